"""The size of a sensor's bias (1 sigma of an axis), as far as the mean of one resting recording
tells it.

Earth's rate and gravity are known, and the mean's difference from them is bias. The vertical gyro's
bias shows fully. Of the two horizontal biases the mean shows only how far they move the horizontal
rate off a circle of radius Omega cos(latitude), unless the heading is known, which shows both. The
accelerometers' horizontal biases tilt the level that is found from them, so only the size of the
force tells.

A standard deviation is told poorly by three figures, or by one. So its posterior, under a prior
that is flat in its logarithm, is given by its median and 95% interval.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.special

from lbgc.earth import EARTH_RATE, earth_rate_ned, normal_gravity
from lbgc.frames import euler_to_matrix
from lbgc.sensor import gaussian

_HEIGHT_UNKNOWN = 1.5e-3
"""The change of gravity with 500 m of unknown height, m/s^2."""
_GRID = 4000
"""Sizes at which the posterior is evaluated."""


@dataclass(frozen=True)
class BiasSize:
    """The standard deviation of each axis's bias, SI: its posterior median and 95% interval."""

    value: float
    """Posterior median"""
    low: float
    """Lower end of the 95% interval"""
    high: float
    """Upper end of the 95% interval"""


def mean_error(terms: gaussian.Gaussians, seconds: float) -> float:
    """Standard deviation that these noise terms give to a mean over `seconds` from the recording's
    start, in their unit."""
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
    """The size of the gyros' bias, rad/s, from a resting recording's means.

    rate, force : (3,), rad/s and m/s^2, the means in body axes; latitude : rad; heading : rad, or
    None where it is not known; error : rad/s, 1 sigma of each mean by noise.
    """
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
        """The vertical bias is normal; the horizontal rate has the size `level` and an unknown
        direction (Rice's law)."""
        bessel = np.log(scipy.special.i0e(level * north / v))
        return np.asarray(
            -0.5 * (vertical**2 + (level - north) ** 2) / v - 1.5 * np.log(v) + bessel
        )

    return _posterior(log_likelihood, np.array([vertical, level, north]), error)


def of_gyro_alone(rate: np.ndarray, error: float = 0.0) -> BiasSize:
    """The size of the gyros' bias, rad/s, from a resting recording's mean rate (3,), rad/s, without
    a vertical: Earth's rate is in it, in a direction of which nothing is known. error : rad/s, 1
    sigma of each mean by noise.

    With |w| the mean's length and Omega Earth's rate, the mean of exp(w.e Omega/v) over directions
    e is sinh(z)/z with z = |w| Omega/v.
    """
    length = float(np.linalg.norm(rate))

    def log_likelihood(v: np.ndarray) -> np.ndarray:
        """The mean is normal about Earth's rate, of any direction."""
        z = np.maximum(length * EARTH_RATE / v, 1e-12)
        apart = -0.5 * (length - EARTH_RATE) ** 2 / v - 1.5 * np.log(v)
        return np.asarray(apart + np.log(-np.expm1(-2 * z) / (2 * z)))

    return _posterior(log_likelihood, np.array([length, EARTH_RATE]), error)


def of_accel(force: np.ndarray, latitude: float) -> BiasSize:
    """The size of the accelerometers' bias, m/s^2, from the size of a resting recording's mean
    force. force : (3,), m/s^2; latitude : rad."""
    off = float(np.linalg.norm(force) - normal_gravity(latitude))
    return _posterior(lambda v: -0.5 * (off**2 / v + np.log(v)), np.array([off]), _HEIGHT_UNKNOWN)


def _posterior(
    log_likelihood: Callable[[np.ndarray], np.ndarray], sizes: np.ndarray, error: float
) -> BiasSize:
    """The posterior of the bias's size under a prior that is flat in its logarithm.

    log_likelihood : as a function of variances, of bias and noise of the mean together; sizes : the
    figures that bound the grid of sizes; error : 1 sigma of the mean by noise.
    """
    largest = max(float(np.abs(sizes).max()), error, 1e-12)
    least = max(error, 1e-5 * largest) / 3
    log_size = np.linspace(np.log(least), np.log(100 * largest), _GRID)
    value = log_likelihood(np.exp(2 * log_size) + error**2)
    weight = np.cumsum(np.exp(value - value.max()))
    low, middle, high = np.exp(np.interp([0.025, 0.5, 0.975], weight / weight[-1], log_size))
    return BiasSize(float(middle), float(low), float(high))
