"""The content of log files before units and axes are converted: three readers, one result."""

import os
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from lbgc import outputs
from lbgc.data.logconfig import NONE, PLATE_UNITS, LogConfig
from lbgc.data.readers.blocks import blocks
from lbgc.data.readers.clock import Said
from lbgc.data.readers.column_names import described, unit
from lbgc.data.readers.formats import files
from lbgc.data.readers.picked import Picked, named, picked
from lbgc.data.readers.rows import of_one_sensor, rows_key, with_values, within
from lbgc.data.readers.sheets import Sheet, shown
from lbgc.data.readers.texts import require_size, sheet
from lbgc.data.readers.timing import stamps_of
from lbgc.errors import InputError, reading, require

_NONSENSE = 1e30
"""Absolute value from which on a number is refused."""
_HOTTEST = 1000.0
"""Size from which on a number is no temperature of a sensor, degrees Celsius or kelvin."""
_MS, _G, _SCALES = (1e-3, 1e6), (1.0, 100.0), (1e-9, 1e9)
"""Bounds of a PSINS header's interval (ms), g (m/s^2), and arcsec or ug s a count."""
_HEADING_IN_NAME = re.compile(r"_(-?\d+(?:\.\d+)?)$")
"""A heading in degrees at the end of a file's name, such as `x_40`."""


@dataclass(frozen=True)
class Raw:
    """One recording as its file has it: along the sensor's own axes, in the configuration's
    units."""

    name: str
    """The recording's name in messages"""
    gyro: np.ndarray
    """(T, 3), as printed; (T, 0) where no gyros were recorded"""
    accel: np.ndarray
    """(T, 3), as printed, likewise"""
    config: LogConfig
    """The configuration, completed by the file's header or name."""
    stamps: np.ndarray | None = None
    """(T,), time stamps, in a unit that `said` may state; int64 where exact."""
    said: Said = field(default_factory=lambda: Said("auto"))
    """What is stated of the clock"""
    time_is_said: bool = False
    """Whether the user named the time column."""
    temperature: np.ndarray | None = None
    """(T,), K or degrees Celsius; None where no column of it was named"""
    gravity: float | None = None
    """The value of g that this file's units use, m/s^2; None where it states none."""
    notes: tuple[str, ...] = ()
    """What was noticed while reading, plain sentences"""
    plate: np.ndarray | None = None
    """(T,), the plate's angle as its column prints it, in `config.plate_unit`"""
    heading: np.ndarray | None = None
    """(T,), the reference heading of the forward axis as its column prints it, degrees"""


def find(path: str) -> Path:
    """The place of a log: the path itself or, for a relative path that is not there, the path under
    $LBGC_REAL_LOGS. Raises InputError where it is in neither."""
    with reading("log.path", path):
        places = [Path(path).expanduser()]
        if "LBGC_REAL_LOGS" in os.environ and not places[0].is_absolute():
            places.append(Path(os.environ["LBGC_REAL_LOGS"]) / path)
        for place in places:
            if place.exists():
                return place
    looked = " or ".join(map(str, places))
    raise InputError(
        "log.path",
        path,
        "",
        f"is not at {looked}; give log.path=FILE, or set LBGC_REAL_LOGS to "
        "the directory of the recordings",
    )


def only_file(path: Path, named: object) -> Path:
    """The path, if it is that of a plain file. Raises InputError otherwise, since a device or a
    pipe may have no end. named : the path as the message shows it."""
    require(path.is_file(), "log.path", named, "is no file")
    return path


def _table(path: Path, config: LogConfig) -> Iterator[Raw]:
    """The reader `table`: the one recording in a file of columns, of any format that is read."""
    yield _of_table(path, config, config, config.recorded)


def _of_table(path: Path, opening: LogConfig, config: LogConfig, parts: Sequence[str]) -> Raw:
    """What a file holds of these triads. opening : by which the file's table is chosen."""
    place = path if files.is_bag_directory(path) else only_file(path, opening.path)
    with files.opened(place, opening) as own:
        return of_sheet(own, outputs.shown(path.stem), config, parts)


def triads_apart(config: LogConfig) -> tuple[Raw, Raw]:
    """The gyros and the accelerometers of one recording, each from its own file or table. Columns
    that stand beside the sensors' are read with the gyros."""
    first, second = (
        _of_table(find(str(own.path)), own, replace(config, **_beside(own)), own.recorded)
        for own in each_triad(config)
    )
    return first, second


