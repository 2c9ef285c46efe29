"""All checks of a log's recordings, which every recording passes before any result comes from
it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from lbgc.data.checks.carried import carried_finding
from lbgc.data.checks.felt import felt_finding, is_felt, late_note
from lbgc.data.checks.findings import CHECKS, Finding
from lbgc.data.checks.moved import HELD, PLATE, TURNED, handled_finding, laid_finding, moved_finding
from lbgc.data.checks.plausible import force_finding, rate_finding, resting
from lbgc.data.checks.printed import channels, counts_finding, held_finding, rail_finding
from lbgc.data.checks.references import FEWEST, agree, turning_finding
from lbgc.data.checks.spoiled import outliers_finding, pasted_finding, stuck_finding
from lbgc.data.checks.triads import (
    Frames,
    frames_finding,
    geometry_finding,
    mirrored_finding,
    motions,
)
from lbgc.data.checks.turns import (
    axis_finding,
    bias_note,
    is_told,
    level_finding,
    sense_finding,
    size_finding,
    turning,
)
from lbgc.data.logconfig import LogConfig
from lbgc.data.record import Record
from lbgc.data.rests import rests
from lbgc.frames import DOWN
from lbgc.sensor.imu import ImuModel

ANYWHERE = np.pi / 4
"""Latitude of which gravity is taken to tell a unit, rad, where none is known."""
_UNPLACED = (
    "latitude: it is not known, so the mean rates were not compared with Earth's: units, frames "
    "and biases are as they are described"
)


def checked(
    record: Record, config: LogConfig, imu: ImuModel | None = None, north: bool = True
) -> Record:
    """The recording with the findings of the checks among its notes.

    imu : the sensor's error model, where it is known; north : whether a heading is asked for.
    Raises InputError where a check refuses the recording's values or frames and `config.accept`
    does not name that check.
    """
    findings = _findings(record, config, imu, north)
    notes = [found.settled(config.accept) for found in findings]
    notes += [] if np.isfinite(record.latitude) else [_UNPLACED]
    return replace(record, notes=(*record.notes, *notes, *_turned_notes(record, config, imu)))


def _findings(
    record: Record, config: LogConfig, imu: ImuModel | None, north: bool
) -> Iterator[Finding]:
    """The findings of all checks, in an order in which the first refusal names the cause: values,
    units, frames, geometry."""
    if record.held is not None:
        yield from _held_findings(record, config, imu, north)
        return
    if np.ptp(record.plate_angle) > PLATE:
        yield from _turned_findings(record, config, imu, north)
        return
    laid = laid_finding(record)
    if laid is not None:
        yield laid
    yield from _value_findings(record, config, imu)
    moved = moved_finding(record, north)
    if moved is not None:
        yield moved
    yield from _resting_findings(record, config, imu, north)


def _resting_findings(
    record: Record, config: LogConfig, imu: ImuModel | None, north: bool
) -> Iterator[Finding]:
    """The findings on units, frames and biases by the means of a recording at rest."""
    rest = resting(record, config, imu)
    placed = np.isfinite(record.latitude)
    anywhere = rest.latitude if placed else ANYWHERE
    force = force_finding(rest.name, rest.force, anywhere, config, record.rate_hz)
    if force is not None:
        yield force
        return
    if not placed:
        return  # nothing is known of Earth's rate
    frames = Frames(rest, motions(record))
    crossed = frames_finding(frames, config, north)
    rate = None if crossed else rate_finding(rest, config, record.rate_hz, north)
    for found in (crossed, rate, geometry_finding(frames, config, north)):
        if found is not None:
            yield found
    if crossed is None:
        mirrored = mirrored_finding(frames, config)
        if mirrored is not None:
            yield mirrored


def _value_findings(record: Record, config: LogConfig, imu: ImuModel | None) -> Iterator[Finding]:
    """The findings on the values of a recording, or of one rest of it."""
    every = channels(record, config, imu)
    values = (
        stuck_finding(record, every),
        outliers_finding(record, every),
        rail_finding(record.name, every),
        pasted_finding(record),
        counts_finding(every),
        held_finding(record),
    )
    yield from (found for found in values if found is not None)


def _value_findings_of(
    parts: Sequence[Record], config: LogConfig, imu: ImuModel | None
) -> Iterator[Finding]:
    """The findings on the values of several rests, one of each check."""
    first: dict[str, Finding] = {}
    for one in (finding for part in parts for finding in _value_findings(part, config, imu)):
        if one.check not in first or (one.refuses and not first[one.check].refuses):
            first[one.check] = one
    yield from first.values()


def _held_findings(
    record: Record, config: LogConfig, imu: ImuModel | None, north: bool
) -> Iterator[Finding]:
    """The findings on a recording of an IMU that is held in several attitudes: on the values of
    each, on the turns between them, and on units by the means of the first. No attitude is
    wrong."""
    found = rests(record)
    parts = [rest.of(record) for rest in found]
    handled = (handled_finding(part) or moved_finding(part, north, HELD) for part in parts)
    yield from islice(filter(None, handled), 1)
    yield from _value_findings_of(parts, config, imu)
    carried = carried_finding(record, found, config)
    if carried is not None:
        yield carried
        return
    placed = np.isfinite(record.latitude)
    for part in parts[:1]:
        rest = resting(part, config, imu)
        anywhere = rest.latitude if placed else ANYWHERE
        force = force_finding(rest.name, rest.force, anywhere, config, record.rate_hz)
        rate = None
        if placed and force is None:
            rate = rate_finding(rest, config, record.rate_hz, north)
        yield from (one for one in (force, rate) if one is not None)


def _turned_findings(
    record: Record, config: LogConfig, imu: ImuModel | None, north: bool
) -> Iterator[Finding]:
    """The findings on a recording whose plate turns: on the values at each rest, one of each check,
    and on units and frames by what of the means turns with the plate. A bias, which does not turn,
    is no fault there."""
    found = rests(record)
    parts = [rest.of(record) for rest in found] or [record]
    yield from _value_findings_of(parts, config, imu)
    moved = (moved_finding(part, north, TURNED) for part in parts)
    level_part = found[0].level_of(record) if found else record
    resting_part = resting(level_part, config, imu)
    felt = felt_finding(record, found, config, resting_part.limit)
    yield from (one for one in (felt, next(filter(None, moved), None)) if one is not None)
    own = turning(record, found, imu) if np.isfinite(record.latitude) else None
    if own is None:
        yield from _resting_findings(level_part, config, imu, north)
        return
    sense, other = sense_finding(own, config), axis_finding(own, config)
    if other is not None or (sense is not None and own.axis != DOWN):
        yield from (one for one in (other or sense,) if one is not None)
        return  # the mean force, of which all is told, is then wrong
    rest = own.resting(resting_part)
    fallen = None if sense else level_finding(own)
    force = (
        None
        if fallen
        else force_finding(rest.name, rest.force, rest.latitude, config, record.rate_hz)
    )
    if fallen is not None:
        yield fallen
    if force is not None:
        yield force
        return
    frames = Frames(rest, motions(level_part) if found else [])
    # The sense of a felt turn, or of Earth's rate in a right-handed frame, tells the gyros' signs
    # better than their vertical rate does, in which a bias may hide.
    told = is_told(own)
    crossed = None
    if not is_felt(record, found, config):
        crossed = frames_finding(frames, config, north and not told)
    size = (
        None
        if sense or (crossed and crossed.refuses)
        else size_finding(own, config, record.rate_hz)
    )
    geometry = geometry_finding(frames, config, north)
    for finding in (sense, crossed, size, geometry):
        if finding is not None:
            yield finding
    mirrored = mirrored_finding(frames, config)
    if crossed is None and sense is None and mirrored is not None and not told:
        yield mirrored


def _turned_notes(record: Record, config: LogConfig, imu: ImuModel | None) -> tuple[str, ...]:
    """The notes on a recording whose plate turns, or none: its bias, and whether its angles are
    late."""
    if not np.ptp(record.plate_angle) > PLATE:
        return ()
    found = rests(record)
    own = turning(record, found, imu) if np.isfinite(record.latitude) else None
    late = late_note(record, found, config)
    notes = [] if own is None else [bias_note(own)]
    return (*notes, *([] if late is None else [late]))


def together(records: Sequence[Record], config: LogConfig, north: bool = True) -> list[Record]:
    """The recordings of one log, checked together. All get the same notes, in which what several
    recordings have in common stands once.

    Raises InputError where headings fall while their references rise.
    """
    turning = turning_finding(records, config, north)
    settled = [] if turning is None else [turning.settled(config.accept)]
    known = turning is None and len(records) >= FEWEST and agree(records)
    said: dict[str, tuple[str, int]] = {}
    for record in records:
        for note in record.notes:
            check = note.split(":", 1)[0]
            if check == "mirrored" and (known or turning is not None):
                continue
            key = check if check in CHECKS else note
            first, count = said.get(key, (note, 0))
            said[key] = (first, count + 1)
    notes = tuple(
        first if count == len(records) else f"{first} ({count} of {len(records)} recordings)"
        for first, count in said.values()
    )
    return [replace(record, notes=(*notes, *settled)) for record in records]
