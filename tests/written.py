"""One recording of an IMU, written in every binary format that is read, each by its own library, or
byte by byte where a format's description is short."""

import bz2
import gzip
import importlib.util
import lzma
import shutil
import struct
import warnings
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet
import scipy.io

from lbgc.data.record import mock_record

MOCK = mock_record()
NAMES = ["t", "w_x", "w_y", "w_z", "f_x", "f_y", "f_z"]
RATE = 10.0


def rows(count: int) -> np.ndarray:
    """The recording as a table has it: s, rad/s, m/s^2, (count, 7)."""
    return np.column_stack([np.arange(count) / RATE, MOCK.gyro[:count], MOCK.accel[:count]])


@dataclass(frozen=True)
class Written:
    """How the recording is written in a format, and how it is read again."""

    write: Callable[[Path, np.ndarray], None]
    name: str
    """Of the file, or of a directory."""
    said: Mapping[str, Any] = field(default_factory=dict)
    """What a user must say of it."""
    package: str | None = None
    """What its reader needs."""
    rounding: float = 2.0**-50
    """The largest relative error of a number that was written and read."""


def _text(table: np.ndarray) -> bytes:
    lines = [",".join(NAMES), *(",".join(f"{v!r}" for v in row) for row in table.tolist())]
    return ("\n".join(lines) + "\n").encode()


def _zip(path: Path, table: np.ndarray) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("log.csv", _text(table))


def _feather(path: Path, table: np.ndarray, **options: Any) -> None:
    with warnings.catch_warnings(action="ignore"):  # of version 1
        pa.feather.write_feather(pa.table(dict(zip(NAMES, table.T, strict=True))), path, **options)


def _stream(path: Path, table: np.ndarray) -> None:
    columns = pa.table(dict(zip(NAMES, table.T, strict=True)))
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_stream(file, columns.schema) as writer:
        writer.write_table(columns, max_chunksize=100)


def structured(table: np.ndarray) -> np.ndarray:
    made = np.empty(len(table), [(name, "<f8") for name in NAMES])
    for name, values in zip(NAMES, table.T, strict=True):
        made[name] = values
    return made


def _npy_3(path: Path, table: np.ndarray) -> None:
    """A field whose name is beyond Latin letters asks for version 3.0."""
    made = np.zeros(
        len(table), [*((name, "<f8") for name in NAMES), ("\N{GREEK SMALL LETTER OMEGA}", "<f4")]
    )
    for name, values in zip(NAMES, table.T, strict=True):
        made[name] = values
    with path.open("wb") as file:
        np.lib.format.write_array(file, made, version=(3, 0))


def _parts(table: np.ndarray) -> dict[str, np.ndarray]:
    return {"time": table[:, 0], "gyro": table[:, 1:4], "accel": table[:, 4:]}


def _npz(path: Path, table: np.ndarray) -> None:
    np.savez_compressed(path, **_parts(table), serial=np.array("A1"))


def _matlab(path: Path, table: np.ndarray) -> None:
    scipy.io.savemat(path, {"imu": _parts(table), "name": "x"}, do_compression=True)


def _matlab_rows(path: Path, table: np.ndarray) -> None:
    parts = {name: np.atleast_2d(values.T) for name, values in _parts(table).items()}
    scipy.io.savemat(path, parts, format="4")


def _hdf5(path: Path, table: np.ndarray) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        group = file.create_group("sensors/imu")
        for name, values in _parts(table).items():
            group.create_dataset(name, data=values, chunks=True, compression="gzip")
        group["gyro"].attrs["units"] = "rad s-1"
        file["temperature"] = np.zeros(5)


def _hdf5_compound(path: Path, table: np.ndarray) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file["log"] = structured(table)


def _matlab_73(path: Path, table: np.ndarray) -> None:
    """An HDF5 file behind MATLAB's header, each array's axes in the other order."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in _parts(table).items():
            file[f"imu/{name}"] = np.atleast_2d(values.T if values.ndim == 2 else values)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def _messages(table: np.ndarray, ros1: bool):
    """Each row's time, ns, and the message of it, serialised by rosbags."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    kinds = store.types
    header, time = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]
    vector, turn = kinds["geometry_msgs/msg/Vector3"], kinds["geometry_msgs/msg/Quaternion"]
    none = np.zeros(9)
    for number, row in enumerate(table.tolist()):
        ns = round(row[0] * 1e9) + 1_700_000_000_000_000_000
        stamp = time(ns // 10**9, ns % 10**9)
        own = header(number, stamp, "imu_link") if ros1 else header(stamp, "imu_link")
        message = kinds["sensor_msgs/msg/Imu"](
            own, turn(0.0, 0.0, 0.0, 1.0), none, vector(*row[1:4]), none, vector(*row[4:]), none
        )
        kind = "sensor_msgs/msg/Imu"
        yield ns, (store.serialize_ros1 if ros1 else store.serialize_cdr)(message, kind)


def _ros1(path: Path, table: np.ndarray, topics: tuple[str, ...] = ("/imu",)) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.BZ2)
    with writer:
        store = get_typestore(Stores.ROS1_NOETIC)
        for topic in topics:
            own = writer.add_connection(topic, "sensor_msgs/msg/Imu", typestore=store)
            for ns, content in _messages(table, ros1=True):
                writer.write(own, ns + 1000, content)


