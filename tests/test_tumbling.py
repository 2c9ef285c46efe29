"""Recordings of an IMU that is held in several attitudes: poses found as they were planned, each
scored, and refused by whoever takes them for a plate's."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import default_config, generate

from lbgc.data.poses import Poses, described, headings_of, poses_of
from lbgc.data.record import Held, Record, mock_record
from lbgc.data.rests import held_still, longest_rest
from lbgc.data.store import Dataset
from lbgc.data.windows import cut
from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.estimators import FROM_POSES
from lbgc.estimators.estimate import FromPoses
from lbgc.frames import euler_to_matrix, rotation_z, wrap
from lbgc.protocol import SLEW, ProtocolConfig
from lbgc.sensor.imu import ImuModel

PROTOCOL = ProtocolConfig(
    "tumble", "tumble", poses=6, downs="cube", dwell_s=8.0, placed_deg=3.0, handling_s=3.0
)
DURATION_S, RATE_HZ = 63.0, 50.0
STARTS_S = np.arange(6) * 11.0


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Dataset:
    """Two recordings of a phone's IMU, whose gyros read 0.1 deg/s a g; one for training."""
    path = tmp_path_factory.mktemp("tumble") / "d.zarr"
    imu = default_config("imu=bmi160").imu
    return generate(path, imu=imu, protocol=PROTOCOL, duration_s=DURATION_S, rate_hz=RATE_HZ,
                    recordings=2, split=[1, 0, 1])  # fmt: skip


@pytest.fixture(scope="module")
def perfect(tmp_path_factory) -> Dataset:
    """A recording of a perfect sensor."""
    path = tmp_path_factory.mktemp("perfect") / "d.zarr"
    imu = default_config("imu=ideal").imu
    return generate(path, imu=imu, protocol=PROTOCOL, duration_s=DURATION_S, rate_hz=RATE_HZ,
                    recordings=2, split=[0, 0, 1])  # fmt: skip


def results() -> Path:
    """Where the last evaluation in this directory left its results."""
    return Path("outputs/evaluate/latest")


def records(dataset: Dataset) -> list[Record]:
    return list(dataset.records(np.arange(len(dataset))))


@dataclass(frozen=True)
class FromEarthRate:
    """What a perfect sensor's means say of each pose, as an estimator of poses answers."""

    heading: np.ndarray
    sigma: np.ndarray
    attitude: np.ndarray
    modes: tuple = ()
    latitude: float | None = None
    latitude_interval: tuple[float, float] | None = None
    notes: tuple[str, ...] = ("the sensor was taken as perfect",)


def from_earth_rate(poses: Poses, imu: ImuModel, hemisphere: str = "either") -> FromPoses:
    rate = np.array([poses.gyro[slice(*own)].mean(axis=0) for own in poses.rests])
    level = np.einsum("pij,pj->pi", poses.levels, rate)
    heading = np.arctan2(-level[:, 1], level[:, 0])
    found = FromEarthRate(heading, np.full(len(poses), 0.01), rotation_z(heading) @ poses.levels)
    found = replace(found, modes=(SimpleNamespace(heading=heading, weight=1.0),))
    if poses.integrated or hemisphere != "either":
        found = replace(found, notes=(f"integrated {poses.integrated}, {hemisphere}",))
    if poses.latitude is not None:
        return found
    latitude = float(np.mean(np.arctan2(-level[:, 2], np.hypot(level[:, 0], level[:, 1]))))
    return replace(found, latitude=latitude, latitude_interval=(latitude - 0.1, latitude + 0.1))


@pytest.fixture
def known(monkeypatch):
    monkeypatch.setitem(FROM_POSES, "tumble", from_earth_rate)


