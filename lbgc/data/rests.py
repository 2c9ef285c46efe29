"""The stretches of a recording in which its plate rests, or a hand holds the IMU at rest."""

from dataclasses import dataclass, replace

import numpy as np

from lbgc.data.record import Record
from lbgc.frames import DOWN, turned
from lbgc.units import DEG

_BLOCK_S = 0.5
"""Length of the blocks whose mean angles are compared, s."""
_STILL = 0.01 * DEG
"""Travel from block to block, rad, below which a plate may rest: more than an encoder's noise, and
less than any plate turns that shows a bias."""
_STAYS = 0.1 * DEG
"""Travel within a stretch, rad, above which it is a slow turn."""
_LEAST_S = 2.0
"""The shortest rest, s."""
_HAND_BLOCK_S = 0.25
"""Length of the blocks by which handling is found, s."""
_TURNS, _SWINGS, _PUSHED = 1.0 * DEG, 0.1 * DEG, 0.03
"""Mean rate of a block less the median of all, rad/s, and changes of its mean rate, rad/s, and mean
force, m/s^2, from the last block's, from which on an IMU is handled. A hand does many times more;
what gyros read at rest differs less from one attitude to another, by their g-sensitivity."""
_SPREADS = 8.0
"""The same in standard deviations of blocks at rest, where the sensor is so noisy."""
_GUARD_S = 0.5
"""Time next to handling that is left out, s: it begins and ends slowly."""
_LEAST_HELD_S = 3.0
"""The shortest stretch in which an IMU is taken as held, s, the time left out not counted."""
_EXACT = 0.5
"""The share of a rest's readings that are equal where the encoder does not flicker."""


@dataclass(frozen=True)
class Rest:
    """A stretch in which the plate rests."""

    samples: slice
    """The stretch's samples"""
    angle: float
    """rad, the plate's angle there"""

    def of(self, record: Record) -> Record:
        """The recording of this rest alone, as a resting recording."""
        name = f"{record.name} at {self.angle / DEG:.4g} deg"
        if record.held is not None:
            first, last = (n / record.rate_hz for n in (self.samples.start, self.samples.stop))
            name = f"{record.name} from {first:.4g} to {last:.4g} s"
        return replace(
            record,
            name=name,
            held=None,
            gyro=record.gyro[self.samples],
            accel=record.accel[self.samples],
            plate_angle=np.zeros(self.samples.stop - self.samples.start),
        )

    def level_of(self, record: Record) -> Record:
        """The recording in the axes that the body has where the plate's angle is zero, where it is
        level. About down they are as good as the body's."""
        own = self.of(record)
        if record.axis == DOWN:
            return own
        gyro, accel = (turned(v, np.array(self.angle), record.axis) for v in (own.gyro, own.accel))
        return replace(own, gyro=gyro, accel=accel)


def rests(record: Record) -> list[Rest]:
    """The rests of a recording, in order of time. Half a second next to a slew is left out, in
    which the plate may not rest quite. Where a hand holds the IMU: its poses, as they are listed or
    as they are found."""
    if record.held is not None:
        spans = [slice(*own) for own in record.held.poses] or held_still(record)
        return [Rest(own, 0.0) for own in spans]
    size = max(1, round(_BLOCK_S * record.rate_hz))
    n = len(record.gyro) // size
    if n < 2:
        return []
    angle = record.plate_angle[: n * size].reshape(n, size).mean(axis=1)
    recorded = np.isfinite(record.gyro[: n * size, 0]).reshape(n, size).all(axis=1)
    still = (np.abs(np.diff(angle)) < _STILL) & recorded[1:] & recorded[:-1]
    edges = np.flatnonzero(np.diff(np.r_[False, still, False].astype(np.int8)))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):  # of blocks, both included
        begin, end = first + (first > 0), last - (last < n - 1)
        if (end + 1 - begin) * size < _LEAST_S * record.rate_hz:
            continue
        if np.ptp(angle[begin : end + 1]) > _STAYS:
            continue
        samples = slice(int(begin * size), int((end + 1) * size))
        if end == n - 1 and np.isfinite(record.gyro[n * size :, 0]).all():
            samples = slice(samples.start, len(record.gyro))
        found.append(Rest(samples, float(np.median(record.plate_angle[samples]))))
    return found


def held_still(record: Record) -> list[slice]:
    """The stretches in which an IMU that a hand moves from one attitude to another is held at rest,
    by its own gyros and accelerometers: samples, in order of time.

    It is at rest for most of the time, so that medians over all blocks are of blocks at rest.
    """
    size = max(1, round(_HAND_BLOCK_S * record.rate_hz))
    n = len(record.gyro) // size
    if n < 2:
        return []
    blocks = (own[: n * size].reshape(n, size, 3) for own in (record.gyro, record.accel))
    rate, force = (own.mean(axis=1, dtype=float) for own in blocks)
    off = np.abs(rate - np.nanmedian(rate, axis=0))
    still = (off <= np.maximum(_TURNS, _SPREADS * _step(rate))).all(axis=1)  # nor where it is NaN
    for means, least in ((rate, _SWINGS), (force, _PUSHED)):
        steps = np.abs(np.diff(means, axis=0))
        alike = (steps <= np.maximum(least, _SPREADS * _step(means))).all(axis=1)
        still &= np.r_[alike, True] & np.r_[True, alike]
    edges = np.flatnonzero(np.diff(np.r_[False, still, False].astype(np.int8)))
    guard = max(1, round(_GUARD_S * record.rate_hz / size))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):  # of blocks
        begin, end = first + guard * (first > 0), last - guard * (last < n)
        if (end - begin) * size >= _LEAST_HELD_S * record.rate_hz:
            found.append(slice(int(begin * size), int(end * size)))
    return found


def _step(means: np.ndarray) -> np.ndarray:
    """1 sigma of the change from one block's mean to the next at rest, by the median change: (n, 3)
    to (3,)."""
    return np.asarray(1.4826 * np.nanmedian(np.abs(np.diff(means, axis=0)), axis=0))


def longest_rest(record: Record) -> Record:
    """The recording of its longest rest alone; all of it where the plate never rests."""
    found = rests(record)
    if not found:
        return record
    return max(found, key=lambda rest: rest.samples.stop - rest.samples.start).of(record)


def without_flicker(record: Record) -> Record:
    """The recording with the median of the encoder's readings in each rest in which they flicker,
    and a note of that: estimators tell a rest by an angle that stays."""
    angle, most = record.plate_angle.copy(), 0.0
    for rest in rests(record):
        own = angle[rest.samples]
        if np.mean(own == rest.angle) < _EXACT:
            most = max(most, float(own.std()))
            angle[rest.samples] = rest.angle
    if most == 0.0:
        return record
    note = (
        f"plate: the angle of {record.name} flickers at rest, by {most / DEG:.2g} deg (1 sigma): "
        "the median of each rest was taken"
    )
    return replace(record, plate_angle=angle, notes=(*record.notes, note))