def each_triad(config: LogConfig) -> tuple[LogConfig, LogConfig]:
    """The description of the gyros' file or table, and that of the accelerometers'."""
    gyro = replace(config, accel_path=None, accel_table=None, accel_columns=NONE,
                   accel_time_column=None, accel_late_s=0.0, accel_rows=None)  # fmt: skip
    path = config.path if config.accel_path is None else config.accel_path
    own_time = config.accel_time_column
    accel = replace(
        gyro,
        path=path,
        table=config.accel_table or config.table,
        time_column=config.time_column if own_time is None else own_time,
        gyro_columns=NONE,
        accel_columns=config.accel_columns,
        plate_column=None,
        heading_column=None,
        temperature_column=None,
    )
    return gyro, accel


def _beside(config: LogConfig) -> dict[str, Any]:
    """The keys of the columns that a table of one triad is read with beside its own."""
    keys = ("time_column", "plate_column", "heading_column", "temperature_column")
    return {key: getattr(config, key) for key in keys}


def is_of_headings(path: Path) -> bool:
    """Whether a directory holds CSV files alone whose names end with headings."""
    every = outputs.listed(path, "*")
    return bool(every) and all(
        own.suffix == ".csv" and _HEADING_IN_NAME.search(own.stem) is not None for own in every
    )


def _recordings(path: Path, config: LogConfig) -> Iterator[Raw]:
    """The reader `recordings`, for the published layout: one CSV file a recording, with the heading
    in whole degrees at the end of its name."""
    every = outputs.listed(path, "*.csv") if path.is_dir() else [path]
    require(bool(every), "log.path", path, "holds no CSV files")
    for file in every:
        with reading("log.path", file):
            within = file == path or file.resolve().parent == path.resolve()
        require(within, "log.path", file, "is a link that leads out of the directory")
        found = _HEADING_IN_NAME.search(file.stem)
        heading = config.heading_deg
        if heading is None and found:
            heading = float(found[1])
        own = sheet(only_file(file, file))
        yield of_sheet(own, outputs.shown(file.name), replace(config, heading_deg=heading))


def of_sheet(own: Sheet, name: str, config: LogConfig, parts: Sequence[str] | None = None) -> Raw:
    """The recording in a sheet of named columns. parts : the triads that it has; None: all that
    were recorded."""
    which = picked(own, config, parts)
    of_rows = rows_key(config.recorded if parts is None else parts)
    marks = getattr(config, of_rows)
    marked = [] if marks is None else named(own, f"log.{of_rows}", marks[:1])
    beside = {
        key: named(own, f"log.{key}", [getattr(config, key)])[0]
        for key in ("plate_column", "heading_column", "temperature_column")
        if getattr(config, key) is not None
    }
    key = "log.columns" if config.columns is not None else None
    keys = dict.fromkeys(which.gyro, key or "log.gyro_columns")
    keys |= dict.fromkeys(which.accel, key or "log.accel_columns")
    (gyro, accel), values, notes = own.together(
        [which.gyro, which.accel], [*which.time, *beside.values(), *marked],
        lambda at, column: _numbers(own, keys[at], at, column),
    )  # fmt: skip
    (gyro, accel, *values), left_out = within(config.rows, [gyro, accel, *values], own.file)
    notes += left_out
    if marked:
        gyro, accel, *values = of_one_sensor([gyro, accel, *values], own.file, of_rows, marks)
    times = values[: len(which.time)]
    angles = {
        own_key: _numbers(own, f"log.{own_key}", at, column)
        for (own_key, at), column in zip(beside.items(), values[len(which.time) :], strict=False)
    }
    warmth = angles.pop("temperature_column", None)  # which may lack some values
    kept = with_values(gyro, accel, bool(which.time))
    if kept is not None:
        without = len(kept) - int(kept.sum())
        notes.append(f"rows: {without} of {name} have no value of the sensors and were left out")
        gyro, accel, times = gyro[kept], accel[kept], [own[kept] for own in times]
        angles = {own_key: column[kept] for own_key, column in angles.items()}
        warmth = None if warmth is None else warmth[kept]
    config = _with_units(which, config, name)
    for own_key, column in angles.items():
        require_finite(name, column[:, None], [own_key.removesuffix("_column")])
    if "plate_column" in beside:
        config = _with_plate_unit(own, beside["plate_column"], config, name)
    if not which.time and config.rate_hz is None and own.rate_hz is not None:
        notes.append(f"rate: {name}'s comments state {own.rate_hz:g} Hz, which was taken")
        config = replace(config, rate_hz=own.rate_hz)
    plate, heading = angles.get("plate_column"), angles.get("heading_column")
    raw = Raw(name, gyro, accel, config, notes=tuple(notes), plate=plate, heading=heading,
              temperature=None if warmth is None else temperatures(warmth))  # fmt: skip
    if not which.time:
        return raw
    try:
        stamps = stamps_of(which.time_name, times)
    except InputError as error:
        if which.time_is_said or config.rate_hz is None:
            raise
        return replace(raw, notes=(*notes, f"time: not used, since {error.value} {error.choices}"))
    exact = len(times) == 2 or times[0].dtype.kind in "mMO"
    require_finite(name, stamps[:, None], ["time"])
    said = Said(
        "auto" if times[0].dtype.kind in "mMO" else config.time_unit,
        "ns" if exact else which.time_unit,
        config.rate_hz or own.rate_hz,
        float(stamps[0]),
    )
    return replace(raw, stamps=stamps, said=said, time_is_said=which.time_is_said)


