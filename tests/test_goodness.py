"""The fit finds what is there, no more, and says where its model does not explain the log."""

from functools import partial

import numpy as np
import pytest
import scipy.stats
from test_fit import RATE, series

from lbgc.data.static import PARTS, Static, require_steady
from lbgc.errors import InputError
from lbgc.report.fitted import report
from lbgc.report.remarks import remarks
from lbgc.sensor.fitting import noise_fit, shapes
from lbgc.sensor.fitting.ordinates import ordinates, pooled
from lbgc.sensor.fitting.search import _Search, search
from lbgc.sensor.fitting.tones import sift
from lbgc.sensor.fitting.trial import try_out
from lbgc.sensor.noise import AngleQuantisation, BandLimited, Flicker, Line, White


def most(count: int, chance: float) -> int:
    """What is exceeded in one of ten thousand samples of so many."""
    return int(scipy.stats.binom.isf(1e-4, count, chance))


def judged(y: np.ndarray, terms=None, start=None) -> noise_fit.Fit:
    data = ordinates(y, 1 / RATE)
    fit = noise_fit.fit(data, terms, start) if terms else noise_fit.choose(data)
    return noise_fit.judged(y[None], data, fit)


def test_a_right_model_is_called_wrong_as_often_as_stated(rng):
    terms = (White(1.0), Flicker(0.5))
    fits = [judged(y, shapes.core()) for y in series(terms, rng, 60, 50)]
    assert sum(f.goodness.fails for f in fits) <= most(50, 0.05)
    assert np.mean([f.goodness.p for f in fits]) > 0.5 - 4 / np.sqrt(12 * 50)


def test_a_band_that_the_model_lacks_is_named_and_widens_the_intervals(rng):
    y = series((White(1.0), Line(2.5, 20.0, 2.0)), rng, 120)[0]
    fit = judged(y, shapes.core())
    assert fit.goodness.fails
    assert fit.goodness.worst.low_hz < 21
    assert fit.goodness.worst.high_hz > 19
    assert fit.goodness.worst.ratio > 1
    assert "is not explained" in fit.goodness.says
    plain = noise_fit.fit(ordinates(y, 1 / RATE), shapes.core()).estimates["N"]
    wide = fit.estimates["N"]
    assert wide.high - wide.low > 2 * (plain.high - plain.low)
    right = judged(y, [*shapes.core(), shapes.line(1)], {"line_f0": 20.0, "line_width": 2.0})
    assert not right.goodness.fails


