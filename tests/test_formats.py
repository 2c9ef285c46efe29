"""One recording in every format that is read: the same record; and what none of them may do."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import written
from written import EVERY, MOCK, RATE, rows

from lbgc.data.logs import LogConfig, read
from lbgc.errors import InputError

COUNT = 250
SAID = {"latitude": 32.76, "heading_deg": 40.0, "bias_limit_deg_per_h": 5.0}


def installed(*packages: str | None) -> None:
    """Skip, by name, where a package of the extra `logs` is missing."""
    for package in packages:
        if package is not None and importlib.util.find_spec(package) is None:
            pytest.skip(f"needs {package}, of the extra logs")


def made(kind: str, home: Path, count: int = COUNT) -> Path:
    """A file of this format with the recording in it."""
    own = EVERY[kind]
    installed(own.package)
    own.write(home / own.name, rows(count))
    return home / own.name


def config(kind: str, path: Path, **changes: object) -> LogConfig:
    return LogConfig(**(SAID | {"path": str(path)} | written.keys_of(kind) | changes))


@pytest.mark.parametrize("kind", EVERY)
def test_one_recording_is_the_same_in_every_format(kind, tmp_path):
    (record,) = read(config(kind, made(kind, tmp_path)))
    rounding = EVERY[kind].rounding
    for found, wanted in ((record.gyro, MOCK.gyro), (record.accel, MOCK.accel)):
        np.testing.assert_allclose(found, wanted[:COUNT], rtol=rounding, atol=0)
    assert record.rate_hz == pytest.approx(RATE, rel=1e-6)


def refused(kind: str, path: Path, **changes: object) -> str:
    with pytest.raises(InputError) as caught:
        list(read(config(kind, path, **changes)))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("kind", ["ros 1", "ros 2", "ulog combined", "dataflash", "dataflash text"])
def test_a_format_that_states_its_units_and_frame_says_the_frame_and_refuses_others(kind, tmp_path):
    path = made(kind, tmp_path)
    (record,) = read(config(kind, path))
    assert any(note.startswith("axes: ") and "log.axes=[x," in note for note in record.notes)
    assert "columns say rad/s" in refused(kind, path, gyro_unit="deg/s")
    assert "columns say m/s2" in refused(kind, path, accel_unit="g")


def test_an_attribute_of_hdf5_is_the_unit(tmp_path):
    path = made("hdf5", tmp_path)
    assert "columns say rad/s" in refused("hdf5", path, gyro_unit="deg/s")


@pytest.mark.parametrize("kind", [k for k in EVERY if k != "rows" and EVERY[k].name != "a"])
def test_garbage_behind_a_formats_ending_is_refused(kind, tmp_path):
    installed(EVERY[kind].package)
    path = tmp_path / EVERY[kind].name
    for content in (np.random.default_rng(1).bytes(3000), b""):
        path.write_bytes(content)
        assert "log.path" in refused(kind, path)


CUT_SHORT = ("ulog", "dataflash")
"""Formats without an end, which a logger that loses power cuts anywhere."""


@pytest.mark.parametrize("kind", EVERY)
def test_a_file_that_is_cut_short_is_refused_or_read_as_far_as_it_goes(kind, tmp_path):
    path = made(kind, tmp_path)
    file = path / "a.db3" if path.is_dir() else path
    content = file.read_bytes()
    file.write_bytes(content[: len(content) * 6 // 10])
    if kind.startswith(CUT_SHORT):
        (record,) = read(config(kind, path))
        assert 100 < len(record.gyro) < COUNT
        np.testing.assert_allclose(record.accel, MOCK.accel[: len(record.accel)], rtol=2.0**-23)
        assert any(note.startswith("end: a.") for note in record.notes)
    else:
        said = refused(kind, path)
        assert "log.path" in said or (kind == "rows" and "leaves" in said)


def test_content_goes_before_the_ending(tmp_path):
    """A file is what it holds, whatever it is called."""
    for kind in ("npz", "feather", "npy fields", "text gz", "matlab 7"):
        path = made(kind, tmp_path)
        other = path.rename(tmp_path / "log.txt")
        (record,) = read(config(kind, other))
        np.testing.assert_allclose(record.gyro, MOCK.gyro[:COUNT], rtol=1e-14)


def test_objects_are_not_built(tmp_path):
    """An array of objects is a program for whoever unpacks it."""
    objects = np.array([{"a": 1}, None] * 10, dtype=object)
    np.save(tmp_path / "a.npy", objects)
    assert "holds objects, which are not built" in refused("npy", tmp_path / "a.npy")
    np.savez(tmp_path / "a.npz", imu=objects)
    assert "holds objects, which are not built" in refused("npz", tmp_path / "a.npz")
    parts = {"time": rows(COUNT)[:, 0], "gyro": MOCK.gyro[:COUNT], "accel": MOCK.accel[:COUNT]}
    np.savez(tmp_path / "b.npz", who=objects, **parts)
    (record,) = read(config("npz", tmp_path / "b.npz"))  # what is numbers beside is read
    np.testing.assert_array_equal(record.gyro, MOCK.gyro[:COUNT])


def test_a_class_in_a_mat_file_is_not_built(tmp_path):
    import scipy.io

    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"imu": rows(COUNT)})
    content = bytearray(path.read_bytes())
    assert content[144] == 6  # a matrix of doubles
    content[144] = 3  # an object
    path.write_bytes(content)
    assert "holds no table of numbers, but imu (object)" in refused("npy", path)


@pytest.mark.parametrize("outside", ["link", "storage", "virtual"])
def test_hdf5_that_refers_to_another_file_is_refused(outside, tmp_path):
    installed("h5py")
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as file:
        if outside == "link":
            file["gyro"] = h5py.ExternalLink("/etc/passwd", "x")
        elif outside == "storage":
            external = [(b"/etc/passwd", 0, 240)]
            file.create_dataset("gyro", (10, 3), "f8", external=external)
        else:
            layout = h5py.VirtualLayout((10, 3), "f8")
            layout[:] = h5py.VirtualSource("/etc/other.h5", "gyro", (10, 3))
            file.create_virtual_dataset("gyro", layout)
    assert "another file" in refused("hdf5", tmp_path / "a.h5")


def test_a_zip_of_several_files_or_of_one_that_leads_outside_is_refused(tmp_path):
    import zipfile

    for names, says in ((["a.csv", "b.csv"], "holds 2 files"), (["../a.csv"], "leads out of it")):
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
            for name in names:
                archive.writestr(name, "1,2\n")
        assert says in refused("text zip", tmp_path / "a.zip")


def test_a_bags_directory_has_files_of_its_own_only(tmp_path):
    path = made("ros 2", tmp_path)
    (path / "a.db3").rename(tmp_path / "other.db3")
    (path / "a.db3").symlink_to(tmp_path / "other.db3")
    assert "a.db3 is no file of its own" in refused("ros 2", path)


def test_a_bags_metadata_names_no_place_outside_and_builds_nothing(tmp_path):
    path = made("ros 2", tmp_path)
    metadata = (path / "metadata.yaml").read_text()
    (path / "a.db3").rename(tmp_path / "other.db3")
    assert "- a.db3" in metadata
    for place in ("../other.db3", str(tmp_path / "other.db3")):
        (path / "metadata.yaml").write_text(metadata.replace("- a.db3", f"- {place}"))
        assert "are missing" in refused("ros 2", path)
    mark = tmp_path / "ran"
    program = f"!!python/object/apply:os.mkdir ['{mark}']"
    (path / "metadata.yaml").write_text(metadata.replace("- a.db3", f"- {program}"))
    assert "log.path" in refused("ros 2", path)
    assert not mark.exists()


@pytest.mark.parametrize("kind", ["ros 1", "ros 2 mcap"])
def test_what_a_bag_says_of_a_message_is_never_made_into_code(kind, tmp_path):
    path = made(kind, tmp_path)
    content = path.read_bytes()
    old = b"Quaternion orientation\n"
    assert old in content
    mark = tmp_path / "ran"
    path.write_bytes(content.replace(old, b"exec(chr(111)+chr(115))"[: len(old) - 1] + b"\n"))
    said = refused(kind, path)
    assert "has other fields than it has" in said
    assert not mark.exists()


CLOSURE = """1027
253
254
6
1
262153
6
system
2
16
1
262153
{size}
{command}
254
"""
"""A function of R without arguments, in the global environment, whose body is system(command)"""


def test_a_function_in_an_r_file_is_no_table_and_is_not_called(tmp_path):
    """It stands where a recording may: alone, or beside one."""
    installed("rdata")
    mark = tmp_path / "ran"
    command = f"touch {mark}"
    closure = CLOSURE.format(size=len(command), command=command)
    matrix = "\n".join(["526", str(7 * COUNT), *(repr(v) for v in rows(COUNT).T.ravel().tolist())])
    dim = f"1026\n1\n262153\n3\ndim\n13\n2\n{COUNT}\n7\n254\n"
    for name, value, rest in (("a", closure, ""), ("b", closure, "imu")):
        items = f"1026\n1\n262153\n1\n{name}\n{value}"
        if rest:
            items += f"1026\n1\n262153\n3\n{rest}\n{matrix}\n{dim}"
        (tmp_path / "a.rda").write_text(f"RDA2\nA\n2\n197888\n131840\n{items}254\n")
        if rest:
            (record,) = read(config("npy", tmp_path / "a.rda"))
            np.testing.assert_array_equal(record.gyro, MOCK.gyro[:COUNT])
        else:
            assert "holds no table of numbers" in refused("npy", tmp_path / "a.rda")
    assert not mark.exists()


@pytest.mark.parametrize("kind", ["text gz", "text bz2", "text xz", "text zip", "npz"])
def test_what_unfolds_beyond_the_limit_is_refused(kind, tmp_path, monkeypatch):
    from lbgc.data.readers import tables

    path = made(kind, tmp_path)
    monkeypatch.setattr(tables, "LARGEST", 5000)
    said = refused(kind, path)
    assert "5000" in said
    assert "are the most" in said


def test_a_mat_file_that_unfolds_beyond_the_limit_is_refused(tmp_path, monkeypatch):
    from lbgc.data.readers import tables
    from lbgc.data.readers.formats import matlab

    path = made("matlab 7", tmp_path)
    monkeypatch.setattr(tables, "LARGEST", 5000)
    with pytest.raises(ValueError, match="unfolds to more than 5000 bytes"):
        matlab.read(path)


def test_a_few_bytes_that_claim_many_rows_are_refused_before_they_are_read(tmp_path):
    """An .npy file's header, and a chunked dataset of HDF5 of which nothing is written."""
    content = np.lib.format.magic(1, 0)
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000, 7), }".ljust(117)
    (tmp_path / "a.npy").write_bytes(content + len(header).to_bytes(2, "little") + header)
    assert "are the most" in refused("npy", tmp_path / "a.npy")
    installed("h5py")
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", (10**12, 7), "f8", chunks=(1000, 7))
    assert "are the most" in refused("npy", tmp_path / "a.h5")


