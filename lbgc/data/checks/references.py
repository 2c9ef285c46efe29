"""Whether the headings of several recordings turn as their references do.

At rest a mirrored y looks like a right one. Over recordings whose reference headings differ it does
not: the measured headings then fall where the references rise.
"""

from collections.abc import Sequence

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.checks.plausible import down_of
from lbgc.data.logconfig import LogConfig
from lbgc.data.readers.axes import matrix_of, spelled
from lbgc.data.record import Record

FEWEST = 4
"""Recordings with references below which they are not held against each other."""
_EVIDENCE = 25.0
_CLOSE = 0.9
"""Mean resultant length of differences that are about one angle: 26 degrees of scatter."""


def turning_finding(
    records: Sequence[Record], config: LogConfig, north: bool = True
) -> Finding | None:
    """Headings that fall where references rise, by more than 5 sigma."""
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
    """Whether `one` is evidently the larger resultant length, by twice the log of the likelihood
    ratio of two circular variances."""
    if one < _CLOSE:
        return False
    return count * float(np.log((1 - other + 1e-9) / (1 - one + 1e-9))) > _EVIDENCE


def _resultants(records: Sequence[Record]) -> tuple[float, float]:
    """Mean resultant lengths of heading less reference, and of heading plus reference."""
    references = [r.heading_reference for r in records]
    if len(records) < FEWEST or any(reference is None for reference in references):
        return 0.0, 0.0
    found = np.array([_heading(record) for record in records])
    known = np.array(references, dtype=float)
    less, plus = (float(abs(np.exp(1j * (found + s * known)).mean())) for s in (-1, 1))
    return less, plus


def _heading(record: Record) -> float:
    """Heading of the mean rate's part across the measured vertical, rad."""
    down = down_of(record.accel.mean(axis=0))
    rate = record.gyro.mean(axis=0)
    right = np.cross(down, [1.0, 0.0, 0.0])
    forward = np.cross(right, down)
    return float(np.arctan2(-(rate @ right), rate @ forward))
