"""What errors amount to, how surely, and how long a window it takes."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from lbgc.metrics import (
    RESAMPLES,
    is_untrue,
    rmse_interval,
    rmse_ratio,
    summarise,
    time_to_reach,
    times_to_reach,
)


def test_an_interval_is_as_wide_as_theory_says(rng):
    """Of n normal errors the mean square has a relative standard deviation of sqrt(2/n), the RMSE
    half of that. The bootstrap's own spread comes from the sample's kurtosis, sqrt(24/n) of 3, and
    from taking percentiles of 400 resamples: about 6% of the half-width each."""
    n = 3000
    errors = np.deg2rad(2.0) * rng.standard_normal(n)
    low, high = summarise(errors, np.zeros(n), recording=np.arange(n)).intervals["rmse_deg"]
    assert (high - low) / 2 == pytest.approx(1.96 * 2.0 / np.sqrt(2 * n), rel=0.25)


def test_intervals_hold_the_truth_as_often_as_they_say(rng):
    """95% intervals of 200 samples of 200: the count that hold is binomial, sd 1.5%, and a
    percentile bootstrap of 200 normal errors is short by about 1%: 4 sd below and 2.5 above."""
    n, trials = 200, 200
    held = 0
    for _ in range(trials):
        errors = np.deg2rad(rng.standard_normal(n))
        said = summarise(errors, np.zeros(n), recording=np.arange(n))
        low, high = said.intervals["rmse_deg"]
        held += low <= 1.0 <= high
    assert 0.95 - 0.01 - 4 * 0.0154 < held / trials <= 0.95 + 2.5 * 0.0154


def test_windows_of_one_recording_are_no_more_than_one(rng):
    """Where a recording's windows all have its error, ten windows each narrow nothing."""
    own = np.deg2rad(rng.standard_normal(300))
    once = summarise(own, np.zeros(300), recording=np.arange(300))
    ten = summarise(np.repeat(own, 10), np.zeros(3000), recording=np.repeat(np.arange(300), 10))
    assert ten.windows == 3000
    for name in ("rmse_deg", "median_deg", "iqr_deg", "p95_deg", "rmse_cos_latitude_deg"):
        narrow, wide = np.diff(ten.intervals[name])[0], np.diff(once.intervals[name])[0]
        assert narrow == pytest.approx(wide, rel=0.15), name


def test_one_recordings_windows_are_resampled_instead(rng):
    errors = np.sort(np.deg2rad(rng.exponential(size=50)))
    one = summarise(errors, np.zeros(50), recording=np.zeros(50))
    assert one.intervals == summarise(errors, np.zeros(50), recording=np.arange(50)).intervals
    assert summarise(errors[:1], np.zeros(1), recording=np.zeros(1)).intervals is None


def test_every_figure_lies_about_its_interval(rng):
    """Unequal windows a recording too; and drawing them in parts changes nothing that matters."""
    own = rng.integers(0, 60, 700)
    errors = np.deg2rad(rng.standard_normal(700) + 0.5 * rng.standard_normal(60)[own])
    said = summarise(errors, np.full(700, 0.5), np.full(700, np.deg2rad(1.1)), own)
    assert set(said.intervals) == {
        *("rmse_deg", "median_deg", "iqr_deg", "p95_deg", "rmse_cos_latitude_deg"),
        "mean_normalised_squared_error",
    }
    for name, (low, high) in said.intervals.items():
        assert low < getattr(said, name) < high, name


def test_resamples_in_parts_are_as_good(rng, monkeypatch):
    own = np.repeat(np.arange(400), 5)
    errors = np.deg2rad(rng.standard_normal(2000))
    whole = summarise(errors, np.zeros(2000), recording=own).intervals
    monkeypatch.setattr("lbgc.metrics._WEIGHTS", 2000 * RESAMPLES / 7)
    parts = summarise(errors, np.zeros(2000), recording=own).intervals
    assert whole == parts


def test_a_true_sigma_has_a_normalised_squared_error_of_one(rng):
    """Of n normal errors the mean of (e/sigma)^2 has a standard deviation of sqrt(2/n): 4 of it."""
    n = 20_000
    sigma = np.deg2rad(rng.uniform(0.1, 5.0, n))
    errors = sigma * rng.standard_normal(n)
    said = summarise(errors, np.zeros(n), sigma).mean_normalised_squared_error
    assert said == pytest.approx(1.0, abs=4 * np.sqrt(2 / n))
    halved = summarise(errors, np.zeros(n), sigma / 2).mean_normalised_squared_error
    assert halved == pytest.approx(4 * said)


def judged(errors, sigma, recording) -> bool:
    return is_untrue(summarise(errors, np.zeros(len(errors)), sigma, recording))


def test_a_true_sigma_is_seldom_called_untrue_and_a_wrong_one_is(rng):
    """Eight recordings: a mean square outside 0.9 to 1.1 is what chance does to most; fewer than 5
    in 100 are called untrue, by at most 3 sd of 400. Half the sigma is seen at 200 recordings."""
    errors = rng.standard_normal((400, 8))
    called = [judged(own, np.ones(8), np.arange(8)) for own in errors]
    assert np.mean(called) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 400)
    many = rng.standard_normal(200)
    assert not judged(many, np.ones(200), np.arange(200))
    assert judged(many, np.full(200, 0.5), np.arange(200))
    assert judged(many, np.full(200, 2.0), np.arange(200))


