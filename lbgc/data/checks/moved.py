"""The check that a recording that is taken as resting was not turned, by hand or on a table."""

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.checks.plausible import down_of
from lbgc.data.record import Record, TriadRecord
from lbgc.data.rests import held_still
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
_LAID = 10.0 * DEG
"""Angle, rad, between the downs of two rests from which on they are attitudes of their own: no base
leans so."""
PLATE = 0.01 * DEG
"""Angle of the encoder, rad, from which on the plate is known to turn."""


UNTURNED = (
    "a log without an encoder's angle is taken for resting; cut it there, each part a log of its "
    "own, or state its positions (log.positions); one that was laid in several attitudes is for "
    "estimator=tumble"
)
TURNED = "the plate's angle says that it rests there"
HELD = "it is taken as held at rest all the while; list the stretches in which it was (log.poses)"
"""Why a turn is a fault: in a log without angles, in one that has them, and in one without a
plate."""


def laid_finding(record: Record) -> Finding | None:
    """The finding that the recording is of an IMU that was laid in several attitudes, which nobody
    but a tumble's estimator may take for one at rest. None where it was not, by its own rests."""
    found = held_still(record)
    if np.ptp(record.plate_angle) > PLATE or len(found) < 2:
        return None
    down = np.array([down_of(record.accel[own].mean(axis=0)) for own in found])
    off = np.arccos(np.clip(down @ down[0], -1.0, 1.0))
    other = int(off.argmax())
    if off[other] < _LAID:
        return None
    first = found[other].start / record.rate_hz
    return Finding(
        "moved",
        f"{record.name}: laid",
        round(float(off[other]) / DEG, 1),
        "deg",
        f"from its first attitude by {first:.4g} s, in {len(found)} attitudes altogether: only "
        "estimator=tumble answers that",
    )


def handled_finding(part: Record) -> Finding | None:
    """The finding that an IMU was handled in a stretch that is listed as one in which it was held
    at rest. None where it was not."""
    found = held_still(part)
    if len(found) == 1 and (found[0].stop - found[0].start) / part.rate_hz > part.duration_s - 0.5:
        return None
    rests = [(own.start / part.rate_hz, own.stop / part.rate_hz) for own in found]
    which = ", ".join(f"{first:.4g} to {last:.4g} s" for first, last in rests) or "nowhere"
    says = f"since its start is where it rests: {HELD}"
    return Finding("moved", f"{part.name}: at rest", which, "", says)


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
