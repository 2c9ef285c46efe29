"""Features of a base that sways, from samples fast enough to see it.

As velocity alignment does (lbgc.estimators.inertial), forces are integrated in axes that stand
still in inertial space, where gravity's direction turns with Earth and bends velocity: eastward
steadily, so that the second Legendre moment over a window of T seconds points along

    g Omega cos(lat) T^2/12.

Velocity in units of that, in level axes, is what a network is given, as means short enough for a
window to have many. Beside it stands the horizontal rate of the body, whose product with a lever
arm of a metre is given in the same unit: what rocks about an axis below the sensor moves it to and
fro, and the gyros say how. Nothing here has been told a heading; a network that has a base is given
the same less what that base's heading explains, in axes that it turned north.
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
from lbgc.estimators.level import level
from lbgc.frames import euler_to_matrix, rotation_matrix, rotation_z, turned

LEAST_RATE_HZ = 50.0
"""Below it a vehicle's sway is not seen as it is: at 10 Hz errors over 10 s are threefold."""
PER_STEP = 5
"""Features a step: velocity and rate, two each, and how lively the sway is."""
CONSTANTS = 2
"""Further features, of the whole window: its length, and its latitude's share in the unit."""
_ARM_M = 1.0
_STILL = 1e-5
"""rad/s, rms: a base that does not sway"""
_MINUTE = 60.0
_LEFT_OVER = 0.02
"""Share of a window, at the most, that may fill no whole step and is left out."""
_AT_ONCE = 200_000
"""Samples integrated together, for memory's sake"""


@dataclass(frozen=True)
class Swaying:
    """Windows that were integrated and levelled."""

    velocity: np.ndarray
    """(W, T, 2), as the module says: level, forward and right where the encoder reads zero"""
    rate: np.ndarray
    """(W, T, 2), likewise"""
    liveliness: np.ndarray
    """(W, T), log10 of the horizontal rate's rms in each step, over 0.01 mrad/s"""
    bend: np.ndarray
    """(W, T, 2), north and east: what a body at rest has of velocity"""

    @classmethod
    def of(cls, windows: Windows, rate_hz: float) -> "Swaying":
        """Means at this rate, T a window. Raises InputError where samples are too slow, or are not
        whole means."""
        windows = _of_whole_steps(windows, rate_hz)
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
        """Features without a heading, (W, T, 5)."""
        return np.concatenate([self.velocity, self.rate, self.liveliness[..., None]], axis=-1)

    def residual(self, base: np.ndarray) -> np.ndarray:
        """Features less what these headings explain, in axes that they turned north: (W, T, 5).
        base : (W,), rad."""
        velocity = turned(self.velocity, base[:, None]) - self.bend
        rate = turned(self.rate, base[:, None])
        return np.concatenate([velocity, rate, self.liveliness[..., None]], axis=-1)


def inputs(
    windows: Windows, rate_hz: float, base: Callable[[Windows], np.ndarray] | None
) -> tuple[np.ndarray, np.ndarray]:
    """A network's features, float32 (W, T, PER_STEP + CONSTANTS), and the headings, (W,), rad, that
    it corrects: zero without a base. Raises InputError as `Swaying.of` does."""
    windows = _of_whole_steps(windows, rate_hz)
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
    if windows.rate_hz < LEAST_RATE_HZ * (1 - 1e-9):
        about = f"must be {LEAST_RATE_HZ:g} Hz or more: the model takes a base that sways"
        raise InputError("the data's rate", f"{windows.rate_hz:g}", "Hz", about)
    block = nearest_samples(1 / rate_hz, windows.rate_hz)
    samples = windows.gyro.shape[1]
    if block is None or samples % block > _LEFT_OVER * samples:
        about = f"must be whole steps of {1 / rate_hz:g} s, as each window of the model's"
        raise InputError("the data's rate", f"{windows.rate_hz:g}", "Hz", about)
    return block


def _of_whole_steps(windows: Windows, rate_hz: float) -> Windows:
    """The windows less the samples at the end that fill no step."""
    samples = windows.gyro.shape[1]
    used = samples - samples % _block(windows, rate_hz)
    values: dict[str, Any] = {name: getattr(windows, name)[:, :used] for name in SAMPLED}
    return replace(windows, **values)


def _slope(series: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Slope of a straight line through (W, T, 3), by least squares: the mean force, (W, 3)."""
    centred = t - t.mean()
    return np.asarray(np.einsum("t,wti->wi", centred, series) / np.sum(centred**2))


def _straightened(series: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The series less a straight line an axis: the sway's velocity at the start and the
    levelling."""
    centred = (t - t.mean())[:, None]
    slope = _slope(series, t)[:, None]
    return np.asarray(series - series.mean(axis=1, keepdims=True) - centred * slope)


def _encoder_zero(attitude: np.ndarray, plate_angle: np.ndarray) -> np.ndarray:
    """Mean yaw, (W,), rad, of what the plate turns on, attitude : (W, T, 3, 3)."""
    yaw = np.arctan2(attitude[..., 1, 0], attitude[..., 0, 0]) - plate_angle
    return np.angle(np.mean(np.exp(1j * yaw), axis=1))


def _bend(windows: Windows, n: int, dt: float) -> np.ndarray:
    """(W, n, 2), m/s, in the axes of n at the windows' middle."""
    beta = apparent_gravity(windows, n, dt)
    latitude = windows.latitude
    half = EARTH_RATE * windows.duration_s / 2
    axis = np.stack([np.cos(latitude), np.zeros_like(latitude), -np.sin(latitude)], axis=-1)
    middle = rotation_matrix(axis * half)  # C_in
    return np.asarray(np.einsum("wji,wtj->wti", middle, beta)[..., :2])


def _unit(windows: Windows) -> np.ndarray:
    """(W,), m/s: a mean of P2 times velocity is a fifth of its coefficient."""
    north = EARTH_RATE * np.cos(windows.latitude)
    return np.asarray(normal_gravities(windows.latitude) * north * windows.duration_s**2 / 60)
