"""North from a resting IMU: levelling and gyrocompassing on the window's mean."""

import numpy as np

from lbgc.data.windows import Windows
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.frames import wrap
from lbgc.sensor.imu import ImuModel

_MOVED = np.deg2rad(0.01)


def level(f_ib_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch from specific force at rest (the paper's eqs. 10-11; Groves 2013, eq. 5.101).

    f_ib_b : (W, 3), m/s^2. Returns rad, (W,) each. They do not depend on g.
    """
    x, y, z = f_ib_b[:, 0], f_ib_b[:, 1], f_ib_b[:, 2]
    return np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z))


def gyrocompass(omega_ib_b: np.ndarray, roll: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Heading from Earth's rate and a known level (the paper's eqs. 14-16; Groves 2013, eq. 5.105).

    omega_ib_b : (W, 3), rad/s; roll, pitch : (W,), rad. Returns heading, rad, (W,). It needs no
    latitude, and works in both hemispheres: its signal is Omega cos(lat).
    """
    x, y, z = omega_ib_b[:, 0], omega_ib_b[:, 1], omega_ib_b[:, 2]
    sine = -y * np.cos(roll) + z * np.sin(roll)
    cosine = x * np.cos(pitch) + y * np.sin(roll) * np.sin(pitch) + z * np.cos(roll) * np.sin(pitch)
    return np.arctan2(sine, cosine)


def mean(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """The paper's baseline: levelling, then gyrocompassing, on the window's mean.

    Raises InputError where the plate turns within a window: the mean rate is then not Earth's.
    """
    travel = np.ptp(windows.plate_angle, axis=1)
    if travel.max(initial=0.0) > _MOVED:
        raise refusal(
            "mean",
            f"{np.rad2deg(travel.max()):.3g}",
            "deg",
            "of plate travel within a window: it takes windows at rest only",
        )
    heading = gyrocompass(windows.gyro.mean(axis=1), *level(windows.accel.mean(axis=1)))
    heading = wrap(heading - windows.plate_angle.mean(axis=1))
    return Estimate(heading, np.full(len(windows), np.nan))
