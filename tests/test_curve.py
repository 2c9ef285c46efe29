"""A published Allan curve becomes a sensor, with intervals that hold."""

import json
from dataclasses import replace

import allantools
import numpy as np
import pyarrow as pa
import pyarrow.feather
import pytest
import scipy.io
import yaml

from lbgc.data import curves
from lbgc.errors import InputError, build
from lbgc.sensor import gaussian
from lbgc.sensor.allan import octave_taus, overlapping_deviation
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.fitting.allan_covariance import AllanCovariance
from lbgc.sensor.fitting.allan_fit import MOST, AllanCurve, fitted, fitted_together
from lbgc.sensor.instability import FLOOR_SQUARED
from lbgc.sensor.noise import AngleQuantisation, Flicker, RandomWalk, White
from lbgc.units import DEG, HOUR, factor

CORNERS = (1.0, 3600.0)


def curve(N, B, K, taus, record_s=None, corners=None, **more) -> AllanCurve:
    """The Allan curve of these coefficients, of a floor that is flat throughout or has corners."""
    floor = FLOOR_SQUARED * B**2 if corners is None else Flicker(B, *corners).allan_variance(taus)
    return AllanCurve(taus, np.sqrt(N**2 / taus + floor + K**2 * taus / 3), None, record_s, **more)


@pytest.mark.parametrize(
    ("term", "alpha"),
    [(White(1.0), 0), (Flicker(1.0, 1e-3, 1e6), -1), (RandomWalk(1.0), -2),
     (AngleQuantisation(1.0), 2)],
    ids=lambda t: type(t).__name__,
)  # fmt: skip
def test_degrees_of_freedom_are_greenhalls(term, alpha):
    """As allantools has them; of less than a few samples it approximates them."""
    taus, dt, seconds = np.array([4.0, 16.0, 64.0, 256.0, 1000.0]), 0.1, 4000.0
    covariance = AllanCovariance(taus, seconds, [term], dt).matrix(np.ones(1))
    freedom = 2 * term.allan_variance(taus) ** 2 / np.diag(covariance)
    n = round(seconds / dt) + 1
    known = [allantools.edf_greenhall(alpha, 2, round(t / dt), n, overlapping=True) for t in taus]
    np.testing.assert_allclose(freedom, known, rtol=0.02)


def test_overlapping_estimates_vary_together_as_predicted(rng):
    """2000 series of 400 s: standard errors and correlations within 4.5 of their own errors."""
    taus, dt, count = np.array([0.25, 0.5, 1.0, 4.0, 20.0, 100.0]), 0.25, 2000
    terms = (White(1.0), Flicker(0.5), RandomWalk(0.1))
    drawn = gaussian.sample(terms, rng, (count, 1600), dt)
    variances = np.array([overlapping_deviation([y[:, None]], dt, taus)[0] ** 2 for y in drawn])
    units = [White(1.0), Flicker(1.0), RandomWalk(1.0)]
    covariance = AllanCovariance(taus, 400.0, units, dt).matrix(np.array([1.0, 0.25, 0.01]))
    sigma = np.sqrt(np.diag(covariance))
    freedom = 2 * sum(t.allan_variance(taus) for t in terms) ** 2 / sigma**2
    off = variances.std(axis=0) / sigma - 1
    assert (np.abs(off) < 4.5 * np.sqrt((2 + 12 / freedom) / count) / 2).all()
    correlation = covariance / np.outer(sigma, sigma)
    assert np.abs(np.corrcoef(variances.T) - correlation).max() < 4.5 * 1.5 / np.sqrt(count)


