"""The rows of a table that are read: those from a first to a last one, and those of one of the
sensors that write to it, or that have a value."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lbgc.data.readers.sheets import shown
from lbgc.errors import InputError, require

_LISTED = 10
"""Values that a message lists, at most."""


def within(
    rows: Sequence[Any] | None, columns: list[np.ndarray], file: str
) -> tuple[list[np.ndarray], list[str]]:
    """Columns from a first row to a last one, counted from one, and a note of the others; all of
    them where none are given. Raises InputError where a file has no such rows."""
    if rows is None:
        return columns, []
    (first, last), count = rows, len(columns[0])
    good = first < count and (last is None or last <= count)
    require(good, "log.rows", rows, f"is not within the {count} rows of {file}")
    left = count - (last or count) + first - 1
    kept = [column[first - 1 : last] for column in columns]
    return kept, [f"rows: {left} of {file}'s {count} were left out (log.rows)"]


def rows_key(parts: Sequence[str]) -> str:
    """The key that says which rows are of these triads."""
    return "accel_rows" if tuple(parts) == ("accel",) else "gyro_rows"


def of_one_sensor(
    columns: list[np.ndarray], file: str, key: str, marks: Sequence[Any]
) -> list[np.ndarray]:
    """Columns in the rows whose last column has the stated value, without that column. marks : the
    column as the user names it, and the value. Raises InputError where no row has it."""
    *others, mark = columns
    if mark.dtype.kind in "fiu":
        told = str(marks[1]).strip()
        number = float(told) if told.lstrip("+-").replace(".", "", 1).isdigit() else np.nan
        mine = mark == number
    else:
        mine = np.array([str(own).strip() == str(marks[1]) for own in mark], dtype=bool)
    if not mine.any():
        found = [shown(own) for own in dict.fromkeys(map(str, mark[:1000].tolist()))]
        some = ", ".join(found[:_LISTED])
        raise InputError(f"log.{key}", list(marks), "", f"is in no row of {file}, which has {some}")
    return [column[mine] for column in others]


def with_values(gyro: np.ndarray, accel: np.ndarray, is_timed: bool) -> np.ndarray | None:
    """Which rows of both triads, (T, 3) or (T, 0) each, have a value, (T,) of bool, where a file
    with a time column has others too, as of sensors that come less often; None where all have."""
    parts = [own for own in (gyro, accel) if own.shape[1]]
    if not is_timed or not all(np.isnan(own[:, 0]).any() for own in parts):
        return None
    missing = np.logical_and.reduce([np.isnan(own).all(axis=1) for own in parts])
    return ~missing if 0 < missing.sum() < len(missing) else None
