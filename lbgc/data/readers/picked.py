"""The choice of a sheet's columns for gyros, accelerometers and time, and their units."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from lbgc.data.logconfig import (
    ACCEL_UNITS,
    DEFAULT_ACCEL,
    DEFAULT_GYRO,
    GYRO_UNITS,
    NONE,
    LogConfig,
)
from lbgc.data.readers.clock import TIME_UNITS
from lbgc.data.readers.column_names import Described, described, seconds_and_nanoseconds
from lbgc.data.readers.sheets import Sheet, shown
from lbgc.errors import InputError, require

_SENSORS = ("log.columns", "log.gyro_columns", "log.accel_columns", "columns")
"""Keys of the sensors' columns."""
_USUAL = {"gyro": DEFAULT_GYRO, "accel": DEFAULT_ACCEL}


@dataclass(frozen=True)
class Picked:
    """The columns that are read, by position counted from zero, and their units."""

    gyro: tuple[int, ...]
    """The gyros' columns, x, y and z; empty where there are none"""
    accel: tuple[int, ...]
    """The accelerometers' columns, likewise"""
    time: tuple[int, ...]
    """The time column, or the two of whole seconds and nanoseconds; empty where there is none"""
    gyro_unit: str | None
    """The gyros' unit by the columns' names or the row beneath them; None where they do not state
    one"""
    accel_unit: str | None
    """The accelerometers' unit, likewise"""
    time_unit: str | None
    """The time's unit, likewise"""
    time_is_said: bool
    """Whether the user named the time column"""
    time_name: str = ""
    """The time column's name in messages"""


def picked(sheet: Sheet, config: LogConfig, parts: Sequence[str] | None = None) -> Picked:
    """Choose the columns to read, by the names or positions in the configuration, or else by the
    meaning of the columns' names. parts : the triads that this sheet has; None: all that were
    recorded. Raises InputError where a column is missing or ambiguous."""
    says = [described(*own) for own in zip_longest(sheet.names, sheet.units, fillvalue="")]
    parts = config.recorded if parts is None else parts
    given = {kind: _given(config, kind) if kind in parts else [] for kind in _USUAL}
    alone = len(parts) == 1
    at = {k: _triad(sheet, config, k, says, alone) if k in parts else [] for k in _USUAL}
    time = _time(sheet, config, says)
    by_name = {
        kind: [
            None if _is_position(name) else says[column]
            for name, column in zip(given[kind], at[kind], strict=True)
        ]
        for kind in _USUAL
    }
    return Picked(
        tuple(at["gyro"]),
        tuple(at["accel"]),
        time,
        _common_unit(by_name["gyro"], GYRO_UNITS),
        _common_unit(by_name["accel"], ACCEL_UNITS),
        None if len(time) != 1 or says[time[0]].unit not in TIME_UNITS else says[time[0]].unit,
        config.time_column is not None,
        " and ".join(shown(sheet.names[at]) or f"number {at + 1}" for at in time),
    )


def named(sheet: Sheet, key: str, names: Sequence[object]) -> list[int]:
    """The positions, counted from zero, of columns that are given by name, or by position counted
    from one. Raises InputError where a column is missing, or has a name that occurs twice."""
    return [_position(sheet, key, name) for name in names]


def _position(sheet: Sheet, key: str, name: object) -> int:
    """The position of one column, as `named` gives it."""
    found = [at for at, own in enumerate(sheet.names) if own == name]
    if not found:
        found = [at for at, own in enumerate(sheet.names) if _bare(own) == name]
    if len(found) == 1:
        return found[0]
    require(not found, key, shown(name), f"stands in {sheet.file} twice; give its position")
    if _is_position(name):
        at = int(str(name))
        about = f"must be from 1 to {sheet.width}, the columns of {sheet.file}"
        require(1 <= at <= sheet.width, key, name, about)
        return at - 1
    has = _has(sheet, key in _SENSORS)
    raise InputError(key, shown(name), "", f"is no column of {sheet.file}; {has}")


def _bare(name: str) -> str:
    """A column's name without a unit in brackets."""
    for bracket in "([":
        name = name.split(bracket)[0] or name
    return name.strip()


def _is_position(name: object) -> bool:
    """Whether a column is given by its position."""
    return isinstance(name, int) or (isinstance(name, str) and name.isdigit())


