"""Whether a recording that is taken for resting was turned, by hand or on a table."""

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.record import Record
from lbgc.data.static import AXES
from lbgc.units import DEG

_BLOCK_S = 0.5
_LENGTHS_S = (0.5, 2.0, 8.0, 32.0)
_ANGLE, _RATE = 3.0 * DEG, 0.5 * DEG
"""rad and rad/s: a sway comes back, and no bias wanders so far so fast."""
_SPREADS = 8.0
_EDGE = 0.02
"""Share of a turn before its start and behind its end."""
_PLATE = 0.01 * DEG


def moved_finding(record: Record, north: bool) -> Finding | None:
    """A turn by more than 3 degrees at more than 0.5 deg/s, far outside what the log does else; of
    a plate that turns by its encoder nothing is said."""
    size = max(1, round(_BLOCK_S * record.rate_hz))
    n = len(record.gyro) // size
    if n < 8 or np.ptp(record.plate_angle) > _PLATE:
        return None
    means = record.gyro[: n * size].reshape(n, size, 3).mean(axis=1, dtype=float)
    off = means - np.median(means, axis=0)
    step = size / record.rate_hz
    angle = np.vstack([np.zeros(3), np.cumsum(off, axis=0)]) * step
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
        if size_of[at, axis] > 1.02 * worst:  # the shortest stretch that has all of it
            worst, where = float(size_of[at, axis]), (int(at), int(at) + k)
            along = int(axis)
    if worst == 0.0:
        return None
    course = np.abs(angle[where[0] : where[1] + 1, along] - angle[where[0], along])
    first = where[0] + int(np.argmax(course > _EDGE * worst)) - 1
    last = where[0] + int(np.argmax(course > (1 - _EDGE) * worst))
    return Finding(
        "moved",
        f"{record.name}: turned",
        round(worst / DEG, 1),
        "deg",
        f"about its {AXES[along]} axis between {first * step:g} and {last * step:g} s: a log "
        "without an encoder's angle is taken for resting; cut it there, each part a log of its own",
        refuses=north,
    )