def ros1_of_two_topics(path: Path, table: np.ndarray) -> None:
    _ros1(path, table, ("/left/imu", "/right/imu"))


def _ros2(path: Path, table: np.ndarray, mcap: bool = False) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        store = get_typestore(Stores.ROS2_HUMBLE)
        own = writer.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for ns, content in _messages(table, ros1=False):
            writer.write(own, ns + 1000, content)


def _ros2_file(path: Path, table: np.ndarray) -> None:
    """The one file of a ROS 2 bag, without its directory."""
    made = path.with_suffix("")
    _ros2(made, table, mcap=path.suffix == ".mcap")
    shutil.move(made / f"{made.name}{path.suffix}", path)
    shutil.rmtree(made)


def _of_kind(kind: bytes, content: bytes) -> bytes:
    """A ULog message."""
    return struct.pack("<H", len(content)) + kind + content


def ulog(messages: Mapping[str, tuple[str, Callable[[np.ndarray], bytes]]], table: np.ndarray):
    """A ULog file: its header, the messages' fields, and each row in each message."""
    made = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000)]
    for name, (fields, _) in messages.items():
        made.append(_of_kind(b"F", f"{name.partition('.')[0]}:{fields}".encode()))
    for number, name in enumerate(messages):
        base, _, instance = name.partition(".")
        made.append(_of_kind(b"A", struct.pack("<BH", int(instance or 0), number) + base.encode()))
    for row in table:
        for number, (_, pack) in enumerate(messages.values()):
            made.append(_of_kind(b"D", struct.pack("<H", number) + pack(row)))
    return b"".join(made)


def _us(row: np.ndarray) -> int:
    return 5_000_000 + round(row[0] * 1e6)


COMBINED = (
    "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
    "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;"
    "uint32_t accelerometer_integral_dt;",
    lambda row: struct.pack("<Q3fIi3fI", _us(row), *row[1:4], 100_000, 0, *row[4:], 100_000),
)
VEHICLE = (
    "uint64_t timestamp;uint64_t timestamp_sample;float[3] delta_angle;float[3] delta_velocity;"
    "uint32_t delta_angle_dt;uint32_t delta_velocity_dt;",
    lambda row: struct.pack("<QQ6fII", _us(row) + 7, _us(row), *(row[1:4] * 0.1),
                            *(row[4:] * 0.05), 100_000, 50_000),
)  # fmt: skip
SENSOR = "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;"
GYRO = (SENSOR, lambda row: struct.pack("<QQ3f", _us(row) + 9, _us(row), *row[1:4]))
ACCEL = (SENSOR, lambda row: struct.pack("<QQ3f", _us(row) + 9, _us(row) + 40, *row[4:]))


def _ulog(**messages: Any) -> Callable[[Path, np.ndarray], None]:
    return lambda path, table: path.write_bytes(ulog(messages, table)) and None


def _format(kind: int, size: int, name: str, letters: str, columns: str) -> bytes:
    """A FMT message of a dataflash log."""
    texts = (name.encode(), letters.encode(), columns.encode())
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, *texts)


