"""A log's values and frames: right, described by an option, noted, or refused with the reason."""

from dataclasses import replace

import cases
import numpy as np
import pytest
from helpers import composed, needs_recording
from test_logs import MOCK, columns, config, write

from lbgc.data.checks.all_checks import checked
from lbgc.data.logs import LogConfig, read
from lbgc.data.readers.axes import matrix_of
from lbgc.data.record import Record
from lbgc.earth import earth_rate_ned
from lbgc.errors import InputError
from lbgc.evaluate import EvaluateConfig
from lbgc.frames import euler_to_matrix, rotation_vector
from lbgc.units import RATE_UNITS


def test_accelerometers_may_have_axes_and_a_sign_of_their_own(tmp_path):
    """Gyros forward-left-up beside accelerometers that print +g down."""
    values = columns()
    for axis, sign in zip("xyz", (1, -1, -1), strict=True):
        values[f"w_{axis}"] = sign * values[f"w_{axis}"]
        values[f"f_{axis}"] = -values[f"f_{axis}"]
    path = write(tmp_path / "log.csv", values)
    own = {"axes": ["x", "-y", "-z"], "accel_axes": ["-x", "-y", "-z"]}
    (record,) = read(config(path, **own))
    np.testing.assert_allclose(record.gyro, MOCK.gyro, rtol=1e-12)
    np.testing.assert_allclose(record.accel, MOCK.accel, rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"accel_axes": ["x", "x", "z"]}, "accel_axes = .*must be x, y, z"),
        ({"accept": ["everything"]}, "accept = everything: choose from stuck, outliers"),
    ],
)
def test_wrong_options_of_checks(changes, says):
    with pytest.raises(InputError, match=says):
        config("x.csv", **changes)


CASE = {"gyro_unit": "deg/s", "latitude": 48.1, "time_column": None, "rate_hz": 100.0}


def case(path, **changes) -> LogConfig:
    return LogConfig(path=str(path), **(CASE | changes))


def held(gyro, accel, latitude=48.1, imu=None, north=True, **changes) -> tuple[str, ...]:
    """The notes of a level file's arrays (rad/s, m/s^2; 100 Hz) at the door."""
    own = LogConfig(**({"path": "x", "latitude": latitude} | changes))
    turns = matrix_of(own.axes).T, matrix_of(own.accel_axes or own.axes).T
    record = Record("log", gyro @ turns[0], accel @ turns[1], np.zeros(len(gyro)), 100.0,
                    float(np.deg2rad(latitude)))  # fmt: skip
    return checked(record, own, imu, north).notes


def heading_of(path, **changes) -> float:
    (record,) = read(case(path, **changes))
    rate = record.gyro.mean(axis=0)
    return float(np.rad2deg(np.arctan2(-rate[1], rate[0])))


def test_an_accelerometers_sign_is_told_by_the_rate_along_the_force(tmp_path):
    """Level at 48.1 degrees, heading 90: 3 sigma of the heading over 300 s are 0.6 degrees."""
    cases.accel_sign(tmp_path)
    assert heading_of(tmp_path / "ok.csv") == pytest.approx(90, abs=0.6)
    says = r"rate along the measured vertical is \+11.2 deg/h where 48.1 degrees ask -11.2"
    reversed_ = r"log.accel_axes=\[-x,-y,-z\] \(accelerometers that print \+g down\)"
    with pytest.raises(InputError, match=f"{says}.*{reversed_}"):
        list(read(case(tmp_path / "accel_reversed.csv")))
    beside = r"log.axes=\[x,-y,-z\] log.accel_axes=\[x,y,z\]"
    with pytest.raises(InputError, match=f"{says}.*{beside}"):
        list(read(case(tmp_path / "gyro_flu_accel_frd.csv")))
    own = {"accel_axes": ["-x", "-y", "-z"]}
    assert heading_of(tmp_path / "accel_reversed.csv", **own) == pytest.approx(90, abs=0.6)
    own = {"axes": ["x", "-y", "-z"], "accel_axes": ["x", "y", "z"]}
    assert heading_of(tmp_path / "gyro_flu_accel_frd.csv", **own) == pytest.approx(90, abs=0.6)
    for name in ("accel_reversed.csv", "gyro_flu_accel_frd.csv"):
        (record,) = read(case(tmp_path / name), north=False)  # noise has no frame
        assert any(note.startswith("frames: ") for note in record.notes)
        (record,) = read(case(tmp_path / name, accept=["frames", "vertical"]))
        assert any(note.endswith("(accepted)") for note in record.notes)


