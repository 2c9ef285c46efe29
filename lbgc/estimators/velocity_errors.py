"""What a sensor's own errors make of a fit to velocity, which that velocity does not show.

With gyros that err by e and accelerometers by d, C from the body to axes that do not turn, and
specific force close to -g along down,

    velocity error = integral of C d + integral of (integral of C e) x (0, 0, -g)

Both are smooth: what a fit takes for north it leaves nothing of. So a fit's sigma has them from the
sensor's model. What does not add up (counting, tones) is left to the residuals, which show it.
"""

import numpy as np
import scipy.linalg

from lbgc.data.windows import Windows
from lbgc.estimators import reduced_order
from lbgc.sensor import gaussian
from lbgc.sensor.imu import ImuModel, Triad

_BLOCKS = 60
"""Weights over a window are as smooth as a cubic."""


def variance(windows: Windows, imu: ImuModel, c_ib: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Variance of g' r, (W,), (m/s)^2 times the square of g's unit, r the horizontal velocity that
    the sensors err by.

    c_ib : (W, T, 3, 3), the body's attitude at the samples; g : (W or 1, T, 2), along x and y of i.
    """
    n, dt = g.shape[1], 1 / windows.rate_hz
    block = -(-n // _BLOCKS)
    starts = np.arange(0, n, block)
    h = block * dt
    force = _summed(g) * dt  # by each sample's specific force, and below by its rate
    x, y = np.moveaxis(_summed(force) * dt, -1, 0)
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
        total += _of_triad(triad, law, np.add.reduceat(turned, starts, axis=1), h)
    return total


def _summed(weights: np.ndarray) -> np.ndarray:
    """What each sample's increment is weighted by, where the sums so far are by these."""
    return np.asarray(np.cumsum(weights[:, ::-1], axis=1)[:, ::-1])


def _of_triad(triad: Triad, law: reduced_order.Drift, weights: np.ndarray, h: float) -> np.ndarray:
    """weights : (W, n, 3), of means over h seconds; law : without first-order processes, which are
    taken exactly."""
    n = weights.shape[1]
    later = _summed(weights)
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
