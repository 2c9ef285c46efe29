"""Headings from what Gaussian data tell of them: the mode, and the mean of the posterior.

Whatever data tell of q = (cos psi, sin psi) is a 2-vector h and a 2 x 2 matrix J, the information
(see lbgc.estimators.optimal), and the posterior is that of lbgc.estimators.circle.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from lbgc.estimators import circle
from lbgc.estimators.estimate import Estimate
from lbgc.frames import wrap
from lbgc.sensor.imu import ImuModel

LIFETIMES = ("unit", "session", "run")
AS_LENGTHS = float(np.deg2rad(6.0))
"""Below it angles behave like lengths."""


def known(imu: ImuModel, lifetimes: tuple[str, ...]) -> ImuModel:
    """The sensor when everything that lasts that long has been calibrated away."""
    none = (0.0, 0.0, 0.0)
    gone: dict[str, Any] = {f"bias_{name}": none for name in lifetimes}
    if "unit" in lifetimes:
        of_unit = ("scale_unit", "misalignment_unit", "g_sensitivity", "bias_per_k", "scale_per_k")
        gone |= dict.fromkeys(of_unit, none)
    return replace(imu, gyro=replace(imu.gyro, **gone), accel=replace(imu.accel, **gone))


def along(heading: np.ndarray) -> np.ndarray:
    """q, (*S, 2)."""
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def across(heading: np.ndarray) -> np.ndarray:
    """dq/dpsi, (*S, 2)."""
    return np.stack([-np.sin(heading), np.cos(heading)], axis=-1)


def likeliest(h: np.ndarray, J: np.ndarray) -> Estimate:
    """The most likely headings, and the posterior's RMS angle about them.
    h : (V, 2); J : (2, 2), or (V or 1, 2, 2)."""
    heading = circle.mode(h, J)
    return Estimate(heading, circle.posterior(h, J, heading).sigma)


def bayes(h: np.ndarray, J: np.ndarray) -> Estimate:
    """The Bayes-optimal estimate: with a flat prior on the circle the posterior's circular mean,
    which minimises the mean of 1 - cos(error); and the posterior's RMS error about it."""
    found = circle.posterior(h, J)
    return Estimate(wrap(found.heading), found.sigma)
