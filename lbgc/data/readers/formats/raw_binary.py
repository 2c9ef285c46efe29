"""Files of nothing but rows of numbers, whose layout the log's configuration says (log.dtype)."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from lbgc.data.readers.formats.table import AT_ONCE, Pieces, Table, named_columns
from lbgc.data.readers.said import row_type
from lbgc.errors import require


def read(path: Path, fields: Sequence[str], skip_bytes: int) -> list[Table]:
    """The table in a file of rows. fields : each one's name and type, as `row_type` takes them;
    skip_bytes : bytes before the first row. Raises InputError where the file holds no whole number
    of rows."""
    dtype = row_type(list(fields))
    size = path.stat().st_size - skip_bytes
    rows, left = divmod(max(size, 0), dtype.itemsize)
    about = f"leaves {left} bytes of {path.name}, which has {size + skip_bytes}, after {rows} rows "
    about += f"of {dtype.itemsize} bytes: check the types, and log.skip_bytes"
    require(rows > 0 and left == 0, "log.dtype", list(fields), about)
    names = tuple(named_columns(dtype))

    def pieces(which: Sequence[int]) -> Pieces:
        return _pieces(path, dtype, skip_bytes, rows, [names[at] for at in which])

    return [Table(path.stem, names, (), rows, pieces)]


def _pieces(
    path: Path, dtype: np.dtype, first: int, rows: int, which: Sequence[str]
) -> Iterator[list[np.ndarray]]:
    """Columns of a file of rows, piece by piece."""
    with path.open("rb") as file:
        file.seek(first)
        for at in range(0, rows, AT_ONCE):
            values = np.fromfile(file, dtype, min(AT_ONCE, rows - at))
            yield [values[name].copy() for name in which]
