"""A named table of a binary file, whose columns are read piece by piece when they are asked for."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbgc.data.readers.sheets import Piece, shown
from lbgc.errors import InputError, reading, require

Pieces = Iterator[list[np.ndarray]]
"""Columns piece by piece: lists of arrays, one for each column, (rows of the piece,) each."""
AT_ONCE = 2**18
"""Rows in a piece."""
LONGEST_TEXT = 1000
"""Bytes of the longest text in a cell."""

_ENOUGH = 10
"""Times as many rows as any other has a table that is taken for its size"""
_SIX = 6
"""Columns of an IMU's table, at the least"""
_LISTED = 20
"""Tables that a message lists, at most."""


@dataclass(frozen=True)
class Frame:
    """The axes along which a format's rates and forces are, where it states them."""

    axes: tuple[str, ...]
    """Which of them are forward, right and down, in the notation of `LogConfig.axes`"""
    why: str
    """Who states it: a clause"""
    doubt: str = ""
    """When it may be otherwise, a clause; empty where it is certain"""

    @property
    def note(self) -> str:
        """The note of it."""
        said = f"axes: {self.why}, which is log.axes=[{','.join(self.axes)}]"
        return f"{said}, {self.doubt}" if self.doubt else said


@dataclass(frozen=True)
class Table:
    """A table of a file: what its columns are called, and how they are read."""

    name: str
    """Its name in the file: a topic, a variable, a group or a kind of message"""
    names: tuple[str, ...]
    """The columns' names; empty texts where the file gives them none"""
    units: tuple[str, ...]
    """The columns' units, empty texts where nothing states one; or no entry at all"""
    rows: int
    """The number of rows"""
    read: Callable[[Sequence[int]], Pieces]
    """Columns by position, piece by piece"""
    notes: tuple[str, ...] = ()
    """What was found or assumed, plain sentences"""
    frame: Frame | None = None
    """The axes of its sensors, where the format states them"""


@dataclass(frozen=True)
class Collected:
    """The columns of a table put together from their pieces."""

    table: Table
    where: str
    """The file in messages"""

    def head(self, rows: int) -> "Collected":
        """The first rows alone."""
        read, most = self.table.read, min(rows, self.table.rows)

        def first(which: Sequence[int]) -> Pieces:
            left = most
            for piece in read(which):
                yield [own[:left] for own in piece]
                left -= len(piece[0])
                if left <= 0:
                    return

        return replace(self, table=replace(self.table, rows=most, read=first))

    @property
    def rows(self) -> int:
        """The number of rows."""
        return self.table.rows

    def pieces(self, which: Sequence[int]) -> Iterator[Piece]:
        """Columns by position: float64, int64, datetime64 or text. Raises InputError where they
        cannot be read, or have other rows than were announced."""
        at = 0
        with reading("log.path", self.where):
            for piece in self.table.read(which):
                values = [plain(own) for own in piece]
                rows = len(values[0])
                if any(len(own) != rows for own in values) or at + rows > self.rows:
                    raise ValueError("columns of different lengths")
                at += rows
                yield values, []
            if at != self.rows:
                raise ValueError(f"holds {at} rows, and says {self.rows}")


def plain(values: np.ndarray) -> np.ndarray:
    """Values as float64, int64, datetime64[ns] or text (objects that are str). Raises ValueError at
    any other kind, and where whole numbers are 2^63 or more."""
    kind = values.dtype.kind
    if kind == "f":
        return np.ascontiguousarray(values, np.float64)
    if kind == "u" and values.dtype.itemsize == 8 and len(values) and values.max() >= 2**63:
        raise ValueError("holds whole numbers of 2^63 or more")
    if kind in "iub":
        return np.ascontiguousarray(values, np.int64)
    if kind == "M":
        return values.astype("datetime64[ns]")
    if kind in "SU" and values.dtype.itemsize <= 4 * LONGEST_TEXT:
        texts = np.char.decode(values, "utf-8", "replace") if kind == "S" else values
        return texts.astype(object)
    if kind == "O" and all(isinstance(own, str) for own in values):
        return values
    raise ValueError(f"holds values of the kind {values.dtype.name}, which is no number")


