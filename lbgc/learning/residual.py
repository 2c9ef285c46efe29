"""Features of windows that are turned by their own classical estimate, as if they pointed north, so
that a network has to find a correction only.

The rates and forces that a level IMU would feel there are subtracted, and what remains is divided
by Earth's horizontal rate and by g: an error of either is then in radians, of heading and of tilt.
These residuals are given in axes that point north (three of each triad) and in those of the body
(the horizontal two): an error of heading shows in the first, a sensor's bias in the second, and
their moments are all that is to be known of both, however the plate turns. Sine and cosine of the
estimate are given besides: a bias that stays with the body moves the heading by a function of them.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from lbgc.data.windows import Windows, at_rate
from lbgc.earth import EARTH_RATE, normal_gravities
from lbgc.errors import InputError
from lbgc.estimators import BASES
from lbgc.estimators.plate import mean_turn, tilt_of, travel_within, usable
from lbgc.frames import turned, unrepeated, wrap
from lbgc.learning import sway
from lbgc.learning.model import ModelConfig, features
from lbgc.sensor.imu import ImuModel

_MINUTE = 60.0


def inputs(
    config: ModelConfig, windows: Windows, rate_hz: float, imu: ImuModel | None
) -> tuple[np.ndarray, np.ndarray]:
    """A network's features, float32 (W, T, C), at its own rate, and the headings that it corrects,
    (W,), rad: zero without a base. imu : the sensor's model, which weights some bases.

    Raises InputError where a value is not finite although something was recorded, where the
    windows' rate is no whole multiple of the network's, or where the base refuses the windows.
    """
    if not config.sways:
        windows = at_rate(windows, rate_hz)
        if config.base is None:
            return features(config, windows), np.zeros(len(windows))
    finite = np.isfinite(windows.plate_angle).all() and all(
        (np.isfinite(v).all(axis=-1) | (windows.unrecorded & (not config.sways))).all()
        for v in (windows.gyro, windows.accel)
    )
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
    """The base's heading of each window, (W,), rad. Each window is taken as a recording of its own
    that begins at zero time and angle, since a prediction is a function of its window alone."""
    first = windows.plate_angle[:, :1]
    own = replace(windows, plate_angle=windows.plate_angle - first, start_s=0 * windows.start_s)
    return wrap(BASES[name](own, imu).heading - first[:, 0])


def _features(config: ModelConfig, windows: Windows, base: np.ndarray) -> np.ndarray:
    """The features of windows turned by the headings base, (W,), rad; zero where the plate neither
    rests nor turns evenly, and where nothing was recorded."""
    angle = unrepeated(windows.plate_angle)
    travel = travel_within(angle)
    used = (usable(angle)[0] & ~windows.unrecorded)[..., None]
    psi = base[:, None] + angle - travel / 2  # an encoder is read at a sample's end
    latitude = windows.latitude[:, None]
    north, down = EARTH_RATE * np.cos(latitude), -EARTH_RATE * np.sin(latitude)
    g = normal_gravities(latitude)
    turning = travel * windows.rate_hz
    gyro, force = turned(_levelled(windows, angle), psi), turned(windows.accel, psi)
    # Earth's rate is averaged over the turn within a sample.
    gyro -= np.stack([north * mean_turn(0 * travel, travel).real, 0 * turning, down + turning], -1)
    columns = {
        "gyro": lambda: _in_both_axes(gyro / north[..., None], psi),
        "accel": lambda: _in_both_axes(force / g[..., None] + [0.0, 0.0, 1.0], psi),
        "plate": lambda: (np.stack([np.cos(angle), np.sin(angle)], axis=-1),),
    }
    length = np.log2(windows.duration_s / _MINUTE) / 2
    place = np.log2(np.cos(windows.latitude))
    lengths = np.full(len(windows), length)
    fixed = np.stack([np.sin(base), np.cos(base), lengths, place], axis=-1)[:, None]
    parts = [
        np.where(used, part, 0.0) for channel in config.channels for part in columns[channel]()
    ]
    size = windows.plate_angle.shape
    every = [np.broadcast_to(part, (*size, part.shape[-1])) for part in (*parts, fixed)]
    return np.concatenate(every, axis=-1, dtype=np.float32)


def _levelled(windows: Windows, angle: np.ndarray) -> np.ndarray:
    """The rates in level axes that turn with the plate, (W, T, 3), by the mean force in the base's
    axes. angle : (W, T), rad, the plate's."""
    lean = tilt_of(angle, windows.accel)
    return turned(turned(windows.gyro, angle) @ np.swapaxes(lean, 1, 2), -angle)


def _in_both_axes(residual: np.ndarray, psi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The residual in north-pointing axes, (W, T, 3), and its part in the body's horizontal ones,
    (W, T, 2)."""
    return residual, turned(residual[..., :2], -psi)
