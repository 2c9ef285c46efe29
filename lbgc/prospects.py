"""What a training can win, said before it starts: by what of the bias repeats, and by the floor."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lbgc.earth import heading_exists, normal_gravity
from lbgc.errors import InputError, build
from lbgc.estimators.block_means import Site
from lbgc.estimators.floor import SETTLE_S, course_of, expected_floor
from lbgc.estimators.information import information
from lbgc.protocol import ProtocolConfig
from lbgc.sensor.datasheet import ImuConfig

LEAST_GAIN = 0.02
"""Share of the error below which a gain is none; the floor itself is told to 1%."""


def prospects(configuration: Mapping[str, Any], window_s: float) -> str | None:
    """A sentence on what a network trained on this dataset can win over an estimator that is told
    the sensor's model alone, on windows of this length; None where the floor cannot say it: at a
    pole, on a base that sways, of a sensor without noise.

    configuration : the dataset's.
    """
    if configuration["scene"]["sway"]["level"] != 0:
        return None
    imu = build(ImuConfig, configuration["imu"])
    # what a session draws repeats as well where all recordings are of one
    one_session = configuration["sessions"] == 1
    repeating = ("unit", "session") if one_session else ("unit",)
    lifetimes = repeating if configuration["units"] == 1 else ()
    try:
        plain, told = (_floor_deg(configuration, imu, known, window_s) for known in ((), lifetimes))
    except (InputError, ArithmeticError, np.linalg.LinAlgError):
        return None
    if not 0 < told < np.inf or not 0 < plain < np.inf:
        return None
    gain = 1 - told / plain
    whose = "one unit's" if configuration["units"] == 1 else f"{configuration['units']} units'"
    begin = (
        f"in {window_s:g} s no estimator that knows this sensor's model alone can do better than "
        f"{plain:.3g} deg RMS; of {whose} recordings {_share(imu, lifetimes):.0%} of the gyro's "
        "bias variance repeats, "
    )
    if gain < LEAST_GAIN:
        return begin + "and no gain is to be had from learning it: at best a network does as well"
    return begin + f"and who has learned it all comes to {told:.3g}: up to {gain:.0%} less"


def _floor_deg(
    configuration: Mapping[str, Any], imu: ImuConfig, known: tuple[str, ...], window_s: float
) -> float:
    latitude = float(np.deg2rad(configuration["latitude"]))
    if not heading_exists(latitude):
        return float("nan")
    site = Site(latitude, normal_gravity(latitude, float(configuration["height_m"])))
    protocol = build(ProtocolConfig, configuration["protocol"])
    model = imu.model(float(configuration["rate_hz"])).without(*known)
    course = course_of(protocol, window_s, settle_s=SETTLE_S)
    return float(np.rad2deg(expected_floor(information(model, course, site))))


def _share(imu: ImuConfig, lifetimes: tuple[str, ...]) -> float:
    """Share of the horizontal gyros' bias variance that is of these lifetimes; 0 where there is
    none."""
    gyro = imu.gyro.triad()
    variance = {
        part: float(np.mean(np.square(gyro.bias(part)[:2]))) for part in ("unit", "session", "run")
    }
    total = sum(variance.values())
    return sum(variance[part] for part in lifetimes) / total if total else 0.0
