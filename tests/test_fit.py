"""The fit says the truth, with intervals, or says that it cannot tell."""

import json
import re

import cases
import numpy as np
import pytest
import scipy.signal
import yaml
from helpers import composed, figures, generate, needs_recording
from test_logs import write

import lbgc.fit
from lbgc.data.static import Static
from lbgc.errors import build
from lbgc.fit import FitConfig
from lbgc.report import fitted
from lbgc.report.fitted_yaml import sensor_yaml
from lbgc.sensor import gaussian
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.deterministic import Sinusoid
from lbgc.sensor.fitting import axes, corner, noise_fit, shapes
from lbgc.sensor.fitting.cosine_variance import Grid, density
from lbgc.sensor.fitting.ordinates import ordinates, pooled
from lbgc.sensor.noise import (
    AngleQuantisation,
    BandLimited,
    Flicker,
    GaussMarkov,
    Line,
    RandomWalk,
    White,
)

HOUR, RATE = 3600, 100


def series(terms, rng, seconds: int = HOUR, count: int = 1, rate: int = RATE) -> np.ndarray:
    return gaussian.sample(terms, rng, (count, seconds * rate), 1 / rate)


@pytest.mark.parametrize(
    "term", [White(1.3), Flicker(0.7), RandomWalk(0.2), GaussMarkov(0.8, 2.0),
             AngleQuantisation(0.3), BandLimited(1.0, 0.4), BandLimited(1.0, 9.0, 2.0)],
    ids=lambda t: type(t).__name__,
)  # fmt: skip
def test_predicted_variances_of_the_low_coefficients_are_exact(term):
    """Against the covariance of block means, transformed."""
    import scipy.fft

    n, h = 64, 3.0
    covariance = gaussian.covariance_of_means((term,), n, h)
    exact = np.diag(scipy.fft.dctn(covariance, norm="ortho"))[1:] * h
    grid = Grid(n, h, np.arange(1, n), np.ones(n - 1))
    np.testing.assert_allclose(density(term, grid), exact, rtol=1e-9)


@pytest.mark.parametrize(
    "terms",
    [
        (White(1.0), Flicker(0.5), RandomWalk(0.05)),
        (BandLimited(1.0, 20.0), Line(3.0, 10.0, 0.5)),
        (AngleQuantisation(0.02), White(0.1)),
    ],
)
def test_predicted_variances_are_those_of_drawn_series(terms, rng):
    """Summed over ten groups of ordinates of 40 series: relative sd sqrt(2/count), 4.5 of them."""
    data = pooled(series(terms, rng, 600, 40), 1 / RATE)
    predicted = sum(density(t, data.grid) for t in terms)
    for group in np.array_split(np.arange(len(predicted)), 10):
        count = data.count[group].sum()
        ratio = np.sum(data.power[group] / predicted[group]) / count
        assert abs(ratio - 1) < 4.5 * np.sqrt(2 / count) + 0.01


def test_coefficients_and_intervals_of_an_hour(rng):
    """40 axis-logs: N, B and K within the Fisher spread, intervals holding (binomial 4 sigma)."""
    true = {"N": 1.0, "B": 0.5, "K": 0.1}
    terms = (White(1.0), Flicker(0.5), RandomWalk(0.1))
    fits = [noise_fit.fit(ordinates(y, 0.01), shapes.core()) for y in series(terms, rng, HOUR, 40)]
    fisher = {"N": 0.0012, "B": 0.059, "K": 0.142}
    for name, value in true.items():
        errors = np.array([f.estimates[name].value / value - 1 for f in fits])
        assert abs(errors.mean()) < 4.5 * fisher[name] / np.sqrt(40) + fisher[name] ** 2
        assert errors.std() < 1.6 * fisher[name]
        held = [f.estimates[name].low <= value <= f.estimates[name].high for f in fits]
        assert np.mean(held) >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / 40)


