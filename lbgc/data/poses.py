"""A sensor held at rest in several attitudes, one after the other, with nothing else known."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Poses:
    """The log of a sensor that was held at rest in P attitudes (poses)."""

    gyro: np.ndarray
    """(T, 3), rad/s, interval means, forward, right and down"""
    accel: np.ndarray
    """(T, 3), m/s^2, likewise"""
    rate_hz: float
    latitude: float | None
    """rad; None where it is not known"""
    rests: tuple[tuple[int, int], ...]
    """The first sample of each pose, and the one after its last"""
    integrated: bool
    """Whether the log is unbroken, so that its gyros tell the turns between the poses"""
