"""Conversion of the noise keys in IMU files of Kalibr (also read by VINS, OpenVINS and Basalt) to
the keys of `conf/imu/`.

    gyroscope_noise_density      rad/s/sqrt(Hz)      N
    gyroscope_random_walk        rad/s^2/sqrt(Hz)    K
    accelerometer_noise_density  m/s^2/sqrt(Hz)      N
    accelerometer_random_walk    m/s^3/sqrt(Hz)      K

They are SI and two-sided: a sample at interval dt has white noise of sigma N/sqrt(dt). A
datasheet's density is one-sided, sqrt(2) times that. Such a file states no flicker noise and no
biases by lifetime.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lbgc.errors import require
from lbgc.units import factor

KEYS = {
    "gyroscope_noise_density": ("gyro", "arw_deg_per_sqrt_h"),
    "gyroscope_random_walk": ("gyro", "rrw_deg_per_h_per_sqrt_h"),
    "accelerometer_noise_density": ("accel", "vrw_m_per_s_per_sqrt_h"),
    "accelerometer_random_walk": ("accel", "random_walk_ug_per_sqrt_h"),
}
"""The triad and the key of `conf/imu/` that each of Kalibr's keys becomes."""
UNREAD = ("rostopic", "update_rate", "model", "time_offset", "T_i_b")
"""Other keys of Kalibr's files, which are left out because they say nothing of the errors."""
_GROUP = "imu0"


def adopted(given: Mapping[str, Any]) -> Mapping[str, Any]:
    """An `imu` group with Kalibr's keys converted to those of `conf/imu/`; a group without any of
    Kalibr's noise keys is returned as it is, freed of a level `imu0`.

    given : the group, as YAML gives it. Raises InputError where a value is not a number of zero or
    more, or disagrees by more than 15% with the same figure in our own key.
    """
    inner = given.get(_GROUP)
    if isinstance(inner, Mapping):
        given = {**{k: v for k, v in given.items() if k != _GROUP}, **inner}
    if not any(key in given for key in KEYS):
        return given
    out = {k: v for k, v in given.items() if k not in KEYS and k not in UNREAD}
    for key in (k for k in KEYS if k in given):
        part, own = KEYS[key]
        value = given[key]
        good = isinstance(value, int | float) and not isinstance(value, bool)
        require(good and 0 <= value < np.inf, key, value, "must be a number, zero or more, in SI")
        group = out.get(part) or {}
        require(isinstance(group, Mapping), part, group, "must be a group of parameters")
        converted, before = value / factor(own), group.get(own)
        require(
            not before or bool(np.allclose(converted, before, rtol=0.15)),
            key,
            value,
            f"disagrees by over 15% with {part}.{own} = {before}: it is {converted:.6g} in that "
            "unit; give one of them",
        )
        out[part] = {**group, own: converted}
    return out
