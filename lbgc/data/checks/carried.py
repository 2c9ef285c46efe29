"""The check that the gyros of an IMU in a hand felt the turns by which gravity moved in its
axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.checks.plausible import down_of
from lbgc.data.logconfig import LogConfig
from lbgc.data.record import Record
from lbgc.data.rests import Rest
from lbgc.frames import one_after_the_other
from lbgc.units import DEG

_TELLS = 20.0 * DEG
"""Angle between two poses' downs, rad, from which on it tells the gyros' turn."""
_OFF, _NEAR = 20.0 * DEG, 10.0 * DEG
"""Median angle, rad, between where the gyros carry down and where gravity shows it, from which on
they felt another turn; and up to which another description explains it."""
_FEWEST = 2
"""Turns that are needed: one alone may be at a rail, or its samples be spoiled."""
_OTHERS = (
    ("gyro_unit", 1 / DEG, "their unit is 57.3 times as large: rad/s where deg/s was taken"),
    ("gyro_unit", DEG, "their unit is 57.3 times as small: deg/s where rad/s was taken"),
    ("gyro_scale", -1.0, "their signs are the other ones (or those of the accelerometers)"),
)
"""What else the rates may be: the key, the factor, and how it is said."""


@dataclass(frozen=True)
class _Turn:
    """What a hand did from one pose to the next."""

    steps: np.ndarray
    """(m, 3), rad, the turn within each sample, as the gyros felt it"""
    before: np.ndarray
    """(3,), down in the body's axes before it, a unit vector"""
    after: np.ndarray
    """(3,), likewise behind it"""

    def off(self, factor: float) -> float:
        """The angle, rad, by which these steps, times a factor, miss the down behind them."""
        carried = one_after_the_other(factor * self.steps).T @ self.before
        return float(np.arccos(np.clip(carried @ self.after, -1.0, 1.0)))


def carried_finding(record: Record, found: Sequence[Rest], config: LogConfig) -> Finding | None:
    """The finding that the gyros, integrated from each rest to the next, do not carry down to where
    gravity shows it: then their unit, their signs or their axes are others. None where they do, or
    where too few turns tell. found : the recording's rests."""
    turns = [own for pair in pairwise(found) if (own := _turn(record, *pair)) is not None]
    if len(turns) < _FEWEST:
        return None
    off = float(np.median([turn.off(1.0) for turn in turns]))
    if off < _OFF:
        return None
    says = f"{record.name}: from pose to pose the gyros carry down to {off / DEG:.3g} deg from "
    says += f"where gravity shows it, in the median of {len(turns)} turns: "
    for key, factor, what in _OTHERS:
        if np.median([turn.off(factor) for turn in turns]) < _NEAR:
            return Finding("turned", f"log.{key}", getattr(config, key), "", says + what)
    says += "the gyros' axes are not the accelerometers' (log.axes, log.accel_axes), or their unit "
    says += "is another, or they were at their rail, or the log is not unbroken"
    return Finding("turned", "log.axes", config.axes, "", says)


def _turn(record: Record, before: Rest, after: Rest) -> _Turn | None:
    """What a hand did between two rests; None where a sample is missing, or gravity hardly moved.
    What the gyros read at rest is taken off: it is no turn."""
    rates = record.gyro[before.samples.stop : after.samples.start]
    if not len(rates) or not np.isfinite(rates).all():
        return None
    rest = sum(record.gyro[own.samples].mean(axis=0) for own in (before, after)) / 2
    downs = [down_of(record.accel[own.samples].mean(axis=0)) for own in (before, after)]
    if not np.arccos(np.clip(downs[0] @ downs[1], -1.0, 1.0)) > _TELLS:
        return None
    return _Turn((rates - rest) / record.rate_hz, downs[0], downs[1])
