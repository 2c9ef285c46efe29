"""Conversion of real logs to records, which from then on are treated like simulated ones."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbgc.data import converted, two_clocks
from lbgc.data.checks import all_checks
from lbgc.data.checks.alone import alone_note, checked_alone
from lbgc.data.checks.moved import PLATE
from lbgc.data.logconfig import NONE, LogConfig
from lbgc.data.positions import at_positions, held, joined
from lbgc.data.readers.pieces import Piece, pieces_of, timed
from lbgc.data.readers.raw import READERS, Raw, columns, find, triads_apart
from lbgc.data.record import Record, TriadRecord
from lbgc.data.rests import without_flicker
from lbgc.errors import require
from lbgc.frames import AXES, DOWN
from lbgc.sensor.imu import ImuModel

_OF_A_TRIAD = (
    "name", "plate_angle", "rate_hz", "latitude", "heading_reference", "temperature", "notes"
)  # fmt: skip
"""Fields of a recording that that of one triad has as well."""
_SHARE = 0.1
"""The least length of a recording of two clocks, as a share of the longest."""


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
    yield from checked(unchecked(config, imu, tumbles), config, imu, north)


@dataclass(frozen=True)
class Recording:
    """A recording as it was read, before its checks."""

    record: Record
    config: LogConfig
    """The configuration, completed by the file's header or name"""
    apart: tuple[TriadRecord, ...] | None = None
    """The two triads on their own clocks, with the first of a file's recordings; None where there
    is one clock"""
    start_s: float = 0.0
    """Time, s, of its first sample's interval, as `LogConfig.from_s` counts; of two clocks alone"""


def unchecked(
    config: LogConfig, imu: ImuModel | None = None, tumbles: bool = False
) -> list[Recording]:
    """A log's recordings before anything was checked. Raises InputError where one triad alone was
    recorded, or where a plate's angles are stated of an IMU that was held in several attitudes.

    imu, tumbles : as of `read`.
    """
    for part in ("gyro", "accel"):
        key = f"{part}_columns"
        about = "leaves one triad: a heading and a calibration need gyros and accelerometers both; "
        about += "python lbgc/fit.py takes one alone"
        require(getattr(config, key) != NONE, f"log.{key}", NONE, about)
    tumbles = tumbles or config.poses is not None
    for key in ("plate_column", "positions", "angles_deg") if tumbles else ():
        about = "says how a plate turns; estimator=tumble is for an IMU in a hand, without one"
        require(getattr(config, key) is None, f"log.{key}", getattr(config, key), about)
    if config.angles_deg is not None:
        return [_of_files(config, imu)]
    found = [own for file in config.each_file for _, own in _of_file(file)]
    if not tumbles:
        return found
    return [replace(own, record=held(own.record, own.config)) for own in found]


def checked(
    found: Sequence[Recording],
    config: LogConfig,
    imu: ImuModel | None = None,
    north: bool = True,
) -> list[Record]:
    """The recordings that `unchecked` gives, checked as `read` does."""
    placed = all(math.isfinite(own.record.latitude) or own.record.held is not None for own in found)
    require(placed or not north, "log.latitude", None, "must be given for this log")
    records = [all_checks.checked(own.record, own.config, imu, north) for own in found]
    return all_checks.together(_told_apart(records), config, north)


def read_noise(config: LogConfig) -> list[Sequence[Record] | Sequence[TriadRecord]]:
    """Read the recordings to which noise is fitted, in groups that have one clock each: both triads
    together, or each by itself where it is alone or has a clock of its own. They are checked as by
    `read`, where no heading is asked for. Raises InputError where the log is refused."""
    if len(config.recorded) == 1:
        alone = [
            checked_alone(record, raw.config)
            for file in config.each_file
            for raw in READERS[file.reader](find(str(file.path)), file)
            for record in _triad_records(raw)
        ]
        return [[replace(own, notes=(*own.notes, alone_note(own))) for own in alone]]
    found = unchecked(config)
    apart = [checked_alone(one, own.config) for own in found for one in own.apart or ()]
    records = checked(found, config, north=False)
    if not apart or any(np.ptp(record.plate_angle) > PLATE for record in records):
        return [records]  # a plate's turns are told by both
    one_clock = [own.record.name for own in found if own.apart is None]
    about = f"has one clock where {found[0].record.name} has two: fit them one by one"
    require(not one_clock, "log.path", ", ".join(one_clock), about)
    notes = dict.fromkeys(note for record in records for note in record.notes)
    apart[0] = replace(apart[0], notes=tuple(dict.fromkeys((*notes, *apart[0].notes))))
    return [[own for own in apart if own.part == part] for part in ("gyro", "accel")]


def _of_file(config: LogConfig) -> Iterator[tuple[Raw, Recording]]:
    """The recordings of one file, or of a pair of one triad each, and what each is from."""
    if config.accel_is_apart:
        gyro, accel = triads_apart(config)
        whole = two_clocks.in_rows(gyro, accel)
        raws: Iterable[Raw] = [] if whole is None else [whole]
        pairs = [(gyro, accel)] if whole is None else []
    else:
        raws, pairs = READERS[config.reader](find(str(config.path)), config), []
    for raw in raws:
        pair = two_clocks.interleaved(raw)
        if pair is not None:
            pairs.append(pair)
            continue
        for record in _records(raw):
            yield raw, Recording(record, raw.config)
    for pair in pairs:
        for own in of_two_clocks(*pair):
            yield pair[0], own


