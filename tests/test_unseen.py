"""North that cannot be seen: sigmas that say so, verdicts, and what is refused."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from cases import write
from helpers import default_config

from lbgc import verdict
from lbgc.data.record import Record
from lbgc.data.windows import Labelled, Windows, cut, stack
from lbgc.earth import EARTH_RATE, earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.estimators import circle
from lbgc.estimators.block_means import Site, levelled
from lbgc.estimators.floor import course_of
from lbgc.estimators.inertial import oba_bias
from lbgc.estimators.static import gls, mean, triad
from lbgc.frames import euler_to_matrix, wrap
from lbgc.units import DEG, HOUR

LATITUDE = np.deg2rad(32.76)


def white_only(arw_deg_per_sqrt_h: float, rate_hz: float = 4.0, **gyro):
    """A sensor with this white noise of its gyros and nothing else that matters."""
    options = {"arw_deg_per_sqrt_h": arw_deg_per_sqrt_h, **gyro}
    zero = ("bias_instability_deg_per_h", "rrw_deg_per_h_per_sqrt_h", "bias_unit_deg_per_h",
            "bias_session_deg_per_h", "bias_run_deg_per_h", "scale_unit_ppm",
            "misalignment_unit_mrad")  # fmt: skip
    said = [f"imu.gyro.{k}={v}" for k, v in (dict.fromkeys(zero, 0.0) | options).items()]
    return default_config(*said).imu.model(rate_hz)


def resting(count, seconds, arw, bias=0.0, rate_hz=4.0, seed=0, latitude=LATITUDE) -> Labelled:
    """Level windows at rest, all round the compass: white noise of the gyros, deg/sqrt(h), and a
    bias of each, 1 sigma in deg/h, new in each window."""
    rng = np.random.default_rng(seed)
    n = round(seconds * rate_hz)
    psi = rng.uniform(-np.pi, np.pi, count)
    c_nb = euler_to_matrix(0.0, 0.0, psi)
    rate = (earth_rate_ned(latitude) @ c_nb)[:, None] * np.ones((1, n, 1))
    white = arw * DEG / np.sqrt(HOUR) * np.sqrt(rate_hz)
    rate = rate + white * rng.standard_normal(rate.shape)
    rate = rate + bias * DEG / HOUR * rng.standard_normal((count, 1, 3))
    force = np.tile([0.0, 0.0, -normal_gravity(latitude)], (count, n, 1))
    force = force + 1e-5 * rng.standard_normal(force.shape)
    windows = Windows(
        gyro=rate,
        accel=force,
        plate_angle=np.zeros((count, n)),
        rate_hz=rate_hz,
        latitude=np.full(count, latitude),
        start_s=np.zeros(count),
    )
    return Labelled(windows=windows, heading=psi, heading_reference=psi)


def nees(found, drawn):
    return np.mean((wrap(found.heading - drawn.heading) / found.sigma) ** 2)


@pytest.mark.parametrize("seconds", [10.0, 60.0])
@pytest.mark.parametrize("estimate", [mean, triad, gls])
def test_sigma_is_true_where_noise_drowns_earths_rate(estimate, seconds):
    """8.7 deg/sqrt(h), told of it: over 4,000 windows within 0.1 of one, six sampling errors."""
    drawn = resting(4000, seconds, 8.7)
    found = estimate(drawn.windows, white_only(8.7))
    assert nees(found, drawn) == pytest.approx(1.0, abs=0.1)
    assert found.sigma.max() <= circle.CHANCE
    assert not found.at_least


@pytest.mark.parametrize("seconds", [10.0, 60.0])
def test_scatter_alone_is_a_lower_bound_and_true_of_white_noise(seconds):
    drawn = resting(4000, seconds, 8.7)
    found = mean(drawn.windows)
    assert found.at_least
    assert nees(found, drawn) == pytest.approx(1.0, abs=0.12)  # its variance is estimated, too
    biased = resting(2000, seconds, 0.1, bias=20.0)
    assert nees(mean(biased.windows), biased) > 2  # which is why it is called a lower bound


def test_a_users_limit_on_the_bias_is_the_prior():
    """A bias of 20 deg/h, 1 sigma, where Earth's horizontal rate is 12.6: north is not seen."""
    drawn = resting(4000, 60.0, 0.1, bias=20.0)
    for estimate in (mean, triad):
        found = estimate(drawn.windows, None, bias_sigma=20.0 * DEG / HOUR)
        assert not found.at_least
        assert nees(found, drawn) == pytest.approx(1.0, abs=0.1)


