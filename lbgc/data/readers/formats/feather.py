"""Arrow's own files: Feather (version 1, and version 2, the IPC file) and the IPC stream."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.feather
import pyarrow.ipc

from lbgc.data.readers.formats.table import AT_ONCE, Pieces, Table
from lbgc.data.readers.tables import as_array

FILE, STREAM, OLD = b"ARROW1\0\0", b"\xff\xff\xff\xff", b"FEA1"
_UNITS = (b"units", b"unit")


def read(path: Path) -> list[Table]:
    """The table of an Arrow file; a column's unit is its field's `units`, where that is there."""
    with path.open("rb") as file:
        if file.read(4) == OLD:
            return [_old(path)]
    with _opened(path, None) as (opened, _):
        names = tuple(map(str, opened.schema.names))
        units = tuple(_unit(field.metadata) for field in opened.schema)
    with _opened(path, [0]) as (_, batches):
        rows = sum(batch.num_rows for batch in batches)
    return [Table(path.stem, names, units if any(units) else (), rows,
                  lambda which: _pieces(path, which))]  # fmt: skip


def _old(path: Path) -> Table:
    """The table of a Feather file of version 1, which is read whole."""
    found = pa.feather.read_table(path, memory_map=False, use_threads=False)
    found.validate(full=True)

    def pieces(which: Sequence[int]) -> Pieces:
        yield [as_array(found.column(at)) for at in which]

    return Table(path.stem, tuple(map(str, found.column_names)), (), found.num_rows, pieces)


@contextmanager
def _opened(path: Path, which: Sequence[int] | None) -> Iterator[tuple[Any, Iterator[Any]]]:
    """An Arrow file and its batches, which have some of its columns alone, or all for None."""
    included = None if which is None else sorted(set(which))
    options = pa.ipc.IpcReadOptions(included_fields=included, use_threads=False)
    with pa.OSFile(str(path)) as file:
        head = file.read(4)
        file.seek(0)
        if head == STREAM:
            opened = pa.ipc.open_stream(file, options=options)
            yield opened, iter(opened)
        else:
            opened = pa.ipc.open_file(file, options=options)
            yield opened, (opened.get_batch(at) for at in range(opened.num_record_batches))


def _pieces(path: Path, which: Sequence[int]) -> Pieces:
    """Columns of an Arrow file, piece by piece, each held to Arrow's own rules."""
    places = {own: at for at, own in enumerate(sorted(set(which)))}
    with _opened(path, which) as (_, batches):
        for batch in batches:
            batch.validate(full=True)
            for first in range(0, batch.num_rows, AT_ONCE):
                part = batch.slice(first, AT_ONCE)
                yield [as_array(pa.chunked_array([part.column(places[at])])) for at in which]


def _unit(told: dict[bytes, bytes] | None) -> str:
    """The unit that a field's metadata state; empty where they state none."""
    found = next((told[key] for key in _UNITS if key in told), b"") if told else b""
    return found[:100].decode("utf-8", "replace")
