"""The check that a recording that is taken as resting was not turned, by hand or on a table."""

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.record import Record, TriadRecord
from lbgc.frames import axis_names
from lbgc.units import DEG

_BLOCK_S = 0.5
"""Length of the blocks whose mean rates are taken, s."""
_LENGTHS_S = (0.5, 2.0, 8.0, 32.0)
"""Durations over which a turn is looked for, s."""
_ANGLE, _RATE = 3.0 * DEG, 0.5 * DEG
"""The least angle, rad, and mean rate, rad/s, of a turn. A sway comes back, and no bias wanders so
far so fast."""
_SPREADS = 8.0
"""The least size of a turn, in standard deviations of the angles that the log turns otherwise."""
_EDGE = 0.02
"""Share of a turn that is left out at its start and at its end when these are timed."""
PLATE = 0.01 * DEG
"""Angle of the encoder, rad, from which on the plate is known to turn."""


UNTURNED = (
    "a log without an encoder's angle is taken for resting; cut it there, each part a log of its "
    "own, or state its positions (log.positions)"
)
TURNED = "the plate's angle says that it rests there"
"""Why a turn is a fault: in a log without angles, and in one that has them."""


def moved_finding(record: Record | TriadRecord, north: bool, why: str = UNTURNED) -> Finding | None:
    """The finding that the recording was turned by more than 3 degrees at more than 0.5 deg/s, far
    more than it turns otherwise. None where it was not, or where the encoder shows that the plate
    turns. why : the reason for which this is a fault."""
    gyro = record.triads["gyro"]
    size = max(1, round(_BLOCK_S * record.rate_hz))
    n = len(gyro) // size
    if n < 8 or np.ptp(record.plate_angle) > PLATE:
        return None
    means = gyro[: n * size].reshape(n, size, gyro.shape[1]).mean(axis=1, dtype=float)
    off = means - np.median(means, axis=0)
    step = size / record.rate_hz
    angle = np.cumsum(np.vstack([np.zeros_like(off[:1]), off]), axis=0) * step
    worst, where, along = 0.0, (0, 0), 0
    for length in _LENGTHS_S:
        k = max(1, round(length / step))
        if k > n // 2:
            break
        turned = angle[k:] - angle[:-k]  # (n + 1 - k, 3)
        spread = 1.4826 * np.median(np.abs(turned), axis=0)
        size_of = np.abs(turned) * (np.abs(turned) > np.maximum(_ANGLE, _SPREADS * spread))
        size_of *= np.abs(turned) / (k * step) > _RATE
        at, axis = np.unravel_index(int(size_of.argmax()), size_of.shape)
        if size_of[at, axis] > 1.02 * worst:  # the shortest stretch with the whole turn
            worst, where = float(size_of[at, axis]), (int(at), int(at) + k)
            along = int(axis)
    if worst == 0.0:
        return None
    course = np.abs(angle[where[0] : where[1] + 1, along] - angle[where[0], along])
    first = where[0] + int(np.argmax(course > _EDGE * worst)) - 1
    last = where[0] + int(np.argmax(course > (1 - _EDGE) * worst))
    axis_name = axis_names(gyro.shape[1])[along]
    return Finding(
        "moved",
        f"{record.name}: turned",
        round(worst / DEG, 1),
        "deg",
        f"about its {axis_name} axis between {first * step:g} and {last * step:g} s: {why}",
        refuses=north,
    )
