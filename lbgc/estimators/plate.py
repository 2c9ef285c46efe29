"""The plate: when it rests or turns evenly, and what axes that turn with it feel of a constant
vector.

A sensor prints means. Over a sample (or a block) in which the plate travels evenly by a about the
angle theta, the mean of exp(i plate's angle) is exp(i theta) sin(a/2)/(a/2): so a vector that
stands still in the axes of the plate's base, Earth's rate or gravity, is felt turned and shortened.
"""

import numpy as np

from lbgc.frames import DOWN, euler_to_matrix, level, turned

_RESTS = np.deg2rad(1e-4)
"""Travel from block to block, rad, below which the plate rests."""
_STEADY = np.deg2rad(0.003)
"""Largest change of travel from block to block, rad, in a steady turn; an encoder reads in
steps."""
_ALONE = np.deg2rad(1e-6)
"""Travel, or change of it, rad, below which one neighbouring block is evidence enough: a slew that
begins in a block's last hundredth moves its mean angle by little more than that, and its mean rate
by much."""


def usable(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which blocks tell of north, and in which the plate rests, bool (*S, n) each.

    angle : (*S, n), rad, unwrapped, the plate's mean over each block. A plate that turns evenly for
    most of a window is on a carousel: its blocks of steady rate tell of north. Else the rests do.
    """
    n = angle.shape[-1]
    travel = np.diff(angle, axis=-1) if n > 1 else np.zeros_like(angle)
    before = np.concatenate([travel[..., :1], travel], axis=-1)[..., :n]
    after = np.concatenate([travel, travel[..., -1:]], axis=-1)[..., :n]
    moves = np.abs(before), np.abs(after)
    resting = (np.maximum(*moves) < _RESTS) | (np.minimum(*moves) < _ALONE)
    change = np.abs(after - before)
    steady = change < _STEADY
    steady[..., 0] = steady[..., -1] = False
    if n > 2:  # a block at an end has only one neighbour
        steady[..., 0], steady[..., -1] = change[..., 1] < _ALONE, change[..., -2] < _ALONE
    steady &= ~resting
    carousel = steady.mean(axis=-1, keepdims=True) > 0.5
    return np.where(carousel, steady, resting), resting


def travel_within(angle: np.ndarray) -> np.ndarray:
    """The plate's travel within each block, (*S, n), rad, by the blocks' mean angles; zero at rest.
    It is wrong for a block in which the plate speeds up or slows down."""
    if angle.shape[-1] == 1:
        return np.zeros_like(angle)
    return np.where(usable(angle)[1], 0.0, np.gradient(angle, axis=-1))


def mean_turn(angle: np.ndarray, travel: np.ndarray) -> np.ndarray:
    """Mean of exp(i plate's angle) over a time in which the plate travels evenly, complex (*S).

    angle : its mean, rad; travel : rad; both *S."""
    return np.asarray(np.exp(1j * angle) * np.sinc(travel / (2 * np.pi)))


def on_plate(vector: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Vectors in the base's axes, (W, 1 or n, 3), averaged in axes that turn with a plate about
    down, (W, n, 3).

    turn : (W, n), complex, see `mean_turn`."""
    c, s = turn.real, turn.imag
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    return np.stack([c * x + s * y, c * y - s * x, z + 0 * c], axis=-1)


def mean_angle(reading: np.ndarray, rate_hz: float, sample_s: float | None) -> np.ndarray:
    """The plate's mean angle over each sample (or mean of samples), (W, T), rad. The encoder is
    read at a sample's end, when the plate is half a sample's travel past its mean angle.

    reading : (W, T), rad; sample_s : the sensor's own interval; None where readings are of samples.
    """
    if sample_s is None or sample_s * rate_hz > 0.999:
        steps = np.diff(reading, axis=1, prepend=reading[:, :1])
        if reading.shape[1] > 1:
            steps[:, 0] = steps[:, 1]
        return np.asarray(reading - steps / 2)
    return np.asarray(reading - sample_s * rate_hz / 2 * travel_within(reading))


def tilt_of(angle: np.ndarray, accel: np.ndarray, axis: int = DOWN) -> np.ndarray:
    """Rotation from the base's axes to level ones, (W, 3, 3), by the mean specific force.

    angle : (W, n or 1), rad, the plate's; accel : (W, n, 3), m/s^2, specific force in the body's
    axes, NaN where nothing was recorded; axis : about which the plate turns."""
    force = turned(accel, angle, axis)
    none = np.isnan(force)
    if none.any():
        seen = np.maximum(np.sum(~none, axis=1), 1)
        return euler_to_matrix(*level(np.sum(force, axis=1, where=~none) / seen), 0.0)
    return euler_to_matrix(*level(force.mean(axis=1)), 0.0)
