"""Real logs become records here; after that nobody can tell them from simulated ones."""

import os
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lbgc.data import tables
from lbgc.data.axes import matrix_of
from lbgc.data.logconfig import ACCEL_UNITS, GYRO_UNITS, LogConfig
from lbgc.data.record import Record
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.errors import InputError, reading, require
from lbgc.sensor.imu import ImuModel
from lbgc.units import (
    ANGLE_UNITS,
    DEG,
    FORCE_UNITS,
    HOUR,
    RATE_UNITS,
    STANDARD_GRAVITY,
    VELOCITY_UNITS,
)

_UNITS_OF_G = ("g", "mg", "g*s", "ug*s")
_NONSENSE = 1e30
_MS, _G, _SCALES = (1e-3, 1e6), (1.0, 100.0), (1e-9, 1e9)
"""Of a PSINS header: interval, m/s^2, and arcsec or ug s a count."""
_HEADING_IN_NAME = re.compile(r"_(-?\d+(?:\.\d+)?)$")


@dataclass(frozen=True)
class _Raw:
    """What a file says: the sensor's own axes, SI after `gyro_si` and `accel_si`."""

    name: str
    gyro: np.ndarray  # (T, 3), as printed
    accel: np.ndarray  # (T, 3), as printed
    time: np.ndarray | None  # (T,), s
    config: LogConfig  # with what the file's header or name added
    gravity: float | None = None  # m/s^2: the unit g as this file means it


def read(config: LogConfig, imu: ImuModel | None = None, north: bool = True) -> Iterator[Record]:
    """The log's recordings. Raises InputError for whatever is wrong with it.

    imu : what is stated of the sensor, where anything is; north : whether the heading is asked
    for. Where it is not (the noise is fitted, the sensor calibrated), what only a heading needs is
    noted, not refused.
    """
    path = _find(config.path)
    for raw in _READERS[config.reader](path, config):
        yield _checked(_record(raw), config, imu, north)


def _checked(record: Record, config: LogConfig, imu: ImuModel | None, north: bool) -> Record:
    """The one place where a record is held against physics, after it was read."""
    return record


def columns(path: str, names: Sequence[str], optional: Sequence[str] = ()) -> np.ndarray:
    """These columns of a CSV or Parquet file, and those of the optional ones that it has: finite
    float (rows, columns). Raises InputError."""
    file = _only_file(_find(path), path)
    table = tables.read(file, "file")
    found = [name for name in optional if name in table.column_names]
    values = tables.columns(table, "columns", [*names, *found], file.stem)
    _require_finite(file.name, values, [*names, *found])
    return values


def _find(path: str) -> Path:
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


def _only_file(path: Path, named: str | Path) -> Path:
    """Of a device or a pipe there may be no end."""
    require(path.is_file(), "log.path", named, "is no file")
    return path


def _table(path: Path, config: LogConfig) -> Iterator[_Raw]:
    yield _from_table(tables.read(_only_file(path, config.path)), path.stem, config)


def _recordings(path: Path, config: LogConfig) -> Iterator[_Raw]:
    """The published layout: one CSV a recording, the heading in whole degrees in its name."""
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    require(bool(files), "log.path", path, "holds no CSV files")
    for file in files:
        with reading("log.path", file):
            within = file == path or file.resolve().parent == path.resolve()
        require(within, "log.path", file, "is a link that leads out of the directory")
        found = _HEADING_IN_NAME.search(file.stem)
        heading = config.heading_deg
        if heading is None and found:
            heading = float(found[1])
        table = tables.read(_only_file(file, file))
        yield _from_table(table, file.name, replace(config, heading_deg=heading))


def _from_table(table: tables.Table, name: str, config: LogConfig) -> _Raw:
    time = None
    if config.time_column:
        time = tables.columns(table, "log.time_column", [config.time_column], name)[:, 0]
    gyro = tables.columns(table, "log.gyro_columns", config.gyro_columns, name)
    accel = tables.columns(table, "log.accel_columns", config.accel_columns, name)
    return _Raw(name, gyro, accel, time, config)


