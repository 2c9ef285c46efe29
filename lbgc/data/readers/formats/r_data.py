"""R's workspaces (.rda, .RData) and single objects (.rds): matrices, vectors, and lists or data
frames of vectors. They are parsed as they lie; no object of a class is built."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lbgc.data.readers.formats.compressed import is_compressed, unfolded
from lbgc.data.readers.formats.extras import needed
from lbgc.data.readers.formats.table import Table
from lbgc.data.readers.formats.variables import Variable, of_array, tables_of

WORKSPACES = tuple(f"RD{kind}{version}\n".encode() for kind in "XAB" for version in (2, 3))
OBJECTS = (*(b"X\n\0\0\0" + bytes([version]) for version in (2, 3)), b"A\n2\n", b"A\n3\n")
MAGICS = (*WORKSPACES, *OBJECTS)
"""What files of this format begin with, once they are unfolded"""
LONGEST_MAGIC = max(map(len, MAGICS))
_MOST = 100_000
"""Objects in a list, at most"""
_LIST, _PAIRS, _NULL = "VEC", "LIST", ("NILVALUE", "NIL")
_NUMBERS = ("REAL", "INT", "LGL")


def read(path: Path) -> list[Table]:
    """The tables of an R workspace, or of one object. Raises ValueError where it holds none;
    InputError where rdata is missing, or the file unfolds to more than is read."""
    parser = needed("rdata.parser")
    with path.open("rb") as file:
        folded = is_compressed(file.read(6))
    content = unfolded(path) if folded else path.read_bytes()
    is_object = content.startswith(OBJECTS)
    root = parser.parse_data(content, extension=".rds" if is_object else ".rda").object
    named = [(path.stem, root)] if is_object else _pairs(root)
    variables = [own for name, value in named for own in _variables(name, value)]
    if not variables:
        raise ValueError("holds no table of numbers")
    return tables_of(variables, path.stem)


def _pairs(own: Any) -> Iterator[tuple[str, Any]]:
    """The names and values of a list of pairs."""
    for _ in range(_MOST):
        if own is None or own.info.type.name in _NULL:
            return
        if own.info.type.name != _PAIRS:
            raise ValueError("is no list of named objects")
        value, rest = own.value
        yield _text(own.tag), value
        own = rest


def _text(own: Any) -> str:
    """A name: a symbol, a reference to one, or a text."""
    for _ in range(4):
        if isinstance(own, bytes):
            return own.decode("utf-8", "replace")
        if own is None:
            return ""
        own = own.referenced_object if own.referenced_object is not None else own.value
    return ""


def _variables(name: str, own: Any) -> Iterator[Variable]:
    """The variables in an object: itself, or what a list holds."""
    said = dict(_pairs(own.attributes)) if own.attributes is not None else {}
    if own.info.type.name in _NUMBERS:
        found = _array(name, own.value, said)
        if found is not None:
            yield found
    elif own.info.type.name == _LIST and "names" in said:
        names = [_text(one) for one in said["names"].value]
        for one, value in zip(names, own.value, strict=True):
            if value.info.type.name in _NUMBERS:
                attributes = dict(_pairs(value.attributes)) if value.attributes is not None else {}
                found = _array(f"{name}/{one}", value.value, attributes)
                if found is not None:
                    yield found


def _array(name: str, values: Any, said: dict[str, Any]) -> Variable | None:
    """The variable of a vector, or of a matrix, whose columns may have names."""
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    values = np.asarray(values)
    columns: Sequence[str] = ()
    if "dim" in said:
        shape = tuple(int(own) for own in said["dim"].value)
        values = values.reshape(shape, order="F")
        if "dimnames" in said and len(shape) == 2:
            own = said["dimnames"].value[1]
            columns = [] if own.info.type.name in _NULL else [_text(one) for one in own.value]
    return of_array(name, values, columns)