def test_of_several_topics_one_is_asked_for_by_name(tmp_path):
    installed("rosbags")
    path = tmp_path / "a.bag"
    written.ros1_of_two_topics(path, rows(COUNT))
    said = refused("ros 1", path)
    assert "log.table = None: must be given" in said
    assert "/left/imu (250 rows, 8 columns), /right/imu (250 rows" in said
    (record,) = read(config("ros 1", path, table="/right/imu"))
    np.testing.assert_array_equal(record.gyro, MOCK.gyro[:COUNT])
    assert "/up/imu: is no table of a.bag; choose from /left/imu" in refused(
        "ros 1", path, table="/up/imu"
    )


def test_of_several_kinds_of_messages_and_sensors_one_is_asked_for(tmp_path):
    installed("pyulog")
    both = {"sensor_combined": written.COMBINED, "vehicle_imu.1": written.VEHICLE}
    (tmp_path / "a.ulg").write_bytes(written.ulog(both, rows(COUNT)))
    assert "sensor_combined (250 rows" in refused("ulog combined", tmp_path / "a.ulg")
    (record,) = read(config("ulog combined", tmp_path / "a.ulg", table="vehicle_imu_1"))
    np.testing.assert_allclose(record.gyro, MOCK.gyro[:COUNT], rtol=2.0**-23)
    (tmp_path / "a.bin").write_bytes(written.dataflash(rows(COUNT), instances=2))
    assert "IMU_0 (250 rows, 7 columns), IMU_1" in refused("dataflash", tmp_path / "a.bin")
    (record,) = read(config("dataflash", tmp_path / "a.bin", table="IMU_1"))
    np.testing.assert_allclose(record.gyro, MOCK.gyro[:COUNT], rtol=2.0**-23)