def is_column(dtype: np.dtype) -> bool:
    """Whether `plain` takes values of this type: never objects, which would be built."""
    return dtype.kind in "fiubM" or (dtype.kind in "SU" and 0 < dtype.itemsize <= LONGEST_TEXT)


def named_columns(dtype: np.dtype) -> dict[str, int]:
    """The fields of a structured type that are columns, each with the number of its values in a
    row."""
    found = {}
    for name in dtype.names or ():
        own = dtype[name]
        width = own.shape[0] if len(own.shape) == 1 else 1 if own.shape == () else 0
        if width and is_column(own.base):
            found[name] = width
    return found


def in_memory(
    name: str, columns: Mapping[str, np.ndarray], units: Mapping[str, str], notes: tuple[str, ...],
    frame: Frame | None = None,
) -> Table:  # fmt: skip
    """The table of columns that are in memory, by their names."""
    values = list(columns.values())

    def read(which: Sequence[int]) -> Pieces:
        yield [values[at] for at in which]

    return Table(name, tuple(columns), tuple(units[own] for own in columns), len(values[0]), read,
                 notes, frame)  # fmt: skip


def cut_short(name: str, what: str) -> str:
    """A note that a log ends in the middle of what its logger wrote. name : the file's; what : the
    clause that says how it ends. The formats that this happens to have no end of their own."""
    return (
        f"end: {name} was cut short, as where power is lost: {what} and was left out. What came "
        "after is missing, and nothing in the file says how much"
    )


def chosen(found: Sequence[Table], said: str | None, fits: Callable[[Table], bool],
           file: str) -> tuple[Table, tuple[str, ...]]:  # fmt: skip
    """The table that holds the recording, and a note where one was taken of several.

    said : the name that the user gave; fits : whether a table can be an IMU's; file : the file's
    name in messages. Raises InputError, listing the tables, where none or several can be it.
    """
    if said is not None:
        same = [own for own in found if own.name == said]
        if len(same) == 1:
            return same[0], ()
        raise InputError("log.table", said, "", f"is no table of {file}; {_listed(found)}")
    require(bool(found), "log.path", file, "holds no table of numbers")
    if len(found) == 1:
        return found[0], ()
    able = [own for own in found if fits(own)]
    taken = _longest(able or [own for own in found if len(own.names) >= _SIX])
    if taken is not None:
        others = [shown(own.name) + (f" ({own.rows} rows)" if own in able else "")
                  for own in found if own is not taken]  # fmt: skip
        some = ", ".join(others[:_LISTED]) + (" and others" if len(others) > _LISTED else "")
        about = f"table: {shown(taken.name)} of {shown(file)} was read; it also holds {some}"
        return taken, (about,)
    if not able:
        about = f"must be given: in {file} no table has columns named as an IMU's; {_listed(found)}"
        raise InputError("log.table", None, "", about)
    about = f"must be given: several tables of {file} can be an IMU's; {_listed(able)}"
    raise InputError("log.table", None, "", about)


def _longest(found: Sequence[Table]) -> Table | None:
    """The table that has many times as many rows as each other; None where there is none."""
    most = max((own.rows for own in found), default=0)
    near = [own for own in found if _ENOUGH * own.rows >= most]
    return near[0] if len(near) == 1 else None


def _listed(found: Sequence[Table]) -> str:
    """The clause of a message that lists tables."""
    some = [
        f"{shown(own.name)} ({own.rows} rows, {len(own.names)} columns)" for own in found[:_LISTED]
    ]
    more = f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
    return f"choose from {', '.join(some)}{more}" if some else "it has none"
