"""What is known of one unit: the law of its lasting errors after recordings with known headings.

A sensor's model says from which law a unit's errors were drawn: each coefficient Normal(0,
sigma^2), independently (see lbgc.sensor.errors). Recordings of one unit turn this prior into a
posterior, Normal(mean, covariance), whose coefficients depend on each other: a bias and a scale
factor that were seen at one heading alone are known in sum. The mean is taken off what the sensor
prints, and the covariance takes the place of the prior's.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lbgc.sensor.errors import Drawn, Proportional, Triple
from lbgc.sensor.imu import ImuModel, Triad
from lbgc.sensor.known import Coefficient, Known

TRIADS = ("gyro", "accel")


def coefficients(imu: ImuModel, *lifetimes: str) -> dict[Coefficient, float]:
    """A sensor's coefficients of these lifetimes that are not zero, and 1 sigma of each, SI."""
    return {
        Coefficient(name, error.name, i, j): sigma
        for name, triad in _triads(imu)
        for error in triad.lasting(*lifetimes)
        for i, j, sigma in error.sizes
    }


def _triads(imu: ImuModel) -> Iterator[tuple[str, Triad]]:
    return zip(TRIADS, (imu.gyro, imu.accel), strict=True)


def lasting(imu: ImuModel, known: Known) -> Known:
    """What is known of the unit alone, without any power-up's own errors."""
    own = coefficients(imu, "unit")
    kept = [k for k, c in enumerate(known.coefficients) if c in own]
    which = tuple(known.coefficients[k] for k in kept)
    return Known(which, known.mean[kept], known.covariance[np.ix_(kept, kept)])


def told(imu: ImuModel, known: Known) -> ImuModel:
    """The sensor's model when this is known, and the means are taken off what it prints."""
    left = dict(zip(known.coefficients, known.sigma.tolist(), strict=True))

    def of_triad(name: str, triad: Triad) -> Triad:
        drawn = []
        for error in triad.drawn:
            own = {
                (c.i, c.j): s for c, s in left.items() if (c.triad, c.error) == (name, error.name)
            }
            x, y, z = (_row(error, own, i) for i in range(3))
            drawn.append(replace(error, left=(x, y, z)) if own else error)
        return replace(triad, drawn=tuple(drawn))

    gyro, accel = (of_triad(name, triad) for name, triad in _triads(imu))
    return replace(imu, gyro=gyro, accel=accel, known=known)


def drawn(imu: ImuModel, known: Known, values: np.ndarray) -> tuple[Drawn, Drawn]:
    """What gyros and accelerometers have where the coefficients have these values, (r,), and
    others of the sensor's lasting errors none."""
    gyro, accel = (triad.none_drawn() for _, triad in _triads(imu))
    _put(known, values, gyro, accel)
    return gyro, accel


def redraw(known: Known, rng: np.random.Generator, gyro: Drawn, accel: Drawn) -> None:
    """Draw, of what lasts of a unit's errors, those coefficients anew whose law is known, and put
    them in their places."""
    normal = known.correlated @ rng.standard_normal(len(known.mean))
    _put(known, known.mean + known.sigma * normal, gyro, accel)


def _put(known: Known, values: np.ndarray, gyro: Drawn, accel: Drawn) -> None:
    """Give the coefficients these values, (r,)."""
    triads = dict(zip(TRIADS, (gyro, accel), strict=True))
    for c, value in zip(known.coefficients, values, strict=True):
        own = triads[c.triad][c.error]
        own[c.i if own.ndim == 1 else (c.i, c.j)] = value


def _row(error: Proportional, own: dict[tuple[int, int], float], i: int) -> Triple:
    """1 sigma of what is left of the coefficients of axis i."""
    x, y, z = (own.get((i, j), float(error.sigma[i, j])) for j in range(3))
    return x, y, z