@pytest.mark.parametrize(
    ("N", "B", "K", "corners", "record_s"),
    [
        (1.0, 0.2, 0.01, None, None),
        (1.0, 0.5, 0.05, CORNERS, 20_000.0),
        (0.3, 1.0, 0.02, None, 20_000.0),
        (0.3, 1.0, 0.02, CORNERS, None),
        (5.0, 1.0, 0.0, CORNERS, 20_000.0),
    ],
)
def test_coefficients_of_a_curve_come_back(N, B, K, corners, record_s, rng):
    """Printed with three digits: N within 3%, B within 10%. Read off a figure with 1% error: within
    the interval, also where the floor's corner and white noise can hardly be told apart."""
    taus = np.geomspace(0.1, 5000, 25)
    true = curve(N, B, K, taus, record_s, corners, reading=0.01)
    printed = replace(true, deviation=np.array([float(f"{d:.3g}") for d in true.deviation]))
    read = replace(true, deviation=true.deviation * np.exp(0.01 * rng.standard_normal(25)))
    first, second = (fitted_together([c], CORNERS, True)[0].fit.estimates for c in (printed, read))
    assert first["N"].value == pytest.approx(N, rel=0.03)
    assert first["B"].value == pytest.approx(B, rel=0.10)
    for e in (first, second):
        assert e["N"].low < N < e["N"].high
        assert e["B"].low < B < e["B"].high


def test_intervals_of_an_hours_curve_hold(rng):
    """24 curves of an hour, three coefficients: fewer than 61 of 72 would be a chance of one in
    two thousand. The errors are as large as the intervals say."""
    true = {"N": 1.0, "B": 0.5, "K": 0.1}
    terms, dt, seconds = (White(1.0), Flicker(0.5), RandomWalk(0.1)), 0.5, 3600
    taus = octave_taus(round(seconds / dt), dt)
    held, errors = 0, []
    for y in gaussian.sample(terms, rng, (24, round(seconds / dt)), dt):
        deviation = overlapping_deviation([y[:, None]], dt, taus)[0]
        e = fitted(AllanCurve(taus, deviation, None, float(seconds), dt)).fit.estimates
        held += sum(e[name].low <= value <= e[name].high for name, value in true.items())
        sigma = np.log(e["B"].high / e["B"].low) / (2 * 1.96) if e["B"].low > 0 else np.inf
        errors.append(np.log(max(e["B"].value, 1e-3) / 0.5) / sigma)
    assert held >= 61
    assert np.std(errors) < 1.6


def test_what_a_curve_cannot_tell_is_a_limit():
    """A curve that ends before the floor says of B and K how large they are at most."""
    taus = np.geomspace(0.1, 30, 15)
    e = fitted(curve(1.0, 0.02, 0.0, taus, 120.0, reading=0.01)).fit.estimates
    assert not e["N"].is_limit
    assert e["B"].is_limit
    assert e["K"].is_limit
    assert 0.02 < e["B"].upper < 0.7


def test_quantisation_and_a_drift_are_taken_where_they_show():
    taus = np.geomspace(0.01, 5000, 30)
    plain = curve(1.0, 0.2, 0.01, taus, 20_000.0, CORNERS, reading=0.01)
    assert set(fitted(plain).fit.estimates) == {"N", "B", "K"}
    more = AngleQuantisation(0.5).allan_variance(taus)
    quantised = AllanCurve(taus, np.sqrt(plain.deviation**2 + more), None, 20_000.0, reading=0.01)
    found = fitted(quantised).fit
    assert found.estimates["Q"].value == pytest.approx(0.5, rel=0.03)
    assert found.estimates["N"].value == pytest.approx(1.0, rel=0.03)
    steep = np.sqrt(plain.deviation**2 + (1e-3 * taus) ** 2 / 2)
    drifting = fitted(AllanCurve(taus, steep, None, 20_000.0, reading=0.01)).fit
    assert drifting.ramp.value == pytest.approx(1e-3, rel=0.1)
    assert drifting.ramp.low > 0
    assert drifting.estimates["N"].value == pytest.approx(1.0, rel=0.03)