def test_noise_that_grows_is_not_steady(rng):
    """By a quarter in the last eighth of five minutes: 20 sigma of what chance does."""
    y = series((White(1.0),), rng, 300)[0].astype(float)
    y[-len(y) // 8 :] *= 1.25
    goodness = judged(y, shapes.core()).goodness
    assert goodness.p_time < 1e-6
    assert goodness.fails
    assert "is not steady" in goodness.says
    assert goodness.widening[0] > 3


def test_three_close_lines_are_reached(rng):
    """The search ends as well as a fit that starts from the truth, and N is right."""
    truth = ((2.0, 19.0, 0.5), (2.0, 20.0, 0.4), (1.5, 21.2, 0.8))
    y = series((BandLimited(1.0, 60.0), *(Line(*one) for one in truth)), rng, 900)[0]
    data = ordinates(y, 1 / RATE)
    start = {"bandwidth": 60.0, "damping": 0.7}
    terms = [shapes.FILTERED_WHITE, *shapes.core()[1:]]
    for k, one in enumerate(truth):
        terms.append(shapes.line(k + 1))
        start |= dict(zip(terms[-1].names, one, strict=True))
    by_hand = noise_fit.fit(data, terms, start)
    found = noise_fit.choose(data)
    assert found.bic < by_hand.bic + 10
    still = np.zeros((1, 10, 3))
    table = report(
        Static("log", still, still, 0.01, 0.5, None, None), dict.fromkeys(PARTS, [found] * 3)
    )
    assert "lines overlap: together" in table
    n = found.estimates["N"]
    assert abs(n.value - 1) < 4.5 * (n.high - n.low) / (2 * 1.96)


@pytest.mark.parametrize(
    ("bandwidth", "truth"),
    [
        (
            19.0,
            ((4.2, 1.74, 0.3, 1), (3.2, 5.1, 0.16, 2), (1.8, 11.9, 0.12, 2), (1.9, 16.0, 0.72, 1)),
        ),
        (50.0, ((4.1, 7.7, 1.06, 1), (4.1, 12.2, 1.3, 1), (1.8, 21.1, 0.5, 2))),
        (24.0, ((6.9, 1.22, 0.02, 2), (6.4, 7.0, 0.66, 2))),
    ],
)
def test_the_search_ends_as_well_as_a_fit_from_the_truth(rng, bandwidth, truth):
    """Wide low lines that a wider one could stand for, and a filter that such lines imitate: each
    left an earlier search hundreds to thousands of units short, with N up to 15% wrong."""
    y = series(
        (BandLimited(1.0, bandwidth), Flicker(0.2), *(Line(*one) for one in truth)), rng, 900
    )
    data = ordinates(y[0], 1 / RATE)
    terms = [shapes.FILTERED_WHITE, *shapes.core()[1:]]
    start = {"bandwidth": bandwidth, "damping": 0.7}
    for k, (*values, poles) in enumerate(truth):
        terms.append(shapes.line(k + 1, poles))
        start |= dict(zip(terms[-1].names, values, strict=True))
    assert search(data, (1.0, 3600.0)).cost < try_out(data, terms, start).cost + 10


def test_a_search_that_is_cut_short_says_so(rng, monkeypatch):
    y = series((White(1.0), Line(2.0, 20.0, 0.5)), rng, 120)[0]
    whole = noise_fit.choose(ordinates(y, 1 / RATE))
    monkeypatch.setattr("lbgc.sensor.fitting.search._Search", partial(_Search, left=3))
    short = noise_fit.choose(ordinates(y, 1 / RATE))
    assert [f.is_cut_short for f in (whole, short)] == [False, True]
    assert not any("cut short" in said for said in remarks(whole, 0))
    assert any("cut short" in said for said in remarks(short, 0))


def test_tones_are_not_found_where_none_are(rng):
    """White noise, 6,000 samples: at most one axis in a hundred has one."""
    found = 0
    for y in rng.standard_normal((400, 6000)):
        data = pooled(y[None], 1 / RATE)
        found += len(data.tones) > 0
    assert found <= most(400, 0.01)


def test_a_tone_is_told_from_a_narrow_line(rng):
    k = np.arange(257, 60_000)
    fine = rng.chisquare(1, len(k))
    fine[20_000] += 400.0
    fine[40_000:40_040] += rng.chisquare(1, 40) * 30
    sifted = sift(fine, int(k[0]), 60_000, 1 / RATE, 1)
    assert [round(t.f * 1200) for t in sifted.tones] == [20_257]
    assert len(sifted.narrow)
    assert np.all(np.abs(sifted.narrow - 40_277) < 30)


def test_a_quantisation_too_weak_to_be_named_is_allowed_for(rng):
    """Sixteen per cent of the power at the highest frequency: in some logs the term is found, in
    others it is not; N's interval holds in both."""
    held = 0
    for y in series((White(1.0), AngleQuantisation(0.02)), rng, 60, 20):
        n = noise_fit.choose(ordinates(y, 1 / RATE)).estimates["N"]
        held += n.low < 1.0 < n.high
    assert held >= 20 - most(20, 0.05)


def test_few_differences_are_no_unsteadiness(rng):
    """A narrow line's power wanders by itself: 60 s of it are some ten independent numbers."""
    for y in series((Line(5.0, 20.0, 0.1), White(0.01)), rng, 60, 20):
        log = np.stack([y] * 3, axis=-1)[None]
        require_steady(Static("log", log, log, 1 / RATE, 0.5, None, None))
    loud = np.concatenate([log[:, :3000], 4 * rng.standard_normal((1, 3000, 3)) + log[:, 3000:]], 1)
    with pytest.raises(InputError, match="times as much gyro noise"):
        require_steady(Static("log", loud, log, 1 / RATE, 0.5, None, None))


def test_a_filter_faster_than_the_samples_is_allowed_for(rng):
    """At 262 Hz it takes a tenth of what is seen at 50: in half an hour it is found, in a minute
    not, and N's interval holds in both."""
    held = 0
    for seconds, count in ((60, 20), (1800, 2)):
        for y in series((BandLimited(1.0, 262.0),), rng, seconds, count):
            e = noise_fit.choose(ordinates(y, 1 / RATE)).estimates
            held += e["N"].low < 1.0 < e["N"].high
            if seconds == 1800:
                assert e["bandwidth"].low < 262.0 < e["bandwidth"].high
    assert held >= 22 - most(22, 0.05)