def test_what_is_not_there_is_an_upper_limit(rng):
    """White noise alone: B and K are limits, not numbers, in about 95% of logs."""
    fits = [
        noise_fit.fit(ordinates(y, 0.01), shapes.core())
        for y in series((White(1.0),), rng, 900, 20)
    ]
    for name in ("B", "K"):
        assert np.mean([f.estimates[name].is_limit for f in fits]) >= 0.75
    assert np.mean([f.ramp.is_limit for f in fits]) >= 0.75


def test_further_parts_are_found_where_they_are(rng):
    terms = (BandLimited(1.0, 15.0), Flicker(0.5), Line(2.0, 20.0, 1.0))
    fit = noise_fit.choose(ordinates(series(terms, rng)[0], 0.01))
    e = fit.estimates
    assert e["bandwidth"].low < 15.0 < e["bandwidth"].high
    f0 = e["line_f0"]
    assert abs(f0.value - 20.0) < 4.5 * (f0.high - f0.low) / (2 * 1.96)
    assert e["line_sigma"].value == pytest.approx(2.0, rel=0.02)
    assert "Q" not in e
    plain = noise_fit.choose(ordinates(series((White(1.0),), rng)[0], 0.01))
    assert set(plain.estimates) == {"N", "B", "K"}


def test_a_lines_intervals_hold(rng):
    """12 logs of ten minutes, four parameters each at 95%: fewer than 40 of 48 would be a chance of
    one in five thousand."""
    true = {"N": 1.0, "line_sigma": 2.0, "line_f0": 20.0, "line_width": 1.5}
    held = 0
    for y in series((White(1.0), Flicker(0.1), Line(2.0, 20.0, 1.5)), rng, 600, 12):
        guess = {"line_f0": 20.1, "line_width": 1.0}
        e = noise_fit.fit(ordinates(y, 0.01), [*shapes.core(), shapes.line(1)], guess).estimates
        held += sum(e[name].low < value < e[name].high for name, value in true.items())
    assert held >= 40


def test_several_lines_are_found_and_written_down(rng):
    """Two on one axis: each centre within its own 4.5 sigma; the YAML gives them back."""
    terms = (White(1.0), Line(2.0, 20.0, 1.0), Line(1.5, 31.0, 2.0))
    fit = noise_fit.choose(ordinates(series(terms, rng)[0], 0.01))
    e = fit.estimates
    found = sorted((e["line_f0"], e["line_f0_2"]), key=lambda x: x.value)
    for estimate, f0 in zip(found, (20.0, 31.0), strict=True):
        assert abs(estimate.value - f0) < 4.5 * (estimate.high - estimate.low) / (2 * 1.96)
    plain = noise_fit.choose(ordinates(series((White(1.0),), rng)[0], 0.01))
    static = Static("log", np.zeros((1, 100, 3)), np.zeros((1, 100, 3)), 0.01, 0.5, None, None)
    three = {part: [fit, plain, plain] for part in ("gyro", "accel")}
    assert fitted.report(static, three).count("narrow-band line") == 4
    text = sensor_yaml("mine", [static], three)
    imu = build(ImuConfig, yaml.safe_load(text))
    for triad in (imu.gyro.triad(), imu.accel.triad()):
        lines = [t for t in triad.terms[0] if isinstance(t, Line)]
        assert sorted(t.f0 for t in lines) == pytest.approx([x.value for x in found], rel=1e-4)
        assert not any(isinstance(t, Line) for t in triad.terms[1])


def test_a_parameters_name_loses_its_lines_number_alone():
    assert fitted.unnumbered("line_f0_2") == fitted.unnumbered("line_f0") == "line_f0"
    assert fitted.unnumbered("line_width_12") == "line_width"


