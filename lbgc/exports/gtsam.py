"""A sensor as GTSAM's ImuFactor and CombinedImuFactor take it: covariances of PreintegrationParams.

GTSAM reads no file: this one has its fields by name, row by row, in SI, for
`params->setGyroscopeCovariance(...)` and its like. All are in continuous time: GTSAM divides
gyroscopeCovariance and accelerometerCovariance by dt, and multiplies biasOmegaCovariance and
biasAccCovariance by dt (gtsam/navigation/CombinedImuFactor.cpp, integrateMeasurement). So they are
N^2 and K^2 of IEEE Std 952, two-sided, of each axis. The plain ImuFactor has the first two alone,
and its biases are constants between two of its keys. Flicker has no field: a random walk stands for
it where the sensor has none of its own. integrationCovariance and biasAccOmegaInt are no figures of
a sensor, and left to the user.
"""

from lbgc.exports.losses import COUNTS, SLOW, WALK, WHITE, Scope, lines, walked, whites
from lbgc.exports.subject import PARTS, Subject, diagonal, number

_SCOPE = Scope(WHITE | WALK | COUNTS, dict.fromkeys(SLOW, "the random walk"))
_ROWS = (
    ("gyroscopeCovariance", "gyro", "N", "(rad/s)^2/Hz"),
    ("accelerometerCovariance", "accel", "N", "(m/s^2)^2/Hz"),
    ("biasOmegaCovariance", "gyro", "K", "(rad/s^2)^2/Hz"),
    ("biasAccCovariance", "accel", "K", "(m/s^3)^2/Hz"),
)


def gtsam(subject: Subject) -> str:
    """The content of a YAML file with the covariances, in continuous time."""
    figures = {part: subject.walking_each(part) for part in PARTS}
    comments = [
        *subject.title("GTSAM (PreintegrationParams, PreintegrationCombinedParams)"),
        "continuous-time covariances: GTSAM itself divides the first two by dt, and multiplies the "
        "others by it",
        *whites(subject),
        *(said for part in PARTS for said in subject.agreement(part, figures[part])),
        *lines(subject, _SCOPE, walked(subject, each=True)),
    ]
    out = [f"# {line}" for line in comments]
    for name, part, field, unit in _ROWS:
        out.append(f"{name}:  # {unit}")
        matrix = diagonal([getattr(own, field) ** 2 for own in figures[part]])
        out += [f"  - [{', '.join(map(number, row))}]" for row in matrix]
    return "\n".join(out) + "\n"
