"""Tables from files of named arrays (NumPy archives, MATLAB, HDF5, R), which belong together where
they lie in one group and have equally many rows."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lbgc.data.readers.formats.table import Pieces, Table

_AXES = ("x", "y", "z")
_WIDEST = 1000
"""Columns of one array, at most."""


@dataclass(frozen=True)
class Variable:
    """An array of a file, one row a sample."""

    path: str
    """Its name in the file, after those of its groups and a slash"""
    rows: int
    """The number of rows"""
    columns: tuple[str, ...]
    """The names of its columns where the file gives them, or empty texts"""
    read: Callable[[Sequence[int]], Pieces]
    """Its columns by position, piece by piece"""
    unit: str = ""
    """The unit of all its columns, where the file states it"""
    structured: bool = False
    """Whether its columns are fields with names of their own"""

    @property
    def group(self) -> str:
        """The name of its group; empty for the file's root."""
        return self.path.rpartition("/")[0]

    @property
    def name(self) -> str:
        """Its name without its group's."""
        return self.path.rpartition("/")[2]


def sideways(shape: Sequence[int]) -> bool:
    """Whether an array of this shape has its samples along the second axis, which is then the
    longer one: no recording has fewer samples than columns."""
    return len(shape) == 2 and shape[1] > shape[0]


def extent(shape: Sequence[int]) -> tuple[int, int] | None:
    """The rows and columns of an array of this shape; None where it is no table."""
    if len(shape) == 1:
        rows, columns = int(shape[0]), 1
    elif len(shape) == 2:
        columns, rows = sorted(map(int, shape))
    else:
        return None
    return (rows, columns) if rows > 1 and 0 < columns <= _WIDEST else None


def of_array(path: str, values: np.ndarray, columns: Sequence[str] = ()) -> Variable | None:
    """A variable of an array in memory; None where it is no table."""
    size = extent(values.shape)
    if size is None:
        return None
    rows, width = size
    turned = values.T if sideways(values.shape) else values.reshape(rows, width)
    names = tuple(columns) if len(columns) == width else ("",) * width
    return Variable(path, rows, names, lambda which: iter([[turned[:, at] for at in which]]))


def tables_of(variables: Sequence[Variable], root: str) -> list[Table]:
    """The tables that variables make. root : the name of those in no group."""
    groups: dict[tuple[str, int], list[Variable]] = {}
    found = []
    for own in variables:
        if own.structured:
            found.append(Table(own.path or root, own.columns, (), own.rows, own.read))
        else:
            groups.setdefault((own.group, own.rows), []).append(own)
    several = {group for group, _ in groups if sum(group == other for other, _ in groups) > 1}
    for (group, rows), members in groups.items():
        name = members[0].path if len(members) == 1 else group or root
        if group in several and len(members) > 1:
            name += f"_{rows}"
        found.append(_joined(name or root, rows, members))
    return found


def _joined(name: str, rows: int, members: Sequence[Variable]) -> Table:
    """The table of variables that stand side by side."""
    alone = len(members) == 1
    places = [(own, at) for own in members for at in range(len(own.columns))]
    names = tuple(_name(own, at, alone) for own, at in places)
    units = tuple(own.unit for own, _ in places)

    def read(which: Sequence[int]) -> Pieces:
        wanted = [places[at] for at in which]
        own = {id(variable): variable for variable, _ in wanted}
        asked = {key: [at for v, at in wanted if v is variable] for key, variable in own.items()}
        streams = [own[key].read(columns) for key, columns in asked.items()]
        for pieces in _together(streams):
            left = {key: iter(piece) for key, piece in zip(asked, pieces, strict=True)}
            yield [next(left[id(variable)]) for variable, _ in wanted]

    return Table(name, names, units if any(units) else (), rows, read)


def _together(streams: Sequence[Pieces]) -> Iterator[list[list[np.ndarray]]]:
    """The pieces of several arrays side by side, cut to equal numbers of rows. Raises ValueError
    where one array ends before another."""
    held: list[list[np.ndarray] | None] = [next(own, None) for own in streams]
    while any(own is not None for own in held):
        whole = [own for own in held if own is not None]
        if len(whole) < len(held):
            raise ValueError("columns of different lengths")
        rows = min(len(own[0]) for own in whole)
        yield [[column[:rows] for column in own] for own in whole]
        held = [
            [column[rows:] for column in own] if len(own[0]) > rows else next(stream, None)
            for own, stream in zip(whole, streams, strict=True)
        ]


def _name(own: Variable, at: int, alone: bool) -> str:
    """The name of a variable's column: its own, the variable's with an axis or number behind it, or
    none where a matrix of unnamed columns is the whole table."""
    width = len(own.columns)
    if own.columns[at]:
        return own.columns[at]
    if width == 1:
        return own.name
    if width == 3:
        return f"{own.name}_{_AXES[at]}"
    return "" if alone else f"{own.name}_{at + 1}"
