"""The tumble through the commands: drawn in MuJoCo, answered from a dataset or a log of it."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import default_config, generate

from lbgc.data.converted import forces
from lbgc.data.logconfig import LogConfig
from lbgc.data.poses import poses_of
from lbgc.data.readers.raw import Raw
from lbgc.data.store import Dataset
from lbgc.protocol import ProtocolConfig

RATE_HZ, POSES, DWELL_S, HANDLING_S = 20.0, 6, 20.0, 2.0
CSV = ("log=csv", "log.gyro_unit=rad/s", "log.accel_unit=auto")


def held(path: Path, recordings: int, imu: str, **changes: object) -> Dataset:
    """Recordings of as many units, all in the test split."""
    keys = {"poses": POSES, "dwell_s": DWELL_S, "handling_s": HANDLING_S} | changes
    count = len(keys.get("attitudes_deg") or range(POSES))
    protocol = ProtocolConfig("tumble", "tumble", **keys)
    seconds = count * keys["dwell_s"] + (count - 1) * HANDLING_S
    return generate(path, imu=default_config(f"imu={imu}").imu, protocol=protocol, rate_hz=RATE_HZ,
                    duration_s=seconds, recordings=recordings, units=recordings,
                    split=[0, 0, 1])  # fmt: skip


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    return held(tmp_path_factory.mktemp("one") / "d.zarr", 1, "stim300")


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    return held(tmp_path_factory.mktemp("many") / "d.zarr", 24, "hg4930")


def told(name: str) -> list:
    """A part of the results of the last evaluation in this directory."""
    return json.loads(Path("outputs/evaluate/latest/results.json").read_text())[name]


def as_log(dataset: Dataset, file: Path) -> None:
    """The first recording as text, with all its digits."""
    record = next(dataset.records(np.arange(1)))
    stamps = np.arange(1, len(record.gyro) + 1) / RATE_HZ
    rows = np.column_stack([stamps, record.gyro, record.accel]).astype(float)
    names = "t_s,w_x,w_y,w_z,f_x,f_y,f_z"
    np.savetxt(file, rows, delimiter=",", header=names, comments="", fmt="%.17g")


def headings(name: str = "heading_deg") -> np.ndarray:
    return np.array([own[name] for own in told("tumbles")[0]["poses"]])


@pytest.mark.parametrize("options", [[], ["tumble.integrated=true"], ["tumble.find_latitude=true"]])
def test_a_log_is_answered_as_the_dataset_that_it_is_of(cli, one, tmp_path, options):
    """Its poses found, listed, and listed with the headings that are right."""
    file = tmp_path / "mine.csv"
    as_log(one, file)
    asked = ("lbgc.evaluate", "estimator=tumble", *options)
    done = cli(*asked, f"data={one.path}")
    assert done.code == 0, done.err
    right, sigma = headings(), headings("sigma_deg")
    ways, place = told("tumbles")[0]["modes"], told("tumbles")[0]["latitude_interval_deg"]
    (row,) = told("rows")
    poses = poses_of(next(one.records(np.arange(1))))
    spans = [(first / RATE_HZ, last / RATE_HZ) for first, last in poses.rests]
    lines = (Path("outputs/evaluate/latest/windows.csv").read_text()).splitlines()[1:]
    true = [line.split(",")[4] for line in lines]
    plain = ",".join(f"[{a:.10g},{b:.10g}]" for a, b in spans)
    labelled = ",".join(
        f"[{a:.10g},{b:.10g},{own}]" for (a, b), own in zip(spans, true, strict=True)
    )
    where = "null" if "tumble.find_latitude=true" in options else "32.76"
    log = (f"log.path={file}", *CSV, f"log.latitude={where}", "imu=stim300")
    for listed in ("null", f"[{plain}]", f"[{labelled}]"):
        done = cli(*asked, *log, f"log.poses={listed}")
        assert done.code == 0, done.err
        np.testing.assert_allclose(headings(), right, rtol=0, atol=1e-6)
        np.testing.assert_allclose(headings("sigma_deg"), sigma, rtol=0, atol=1e-6)
        own = told("tumbles")[0]
        assert len(own["modes"]) == len(ways)
        assert sum(mode["weight"] for mode in own["modes"]) == pytest.approx(1, abs=0.05)
        if place is not None:
            np.testing.assert_allclose(own["latitude_interval_deg"], place, rtol=0, atol=1e-6)
            assert place[0] < 32.76 < place[1]
    (labels,) = told("rows")
    assert labels["rmse_deg"] == pytest.approx(row["rmse_deg"], abs=1e-5)


@pytest.mark.parametrize("integrated", [False, True])
def test_errors_in_mujoco_are_as_large_as_the_sigmas_say(cli, many, integrated):
    """Six poses of one recording err together where turns tie them: the scatter is over recordings,
    and no less than that of a square of one normal error where they do, of three where not."""
    option = f"tumble.integrated={str(integrated).lower()}"
    done = cli("lbgc.evaluate", f"data={many.path}", "estimator=tumble", option)
    assert done.code == 0, done.err
    lines = Path("outputs/evaluate/latest/windows.csv").read_text().splitlines()[1:]
    error, sigma = np.array([line.split(",")[6:8] for line in lines], float).T
    each = ((error / sigma) ** 2).reshape(-1, POSES).mean(axis=1)
    independent = 1 if integrated else 3
    spread = max(each.std(ddof=1), np.sqrt(2 / independent)) / np.sqrt(len(each))
    assert abs(each.mean() - 1) < 3 * spread
    assert np.rad2deg(np.abs(error)).max() > 0
    (row,) = told("rows")
    assert row["mean_normalised_squared_error"] == pytest.approx(each.mean(), rel=1e-3)


LEVEL = ((0.0, 0.0, 10.0), (0.0, 0.0, 80.0), (0.0, 0.0, 200.0))


@pytest.mark.parametrize(
    ("imu", "count", "options", "refused", "says"),
    [
        ("bmi160", 2, [], True, "tell no heading: rank 1 of 3: the vertical rates of 2 poses"),
        ("bmi160", 2, [], True, "two leave a mirror image, one leaves the whole circle"),
        ("stim300", 2, [], False, "2 ways to hold the headings fit"),
        ("stim300", 2, [], False, "% probable: headings "),
        ("stim300", 3, ["tumble.find_latitude=true"], False,
         "the bias along it and sin(lat) cannot be told apart"),
    ],
)  # fmt: skip
def test_what_level_poses_cannot_tell_is_said(cli, tmp_path, imu, count, options, refused, says):
    made = held(tmp_path / "d.zarr", 1, imu, attitudes_deg=LEVEL[:count], placed_deg=0.1)
    done = cli("lbgc.evaluate", f"data={made.path}", "estimator=tumble", *options)
    assert done.code == (2 if refused else 0), done.err
    assert says in (done.err if refused else done.out)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["log.gyro_unit=deg/s"], "their unit is 57.3 times as large: rad/s where deg/s was taken"),
        (["log.gyro_scale=57.29577951"], "57.3 times as small: deg/s where rad/s was taken"),
        (["log.gyro_scale=-1"], "their signs are the other ones"),
        (["log.accel_axes=[y,x,-z]"], "the gyros' axes are not the accelerometers'"),
    ],
)
def test_gyros_that_do_not_carry_gravity_from_pose_to_pose_are_refused(
    cli, one, tmp_path, options, says
):
    file = tmp_path / "mine.csv"
    as_log(one, file)
    asked = ("lbgc.evaluate", *CSV, f"log.path={file}", "log.latitude=32.76", "imu=stim300",
             "estimator=tumble", *options)  # fmt: skip
    done = cli(*asked)
    assert done.code == 2
    assert says in done.err
    assert "from pose to pose the gyros carry down to " in done.err


def test_a_latitude_that_nobody_tells_is_asked_for(cli, one, tmp_path):
    file = tmp_path / "mine.csv"
    as_log(one, file)
    done = cli("lbgc.evaluate", *CSV, f"log.path={file}", "log.latitude=null", "imu=stim300",
               "estimator=tumble")  # fmt: skip
    assert done.code == 2
    assert "log.latitude = None deg: must be given for mine; tumble.find_latitude=true" in done.err


@pytest.mark.parametrize(("size", "unit"), [(9.8, 1.0), (1.0, 9.80665)])
def test_the_unit_of_forces_is_told_by_their_sizes_where_opposite_attitudes_cancel(size, unit):
    accel = np.repeat([[0.0, 0.0, -size], [0.0, 0.0, size]], 50, axis=0)
    assert np.abs(accel.mean(axis=0)).max() < 1e-12
    config = LogConfig(path="mine.csv", latitude=0.0, accel_unit="auto")
    raw = Raw("mine", np.zeros((100, 3)), accel.copy(), config)
    np.testing.assert_allclose(forces(raw, 10.0), accel * unit)


def test_a_log_of_several_attitudes_is_said_to_be_a_tumbles(cli, one, tmp_path):
    file = tmp_path / "mine.csv"
    as_log(one, file)
    done = cli("lbgc.look", f"files=[{file}]")
    assert "it was laid in 6 attitudes: evaluate estimator=tumble finds" in done.out
