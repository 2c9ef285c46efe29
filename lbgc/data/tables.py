"""CSV and Parquet files: named columns of numbers."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from lbgc.errors import InputError, reading, require

Table: TypeAlias = pa.Table


def read(path: Path, key: str = "log.path") -> Table:
    """The whole file, by its ending. Raises InputError, naming it by `key`."""
    with reading(key, path), pa.OSFile(str(path)) as file:
        parquet = path.suffix == ".parquet"
        table = pa.parquet.ParquetFile(file).read() if parquet else pa.csv.read_csv(file)
        _ = table.column_names  # decoded only now
        return table


def columns(table: Table, key: str, names: Sequence[str], file: str) -> np.ndarray:
    """These columns as float (rows, columns). Raises InputError where one is missing, stands there
    twice, or holds no numbers."""
    for column in names:
        if column not in table.column_names:
            raise InputError(
                key,
                column,
                "",
                f"is no column of {file}; it has "
                + ", ".join(c or "(unnamed)" for c in table.column_names),
            )
        require(table.column_names.count(column) == 1, key, column, f"stands in {file} twice")
        kind = table.schema.field(column).type
        is_number = pa.types.is_integer(kind) or pa.types.is_floating(kind)
        require(is_number, key, column, f"of {file} holds {kind}, not numbers")
    with reading(key, names):
        arrays = [table[c].to_numpy(zero_copy_only=False).astype(np.float64) for c in names]
        return np.stack(arrays, axis=1)