def test_the_only_table_that_can_be_an_imus_is_taken_and_said(tmp_path):
    (record,) = read(config("hdf5", made("hdf5", tmp_path)))
    about = "table: sensors/imu of a.h5 was read; it also holds temperature"
    assert about in record.notes


def test_an_accelerometer_on_another_clock_does_not_stand_beside_the_gyro(tmp_path):
    """ULog's two sensors, the second half a step late: they are two tables, and no IMU's."""
    installed("pyulog")
    late = (written.SENSOR, lambda row: written.ACCEL[1](row + np.array([0.06] + [0.0] * 6)))
    both = {"sensor_gyro": written.GYRO, "sensor_accel": late}
    (tmp_path / "a.ulg").write_bytes(written.ulog(both, rows(COUNT)))
    said = refused("ulog combined", tmp_path / "a.ulg")
    assert "sensor_gyro (250 rows, 4 columns)" in said


def test_a_bag_that_says_other_fields_of_the_message_is_refused(tmp_path):
    path = made("ros 2 mcap", tmp_path)
    content = path.read_bytes()
    old, new = b"Vector3 angular_velocity\n", b"Vector3 angular_velocitx\n"
    assert old in content
    path.write_bytes(content.replace(old, new))
    assert "has other fields than it has" in refused("ros 2 mcap", path)


