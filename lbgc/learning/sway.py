"""Features for a base that sways, from samples fast enough to resolve the sway.

As in velocity alignment (lbgc.estimators.inertial), forces are integrated in axes that do not
rotate in inertial space, where gravity's direction turns with Earth and bends velocity: steadily
eastward, so that the coefficient of the second Legendre polynomial over a window of T seconds is

    g Omega cos(lat) T^2/12.

A network is given velocity in units of a fifth of that, which is the second Legendre moment, in
level axes, as means short enough for a window to have many. Beside it stands the horizontal rate of
the body, times a lever arm of a metre, in the same unit: a body that rocks about an axis below the
sensor moves it to and fro, as the gyros show. None of these features depends on a known heading; a
network that has a base is given them less what that base's heading explains, in axes that are
turned north by it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbgc.data.record import SAMPLED, nearest_samples
from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, normal_gravities
from lbgc.errors import InputError
from lbgc.estimators.inertial import apparent_gravity, integrate
from lbgc.frames import euler_to_matrix, level, rotation_matrix, rotation_z, turned

LEAST_RATE_HZ = 50.0
"""Lowest rate of samples that shows a vehicle's sway as it is: at 10 Hz errors over 10 s are
threefold."""
PER_STEP = 5
"""Number of features a step: velocity and rate, two each, and the logarithm of the sway's rate."""
CONSTANTS = 2
"""Number of further features, of the whole window: its length, and the logarithm of the latitude's
cosine, which is in the unit of velocity."""
_ARM_M = 1.0
_STILL = 1e-5
"""RMS rate of a base that does not sway, rad/s."""
_MINUTE = 60.0
_LEFT_OVER = 0.02
"""Largest share of a window that may be left out at its end because it fills no whole step."""
_AT_ONCE = 200_000
"""Number of samples that are integrated together; it limits memory."""