def test_at_high_signal_sigma_is_the_old_one():
    """Small errors: sigma is the rate's error across north over Earth's horizontal rate."""
    windows = resting(200, 60.0, 0.1).windows
    found = mean(windows, white_only(0.1))
    error = 0.1 * DEG / np.sqrt(HOUR) / np.sqrt(60.0)
    small = error / (EARTH_RATE * np.cos(LATITUDE))
    assert np.median(found.sigma) == pytest.approx(small, rel=0.02)


@pytest.mark.parametrize("latitude_deg", [48.1, -48.1, 33.9, -33.9])
@pytest.mark.parametrize("bias", [0.0, 500.0])
def test_oba_bias_is_left_out_at_rest_whatever_noise_is_drawn(latitude_deg, bias):
    for seed in (2, 3):
        windows = resting(1, 60.0, 0.1, bias, seed=seed, latitude=np.deg2rad(latitude_deg)).windows
        with pytest.raises(InputError, match="to tell a bias from north"):
            oba_bias(windows)
    flicker = windows.plate_angle + np.deg2rad(0.01) * (np.arange(240) % 2)
    with pytest.raises(InputError, match="to tell a bias from north"):
        oba_bias(replace(windows, plate_angle=flicker))


def recording(bias, seconds=300.0, arw=0.1, seed=0, name="log") -> Record:
    """One level recording at rest, its gyros' biases in deg/h."""
    drawn = resting(1, seconds, arw, seed=seed)
    windows, heading = drawn.windows, float(drawn.heading[0])
    gyro = windows.gyro[0] + np.array(bias) * DEG / HOUR
    return Record(name, gyro, windows.accel[0], windows.plate_angle[0], 4.0, LATITUDE,
                  heading_reference=heading)  # fmt: skip


@pytest.mark.parametrize("bias", [1.0, 6.0, 12.0, 60.0])
def test_the_verdict_is_the_error_that_comes(bias):
    """`mean` is the best estimator of white noise and a like bias of both gyros: its RMSE over
    4,000 windows has a sampling error of 1%, the expected floor another."""
    drawn = resting(4000, 60.0, 0.5, bias)
    law = white_only(0.5, bias_run_deg_per_h=bias)
    course = levelled(drawn.windows.rows(slice(0, 1)), law.dt)[0].course
    found = verdict.judged(law, course, Site.at(LATITUDE), 60.0)
    error = wrap(mean(drawn.windows, law).heading - drawn.heading)
    rmse = np.rad2deg(np.sqrt(np.mean(error**2)))
    assert found.floor_deg == pytest.approx(rmse, rel=0.06)
    assert found.can == (rmse < 60)


def test_a_bias_that_turns_with_the_plate_hides_nothing():
    law = white_only(0.1, bias_run_deg_per_h=300.0)
    two = default_config("protocol=two_position").protocol
    site = Site.at(LATITUDE)
    found = [verdict.judged(law, course_of(p, 60.0), site, 60.0)
             for p in (replace(two, name="static", kind="static"), two)]  # fmt: skip
    assert [v.can for v in found] == [False, True]
    assert found[0].cause == "bias of the run"


def test_what_is_stated_of_a_sensor_stands_until_a_log_speaks_against_it():
    """60 logs whose biases are as stated, 2 deg/h: none is doubted. One of ten times as much is."""
    law = white_only(0.1, bias_run_deg_per_h=2.0)
    rng = np.random.default_rng(5)
    for seed in range(60):
        log = recording(2.0 * rng.standard_normal(3), seed=seed)
        assert not verdict.evidence([log], law).contradicts
    found, said = verdict.reached("log", "mine", law, [log], [60.0], True)
    assert len(said) == 1
    assert said[0].startswith("North can be found: log with mine, windows of 60 s")
    found, said = verdict.reached(
        "log", "mine", law, [recording([25.0, -10.0, 12.0])], [10.0, 60.0], True
    )
    assert not any(v.can for v in found)
    assert "North CANNOT be found" in said[0]
    assert "by chance it is 104" in said[0]
    assert "15.04 is Earth's" in said[0]
    assert "THIS LOG SPEAKS AGAINST what is stated of mine" in said[1]