def test_a_curve_that_no_sum_of_terms_explains_fails():
    """A bump of a factor of 1.5, as vibration makes one: said, with wider intervals."""
    taus = np.geomspace(0.1, 5000, 30)
    plain = curve(1.0, 0.2, 0.01, taus, 20_000.0, CORNERS, reading=0.01)
    bump = 1 + 0.5 * np.exp(-(np.log(taus / 2.0) ** 2) / 0.3)
    good, bad = fitted(plain), fitted(AllanCurve(taus, plain.deviation * bump, None, 20_000.0))
    assert not good.fails
    assert bad.fails
    width = [np.log(f.fit.estimates["N"].high / f.fit.estimates["N"].low) for f in (good, bad)]
    assert width[1] > 5 * width[0]


def test_many_points_are_thinned_and_a_long_corner_is_found():
    taus = np.geomspace(0.1, 5000, 400)
    long = (10.0, 3600.0)
    true = curve(0.02, 1.0, 0.0, taus, 20_000.0, long, reading=0.01)
    (found,) = fitted_together([true], CORNERS, True)
    assert len(found.curve.taus) <= MOST
    assert found.fit.corners == long
    assert found.fit.estimates["B"].value == pytest.approx(1.0, rel=0.02)
    (kept,) = fitted_together([true], CORNERS, False)
    assert kept.fit.corners == CORNERS
    assert kept.fails


TAUS = 0.1 * 2.0 ** np.arange(15)


def written(path, header, *columns):
    rows = (",".join(f"{v:.6g}" for v in row) for row in zip(*columns, strict=True))
    path.write_text("\n".join([header, *rows][0 if header else 1 :]) + "\n")


def test_a_published_curve_becomes_a_sensor(cli, tmp_path):
    """N = 3 deg/h s^1/2 = 0.05 deg/sqrt(h), B = 2 deg/h; of the accelerometer nothing is known."""
    deviation = curve(3.0, 2.0, 0.02, TAUS).deviation
    written(tmp_path / "sheet.csv", "tau (s),deviation (deg/h)", TAUS, deviation)
    done = cli("lbgc.fit", "curve.gyro=sheet.csv", "name=theirs")
    assert done.code == 0, done.err
    assert "all points weigh equally" in done.out
    assert "linear drift                   below" in done.out
    directory = tmp_path / done.last_line
    assert (directory / "allan_gyro.png").exists()
    text = (directory / "imu" / "theirs.yaml").read_text()
    assert "No curve of its accel: without noise here" in text
    sensor = build(ImuConfig, yaml.safe_load(text))
    assert sensor.gyro.triad().N[1] == pytest.approx(0.05 * DEG / np.sqrt(HOUR), rel=0.03)
    found = json.loads((directory / "fit.json").read_text())["gyro"][2]
    assert found["estimates"]["B"]["value"] == pytest.approx(2 * DEG / HOUR, rel=0.10)
    assert found["curve"]["weights"] == "equal"
    assert len(found["curve"]["taus"]) == 15


def test_a_curve_is_read_from_any_format(tmp_path, monkeypatch):
    """A named array with fields, and one of columns without names; of several tables, the one."""
    monkeypatch.chdir(tmp_path)
    deviation = curve(3.0, 2.0, 0.02, TAUS).deviation
    columns = {"tau": TAUS, "deviation": deviation}
    np.save("plain.npy", np.column_stack([TAUS, deviation]))
    scipy.io.savemat("theirs.mat", {"curve": columns, "other": {"x": TAUS, "y": TAUS, "z": TAUS}})
    pa.feather.write_feather(pa.table(columns), "theirs.feather")
    for file in ("plain.npy", "theirs.mat", "theirs.feather"):
        (found,) = curves.read(curves.CurveConfig(gyro=file, gyro_unit="deg/h"), "gyro")
        np.testing.assert_allclose(found.taus, TAUS)
        np.testing.assert_allclose(found.deviation, deviation * DEG / HOUR)
    scipy.io.savemat("two.mat", {"one": columns, "two": columns})
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY garbage")
    for file, says in (("two.mat", "holds no one curve"), ("a.npy", "cannot be read")):
        with pytest.raises(InputError, match=says) as caught:
            curves.read(curves.CurveConfig(gyro=file, gyro_unit="deg/h"), "gyro")
        assert caught.value.name == "curve.gyro"


