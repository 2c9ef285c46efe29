"""MATLAB's .mat files up to version 7; those of version 7.3 are HDF5 (`hdf5`). Numbers and
structures of numbers are read; an object of a class is passed over, and nothing is built of it."""

import struct
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from lbgc.data.readers import tables
from lbgc.data.readers.formats.table import Table, is_column
from lbgc.data.readers.formats.variables import Variable, of_array, tables_of

MAGIC = b"MATLAB 5.0 MAT-file"
_HEADER, _COMPRESSED = 128, 15
_DEEPEST = 5
_NUMBERS = {"double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
            "uint64", "logical", "struct"}  # fmt: skip
_AT_ONCE = 2**20


def read(path: Path) -> list[Table]:
    """The tables of a .mat file: variables, and fields of a structure, that have equally many rows
    are one. Raises ValueError where there is none, or where it unfolds to more than is read."""
    import scipy.io  # half a second, which only these files take

    with path.open("rb") as file:
        if file.read(len(MAGIC)) == MAGIC:
            _require_bounded(file)
    there = scipy.io.whosmat(path, appendmat=False)
    names = [name for name, _, kind in there if kind in _NUMBERS]
    with warnings.catch_warnings(action="ignore"):  # of variables that stand there twice
        found = scipy.io.loadmat(path, appendmat=False, variable_names=names) if names else {}
    variables = [own for name in names if name in found for own in _variables(name, found[name])]
    if not variables:
        others = ", ".join(f"{name} ({kind})" for name, _, kind in there[:20])
        raise ValueError(f"holds no table of numbers, but {others or 'nothing'}")
    return tables_of(variables, path.stem)


def _variables(path: str, values: Any, deeper: int = _DEEPEST) -> Iterator[Variable]:
    """The variables in an array, or in the fields of a structure."""
    if not isinstance(values, np.ndarray):
        return
    if values.dtype.names and values.size == 1 and deeper:
        record = values.reshape(-1)[0]
        for name in values.dtype.names:
            yield from _variables(f"{path}/{name}", record[name], deeper - 1)
    elif not values.dtype.names and is_column(values.dtype):
        own = of_array(path, values)
        if own is not None:
            yield own


def _require_bounded(file: IO[bytes]) -> None:
    """Raise ValueError where the file's compressed variables unfold to more than is read."""
    file.seek(_HEADER - 2)
    order = "<" if file.read(2) == b"IM" else ">"
    unfolded = 0
    while len(tag := file.read(8)) == 8:
        kind, size = struct.unpack(f"{order}II", tag)
        if kind == _COMPRESSED:
            for part in _unfolded(file, size):
                unfolded += part
                if unfolded > tables.LARGEST:
                    about = f"unfolds to more than {tables.LARGEST} bytes, which are the most"
                    raise ValueError(about)
        else:
            file.seek(size, 1)


def _unfolded(file: IO[bytes], size: int) -> Iterator[int]:
    """How many bytes each part of a compressed variable unfolds to."""
    stream = zlib.decompressobj()
    while size > 0 and not stream.eof:
        part = stream.unconsumed_tail or file.read(min(_AT_ONCE, size))
        if not stream.unconsumed_tail:
            size -= len(part)
        if not part:
            raise ValueError("ends within a variable")
        yield len(stream.decompress(part, _AT_ONCE))
    while stream.unconsumed_tail and not stream.eof:
        yield len(stream.decompress(stream.unconsumed_tail, _AT_ONCE))
    file.seek(size, 1)
