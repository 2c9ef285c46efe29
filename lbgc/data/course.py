"""A turned recording without its turns: what is left are resting recordings, to which noise can be
fitted."""

from dataclasses import replace

import numpy as np

from lbgc.data.record import Record
from lbgc.data.rests import rests
from lbgc.errors import require

_TURNS = 1e-4
"""The change of an encoder's reading up to which a plate is at rest, rad."""
_SETTLES_S = 3.0
"""Time after a slew, or after the start of a turn, in which a plate still settles, s."""
_BLOCK_S, _EVEN = 0.5, 0.01
"""Length of the blocks whose mean angles are compared, s, and the share by which their travel may
differ in an even turn."""
_SHORT = 0.5
"""The share of the longest rest below which a rest is left out: recordings are cut to one length.
"""


def turns_evenly(record: Record) -> bool:
    """Whether the plate turns and never rests. Then the errors of scale and misalignment make a
    mean rate that no bias makes."""
    return bool(np.ptp(record.plate_angle) >= _TURNS) and not rests(record)


def resting_parts(record: Record) -> list[Record]:
    """The recording as resting ones: itself where its plate rests, a recording of each rest where
    it turns from rest to rest, and where it turns evenly the residual from its course, as if it
    rested at angle zero. A note says which. Rests share the bias of one run, and no heading is
    theirs by which one would be told from another.

    Raises InputError where the plate neither rests for some seconds nor turns evenly.
    """
    if np.ptp(record.plate_angle) < _TURNS:
        return [record]
    if turns_evenly(record):
        return [_without_turn(record)]
    found = rests(record)
    late = round(_SETTLES_S * record.rate_hz)
    settled = [replace(r, samples=slice(r.samples.start + late * (r.samples.start > 0),
                                        r.samples.stop)) for r in found]  # fmt: skip
    longest = max(r.samples.stop - r.samples.start for r in settled)
    kept = [r for r in settled if r.samples.stop - r.samples.start >= _SHORT * longest]
    note = f"turned: noise is fitted to {len(kept)} rests of {record.name}, each with its own mean"
    parts = []
    for rest in kept:
        own = replace(rest.of(record), heading=None, heading_reference=None)
        if record.temperature is not None:
            own = replace(own, temperature=record.temperature[rest.samples])
        parts.append(replace(own, notes=(*record.notes, note)))
    return parts


def _evenly(record: Record) -> slice:
    """The samples of the longest stretch in which the plate turns evenly. Raises InputError where
    that is less than half of the recording."""
    size = max(1, round(_BLOCK_S * record.rate_hz))
    n = len(record.plate_angle) // size
    travel = np.diff(record.plate_angle[: n * size].reshape(n, size).mean(axis=1))
    middle = float(np.median(travel))
    even = np.abs(travel - middle) < _EVEN * abs(middle)
    edges = np.flatnonzero(np.diff(np.r_[False, even, False].astype(np.int8)))
    runs = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    first, last = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
    about = "neither rests for some seconds nor turns evenly: noise is fitted to what does"
    require(2 * (last - first) > n, record.name, "its plate", about)
    late = round(_SETTLES_S * record.rate_hz)
    return slice(first * size + late, (last + 1) * size - late)


def _without_turn(record: Record) -> Record:
    """An evenly turned recording as if the plate rested at angle zero: what follows the cosine and
    the sine of its angle is that of the angle zero throughout, and its mean rate is taken off."""
    own = _evenly(record)
    angle, n = record.plate_angle[own], own.stop - own.start
    columns = np.stack([np.ones(n), np.cos(angle), np.sin(angle)], axis=1)
    gyro, accel = record.gyro[own].copy(), record.accel[own].copy()
    gyro[:, record.axis] -= (angle[-1] - angle[0]) / (n - 1) * record.rate_hz
    for values in (gyro, accel):
        fit = np.linalg.lstsq(columns, values, rcond=None)[0]
        values += fit[1] - columns[:, 1:] @ fit[1:]
    note = f"turned: noise is fitted to {record.name} less its even turn"
    warmth = None if record.temperature is None else record.temperature[own]
    at_zero = replace(record, gyro=gyro, accel=accel, plate_angle=np.zeros(n), temperature=warmth)
    return replace(at_zero, heading=None, heading_reference=None, notes=(*record.notes, note))
