"""A sensor as ROS 2 reads it: the covariances of sensor_msgs/msg/Imu.

The message has 3 x 3 covariances "of the measurement", row major about x, y, z; the variances of a
data sheet go on the diagonal, and -1 first says that there is no estimate of this kind
(common_interfaces, sensor_msgs/msg/Imu.msg). robot_localization takes each message's error as
independent of every other's (its documentation, "Preparing your data"), so the figure is the
variance of the white noise in one sample, N^2 times the rate, and there is no place for what is
slow. A filter that averages m of these messages has N^2/(m dt), as the sensor has.
"""

from lbgc.exports.losses import COUNTS, WHITE, Scope, lines, whites
from lbgc.exports.subject import PARTS, Subject, diagonal, number
from lbgc.sensor import stand_in

_SCOPE = Scope(WHITE | COUNTS)
_FIELDS = {
    "gyro": ("angular_velocity_covariance", "(rad/s)^2"),
    "accel": ("linear_acceleration_covariance", "(m/s^2)^2"),
}


def ros(subject: Subject) -> str:
    """The content of a YAML file with the message's covariances."""
    figures = {part: stand_in.white(subject.slow(part)) for part in PARTS}
    comments = [
        *subject.title("ROS 2 (sensor_msgs/msg/Imu, robot_localization)"),
        f"variance of the white noise in one sample at {subject.rate_hz:g} Hz, row major; in "
        "proportion at another rate",
        "the message has no figure for a bias or its drift: a filter must have states for them",
        *whites(subject),
        *(said for part in PARTS for said in subject.agreement(part, figures[part])),
        *lines(subject, _SCOPE),
    ]
    rows = [f"orientation_covariance: [-1.0, {', '.join(['0.0'] * 8)}]  # no estimate"]
    for part, (name, unit) in _FIELDS.items():
        matrix = diagonal([own.N**2 * subject.rate_hz for own in figures[part]])
        values = ", ".join(number(value) for row in matrix for value in row)
        rows.append(f"{name}: [{values}]  # {unit}")
    return "\n".join([*(f"# {line}" for line in comments), *rows]) + "\n"