def dataflash(table: np.ndarray, instances: int = 1) -> bytes:
    made = [_format(0x80, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
            _format(0x81, 3 + 9 + 24, "IMU", "QBffffff",
                    "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
            _format(0x82, 3 + 12, "BARO", "Qf", "TimeUS,Alt")]  # fmt: skip
    for row in table:
        made.append(b"\xa3\x95\x82" + struct.pack("<Qf", _us(row), 1.0))
        for instance in range(instances):
            own = struct.pack("<QB6f", _us(row), instance, *row[1:])
            made.append(b"\xa3\x95\x81" + own)
    return b"".join(made)


def _dataflash_text(path: Path, table: np.ndarray) -> None:
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
             "FMT, 129, 36, IMU, QBffffff, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"]  # fmt: skip
    for row in table:
        lines.append(", ".join(["IMU", str(_us(row)), "0", *(f"{v!r}" for v in row[1:].tolist())]))
    path.write_text("\n".join(lines) + "\n")


def _workspace(path: Path, table: np.ndarray) -> None:
    import pandas
    import rdata

    with warnings.catch_warnings(action="ignore"):
        rdata.write_rda(path, {"imu": pandas.DataFrame(table, columns=NAMES), "n": [1.0, 2.0]})


def _r_object(path: Path, table: np.ndarray) -> None:
    import pandas
    import rdata

    with warnings.catch_warnings(action="ignore"):
        rdata.write_rds(path, pandas.DataFrame(table, columns=NAMES))


ROW = ["t:f8", "pad:V2", *(f"{name}:>f8" for name in NAMES[1:])]


def _raw(path: Path, table: np.ndarray) -> None:
    made = np.zeros(len(table), [("t", "<f8"), ("pad", "V2"), *((n, ">f8") for n in NAMES[1:])])
    for name, values in zip(NAMES, table.T, strict=True):
        made[name] = values
    path.write_bytes(b"HEAD" + made.tobytes())


def _parquet(path: Path, table: np.ndarray) -> None:
    pa.parquet.write_table(pa.table(dict(zip(NAMES, table.T, strict=True))), path)


def _psins(path: Path, table: np.ndarray) -> None:
    """Increments in counts of 2^-20 arcsec and 2^-10 ug s, not rounded to whole ones."""
    dt, gravity = table[1, 0] - table[0, 0], 9.78
    gyro = np.rad2deg(table[:, 1:4]) * 3600 * dt * 2**20
    accel = table[:, 4:] / gravity * 1e6 * dt * 2**10
    scales = [2.0**-20] * 3 + [2.0**-10] * 3
    head = [[0.0] * 6, [32.76, 35.0, 0.0, 0.0, 1e3 * dt, gravity], scales]
    np.savetxt(path, np.vstack([head, np.hstack([gyro, accel])]), "%.17g")


SINGLE = 2.0**-23
"""Rounding of float32"""
POSITIONS = {"columns": [2, 3, 4, 5, 6, 7], "time_column": 1}
EVERY: dict[str, Written] = {
    "parquet": Written(_parquet, "a.parquet"),
    "psins": Written(_psins, "a.imu", {"reader": "psins"}, rounding=2.0**-46),
    "text gz": Written(lambda p, t: p.write_bytes(gzip.compress(_text(t))) and None, "a.csv.gz"),
    "text bz2": Written(lambda p, t: p.write_bytes(bz2.compress(_text(t))) and None, "a.csv.bz2"),
    "text xz": Written(lambda p, t: p.write_bytes(lzma.compress(_text(t))) and None, "a.csv.xz"),
    "text zip": Written(_zip, "a.zip"),
    "feather": Written(_feather, "a.feather"),
    "feather zstd": Written(lambda p, t: _feather(p, t, compression="zstd"), "a.feather"),
    "feather 1": Written(lambda p, t: _feather(p, t, version=1), "a.feather"),
    "arrow stream": Written(_stream, "a.arrows"),
    "npy": Written(lambda p, t: np.save(p, t), "a.npy", POSITIONS),
    "npy by columns": Written(lambda p, t: np.save(p, np.asfortranarray(t)), "a.npy", POSITIONS),
    "npy turned": Written(lambda p, t: np.save(p, np.ascontiguousarray(t.T)), "a.npy", POSITIONS),
    "npy fields": Written(lambda p, t: np.save(p, structured(t)), "a.npy"),
    "npy 3.0": Written(_npy_3, "a.npy"),
    "npz": Written(_npz, "a.npz"),
    "matlab 7": Written(_matlab, "a.mat"),
    "matlab 4": Written(_matlab_rows, "a.mat"),
    "matlab 7.3": Written(_matlab_73, "a.mat", {}, "h5py"),
    "hdf5": Written(_hdf5, "a.h5", {}, "h5py"),
    "hdf5 compound": Written(_hdf5_compound, "a.hdf5", {}, "h5py"),
    "ros 1": Written(_ros1, "a.bag", {}, "rosbags"),
    "ros 2": Written(_ros2, "a", {}, "rosbags"),
    "ros 2 sqlite": Written(_ros2_file, "a.db3", {}, "rosbags"),
    "ros 2 mcap": Written(_ros2_file, "a.mcap", {}, "rosbags"),
    "ulog combined": Written(_ulog(sensor_combined=COMBINED), "a.ulg", {}, "pyulog", SINGLE),
    "ulog vehicle_imu": Written(_ulog(vehicle_imu=VEHICLE), "a.ulg", {}, "pyulog", SINGLE),
    "ulog two sensors": Written(_ulog(sensor_gyro=GYRO, sensor_accel=ACCEL), "a.ulg", {}, "pyulog",
                                SINGLE),
    "dataflash": Written(lambda p, t: p.write_bytes(dataflash(t)) and None, "a.bin",
                         rounding=SINGLE),
    "dataflash text": Written(_dataflash_text, "a.log"),
    "r": Written(_workspace, "a.rda", {}, "rdata"),
    "r object": Written(_r_object, "a.rds", {}, "rdata"),
    "rows": Written(_raw, "a.bin", {"dtype": ROW, "skip_bytes": 4}),
}  # fmt: skip
"""Every format, by the name that a test gives it."""


_STATED = ("ros", "ulog", "dataflash")
"""Formats that state their units"""


def keys_of(kind: str) -> dict[str, Any]:
    """What a user must say of a format's file, by the keys of `LogConfig`."""
    units = {"gyro_unit": "auto", "accel_unit": "auto"}
    if not kind.startswith(_STATED):
        units = {"gyro_unit": "rad/s", "accel_unit": "m/s2"}
    return {**units, **EVERY[kind].said}


def is_installed(kind: str) -> bool:
    """Whether what reads a format is there."""
    package = EVERY[kind].package
    return package is None or importlib.util.find_spec(package) is not None