def _has(sheet: Sheet, sensors: bool = True) -> str:
    """The clause of a message that lists the columns of a sheet. sensors : whether it is about the
    six of the sensors, so that it says how they are given."""
    if not sheet.has_header:
        how = _by_position(sheet) if sensors else "give its position, counted from 1"
        return f"it has no header, and {sheet.width} columns: {how}"
    names = [shown(name) if name else "(unnamed)" for name in sheet.names[:40]]
    more = f" and {sheet.width - 40} more" if sheet.width > 40 else ""
    how = ": give log.columns, six of them: gyro, accelerometer" if sensors else ""
    return f"it has {', '.join(names)}{more}{how}"


def _by_position(sheet: Sheet) -> str:
    """The clause of a message that says how columns are given by position."""
    first = 2 if sheet.width > 6 else 1
    example = ",".join(str(at) for at in range(first, first + 6))
    time = " log.time_column=1" if first == 2 else ""
    return (
        f"say which are gyro x, y, z and accelerometer x, y, z, counted from 1, such as "
        f"log.columns=[{example}]{time}"
    )


def _given(config: LogConfig, kind: str) -> list[Any]:
    """The columns of a triad (gyro or accel) as the configuration names them."""
    if config.columns is not None:
        return config.columns[:3] if kind == "gyro" else config.columns[3:]
    return list(getattr(config, f"{kind}_columns"))


def _triad(
    sheet: Sheet, config: LogConfig, kind: str, says: Sequence[Described], alone: bool
) -> list[int]:
    """The positions of a triad's columns, x, y and z. A table of one triad alone may call them just
    that."""
    names, usual = _given(config, kind), _USUAL[kind]
    if config.columns is not None:
        return named(sheet, "log.columns", names)
    key = f"log.{kind}_columns"
    if names != list(usual) or set(usual) & set(sheet.names):
        return named(sheet, key, names)
    if alone and not any(own.kind in _USUAL for own in says) and set("xyz") <= set(sheet.names):
        return named(sheet, key, "xyz")
    return [_described(sheet, key, kind, i, says, alone) for i in range(3)]


def _described(
    sheet: Sheet, key: str, kind: str, at: int, says: Sequence[Described], alone: bool
) -> int:
    """The position of the one column whose name means this sensor (gyro or accel) and axis."""
    name, axis = _USUAL[kind][at], "xyz"[at]
    found = [at for at, own in enumerate(says) if (own.kind, own.axis) == (kind, axis)]
    if len(found) == 1:
        return found[0]
    if not found:
        other = not alone and any(own.kind in _USUAL and own.kind != kind for own in says)
        hint = f"; {key}={NONE} where that triad was not recorded: the other's noise can be fitted"
        about = f"is no column of {sheet.file}; {_has(sheet)}{hint if other else ''}"
        raise InputError(key, name, "", about)
    which = ", ".join(shown(sheet.names[at]) for at in found)
    raise InputError(
        key, name, "", f"is no column of {sheet.file}, and {which} could each be the {kind}'s "
        f"{axis}: give log.columns, six of them: gyro, accelerometer"
    )  # fmt: skip


def _time(sheet: Sheet, config: LogConfig, says: Sequence[Described]) -> tuple[int, ...]:
    """The positions of the time column or columns; empty where there is none."""
    given = config.time_column
    if given == NONE:
        return ()
    if given is not None:
        names = given if isinstance(given, list) else [given]
        return tuple(named(sheet, "log.time_column", names))
    pair = seconds_and_nanoseconds(sheet.names)
    if pair is not None:
        return pair
    found = [at for at, own in enumerate(says) if own.kind == "time"]
    with_unit = [at for at in found if says[at].unit is not None]
    if len(found) > 1 and len(with_unit) == 1:
        found = with_unit
    if len(found) > 1 and config.rate_hz is None:
        which = " or ".join(shown(sheet.names[at]) for at in found)
        about = f"must be given: {sheet.file} has several; give log.time_column={which}"
        raise InputError("log.time_column", None, "", about)
    return tuple(found) if len(found) == 1 else ()


def _common_unit(
    says: Sequence[Described | None], units: Sequence[str] | dict[str, Any]
) -> str | None:
    """The unit that all three columns' names state; None where they do not agree on one."""
    found = {own.unit for own in says if own is not None and own.unit in units}
    return found.pop() if len(found) == 1 and None not in says else None
