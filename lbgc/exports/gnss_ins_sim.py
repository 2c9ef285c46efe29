"""A sensor as gnss-ins-sim simulates it: dictionaries for IMU.set_gyro_error and set_accel_error.

A sample is truth + b + drift + white noise of arw/sqrt(dt) (vrw of the accelerometers), so these
are N of IEEE Std 952, SI. The drift begins at zero and goes on as

    drift = (1 - dt/T) drift + Normal(0, b_drift^2 (1 - e^(-2 dt/T))),

T = b_corr, so b_drift is about the standard deviation of a first-order Gauss-Markov process, and
b_corr its correlation time (gnss_ins_sim/pathgen/pathgen.py, bias_drift; its last factor was
b_drift dt before, which is another unit). Both are written so that this very recursion is exact:
with p = e^(-dt/T'), b_corr = dt/(1 - p), and b_drift makes the variance sigma^2. The process stands
for flicker and random walk together (`lbgc.sensor.stand_in`). An infinite b_corr is white noise of
b_drift a sample there, so a finite one stands where nothing drifts. The keys gyro_b_stability and
its like of IMU(accuracy=...) are the same in deg/h and deg/sqrt(h).
"""

import numpy as np

from lbgc.exports.losses import COUNTS, SLOW, WALK, WHITE, Scope, lines, whites
from lbgc.exports.subject import PARTS, Subject, number
from lbgc.sensor.stand_in import Figures

_SCOPE = Scope(WHITE | COUNTS, dict.fromkeys(SLOW | WALK, "b_drift and b_corr"))
_NAMES = {"gyro": ("gyro_err", "arw"), "accel": ("accel_err", "vrw")}


def gnss_ins_sim(subject: Subject) -> str:
    """The content of a Python file with both dictionaries."""
    figures = {part: subject.reverting_each(part) for part in PARTS}
    comments = [
        *subject.title("gnss-ins-sim"),
        "imu = imu_model.IMU(accuracy='low-accuracy', axis=6, gps=False)",
        "imu.set_gyro_error(gyro_err); imu.set_accel_error(accel_err)",
        "b is a constant: draw one where the sensor has a turn-on bias",
        "the drift begins at zero: its law holds after some b_corr",
        *whites(subject),
        *(said for part in PARTS for said in subject.agreement(part, figures[part])),
        *lines(subject, _SCOPE),
    ]
    rows = [row for part in PARTS for row in _dictionary(subject, part, figures[part])]
    return "\n".join([*(f"# {line}" for line in comments), "import numpy as np", "", *rows]) + "\n"


def _dictionary(subject: Subject, part: str, figures: list[Figures]) -> list[str]:
    """The lines of one triad's dictionary."""
    name, white = _NAMES[part]
    steps = np.array([subject.dt / own.T for own in figures])  # dt/T'
    times = subject.dt / -np.expm1(-steps)
    gains = np.sqrt(np.expm1(-2 * steps) / np.expm1(-2 * subject.dt / times))
    rows = {
        "b": [0.0 for _ in figures],
        "b_drift": [own.sigma * gain for own, gain in zip(figures, gains, strict=True)],
        "b_corr": times,
        white: [own.N for own in figures],
    }
    inner = [f"    '{k}': np.array([{', '.join(map(number, v))}])," for k, v in rows.items()]
    return [f"{name} = {{", *inner, "}"]
