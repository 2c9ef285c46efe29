"""What repeats of a unit is found, and what that does to the heading is said."""

import json

import numpy as np
import pytest
from helpers import REAL_LOGS, default_config, generate
from test_logs import write

from lbgc.earth import earth_rate_ned
from lbgc.frames import rotation_z
from lbgc.sensor.calibration import by_lifetime, calibrate
from lbgc.units import DEG, HOUR

DPH = DEG / HOUR
MEANS = REAL_LOGS.parent / "reference" / "sdc500_recording_means.csv"


def means(rng, bias, matrix, run, count=72):
    heading = np.deg2rad(np.arange(count) * 360.0 / count)
    truth = np.einsum("j,rji->ri", earth_rate_ned(0.5718), rotation_z(heading))
    rates = truth @ (np.eye(3) + matrix).T + bias + run * rng.standard_normal((count, 3))
    return rates, heading


def test_bias_scale_and_misalignment_are_found(rng):
    """Each within 4.5 of its own standard errors."""
    bias = np.array([2.0, -1.0, 0.5]) * DPH
    matrix = np.array([[0.03, -0.02, 0.0], [0.01, -0.05, 0.0], [0.0, 0.0, 0.0]])
    found = calibrate(*means(rng, bias, matrix, 0.1 * DPH), 0.5718)
    assert (np.abs(found.bias - bias) < 4.5 * found.bias_sigma + 0.1 * DPH).all()
    assert (np.abs(found.matrix - matrix[:2, :2]) < 4.5 * found.matrix_sigma).all()
    assert found.heading_rmse_without_all < found.heading_rmse_without_bias < found.heading_rmse


def test_run_bias_is_the_scatter(rng):
    found = calibrate(*means(rng, np.zeros(3), np.zeros((3, 3)), 1.0 * DPH, 600), 0.5718)
    np.testing.assert_allclose(found.run_sigma, 1.0 * DPH, rtol=4.5 / np.sqrt(1200))
    assert found.across_rms == pytest.approx(1.0 * DPH, rel=4.5 / np.sqrt(1200))


def test_sessions_are_told_from_runs(rng):
    """Drawn 400 times: 6 power-ups of 5 to 15 recordings, session 2, run 1. The estimators of both
    variances are unbiased (the session's before it is cut at zero, which it hardly ever is): within
    4.5 sampling errors; and the bias is off by its own standard error, NEES within 4.5 of its
    own (and 5% for weights from estimated variances)."""
    sizes = [5, 7, 9, 11, 13, 15]
    session = np.repeat(np.arange(6), sizes)
    found = []
    for _ in range(400):
        error = 2.0 * rng.standard_normal((6, 3))[session] + rng.standard_normal((60, 3))
        found.append(by_lifetime(error + 0.7, session))
    bias, sigma, run, between = (np.array(x) for x in zip(*found, strict=True))
    for squares, truth in ((run**2, 1.0), (between**2, 4.0)):
        error = squares.std() / np.sqrt(squares.size)
        assert abs(squares.mean() - truth) < 4.5 * error
    nees = ((bias - 0.7) / sigma) ** 2
    # five degrees of freedom of the spread: t^2 has mean 5/3
    assert nees.mean() == pytest.approx(5 / 3, abs=4.5 * nees.std() / np.sqrt(nees.size) + 0.08)


def test_one_session_is_no_split(rng):
    error = rng.standard_normal((20, 3))
    bias, sigma, run, between = by_lifetime(error, np.zeros(20))
    assert between is None
    np.testing.assert_allclose(run, error.std(axis=0, ddof=1))
    np.testing.assert_allclose(sigma, run / np.sqrt(20))
    np.testing.assert_allclose(bias, error.mean(axis=0))


def test_the_session_is_a_column_of_the_means(cli, tmp_path, rng):
    rates, heading = means(rng, np.zeros(3), np.zeros((3, 3)), 0.2 * DPH, 60)
    session = np.arange(60) // 10
    rates = rates + 3 * DPH * rng.standard_normal((6, 3))[session]
    names = ("gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s")
    table = {"heading_deg": heading / DEG, "session": session}
    write(tmp_path / "m.csv", table | dict(zip(names, (rates / DEG).T, strict=True)))
    done = cli("lbgc.calibrate", "means=m.csv", "latitude=32.76")
    found = json.loads((tmp_path / done.last_line).read_text())
    assert "between sessions" in done.out
    np.testing.assert_allclose(np.array(found["run_sigma"]) / DPH, 0.2, rtol=4.5 / np.sqrt(108))
    assert (np.array(found["session_sigma"]) / DPH > 1.0).all()


def test_a_datasets_unit_is_calibrated(cli, tmp_path):
    imu = default_config("imu.gyro.bias_unit_deg_per_h=5", "imu.gyro.bias_run_deg_per_h=0.1").imu
    dataset = generate(tmp_path / "d.zarr", output="means", mean_s=240.0, imu=imu)
    done = cli("lbgc.calibrate", "data=d.zarr")
    assert done.code == 0, done.err
    found = json.loads((tmp_path / done.last_line).read_text())
    drawn = dataset.label("gyro_bias_unit")[0]
    assert np.abs(np.array(found["bias"])[:2] - drawn[:2]).max() < 0.3 * DPH
    assert "better" in done.out


@pytest.mark.skipif(not MEANS.exists(), reason=f"needs the recording means {MEANS.name}")
def test_the_published_recordings_figures(cli, tmp_path):
    """Within 0.05 deg/h of those stated beside them; that bias makes the headings worse."""
    done = cli("lbgc.calibrate", f"means={MEANS}", "latitude=32.76")
    found = json.loads((tmp_path / done.last_line).read_text())
    np.testing.assert_allclose(np.array(found["bias"][:2]) / DPH, [0.0, -0.9], atol=0.05)
    np.testing.assert_allclose(np.array(found["run_sigma"][:2]) / DPH, 1.15, atol=0.05)
    assert found["across_rms"] / DPH == pytest.approx(0.87, abs=0.05)
    assert found["along_mean"] / DPH == pytest.approx(-0.51, abs=0.05)
    assert found["along_sigma"] / DPH == pytest.approx(1.6, abs=0.05)
    assert found["matrix"][0][0] == pytest.approx(-0.04, abs=0.005)
    assert found["matrix"][1][1] == pytest.approx(-0.06, abs=0.005)
    assert found["heading_rmse"] / DEG == pytest.approx(4.1, abs=0.05)
    assert found["heading_rmse_without_bias"] / DEG == pytest.approx(4.75, abs=0.05)
    assert "taken out: 4.75 deg, worse" in done.out


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "means, data or log = nothing: give one of them"),
        (("means=a.csv",), "latitude = None deg: must be given with means=FILE"),
        (("means=a.csv", "latitude=40", "data=b"), "give one of them"),
        (("means=nonesuch.csv", "latitude=40"), "is not at nonesuch.csv"),
        (("means=few.csv", "latitude=40"), "3 recordings: are too few: 6 at the least"),
        (("means=wrong.csv", "latitude=40"), "columns = heading_deg: is no column of wrong"),
    ],
)
def test_bad_calibration_input_is_named(cli, tmp_path, options, says):
    names = ("heading_deg", "gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s")
    write(tmp_path / "few.csv", {name: np.arange(3.0) for name in names})
    write(tmp_path / "wrong.csv", {"a": np.arange(3.0)})
    done = cli("lbgc.calibrate", *options)
    assert done.code == 2
    assert says in done.err