def test_poses_are_found_where_they_were_planned(dataset):
    stages = dataset.label("stage")
    for record, stage in zip(records(dataset), stages, strict=True):
        poses = poses_of(record)
        assert len(poses) == 6
        for (first, last), start in zip(poses.rests, STARTS_S, strict=True):
            assert not (stage[first:last] == SLEW).any()
            assert 0 <= first / RATE_HZ - start < 2.0
            assert 0 <= start + 8.0 - last / RATE_HZ < 1.0
        said = described(poses, "it")
        assert said.startswith("it: 6 poses of ")
        assert said.endswith("forward 1, right 1, down 1, backward 1, left 1, up 1")


def test_each_pose_reads_what_its_attitude_makes_of_earth_rate_and_gravity(perfect):
    for record in records(perfect):
        poses = poses_of(record)
        rotation = euler_to_matrix(*record.held.attitude.T)
        for first, last in poses.rests:
            to_body = rotation[first:last].mean(axis=0).T
            rate = poses.gyro[first:last].mean(axis=0)
            force = poses.accel[first:last].mean(axis=0)
            earth = earth_rate_ned(record.latitude)
            np.testing.assert_allclose(rate, to_body @ earth, atol=5e-10)  # the last of settling
            down = [0.0, 0.0, -normal_gravity(record.latitude)]
            np.testing.assert_allclose(force, to_body @ down, atol=3e-6)  # float32 attitudes
        found = from_earth_rate(poses, None)
        right = headings_of(poses, record, rotation_z(-found.heading) @ found.attitude)
        np.testing.assert_allclose(wrap(found.heading - right), 0.0, atol=1e-5)


def test_the_right_heading_is_a_turn_about_the_vertical():
    """Also where the forward axis is nearly vertical, so that its own heading says nothing."""
    n, truth = 40, np.tile(np.deg2rad([[20.0, 89.0, 50.0]]), (40, 1))
    true = euler_to_matrix(*truth[0])
    held = Held(attitude=truth)
    record = replace(mock_record(), gyro=np.zeros((n, 3)), accel=np.zeros((n, 3)),
                     plate_angle=np.zeros(n), held=held)  # fmt: skip
    poses = Poses(record.gyro, record.accel, 10.0, 0.5, ((0, 20), (20, 40)), False)
    for off in (0.0, 0.3):
        levels = np.stack([rotation_z(-off) @ true] * 2)
        np.testing.assert_allclose(headings_of(poses, record, levels), off, atol=1e-12)


def test_a_quiet_turn_and_a_short_stop_are_no_poses():
    """6 s still, 6 s turning evenly at 2 deg/s, 6 s still, a move, 2 s still, a move, 6 s still."""
    rate = np.zeros((40 * 20, 3))
    rate[120:240, 2] = np.deg2rad(2.0)
    rate[360:400, 0] = rate[440:480, 0] = np.deg2rad(40.0)
    force = np.tile([0.0, 0.0, -9.8], (800, 1))
    noise = np.random.default_rng(4).standard_normal((800, 3))
    record = replace(mock_record(), gyro=rate + 1e-4 * noise, accel=force + 1e-3 * noise,
                     plate_angle=np.zeros(800), rate_hz=20.0, held=Held())  # fmt: skip
    found = [(own.start / 20, own.stop / 20) for own in held_still(record)]
    assert len(found) == 3
    np.testing.assert_allclose(found, [(0, 5.25), (12.75, 17.25), (24.75, 40)], atol=0.3)
    assert len(longest_rest(record).gyro) == round((found[2][1] - found[2][0]) * 20)
    assert longest_rest(record).held is None


def test_where_nothing_was_recorded_is_no_pose():
    record = mock_record(held=Held())
    gyro, accel = record.gyro.copy(), record.accel.copy()
    gyro[100:150] = accel[100:150] = np.nan
    broken = replace(record, gyro=gyro, accel=accel)
    found = poses_of(broken).rests
    assert len(found) == 2
    assert found[0][1] <= 100 < 150 <= found[1][0]
    with pytest.raises(InputError, match=r"has 1 rests of 3 s or more, and a tumble takes two"):
        poses_of(record)


