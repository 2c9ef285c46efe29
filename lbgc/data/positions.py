"""Logs of several positions of a plate, where it stood in each, and what is between them; and logs
of several attitudes in which the IMU was held."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from lbgc import outputs
from lbgc.data.checks.felt import agrees, contradiction, turned_by
from lbgc.data.logconfig import LogConfig
from lbgc.data.readers.raw import Raw
from lbgc.data.record import Held, Record
from lbgc.errors import InputError, require
from lbgc.frames import AXES, wrap
from lbgc.sensor.imu import ImuModel
from lbgc.units import DEG

_SAME_RATE = 0.01
"""The relative difference up to which the rates of two files are one."""
_SHORTEST_S = 4.0
"""The shortest position, s: with less of it nothing is left to check beside a slew."""
_LONGEST_S = 86400.0
"""The longest time between two files, s, that their time stamps are believed."""


def at_positions(record: Record, config: LogConfig) -> Record:
    """A log with the plate's angle by its listed positions, and without what lies before the first
    and behind the last.

    Between two positions the plate turns as the gyro along its axis felt it, brought to the listed
    angles at both ends. Raises InputError where it felt another turn; where `config.accept` has
    that, the samples between are taken as not recorded.
    """
    assert config.positions is not None
    spans = [_span(record, own, "log.positions") for own in config.positions]
    angles = [own[2] * DEG for own in config.positions]
    begin, end = spans[0][0], spans[-1][1]
    gyro, accel, notes = record.gyro.copy(), record.accel.copy(), list(record.notes)
    angle = np.full(len(gyro), angles[0])
    at = angles[0]
    for (before, after), (last, this) in zip(pairwise(spans), pairwise(angles), strict=True):
        between = slice(before[1], after[0])
        rest = (gyro[slice(*before)].mean(axis=0) + gyro[slice(*after)].mean(axis=0)) / 2
        every = turned_by(gyro[between], rest, record.rate_hz)
        course, turns = every[:, record.axis], every[-1] if len(every) else np.zeros(3)
        felt = float(turns[record.axis])
        step = felt + float(wrap(this - last - felt))  # whole turns are the gyros' to tell
        if agrees(felt, step):
            share = course / felt if felt else np.zeros(len(course))
            angle[between] = at + step * share
            at += step
        else:
            when = between.start / record.rate_hz, between.stop / record.rate_hz
            value = [own[2] for own in config.positions]
            found = contradiction(
                record, "log.positions", value, when, turns, this - last, "negate the angles"
            )
            notes.append(found.settled(config.accept))
            gyro[between] = accel[between] = np.nan
            at += float(wrap(this - last))
            angle[between] = at
        angle[slice(*after)] = at
    left_out = begin, len(gyro) - end
    if any(left_out):
        notes.append(
            f"positions: {left_out[0] / record.rate_hz:.4g} s before the first and "
            f"{left_out[1] / record.rate_hz:.4g} s behind the last of {record.name} were left out"
        )
    whole = slice(begin, end)
    return replace(
        record, gyro=gyro[whole], accel=accel[whole], plate_angle=angle[whole], notes=tuple(notes)
    )


def held(record: Record, config: LogConfig) -> Record:
    """A log of an IMU that was held at rest in several attitudes, with those that are listed.
    Raises InputError where the log has no such samples."""
    listed = config.poses or []
    poses = tuple(_span(record, own, "log.poses") for own in listed)
    headings = tuple(own[2] * DEG for own in listed if len(own) == 3)
    return replace(record, held=Held(None, poses, headings), heading_reference=None)


def _span(record: Record, own: list[float], key: str) -> tuple[int, int]:
    """The first sample of a listed stretch, and the one behind its last. Raises InputError, naming
    `key`, where the log has no such samples."""
    start, stop = own[0] * record.rate_hz, own[1] * record.rate_hz
    first, last = int(np.ceil(start - 1e-3)), int(np.floor(stop + 1e-3))
    about = f"is not within the {record.duration_s:.6g} s that {record.name} lasts"
    require(last <= len(record.gyro), key, own, about)
    long = (last - first) / record.rate_hz > _SHORTEST_S - 0.01
    require(long, key, own, f"must last {_SHORTEST_S:g} s or more")
    return first, last


def joined(
    records: Sequence[Record], raws: Sequence[Raw], config: LogConfig, imu: ImuModel | None
) -> Record:
    """The files of one recording, each at its own angle of the plate, as that recording. Between
    them nothing is recorded: those samples are NaN.

    raws : the files, for their time stamps; imu : the sensor's model, where it is known. Raises
    InputError where the files' rates differ, or where the time between them is not known and the
    sensor's drift over it matters.
    """
    assert config.angles_deg is not None
    first = records[0]
    for own in records[1:]:
        alike = abs(own.rate_hz / first.rate_hz - 1) < _SAME_RATE
        about = f"but {first.name} has {first.rate_hz:.6g} Hz: files of one recording have one rate"
        require(alike, f"{own.name}: its rate, Hz", f"{own.rate_hz:.6g}", about)
    parts: dict[str, list[np.ndarray]] = {"gyro": [], "accel": [], "plate_angle": []}
    for own in records:
        about = f"is too short for a position of a plate, which takes {_SHORTEST_S:g} s or more"
        long = own.duration_s > _SHORTEST_S - 0.01
        require(long, f"{own.name}: its duration, s", f"{own.duration_s:.3g}", about)
    notes = dict.fromkeys(note for record in records for note in record.notes)
    before = known = 0.0
    for k, (record, degrees) in enumerate(zip(records, config.angles_deg, strict=True)):
        angle = degrees * DEG
        if k:
            gap, note = _gap(records[k - 1 : k + 1], raws[k - 1 : k + 1], config, imu)
            notes[note] = None
            known += gap
            n = max(1, round(gap * first.rate_hz))
            parts["gyro"].append(np.full((n, 3), np.nan))
            parts["accel"].append(np.full((n, 3), np.nan))
            parts["plate_angle"].append(np.where(np.arange(n) < n / 2, before, angle))
        parts["gyro"].append(record.gyro)
        parts["accel"].append(record.accel)
        parts["plate_angle"].append(np.full(len(record.gyro), angle))
        before = angle
    gyro, accel, angles = (np.concatenate(own) for own in parts.values())
    lasts = sum(record.duration_s for record in records) + known
    name = first.name
    if len(records) > 1:
        name = outputs.shown(f"{first.name} and {len(records) - 1} more")
        notes[
            f"positions: {len(records)} files are one recording of {lasts:.6g} s, the time between "
            f"them included: windows_s=[{lasts:.6g}] holds all of it"
        ] = None
    axis = AXES.index(config.plate_axis)
    return replace(first, name=name, gyro=gyro, accel=accel, plate_angle=angles, axis=axis,
                   notes=tuple(notes))  # fmt: skip


def _gap(
    records: Sequence[Record], raws: Sequence[Raw], config: LogConfig, imu: ImuModel | None
) -> tuple[float, str]:
    """The time between two files, s, and the note that says where it is from. Raises InputError
    where it is not known although the sensor's model says how its errors drift."""
    names = f"from {records[0].name} to {records[1].name}"
    if config.gap_s is not None:
        return config.gap_s, f"gap: {config.gap_s:g} s {names}, as stated (log.gap_s)"
    by_stamps = _by_stamps(records[0], *raws)
    if by_stamps is not None:
        return by_stamps, f"gap: {by_stamps:.6g} s {names}, by their time stamps"
    if imu is not None:
        raise InputError(
            "log.gap_s", None, "s", f"must be given: the time {names} is not known (their time "
            "stamps do not run on), and the sensor's errors drift meanwhile; 0 takes the files as "
            "following one another"
        )  # fmt: skip
    return 0.0, (
        f"gap: the time {names} is not known (log.gap_s states it): no sigma knows of the drift "
        "meanwhile, and two positions take a bias that did not change"
    )


def _by_stamps(record: Record, one: Raw, other: Raw) -> float | None:
    """The time between two files, s, by their stamps; None where these are not of one clock that
    runs on. record : of the first file, for its rate."""
    if one.stamps is None or other.stamps is None:
        return None
    steps = [float(raw.stamps[-1] - raw.stamps[0]) / (len(raw.stamps) - 1)
             for raw in (one, other) if raw.stamps is not None]  # fmt: skip
    if not min(steps) > 0 or abs(steps[1] / steps[0] - 1) > _SAME_RATE:
        return None
    samples = float(other.stamps[0] - one.stamps[-1]) / steps[0]
    gap = (samples - 1) / record.rate_hz
    return max(gap, 0.0) if samples > 0.5 and gap < _LONGEST_S else None
