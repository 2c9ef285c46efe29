"""Bags of ROS 1 and ROS 2 (SQLite, MCAP, and directories of them): messages sensor_msgs/Imu, in
rad/s and m/s^2 by REP 103. They are decoded by the layout of that message, which is fixed; what a
bag says of a message's layout is compared with it, and never made into code."""

import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lbgc.data.readers.formats.extras import needed
from lbgc.data.readers.formats.table import AT_ONCE, Frame, Pieces, Table

ROS1, MCAP, SQLITE = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\0"
METADATA = "metadata.yaml"
_IMU = ("sensor_msgs/msg/Imu", "sensor_msgs/Imu")
_FIELDS = [
    ("Header", "header"), ("Quaternion", "orientation"),
    ("float64[9]", "orientation_covariance"), ("Vector3", "angular_velocity"),
    ("float64[9]", "angular_velocity_covariance"), ("Vector3", "linear_acceleration"),
    ("float64[9]", "linear_acceleration_covariance"),
]  # fmt: skip
_FIELD = re.compile(r"^\s*([\w/]+(?:\[\d*\])?)\s+(\w+)\s*(?:#.*)?$")
_NUMBERS = 37
"""Numbers after the header: quaternion, 9, rate, 9, force, 9"""
_RATE, _FORCE = 13, 25
"""Places of the rate's and the force's x among them"""
_LONGEST = 1000
"""Bytes of the name of a frame"""
_ROW = np.dtype([("stamp", "<i8"), ("received", "<i8"), ("values", "<f8", (6,))])
_NAMES = (
    "header.stamp", "received", *(f"angular_velocity.{axis}" for axis in "xyz"),
    *(f"linear_acceleration.{axis}" for axis in "xyz"),
)  # fmt: skip
_UNITS = ("ns", "ns", *["rad/s"] * 3, *["m/s2"] * 3)
_FRAME = Frame(
    ("x", "-y", "-z"),
    "ROS's frames are forward, left, up by REP 103",
    "unless the sensor's own frame is another, as REP 145 allows",
)


def read(path: Path) -> list[Table]:
    """The tables of a bag's topics with IMU messages. Raises ValueError where there is none;
    InputError where rosbags is missing."""
    is_ros1, opened = _opened(path)
    opened.open()
    topics: dict[str, list[Any]] = {}
    for own in opened.connections:
        if _is_imu(own.msgtype, own.msgdef):
            topics.setdefault(str(own.topic), []).append(own)
    if not topics:
        kinds = ", ".join(f"{own.topic} ({own.msgtype})" for own in opened.connections[:20])
        raise ValueError(f"holds no sensor_msgs/Imu, but {kinds or 'nothing'}")
    return [_table(opened, topic, own, is_ros1) for topic, own in topics.items()]


def _table(opened: Any, topic: str, connections: Sequence[Any], is_ros1: bool) -> Table:
    """The table of a topic, which several publishers may have sent."""
    rows = sum(own.msgcount for own in connections)
    return Table(topic, _NAMES, _UNITS, rows,
                 lambda which: _pieces(opened, connections, is_ros1, which), (_FRAME.note,),
                 _FRAME)  # fmt: skip


def _opened(path: Path) -> tuple[bool, Any]:
    """Whether a bag is of ROS 1, and the library's reader of it."""
    if path.is_dir():
        _require_own_files(path)
        return False, needed("rosbags.rosbag2.reader").DirectoryReader(path)
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith(ROS1):
        return True, needed("rosbags.rosbag1").Reader(path)
    readers = needed("rosbags.rosbag2.reader")
    return False, (readers.McapReader if head.startswith(MCAP) else readers.Sqlite3Reader)(path)


def _require_own_files(path: Path) -> None:
    """Raise ValueError unless all that a bag's directory holds are plain files of its own."""
    for own in path.iterdir():
        if not own.is_file() or own.resolve().parent != path.resolve():
            raise ValueError(f"{own.name} is no file of its own")


def _is_imu(kind: str, definition: Any) -> bool:
    """Whether messages are sensor_msgs/Imu, or of another name with the same fields. Raises
    ValueError where a bag says that the fields of sensor_msgs/Imu are others."""
    text = definition.data if definition.format.name == "MSG" else ""
    if not text.strip():
        return kind in _IMU
    own = text.partition("\n===")[0]
    found = [_FIELD.match(line) for line in own.split("\n")[:200]]
    fields = [(match[1].rpartition("/")[2], match[2]) for match in found if match]
    if kind in _IMU and fields != _FIELDS:
        raise ValueError(f"says that {kind} has other fields than it has")
    return fields == _FIELDS


def _pieces(opened: Any, connections: Sequence[Any], is_ros1: bool, which: Sequence[int]) -> Pieces:
    """Columns of a topic, piece by piece."""
    decode = _of_ros1 if is_ros1 else _of_cdr
    rows, count = np.empty(AT_ONCE, _ROW), 0
    for _, received, content in opened.messages(connections):
        numbers, stamp = decode(content)
        rows["stamp"][count], rows["received"][count] = stamp, received
        rows["values"][count] = *numbers[_RATE : _RATE + 3], *numbers[_FORCE : _FORCE + 3]
        count += 1
        if count == AT_ONCE:
            yield [_column(rows, at).copy() for at in which]
            count = 0
    yield from [[_column(rows[:count], at) for at in which]] if count else []


def _column(rows: np.ndarray, at: int) -> np.ndarray:
    """A column of decoded rows."""
    return rows["values"][:, at - 2] if at > 1 else rows["stamp" if at == 0 else "received"]


def _of_ros1(content: bytes) -> tuple[tuple[float, ...], int]:
    """The numbers and the stamp, ns, of a message in ROS 1's layout."""
    _, seconds, nanoseconds, named = struct.unpack_from("<IIII", content)
    first = 16 + named
    if named > _LONGEST or len(content) != first + 8 * _NUMBERS:
        raise ValueError(f"an IMU message of {len(content)} bytes")
    return struct.unpack_from(f"<{_NUMBERS}d", content, first), seconds * 10**9 + nanoseconds


def _of_cdr(content: bytes) -> tuple[tuple[float, ...], int]:
    """The numbers and the stamp, ns, of a message in CDR, either byte order."""
    order = {b"\0\0": ">", b"\0\1": "<"}.get(bytes(content[:2]))
    if order is None:
        raise ValueError("a message in no plain CDR")
    seconds, nanoseconds, named = struct.unpack_from(f"{order}iII", content, 4)
    first = 4 + -(-(12 + named) // 8) * 8
    if named > _LONGEST or not 0 <= len(content) - first - 8 * _NUMBERS < 8:
        raise ValueError(f"an IMU message of {len(content)} bytes")
    return struct.unpack_from(f"{order}{_NUMBERS}d", content, first), seconds * 10**9 + nanoseconds
