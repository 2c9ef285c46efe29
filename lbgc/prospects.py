"""The gain that a training can bring, stated before it starts: by the floor, with and without the
repeatable part of the bias known."""

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
from lbgc.sensor.imu import ImuModel

LEAST_GAIN = 0.02
"""Share of the error below which a gain counts as none; the floor itself is accurate to 1%."""


def prospects(
    configuration: Mapping[str, Any], window_s: float, told: ImuModel | None = None
) -> str | None:
    """A sentence on how much better than an estimator that is told the sensor's model alone a
    network trained on this dataset can be, on windows of this length. None where the floor cannot
    tell: at a pole, on a base that sways, for a sensor without noise.

    configuration : the dataset's; told : the sensor's model with what is known of the one unit
    that the network is for.
    """
    if configuration["scene"]["sway"]["level"] != 0:
        return None
    imu = build(ImuConfig, configuration["imu"])
    # The session's errors repeat too where all recordings are of one session.
    one_session = configuration["sessions"] == 1
    repeating = ("unit", "session") if one_session else ("unit",)
    lifetimes = repeating if configuration["units"] == 1 else ()
    try:
        law = imu.model(float(configuration["rate_hz"]))
        known = law.without(*lifetimes) if told is None else told
        plain, least = (_floor_deg(configuration, model, window_s) for model in (law, known))
    except (InputError, ArithmeticError, np.linalg.LinAlgError):
        return None
    if not 0 < least < np.inf or not 0 < plain < np.inf:
        return None
    if told is not None:
        return (
            f"in {window_s:g} s no estimator that is told what is known of this unit can do better "
            f"than {least:.3g} deg RMS, and none that knows the sensor's model alone than "
            f"{plain:.3g}; the network is for this unit"
        )
    gain = 1 - least / plain
    whose = "one unit's" if configuration["units"] == 1 else f"{configuration['units']} units'"
    begin = (
        f"in {window_s:g} s no estimator that knows this sensor's model alone can do better than "
        f"{plain:.3g} deg RMS; of {whose} recordings {_share(imu, lifetimes):.0%} of the gyro's "
        "bias variance repeats, "
    )
    if gain < LEAST_GAIN:
        return begin + "and no gain is to be had from learning it: at best a network does as well"
    return begin + f"and who has learned it all comes to {least:.3g}: up to {gain:.0%} less"


def _floor_deg(configuration: Mapping[str, Any], model: ImuModel, window_s: float) -> float:
    """The expected floor of this sensor, degrees; NaN at a pole."""
    latitude = float(np.deg2rad(configuration["latitude"]))
    if not heading_exists(latitude):
        return float("nan")
    site = Site(latitude, normal_gravity(latitude, float(configuration["height_m"])))
    protocol = build(ProtocolConfig, configuration["protocol"])
    course = course_of(protocol, window_s, settle_s=SETTLE_S)
    return float(np.rad2deg(expected_floor(information(model, course, site))))


def _share(imu: ImuConfig, lifetimes: tuple[str, ...]) -> float:
    """Share of the horizontal gyros' bias variance that has these lifetimes; 0 where there is no
    bias."""
    gyro = imu.gyro.triad()
    variance = {
        part: float(np.mean(np.square(gyro.bias(part)[:2]))) for part in ("unit", "session", "run")
    }
    total = sum(variance.values())
    return sum(variance[part] for part in lifetimes) / total if total else 0.0