def test_fitted_axes_are_kept_whatever_fails_later(cli, tmp_path, monkeypatch):
    generate(tmp_path / "d.zarr", recordings=1, rate_hz=50.0, duration_s=80.0, split=[0, 0, 1])

    def fail(*_):
        raise OSError("the disk is full")

    monkeypatch.setattr(lbgc.fit, "report", fail)
    said = cli("lbgc.fit", "data=d.zarr")
    assert (said.code, "the disk is full" in said.err) == (2, True)
    kept = list((tmp_path / "outputs" / "fit").glob("*/axes/*.json"))
    assert {p.stem for p in kept} == {
        f"{part}_{axis}" for part in ("gyro", "accel") for axis in ("forward", "right", "down")
    }
    assert all(json.loads(p.read_text())["estimates"]["N"]["value"] > 0 for p in kept)


def test_processes_change_no_number(rng):
    """Two processes and none beside this one; each says what it tries."""
    three = {("gyro", k): series((White(1.0 + k),), rng, 60) for k in range(3)}
    said = []
    alone = dict(axes.fitted(three, 1 / RATE, (1.0, 3600.0), 1, lambda *what: said.append(what)))
    beside = dict(axes.fitted(three, 1 / RATE, (1.0, 3600.0), 2))
    assert {name for name, _ in said} == set(three)
    assert {n: f.estimates for n, f in alone.items()} == {n: f.estimates for n, f in beside.items()}


def test_the_corner_that_the_data_show_is_taken(rng):
    """A bias instability that sets in at ten seconds, well above white noise: two axes say so
    together. Where white noise covers it, the usual corner stays."""
    plain, shown = ((White(0.02), Flicker(1.0, s)) for s in (1.0, 10.0))
    found = {}
    for name, terms in (("plain", plain), ("shown", shown), ("covered", (White(1.0),))):
        fits = [
            noise_fit.judged(y[None], data, noise_fit.choose(data))
            for y in series(terms, rng, 1200, 2, 10)
            for data in (ordinates(y, 0.1),)
        ]
        found[name] = corner.chosen([f.short_corners for f in fits])
    assert found == {"plain": 1.0, "shown": 10.0, "covered": 1.0}


def test_a_log_of_two_minutes_at_10_hz_is_fitted(rng):
    """Twelve hundred samples, hardly two ordinates in a bin."""
    n = noise_fit.choose(ordinates(series((White(1.0),), rng, 120, 1, 10)[0], 0.1)).estimates["N"]
    assert n.low < 1.0 < n.high
    assert FitConfig(data="x", flicker_short_s=3.0).corners == (3.0, 3600.0)


def test_two_resonances_are_two_lines(rng):
    """Filtered by others' code (a digital peak), on five minutes: both found as resonances, and
    white noise within 3%; steep flanks would leave their skirts to it."""
    t, gyro, _ = cases.static(100, 300, seed=5)
    y = gyro[:, 0] / np.std(gyro[:, 0]) * 10  # N = 1
    for hz, width, rms in ((17, 0.5, 100.0), (31, 0.7, 66.0)):
        b, a = scipy.signal.iirpeak(hz, hz / width, fs=100)
        x = scipy.signal.lfilter(b, a, rng.standard_normal(len(t)))
        y = y + rms / 10 * x / x.std()
    fit = noise_fit.choose(ordinates(y, 0.01))
    e = fit.estimates
    assert set(e) - {"N", "B", "K"} == {
        name + number for name in ("line_sigma", "line_f0", "line_width") for number in ("", "_2")
    }
    assert [shapes.poles(s) for s in fit.shapes if shapes.is_line(s)] == [1, 1]
    found = sorted((e["line_f0"].value, e["line_f0_2"].value))
    assert found == pytest.approx([17.0, 31.0], abs=0.15)
    assert e["N"].value == pytest.approx(1.0, rel=0.03)


