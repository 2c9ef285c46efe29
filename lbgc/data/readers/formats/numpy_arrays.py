"""NumPy's files: .npy, one array, and .npz, an archive of them. No array of objects is built."""

import io
import struct
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from lbgc.data.readers.formats.table import AT_ONCE, Pieces, Table, is_column, named_columns
from lbgc.data.readers.formats.variables import Variable, extent, sideways, tables_of

_MOST_MEMBERS = 1000
_LONGEST_HEADER = 2**20
"""Bytes"""
_AT_ONCE_BYTES = 2**25
"""Bytes of an array that are held at once while its columns are taken out."""


def read_npy(path: Path) -> list[Table]:
    """The table in an .npy file. Raises ValueError where it holds no table of numbers."""
    with path.open("rb") as file:
        found = _variable(path, None, path.stem, *_header(file))
    if isinstance(found, str):
        raise ValueError(found)
    return tables_of([found], path.stem)


def read_npz(path: Path) -> list[Table]:
    """The tables in an .npz archive; members that are no numbers are passed over. Raises ValueError
    where none is left."""
    found: list[Variable] = []
    refused: list[str] = []
    with zipfile.ZipFile(path) as archive:
        members = archive.namelist()
        if len(members) > _MOST_MEMBERS:
            raise ValueError(f"holds {len(members)} arrays, and {_MOST_MEMBERS} are the most")
        for member in members:
            with archive.open(member) as file:
                name = member.removesuffix(".npy")
                own = _variable(path, member, name, *_header(file))
                if isinstance(own, str):
                    refused.append(own)
                else:
                    found.append(own)
    if not found:
        raise ValueError(refused[0] if refused else "holds no array")
    return tables_of(found, path.stem)


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    """The shape, the order (whether Fortran's) and the type of an array, its file left at the first
    value."""
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    elif version in ((2, 0), (3, 0)):
        size = _exactly(file, 4)
        (length,) = struct.unpack("<I", size)
        if length > _LONGEST_HEADER:
            raise ValueError(f"has a header of {length} bytes")
        text = _exactly(file, length)
        if version == (3, 0):  # as 2.0, but UTF-8: letters beyond ASCII are only in names
            text = text.decode().encode("ascii", "backslashreplace")
        header = io.BytesIO(struct.pack("<I", len(text)) + text)
        shape, fortran, dtype = np.lib.format.read_array_header_2_0(header)
    else:
        raise ValueError(f"is of version {version} of the format, and 1.0 to 3.0 are read")
    return shape, fortran, dtype


def _variable(
    path: Path, member: str | None, name: str, shape: tuple[int, ...], fortran: bool,
    dtype: np.dtype,
) -> Variable | str:  # fmt: skip
    """The variable of an array, or the reason why there is none. member : its name in an
    archive."""
    if dtype.hasobject:
        return f"{name} holds objects, which are not built"
    fields = named_columns(dtype)
    size = extent(shape)
    if size is None or (fields and len(shape) != 1) or not (fields or is_column(dtype)):
        return f"{name} is no table of numbers: its shape is {shape}, its type {dtype.name[:60]}"
    rows, width = size

    def read(which: Sequence[int]) -> Pieces:
        with _opened(path, member) as file:
            _header(file)
            if fields:
                yield from _rows(file, dtype, (), rows, [expanded[at] for at in which])
            elif len(shape) == 2 and fortran != sideways(shape):
                yield _by_columns(file, dtype, rows, width, which)
            else:
                yield from _rows(file, dtype, (width,), rows, [(None, at) for at in which])

    expanded = [(own, at if n > 1 else None) for own, n in fields.items() for at in range(n)]
    names = tuple(own if at is None else f"{own}_{at + 1}" for own, at in expanded)
    return Variable(name, rows, names or ("",) * width, read, structured=bool(fields))


def _opened(path: Path, member: str | None) -> IO[bytes]:
    """An .npy file, or a member of an archive, opened."""
    if member is None:
        return path.open("rb")
    return zipfile.ZipFile(path).open(member)


def _rows(
    file: IO[bytes], dtype: np.dtype, width: tuple[int, ...], rows: int,
    which: Sequence[tuple[str | None, int | None]],
) -> Pieces:  # fmt: skip
    """Columns of values that lie row by row: of a field, of a place in the row, or of both."""
    size = dtype.itemsize * (width[0] if width else 1)
    at_once = max(1, min(AT_ONCE, _AT_ONCE_BYTES // size))
    for first in range(0, rows, at_once):
        count = min(at_once, rows - first)
        values = np.frombuffer(_exactly(file, count * size), dtype).reshape(count, *width)
        yield [_column(values, *own).copy() for own in which]


def _column(values: np.ndarray, name: str | None, at: int | None) -> np.ndarray:
    """A field, a place in the row, or a place in a field."""
    own = values if name is None else values[name]
    return own if at is None else own[:, at]


def _by_columns(
    file: IO[bytes], dtype: np.dtype, rows: int, width: int, which: Sequence[int]
) -> list[np.ndarray]:
    """Columns of values that lie column by column."""
    found: dict[int, np.ndarray] = {}
    size = rows * dtype.itemsize
    for at in range(max(which, default=-1) + 1):
        made = np.empty(rows, dtype) if at in which else None
        taken: Any = None if made is None else made.view(np.uint8)
        for first in range(0, size, _AT_ONCE_BYTES):
            part = _exactly(file, min(_AT_ONCE_BYTES, size - first))
            if taken is not None:
                taken[first : first + len(part)] = np.frombuffer(part, np.uint8)
        if made is not None:
            found[at] = made
    return [found[at] for at in which]


def _exactly(file: IO[bytes], size: int) -> bytes:
    """As many bytes as asked for. Raises ValueError where the file ends before."""
    content = file.read(size)
    if len(content) != size:
        raise ValueError("ends before its last row")
    return content
