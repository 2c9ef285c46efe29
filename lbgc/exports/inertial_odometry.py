"""A sensor as visual-inertial tools read it: imu.yaml of Kalibr, kalibr_imu_chain.yaml of OpenVINS.

Both have one white noise and one random walk of the bias for a triad. Densities are the roots of
two-sided PSDs in continuous time: a sample has white noise of sigma density/sqrt(dt), and the bias
walks by random_walk sqrt(dt) a sample (Kalibr wiki, "IMU Noise Model"; OpenVINS,
ov_msckf/src/state/Propagator.cpp, where both are squared, the first over dt and the second times
dt). So they are IEEE Std 952's N and K, and no sqrt(2) comes in. Neither has flicker. Of a sensor
that is stated with a random walk, that is told and the flicker is lost; else a random walk stands
for the flicker (`lbgc.sensor.stand_in`), since none at all would be a bias that never moves, and
Kalibr divides by its square (IccSensors.py, addBiasMotionTerms). The keys are those of
`lbgc.sensor.kalibr`.
"""

from lbgc.exports.losses import COUNTS, SLOW, WALK, WHITE, Scope, lines, walked, whites
from lbgc.exports.subject import PARTS, Subject, number, worst
from lbgc.sensor.kalibr import KEYS

_UNITS = {
    "gyroscope_noise_density": "rad/s/sqrt(Hz), two-sided",
    "gyroscope_random_walk": "rad/s^2/sqrt(Hz)",
    "accelerometer_noise_density": "m/s^2/sqrt(Hz), two-sided",
    "accelerometer_random_walk": "m/s^3/sqrt(Hz)",
}
_SCOPE = Scope(WHITE | WALK | COUNTS, dict.fromkeys(SLOW, "the random walk"))
_IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_INTRINSICS = {
    "Tw": _IDENTITY,
    "R_IMUtoGYRO": _IDENTITY,
    "Ta": _IDENTITY,
    "R_IMUtoACC": _IDENTITY,
    "Tg": ((0.0, 0.0, 0.0),) * 3,
}


def kalibr(subject: Subject) -> str:
    """The content of Kalibr's imu.yaml."""
    rows = [*_figures(subject), "rostopic: /imu0", f"update_rate: {subject.rate_hz:.9g}"]
    return "\n".join([*_comments(subject, "Kalibr"), *rows]) + "\n"


def openvins(subject: Subject) -> str:
    """The content of OpenVINS's kalibr_imu_chain.yaml, with intrinsics of a perfect sensor."""
    pose = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    rows = [
        *_matrix("T_i_b", pose),
        *_figures(subject),
        "rostopic: /imu0",
        "time_offset: 0.0",
        f"update_rate: {subject.rate_hz:.9g}",
        'model: "kalibr"',
        *(row for name, matrix in _INTRINSICS.items() for row in _matrix(name, matrix)),
    ]
    head = ["%YAML:1.0", *_comments(subject, "OpenVINS"), "", "imu0:"]
    return "\n".join([*head, *(f"  {row}" for row in rows)]) + "\n"


def _comments(subject: Subject, tool: str) -> list[str]:
    """The comments in front: whose figures these are, where they hold, and what is lost."""
    found = [
        *subject.title(tool),
        *(worst(subject, part) for part in PARTS),
        *whites(subject),
        *(s for part in PARTS for s in subject.agreement(part, subject.walking(part))),
        *(said for part in PARTS for said in _unwalked(subject, part)),
        *lines(subject, _SCOPE, walked(subject, each=False)),
    ]
    return [f"# {line}" for line in found]


def _unwalked(subject: Subject, part: str) -> list[str]:
    """The warning that a random walk is zero, which Kalibr would divide by."""
    if subject.walking(part).K > 0:
        return []
    return [f"{part}: the sensor is stated with no drift: Kalibr divides by its random walk's "
            "square, so set one that is not zero"]  # fmt: skip


def _figures(subject: Subject) -> list[str]:
    """The lines of the four noise keys."""
    rows = []
    for key, (part, _) in KEYS.items():
        figures = subject.walking(part)
        value = figures.N if key.endswith("noise_density") else figures.K
        rows.append(f"{key}: {number(value)}  # {_UNITS[key]}")
    return rows


def _matrix(name: str, rows: tuple[tuple[float, ...], ...]) -> list[str]:
    """The lines of a matrix, row by row."""
    return [f"{name}:", *(f"  - {list(row)}" for row in rows)]
