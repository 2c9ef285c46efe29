"""A window turned by its own classical estimate, so that it looks as if it pointed north: what a
network then has to find is a correction.

Rates and forces less what a level IMU would feel there, divided by Earth's horizontal rate and by
g: an error of either is then in radians, of heading and of tilt. They are given in axes that point
north (three of each triad) and in those of the body (the horizontal two): what moves the heading
shows in the first, what a sensor's bias does in the second, and their moments are all that is to be
known of both, however the plate turns. Sine and cosine of the estimate are given besides: a bias
that always stays with the body moves the heading by a function of it.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from lbgc.data.windows import Windows, at_rate
from lbgc.earth import EARTH_RATE, normal_gravities
from lbgc.errors import InputError
from lbgc.estimators import CLASSICAL
from lbgc.estimators.level import level
from lbgc.frames import euler_to_matrix, wrap
from lbgc.learning import sway
from lbgc.learning.model import ModelConfig, features
from lbgc.sensor.imu import ImuModel

_MOVES = np.deg2rad(1e-4)
_STEADY = np.deg2rad(0.003)
"""Of change in the plate's travel from sample to sample, if it turns on."""
_MINUTE = 60.0


def inputs(
    config: ModelConfig, windows: Windows, rate_hz: float, imu: ImuModel | None
) -> tuple[np.ndarray, np.ndarray]:
    """A network's features, float32 (W, T, C), at its own rate, and the headings that it corrects,
    (W,), rad: zero without a base. imu : the sensor, which some bases weigh by.

    Raises InputError where a value is not finite, where the windows' rate is no whole multiple of
    the network's, or where the base refuses the windows.
    """
    if not config.sways:
        windows = at_rate(windows, rate_hz)
        if config.base is None:
            return features(config, windows), np.zeros(len(windows))
    finite = all(np.isfinite(v).all() for v in (windows.gyro, windows.accel, windows.plate_angle))
    if not finite:
        raise InputError("window", "not finite", "", "every value must be a finite number")
    name = config.base
    if config.sways:
        corrected = None if name is None else partial(base_heading, name, imu=imu)
        return sway.inputs(windows, rate_hz, corrected)
    assert name is not None
    base = base_heading(name, windows, imu)
    return _features(config, windows, base), base


def base_heading(name: str, windows: Windows, imu: ImuModel | None) -> np.ndarray:
    """(W,), rad. As if each window were a recording of its own, for a prediction is a function of
    the window alone: it begins at zero time and angle."""
    first = windows.plate_angle[:, :1]
    own = replace(windows, plate_angle=windows.plate_angle - first, start_s=0 * windows.start_s)
    return wrap(CLASSICAL[name](own, imu).heading - first[:, 0])


def _features(config: ModelConfig, windows: Windows, base: np.ndarray) -> np.ndarray:
    angle = windows.plate_angle
    travel = np.gradient(angle, axis=1) if angle.shape[1] > 1 else np.zeros_like(angle)
    used = _usable(travel)
    psi = base[:, None] + angle - travel / 2  # an encoder is read at a sample's end
    latitude = windows.latitude[:, None]
    north, down = EARTH_RATE * np.cos(latitude), -EARTH_RATE * np.sin(latitude)
    g = normal_gravities(latitude)
    turning = np.where(np.abs(travel) > _MOVES, travel * windows.rate_hz, 0.0)
    gyro, force = _north(_levelled(windows.gyro, windows, angle), psi), _north(windows.accel, psi)
    # Earth's rate is averaged over the turn within a sample.
    gyro = gyro - np.stack(
        [north * np.sinc(travel / (2 * np.pi)), 0 * turning, down + turning], axis=-1
    )
    columns = {
        "gyro": lambda: _both(gyro / north[..., None], psi),
        "accel": lambda: _both(force / g[..., None] + [0.0, 0.0, 1.0], psi),
        "plate": lambda: np.stack([np.cos(angle), np.sin(angle)], axis=-1),
    }
    moving = [columns[c]() * used[..., None] for c in config.channels]
    length = np.log2(windows.duration_s / _MINUTE) / 2
    place = np.log2(np.cos(windows.latitude))
    lengths = np.full(len(windows), length)
    fixed = np.stack([np.sin(base), np.cos(base), lengths, place], axis=-1)
    held = np.broadcast_to(fixed[:, None], (*angle.shape, fixed.shape[1]))
    return np.concatenate([*moving, held], axis=-1).astype(np.float32)


def _usable(travel: np.ndarray) -> np.ndarray:
    """Samples at rest, or in steady motion, bool (W, T): in between, what a gyro's scale and a
    base's lean make of a slew's rate is far above what is looked for."""
    change = np.abs(np.diff(travel, axis=1, prepend=travel[:, :1], append=travel[:, -1:]))
    steady = np.maximum(change[:, :-1], change[:, 1:]) < _STEADY
    resting = np.abs(travel) < _MOVES
    carousel = (steady & ~resting).mean(axis=1, keepdims=True) > 0.5
    return np.where(carousel, steady, resting)


def _levelled(values: np.ndarray, windows: Windows, angle: np.ndarray) -> np.ndarray:
    """The values less the lean that the mean force in the plate's base shows, (W, T, 3)."""
    lean = euler_to_matrix(*level(_about_z(windows.accel, angle).mean(axis=1)), 0.0)
    return _about_z(np.einsum("wij,wtj->wti", lean, _about_z(values, angle)), -angle)


def _north(values: np.ndarray, psi: np.ndarray) -> np.ndarray:
    """Body axes to north-pointing ones."""
    return _about_z(values, psi)


def _both(residual: np.ndarray, psi: np.ndarray) -> np.ndarray:
    """In north-pointing axes, and the horizontal ones of the body besides: (W, T, 5)."""
    return np.concatenate([residual, _about_z(residual, -psi)[..., :2]], axis=-1)


def _about_z(values: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """C(angle) v about the down axis: (W, T, 3), angle (W, T)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = values[..., 0], values[..., 1], values[..., 2]
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)
