"""Poses at rest as an estimator sees them: means over parts of each rest, their levels, and the
turns between them.

Rests are cut on one fine grid of blocks over the whole session, so that a noise that wanders has
one covariance over all of them. Where the log is unbroken, the gyros are integrated from each rest
to the next. The rotation M that they tell, from the body's axes in the next pose to those in this
one, makes L_p M L_p+1' a rotation by the angle Delta about the vertical, but for small errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from lbgc.data.poses import Poses
from lbgc.errors import require
from lbgc.frames import euler_to_matrix, level, rotation_matrix, rotation_vector
from lbgc.sensor.imu import ImuModel

_FINE = 2000
"""Most fine blocks of a session."""
_PARTS = 480
"""Most parts of a session; each rest has four at the least, if it has as many blocks."""
_TOLD = 0.2
"""rad: largest turn within a sample, at which its mean rate still tells the turn."""
_FULL = 0.999
"""Share of a range from which on a gyro saturates."""


@dataclass(frozen=True)
class Layout:
    """When a session's rests were; what follows from it and a sensor is computed once."""

    interval: float
    """s, of a fine block"""
    rests: tuple[tuple[int, int], ...]
    """The first fine block of each of P poses, and the one after its last"""

    @property
    def count(self) -> int:
        """Number of fine blocks from the session's start to the last rest's end."""
        return self.rests[-1][1]

    @property
    def duration_s(self) -> float:
        """Time from the session's start to the last rest's end."""
        return self.count * self.interval

    def parts(self) -> list[np.ndarray]:
        """The edges of each pose's parts, in fine blocks."""
        most = max(4, _PARTS // len(self.rests))
        return [
            np.linspace(first, last, min(last - first, most) + 1).round().astype(int)
            for first, last in self.rests
        ]

    def averaged(self) -> np.ndarray:
        """Matrix, (n, count), that averages the fine blocks' means to the parts'."""
        edges = [pair for own in self.parts() for pair in pairwise(own.tolist())]
        matrix = np.zeros((len(edges), self.count))
        for row, (first, last) in zip(matrix, edges, strict=True):
            row[first:last] = 1 / (last - first)
        return matrix

    def pose(self) -> np.ndarray:
        """The number of each part's pose, (n,)."""
        return np.repeat(np.arange(len(self.rests)), [len(own) - 1 for own in self.parts()])


@dataclass(frozen=True, eq=False)
class Turn:
    """What gyros tell of the turn from a pose to the next, as sums over its time in the axes of
    the body in the first: M is the rotation from the body's axes at a time to those."""

    matrix: np.ndarray
    """(3, 3), M at the end"""
    seconds: float
    one: np.ndarray
    """(3, 3), integral of M, s"""
    truth: np.ndarray
    """(3, 3, 3), integral of M[:, i] times the rate about axis j, rad"""
    force: np.ndarray
    """(3, 3, 3), likewise the specific force, m/s"""
    square: np.ndarray
    """(3, 3, 3), integral of M[:, i] M[:, i]' of each axis i, s"""
    taken: np.ndarray
    """(3,), rad, integral of M times what was taken off the gyros before they were integrated"""
    warmth: float
    """K, mean rise of the temperature since power-up"""


@dataclass(frozen=True, eq=False)
class SensorErrors:
    """What a sensor errs by, as far as it is known: gyros bias + gain rate + by_force force,
    accelerometers accel_bias + accel_gain force."""

    bias: np.ndarray
    """(3,), rad/s"""
    gain: np.ndarray
    """(3, 3)"""
    by_force: np.ndarray
    """(3, 3), rad/s by m/s^2"""
    accel_bias: np.ndarray
    """(3,), m/s^2"""
    accel_gain: np.ndarray
    """(3, 3)"""

    @classmethod
    def of(cls, values: np.ndarray) -> "SensorErrors":
        """The errors that one row has, (ERRORS,), in the order above."""
        parts = np.split(values, [3, 12, 21, 24])
        return cls(*(own if len(own) == 3 else own.reshape(3, 3) for own in parts))

    def undone(self, gyro: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates and specific forces, (m, 3) both, of which the sensor has printed these."""
        force = np.linalg.solve(np.eye(3) + self.accel_gain, (accel - self.accel_bias).T)
        rate = np.linalg.solve(np.eye(3) + self.gain, (gyro - self.bias).T - self.by_force @ force)
        return rate.T, force.T


ERRORS = 33
"""Numbers that a sensor's errors have."""


@dataclass(frozen=True, eq=False)
class Held:
    """P poses of one session."""

    layout: Layout
    base: np.ndarray
    """(P, 3, 3), rotation L from the body's axes to level ones, by the mean specific force"""
    latitude: float | None
    """rad"""
    turns: tuple[Turn | None, ...]
    """(P - 1,), None where the turn is not known"""
    body: np.ndarray
    """(6, n), means over the parts: rate, rad/s, and specific force, m/s^2"""
    log: Poses | None = None
    """What they are of, where it was recorded"""

    @property
    def count(self) -> int:
        """Number of poses."""
        return len(self.base)

    @property
    def downs(self) -> np.ndarray:
        """(P, 3), the direction of down in the body's axes."""
        return self.base[:, 2]

    @property
    def linked(self) -> np.ndarray:
        """Numbers of the poses from which the turn to the next is known."""
        return np.flatnonzero([turn is not None for turn in self.turns])

    def between(self) -> np.ndarray:
        """(len(linked), 3, 3): the known turns, from level axes of the next pose to those of this
        one."""
        return np.array(
            [
                self.base[p] @ turn.matrix @ self.base[p + 1].T
                for p, turn in enumerate(self.turns)
                if turn is not None
            ]
        ).reshape(-1, 3, 3)


def held(poses: Poses, imu: ImuModel) -> Held:
    """The poses of a log. Raises InputError where it has none, or values are missing in a rest."""
    require(len(poses.rests) > 0, "poses", len(poses.rests), "must be one or more: no rest is here")
    size = _size(poses.rests)
    rests = tuple((-(-first // size), last // size) for first, last in poses.rests)
    short = min(last - first for first, last in poses.rests) / poses.rate_hz
    why = f"is too short against the session, {poses.rests[-1][1] / poses.rate_hz:.4g} s"
    require(min(last - first for first, last in rests) > 0, "dwell_s", short, why)
    layout = Layout(size / poses.rate_hz, rests)
    both = np.concatenate([poses.gyro, poses.accel], axis=1).astype(float)
    means = [
        both[a * size : b * size].mean(axis=0)
        for own in layout.parts()
        for a, b in pairwise(own.tolist())
    ]
    body = np.array(means).T
    require(bool(np.isfinite(body).all()), "poses", "NaN", "must have every sample of each rest")
    weight = np.array([b - a for own in layout.parts() for a, b in pairwise(own.tolist())])
    force = np.array(
        [
            np.average(body[3:, layout.pose() == p], axis=1, weights=weight[layout.pose() == p])
            for p in range(len(rests))
        ]
    )
    base = euler_to_matrix(*level(force), 0.0)
    found = Held(layout, base, poses.latitude, (None,) * (len(rests) - 1), body, poses)
    known = np.pad(body[:3].mean(axis=1), (0, ERRORS - 3))
    return anew(found, imu, base, SensorErrors.of(known))


def anew(of: Held, imu: ImuModel, base: np.ndarray, known: SensorErrors) -> Held:
    """Poses with other levels, base (P, 3, 3), and with turns that the gyros tell without what is
    known of their errors by now: turns are linear in small errors alone."""
    log = of.log
    if log is None or not log.integrated:
        return replace(of, base=base)
    size = round(of.layout.interval * log.rate_hz)
    edges = [(a * size, b * size) for a, b in of.layout.rests]
    turns = tuple(
        _turn(log, imu, before, after, known) for (_, before), (after, _) in pairwise(edges)
    )
    return replace(of, base=base, turns=turns)


def _size(rests: Sequence[tuple[int, int]]) -> int:
    """Samples in a fine block: the smallest that makes few enough blocks of the session, or up to
    twice that where every rest then begins and ends with a block."""
    least = max(1, -(-rests[-1][1] // _FINE))
    edges = np.array(rests).ravel()
    whole = [k for k in range(least, 2 * least + 1) if not (edges % k).any()]
    return whole[0] if whole else least


def _turn(poses: Poses, imu: ImuModel, first: int, last: int, known: SensorErrors) -> Turn | None:
    """The turn over samples first to last; None where the gyros do not tell it: a sample is
    missing, at the end of the range, or turns too far."""
    gyro, force = (x[first:last].astype(float) for x in (poses.gyro, poses.accel))
    dt = 1 / poses.rate_hz
    if not (np.isfinite(gyro).all() and np.isfinite(force).all()):
        return None
    most = np.abs(gyro).max(initial=0.0)
    if imu.gyro.range is not None and most >= _FULL * imu.gyro.range:
        return None
    rate, force = known.undone(gyro, force)
    if np.linalg.norm(rate, axis=1).max(initial=0.0) * dt > _TOLD:
        return None
    start = (first * dt, last * dt)
    return _integrated(rate, force, dt, known, _warmth(imu, *start))


def _warmth(imu: ImuModel, start_s: float, end_s: float) -> float:
    """Mean rise of the temperature, K, between two times since the session's start."""
    return float(imu.warming.rise_at(np.linspace(start_s, end_s, 33)).mean())


def _integrated(
    rate: np.ndarray, force: np.ndarray, dt: float, known: SensorErrors, warmth: float
) -> Turn:
    """The sums of a turn. rate, force : (m, 3), each a mean over dt, s."""
    steps = rotation_matrix(rate * dt)
    half = rotation_matrix(rate * dt / 2)
    M, at = np.empty((len(rate), 3, 3)), np.eye(3)
    for k, step in enumerate(steps):
        M[k] = at @ half[k]
        at = at @ step
    one = M.sum(axis=0) * dt
    truth, by_force = (np.einsum("kai,kj->aij", M, x) * dt for x in (rate, force))
    taken = one @ known.bias
    taken += np.einsum("aij,ij->a", truth, known.gain)
    taken += np.einsum("aij,ij->a", by_force, known.by_force)
    square = np.einsum("kai,kbi->iab", M, M) * dt
    return Turn(at, len(rate) * dt, one, truth, by_force, square, taken, warmth)


def planned(
    attitudes: np.ndarray,
    dwell_s: float,
    handling_s: float,
    latitude: float | None,
    gravity: float,
    imu: ImuModel,
    integrated: bool,
) -> Held:
    """P poses before anything is recorded. attitudes : (P, 3, 3), C_nb; handling_s : s, between
    rests, in which the body turns evenly, by the shortest way; gravity : m/s^2."""
    step = _whole(dwell_s, handling_s)
    size, gap = round(dwell_s / step), round(handling_s / step)
    coarse = max(1, -(-(size + gap) * len(attitudes) // _FINE))
    while coarse > 1 and (size % coarse or gap % coarse):
        coarse -= 1
    size, gap = size // coarse, gap // coarse
    rests = tuple((p * (size + gap), p * (size + gap) + size) for p in range(len(attitudes)))
    layout = Layout(step * coarse, rests)
    down = attitudes[:, 2]
    base = euler_to_matrix(*level(-gravity * down), 0.0)
    turns: list[Turn | None] = [None] * (len(attitudes) - 1)
    if integrated:
        for p, (this, then) in enumerate(pairwise(attitudes)):
            turns[p] = _evenly(this, then, handling_s, gravity, imu, layout.interval * rests[p][1])
    body = np.zeros((6, len(layout.pose())))
    return Held(layout, base, latitude, tuple(turns), body)


def _evenly(
    this: np.ndarray, then: np.ndarray, seconds: float, gravity: float, imu: ImuModel, at_s: float
) -> Turn:
    """An even turn from one attitude to the next, in so many seconds, from a time on, s."""
    count = 200
    rate = np.tile(shortest(this.T @ then) / seconds, (count, 1))
    dt = seconds / count
    on = rotation_matrix(rate * (np.arange(count) + 0.5)[:, None] * dt)
    force = -gravity * (this @ on)[:, 2]
    none = SensorErrors.of(np.zeros(ERRORS))
    return _integrated(rate, force, dt, none, _warmth(imu, at_s, at_s + seconds))


def shortest(matrix: np.ndarray) -> np.ndarray:
    """The rotation vector, (3,), of a rotation, (3, 3), by half a turn or less: as
    `lbgc.frames.rotation_vector`, which does not tell half a turn from none."""
    cosine = min(max((float(np.trace(matrix)) - 1) / 2, -1.0), 1.0)
    if cosine > -0.99:
        return rotation_vector(matrix)
    outer = ((matrix + matrix.T) / 2 - cosine * np.eye(3)) / (1 - cosine)
    axis = outer[:, int(np.argmax(np.diag(outer)))]
    axis = axis / np.linalg.norm(axis)
    x, y, z = matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]
    sine = float(axis @ (x, y, z)) / 2
    return np.asarray(axis * np.arctan2(sine, cosine))


def _whole(dwell_s: float, handling_s: float) -> float:
    """The largest step, s, in whole numbers of which both are, or that comes close."""
    for parts in range(30, 241):
        step = dwell_s / parts
        if handling_s == 0 or abs(handling_s / step - round(handling_s / step)) < 1e-9:
            return step
    return dwell_s / 60
