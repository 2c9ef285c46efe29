"""The true rate and specific force of an IMU whose pose is known at every physics step, as means
over its samples' intervals.

Poses are given in a frame A that rests on Earth: at an instant t_k the attitude is C_k (body to A)
and the site is at x_k; the floor carries both along at a velocity u_k besides. Over a step of
length h

    angle increment     integral of omega_ab_b = the rotation vector of C_k' C_(k+1)
    velocity increment  integral of C' a       = h (C_k' a_k + C_(k+1)' a_(k+1))/2
                                                 + (C_k' + C_(k+1)')/2 (u_(k+1) - u_k)

with a_k = (x_(k+1) - 2 x_k + x_(k-1))/h^2, the acceleration by which the physics moved the site.
The first is exact where the axis of rotation is constant during a step, the second to the square
of the angle turned in a step. A sample sums its steps. Earth's rate, gravity and the Coriolis force
enter linearly, by three more means over the sample, so that one motion serves every latitude and
azimuth:

    omega_ib_b = rate + mean(C)' Omega
    f_ib_b     = acceleration - mean(C)' g + coriolis Omega,   coriolis = mean(C' (-2 [v x]))
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from lbgc.frames import rotation_vector

Arrays = TypeVar("Arrays")


@dataclass(frozen=True)
class Felt:
    """The motion of an IMU as means over n samples' intervals, (t_k - dt, t_k], from which rate and
    force follow for any Earth rate and gravity; n = 1 where nothing moves."""

    attitude: np.ndarray
    """(n, 3, 3), mean of C"""
    rate: np.ndarray
    """(n, 3), rad/s, mean rate of the body relative to A, along the body's axes"""
    acceleration: np.ndarray
    """(n, 3), m/s^2, mean acceleration of the site relative to A, along the body's axes"""
    coriolis: np.ndarray
    """(n, 3, 3), m/s, whose product with Earth's rate is the Coriolis term of the force, along the
    body's axes"""

    def omega(self, earth_rate: np.ndarray) -> np.ndarray:
        """The true rate omega_ib_b, (3, n), rad/s. earth_rate : (3,), rad/s, in A."""
        return (self.rate + self.in_body(earth_rate)).T

    def force(self, earth_rate: np.ndarray, gravity: np.ndarray) -> np.ndarray:
        """The true specific force f_ib_b, (3, n), m/s^2. earth_rate, gravity : (3,), rad/s and
        m/s^2, in A."""
        felt = self.acceleration - self.in_body(gravity) + self.coriolis @ earth_rate
        return felt.T

    def averaged(self, block: int) -> "Felt":
        """Means over blocks of `block` samples; one sample that stands for all is returned as it
        is."""
        if len(self.rate) == 1 or block == 1:
            return self
        return Felt(*(v.reshape(-1, block, *v.shape[1:]).mean(axis=1) for v in vars(self).values()))

    def repeated(self, count: int) -> "Felt":
        """One sample repeated `count` times."""
        return Felt(*(np.repeat(values, count, axis=0) for values in vars(self).values()))

    def in_body(self, vector: np.ndarray) -> np.ndarray:
        """A constant vector (3,) in A as means along the body's axes, (n, 3)."""
        return np.einsum("nij,i->nj", self.attitude, vector)


def resting(attitude: np.ndarray) -> Felt:
    """The motion of a body at rest in A with this attitude (3, 3): one sample that stands for
    all."""
    return Felt(attitude[None], np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3, 3)))


def felt(
    attitude: np.ndarray,
    place: np.ndarray,
    step: float,
    steps: int,
    carried: np.ndarray | None = None,
) -> Felt:
    """The motion over n samples, from the poses at t_-1, t_0, ... t_m, t_(m+1), with m = n x steps.

    attitude : (m + 3, 3, 3), C; place : (m + 3, 3), m, x; step : s; steps : the number of steps in
    a sample; carried : (m + 3, 3), m/s, u, None for zero.
    """
    inner = attitude[1:-1]
    to_body = np.swapaxes(inner, -1, -2)
    middle = (to_body[:-1] + to_body[1:]) / 2
    turned = rotation_vector(to_body[:-1] @ inner[1:])
    pushed = np.einsum("kij,kj->ki", to_body, np.diff(place, n=2, axis=0) / step**2)
    gained = step * (pushed[:-1] + pushed[1:]) / 2
    velocity = np.diff(place[1:-1], axis=0) / step
    if carried is not None:
        u = carried[1:-1]
        gained += np.einsum("kij,kj->ki", middle, np.diff(u, axis=0))
        velocity += (u[:-1] + u[1:]) / 2

    def mean(values: np.ndarray) -> np.ndarray:
        """Means over each sample's steps, which are few, so that adding slices is fast."""
        return sum((values[k::steps] for k in range(1, steps)), values[::steps]) / steps

    return Felt(
        attitude=mean(np.swapaxes(middle, -1, -2)),
        rate=mean(turned) / step,
        acceleration=mean(gained) / step,
        coriolis=-2 * mean(_rows_cross(middle, velocity)),
    )


def _rows_cross(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """The products matrix [vector x], that is each row's cross product with the vector: (m, 3, 3)
    and (m, 3) -> (m, 3, 3)."""
    a, b, c = np.ascontiguousarray(matrix.transpose(2, 1, 0))  # (3, m) each, for long rows
    x, y, z = np.ascontiguousarray(vector.T)
    out = np.empty_like(matrix)
    for column, product in enumerate((b * z - c * y, c * x - a * z, a * y - b * x)):
        out[:, :, column] = product.T
    return out


def joined(parts: Sequence[Arrays]) -> Arrays:
    """Consecutive stretches as one. parts : dataclasses whose fields are arrays, such as `Felt`."""
    every = ([getattr(part, name) for part in parts] for name in vars(parts[0]))
    return type(parts[0])(*map(np.concatenate, every))
