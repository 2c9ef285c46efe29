"""Variance of the error that a sensor's own errors give a fit to velocity, unseen in its residuals.

With gyros that err by e and accelerometers by d, C from the body to axes that do not turn, and
specific force close to -g along down,

    velocity error = integral of C d + integral of (integral of C e) x (0, 0, -g)

Both are smooth: the fit takes them for north, and its residuals do not show them. So a fit's sigma
includes them by the sensor's model. Errors that do not accumulate (counting, tones) are left to the
residuals, which do show them.
"""

import numpy as np
import scipy.linalg

from lbgc.data.windows import Windows
from lbgc.estimators import reduced_order
from lbgc.sensor import gaussian
from lbgc.sensor.imu import ImuModel, Triad

_BLOCKS = 60
"""Largest number of blocks into which weights over a window, as smooth as a cubic, are summed."""


def variance(windows: Windows, imu: ImuModel, c_ib: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Variance of g' r, (W,), (m/s)^2 times the square of g's unit, r the error of horizontal
    velocity due to the sensors' errors.

    c_ib : (W, T, 3, 3), the body's attitude at the samples; g : (W or 1, T, 2), along x and y of i.
    """
    n, dt = g.shape[1], 1 / windows.rate_hz
    block = -(-n // _BLOCKS)
    starts = np.arange(0, n, block)
    h = block * dt
    force = _summed_to_end(g) * dt  # weights of each sample's specific force; below, of its rate
    x, y = np.moveaxis(_summed_to_end(force) * dt, -1, 0)
    along_force = np.pad(force, ((0, 0), (0, 0), (0, 1)))
    along_rate = np.stack([y, -x, np.zeros_like(x)], axis=-1)
    total = np.zeros(len(windows))
    when = reduced_order.When.of(windows)
    for triad, law, weights in (
        (imu.gyro, reduced_order.of_gyro(imu, when, processes=False),
         along_rate * when.gravity[:, None, None]),
        (imu.accel, reduced_order.of_accel(imu, when, processes=False), along_force),
    ):  # fmt: skip
        turned = np.einsum("wtij,wti->wtj", c_ib, np.broadcast_to(weights, c_ib.shape[:-1]))
        total += _triad_variance(triad, law, np.add.reduceat(turned, starts, axis=1), h)
    return total


def _summed_to_end(weights: np.ndarray) -> np.ndarray:
    """Weights of the samples' increments that are equivalent to these weights of their cumulative
    sums: sums from each sample to the end, along axis 1."""
    return np.asarray(np.cumsum(weights[:, ::-1], axis=1)[:, ::-1])


def _triad_variance(
    triad: Triad, law: reduced_order.Drift, weights: np.ndarray, h: float
) -> np.ndarray:
    """Variance, (W,), that one triad's errors contribute.

    weights : (W, n, 3), of means over h seconds; law : the reduced model without first-order
    processes, which are taken exactly.
    """
    n = weights.shape[1]
    later = _summed_to_end(weights)
    total = np.einsum("wj,wj->w", later[:, 0] ** 2, law.constant)
    total += np.einsum("wtj,wj->w", later**2, law.walk) * h
    for axis in range(3):
        row = np.zeros(n)
        row[0] = law.white[axis] / h
        wandering = tuple(term for term in triad.terms[axis] if term.processes)
        if wandering:
            row += gaussian.autocovariance_of_means(wandering, n, h)
        own = weights[..., axis]
        total += np.einsum("wt,wt->w", own @ scipy.linalg.toeplitz(row), own)
    return np.asarray(total)
