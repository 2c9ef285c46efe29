"""PX4's ULog files: messages of its IMUs, in rad/s and m/s^2, forward-right-down, by its message
definitions (sensor_combined, vehicle_imu, sensor_gyro with sensor_accel)."""

import struct
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lbgc.data.readers.formats.extras import needed
from lbgc.data.readers.formats.table import Frame, Table, cut_short, in_memory

MAGIC = b"ULog\x01\x12\x35"
_MESSAGES = ["sensor_combined", "vehicle_imu", "sensor_gyro", "sensor_accel"]
_AXES = "xyz"
_GYRO, _ACCEL = [f"gyro_{axis}" for axis in _AXES], [f"accel_{axis}" for axis in _AXES]
_UNITS = {"timestamp": "us", **dict.fromkeys(_GYRO, "rad/s"), **dict.fromkeys(_ACCEL, "m/s2")}
_HEADER, _FLAGS = 16, struct.Struct("<HB16x3Q")
"""Bytes before the first message, and the one that says where something was added to the file"""
_ALIKE = 0.98
"""The share of two sensors' samples that must have come together."""
_FRAME = Frame(("x", "y", "z"), "PX4 states rates and forces forward, right, down")


def read(path: Path) -> list[Table]:
    """The tables of a ULog file's IMU messages. Raises InputError where pyulog is missing."""
    found = needed("pyulog").ULog(str(path), _MESSAGES, disable_str_exceptions=True)
    notes = [_FRAME.note]
    if found.file_corruption:
        notes.append(f"damage: parts of {path.name} are damaged and were passed over")
    elif left := _left_at_end(path):
        notes.append(cut_short(path.name, f"the last {left} bytes are no whole message"))
    if found.dropouts:
        lost = sum(own.duration for own in found.dropouts)
        notes.append(f"dropouts: {path.name} says that {len(found.dropouts)} times, {lost} ms in "
                     "all, its logger could not write")  # fmt: skip
    topics = {(own.name, own.multi_id): own.data for own in found.data_list}
    several = {name for name, number in topics if number > 0}
    tables = []
    for (name, number), data in topics.items():
        title = f"{name}_{number}" if name in several else name
        columns = _columns(name, data, topics.get(("sensor_accel", number)))
        if columns:
            tables.append(in_memory(title, columns, _UNITS, tuple(notes), _FRAME))
    return tables


def _left_at_end(path: Path) -> int:
    """The bytes of a last message that is cut short, of the log and of each part that was added to
    it. The file's messages are whole otherwise."""
    content = path.read_bytes()
    added: list[int] = []
    if len(content) >= _HEADER + _FLAGS.size and content[_HEADER + 2] == ord("B"):
        added = [at for at in _FLAGS.unpack_from(content, _HEADER)[2:] if at]
    left = 0
    for first, end in pairwise([_HEADER, *added, len(content)]):
        at = first
        while at + 3 <= end:
            after = at + 3 + int.from_bytes(content[at : at + 2], "little")
            if after > end:
                break
            at = after
        left += max(0, end - at)
    return left


def _columns(
    name: str, data: Mapping[str, Any], accel: Mapping[str, Any] | None
) -> dict[str, np.ndarray]:
    """The columns of one message's data; none where they are not those of an IMU.

    accel : data of the accelerometer's message of the same number, which stand beside sensor_gyro's
    where both came at the same times.
    """
    if name == "sensor_combined":
        return {
            "timestamp": data["timestamp"],
            **{_GYRO[at]: data[f"gyro_rad[{at}]"] for at in range(3)},
            **{_ACCEL[at]: data[f"accelerometer_m_s2[{at}]"] for at in range(3)},
        }
    if name == "vehicle_imu":  # increments, each over an interval of its own
        return {
            "timestamp": data["timestamp_sample"],
            **{_GYRO[at]: _rate(data, "angle", at) for at in range(3)},
            **{_ACCEL[at]: _rate(data, "velocity", at) for at in range(3)},
        }
    names = _GYRO if name == "sensor_gyro" else _ACCEL
    found = {"timestamp": _stamps(data), **_vector(names, data)}
    if name == "sensor_gyro" and accel is not None:
        pairs = _together(_stamps(data), _stamps(accel))
        if pairs is not None:
            found = {own: values[pairs[0]] for own, values in found.items()}
            found |= {own: values[pairs[1]] for own, values in _vector(_ACCEL, accel).items()}
    return found


def _vector(names: Sequence[str], data: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The three axes of a sensor's message."""
    return {own: data[axis] for own, axis in zip(names, _AXES, strict=True)}


def _stamps(data: Mapping[str, Any]) -> np.ndarray:
    """The times of a sensor's samples, us: when they were taken, where the message states that."""
    key = "timestamp_sample" if "timestamp_sample" in data else "timestamp"
    return np.asarray(data[key], np.int64)


def _rate(data: Mapping[str, Any], kind: str, at: int) -> np.ndarray:
    """An increment's mean rate: the increment over its interval, which stands beside it in us."""
    seconds = data[f"delta_{kind}_dt"] * 1e-6
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(data[f"delta_{kind}[{at}]"].astype(np.float64) / seconds)


def _together(gyro: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The rows of two sensors that are one sample: stamps, us, less than a quarter of a step apart.
    None where that is not so of nearly all rows."""
    if min(len(gyro), len(accel)) < 2:
        return None
    after = np.clip(np.searchsorted(accel, gyro), 1, len(accel) - 1)
    nearer = np.abs(accel[after] - gyro) < np.abs(accel[after - 1] - gyro)
    nearest = np.where(nearer, after, after - 1)
    rows = np.flatnonzero(np.abs(accel[nearest] - gyro) < np.median(np.diff(gyro)) / 4)
    once = len(np.unique(nearest[rows])) == len(rows)
    enough = len(rows) >= _ALIKE * max(len(gyro), len(accel))
    return (rows, nearest[rows]) if once and enough else None
