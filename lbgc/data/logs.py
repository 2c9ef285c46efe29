"""Conversion of real logs to records, which from then on are treated like simulated ones."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from lbgc.data.checks import all_checks
from lbgc.data.logconfig import LogConfig
from lbgc.data.positions import at_positions, held, joined
from lbgc.data.readers.axes import matrix_of
from lbgc.data.readers.raw import READERS, Raw, columns, find, require_finite
from lbgc.data.readers.repeats import sampled, without_printed_twice
from lbgc.data.readers.timing import EvenPieces, timing
from lbgc.data.record import Record
from lbgc.data.rests import without_flicker
from lbgc.errors import InputError, require
from lbgc.sensor.imu import ImuModel
from lbgc.units import DEG, STANDARD_GRAVITY, force_factor, rate_factor

_UNITS_OF_G = ("g", "mg", "g*s", "ug*s")
"""Units that depend on the value of g that a file states."""
_UNEVEN_DEG = 5.0
"""Largest scatter of a reference instrument's headings, degrees, about one that turns with the
plate."""


def read(
    config: LogConfig,
    imu: ImuModel | None = None,
    north: bool = True,
    tumbles: bool = False,
) -> Iterator[Record]:
    """Read a log's recordings and check them. Raises InputError where the log is refused.

    imu : the sensor's error model, where it is known; north : whether the heading is asked for.
    Where it is not (the noise is fitted, the sensor calibrated), faults that matter only to a
    heading become notes. tumbles : whether the IMU was held in several attitudes, without a plate,
    as it is where `config.poses` lists them.
    """
    tumbles = tumbles or config.poses is not None
    for key in ("plate_column", "positions", "angles_deg") if tumbles else ():
        about = "says how a plate turns; estimator=tumble is for an IMU in a hand, without one"
        require(getattr(config, key) is None, f"log.{key}", getattr(config, key), about)
    if config.angles_deg is not None:
        records = [_of_files(config, imu)]
    else:
        records = [
            (record, raw.config)
            for file in config.files
            for raw in READERS[config.reader](find(file), replace(config, path=file))
            for record in _records(raw)
        ]
    if tumbles:
        records = [(held(record, own), own) for record, own in records]
    found = [all_checks.checked(record, own, imu, north) for record, own in records]
    yield from all_checks.together(_told_apart(found), config, north)


def _of_files(config: LogConfig, imu: ImuModel | None) -> tuple[Record, LogConfig]:
    """The one recording whose positions are files of their own, and its configuration. Raises
    InputError where a file holds several recordings, or cannot be one of this recording's."""
    records, raws = [], []
    for path in config.files:
        own = replace(config, path=path, angles_deg=None, gap_s=None)
        read_from = list(READERS[config.reader](find(path), own))
        pieces = [record for raw in read_from for record in _records(raw)]
        require(len(pieces) == 1, "log.path", path, "holds several recordings, not one position")
        records += pieces
        raws += read_from
    return joined(records, raws, config, imu), replace(raws[0].config, angles_deg=None)


def _told_apart(records: Iterable[Record]) -> list[Record]:
    """Records of which no two have one name: a second one's has its number behind it."""
    found: dict[str, Record] = {}
    for record in records:
        name, number = record.name, 2
        while name in found:
            name, number = f"{record.name} ({number})", number + 1
        found[name] = record if name == record.name else replace(record, name=name)
    return list(found.values())


def _records(raw: Raw) -> Iterator[Record]:
    """The records of a file, in SI and forward-right-down, one for each evenly sampled piece."""
    require(len(raw.gyro) > 1, raw.name, f"{len(raw.gyro)} samples", "is no recording")
    for key, values in (("gyro", raw.gyro), ("accel", raw.accel)):
        require_finite(raw.name, values, [f"{key} {axis}" for axis in "xyz"])
    raw = without_printed_twice(raw)
    clock = clock_of(raw)
    rows = np.empty((len(raw.gyro), 6))  # row by row, whatever the file's order is
    rows[:, :3], rows[:, 3:] = raw.gyro, raw.accel
    pieces = _within(clock, raw.config, raw.name)
    for key in ("positions", "poses"):
        listed = getattr(raw.config, key)
        whole = listed is None or pieces == [slice(0, len(rows))]
        about = f"is for {raw.name} from its first sample to its last, in one piece"
        require(whole, f"log.{key}", listed, about)
    for number, piece in enumerate(pieces, start=1):
        name = raw.name if len(pieces) == 1 else f"{raw.name} part {number}"
        values, rate, notes = sampled(name, rows[piece], clock.rate_hz, raw.config.repeats)
        own = replace(
            raw,
            name=name,
            gyro=values[:, :3],
            accel=values[:, 3:],
            plate=_beside(raw.plate, piece, len(values)),
            heading=_beside(raw.heading, piece, len(values)),
            temperature=_beside(raw.temperature, piece, len(values)),
        )
        record = _record(own, rate, (*raw.notes, *clock.notes, *notes))
        yield record if raw.config.positions is None else at_positions(record, raw.config)