def test_no_bias_stated_is_not_taken_for_none():
    good, bad = recording([0.1, 0.0, 0.1]), recording([500.0, -300.0, 200.0])
    law = white_only(0.1)
    for log, can in ((good, True), (bad, False)):
        found, said = verdict.reached("log", "mine", law, [log], [60.0], True)
        assert [v.can for v in found] == [can]
        assert "NO BIAS IS STATED of mine: floor, gls and every sigma take it as zero" in said[1]
        found, said = verdict.reached("log", None, None, [log], [60.0], True)
        assert [v.can for v in found] == [can]
        assert "no sensor is named (imu=NAME): the verdict assumes white noise" in said[1]
    assert float(said[1].split("a bias of ")[1].split()[0]) == pytest.approx(500, rel=0.3)
    found, said = verdict.reached("d", "mine", law, [good], [60.0], False)  # a simulation's own
    assert len(said) == 1


def test_a_moving_base_is_named_where_gyros_scatter_more_than_is_stated():
    law = white_only(0.1, bias_run_deg_per_h=2.0)
    log = recording([1.0, 1.0, 1.0])
    t = np.arange(len(log.gyro)) / 4.0
    sway = np.deg2rad(0.02) * np.sin(2 * np.pi * 0.3 * t)
    moved = replace(log, gyro=log.gyro + sway[:, None])
    assert not any("The base moves" in s for s in verdict.about(
        verdict.evidence([log], law), law, "mine", None))  # fmt: skip
    seen = verdict.evidence([moved], law)
    assert "scatter" in verdict.about(seen, law, "mine", None)[0]


def test_a_rate_that_is_not_earths_widens_what_scatter_says():
    """Its size is known: 500 deg/h where 15 is Earth's tells nothing of north, even to whoever is
    told no sensor. White noise alone is not widened: one window in 10,000 has 4 sigma."""
    log = recording([500.0, -300.0, 200.0])
    assert np.rad2deg(mean(cut(log, 60.0)).sigma) == pytest.approx(104, abs=2)
    drawn = resting(4000, 60.0, 1.0)
    assert nees(mean(drawn.windows), drawn) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("told", [False, True])
def test_evaluate_says_the_verdict_before_its_table(cli, tmp_path, told):
    log = recording([500.0, -300.0, 200.0], seconds=120.0)
    values = np.column_stack([np.rad2deg(log.gyro), log.accel])
    write(tmp_path / "mine.csv", values)
    options = ["log=csv", "log.path=mine.csv", "log.latitude=32.76", "log.rate_hz=4",
               "log.gyro_unit=deg/s", "log.most_bias_deg_per_h=1000", "windows_s=[10,60]",
               *(["imu=stim300", "log.heading_deg=10"] if told else [])]  # fmt: skip
    done = cli("lbgc.evaluate", *options)
    assert done.code == 0, done.err
    assert 0 < done.out.index("North CANNOT be found") < done.out.index("estimator  window")
    said = json.loads((tmp_path / done.last_line).with_name("results.json").read_text())
    assert [v["can"] for v in said["verdicts"]] == [False, False]
    assert all(v["floor_deg"] > 60 for v in said["verdicts"])
    assert said["verdict"][0] in done.out
    assert "North CANNOT be found" in (tmp_path / done.last_line).read_text()
    if told:
        assert "THIS LOG SPEAKS AGAINST what is stated of STIM300" in done.out
    else:
        assert ">= 10" in done.out  # a sigma that nobody told anything


@pytest.mark.parametrize(("off_deg", "says"), [(0.0, False), (90.0, True)])
@pytest.mark.parametrize("name", ["mean", "gls"])
def test_a_heading_that_the_log_contradicts_is_named(cli, tmp_path, name, off_deg, says):
    """Four minutes of a sensor that is told to half a degree."""
    log = recording([0.0, 0.0, 0.0], seconds=240.0, arw=0.01)
    write(tmp_path / "mine.csv", np.column_stack([np.rad2deg(log.gyro), log.accel]))
    heading = np.rad2deg(log.heading_reference) + off_deg
    done = cli("lbgc.evaluate", "log=csv", "log.path=mine.csv", "log.latitude=32.76",
               "log.rate_hz=4", "log.gyro_unit=deg/s", "windows_s=[60,240]", "imu=kvh1775",
               f"log.heading_deg={heading:.3f}", f"estimators=[{name}]")  # fmt: skip
    assert done.code == 0, done.err
    found = re.search(rf"{name} is \S+ of its sigmas off the told heading at 240 s", done.out)
    assert (found is not None) == says


