"""Files of numbers as sheets of named columns, whose values are read piece by piece when they are
asked for."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from tqdm import tqdm

from lbgc import machine, outputs
from lbgc.data.readers import tables
from lbgc.errors import require

_HEAD_ROWS = 100_000
"""Rows of a sheet's head."""
_SHOWN = 60
"""Characters of a file's text that a message shows, at most."""
_PATIENCE_S = 5.0
"""Seconds after which it is shown how much is read."""

Piece = tuple[list[np.ndarray], list[str]]
"""Some rows of columns, (rows of the piece,) each, and notes of what was left out before them"""
Number = Callable[[int, np.ndarray], np.ndarray]
"""A column's values as float64, by its position; raises InputError where they are not numbers"""


def shown(text: object) -> str:
    """Text from a file in a form for messages, which name several."""
    return outputs.shown(text, _SHOWN)


class Source(Protocol):
    """What columns are read from."""

    @property
    def rows(self) -> int:
        """The number of rows, or somewhat more."""

    def pieces(self, which: Sequence[int]) -> Iterator[Piece]:
        """Columns by position, piece by piece, in the types that `Sheet.columns` gives."""

    def head(self, rows: int) -> "Source":
        """A source of the first rows alone."""


@dataclass(frozen=True)
class Sheet:
    """The columns of a file, whose values are read when they are asked for."""

    file: str
    """The file's name in messages"""
    names: tuple[str, ...]
    """The columns' names; an empty text where the file has no header, or a column no name"""
    units: tuple[str, ...]
    """The units in a row beneath the header; empty where there is none"""
    rate_hz: float | None
    """Sample rate that comments and preamble state, Hz"""
    source: Source
    """The file's content"""
    notes: tuple[str, ...] = ()
    """What was found or assumed before any column was read, plain sentences"""

    @property
    def width(self) -> int:
        """The number of columns."""
        return len(self.names)

    @property
    def has_header(self) -> bool:
        """Whether any column has a name."""
        return any(self.names)

    def head(self) -> "Sheet":
        """The sheet with its first rows alone, some 100,000."""
        return replace(self, source=self.source.head(_HEAD_ROWS))

    def columns(self, which: Sequence[int]) -> tuple[list[np.ndarray], list[str]]:
        """Read columns by position, each (T,): float64, int64 where they are whole numbers of more
        than nine digits (stamps), or datetime64; text where they are none of these. With notes of
        what was left out."""
        _, columns, notes = self.together((), which, lambda at, values: values)
        return columns, notes

    def together(
        self, groups: Sequence[Sequence[int]], others: Sequence[int], number: Number
    ) -> tuple[list[np.ndarray], list[np.ndarray], list[str]]:
        """Read groups of columns of numbers, each as one array (T, columns) of float64, and other
        columns as `columns` does, in one pass that holds no row twice."""
        rows = self.source.rows
        require_room(rows, sum(map(len, groups)) + len(others), self.file)
        wanted = [(own, k, at) for own, group in enumerate(groups) for k, at in enumerate(group)]
        made = [np.empty((rows, len(group))) for group in groups]
        beside = [_Column(rows) for _ in others]
        notes, first = [*self.notes], 0
        every = [*(at for *_, at in wanted), *others]
        with tqdm(total=rows, desc=f"reading {shown(self.file)}", unit=" rows", unit_scale=True,
                  leave=False, delay=_PATIENCE_S) as bar:  # fmt: skip
            for values, noted in self.source.pieces(every):
                notes += noted
                last = first + len(values[0]) if values else first
                for (own, k, at), column in zip(wanted, values, strict=False):
                    made[own][first:last, k] = number(at, column)
                for kept, column in zip(beside, values[len(wanted) :], strict=True):
                    kept.add(first, column)
                bar.update(last - first)
                first = last
        tables.let_go()
        return [own[:first] for own in made], [own.until(first) for own in beside], notes


class _Column:
    """A column that is put together from its pieces, of a type that holds all of them."""

    def __init__(self, rows: int):
        self.rows, self.values = rows, np.empty(0)

    def add(self, first: int, piece: np.ndarray) -> None:
        """Put a piece behind those that were added, which end before row `first`."""
        if first == 0:
            self.values = np.empty(self.rows, piece.dtype)
        elif self.values.dtype != piece.dtype:  # such as whole numbers of which some are missing
            kind = np.promote_types(self.values.dtype, piece.dtype)
            self.values = self.values.astype(kind)
        self.values[first : first + len(piece)] = piece

    def until(self, rows: int) -> np.ndarray:
        """The column, of so many rows."""
        return self.values[:rows]


def require_room(rows: int, columns: int, where: str) -> None:
    """Raise InputError where columns take more memory than is read, or than this machine has."""
    size, most = 8 * rows * columns, tables.LARGEST
    require(size <= most, "log.path", where, f"unfolds to {size} bytes, and {most} are the most")
    machine.require_memory("log.path", where, 1.5 * size, "the table that it unfolds to")
