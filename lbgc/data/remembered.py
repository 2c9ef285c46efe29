"""What was found whole of a dataset on this machine, so that it need not be read again.

A shard's files are known by a mark of their names, sizes, times and inodes, which whoever writes
them changes. The marks are kept among the user's own files, not in the dataset: who may write a
dataset could otherwise say that it is whole. Bits that rot on a disk change no mark; a value is
checked by its chunk's CRC-32C whenever it is read, and then all is forgotten.
"""

import hashlib
import json
import os
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from lbgc import machine
from lbgc.data.place import Entry, Place
from lbgc.outputs import as_json, fingerprint, read_file, write_atomically

_MOST_BYTES = 400_000_000
_DATASETS = 200
"""Datasets of which something is kept, the last that were used."""
_SETTLED_NS = 2_000_000_000
"""Age from which a file's times tell: one that is written twice within a tick of its file system's
clock, some milliseconds or two seconds, has the same time twice."""


def mark(entries: Mapping[str, Entry], files: Iterable[str]) -> str:
    """What changes when one of these files does; empty where that cannot be told, as of files that
    have just been written, or of a place that gives no such marks."""
    found = [(name, entries[name]) for name in files if name in entries]
    newest = max((own.changed_ns for _, own in found), default=0)
    if not found or not all(own.mark for _, own in found):
        return ""
    if newest > time.time_ns() - _SETTLED_NS:
        return ""
    text = "".join(f"{name} {own.size} {own.mark} " for name, own in found)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class Remembered:
    """The marks of those shards of a dataset that were found whole, (shard -> mark)."""

    def __init__(self, place: Place, identity: str):
        where = str(place.local.resolve()) if place.local is not None else str(place)
        self._file = _home() / f"{fingerprint({'where': where})}.json"
        self._whose = {"where": where, "identity": identity}
        self._marks = {} if os.environ.get(machine.VERIFY) else self._read()
        self._changed = False

    def __contains__(self, own: tuple[int, str]) -> bool:
        shard, now = own
        return bool(now) and self._marks.get(str(shard)) == now

    def note(self, shard: int, now: str) -> None:
        """Remember that a shard's files are whole with this mark, if they have one."""
        if now and self._marks.get(str(shard)) != now:
            self._marks[str(shard)] = now
            self._changed = True

    def save(self) -> None:
        """Keep what was noted. Where it cannot be written, the next command reads again."""
        if not self._changed:
            return
        with suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            kept = sorted(self._file.parent.glob("*.json"), key=lambda f: f.stat().st_mtime)
            for old in kept[:-_DATASETS]:
                old.unlink(missing_ok=True)
            write_atomically(
                self._file, as_json({**self._whose, "marks": self._marks}, indent=None)
            )

    def forget(self) -> None:
        """Know nothing any more: what was whole no longer is."""
        with suppress(OSError):
            self._file.unlink(missing_ok=True)

    def _read(self) -> dict[str, str]:
        try:
            said = json.loads(read_file(self._file, _MOST_BYTES))
            marks = said.pop("marks") if said.get("identity") else None
        except (OSError, ValueError, AttributeError, KeyError, RecursionError):
            return {}
        return marks if said == self._whose and isinstance(marks, dict) else {}


def _home() -> Path:
    """The user's directory for what can be made again."""
    given = os.environ.get("XDG_CACHE_HOME")
    above = Path(given) if given else Path(os.path.expanduser("~")) / ".cache"
    return above / "lbgc" / "verified"