def test_a_forward_axis_along_the_vertical_has_no_heading(tmp_path):
    cases.forward_vertical(tmp_path)
    says = r"forward axis is .* degrees from the vertical.*log.axes=\[-z,y,x\]"
    with pytest.raises(InputError, match=says):
        list(read(case(tmp_path / "log.csv")))
    assert heading_of(tmp_path / "log.csv", axes=["-z", "y", "x"]) == pytest.approx(90, abs=0.6)


def test_a_bias_is_called_one_before_any_unit(tmp_path):
    """Of 25 deg/h and more: none of them makes another unit right."""
    cases.mems_bias(tmp_path)
    for name, size in (("b25", 29.5), ("b500", 616), ("b1800", 2217)):
        with pytest.raises(InputError, match=r"log.most_bias_deg_per_h = 14.0") as caught:
            list(read(case(tmp_path / f"{name}.csv")))
        said = str(caught.value)
        least = float(said.split("a bias of at least ")[1].split(",")[0])
        assert 0.5 * size < least < size + 1.5
        assert "Earth's horizontal rate here is 10" in said
        assert "it would make sense" not in said
        assert "Earth's rate would be there" not in said
        list(read(case(tmp_path / f"{name}.csv"), north=False))
        stated = float(said.split("log.bias_limit_deg_per_h=")[1].split(" ")[0].rstrip(";"))
        list(read(case(tmp_path / f"{name}.csv", bias_limit_deg_per_h=stated)))


@pytest.mark.parametrize("stated", ["deg/s", "rad/s", "deg/h", "mrad/s"])
@pytest.mark.parametrize("true", ["deg/s", "rad/s", "deg/h", "mrad/s"])
def test_a_wrong_unit_is_named_where_earths_rate_is_there_in_another(stated, true):
    if stated == true:
        return
    _, gyro, accel = cases.static(100, 300, arw=0.01, seed=1, bias=(0.5, -0.3, 0.4))
    read_as = gyro / RATE_UNITS[true] * RATE_UNITS[stated]
    with pytest.raises(InputError, match=f"in .*{true}") as caught:
        held(read_as, accel, gyro_unit=stated)
    assert ("a bias does not hide" in str(caught.value)) or (
        "bias of at least" in str(caught.value)
    )


FLU, RFU = np.diag([1.0, -1.0, -1.0]), np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])


@pytest.mark.parametrize("latitude", [48.1, -33.9, 0.0])
@pytest.mark.parametrize(("turn", "option"), [(FLU, r"\[x,-y,-z\]"), (RFU, r"\[y,x,-z\]")])
def test_a_file_whose_z_points_up_is_not_read_as_one_whose_z_points_down(latitude, turn, option):
    _, gyro, accel = cases.static(100, 300, latitude, heading=40, arw=0.05, seed=3)
    with pytest.raises(InputError, match=rf"down axis points up.*log.axes={option}"):
        held(gyro @ turn, accel @ turn, latitude)
    held(gyro @ turn, accel @ turn, latitude, north=False)


def test_a_latitude_of_the_wrong_sign_is_named():
    _, gyro, accel = cases.static(100, 300, -33.9, heading=40, arw=0.05, seed=3)
    with pytest.raises(InputError, match=r"or log.latitude=-33.9 \(the southern"):
        held(gyro, accel, 33.9)


