"""A sensor as the filters of PX4 and ArduPilot take it: process noise of EKF2 and EKF3.

Both state noise by the step of the filter's prediction, not as a density. With h the step, the
variance of an angle grows by (h noise)^2 a step, so noise = N/sqrt(h); a bias's by (h b_noise)^2,
so b_noise = K/sqrt(h), in rad/s^2 or m/s^3 (PX4, src/modules/ekf2/EKF/covariance.cpp,
predictCovariance, h = EKF2_PREDICT_US of 10 ms; ArduPilot, libraries/AP_NavEKF3/
AP_NavEKF3_core.cpp, CovariancePrediction, where the bias's state is an angle h b, h = EKF_TARGET_DT
of 12 ms). Units alone, rad/s, do not tell this: at another step these are other figures.

They are the sensor's alone. The defaults are far larger, since an airframe's vibration and what the
model leaves out are in them. Flicker has no figure: a random walk
stands for it where the sensor has none of its own.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.exports.losses import COUNTS, SLOW, WALK, WHITE, Scope, lines, walked, whites
from lbgc.exports.subject import PARTS, Subject, number, worst

_SCOPE = Scope(WHITE | WALK | COUNTS, dict.fromkeys(SLOW, "the bias's process noise"))


@dataclass(frozen=True)
class _Filter:
    """An autopilot's filter: its name, its step, and its parameters with their usual ranges."""

    tool: str
    step_s: float
    step: str
    rows: tuple[tuple[str, str, str, float, float, str], ...]
    """Parameter, triad, figure, least and most that the documentation gives, unit."""
    line: str
    """How the file states a parameter."""


_PX4 = _Filter(
    "PX4 (EKF2)",
    0.01,
    "EKF2_PREDICT_US = 10000",
    (
        ("EKF2_GYR_NOISE", "gyro", "N", 1e-4, 0.1, "rad/s"),
        ("EKF2_ACC_NOISE", "accel", "N", 0.01, 1.0, "m/s^2"),
        ("EKF2_GYR_B_NOISE", "gyro", "K", 0.0, 0.01, "rad/s^2"),
        ("EKF2_ACC_B_NOISE", "accel", "K", 0.0, 0.01, "m/s^3"),
    ),
    "1\t1\t{name}\t{value}\t9",
)
_ARDUPILOT = _Filter(
    "ArduPilot (EKF3)",
    0.012,
    "EKF_TARGET_DT = 0.012 s",
    (
        ("EK3_GYRO_P_NSE", "gyro", "N", 1e-4, 0.1, "rad/s"),
        ("EK3_ACC_P_NSE", "accel", "N", 0.01, 1.0, "m/s^2"),
        ("EK3_GBIAS_P_NSE", "gyro", "K", 1e-5, 1e-3, "rad/s^2"),
        ("EK3_ABIAS_P_NSE", "accel", "K", 1e-5, 0.02, "m/s^3"),
    ),
    "{name},{value}",
)


def px4(subject: Subject) -> str:
    """The content of a parameter file of QGroundControl: vehicle, component, name, value, type."""
    return _written(subject, _PX4)


def ardupilot(subject: Subject) -> str:
    """The content of a parameter file of ArduPilot: name and value."""
    return _written(subject, _ARDUPILOT)


def _written(subject: Subject, tool: _Filter) -> str:
    rows = []
    said = []
    for name, part, figure, least, most, unit in tool.rows:
        value = getattr(subject.walking(part), figure) / np.sqrt(tool.step_s)
        rows.append(tool.line.format(name=name, value=number(value)))
        usual = f"{tool.tool} documents {least:g} to {most:g} {unit}"
        if not least <= value <= most:
            usual += f", and {value:.3g} is outside: a ground station may refuse it"
        said.append(f"{name}, {unit}: {usual}")
    comments = [
        *subject.title(tool.tool),
        f"process noise for a filter's step of {tool.step_s:g} s ({tool.step}); multiply by "
        f"sqrt({tool.step_s:g} s/step) for another",
        "the sensor's noise alone: what vibrates, and what the filter's model leaves out, comes on "
        "top, and is most of the defaults",
        *said,
        *(worst(subject, part) for part in PARTS),
        *whites(subject),
        *(s for part in PARTS for s in subject.agreement(part, subject.walking(part))),
        *lines(subject, _SCOPE, walked(subject, each=False)),
    ]
    return "\n".join([*(f"# {line}" for line in comments), *rows]) + "\n"