@dataclass(frozen=True)
class Swaying:
    """Integrated and levelled velocity and rate of W windows, as means over T steps; in the unit
    that the module states."""

    velocity: np.ndarray
    """(W, T, 2), in level axes: the body's forward and right when the encoder reads zero"""
    rate: np.ndarray
    """(W, T, 2), times a lever arm of a metre, in the same axes"""
    liveliness: np.ndarray
    """(W, T), log10(1 + P)/2, P the horizontal rate's mean square in each step over (0.01
    mrad/s)^2"""
    bend: np.ndarray
    """(W, T, 2), north and east: the velocity of a body at rest, which gravity's turn causes"""

    @classmethod
    def of(cls, windows: Windows, rate_hz: float) -> "Swaying":
        """Integrate and level windows, with means at rate_hz. Raises InputError where samples are
        too slow, or where a mean is no whole number of samples."""
        windows = _whole_steps(windows, rate_hz)
        block = _block(windows, rate_hz)
        series = integrate(windows)
        before = series.before
        n, dt = windows.gyro.shape[1], 1 / windows.rate_hz
        t = (np.arange(n) + 1.0) * dt
        force = _slope(series.alpha, t)
        lean = euler_to_matrix(*level(force), 0.0)[:, None]
        zero = _encoder_zero(lean @ before, windows.plate_angle)
        to_level = np.swapaxes(rotation_z(zero), 1, 2)[:, None] @ lean
        rate = np.einsum("wtij,wtj->wti", to_level @ before, windows.gyro)[..., :2]
        velocity = np.einsum("wtij,wtj->wti", to_level, series.alpha)[..., :2]
        bend = _bend(windows, n, dt)
        unit = _unit(windows)[:, None, None]

        def means(values: np.ndarray) -> np.ndarray:
            w, _, *rest = values.shape
            return values.reshape(w, n // block, block, *rest).mean(axis=2)

        swing = rate - rate.mean(axis=1, keepdims=True)
        power = means(np.sum(swing**2, axis=-1)) / _STILL**2
        return cls(
            means(_straightened(velocity, t)) / unit,
            means(swing) * _ARM_M / unit,
            np.log10(1 + power) / 2,
            means(_straightened(bend, t)) / unit,
        )

    def features(self) -> np.ndarray:
        """Features of a network without a base, (W, T, 5)."""
        return np.concatenate([self.velocity, self.rate, self.liveliness[..., None]], axis=-1)

    def residual(self, base: np.ndarray) -> np.ndarray:
        """Features of a network with a base, (W, T, 5): less what the base's headings explain, in
        axes that are turned north by them. base : (W,), rad."""
        velocity = turned(self.velocity, base[:, None]) - self.bend
        rate = turned(self.rate, base[:, None])
        return np.concatenate([velocity, rate, self.liveliness[..., None]], axis=-1)


def inputs(
    windows: Windows, rate_hz: float, base: Callable[[Windows], np.ndarray] | None
) -> tuple[np.ndarray, np.ndarray]:
    """A network's features, float32 (W, T, PER_STEP + CONSTANTS), and the headings, (W,), rad, that
    it corrects: zero without a base. Raises InputError as `Swaying.of` does."""
    windows = _whole_steps(windows, rate_hz)
    size = max(1, _AT_ONCE // windows.gyro.shape[1])
    features, headings = [], []
    for first in range(0, len(windows), size):
        some = windows.rows(slice(first, first + size))
        seen = Swaying.of(some, rate_hz)
        heading = np.zeros(len(some)) if base is None else base(some)
        moving = seen.features() if base is None else seen.residual(heading)
        length = np.full(len(some), np.log2(windows.duration_s / _MINUTE) / 2)
        fixed = np.stack([length, np.log10(np.cos(some.latitude))], axis=-1)[:, None]
        held = np.broadcast_to(fixed, (*moving.shape[:2], CONSTANTS))
        features.append(np.concatenate([moving, held], axis=-1).astype(np.float32))
        headings.append(heading)
    return np.concatenate(features), np.concatenate(headings)


def _block(windows: Windows, rate_hz: float) -> int:
    """Number of samples in a step. Raises InputError where samples are slower than 50 Hz, or where
    steps are no whole number of samples or leave more than 2% of a window over."""
    if windows.rate_hz < LEAST_RATE_HZ * (1 - 1e-9):
        about = f"must be {LEAST_RATE_HZ:g} Hz or more: the model takes a base that sways"
        raise InputError("the data's rate", f"{windows.rate_hz:g}", "Hz", about)
    block = nearest_samples(1 / rate_hz, windows.rate_hz)
    samples = windows.gyro.shape[1]
    if block is None or samples % block > _LEFT_OVER * samples:
        about = f"must be whole steps of {1 / rate_hz:g} s, as each window of the model's"
        raise InputError("the data's rate", f"{windows.rate_hz:g}", "Hz", about)
    return block


def _whole_steps(windows: Windows, rate_hz: float) -> Windows:
    """The windows without the samples at the end that fill no whole step."""
    samples = windows.gyro.shape[1]
    used = samples - samples % _block(windows, rate_hz)
    values: dict[str, Any] = {name: getattr(windows, name)[:, :used] for name in SAMPLED}
    return replace(windows, **values)


def _slope(series: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Slope of a straight line through a series, (W, T, 3), by least squares, (W, 3): of velocity
    it is the mean force. t : (T,), s."""
    centred = t - t.mean()
    return np.asarray(np.einsum("t,wti->wi", centred, series) / np.sum(centred**2))


def _straightened(series: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The series less a straight line an axis, which holds the sway's velocity at the start and the
    error of levelling."""
    centred = (t - t.mean())[:, None]
    slope = _slope(series, t)[:, None]
    return np.asarray(series - series.mean(axis=1, keepdims=True) - centred * slope)


def _encoder_zero(attitude: np.ndarray, plate_angle: np.ndarray) -> np.ndarray:
    """Mean yaw of the plate's base, (W,), rad: the body's yaw less the plate's angle. attitude :
    (W, T, 3, 3), the body's."""
    yaw = np.arctan2(attitude[..., 1, 0], attitude[..., 0, 0]) - plate_angle
    return np.angle(np.mean(np.exp(1j * yaw), axis=1))


def _bend(windows: Windows, n: int, dt: float) -> np.ndarray:
    """North and east velocity of a body at rest, (W, n, 2), m/s, by gravity's turn, in the axes of
    n at the windows' middle."""
    beta = apparent_gravity(windows, n, dt)
    latitude = windows.latitude
    half = EARTH_RATE * windows.duration_s / 2
    axis = np.stack([np.cos(latitude), np.zeros_like(latitude), -np.sin(latitude)], axis=-1)
    middle = rotation_matrix(axis * half)  # C_in
    return np.asarray(np.einsum("wji,wtj->wti", middle, beta)[..., :2])


def _unit(windows: Windows) -> np.ndarray:
    """The unit of velocity, (W,), m/s: g Omega cos(lat) T^2/60, since the mean of velocity times
    the second Legendre polynomial is a fifth of its coefficient."""
    north = EARTH_RATE * np.cos(windows.latitude)
    return np.asarray(normal_gravities(windows.latitude) * north * windows.duration_s**2 / 60)