def test_a_limit_that_the_user_knows_is_believed(cli, tmp_path):
    """3,000 deg/h: within it every bias is as probable, and the sigma of `mean` is chance."""
    log = recording([2.0, -1.0, 1.0], seconds=120.0)
    write(tmp_path / "mine.csv", np.column_stack([np.rad2deg(log.gyro), log.accel]))
    sigma = {}
    for limit in ("null", "8", "3000"):
        done = cli("lbgc.evaluate", "log=csv", "log.path=mine.csv", "log.latitude=32.76",
                   "log.rate_hz=4", "log.gyro_unit=deg/s", "windows_s=[60]", "log.heading_deg=10",
                   f"log.bias_limit_deg_per_h={limit}")  # fmt: skip
        assert done.code == 0, done.err
        said = json.loads((tmp_path / done.last_line).with_name("results.json").read_text())
        row = said["rows"][0]
        assert row["sigma_is_at_least"] == (limit == "null")
        sigma[limit] = row["sigma_deg"]
    assert sigma["null"] < 10 < sigma["8"] < 40 < sigma["3000"]


def test_a_model_refuses_another_unit_sensor_protocol_and_place(unit_bias_run):
    """Of one unit whose bias is 1 deg/h an axis; of a log, what its own rates say."""
    from lbgc.learning.trained import Setting, Trained

    data, run = unit_bias_run
    model = Trained.load(run)
    windows = stack(data.records(np.arange(20)), 0.2).windows
    units = (data.configuration["unit_seed"], 1)
    own = Setting(model.sensor, "heading_scan", units)
    expected = model.learned(windows).heading
    assert np.array_equal(model.asked(own, False)(windows).heading, expected)
    static = replace(own, protocol="static")
    assert np.array_equal(model.asked(static, False)(windows).heading, expected)
    other = default_config("imu=stim300").imu
    for setting, says in (
        (replace(own, sensor=other), "= STIM300: is not its sensor; it is meant for SDC500"),
        (replace(own, protocol="two_position"), "= two_position: is not its protocol"),
        (replace(own, units=(77, 1)), "= unit_seed=77: is another sensor than unit_seed=4, whose"),
    ):
        with pytest.raises(InputError, match=says):
            model.asked(setting, False)(windows)
        forced = model.asked(setting, True)
        assert np.array_equal(forced(windows).heading, expected)
        assert forced.name.endswith("(untrained)")
        assert any(says.split(":")[0][2:] in why for why in forced.overridden)
    far = replace(windows, latitude=windows.latitude + 0.1)
    with pytest.raises(InputError, match="deg: is no latitude of its"):
        model.asked(own, False)(far)
    turned = windows.plate_angle + np.linspace(0, 1, windows.plate_angle.shape[1])
    with pytest.raises(InputError, match="a plate: that turns is none of its"):
        model.asked(own, False)(replace(windows, plate_angle=turned))


def test_a_log_says_by_its_rates_that_it_is_another_units(unit_bias_run):
    """Sessions and runs have no bias here, so that 1 deg/h of the unit's can be told apart: no
    recording of the unit's own is refused; of other units' logs nearly half are. The rest have
    much the same bias, in the part that a heading does not hide."""
    from lbgc.learning.trained import Setting, Trained

    data, run = unit_bias_run
    model = Trained.load(run)
    windows = stack(data.records(np.arange(40)), 0.2).windows
    records = list(data.records(np.arange(40)))
    assert not any(model.asked(Setting(None, records=[r]), False).beside for r in records)
    rng = np.random.default_rng(3)
    refused = 0
    for record in records:
        other = record.gyro + rng.standard_normal(3) * np.sqrt(2) * DEG / HOUR
        log = replace(record, gyro=other)
        refused += bool(model.asked(Setting(None, records=[log]), False).beside)
    assert refused >= 16
    log = replace(records[0], gyro=records[0].gyro + 5 * DEG / HOUR)
    asked = model.asked(Setting(None, records=[log]), False)
    with pytest.raises(InputError, match="sigma from all of the unit's whose bias it learned"):
        asked(windows)


def test_bound_shouts_where_no_bias_is_stated(cli, tmp_path):
    options = "windows_s=[10,20]", "imu=sdc500"
    assert "NO BIAS IS STATED" not in cli("lbgc.bound", *options).out
    none = [f"imu.gyro.bias_{life}_deg_per_h=0" for life in ("unit", "session", "run")]
    done = cli("lbgc.bound", *options, *none)
    assert done.code == 0, done.err
    assert "NO BIAS IS STATED of the gyros (imu.gyro.bias_unit_deg_per_h" in done.out
