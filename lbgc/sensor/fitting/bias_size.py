"""How large a sensor's bias is, as far as the mean of one resting recording tells.

Earth's rate and gravity are known; what a mean differs from them by is bias. The gyros' vertical
one shows itself fully. Of the horizontal two the mean shows how far they carry its horizontal part
off a circle of radius Omega cos(latitude), and where the heading is known, both. The
accelerometers' tilt the level with them, so that only the force's size tells.

Three figures (or one) are few to tell a standard deviation from: its posterior under a prior flat
in its logarithm is given by its median and 95% interval.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.special

from lbgc.earth import EARTH_RATE, earth_rate_ned, normal_gravity
from lbgc.frames import euler_to_matrix
from lbgc.sensor import gaussian

_HEIGHT_UNKNOWN = 1.5e-3
"""m/s^2, what 500 m of unknown height make of gravity."""
_GRID = 4000


@dataclass(frozen=True)
class BiasSize:
    """1 sigma of each axis's bias, SI: posterior median and 95% interval."""

    value: float
    low: float
    high: float


def mean_error(terms: gaussian.Gaussians, seconds: float) -> float:
    """Standard deviation of a mean over so many seconds by these noise terms, in their unit."""
    if not terms:
        return 0.0
    return float(np.sqrt(gaussian.covariance_of_means(terms, 1, seconds)[0, 0]))


def of_gyro(
    rate: np.ndarray,
    force: np.ndarray,
    latitude: float,
    heading: float | None = None,
    error: float = 0.0,
) -> BiasSize:
    """rate, force : (3,), rad/s and m/s^2, a resting recording's means, body axes; latitude : rad;
    heading : rad, or None where it is not known; error : rad/s, 1 sigma of each mean by noise."""
    down = -force / np.linalg.norm(force)
    if heading is not None:
        roll = np.arctan2(down[1], down[2])
        pitch = -np.arcsin(np.clip(down[0], -1, 1))
        earth = earth_rate_ned(latitude) @ euler_to_matrix(roll, pitch, heading)
        off = rate - earth
        return _posterior(lambda v: -0.5 * float(np.sum(off**2)) / v - 1.5 * np.log(v), off, error)
    vertical = float(rate @ down) + EARTH_RATE * np.sin(latitude)
    level = float(np.linalg.norm(rate - (rate @ down) * down))
    north = EARTH_RATE * np.cos(latitude)

    def log_likelihood(v: np.ndarray) -> np.ndarray:
        """A normal vertical; a horizontal of size `level` whose direction is unknown (Rice)."""
        bessel = np.log(scipy.special.i0e(level * north / v))
        return np.asarray(
            -0.5 * (vertical**2 + (level - north) ** 2) / v - 1.5 * np.log(v) + bessel
        )

    return _posterior(log_likelihood, np.array([vertical, level, north]), error)


def of_accel(force: np.ndarray, latitude: float) -> BiasSize:
    """force : (3,), m/s^2, a resting recording's mean; latitude : rad."""
    off = float(np.linalg.norm(force) - normal_gravity(latitude))
    return _posterior(lambda v: -0.5 * (off**2 / v + np.log(v)), np.array([off]), _HEIGHT_UNKNOWN)


def _posterior(
    log_likelihood: Callable[[np.ndarray], np.ndarray], sizes: np.ndarray, error: float
) -> BiasSize:
    """log_likelihood : of the variances (bias and noise of the mean together) on a grid."""
    largest = max(float(np.abs(sizes).max()), error, 1e-12)
    least = max(error, 1e-5 * largest) / 3
    log_size = np.linspace(np.log(least), np.log(100 * largest), _GRID)
    value = log_likelihood(np.exp(2 * log_size) + error**2)
    weight = np.cumsum(np.exp(value - value.max()))
    low, middle, high = np.exp(np.interp([0.025, 0.5, 0.975], weight / weight[-1], log_size))
    return BiasSize(float(middle), float(low), float(high))