def test_every_pose_counts_as_an_answer(cli, perfect, known):
    done = cli("lbgc.evaluate", f"data={perfect.path}", "estimator=tumble")
    assert done.code == 0, done.err
    said = json.loads((results() / "results.json").read_text())
    (row,) = said["rows"]
    assert (row["estimator"], row["windows"], row["window_s"]) == ("tumble", 12, DURATION_S)
    assert row["independent"] == 2
    assert row["rmse_deg"] < 1e-3
    assert len(said["tumbles"]) == 2
    assert len(said["tumbles"][0]["poses"]) == 6
    assert "6 poses of" in done.out
    assert "the sensor was taken as perfect" in done.out
    assert (results() / "report.html").exists()


def test_errors_against_the_reference_have_its_error(cli, perfect, known):
    done = cli("lbgc.evaluate", f"data={perfect.path}", "estimator=tumble", "against=reference")
    assert done.code == 0, done.err
    (row,) = json.loads((results() / "results.json").read_text())["rows"]
    off = [wrap(own.heading_reference - own.heading) for own in records(perfect)]
    assert row["rmse_deg"] == pytest.approx(np.rad2deg(np.sqrt(np.mean(np.square(off)))), abs=1e-3)


def test_a_latitude_that_is_to_be_found_is_not_told(cli, perfect, known):
    done = cli("lbgc.evaluate", f"data={perfect.path}", "estimator=tumble",
               "tumble.find_latitude=true")  # fmt: skip
    assert done.code == 0, done.err
    assert "latitude 32.76, 95% from 27.03 to 38.49 deg" in done.out


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["tumble.integrated=true"], "integrated True, either"),
        (["tumble.find_latitude=true", "tumble.hemisphere=north"], "integrated False, north"),
    ],
)
def test_the_estimator_is_told_what_is_asked(cli, perfect, known, options, says):
    done = cli("lbgc.evaluate", f"data={perfect.path}", "estimator=tumble", *options)
    assert says in done.out


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("lbgc.evaluate", ["estimators=[mean]"]),
        ("lbgc.evaluate", ["estimator=all"]),
        ("lbgc.train", ["windows_s=[10]"]),
        ("lbgc.fit", []),
        ("lbgc.calibrate", []),
    ],
)
def test_who_takes_it_for_a_plates_is_told_who_answers(cli, dataset, command, options):
    done = cli(command, f"data={dataset.path}", *options)
    assert done.code == 2
    assert "only estimator=tumble answers that" in done.err


def test_the_bound_of_a_plate_is_not_that_of_a_tumble(cli):
    done = cli("lbgc.bound", "protocol=tumble", "imu=stim300")
    assert done.code == 2
    assert "protocol.kind = tumble: has no plate" in done.err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["estimators=[tumble]"], "estimators = tumble: choose from"),
        (["estimator=tumble", "known=[unit]"], "known = ['unit']: is for windows"),
        (["estimator=tumble", "run=x"], "run = x: is for windows"),
        (["estimator=tumble", "tumble.hemisphere=up"], "choose from either, north, south"),
    ],
)
def test_what_poses_do_not_go_with_is_refused(cli, perfect, known, options, says):
    done = cli("lbgc.evaluate", f"data={perfect.path}", *options)
    assert done.code == 2
    assert says in done.err


def test_a_static_dataset_has_no_poses(cli, tmp_path, known):
    made = generate(tmp_path / "d.zarr", protocol=ProtocolConfig("static", "static"), rate_hz=25.0,
                    duration_s=20.0, recordings=1, split=[0, 0, 1])  # fmt: skip
    done = cli("lbgc.evaluate", f"data={made.path}", "estimator=tumble")
    assert done.code == 2
    assert "was not held in several attitudes" in done.err


def test_windows_are_not_cut_from_it(dataset):
    with pytest.raises(InputError, match="only estimator=tumble answers"):
        cut(records(dataset)[0], 5.0)


