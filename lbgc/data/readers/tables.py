"""Columns of numbers from Parquet files, and from text whose layout is known. Arrow is used in this
file and in formats/feather.py only."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from lbgc import machine
from lbgc.errors import reading, require

LARGEST = 4 * 2**30
"""Size of the largest file that is read, bytes, and of the largest that one unfolds to."""
_TOGETHER = 2**18
"""Rows that are unfolded at once."""
_LONGEST = 1000
"""Bytes of the longest text in a cell."""
_KINDS = {"number": pa.float64(), "stamp": pa.int64()}


@dataclass(frozen=True)
class Columns:
    """The columns of a table that Arrow has read."""

    table: pa.Table

    @property
    def names(self) -> tuple[str, ...]:
        """The columns' names."""
        return tuple(map(str, self.table.column_names))

    def head(self, rows: int) -> "Columns":
        """Its first rows alone."""
        return Columns(self.table.slice(0, rows))

    def columns(self, which: Sequence[int]) -> tuple[list[np.ndarray], list[str]]:
        """Columns by position: float64, int64, datetime64 or timedelta64, or text where they hold
        no numbers. Raises InputError where one cannot be converted."""
        found = []
        for at in which:
            with reading("log.path", self.table.column_names[at]):
                found.append(as_array(self.table.column(at)))
        return found, []


def read_parquet(path: Path, key: str) -> Columns:
    """Read a whole Parquet file. Raises InputError, naming it by `key`, where it cannot be read."""
    with reading(key, path), pa.OSFile(str(path)) as file:
        opened = pa.parquet.ParquetFile(file)
        told = opened.metadata
        _require_room(8 * told.num_rows * told.num_columns, path, key)
        kinds = opened.schema_arrow
        texts = [name for name in kinds.names if _is_text(kinds.field(name).type)]
        file.seek(0)  # text that stands there many times is kept once
        opened = pa.parquet.ParquetFile(file, read_dictionary=texts)
        batches, unfolded = [], 0
        for batch in opened.iter_batches(_TOGETHER):
            batches.append(batch)
            unfolded += max(batch.nbytes, 8 * batch.num_rows * batch.num_columns)
            _require_room(unfolded, path, key)
        table = pa.Table.from_batches(batches, batches[0].schema if batches else kinds)
        if table.num_rows != told.num_rows:
            raise ValueError(f"holds {table.num_rows} rows, and says {told.num_rows}")
        _ = table.column_names  # names are decoded here, where a failure is reported
        return Columns(table)


def _require_room(unfolded: int, path: Path, key: str) -> None:
    """Raise InputError where a file unfolds to more bytes than are read, or than this machine has
    memory for: a few kilobytes may hold any number of equal values, and claim any other. What a
    file says of its columns one by one is not asked for: Arrow ends the process where that is
    damaged."""
    require(unfolded <= LARGEST, key, path, f"unfolds to {unfolded} bytes, and {LARGEST} are the "
            "most")  # fmt: skip
    machine.require_memory(key, path, 3.0 * unfolded, "the table that it unfolds to")


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