def test_tones_are_found_and_kept_out_of_the_noise(rng):
    y = series((White(1.0),), rng)[0] + Sinusoid(0.5, 17.3).sample(rng, (HOUR * RATE,), 0.01)
    data = ordinates(y, 0.01)
    (tone,) = data.tones
    assert tone.f == pytest.approx(17.3, abs=1e-3)
    assert tone.amplitude == pytest.approx(0.5, rel=0.15)  # 1 sigma is 5%
    assert noise_fit.fit(data, shapes.core()).estimates["N"].value == pytest.approx(1.0, rel=0.01)


def test_a_strong_tone_is_no_line(rng):
    """Its leakage is left out too; its amplitude is the motion's, not that of its means."""
    y = series((White(1.0),), rng)[0] + Sinusoid(60.0, 47.99).sample(rng, (HOUR * RATE,), 0.01)
    fit = noise_fit.choose(ordinates(y, 0.01))
    assert set(fit.estimates) == {"N", "B", "K"}
    assert len(fit.tones) == 1
    assert fit.tones[0].amplitude == pytest.approx(60.0, rel=0.01)


def test_a_log_becomes_a_sensor_that_gives_it_back(cli, tmp_path):
    """dataset -> fit -> YAML -> dataset -> fit: the second fit's intervals hold the first's values
    (each misses in 5%: at most two of nine)."""
    still = {"recordings": 1, "rate_hz": 50.0, "duration_s": 1800.0, "split": [0, 0, 1]}
    generate(tmp_path / "first.zarr", **still)
    first = cli("lbgc.fit", "data=first.zarr", "name=first")
    assert first.code == 0, first.err
    command = re.search(r"--config-dir (\S+) imu=first", first.out)
    assert command
    directory = tmp_path / command[1]
    assert {p.name for p in directory.iterdir()} >= {
        "imu",
        "fit.json",
        "allan_gyro.png",
        "allan_accel.png",
        "allan_paper.png",
        "spectrum_gyro.png",
        "spectrum_accel.png",
    }
    sensor = build(ImuConfig, yaml.safe_load((directory / "imu" / "first.yaml").read_text()))
    generate(tmp_path / "second.zarr", **still, imu=sensor, seed=2)
    second = cli("lbgc.fit", "data=second.zarr", "name=second")
    assert second.code == 0, second.err
    again = json.loads((tmp_path / second.last_line / "fit.json").read_text())
    misses = 0
    for axis, n, b, k in zip(
        range(3),
        sensor.gyro.triad().N,
        figures(sensor.gyro.triad(), Flicker, "B"),
        figures(sensor.gyro.triad(), RandomWalk, "K"),
        strict=True,
    ):
        found = again["gyro"][axis]["estimates"]
        for name, value in (("N", n), ("B", b), ("K", k)):
            misses += not found[name]["low"] * 0.999 <= value <= found[name]["high"] * 1.001
    assert misses <= 2


def test_labelled_recordings_give_the_biases_too(cli, tmp_path):
    generate(tmp_path / "d.zarr", recordings=8, rate_hz=10.0, duration_s=240.0)
    done = cli("lbgc.fit", "data=d.zarr", "name=labelled")
    assert done.code == 0, done.err
    assert "8 recordings of one unit" in done.out
    written = yaml.safe_load((tmp_path / done.last_line / "imu" / "labelled.yaml").read_text())
    assert len(written["gyro"]["bias_run_deg_per_h"]) == 3