@pytest.fixture(scope="module")
def log(dataset, tmp_path_factory):
    """The first recording as a user's own file."""
    record = records(dataset)[0]
    file = tmp_path_factory.mktemp("log") / "mine.csv"
    rows = np.concatenate([record.gyro, record.accel], axis=1)
    np.savetxt(file, rows, delimiter=",", header="w_x,w_y,w_z,f_x,f_y,f_z", comments="", fmt="%.9g")
    return file, record


LOG = (
    "log=csv",
    "log.gyro_unit=rad/s",
    "log.latitude=32.76",
    f"log.rate_hz={RATE_HZ:g}",
    "imu=bmi160",
)


def test_a_log_is_answered_pose_by_pose(cli, log, known):
    file, _ = log
    done = cli("lbgc.evaluate", *LOG, f"log.path={file}", "estimator=tumble")
    assert done.code == 0, done.err
    (own,) = json.loads((results() / "results.json").read_text())["tumbles"]
    assert len(own["poses"]) == 6
    assert "no heading is known, so there are no errors; log.poses gives them" in done.out


def test_a_log_with_listed_poses_is_scored_on_their_headings(cli, log, known):
    file, record = log
    poses = poses_of(record)
    found = np.rad2deg(from_earth_rate(poses, None).heading)
    spans = [(first / RATE_HZ, last / RATE_HZ) for first, last in poses.rests]
    listed = ",".join(
        f"[{a:g},{b:g},{own - 2:.6f}]" for (a, b), own in zip(spans, found, strict=True)
    )
    done = cli("lbgc.evaluate", *LOG, f"log.path={file}", f"log.poses=[{listed}]",
               "estimator=tumble")  # fmt: skip
    assert done.code == 0, done.err
    (row,) = json.loads((results() / "results.json").read_text())["rows"]
    assert row["windows"] == 6
    assert row["rmse_deg"] == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["estimators=[mean]"], "in 6 attitudes altogether: only estimator=tumble answers that"),
        (["estimators=[mean]", "log.poses=[[0,6],[12,18]]"], "only estimator=tumble answers that"),
        (["estimator=tumble", "log.poses=[[0,6],[12,99]]"], "is not within the 63 s that"),
        (["estimator=tumble", "log.poses=[[0,6]]"], "must name two or more"),
        (["estimator=tumble", "log.poses=[[0,6],[5,18]]"], "in order of time, without overlap"),
        (
            ["estimator=tumble", "log.poses=[[0,6,1],[12,18]]"],
            "must be [from_s, to_s, heading_deg] each",
        ),
        (["estimator=tumble", "log.poses=[[0,14],[22,30]]"], "list the stretches in which it was"),
        (["estimator=tumble", "log.positions=[[0,6,0],[12,18,90]]"], "says how a plate turns"),
    ],
)
def test_logs_that_are_no_tumble_or_not_so_are_refused(cli, log, known, options, says):
    file, _ = log
    done = cli("lbgc.evaluate", *LOG, f"log.path={file}", *options)
    assert done.code == 2
    assert says in done.err


def test_a_log_whose_listed_poses_were_handled_says_where_it_rests(cli, log, known):
    file, _ = log
    done = cli("lbgc.evaluate", *LOG, f"log.path={file}", "log.poses=[[23,30],[33,47]]",
               "estimator=tumble")  # fmt: skip
    assert done.code == 2
    assert "mine from 33 to 47 s: at rest = 0.96 to 7.2 s: since its start" in done.err


def test_a_log_needs_its_sensor(cli, log, known):
    file, _ = log
    done = cli("lbgc.evaluate", *LOG[:4], "log.bias_limit_deg_per_h=20000", f"log.path={file}",
               "estimator=tumble")  # fmt: skip
    assert done.code == 2
    assert "imu = None: must be given: what poses tell" in done.err
