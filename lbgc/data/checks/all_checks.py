"""All checks of a log's recordings, which every recording passes before any result comes from
it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from lbgc.data.checks.findings import CHECKS, Finding
from lbgc.data.checks.moved import moved_finding
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
from lbgc.data.logconfig import LogConfig
from lbgc.data.record import Record
from lbgc.sensor.imu import ImuModel


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
    return replace(record, notes=(*record.notes, *notes))


def _findings(
    record: Record, config: LogConfig, imu: ImuModel | None, north: bool
) -> Iterator[Finding]:
    """The findings of all checks, in an order in which the first refusal names the cause: values,
    units, frames, geometry."""
    every = channels(record, config, imu)
    values = (
        stuck_finding(record, every),
        outliers_finding(record, every),
        rail_finding(record.name, every),
        pasted_finding(record),
        counts_finding(every),
        held_finding(record),
        moved_finding(record, north),
    )
    yield from (found for found in values if found is not None)
    rest = resting(record, config, imu)
    force = force_finding(rest, config, record.rate_hz)
    if force is not None:
        yield force
        return
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
