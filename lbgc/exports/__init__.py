"""A sensor in other tools' terms: each format a pure function from a sensor to a file's text."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lbgc.errors import require, require_choice
from lbgc.exports.autopilots import ardupilot, px4
from lbgc.exports.gazebo import gazebo
from lbgc.exports.gnss_ins_sim import gnss_ins_sim
from lbgc.exports.gtsam import gtsam
from lbgc.exports.inertial_odometry import kalibr, openvins
from lbgc.exports.matlab import FILE, matlab
from lbgc.exports.ros import ros
from lbgc.exports.subject import Subject


@dataclass(frozen=True)
class Format:
    """Another tool's file."""

    file: str
    """Its name."""
    text: Callable[[Subject], str]
    """Its content for a sensor."""


FORMATS = {
    "kalibr": Format("imu.yaml", kalibr),
    "openvins": Format("kalibr_imu_chain.yaml", openvins),
    "gtsam": Format("gtsam.yaml", gtsam),
    "ros": Format("sensor_msgs_imu.yaml", ros),
    "gazebo": Format("imu.sdf", gazebo),
    "px4": Format("px4.params", px4),
    "ardupilot": Format("ardupilot.parm", ardupilot),
    "matlab": Format(FILE, matlab),
    "gnss_ins_sim": Format("imu_errors.py", gnss_ins_sim),
}
"""What a sensor can be written as, by the name that users give."""


def require_formats(name: str, formats: Sequence[str]) -> None:
    """Raise InputError unless each format is one that there is, and stands once. name : the key."""
    for own in formats:
        require_choice(name, own, list(FORMATS))
    require(len(set(formats)) == len(formats), name, formats, "must name each format once")


def written(subject: Subject, formats: Sequence[str]) -> dict[str, str]:
    """The text of each file, by its name."""
    return {FORMATS[own].file: FORMATS[own].text(subject) for own in formats}