def spoil(name: str, rng) -> dict[str, np.ndarray]:
    n = 20_000
    gyro = np.array([6e-5, 0.0, -4e-5]) + 1e-5 * rng.standard_normal((n, 3))
    accel = np.array([0.0, 0.0, -9.8]) + 1e-2 * rng.standard_normal((n, 3))
    if name == "shaken":
        gyro[n // 2 : n // 2 + 4000] += 1e-4 * rng.standard_normal((4000, 3))
    if name == "dead":
        gyro[:, 1] = 3e-5
    if name == "short":
        gyro, accel = gyro[:1000], accel[:1000]
    names = ["w_x", "w_y", "w_z", "f_x", "f_y", "f_z"]
    return dict(zip(names, np.hstack([gyro, accel]).T, strict=True))


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("dead", "never changes"),
        ("shaken", "something moved, or shook it"),
        ("short", "10 s: is too short to tell noise"),
    ],
)
def test_logs_that_are_not_static_are_refused(cli, tmp_path, rng, name, says):
    write(tmp_path / "log.csv", spoil(name, rng))
    options = ("log.path=log.csv", "log.rate_hz=100", "log.latitude=48", "log.gyro_unit=rad/s")
    done = cli("lbgc.fit", "log=csv", *options)
    assert done.code == 2
    assert says in done.err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "log, data, curve or units = nothing: give one"),
        (("data=nonesuch",), "is no dataset"),
        (("data=x", "name='a/b'"), "must be a plain word"),
        (("data=x", "flicker_long_s=0.5"), "above flicker_short_s"),
        (("data=x", "flicker_short_s=0"), "greater than zero"),
        (("data=x", "processes=0"), "greater than zero"),
    ],
)
def test_bad_fit_input_is_named(cli, tmp_path, options, says):
    done = cli("lbgc.fit", *options)
    assert done.code == 2
    assert says in done.err
    assert list(tmp_path.iterdir()) == []


@needs_recording("lasergyro.imu")
def test_a_swaying_vehicle_is_not_static(cli):
    done = cli("lbgc.fit", "log=lasergyro")
    assert done.code == 2
    assert "times as much gyro noise in one eighth" in done.err


def test_the_defaults_are_the_yamls():
    assert composed(FitConfig, "fit", "data=x") == FitConfig(data="x")
    assert fitted.KEYS["N"] == ("arw_deg_per_sqrt_h", "vrw_m_per_s_per_sqrt_h")


def test_six_replicates_tell_as_much_as_six_logs(rng):
    """Fisher's information adds up: the intervals of six logs fitted together are 1/sqrt(6) as wide
    as those of one, within 10% of their mean, at biases that differ by 40 of N/sqrt(s)."""
    y = series((White(1.0), Flicker(0.5), RandomWalk(0.1)), rng, 2 * HOUR, 6, 10)
    y += 40 * rng.standard_normal((6, 1))
    single = [noise_fit.fit(ordinates(one, 0.1), shapes.core()).estimates for one in y]
    joint = noise_fit.fit(pooled(y, 0.1), shapes.core()).estimates
    for name, true in (("N", 1.0), ("B", 0.5), ("K", 0.1)):
        widths = [np.log(e[name].high / e[name].low) for e in (joint, *single)]
        assert widths[0] / np.mean(widths[1:]) == pytest.approx(1 / np.sqrt(6), rel=0.10)
        assert joint[name].low < true < joint[name].high


def test_several_logs_of_one_sensor_are_fitted_together(cli, tmp_path, rng):
    """Two files, of which one is longer: two recordings in one fit, with their biases apart."""
    for k, n in enumerate((8000, 6000)):
        values = spoil("", rng)
        rows = {name: v[:n] + (k * 1e-5 if name[0] == "w" else 0.0) for name, v in values.items()}
        write(tmp_path / f"{k}.csv", rows)
    options = ("log.rate_hz=100", "log.latitude=48", "log.gyro_unit=rad/s", "processes=1")
    done = cli("lbgc.fit", "log=csv", "log.path=[0.csv,1.csv]", *options)
    assert done.code == 0, done.err
    assert "2 recording(s) of 60 s at 100 Hz" in done.out
    assert "the first 60 s of each are used" in done.out
    found = json.loads((tmp_path / done.last_line / "fit.json").read_text())
    n = found["gyro"][0]["estimates"]["N"]
    assert n["low"] < 1e-6 < n["high"]
    again = cli("lbgc.fit", "log=csv", "log.path=[0.csv,0.csv]", *options)
    assert (again.code, "names a file twice" in again.err) == (2, True)