def test_windows_that_share_a_recording_count_once():
    """One bias in forty windows is one error, whatever its square."""
    errors = np.full(40, 1.5)
    own = np.repeat(np.arange(2), 20)
    assert summarise(errors, np.zeros(40), np.ones(40), own).independent == 2
    assert not judged(errors, np.ones(40), own)
    assert judged(errors, np.ones(40), np.arange(40))


@pytest.mark.parametrize("none", [np.nan, 0.0, np.inf])
def test_a_sigma_that_is_none_is_not_judged(none):
    said = summarise(np.ones(3), np.zeros(3), np.array([1.0, none, 1.0]), np.arange(3))
    assert said.mean_normalised_squared_error is None
    json.dumps(asdict(said), allow_nan=False)


def test_the_time_to_an_error_is_interpolated_in_logarithms():
    windows = [10.0, 40.0, 160.0]
    rmse = [10.0 / np.sqrt(w) for w in windows]
    assert time_to_reach(windows, rmse, 5.0) == "<= 10 s"
    for seconds in (20.0, 40.0, 100.0):
        assert time_to_reach(windows, rmse, 10.0 / np.sqrt(seconds)) == f"{seconds:g} s"
    assert time_to_reach(windows, rmse, 0.1) == "not within 160 s"


def test_an_error_that_comes_back_is_not_reached_before():
    assert time_to_reach([10, 20, 40, 80], [2.0, 0.5, 2.0, 0.5], 1.0) == "56.6 s"
    assert time_to_reach([10, 20], [0.5, 2.0], 1.0) == "not within 20 s"


def seconds(said: str) -> float:
    return float(said.removesuffix(" s"))


def test_a_time_has_an_interval_as_wide_as_theory_says(rng):
    """RMSE 10/sqrt(T) of n independent errors at each length: a time goes with its square, so that
    between two lengths it errs by 2/sqrt(2 n) of each, halved as the two average: sqrt(1/n). The
    bootstrap's own spread is some 10% of that."""
    n = 2000
    errors = {w: np.deg2rad(10 / np.sqrt(w)) * rng.standard_normal(n) for w in (10.0, 40.0, 160.0)}
    own = {w: (e, np.arange(n)) for w, e in errors.items()}
    said = times_to_reach(own, [5.0, 10 / np.sqrt(20.0), 0.1])
    assert said[0.1].value == said[0.1].low == said[0.1].high == "not within 160 s"
    assert said[5.0].low == said[5.0].high == "<= 10 s"
    middle = said[10 / np.sqrt(20.0)]
    rmse = [np.rad2deg(np.sqrt(np.mean(e**2))) for e in errors.values()]
    assert middle.value == time_to_reach(list(errors), rmse, 10 / np.sqrt(20.0))
    low, value, high = (seconds(s) for s in (middle.low, middle.value, middle.high))
    assert low < value < high
    assert (high - low) / 2 == pytest.approx(1.96 * 20.0 / np.sqrt(n), rel=0.3)


def test_an_interval_may_have_no_end_and_draws_the_same_recordings_at_every_length(rng):
    """Each recording has one error, halved at the longer length: where the RMSE is met at the
    short one for half of the draws, an interval over independent draws would be wider."""
    own = np.deg2rad(rng.standard_normal(300))
    number = np.arange(300)
    rmse = np.rad2deg(np.sqrt(np.mean(own**2)))
    said = times_to_reach({10.0: (own, number), 20.0: (own / 2, number)}, [0.5 * rmse, 0.75 * rmse])
    assert said[0.5 * rmse].high == "not within 20 s"
    assert said[0.5 * rmse].low not in ("not within 20 s", "<= 10 s")
    low, high = (seconds(s) for s in (said[0.75 * rmse].low, said[0.75 * rmse].high))
    # log T is linear in log error, whose interval is 1.96/sqrt(600)
    assert np.log(high / low) == pytest.approx(2 * 1.96 / np.sqrt(600), rel=0.3)


def test_one_recordings_times_are_over_its_windows(rng):
    many, few = (np.deg2rad(s * rng.standard_normal(n)) for s, n in ((2.0, 40), (1.0, 20)))
    said = times_to_reach({10.0: (many, 0 * many), 20.0: (few, 0 * few)}, [1.4])[1.4]
    assert seconds(said.low) < seconds(said.value) < seconds(said.high)
    one = times_to_reach({10.0: (many[:1], np.zeros(1))}, [1.4])[1.4]
    assert one.low is None
    assert one.high is None


def test_an_rmses_own_interval_is_the_summarys(rng):
    own = np.repeat(np.arange(40), 5)
    errors = np.deg2rad(rng.standard_normal(200))
    whole = summarise(errors, np.zeros(200), recording=own).intervals["rmse_deg"]
    np.testing.assert_allclose(rmse_interval(np.rad2deg(errors), own), whole)
    assert rmse_interval(errors[:1], own[:1]) is None


def test_a_ratio_is_paired(rng):
    """b = a + noise a tenth as large: the ratio is sqrt(1.01), known far better than either RMSE.

    d(log ratio) is about half the mean of (b^2 - a^2)/a^2-rms, whose spread is that of 2 a (b - a):
    0.1/sqrt(n) for n windows.
    """
    n = 2000
    a = rng.standard_normal(n)
    b = a + 0.1 * rng.standard_normal(n)
    found = rmse_ratio(b, a, np.arange(n))
    spread = 0.1 / np.sqrt(n)
    assert found.value == pytest.approx(np.sqrt(1.01), abs=4 * spread)
    assert (found.high - found.low) / 2 == pytest.approx(1.96 * spread, rel=0.3)
    assert rmse_ratio(a, a, np.arange(n)) == rmse_ratio(b, b, np.arange(n))
