"""Columns of numbers from Parquet files, and from text whose layout is known. Arrow is used in this
file and in formats/feather.py only."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from lbgc.errors import InputError, reading, require

LARGEST = 4 * 2**30
"""Size of the largest file that is read, bytes, and of the largest that one unfolds to."""
_TOGETHER = 2**18
"""Rows that are unfolded at once."""
_BUFFER = 2**20
"""Bytes of a column that are read at once."""
_LONGEST = 1000
"""Bytes of the longest text in a cell."""
_KINDS = {"number": pa.float64(), "stamp": pa.int64(), "string": pa.string()}


@dataclass(frozen=True)
class Columns:
    """The columns of a Parquet file."""

    path: Path
    key: str
    """The key that names the file in messages"""
    names: tuple[str, ...]
    """The columns' names"""
    rows: int
    """The number of rows that it says it has"""

    def head(self, rows: int) -> "Columns":
        """Its first rows alone."""
        return replace(self, rows=min(rows, self.rows))

    def pieces(self, which: Sequence[int]) -> Iterator[tuple[list[np.ndarray], list[str]]]:
        """Columns by position, piece by piece: float64, int64, datetime64 or timedelta64, or text
        where they hold no numbers; with no notes. Raises InputError where one cannot be
        converted."""
        count = unfolded = 0
        with reading(self.key, self.path), pa.OSFile(str(self.path)) as file:
            kinds = pa.parquet.ParquetFile(file).schema_arrow
            texts = [name for name in kinds.names if _is_text(kinds.field(name).type)]
            file.seek(0)  # text that stands there many times is kept once
            opened = pa.parquet.ParquetFile(file, read_dictionary=texts, buffer_size=_BUFFER)
            flat = len(set(self.names)) == len(self.names) == opened.metadata.num_columns
            some = [self.names[at] for at in dict.fromkeys(which)]
            groups = range(opened.num_row_groups)  # one by one, since Arrow reads ahead
            for batch in chain.from_iterable(
                opened.iter_batches(_TOGETHER, [group], some if flat else None) for group in groups
            ):
                rows = min(batch.num_rows, self.rows - count)
                unfolded += max(batch.nbytes, 8 * batch.num_rows * batch.num_columns)
                about = f"unfolds to {unfolded} bytes, and {LARGEST} are the most"
                require(unfolded <= LARGEST, self.key, self.path, about)
                yield [self._column(batch, some.index(self.names[at]) if flat else at, rows)
                       for at in which], []  # fmt: skip
                count += rows
                if count == self.rows:
                    return
        if count != self.rows:
            about = f"holds {count} rows, and says {self.rows}"
            raise InputError(self.key, self.path, "", f"cannot be read ({about})")

    def _column(self, batch: pa.RecordBatch, at: int, rows: int) -> np.ndarray:
        """The first rows of a batch's column."""
        with reading("log.path", batch.schema.names[at]):
            return as_array(pa.chunked_array([batch.column(at).slice(0, rows)]))


def read_parquet(path: Path, key: str) -> Columns:
    """The columns of a Parquet file. Raises InputError, naming it by `key`, where it cannot be
    read."""
    with reading(key, path), pa.OSFile(str(path)) as file:
        opened = pa.parquet.ParquetFile(file)
        names = tuple(map(str, opened.schema_arrow.names))
        return Columns(path, key, names, opened.metadata.num_rows)


def let_go() -> None:
    """Give back the memory that Arrow keeps for what it may read next."""
    pa.default_memory_pool().release_unused()


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_binary(kind))


def parsed(
    body: bytes, separator: str, decimal: str, width: int, kinds: dict[int, str]
) -> list[np.ndarray] | None:
    """Parse columns of text rows that have `width` fields each.

    kinds : of the columns to read, by position: number, stamp (int64), or text, which may turn out
    to be a date. Returns an array for each, or None where some row does not fit.
    """
    names = [str(at) for at in range(width)]
    types = {str(at): _KINDS[kind] for at, kind in kinds.items() if kind in _KINDS}
    try:
        table = pa.csv.read_csv(
            pa.BufferReader(body),
            pa.csv.ReadOptions(column_names=names, block_size=2**23),
            pa.csv.ParseOptions(delimiter=separator),
            pa.csv.ConvertOptions(
                column_types=types,
                include_columns=[str(at) for at in kinds],
                decimal_point=decimal,
            ),
        )
        return [as_array(table[str(at)]) for at in kinds]
    except (pa.ArrowInvalid, OverflowError):
        return None


def as_array(values: pa.ChunkedArray) -> np.ndarray:
    """An Arrow column as a NumPy array; times of day become timedelta64."""
    kind = values.type
    if pa.types.is_timestamp(kind):
        return np.asarray(values.cast(pa.timestamp("ns")).to_numpy())
    if pa.types.is_time(kind):
        unit = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}[kind.unit]
        whole = values.cast(pa.int32() if pa.types.is_time32(kind) else pa.int64())
        return np.asarray((whole.to_numpy().astype(np.int64) * unit).view("timedelta64[ns]"))
    if pa.types.is_integer(kind) and values.null_count == 0:
        return np.asarray(values.to_numpy().astype(np.int64))
    if pa.types.is_integer(kind) or pa.types.is_floating(kind):
        return np.asarray(values.to_numpy().astype(np.float64))
    if pa.types.is_dictionary(kind):
        texts = [own for part in values.chunks for own in part.dictionary.cast(pa.string())]
        longest = max((len(own.as_buffer() or b"") for own in texts), default=0)
        if longest > _LONGEST:
            raise ValueError(f"holds a text of {longest} bytes, and {_LONGEST} are the most")
    return np.asarray(values.cast(pa.string()).to_pylist(), dtype=object)