def _of_files(config: LogConfig, imu: ImuModel | None) -> Recording:
    """The one recording whose positions are files of their own. Raises InputError where a file
    holds several recordings, or cannot be one of this recording's."""
    records, raws = [], []
    plain = replace(config, angles_deg=None, gap_s=None, plate_axis=AXES[DOWN])
    for file in plain.each_file:
        pieces = list(_of_file(file))
        require(len(pieces) == 1, "log.path", file.path, "holds several recordings, not one "
                "position")  # fmt: skip
        ((raw, own),) = pieces
        about = f"must be given: {raw.name} has two clocks, whose stamps do not tell the time "
        about += "between its rests"
        require(own.apart is None or config.gap_s is not None, "log.gap_s", None, about)
        records.append(own.record)
        raws.append(raw)
    done = replace(raws[0].config, angles_deg=None)
    return Recording(joined(records, raws, config, imu), done)


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
    """The records of a file, in SI and forward-right-down, one for each evenly sampled piece. They
    take the place of `raw`, whose values are converted where they stand: a day has them once."""
    for own in pieces_of(*timed(raw)):
        fields = converted.fields_of(own.raw, own.rate_hz, own.notes)
        rates = converted.rates(own.raw, own.rate_hz)
        forces = converted.forces(own.raw, own.rate_hz)
        yield _positioned(Record(gyro=rates, accel=forces, **fields), raw)


def _positioned(record: Record, raw: Raw) -> Record:
    """The record with the plate's angle by its column or by its positions, if it has any."""
    record = record if raw.plate is None else without_flicker(record)
    return record if raw.config.positions is None else at_positions(record, raw.config)


def _triad_records(raw: Raw) -> Iterator[TriadRecord]:
    """The recordings of the one triad that was recorded, likewise."""
    about = "is for gyros and accelerometers both: noise of one triad is fitted to a log at rest"
    for key in ("positions", "poses", "angles_deg"):
        turned = getattr(raw.config, key)
        require(not turned, f"log.{key}", turned, about)
    for own in pieces_of(*timed(raw)):
        record = _of_a_triad(own, converted.fields_of(own.raw, own.rate_hz, own.notes))
        still = bool(np.ptp(record.plate_angle) < PLATE)
        require(still, "log.plate_column", raw.config.plate_column, f"turns in {own.raw.name}, and "
                "noise of one triad is fitted to a log at rest")  # fmt: skip
        yield record


def _of_a_triad(own: Piece, fields: Mapping[str, Any]) -> TriadRecord:
    """The recording of a piece's one triad, its values converted. fields : those of its record."""
    part = "gyro" if own.raw.gyro.shape[1] else "accel"
    values = (converted.rates if part == "gyro" else converted.forces)(own.raw, own.rate_hz)
    return TriadRecord(part, values, **{key: fields[key] for key in _OF_A_TRIAD})


def of_two_clocks(gyro: Raw, accel: Raw) -> Iterator[Recording]:
    """The recordings of two triads whose clocks differ, where they have the time in common; the
    triads on their own clocks with the first. Raises InputError where they have none."""
    both = [timed(gyro), timed(accel)]
    late = gyro.config.accel_late_s
    begun = [
        two_clocks.start(raw, clock, clock.pieces[0]) - by
        for (raw, clock), by in zip(both, (0.0, late), strict=True)
    ]
    gyros, accels = (
        [
            (own, two_clocks.start(raw, clock, own.rows) - by)
            for own in pieces_of(raw, clock, max(begun) - first, joins=False)
        ]
        for (raw, clock), by, first in zip(both, (0.0, late), begun, strict=True)
    )
    fields = [converted.fields_of(own.raw, own.rate_hz, own.notes) for own, _ in gyros]
    rates = [_of_a_triad(own, of) for (own, _), of in zip(gyros, fields, strict=True)]
    warmth = [
        (of["temperature"], own.rate_hz, at) for of, (own, at) in zip(fields, gyros, strict=True)
    ]
    forces = [
        replace(
            _of_a_triad(own, converted.fields_of(own.raw, own.rate_hz, own.notes)),
            temperature=two_clocks.temperature_of(len(own.raw.accel), own.rate_hz, at, warmth),
        )
        for own, at in accels
    ]
    found = [
        (two_clocks.on_one_clock(rate, of, at, force, when), max(at, when) - max(begun))
        for rate, of, (_, at) in zip(rates, fields, gyros, strict=True)
        for force, (_, when) in zip(forces, accels, strict=True)
    ]
    records = [(own, start) for own, start in found if own is not None]
    about = f"have no time in common: the accelerometers' stamps begin {begun[1] - begun[0]:.6g} s "
    about += "after the gyros'; log.accel_late_s=S subtracts S from them, log.accel_time_column "
    about += "names another clock"
    require(bool(records), "log.accel_path", f"{gyro.name} and {accel.name}", about)
    longest = max(own.duration_s for own, _ in records)
    kept = [(own, start) for own, start in records if own.duration_s >= _SHARE * longest]
    for number, (own, start) in enumerate(kept, start=1):
        name = own.name if len(kept) == 1 else f"{gyro.name} part {number}"
        record = _positioned(replace(own, name=name), gyro)
        apart = () if number > 1 else (*rates, *forces)
        yield Recording(record, gyro.config, apart, start)


__all__ = ["LogConfig", "checked", "columns", "of_two_clocks", "read", "read_noise", "unchecked"]
