"""What repeats of a unit is found, and what that does to the heading is said."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers import REAL_LOGS, default_config, generate
from leaning_sets import calibrated, leaning_coverage_percent, recordings
from test_logs import write

from lbgc.calibrate import FORCES
from lbgc.earth import earth_rate_ned
from lbgc.errors import InputError
from lbgc.frames import rotation_z
from lbgc.report.calibration_table import report
from lbgc.sensor.calibration import calibrate
from lbgc.sensor.lifetimes import by_lifetime
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
    assert (np.abs(found.bias - bias) < 4.5 * found.bias_sigma).all()
    assert (np.abs(found.matrix - matrix[:2, :2]) < 4.5 * found.matrix_sigma).all()
    assert found.without_all.heading_rmse < found.without_bias.heading_rmse < found.heading_rmse


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
    for name, truth in (("run_sigma", 1.0), ("session_sigma", 4.0)):
        squares = np.array([getattr(f, name) for f in found]) ** 2
        error = squares.std() / np.sqrt(squares.size)
        assert abs(squares.mean() - truth) < 4.5 * error
    nees = np.array([((f.bias - 0.7) / f.bias_sigma) ** 2 for f in found])
    # five degrees of freedom of the spread: t^2 has mean 5/3
    assert nees.mean() == pytest.approx(5 / 3, abs=4.5 * nees.std() / np.sqrt(nees.size) + 0.08)


@pytest.mark.parametrize(("sessions", "each", "between"), [(3, 4, 2.0), (3, 4, 0.3), (4, 2, 1.0)])
def test_few_sessions_intervals_have_their_freedom(rng, sessions, each, between):
    """Drawn 1000 times, three axes each. Run and bias hold the truth 95% of the time, the bias's
    more where the sessions' spread is cut at zero, the session's at least 94: within 4.5 sampling
    errors."""
    session, held = np.repeat(np.arange(sessions), each), []
    for _ in range(1000):
        error = between * rng.standard_normal((sessions, 3))[session]
        found = by_lifetime(error + rng.standard_normal((len(session), 3)), session)
        ends = (found.bias_interval, found.run_interval, found.session_interval)
        truth = (0.0, 1.0, between)
        held.append([(e[0] <= x) & (x <= e[1]) for e, x in zip(ends, truth, strict=True)])
    of_bias, of_run, of_session = np.mean(held, axis=(0, 2))
    slack = 4.5 * np.sqrt(0.95 * 0.05 / 3000)
    assert of_run == pytest.approx(0.95, abs=slack)
    assert of_bias > 0.95 - slack
    assert of_session > 0.94 - slack


def test_one_session_is_no_split(rng):
    error = rng.standard_normal((20, 3))
    found = by_lifetime(error, np.zeros(20))
    assert found.session_sigma is None
    np.testing.assert_allclose(found.run_sigma, error.std(axis=0, ddof=1))
    np.testing.assert_allclose(found.bias_sigma, found.run_sigma / np.sqrt(20))
    np.testing.assert_allclose(found.bias, error.mean(axis=0))


def test_a_base_that_leans_has_no_scale():
    """Of 60 sets at 3 and 2 degrees of lean whose scale and misalignment are zero, none is refused
    and 95% of the 240 intervals hold it: within 4.5 sampling errors."""
    percent, refused = leaning_coverage_percent(60, 3.0, 2.0)
    assert refused == 0
    assert percent == pytest.approx(95.0, abs=450 * np.sqrt(0.95 * 0.05 / 240))


def test_scale_and_misalignment_are_found_on_a_base_that_leans(rng):
    """9 degrees, the sensor turned on it: within 4.5 standard errors, and they are small."""
    imu = default_config("imu=ideal", "imu.gyro.bias_run_deg_per_h=0.02").imu.model(100.0)
    heading = np.arange(36) * 2 * np.pi / 36
    drawn = recordings(imu, rng, 9.0, -4.0, heading)
    matrix = np.array([[0.03, -0.02, 0.0], [0.01, -0.05, 0.0], [0.0, 0.0, 0.0]])
    spoiled = [replace(r, gyro=r.gyro @ (np.eye(3) + matrix).T) for r in drawn]
    found = calibrated(spoiled)
    assert (np.abs(found.matrix - matrix[:2, :2]) < 4.5 * found.matrix_sigma).all()
    assert (found.matrix_sigma < 1e-3).all()


@pytest.mark.parametrize("each", [1, 3])
def test_a_session_for_every_heading_is_no_wrong_scale(each):
    """The sessions' spread is then the headings': 95% hold zero, within 4.5 sampling errors."""
    held, heading = [], np.repeat(np.arange(8) * np.pi / 4, each)
    truth = np.einsum("j,rji->ri", earth_rate_ned(0.7), rotation_z(heading))
    session = np.repeat(np.arange(8), each)
    rng = np.random.default_rng(3)
    for _ in range(100):
        rates = truth + DPH * (2 * rng.standard_normal((8, 3))[session]
                               + 0.1 * rng.standard_normal((8 * each, 3)))  # fmt: skip
        low, high = calibrate(rates, heading, 0.7, session).matrix_interval
        held.append((low <= 0) & (high >= 0))
    assert np.mean(held) == pytest.approx(0.95, abs=4.5 * np.sqrt(0.95 * 0.05 / 400))


@pytest.mark.parametrize(
    ("headings", "says"),
    [
        ([40], "every heading is near 40 deg; headings near 130, 220, 310 deg are missing"),
        ([38, 41], "headings near 130, 220, 310 deg are missing"),
        ([0, 180], "headings near 90 and 270 deg are missing"),
        ([30, 120], "headings near 75 and 255 deg are missing"),
    ],
)
def test_headings_that_are_missing_are_named_and_the_bias_is_told(rng, headings, says):
    """Scale of 3% is in the bias of one heading, and of two as far as they are on one side."""
    heading = np.deg2rad(np.tile(headings, 12).astype(float))
    truth = np.einsum("j,rji->ri", earth_rate_ned(0.5), rotation_z(heading))
    bias = np.array([3.0, -2.0, 1.0]) * DPH
    rates = truth * [1.03, 1.03, 1.0] + bias + 0.05 * DPH * rng.standard_normal(truth.shape)
    found = calibrate(rates, heading, 0.5)
    assert found.matrix is None
    assert found.missing is not None
    assert found.without_all is None
    bias = bias + 0.03 * truth.mean(axis=0) * [1, 1, 0]
    assert (np.abs(found.bias - bias) < 4.5 * found.bias_sigma).all()
    said = report(found, "mine")
    assert says in said
    assert "scale and misalignment cannot be told" in said
    assert "nan" not in said


def test_four_headings_give_a_scale_with_one_degree_of_freedom(rng):
    """t is 12.7; and three of them leave nothing to judge the fourth by."""
    heading = np.arange(4) * np.pi / 2
    truth = np.einsum("j,rji->ri", earth_rate_ned(0.5), rotation_z(heading))
    found = calibrate(truth + DPH * rng.standard_normal((4, 3)), heading, 0.5)
    half = (found.matrix_interval[1] - found.matrix_interval[0]) / 2
    np.testing.assert_allclose(half, 12.706 * found.matrix_sigma, rtol=1e-3)
    assert found.without_all is None
    assert "scale and misalignment taken out" not in report(found, "mine")


def test_a_navigation_grade_bias_shows_its_digits(rng):
    heading = np.arange(12) * np.pi / 6
    truth = np.einsum("j,rji->ri", earth_rate_ned(0.5), rotation_z(heading))
    rates = truth + 0.0035 * DPH + 0.0003 * DPH * rng.standard_normal(truth.shape)
    said = report(calibrate(rates, heading, 0.5), "mine").split()
    shown = said[said.index("forward") + 4]
    assert float(shown) == pytest.approx(0.0035, abs=0.0005)
    assert len(shown) >= len("+0.00350")


def test_three_recordings_give_a_bias_with_their_freedom(rng):
    """Two degrees of freedom: t is 4.30."""
    found = calibrate(1e-6 * rng.standard_normal((3, 3)), np.zeros(3), 0.5)
    half = (found.bias_interval[1] - found.bias_interval[0]) / 2
    np.testing.assert_allclose(half, 4.303 * found.bias_sigma, rtol=1e-3)


def test_better_is_said_of_sessions_alone(rng):
    """A bias of the unit helps the next session; one of each power-up helps its own recordings
    alone, and is not called better."""
    heading = np.tile(np.arange(8) * np.pi / 4, 6)
    truth = np.einsum("j,rji->ri", earth_rate_ned(0.5), rotation_z(heading))
    session = np.repeat(np.arange(6), 8)
    noise = 0.1 * DPH * rng.standard_normal(truth.shape)
    of_unit = calibrate(truth + 3 * DPH + noise, heading, 0.5, session)
    assert of_unit.without_bias.by_session
    assert of_unit.without_bias.says == 1
    assert ", better (mean square -" in report(of_unit, "mine")
    own = 3 * DPH * rng.standard_normal((6, 3))[session]
    assert calibrate(truth + own + noise, heading, 0.5, session).without_bias.says < 1
    one = calibrate(truth[:8] + 3 * DPH + noise[:8], heading[:8], 0.5, session[:8])
    assert "deg, less, for these power-ups" in report(one, "mine")
    assert ", better" not in report(one, "mine")


def test_left_out_is_no_better_by_chance(rng):
    """No bias, six sessions of one recording: of 200 sets, 2.5% are said to be better by chance,
    fewer since a bias that is estimated costs: at most 2.5 and 4.5 sampling errors."""
    heading = np.arange(6) * np.pi / 3
    truth = np.einsum("j,rji->ri", earth_rate_ned(0.5), rotation_z(heading))
    said = [
        calibrate(truth + DPH * rng.standard_normal((6, 3)), heading, 0.5, np.arange(6))
        .without_bias.says
        for _ in range(200)
    ]  # fmt: skip
    assert np.mean(np.array(said) == 1) < 0.025 + 4.5 * np.sqrt(0.025 * 0.975 / 200)


def test_what_does_not_rest_is_refused(rng):
    imu = default_config("imu=stim300").imu.model(100.0)
    drawn = recordings(imu, rng, 0.5, 0.0, np.arange(12) * np.pi / 6)
    assert calibrated(drawn).recordings == 12
    turned = drawn[4]
    angle = np.deg2rad(np.linspace(0, 30, len(turned.gyro)))
    by_hand = np.array([0.0, 0.0, np.deg2rad(30.0) / turned.duration_s])
    with pytest.raises(InputError, match=r"recording 4 = .* deg/h: is how far its down rate is"):
        calibrated([*drawn[:4], replace(turned, gyro=turned.gyro + by_hand), *drawn[5:]])
    with pytest.raises(InputError, match=r"recording 4 = 30 deg: is how far its plate turns"):
        calibrated([*drawn[:4], replace(turned, plate_angle=angle), *drawn[5:]])
    leant = turned.accel + np.where(np.arange(len(angle)) > 20, 0.05, 0.0)[:, None] * [1, 0, 0]
    with pytest.raises(InputError, match=r"recording 4 = .* m/s2: is how much its forward force"):
        calibrated([*drawn[:4], replace(turned, accel=leant), *drawn[5:]])
    with pytest.raises(InputError, match="is how far the vertical moves"):
        calibrated([replace(r, accel=r.accel + (leant - turned.accel) * 5) for r in drawn])


def test_rest_is_not_refused():
    """Sets that rest, with flicker, a random walk and a ramp: of 100, none."""
    keys = ("imu.gyro.rrw_deg_per_h_per_sqrt_h=20", "imu.gyro.bias_instability_deg_per_h=10",
            "imu.gyro.ramp_deg_per_h_per_h=5")  # fmt: skip
    imu = default_config("imu=vn100", "imu.gyro.allan_minimum_deg_per_h=null", *keys).imu
    for i in range(100):
        rng = np.random.default_rng([7, i])
        heading = rng.uniform(0, 2 * np.pi, int(rng.integers(4, 30)))
        calibrated(recordings(imu.model(100.0), rng, 1.0, 0.0, heading, duration_s=120.0))


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
    assert "one session" not in done.out
    assert "levelled by the accelerometers" in done.out
    assert "deg, less, for these power-ups" in done.out


def test_a_two_position_set_is_refused(cli, tmp_path):
    protocol = default_config("protocol=two_position").protocol
    generate(tmp_path / "d.zarr", output="means", recordings=8, protocol=protocol)
    done = cli("lbgc.calibrate", "data=d.zarr")
    assert done.code == 2
    assert "180 deg: is how far its plate turns" in done.err


def test_headings_on_one_side_are_said(cli, tmp_path, rng):
    rates, heading = means(rng, np.zeros(3), np.zeros((3, 3)), 0.2 * DPH, 60)
    names = ("gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s")
    for rows, says in ((slice(0, 20), True), (slice(None), False)):
        table = {"heading_deg": heading[rows] / DEG}
        table |= dict(zip(names, (rates[rows] / DEG).T, strict=True))
        write(tmp_path / "m.csv", table)
        done = cli("lbgc.calibrate", "means=m.csv", "latitude=32.76")
        assert ("headings are on one side: others near 237 deg" in done.out) == says


@pytest.mark.parametrize("run", [0.05, 1.0])
def test_coarsely_printed_means_are_said(cli, tmp_path, rng, run):
    """To 0.36 deg/h, where they scatter by less and by more."""
    rates, heading = means(rng, np.zeros(3), np.zeros((3, 3)), run * DPH, 48)
    names = ("gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s")
    table = dict(zip(names, np.round(rates / DEG, 4).T, strict=True))
    write(tmp_path / "m.csv", {"heading_deg": heading / DEG} | table)
    done = cli("lbgc.calibrate", "means=m.csv", "latitude=32.76")
    said = "down rates come in steps of 0.36 deg/h, no finer than they scatter"
    assert (said in done.out) == (run < 0.1)


def test_a_stray_of_another_power_up_may_say_so(rng):
    heading = np.arange(25) * 2 * np.pi / 25
    imu = default_config("imu=ideal", "imu.gyro.bias_run_deg_per_h=0.1",
                         "imu.gyro.bias_session_deg_per_h=20").imu.model(100.0)  # fmt: skip
    session = np.where(np.arange(25) < 24, 0, 1)
    drawn = recordings(imu, rng, 0.0, 0.0, heading, session=session)
    with pytest.raises(InputError, match="or is of another power-up"):
        calibrated(drawn)
    assert calibrated(drawn, session).sessions == 2


def test_columns_of_force_level_the_means(cli, tmp_path, rng):
    imu = default_config("imu=ideal", "imu.gyro.bias_run_deg_per_h=0.05").imu.model(100.0)
    drawn = recordings(imu, rng, 3.0, 2.0, np.arange(24) * np.pi / 12, latitude_deg=40.0)
    gyro, force = (np.stack([getattr(r, k)[0] for r in drawn]) for k in ("gyro", "accel"))
    table = {"heading_deg": np.array([r.heading_reference / DEG for r in drawn])}
    table |= {f"gyro_{x}_deg_s": v for x, v in zip("xyz", (gyro / DEG).T, strict=True)}
    write(tmp_path / "level.csv", table)
    levelled = table | dict(zip(FORCES, force.T, strict=True))
    np.savez(tmp_path / "m.npz", **levelled)  # any format of logs
    done = cli("lbgc.calibrate", "means=m.npz", "latitude=40")
    found = json.loads((tmp_path / done.last_line).read_text())
    assert np.abs(found["matrix"]).max() < 0.01
    assert "roll and pitch are up to" in done.out
    done = cli("lbgc.calibrate", "means=level.csv", "latitude=40")
    assert "taken as level; a base that leans by 1 degree would look like 1.5% of scale" in done.out
    found = json.loads((tmp_path / done.last_line).read_text())
    assert np.abs(found["matrix"]).max() > 0.02


@pytest.mark.skipif(not MEANS.exists(), reason=f"needs the recording means {MEANS.name}")
def test_the_published_recordings_figures(cli, tmp_path):
    """Within 0.05 deg/h of those stated beside them; that bias makes the headings worse."""
    done = cli("lbgc.calibrate", f"means={MEANS}", "latitude=32.76")
    found = json.loads((tmp_path / done.last_line).read_text())
    np.testing.assert_allclose(np.array(found["mean_error"][:2]) / DPH, [0.0, -0.9], atol=0.05)
    np.testing.assert_allclose(np.array(found["run_sigma"][:2]) / DPH, [1.11, 1.02], atol=0.05)
    assert found["across_rms"] / DPH == pytest.approx(0.87, abs=0.05)
    assert found["along_mean"] / DPH == pytest.approx(-0.51, abs=0.05)
    assert found["along_sigma"] / DPH == pytest.approx(1.6, abs=0.05)
    assert found["matrix"][0][0] == pytest.approx(-0.04, abs=0.005)
    assert found["matrix"][1][1] == pytest.approx(-0.06, abs=0.005)
    assert found["heading_rmse"] / DEG == pytest.approx(4.1, abs=0.05)
    assert found["without_bias"]["heading_rmse"] / DEG == pytest.approx(4.85, abs=0.1)
    assert "deg, worse: it is no constant" in done.out


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "means, data or log = nothing: give one of them"),
        (("means=a.csv",), "latitude = None deg: must be given with means=FILE"),
        (("means=a.csv", "latitude=40", "data=b"), "give one of them"),
        (("means=nonesuch.csv", "latitude=40"), "is not at nonesuch.csv"),
        (("means=few.csv", "latitude=40"), "2 recordings: are too few: 3 at the least"),
        (("means=wrong.csv", "latitude=40"), "columns = heading_deg: is no column of wrong"),
        (("means=half.csv", "latitude=40"), "columns = accel_z_m_s2: is no column of half.csv"),
    ],
)
def test_bad_calibration_input_is_named(cli, tmp_path, options, says):
    names = ("heading_deg", "gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s")
    write(tmp_path / "few.csv", {name: np.arange(2.0) for name in names})
    write(tmp_path / "wrong.csv", {"a": np.arange(3.0)})
    write(tmp_path / "half.csv", {name: np.arange(9.0) for name in (*names, *FORCES[:2])})
    done = cli("lbgc.calibrate", *options)
    assert done.code == 2
    assert says in done.err
