"""The steps in which a Kalman filter goes through windows.

A step is some samples. Over it the gyros are integrated to a rotation and the accelerometers to a
velocity, and the plate rests, turns evenly, or does neither.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.data.windows import Windows
from lbgc.estimators.estimate import refusal
from lbgc.estimators.plate import mean_angle, tilt_of, usable
from lbgc.estimators.sway_noise import velocity_noise
from lbgc.frames import DOWN, rotation, rotation_matrix
from lbgc.sensor.imu import ImuModel

_CREEPS = np.deg2rad(0.05)
"""rad/s, below which a plate counts as resting on a moving base, where its encoder never shows it
quite at rest."""


@dataclass(frozen=True)
class Steps:
    """W windows in n steps each."""

    interval: float
    """s, duration of a step"""
    turned: np.ndarray
    """(W, n, 3, 3): rotation from the body's axes at a step's end to those at its start"""
    push: np.ndarray
    """(W, n, 3), m/s: the integral of specific force in the body's axes at the step's start"""
    mean_push: np.ndarray
    """(W, n, 3), m/s: the mean over the step's samples of that integral up to each of them; on a
    base that rests, the integral up to the step's end"""
    mean_time: float
    """s, time since the step's start to which `mean_push` belongs"""
    rate: np.ndarray
    """(W, n, 3), rad/s, mean over the step"""
    force: np.ndarray
    """(W, n, 3), m/s^2, mean over the step"""
    angle: np.ndarray
    """(W, n), rad, of the plate at the step's middle"""
    half: np.ndarray
    """(W, n), rad, angle by which the plate turns in half a step, if it turns evenly"""
    even: np.ndarray
    """bool (W, n): the plate rests, or turns evenly on a carousel"""
    rests: np.ndarray
    """bool (W, n): the plate rests; false throughout where the base is taken to move"""
    unrecorded: np.ndarray
    """bool (W, n): samples of the step are missing, or it is of a slew about a level axis, where
    neither forces nor the encoder hold the heading that gyros carry on; its integrals are then
    zero, and its mean force NaN"""
    axis: int = DOWN
    """The body's axis about which the plate turns"""

    @property
    def carried(self) -> np.ndarray:
        """The angle by which the plate turns, (W, n), rad, over all the steps without a record that
        end with this one; zero for the others."""
        found = np.zeros(self.angle.shape)
        start, end = self.angle - self.half * self.even, self.angle + self.half * self.even
        for row, none in enumerate(self.unrecorded):
            edges = np.flatnonzero(np.diff(np.r_[False, none, False].astype(np.int8)))
            for first, after in zip(edges[::2], edges[1::2], strict=True):
                if first > 0 and after < len(none):
                    found[row, after - 1] = start[row, after] - end[row, first - 1]
        return found


def cut_steps(windows: Windows, imu: ImuModel, size: int, moving: bool, name: str) -> Steps:
    """Windows in steps of `size` samples each; samples left over at the end are dropped.

    moving : whether the base is taken to move; name : the estimator's. Raises InputError where the
    plate never rests or turns evenly, or where the base moves and something was not recorded.
    """
    w, n, dt = len(windows), windows.gyro.shape[1] // size, 1 / windows.rate_hz
    cut = n * size
    gyro, accel = (
        np.asarray(v[:, :cut], float).reshape(w, n, size, 3) for v in (windows.gyro, windows.accel)
    )
    none = np.asarray(windows.unrecorded[:, :cut].reshape(w, n, size).any(axis=2))
    angle = mean_angle(windows.plate_angle, windows.rate_hz, imu.dt)
    angle = angle[:, :cut].reshape(w, n, size).mean(axis=2)
    even, rests = np.zeros((w, n), bool), np.zeros((w, n), bool)
    for row in range(w):
        if moving:
            even[row] = _even(angle[row], size * dt)
            continue
        even[row], resting = usable(angle[row].round(9))
        even[row] &= ~none[row]
        rests[row] = even[row] & resting
    if windows.axis != DOWN:
        none = none | ~even
    if none.any():
        if moving:
            what = "moves while something was not recorded: the gyros cannot carry the attitude on"
            raise refusal(name, "the base", "", what)
        gyro, accel = (np.where(none[..., None, None], 0.0, v) for v in (gyro, accel))
    turned = np.broadcast_to(np.eye(3), (w, n, 3, 3))
    push, total = np.zeros((w, n, 3)), np.zeros((w, n, 3))
    for k in range(size):
        force = accel[:, :, k] + np.cross(gyro[:, :, k] * dt, accel[:, :, k]) / 2
        push += np.einsum("wnij,wnj->wni", turned, force) * dt
        total += push
        turned = turned @ rotation_matrix(gyro[:, :, k] * dt)
    if not even.any(axis=1).all():
        raise refusal(name, "the plate", "", "never rests or turns steadily in a window")
    half = np.gradient(angle, axis=1) / 2 if n > 1 else np.zeros((w, 1))
    half[rests] = 0.0
    means = gyro.mean(axis=2), np.where(none[..., None], np.nan, accel.mean(axis=2))
    # Rounding to counts and fast sways scatter single samples of velocity far more than their mean.
    mean_push, mean_time = (total / size, (size + 1) / 2 * dt) if moving else (push, size * dt)
    return Steps(size * dt, turned, push, mean_push, mean_time, *means, angle, half, even, rests,
                 none, windows.axis)  # fmt: skip