@pytest.mark.parametrize("heading", [0.0, 90.0, 225.0, 300.0])
@pytest.mark.parametrize("columns", [(2, 1, 0), (0, 2, 1)])
def test_gyro_columns_that_changed_places_are_never_answered_in_silence(heading, columns):
    """At 45 degrees, where the vertical rate alone does not always tell."""
    _, gyro, accel = cases.static(100, 300, 45.0, heading, arw=0.05, seed=4)
    right = np.degrees(np.arctan2(-gyro.mean(axis=0)[1], gyro.mean(axis=0)[0]))
    wrong = np.degrees(np.arctan2(-gyro[:, columns[1]].mean(), gyro[:, columns[0]].mean()))
    off = abs((wrong - right + 180) % 360 - 180)
    notes = held(gyro[:, list(columns)], accel, 45.0, accept=["frames"])
    assert off < 3 or any(note.startswith("frames: ") for note in notes)
    if off > 60:
        with pytest.raises(InputError, match="check frames"):
            held(gyro[:, list(columns)], accel, 45.0)


def test_what_rest_cannot_tell_is_said():
    _, gyro, accel = cases.static(100, 300, arw=0.05, seed=4)
    mirrored = np.diag([1.0, -1.0, 1.0])
    for values in (gyro, gyro @ mirrored):
        (note,) = held(values, accel)
        assert note.startswith("mirrored: the sign of y cannot be checked from this log")
    _, gyro, accel = cases.static(100, 300, 0.5, arw=0.05, seed=4)
    for turn in (np.eye(3), FLU):
        (note,) = held(gyro @ turn, accel, 0.5)
        assert "neither the sign of y nor those of the gyros" in note
        assert "equator" in note
    (note,) = held(gyro + 1e-3, accel, 0.5, bias_limit_deg_per_h=1000.0)
    assert "neither" in note


def swaying(seconds=600.0, seed=0) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch of half a degree, slow and random, at 48.1 degrees, heading 90, 20 Hz."""
    rng = np.random.default_rng(seed)
    n = round(seconds * 20)
    slow = np.exp(-np.arange(400) / 60.0)
    angles = np.array([np.convolve(rng.standard_normal(n + 400), slow)[400:][:n] for _ in "rp"])
    roll, pitch = np.deg2rad(0.5) * angles / angles.std(axis=1, keepdims=True)
    c_nb = euler_to_matrix(roll, pitch, np.full(n, np.pi / 2))
    turn = rotation_vector(np.swapaxes(c_nb[:-1], -1, -2) @ c_nb[1:]) * 20
    gyro = turn + earth_rate_ned(np.deg2rad(48.1)) @ c_nb[1:]
    accel = np.array([0, 0, -cases.gravity(48.1)]) @ c_nb[1:]
    noise = np.deg2rad(0.1) / 60 * np.sqrt(20) * rng.standard_normal(gyro.shape)
    return gyro + noise, accel + 2e-3 * rng.standard_normal(accel.shape)


def test_a_sway_tells_a_mirrored_frame_from_a_right_one():
    gyro, accel = swaying()
    mirrored = np.diag([1.0, -1.0, 1.0])

    def at(gyro, accel):
        own = LogConfig(path="x", latitude=48.1, bias_limit_deg_per_h=50.0)
        record = Record("log", gyro, accel, np.zeros(len(gyro)), 20.0, np.deg2rad(48.1))
        return checked(record, own).notes

    assert at(gyro, accel) == ()
    with pytest.raises(InputError, match=r"log.axes=\[x,-y,z\].*y points the other way"):
        at(gyro @ mirrored, accel @ mirrored)
    with pytest.raises(InputError, match="do not turn the accelerometers' vertical"):
        at(gyro @ mirrored, accel)


@needs_recording("lasergyro.imu")
def test_a_real_vehicles_sway_tells_a_mirrored_frame():
    log = composed(EvaluateConfig, "evaluate", "log=lasergyro").log
    (record,) = read(log)
    assert not any(note.startswith("mirrored") for note in record.notes)
    mirrored = np.diag([1.0, -1.0, 1.0])
    wrong = replace(record, gyro=record.gyro @ mirrored, accel=record.accel @ mirrored)
    own = replace(log, latitude=34.24605, gyro_unit="arcsec", accel_unit="ug*s")
    with pytest.raises(InputError, match="y points the other way"):
        checked(wrong, own)