def _beside(column: np.ndarray | None, piece: slice, samples: int) -> np.ndarray | None:
    """The values, (samples,), of a column beside the sensors' at the ends of a piece's samples,
    which may be held for several rows."""
    if column is None:
        return None
    own = column[piece]
    ends = np.round(np.arange(1, samples + 1) * (len(own) / samples)).astype(int) - 1
    return np.asarray(own[np.clip(ends, 0, len(own) - 1)])


def _within(clock: EvenPieces, config: LogConfig, name: str) -> list[slice]:
    """The pieces' rows between the times that the configuration has."""
    first = round(config.from_s * clock.rate_hz)
    last = math.inf if config.to_s is None else round(config.to_s * clock.rate_hz)
    cut = [slice(max(p.start, first), int(min(p.stop, last))) for p in clock.pieces]
    kept = [piece for piece in cut if piece.stop - piece.start > 1]
    end = max(piece.stop for piece in clock.pieces) / clock.rate_hz
    about = f"leaves nothing of {name}, which ends at {end:g} s"
    require(bool(kept), "log.from_s", config.from_s, about)
    return kept


def clock_of(raw: Raw) -> EvenPieces:
    """The log's rate and pieces by its time stamps, or by the stated rate where it has none."""
    stated = raw.config.rate_hz
    if raw.stamps is None:
        require(
            stated is not None, "log.rate_hz", None, "must be given: the log has no time, or no "
            "column that its name tells (log.time_column)"
        )  # fmt: skip
        assert stated is not None
        return EvenPieces(stated, (slice(0, len(raw.gyro)),))
    try:
        return timing(raw.name, raw.stamps, raw.said, stated, raw.config.gaps)
    except InputError as error:
        if raw.time_is_said or stated is None or error.name != "log.time_unit":
            raise
        whole = (slice(0, len(raw.gyro)),)
        return EvenPieces(stated, whole, (f"time: not used, since {error.choices}",))


def _record(raw: Raw, rate: float, notes: tuple[str, ...]) -> Record:
    """The record of one piece at this rate, Hz, its units and axes converted."""
    config = raw.config
    require(config.latitude is not None, "log.latitude", None, "must be given for this log")
    assert config.latitude is not None
    for key, column in (("plate_column", raw.plate), ("heading_column", raw.heading)):
        given = getattr(config, key)
        about = f"is not read from {raw.name}: log.reader={config.reader} has no further columns"
        require(given is None or column is not None, f"log.{key}", given, about)
    gyro = raw.gyro * config.gyro_scale * rate_factor(config.gyro_unit, rate)
    accel = _forces(raw, rate)
    angle = np.zeros(len(gyro))
    if raw.plate is not None:
        factor = 1.0 if config.plate_unit == "rad" else DEG
        angle = np.unwrap(raw.plate * (config.plate_scale * factor))
    sigma = config.heading_sigma_deg
    record = Record(
        name=raw.name,
        gyro=gyro @ matrix_of(config.axes).T,
        accel=accel @ matrix_of(config.axes_of_accel).T,
        plate_angle=angle,
        rate_hz=rate,
        latitude=config.latitude * DEG,
        heading_reference=_reference(raw, angle),
        reference_sigma=None if sigma is None else sigma * DEG,
        unit=config.unit,
        session=config.session,
        temperature=raw.temperature,
        notes=notes,
    )
    return record if raw.plate is None else without_flicker(record)


def _reference(raw: Raw, angle: np.ndarray) -> float | None:
    """The reference heading where the plate's angle is zero, rad: the stated one, or the circular
    mean of the column's less the angle, (T,), rad. Raises InputError where the column does not turn
    with the plate."""
    config = raw.config
    if raw.heading is None:
        return None if config.heading_deg is None else config.heading_deg * DEG
    at_zero = np.exp(1j * (raw.heading * DEG - angle))
    mean = float(np.angle(at_zero.mean()))
    off = float(np.sqrt(np.mean(np.angle(at_zero * np.exp(-1j * mean)) ** 2))) / DEG
    if off > _UNEVEN_DEG:
        raise InputError(
            "log.heading_column", config.heading_column, "", f"differs by {off:.3g} deg RMS from "
            f"one heading of {raw.name} that turns with the plate: its unit is degrees, clockwise "
            "from north; or the plate's angle is wrong"
        )  # fmt: skip
    return mean


def _forces(raw: Raw, rate_hz: float) -> np.ndarray:
    """Specific forces in m/s^2. The unit "auto" is g where the median of their sizes is below 3,
    else m/s2: their mean is small where the IMU is held in opposite attitudes."""
    values, unit = raw.accel * raw.config.accel_scale, raw.config.accel_unit
    if unit == "auto":
        unit = "g" if np.median(np.linalg.norm(values, axis=1)) < 3 else "m/s2"
    factor = force_factor(unit, rate_hz)
    if raw.gravity is not None and unit in _UNITS_OF_G:
        factor *= raw.gravity / STANDARD_GRAVITY
    return values * factor


__all__ = ["LogConfig", "columns", "read"]