def _psins(path: Path, config: LogConfig) -> Iterator[_Raw]:
    """PSINS: comments, three header rows of six, then integer increments.

    Rows: attitude (deg; yaw counter-clockwise) and velocity; latitude, longitude (deg), height,
    t0, interval (ms), g (m/s^2); arcsec and ug s a count, an axis.
    """
    # Opened here: given a path, NumPy unpacks what it ends in.
    with (
        reading("log.path", path, "is no PSINS file"),
        _only_file(path, path).open() as file,
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("error")  # that there is nothing in it
        rows = np.loadtxt(file, comments="%", ndmin=2)
    require(
        rows.shape[0] > 3 and rows.shape[1] == 6,
        "log.path",
        path,
        "is no PSINS file: it "
        f"must have three header rows and then data, six numbers each, not {rows.shape}",
    )
    _require_finite(path.name, rows, [f"number {column} of six" for column in range(1, 7)])
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
    yield _Raw(
        path.name,
        counts[:, :3] * scales[:3],
        counts[:, 3:] * scales[3:],
        None,
        config,
        gravity=float(place[5]),
    )


_READERS = {"table": _table, "recordings": _recordings, "psins": _psins}


def _record(raw: _Raw) -> Record:
    """To SI, to forward-right-down, and through every check."""
    config = raw.config
    require(len(raw.gyro) > 1, raw.name, f"{len(raw.gyro)} samples", "is no recording")
    for key, values in (("gyro", raw.gyro), ("accel", raw.accel)):
        _require_finite(raw.name, values, [f"{key} {axis}" for axis in "xyz"])
    rate = _rate(raw)
    require(config.latitude is not None, "log.latitude", None, "must be given for this log")
    assert config.latitude is not None
    gyro = _rates(raw.gyro * config.gyro_scale, config.gyro_unit, rate)
    accel, accel_unit = _forces(raw, rate)
    _check_resting_force(raw, accel, accel_unit, rate)
    _check_mean_rate(raw, gyro, rate)
    accel_axes = config.axes if config.accel_axes is None else config.accel_axes
    heading = None if config.heading_deg is None else config.heading_deg * DEG
    return Record(
        name=raw.name,
        gyro=gyro @ matrix_of(config.axes).T,
        accel=accel @ matrix_of(accel_axes).T,
        plate_angle=np.zeros(len(gyro)),
        rate_hz=rate,
        latitude=config.latitude * DEG,
        heading_reference=heading,
    )


def _require_finite(name: str, values: np.ndarray, columns: Sequence[str]) -> None:
    """values : (rows, columns). So large ones are refused that no sum of them can overflow."""
    bad = np.argwhere(~(np.abs(values) < _NONSENSE))
    if len(bad):
        row, column = bad[0]
        value = values[row, column]
        what = "is more than anything measures" if np.isfinite(value) else "is not a number"
        where = f"{name}: {columns[column]} in row {row}"
        raise InputError(where, value, "", f"{what} ({len(bad)} such values)")


def _rate(raw: _Raw) -> float:
    """Samples a second, checked against the time column where there is one."""
    stated = raw.config.rate_hz
    if raw.time is None:
        require(stated is not None, "log.rate_hz", None, "must be given: the log has no time")
        assert stated is not None
        return stated
    _require_finite(raw.name, raw.time[:, None], ["time"])
    steps = np.diff(raw.time)
    backward = np.flatnonzero(steps <= 0)
    if len(backward):
        at = backward[0]
        raise InputError(
            f"{raw.name}: time in row {at + 1}",
            raw.time[at + 1],
            "s",
            f"does not increase: {raw.time[at]} s stands before it",
        )
    dt = float(np.median(steps))
    gaps = np.flatnonzero(steps > 1.5 * dt)
    if len(gaps):
        raise InputError(
            f"{raw.name}: time after row {gaps[0]}",
            raw.time[gaps[0]],
            "s",
            f"a gap of {steps[gaps[0]]:.4g} s where samples are {dt:.4g} s apart "
            f"({len(gaps)} gaps); cut the log there",
        )
    # The mean step, since a time column is often rounded; the median only told gaps.
    measured = len(steps) / float(raw.time[-1] - raw.time[0])
    require(np.isfinite(measured), f"{raw.name}: time", f"{len(steps)} steps", "take no time")
    if stated is None:
        return measured
    agrees = abs(measured / stated - 1) < 0.01
    require(agrees, "log.rate_hz", stated, f"but {raw.name}'s time says {measured:.5g} Hz")
    return stated


def _rates(values: np.ndarray, unit: str, rate_hz: float) -> np.ndarray:
    return values * RATE_UNITS[unit] if unit in RATE_UNITS else values * ANGLE_UNITS[unit] * rate_hz


def _forces(raw: _Raw, rate_hz: float) -> tuple[np.ndarray, str]:
    values, unit = raw.accel * raw.config.accel_scale, raw.config.accel_unit
    if unit == "auto":
        unit = "g" if np.linalg.norm(values.mean(axis=0)) < 3 else "m/s2"
    return values * _accel_factor(unit, rate_hz, raw.gravity), unit


def _accel_factor(unit: str, rate_hz: float, gravity: float | None) -> float:
    factor = FORCE_UNITS[unit] if unit in FORCE_UNITS else VELOCITY_UNITS[unit] * rate_hz
    if gravity is not None and unit in _UNITS_OF_G:
        factor *= gravity / STANDARD_GRAVITY
    return factor


def _check_resting_force(raw: _Raw, accel: np.ndarray, unit: str, rate_hz: float) -> None:
    assert raw.config.latitude is not None
    g = normal_gravity(raw.config.latitude * DEG)
    norm = float(np.linalg.norm(accel.mean(axis=0)))
    printed = norm / _accel_factor(unit, rate_hz, raw.gravity)
    would_fit = [
        u
        for u in ACCEL_UNITS
        if abs(printed * _accel_factor(u, rate_hz, raw.gravity) / g - 1) < 0.2
    ]
    if not abs(norm / g - 1) < 0.2:
        raise InputError(
            "log.accel_unit",
            unit,
            "",
            f"{raw.name} would rest at {norm:.4g} m/s2, not within 20% of g; {_fitting(would_fit)}",
        )


def _check_mean_rate(raw: _Raw, gyro: np.ndarray, rate_hz: float) -> None:
    limit = raw.config.bias_limit_deg_per_h
    unit = raw.config.gyro_unit
    earth = EARTH_RATE / DEG * HOUR

    def plausible(mean_si: float) -> bool:
        return abs(mean_si / DEG * HOUR - earth) <= limit

    mean = float(np.linalg.norm(gyro.mean(axis=0)))
    if not plausible(mean):
        one = _rates(np.ones(1), unit, rate_hz)[0]
        would_fit = [
            u for u in GYRO_UNITS if plausible(mean / one * _rates(np.ones(1), u, rate_hz)[0])
        ]
        raise InputError(
            "log.gyro_unit",
            unit,
            "",
            f"{raw.name}'s mean rate would be "
            f"{mean / DEG * HOUR:.4g} deg/h, Earth's is {earth:.4g} and the bias at "
            f"most {limit:g} (log.bias_limit_deg_per_h); {_fitting(would_fit)}",
        )


def _fitting(units: list[str]) -> str:
    if units:
        return "in " + " or ".join(units) + " it would make sense"
    return "no unit makes sense of it: is it at rest, and its scale right?"


__all__ = ["LogConfig", "columns", "read"]
