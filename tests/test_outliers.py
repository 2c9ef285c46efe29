"""Spikes and short knocks are found and taken out, and nothing else is."""

import json

import numpy as np
import pytest
from test_fit import spoil
from test_logs import write

from lbgc.sensor import gaussian
from lbgc.sensor.fitting import noise_fit, shapes
from lbgc.sensor.fitting.ordinates import ordinates
from lbgc.sensor.fitting.outliers import without_outliers
from lbgc.sensor.noise import BandLimited, Flicker, Line, RandomWalk, White

TERMS = (White(1.0), Flicker(0.5), RandomWalk(0.1))
TRUE = {"N": 1.0, "B": 0.5, "K": 0.1}
SIGMA, RATE = 10.0, 100


def spoilt(y, rng, sizes=(8.0, 100.0)):
    """A recording with 0.1% of its samples spoiled: half of them by spikes of so many sigma (evenly
    in logarithm), half by knocks that ring and push for 0.2 s, of 15 to 50 sigma."""
    y, n = y.copy(), len(y)
    at = rng.choice(n, n // 2000, replace=False)
    y[at] += SIGMA * rng.choice([-1, 1], len(at)) * np.exp(rng.uniform(*np.log(sizes), len(at)))
    k = np.arange(20)
    ringing = np.exp(-k / 6) * (0.3 + np.cos(2 * np.pi * 0.2 * k))
    for first in rng.integers(100, n - 100, n // 40_000):
        y[first : first + 20] += SIGMA * rng.uniform(15, 50) * rng.choice([-1, 1]) * ringing
    return y


def fit(y):
    return noise_fit.fit(ordinates(y, 1 / RATE), shapes.core()).estimates


@pytest.mark.parametrize("sizes", [(8.0, 100.0), (5.0, 8.0)])
def test_a_spoilt_hour_is_fitted_as_a_clean_one(sizes, rng):
    """Eight hours: 24 intervals, of which fewer than 18 hold by a chance of one in a thousand. The
    spoilt log's interval never holds N. Estimates are within 0.9 standard errors of the clean
    log's."""
    held = 0
    for y in gaussian.sample(TERMS, rng, (8, 3600 * RATE), 1 / RATE):
        wild = spoilt(y, rng, sizes)
        settled, found = without_outliers(wild[None], 1 / RATE)
        assert found is not None
        assert 0.0008 < found.share < 0.0020
        clean, plain, robust = fit(y), fit(wild), fit(settled[0])
        assert plain["N"].low > TRUE["N"]
        for name, value in TRUE.items():
            held += robust[name].low <= value <= robust[name].high
            sigma = np.log(clean[name].high / clean[name].low) / (2 * 1.96)
            assert abs(np.log(robust[name].value / clean[name].value)) < 0.9 * sigma + 5e-4
    assert held >= 18


@pytest.mark.parametrize(
    "terms",
    [TERMS, (BandLimited(1.0, 5.0),), (White(1.0), Line(30.0, 10.0, 0.5)), (RandomWalk(30.0),)],
    ids=["usual", "filtered", "vibrating", "walking"],
)
def test_clean_recordings_are_left_as_they_are(terms, rng):
    """Twenty recordings of ten minutes. One in a hundred loses a sample: more than two of twenty
    have a chance of one in a thousand."""
    lost = 0
    for y in gaussian.sample(terms, rng, (20, 600 * RATE), 1 / RATE):
        settled, found = without_outliers(y[None], 1 / RATE)
        assert found is not None
        lost += found.samples > 0
        if found.samples == 0:
            np.testing.assert_array_equal(settled[0], y)
    assert lost <= 2


def test_what_counts_hide_is_left_alone(rng):
    """A count of ten standard deviations: the spread around the median is zero."""
    y = np.round(gaussian.sample((White(1.0),), rng, (1, 6000), 1 / RATE) / 100) * 100
    settled, found = without_outliers(y, 1 / RATE)
    assert found is None
    assert settled is y


def test_a_knocked_log_is_fitted_when_it_is_asked_for(cli, tmp_path, rng):
    """Refused as it is; with robust=true N is the clean log's."""
    rows = spoil("", rng)
    for name, column in rows.items():
        spread = 1e-5 if name.startswith("w") else 1e-2
        column += spread / SIGMA * spoilt(np.zeros(len(column)), rng, (20.0, 200.0))
    write(tmp_path / "log.csv", rows)
    options = ("log=csv", "log.path=log.csv", "log.rate_hz=100", "log.latitude=48",
               "log.gyro_unit=rad/s", "processes=1")  # fmt: skip
    plain = cli("lbgc.fit", *options)
    assert (plain.code, "outliers" in plain.err) == (2, True), plain.err
    done = cli("lbgc.fit", *options, "robust=true")
    assert done.code == 0, done.err
    assert done.out.count("were taken for spikes or knocks") == 6
    found = json.loads((tmp_path / done.last_line / "fit.json").read_text())
    for axis in found["gyro"]:
        n = axis["estimates"]["N"]
        assert n["value"] == pytest.approx(1e-6, rel=4.5 / np.sqrt(2 * 20_000))


def test_what_is_wild_throughout_is_no_outlier(cli, tmp_path, rng):
    """A twentieth of the samples."""
    rows = spoil("", rng)
    for name, column in rows.items():
        at = rng.choice(len(column), len(column) // 20, replace=False)
        column[at] += (1e-5 if name.startswith("w") else 1e-2) * 30 * rng.choice([-1, 1], len(at))
    write(tmp_path / "log.csv", rows)
    done = cli("lbgc.fit", "log=csv", "log.path=log.csv", "log.rate_hz=100", "log.latitude=48",
               "log.gyro_unit=rad/s", "robust=true")  # fmt: skip
    assert (done.code, "that is no exception" in done.err) == (2, True), done.err