def test_units_errors_and_axes_of_a_file_are_read(cli, tmp_path):
    """One file an axis, semicolons, an interval instead of an error, milliseconds."""
    for k, name in enumerate("xyz"):
        d = curve(100.0 * (k + 1), 5.0, 0.0, TAUS).deviation
        rows = "\n".join(f"{1e3 * t};{v};{0.9 * v};{1.1 * v}" for t, v in zip(TAUS, d, strict=True))
        (tmp_path / f"{name}.csv").write_text(f"tau [ms];deviation [ug];low;high\n{rows}\n")
    done = cli("lbgc.fit", "curve.accel=[x.csv,y.csv,z.csv]", "curve.confidence_percent=68.27",
               "curve.reading_percent=0")  # fmt: skip
    assert done.code == 0, done.err
    assert "points weigh by the errors that the curve states" in done.out
    sensor = yaml.safe_load((tmp_path / done.last_line / "imu" / "mine.yaml").read_text())
    N = np.array(sensor["accel"]["vrw_m_per_s_per_sqrt_h"])
    N *= factor("vrw_m_per_s_per_sqrt_h") / factor("ug")
    np.testing.assert_allclose(N, [100, 200, 300], rtol=0.03)
    assert "gyro" not in sensor


@pytest.mark.parametrize(
    ("header", "options", "says"),
    [
        ("tau,deviation", (), "curve.gyro_unit = None: choose from rad/s, deg/s, deg/h"),
        ("tau,deviation (deg/h)", ("curve.gyro_unit=deg/s",), "column says deg/h"),
        ("tau,deviation (furlong)", (), "whose unit is none of"),
        ("tau,adev", (), "has no column deviation; it has tau, adev"),
        ("tau,deviation (deg/h)", ("curve.record_s=100",), "twice the longest averaging time"),
        ("tau,deviation (deg/h)", ("curve.rate_hz=1",), "the shortest averaging time is 0.1 s"),
        ("tau,deviation (deg/h)", ("curve.reading_percent=-1",), "must be from 0 to 50"),
        ("tau,deviation (deg/h)", ("data=x.zarr",), "data and curve: give one"),
        ("tau,deviation (deg/h)", ("curve.accel=none.csv",), "curve.accel = none.csv: is no file"),
        ("tau,deviation (deg/h)", ("curve.accel=[a,b]",), "one file, or three"),
    ],
)
def test_a_curve_that_is_not_clear_is_refused(cli, tmp_path, header, options, says):
    written(tmp_path / "c.csv", header, TAUS, curve(3.0, 2.0, 0.02, TAUS).deviation)
    done = cli("lbgc.fit", "curve.gyro=c.csv", *options)
    assert done.code == 2
    assert says in done.err
    assert not (tmp_path / "outputs").exists()


@pytest.mark.parametrize(
    ("taus", "deviation", "says"),
    [
        ([1, 2, 3], [1, 1, 1], "has 3 points"),
        ([1, 2, 3, 3, 4, 5, 6], [1] * 7, "an averaging time twice"),
        ([0, 1, 2, 3, 4, 5, 6], [1] * 7, "has a tau that is not above zero"),
        ([1, 2, 3, 4, 5, 6], [1, 1, 1, 1, -1, 1], "has a deviation that is not above zero"),
        ([1, 2, 3, 4, 5, 6], [1, 1, 1, np.nan, 1, 1], "is not a number"),
    ],
)
def test_points_that_are_none_are_refused(cli, tmp_path, taus, deviation, says):
    written(tmp_path / "c.csv", "tau,deviation", taus, deviation)
    done = cli("lbgc.fit", "curve.gyro=c.csv", "curve.gyro_unit=deg/h")
    assert (done.code, says in done.err) == (2, True), done.err
