"""North from a resting IMU: levelling and gyrocompassing on the window's mean."""

from dataclasses import replace

import numpy as np

from lbgc.data.record import mean_along
from lbgc.data.windows import Windows
from lbgc.earth import earth_rate_ned
from lbgc.estimators.block_means import levelled
from lbgc.estimators.error_patterns import timeless
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.estimators.least_squares import answer, check, needs_model, weighted
from lbgc.estimators.level import gyrocompass
from lbgc.estimators.level_axis import plain
from lbgc.frames import DOWN, level, matrix_to_euler, turned, wrap
from lbgc.sensor.imu import ImuModel

_MOVED = np.deg2rad(0.01)


def mean(windows: Windows, imu: ImuModel | None = None, *, bias_sigma: float = 0.0) -> Estimate:
    """The paper's baseline: levelling, then gyrocompassing, on the window's mean; at any tilt.

    Its sigma holds for a base that is nearly level. It follows from the sensor's model where that
    is known, else from the window's own scatter, which shows white noise and no bias, and from
    `bias_sigma`. The size of Earth's horizontal rate is known, and is not taken from the
    measurement: where noise is as large, the heading may be anywhere (lbgc.estimators.circle).

    bias_sigma : rad/s, 1 sigma of each gyro's bias where the sensor is not known.

    Raises InputError where the plate turns within a window: the mean rate is then not Earth's.
    """
    _at_rest("mean", windows)
    rate, force, angle = _means(windows)
    heading = wrap(gyrocompass(rate, *level(force)) - angle)
    return _with_sigma(heading, windows, imu, bias_sigma)


def triad(windows: Windows, imu: ImuModel | None = None, *, bias_sigma: float = 0.0) -> Estimate:
    """Dual-vector coarse alignment (Black 1964's TRIAD): the attitude that takes the measured
    force to gravity exactly, and the measured rate into the meridian's plane.

    Its heading equals that of `mean` algebraically; it is taken from the attitude matrix, which
    uses the latitude. bias_sigma : as for `mean`.
    """
    check("triad", windows)
    _at_rest("triad", windows)
    rate, force, angle = _means(windows)
    body = _triad(force, rate)
    up = np.broadcast_to([0.0, 0.0, -1.0], force.shape)
    c_nb = _triad(up, earth_rate_ned(windows.latitude)) @ np.swapaxes(body, -1, -2)
    heading = wrap(matrix_to_euler(c_nb)[2] - angle)
    return _with_sigma(heading, windows, imu, bias_sigma)


def gls(windows: Windows, imu: ImuModel | None = None, *, checked: bool = True) -> Estimate:
    """Generalised least squares: the most likely heading under the sensor's full Gaussian model,
    biases at their stated sizes. The plate may rest or turn; its base leans by 10 degrees at most.

    Raises InputError where a window contradicts that model, as a base that moves does. If not
    `checked` it answers such a window, with a sigma that is not true.
    """
    model = needs_model("gls", imu)
    return answer(windows, model, lambda part: weighted("gls", part, model, False, checked), "gls")


def _means(windows: Windows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean rate, (W, 3), rad/s, and mean force, (W, 3), m/s^2, and the angle, (W,), rad, by which
    the heading of their axes is that of the plate at zero and more. They are in the body's axes
    where the plate turns about down; else the plate may lie on its side, and they are turned back.
    """
    rate, force = mean_along(windows.gyro, 1), mean_along(windows.accel, 1)
    angle = windows.plate_angle.mean(axis=1)
    if windows.axis == DOWN:
        return rate, force, angle
    rate, force = (turned(own, angle, windows.axis) for own in (rate, force))
    return rate, force, 0 * angle


def _at_rest(name: str, windows: Windows) -> None:
    """Raise InputError where the plate travels more than 0.01 degrees within a window, or where
    something was not recorded."""
    travel = np.ptp(windows.plate_angle, axis=1)
    if travel.max(initial=0.0) > _MOVED:
        raise refusal(
            name,
            f"{np.rad2deg(travel.max()):.3g}",
            "deg",
            "of plate travel within a window: it takes windows at rest only",
        )
    if windows.unrecorded.any():
        raise refusal(name, "a window", "", "holds a time that was not recorded")


def _triad(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Orthonormal axes, (W, 3, 3), as columns, that two vectors, (W, 3), define: x along the first,
    y across both."""
    x = first / np.linalg.norm(first, axis=-1, keepdims=True)
    y = np.cross(x, second)
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _with_sigma(
    heading: np.ndarray, windows: Windows, imu: ImuModel | None, bias_sigma: float
) -> Estimate:
    """The headings, (W,), with the sigma of the plain mean. Every block counts as at rest, even if
    the encoder's reading flickers."""
    sigma = np.empty(len(windows))
    still = np.broadcast_to(windows.plate_angle[:, :1], windows.plate_angle.shape)
    at_least = False
    whenever = imu is None or timeless(imu)
    for part in levelled(replace(windows, plate_angle=still), timeless=whenever):
        found = plain(part, False, imu, bias_sigma)
        sigma[part.rows] = found.sigma
        at_least |= found.at_least
    return Estimate(heading, sigma, at_least)
