"""Whether a dataset's shards are whole: what its manifest says of them, against its files."""

from collections.abc import Mapping
from dataclasses import dataclass

from tqdm import tqdm

from lbgc.data import manifest
from lbgc.data.documents import Layout
from lbgc.data.files import row_files
from lbgc.data.place import Entry, Place
from lbgc.data.remembered import Remembered, mark


@dataclass(frozen=True)
class State:
    """What a dataset's files are, against what its manifest says."""

    missing: list[int]
    """Shards which the manifest does not name"""
    damaged: list[int]
    """Shards which it names, and whose files are not what it says"""
    strays: list[str]
    """Files that an interrupted run has left, and links in the place of files"""
    read: int
    """Shards whose files were read for it; the others were found whole before, and are as they
    were then"""

    @property
    def unfinished(self) -> list[int]:
        """What generation has to do, or to do again."""
        return sorted(self.missing + self.damaged)


def state(place: Place, identity: str, layout: Layout) -> State:
    """The state of the dataset of this identity and layout."""
    entries = place.entries()
    rows = manifest.rows(place, entries, layout.schema, layout.shards)
    known, damaged, read = Remembered(place, identity), [], 0
    for shard in tqdm(sorted(rows), "checking", unit="shard", leave=False, delay=1):
        files = layout.files(shard)
        if not _has_its_sizes(rows[shard], files, entries):
            damaged.append(shard)
            continue
        now = mark(entries, [*files, *row_files(shard, layout.schema)])
        if (shard, now) in known:
            continue
        read += 1
        row = rows[shard]
        there = place.read_all(name for name in files if name in entries)
        if manifest.stored_checksum(identity, shard, files, there.get, row.digest) == row.stored:
            known.note(shard, now)
        else:
            damaged.append(shard)
    known.save()
    missing = [shard for shard in range(layout.shards) if shard not in rows]
    return State(missing, damaged, manifest.strays(entries), read)


def remember(place: Place, identity: str, layout: Layout) -> None:
    """Take every shard whose files have the names and sizes that the manifest says for whole: they
    were written by this program a moment ago."""
    entries, known = place.entries(), Remembered(place, identity)
    for shard, row in manifest.rows(place, entries, layout.schema, layout.shards).items():
        files = layout.files(shard)
        if _has_its_sizes(row, files, entries):
            known.note(shard, mark(entries, [*files, *row_files(shard, layout.schema)]))
    known.save()


def _has_its_sizes(row: manifest.Row, files: list[str], entries: Mapping[str, Entry]) -> bool:
    """Whether a shard has the files that its row tells of, by name and size; an earlier version's
    rows tell nothing of that."""
    if not row.sizes:
        return True
    found = {name: entries[name].size for name in files if name in entries}
    return manifest.sizes_checksum(found) == row.sizes
