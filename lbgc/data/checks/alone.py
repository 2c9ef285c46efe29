"""The checks of one triad's recording by itself: of its values, of its rest, and of its unit where
gravity tells that. Frames, biases against Earth's rate and the gyros' unit take both triads."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lbgc.data.checks.all_checks import ANYWHERE
from lbgc.data.checks.findings import Finding
from lbgc.data.checks.moved import moved_finding
from lbgc.data.checks.plausible import force_finding
from lbgc.data.checks.printed import channels, counts_finding, rail_finding
from lbgc.data.checks.spoiled import outliers_finding, pasted_finding, stuck_finding
from lbgc.data.logconfig import LogConfig
from lbgc.data.readers.blocks import some
from lbgc.data.record import TriadRecord

_EDGE, _FEWEST = 0.1, 200
"""Share of values at each end among which no gap is looked for, and the fewest between."""
_APART, _TURNS = 3.0, 0.1
"""The least width of the gap in standard deviations of what is on either side of it, and the share
of rows from which on values go over it; a wandering bias is slower."""
_ALONE = {
    "gyro": "gyros alone were recorded: their unit, their axes and their bias cannot be checked "
    "against the vertical",
    "accel": "accelerometers alone were recorded: that they rest at 1 g was checked, their axes "
    "and which of them points down were not",
}


def checked_alone(record: TriadRecord, config: LogConfig) -> TriadRecord:
    """The recording of one triad with the findings of its checks among its notes. Raises InputError
    where a check refuses it and `config.accept` does not name that check."""
    notes = [found.settled(config.accept) for found in _findings(record, config)]
    return replace(record, notes=(*record.notes, *notes))


def alone_note(record: TriadRecord) -> str:
    """The note of what is not checked of a log that has no other triad."""
    return f"one triad: of {record.name} {_ALONE[record.part]}; noise alone is fitted"


def _findings(record: TriadRecord, config: LogConfig) -> Iterator[Finding]:
    """The findings of the checks that one triad allows."""
    every = channels(record, config, None)
    found = [
        _mixed_finding(record),
        stuck_finding(record, every),
        outliers_finding(record, every),
        rail_finding(record.name, every),
        pasted_finding(record),
        counts_finding(every),
    ]
    if record.part == "gyro":
        found.append(moved_finding(record, north=False))
    else:
        mean = record.values.mean(axis=0)
        where = record.latitude if np.isfinite(record.latitude) else ANYWHERE
        found.append(force_finding(record.name, mean, where, config, record.rate_hz))
    yield from (one for one in found if one is not None)


def _mixed_finding(record: TriadRecord) -> Finding | None:
    """The finding that rows of two sensors take turns, as in tables to which several sensors write;
    None where they do not. Then the values of an axis have a wide gap in their middle, over which
    they go to and fro. By itself one triad's mean does not contradict that."""
    for values in some(record.values).T:
        ordered = np.sort(values)
        inner = ordered[int(_EDGE * len(ordered)) : len(ordered) - int(_EDGE * len(ordered))]
        gaps = np.diff(inner)
        if len(gaps) < _FEWEST or not gaps.any():
            continue
        at = int(gaps.argmax())
        high = values > (inner[at] + inner[at + 1]) / 2
        spread = max(float(np.std(values[high])), float(np.std(values[~high])))
        turns = float(np.mean(high[1:] != high[:-1]))
        if gaps[at] > _APART * spread > 0 and turns > _TURNS:
            key = f"log.{record.part}_rows"
            says = f"rows of {record.name} are of two sensors, whose values take turns; which are "
            says += f"the {record.part}'s: {key}=[COLUMN,VALUE]"
            return Finding("mixed", key, None, "", says)
    return None