def test_a_bag_without_an_imu_says_what_it_has(tmp_path):
    path = made("ros 1", tmp_path)
    content = path.read_bytes()
    old, new = b"linear_acceleration\n", b"linear_acceleratiom\n"
    assert old in content
    content = content.replace(old, new).replace(b"sensor_msgs/Imu", b"sensor_msgs/Imx")
    path.write_bytes(content)
    said = refused("ros 1", path)
    assert "holds no sensor_msgs/Imu, but /imu (sensor_msgs/msg/Imx)" in said


def test_a_message_of_another_name_with_the_same_fields_is_an_imus(tmp_path):
    path = made("ros 1", tmp_path)
    path.write_bytes(path.read_bytes().replace(b"sensor_msgs/Imu", b"vendors_msg/Imu"))
    (record,) = read(config("ros 1", path))
    np.testing.assert_array_equal(record.gyro, MOCK.gyro[:COUNT])


@pytest.mark.parametrize("package", ["h5py", "rosbags", "pyulog", "rdata"])
def test_a_package_that_is_missing_is_named(package, tmp_path, monkeypatch):
    heads = {"h5py": b"\x89HDF\r\n\x1a\n", "rosbags": b"#ROSBAG V2.0\n", "rdata": b"RDX3\n",
             "pyulog": b"ULog\x01\x12\x35"}  # fmt: skip
    monkeypatch.setitem(__import__("sys").modules, package, None)
    (tmp_path / "a.bin").write_bytes(heads[package].ljust(1000, b"\0"))
    said = refused("npy", tmp_path / "a.bin")
    assert f"package = {package}: is not installed" in said
    assert "'lbgc[logs]'" in said


@pytest.mark.parametrize(
    ("program", "says"),
    [("import os; os.abort()", "its reader crashed: SIGABRT"),
     ("raise SystemExit('no reason')", "its reader ended: no reason"),
     ("while True: pass", "it took too long"),
     ("import resource; resource.setrlimit(resource.RLIMIT_CPU, (1, 9))\nwhile True: pass",
      "it took more than 6 s of processor"),
     ("import os, sys; os.close(1); sys.stdin.read()", "answers nothing")],
)  # fmt: skip
def test_a_reader_that_crashes_or_never_ends_is_one_line(program, says, tmp_path, monkeypatch):
    import subprocess
    import sys

    from lbgc.data.readers.formats import apart

    def started(*_: object) -> "subprocess.Popen[bytes]":
        pipe = subprocess.PIPE
        command = [sys.executable, "-c", program]
        return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe)

    monkeypatch.setattr(apart, "_started", started)
    monkeypatch.setattr(apart, "_PATIENCE", 0.1 if says == "it took too long" else 10.0)
    monkeypatch.setattr(apart, "_TO_END", 1.0)
    path = made("feather", tmp_path)
    assert says in refused("feather", path)


def test_libraries_written_in_c_read_in_a_process_of_their_own():
    """All but NumPy's and Arrow's own formats, whose readers are tried with many spoiled files."""
    from lbgc.data.readers.formats import child, files

    every = {*files._BY_MAGIC.values(), *files._BY_ENDING.values()}
    apart = {own.reader for own in every} - {own.reader for own in files._IN_HERE}
    assert apart == set(child.READERS)


