"""A warm-up, a step and a drift are told from a random walk, and a random walk is none of them."""

import json

import numpy as np
import pytest
import yaml
from cases import turn_on
from helpers import composed

import lbgc.fit
from lbgc.errors import InputError, build
from lbgc.sensor import gaussian
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.fitting import resting_axis, warmup
from lbgc.sensor.noise import Flicker, GaussMarkov, RandomWalk, White

N, DT = 3600, 1.0
T = N * DT
AT = (np.arange(N) + 0.5) * DT


def noise(terms, rng):
    return gaussian.sample(terms, rng, (1, N), DT)[0].astype(float)


@pytest.mark.parametrize(
    "terms",
    [
        (White(1.0), RandomWalk(0.05)),
        (White(0.1), RandomWalk(1.0)),
        (White(1.0), Flicker(0.3)),
        (White(1.0), GaussMarkov(1.0, 600.0)),
    ],
    ids=["walk", "strong walk", "flicker", "Gauss-Markov"],
)
def test_noise_is_no_change_of_the_mean(terms, rng):
    """Four recordings of each kind; the rate of false alarms is below 0.1% (see `_CERTAIN`)."""
    assert [warmup.found(noise(terms, rng), DT) for _ in range(4)] == [None] * 4


@pytest.mark.parametrize(
    ("tau", "end"), [(60.0, False), (600.0, False), (1800.0, False), (100.0, True)]
)
def test_a_decay_is_found_with_its_size_and_time(tau, end, rng):
    shape = np.exp(-(T - AT if end else AT) / tau)
    for size in (8.0, -8.0):
        rest, (course,) = warmup.taken_out(size * shape + noise((White(1.0),), rng), DT)
        assert course.kind == ("rise" if end else "decay")
        # 4.5 sigma: the size's with the time unknown is about 1.5 to 3 times its own
        sigma = np.sqrt(2 / tau) * 3
        assert course.size == pytest.approx(size, abs=4.5 * max(sigma, course.sigma))
        assert course.low * 0.9 < tau < course.high * 1.1
        assert np.abs(rest[:200].mean()) < 4.5 / np.sqrt(200)


@pytest.mark.parametrize(("at", "size"), [(150.0, 1.0), (1300.3, -30.0), (3400.0, 5.0)])
def test_a_step_is_found_to_the_sample(at, size, rng):
    for terms in ((White(1.0), Flicker(0.05)),):
        rest, courses = warmup.taken_out(size * (at < AT) + noise(terms, rng), DT)
        (course,) = courses
        assert course.kind == "step"
        assert course.size == pytest.approx(size, abs=5 * course.sigma)
        assert abs(course.time - at) < 1.0 + 40 / size**2
        assert np.abs(rest).max() < 6


def test_a_straight_drift_is_told_as_one(rng):
    series = 10 * AT / T + noise((White(1.0),), rng)
    _, (course,) = warmup.taken_out(series, DT)
    assert course.kind == "ramp"
    assert course.size == pytest.approx(10, abs=4.5 * np.sqrt(12 / N))
    fit = resting_axis.fitted(series[None], DT, (1.0, 3600.0))
    assert fit.estimates["K"].is_limit
    assert fit.ramp.low < 10 / T < fit.ramp.high


def test_changes_on_top_of_a_bias_instability_leave_it(rng):
    """And two changes are two."""
    own = noise((White(1.0), Flicker(0.1)), rng)
    rest, courses = warmup.taken_out(own + 20 * np.exp(-AT / 300) + 10 * (AT > 2500), DT)
    assert sorted(c.kind for c in courses) == ["decay", "step"]
    assert (rest - rest.mean()).std() == pytest.approx(own.std(), rel=0.02)


def test_several_recordings_warm_up_each_by_itself(rng):
    series = np.stack([noise((White(1.0),), rng) + a * np.exp(-AT / 400) for a in (20, -15, 25)])
    fit = resting_axis.fitted(series, DT, (1.0, 3600.0))
    assert [c.kind for c in fit.courses] == ["decay"] * 3
    sizes = [c.size for c in fit.courses]
    assert sizes == pytest.approx([20, -15, 25], abs=4.5 * 3 * np.sqrt(2 / 400))
    assert fit.estimates["K"].is_limit


def test_short_and_dead_series_have_none():
    assert warmup.found(np.arange(20.0), DT) is None
    assert warmup.found(np.ones(500), DT) is None


def test_what_to_cut():
    def course(kind, time):
        return warmup.MeanChange(kind, 1.0, 0.1, time, time, time, 50.0, 3600.0)

    assert course("decay", 600.0).skip_s == 1800.0
    assert course("decay", 1000.0).skip_s is None
    assert course("step", 500.0).skip_s == 500.0
    assert course("rise", 100.0).skip_s is None


def test_a_log_that_warms_up_becomes_a_sensor_that_does(cli, tmp_path):
    """Warm-ups of 60 deg/h and 5 mg with 10 minutes' time constant; white noise else."""
    turn_on(tmp_path)
    options = (
        "log=csv", f"log.path={tmp_path / 'log.csv'}", "log.rate_hz=20", "log.latitude=48.1",
        "log.heading_deg=90",
    )  # fmt: skip
    done = cli("lbgc.fit", *options, "name=warm")
    assert done.code == 0, done.err
    assert "no random walk: taken out before the noise is fitted" in done.out
    directory = tmp_path / done.last_line
    sensor = yaml.safe_load((directory / "imu" / "warm.yaml").read_text())
    build(ImuConfig, sensor)
    assert sensor["temperature"]["rise_k"] == 1
    assert sensor["temperature"]["time_s"] == pytest.approx(600, rel=0.02)
    assert sensor["gyro"]["bias_per_k_deg_per_h_per_k"] == pytest.approx([60, 0, 0], rel=0.03)
    assert sensor["accel"]["bias_per_k_ug_per_k"] == pytest.approx([0, 0, 5000], rel=0.01)
    assert sensor["gyro"]["bias_run_deg_per_h"] < 0.5  # the log has none, once the warm-up is out
    assert "gyro bias of" in sensor["assumed"]
    found = json.loads((directory / "fit.json").read_text())
    for part in ("gyro", "accel"):
        for axis in found[part]:
            assert axis["estimates"]["K"]["low"] == 0


def test_skip_s_leaves_out_the_start(tmp_path):
    turn_on(tmp_path)
    options = ("log=csv", f"log.path={tmp_path / 'log.csv'}", "log.rate_hz=20", "log.latitude=48.1")
    (whole,), (cut,) = (
        lbgc.fit._read(composed(lbgc.fit.FitConfig, "fit", *options, f"skip_s={skip}"))
        for skip in (0, 1800)
    )
    np.testing.assert_array_equal(cut.gyro, whole.gyro[:, 36_000:])
    with pytest.raises(InputError, match="50 s: is too short"):
        lbgc.fit._read(composed(lbgc.fit.FitConfig, "fit", *options, "skip_s=3550"))