def temperatures(values: np.ndarray) -> np.ndarray:
    """A temperature column, (T,), with a value in each row: rows without one, and nonsense, are
    filled on a straight line. Raises InputError where fewer than two rows have one."""
    good = np.abs(values) < _HOTTEST
    about = "has no two temperatures, in degrees Celsius or kelvin"
    require(good.sum() > 1, "log.temperature_column", f"{good.sum()} values", about)
    rows = np.arange(len(values))
    return np.asarray(np.interp(rows, rows[good], values[good]))


def _numbers(own: Sheet, key: str, at: int, values: np.ndarray) -> np.ndarray:
    """A column's values as float64. Raises InputError where they are not numbers."""
    if values.dtype.kind in "fi":
        return np.asarray(values, np.float64)
    held = "dates" if values.dtype.kind in "mM" else "string"
    name = shown(own.names[at]) or at + 1
    raise InputError(key, name, "", f"of {own.file} holds {held}, not numbers")


def _with_units(which: Picked, config: LogConfig, name: str) -> LogConfig:
    """The configuration with the units that the columns' names state, where it says auto. Raises
    InputError where the configuration and the names contradict each other."""
    units = {"gyro_unit": config.gyro_unit, "accel_unit": config.accel_unit}
    for key, says, scale in (
        ("gyro_unit", which.gyro_unit, config.each("gyro", "scale")),
        ("accel_unit", which.accel_unit, config.each("accel", "scale")),
    ):
        given = units[key]
        if given == "auto":
            fallback = "deg/s" if key == "gyro_unit" else "auto"
            about = f"must be given: {name}'s columns do not say it, and no accelerometers were "
            about += "recorded by whose vertical it could be checked"
            unchecked = key == "gyro_unit" and says is None and config.recorded == ("gyro",)
            require(not unchecked, f"log.{key}", given, about)
            units[key] = says or fallback
        elif says is not None and says != given and np.all(np.abs(scale) == 1):
            raise InputError(
                f"log.{key}", given, "", f"but {name}'s columns say {says}: log.{key}={says} goes "
                "by them, log.columns=[...] by position takes no notice of them"
            )  # fmt: skip
    return replace(config, gyro_unit=units["gyro_unit"], accel_unit=units["accel_unit"])


def _with_plate_unit(own: Sheet, at: int, config: LogConfig, name: str) -> LogConfig:
    """The configuration with the unit of the plate's angle that its column's name states, where it
    says auto. Raises InputError where the two contradict each other."""
    says = plate_unit(own, at)
    if config.plate_unit == "auto":
        return replace(config, plate_unit=says or "deg")
    agrees = says in (None, config.plate_unit) or config.plate_scale not in (1.0, -1.0)
    about = f"but {name}'s column says {says}: log.plate_unit=auto goes by it"
    require(agrees, "log.plate_unit", config.plate_unit, about)
    return config