def test_rows_of_numbers_are_as_their_dtype_says(tmp_path):
    path = made("rows", tmp_path)
    said = refused("rows", path, skip_bytes=0)
    assert "leaves 4 bytes of a.bin" in said
    for dtype, says in ((["t:f16"], "is no name:type"), (["t:f8", "t:f4"], "different names"),
                        (["f8"], "is no name:type"), ([":f8"], "is no name:type"),
                        (["t:O"], "is no name:type")):  # fmt: skip
        with pytest.raises(InputError, match=says):
            config("rows", path, dtype=dtype)
    with pytest.raises(InputError, match="skip_bytes = -1: must be 0 or more"):
        config("rows", path, skip_bytes=-1)


def test_a_table_cannot_be_named_where_the_file_is_one(tmp_path):
    path = made("text gz", tmp_path)
    assert "leave log.table out" in refused("text gz", path, table="imu")


def test_nothing_is_imported_from_where_one_happens_to_be(tmp_path, monkeypatch):
    """The process that reads has the same import path, and not the directory it is started in."""
    (tmp_path / "numpy.py").write_text("raise SystemExit('taken')")
    monkeypatch.chdir(tmp_path)
    (record,) = read(config("feather", made("feather", tmp_path)))
    assert len(record.gyro) == COUNT


def test_damage_within_a_dataflash_log_is_passed_over_and_said(tmp_path):
    path = made("dataflash", tmp_path)
    content = bytearray(path.read_bytes())
    at = content.rindex(b"\xa3\x95\x81", 0, len(content) // 2)
    content[at : at + 20] = bytes(20)
    path.write_bytes(content)
    (record,) = read(config("dataflash", path, gaps="join"))
    assert len(record.gyro) == COUNT - 1
    assert "damage: 36 bytes of a.bin are no messages and were passed over" in record.notes


def test_a_dataflash_log_that_describes_a_message_in_two_ways_is_refused(tmp_path):
    path = made("dataflash", tmp_path)
    content = path.read_bytes()
    first = content.index(b"IMU\0QBffffff") - 5
    other = content[first : first + 89].replace(b"AccX,AccY", b"AccY,AccX")
    path.write_bytes(content + other)
    assert "in two ways" in refused("dataflash", path)


def test_the_last_line_of_a_text_log_that_has_no_end_is_left_out(tmp_path):
    path = made("dataflash text", tmp_path)
    path.write_bytes(path.read_bytes()[:-3])
    (record,) = read(config("dataflash text", path))
    assert len(record.gyro) == COUNT - 1
    assert any("the last line, number 252, has no end" in note for note in record.notes)


@pytest.mark.parametrize("kind", ["ulog combined", "dataflash", "dataflash text"])
def test_a_log_that_ends_with_a_whole_message_says_nothing_of_its_end(kind, tmp_path):
    (record,) = read(config(kind, made(kind, tmp_path)))
    assert not any(note.startswith("end:") for note in record.notes)


def test_what_was_added_to_a_ulog_file_begins_where_its_flags_say(tmp_path):
    """A logger adds what a crash left to a log that was cut short by it."""
    installed("pyulog")
    path = made("ulog combined", tmp_path)
    content = path.read_bytes()[:-3]
    added = len(content) + 43
    flags = b"\x28\0B" + bytes(8) + b"\1" + bytes(7) + added.to_bytes(8, "little") + bytes(16)
    path.write_bytes(content[:16] + flags + content[16:] + b"\1\0S1")
    (record,) = read(config("ulog combined", path))
    assert len(record.gyro) == COUNT - 1
    assert any("the last 46 bytes are no whole" in note for note in record.notes)


def test_a_table_with_many_times_the_others_rows_is_taken_and_said(tmp_path):
    """As of PX4, which logs one topic in full and the others now and then."""
    installed("h5py")
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, count in (("full", COUNT), ("seldom", COUNT // 25)):
            file[name] = written.structured(rows(count))
    (record,) = read(config("hdf5", tmp_path / "a.h5"))
    assert len(record.gyro) == COUNT
    about = "table: full of a.h5 was read; it also holds seldom (10 rows)"
    assert about in record.notes


def test_a_binary_file_that_nobody_knows_is_told_how_it_can_be_read(tmp_path):
    (tmp_path / "a.bin").write_bytes(np.linspace(0, 1, 700).tobytes())
    assert "read by log.dtype" in refused("npy", tmp_path / "a.bin")
