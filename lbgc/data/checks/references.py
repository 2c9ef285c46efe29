"""Whether the headings of several recordings turn in the same direction as their references.

In one resting recording a mirrored y axis cannot be told from a right one. Recordings with
different reference headings do tell it: the measured headings then fall where the references rise.
"""

from collections.abc import Sequence

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.checks.plausible import down_of
from lbgc.data.logconfig import LogConfig
from lbgc.data.readers.axes import matrix_of, spelled
from lbgc.data.record import Record

FEWEST = 4
"""The least number of recordings with references that are compared."""
_EVIDENCE = 25.0
"""Twice the log-likelihood ratio that is 5 sigma."""
_CLOSE = 0.9
"""The least mean resultant length of differences that have one common angle: 26 degrees of
scatter."""


def turning_finding(
    records: Sequence[Record], config: LogConfig, north: bool = True
) -> Finding | None:
    """The finding that headings fall where references rise, by more than 5 sigma; None where they
    do not."""
    with_, against = _resultants(records)
    if not _better(against, with_, len(records)):
        return None
    mirror = np.diag([1.0, -1.0, 1.0])
    axes, accel = (spelled(mirror @ matrix_of(a)) for a in (config.axes, config.axes_of_accel))
    says = f"the headings of {len(records)} recordings fall where their references rise: y points "
    says += f"the other way (log.axes={axes} log.accel_axes={accel}), x and y stand in each "
    says += "other's place, or the references are counter-clockwise"
    return Finding("mirrored", "log.axes", spelled(matrix_of(config.axes)), "", says, north)


def agree(records: Sequence[Record]) -> bool:
    """Whether the headings rise with their references, by more than 5 sigma."""
    with_, against = _resultants(records)
    return _better(with_, against, len(records))


def _better(one: float, other: float, count: int) -> bool:
    """Whether the mean resultant length `one` is larger than the other by 5 sigma, measured by
    twice the log-likelihood ratio of the two circular variances."""
    if one < _CLOSE:
        return False
    return count * float(np.log((1 - other + 1e-9) / (1 - one + 1e-9))) > _EVIDENCE


def _resultants(records: Sequence[Record]) -> tuple[float, float]:
    """The mean resultant lengths of heading less reference, and of heading plus reference; zero
    where references are missing or recordings too few."""
    references = [r.heading_reference for r in records]
    if len(records) < FEWEST or any(reference is None for reference in references):
        return 0.0, 0.0
    found = np.array([_heading(record) for record in records])
    known = np.array(references, dtype=float)
    less, plus = (float(abs(np.exp(1j * (found + s * known)).mean())) for s in (-1, 1))
    return less, plus


def _heading(record: Record) -> float:
    """The heading, rad, by the horizontal part of the mean rate, across the measured vertical."""
    down = down_of(record.accel.mean(axis=0))
    rate = record.gyro.mean(axis=0)
    right = np.cross(down, [1.0, 0.0, 0.0])
    forward = np.cross(right, down)
    return float(np.arctan2(-(rate @ right), rate @ forward))