def plate_unit(own: Sheet, at: int) -> str | None:
    """The unit of an angle that a column's name states, or the row beneath it; None for neither."""
    units = own.units[at] if at < len(own.units) else ""
    says = described(own.names[at], units).unit or unit(own.names[at].rsplit("_", 1)[-1])
    return says if says in PLATE_UNITS else None


def columns(path: str, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Read named columns of a file of any format, and those of the optional ones that it has: (T,)
    each, float64, all finite. Raises InputError where the file or a column cannot be read."""

    def which(own: Sheet) -> dict[str, int]:
        wanted = [*names, *(name for name in optional if name in own.names)]
        return dict(zip(wanted, named(own, "columns", wanted), strict=True))

    with files.opened(only_file(find(path), path), LogConfig(path=path), which) as own:
        places = which(own)
        values, _ = own.columns(list(places.values()))
    found = {
        name: _numbers(own, "columns", at, column)
        for (name, at), column in zip(places.items(), values, strict=True)
    }
    for name, column in found.items():
        require_finite(own.file, column[:, None], [name])
    return found


def _psins(path: Path, config: LogConfig) -> Iterator[Raw]:
    """The reader `psins`, for PSINS files: comments, three header rows of six numbers, and then
    integer increments.

    The header rows are: attitude (deg; yaw counter-clockwise) and velocity; latitude, longitude
    (deg), height, t0, interval (ms), g (m/s^2); and for each axis arcsec and ug s a count.
    """
    # The file is opened here, because NumPy decompresses by the ending of a path.
    with (
        reading("log.path", path, "is no PSINS file"),
        only_file(path, path).open() as file,
        warnings.catch_warnings(),
    ):
        require_size(path, "log.path")
        warnings.simplefilter("error")  # NumPy only warns of an empty file
        rows = np.loadtxt(file, comments="%", ndmin=2)
    require(
        rows.shape[0] > 3 and rows.shape[1] == 6,
        "log.path",
        path,
        "is no PSINS file: it "
        f"must have three header rows and then data, six numbers each, not {rows.shape}",
    )
    require_finite(
        outputs.shown(path.name), rows, [f"number {column} of six" for column in range(1, 7)]
    )
    attitude, place, scales = rows[:3]
    good = _MS[0] <= place[4] <= _MS[1] and _G[0] <= place[5] <= _G[1]
    good = good and bool(((scales >= _SCALES[0]) & (scales <= _SCALES[1])).all())
    require(good, "log.path", path, "has a header without interval, g or scale factors")
    config = replace(
        config,
        gyro_unit="arcsec",
        accel_unit="ug*s",
        rate_hz=config.rate_hz if config.rate_hz is not None else 1e3 / float(place[4]),
        latitude=config.latitude if config.latitude is not None else place[0],
        heading_deg=config.heading_deg if config.heading_deg is not None else -attitude[2],
    )
    counts = rows[3:]
    yield Raw(
        outputs.shown(path.name),
        counts[:, :3] * scales[:3],
        counts[:, 3:] * scales[3:],
        config,
        gravity=float(place[5]),
    )


READERS: dict[str, Callable[[Path, LogConfig], Iterator[Raw]]] = {
    "table": _table,
    "recordings": _recordings,
    "psins": _psins,
}


def require_finite(
    name: str, values: np.ndarray, columns: Sequence[str], pieces: Sequence[slice] | None = None
) -> None:
    """Raise InputError unless all values (rows, columns) in these pieces, or in all rows, are
    finite and below 1e30, so that no sum of them can overflow."""
    few = [
        slice(piece.start + own.start, piece.start + own.stop)
        for piece in pieces or [slice(0, len(values))]
        for own in blocks(piece.stop - piece.start)
    ]
    bad = [
        np.argwhere(~(np.abs(values[own]) < _NONSENSE)) + np.array([own.start, 0]) for own in few
    ]
    if sum(map(len, bad)):
        row, column = np.concatenate(bad)[0]
        value = values[row, column]
        what = "is more than anything measures" if np.isfinite(value) else "is not a number"
        where = f"{name}: {columns[column]} in row {row}"
        raise InputError(where, value, "", f"{what} ({sum(map(len, bad))} such values)")