def _even(angle: np.ndarray, interval: float) -> np.ndarray:
    """In which steps a plate on a moving base is steady, bool (n,): those in which it turns evenly
    if these are most, else those in which it rests. angle : (n,), rad; interval : s."""
    rate = np.gradient(angle, interval) if len(angle) > 1 else np.zeros(1)
    rests = np.abs(rate) < _CREEPS
    turns = ~rests & (np.abs(np.gradient(rate)) < _CREEPS)
    return np.asarray(turns if turns.mean() > 0.5 else rests)


def coarse(steps: Steps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The base's attitude, (W, 3, 3), by the mean force in its own axes; the body's attitude at the
    start of the first even step, (W, 3, 3); and the number of that step, (W,). Attitudes are
    relative to n', the level axes of lbgc.estimators.kalman."""
    row, first = np.arange(len(steps.even)), np.argmax(steps.even, axis=1)
    base = tilt_of(steps.angle, steps.force, steps.axis)
    at = rotation((steps.angle - steps.half)[row, first], steps.axis)
    return base, base @ at, first


def sway(steps: Steps, name: str) -> np.ndarray:
    """Variance of the velocity, (W,), (m/s)^2, that zero-velocity updates are to assume on a base
    that sways, the accelerometers' noise included: see lbgc.estimators.sway_noise."""
    _, c_nb, first = coarse(steps)
    w, n = steps.angle.shape
    velocity, at = np.empty((w, n, 3)), np.zeros((w, 3))
    for k in range(n):
        velocity[:, k] = at + np.einsum("wij,wj->wi", c_nb, steps.mean_push[:, k])
        at = at + np.einsum("wij,wj->wi", c_nb, steps.push[:, k])
        c_nb = np.where((k < first)[:, None, None], c_nb, c_nb @ steps.turned[:, k])
    noise = np.empty(w)
    for row in range(w):
        columns, g = _undisturbed_velocities(steps, row, name)
        noise[row] = velocity_noise(velocity[row, :, :2], columns, g)
    return noise


def _undisturbed_velocities(steps: Steps, row: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Courses that a velocity can take in time without a sway, and those that north causes.

    The first, (n, p), are for each stretch of even steps a constant, a line (a tilt) and a parabola
    (a rate), and on a carousel the plate's cosine and sine (an accelerometer's bias). The second,
    (n, p'), orthonormal, are the rates' alone, which an error of north resembles.
    """
    even = steps.even[row]
    part = np.cumsum(np.diff(even, prepend=False) & even)
    columns, of_rate = [], []
    for segment in range(1, part[-1] + 1):
        inside = even & (part == segment)
        t = np.linspace(-1, 1, int(inside.sum()))
        powers = np.stack([np.ones_like(t), t, t**2], axis=1)
        if len(t) <= 3:
            powers = np.eye(len(t))
        every = np.zeros((len(even), powers.shape[1]))
        every[inside] = powers
        columns.append(every)
        if len(t) > 3:
            of_rate.append(np.linalg.qr(every)[0][:, 2])
    if np.ptp(steps.angle[row][even]) > np.pi / 2 and part[-1] == 1:
        turn = np.stack([np.cos(steps.angle[row]), np.sin(steps.angle[row])], axis=1)
        columns.append(turn * even[:, None])
    if not of_rate:
        raise refusal(name, "the base", "", "moves, and the plate rests for too short a time")
    return np.concatenate(columns, axis=1), np.stack(of_rate, axis=1)
