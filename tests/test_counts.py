"""Counts are found, their rounding is taken out, and what they hide is not told."""

import numpy as np
import pytest
import yaml

from lbgc.data.static import PARTS, Static
from lbgc.report.fitted import spelled
from lbgc.report.fitted_yaml import sensor_yaml
from lbgc.report.remarks import remarks
from lbgc.sensor import gaussian
from lbgc.sensor.deterministic import Sinusoid
from lbgc.sensor.fitting import counts, noise_fit, resting_axis
from lbgc.sensor.fitting.ordinates import pooled
from lbgc.sensor.noise import Flicker, White

N, DT, LSB = 30_000, 0.01, 0.0033


def rounded(sigma, rng, extra=0.0, n=N):
    """Counts of white noise of so many counts about a mean that stands anywhere, unit."""
    return np.round(rng.uniform(-0.5, 0.5) + sigma * rng.standard_normal(n) + extra) * LSB


@pytest.mark.parametrize("fmt", ["%.9g", "%.4f", "float32"])
@pytest.mark.parametrize("sigma", [0.3, 2.0, 30.0])
def test_a_count_is_found_as_printed(fmt, sigma, rng):
    series = rounded(sigma, rng) + 9.8
    if fmt == "float32":
        series = series.astype(np.float32).astype(float)
    else:
        series = np.array([float(fmt % v) for v in series])
    assert counts.count_size(series) == pytest.approx(LSB, rel=0.02 if sigma < 1 else 0.003)


def test_what_has_no_count_has_none(rng):
    for n in (300, N):
        assert counts.count_size(rng.standard_normal(n)) is None
        assert counts.count_size(rng.standard_normal(n).astype(np.float32)) is None
    assert counts.count_size(np.ones(100)) is None


@pytest.mark.parametrize("sigma", [0.2, 0.3, 0.45, 0.6])
def test_noise_below_a_count_is_told_by_how_often_each_count_comes(sigma, rng):
    """The intervals of 24 recordings hold it: 95% each, 18 or more of 24 in all but 1e-4; and the
    estimate is right to 4.5 sampling errors of its mean over those that have one."""
    found = [counts.judged(rounded(sigma, rng)) for _ in range(24)]
    assert {c.kind for c in found} == {"coarse"}
    assert sum(c.low <= sigma <= (c.high if c.low > 0 else c.upper) for c in found) >= 18
    told = np.array([c.sigma for c in found if c.low > 0])
    error = np.median([(c.high - c.low) / 3.92 for c in found if c.low > 0])
    assert abs(told.mean() - sigma) < 4.5 * error / np.sqrt(len(told)) + 0.01 * sigma


def test_counts_that_hide_the_noise_give_a_limit(rng):
    """In the middle of a count; 0.5/0.12 is 4.2 sigma: one sample in 30,000 leaves it."""
    hidden = np.round(0.12 * rng.standard_normal(N) + 0.1)
    hidden[0] = 1.0
    seen = counts.judged(hidden * LSB)
    assert seen.low == 0.0
    assert 0.12 < seen.upper < 0.3
    assert seen.blur == 2.0


def test_a_tone_shakes_counts_too_and_is_no_noise(rng):
    wave = Sinusoid(1.0, 8.01).at(np.array(0.3), N, DT)
    seen = counts.judged(rounded(0.3, rng, wave))
    assert seen.kind == "coarse"
    assert seen.low < 0.3 < seen.high
    assert seen.blur < 0.5 * counts.judged(rounded(0.3, rng)).blur


def test_noise_with_a_memory_is_not_told_from_coarse_counts(rng):
    """Neighbours' correlation 0.6."""
    own = np.zeros(N)
    drawn = rng.standard_normal(N)
    for k in range(1, N):
        own[k] = 0.6 * own[k - 1] + 0.8 * drawn[k]
    series = np.round(0.3 * own + 0.2) * LSB
    assert counts.judged(series).kind == "memory"
    fit = resting_axis.fitted(series[None], DT, (1.0, 3600.0))
    assert fit.estimates["N"].is_withheld
    assert spelled(fit.estimates["N"], "arw_deg_per_sqrt_h") == "cannot be told from this log"
    assert any("not white or changes them too rarely" in said for said in remarks(fit, 0))


def test_carried_counts_that_noise_does_not_shake_tell_no_noise(rng):
    """Pulses of an accurate ring laser: 0.02 counts of noise a sample, and rates that beat fast,
    slowly and hardly ever; each sample rounded by itself is another thing."""
    for rate in (0.37, 0.0412, 0.003):
        angle = np.cumsum(rate + 0.02 * rng.standard_normal(N))
        series = np.diff(np.round(angle)) * LSB
        assert counts.judged(series).kind == "beating"
    fit = resting_axis.fitted(series[None], DT, (1.0, 3600.0))
    assert fit.goodness is None
    assert all(e.is_withheld for name, e in fit.estimates.items() if name != "Q")
    assert fit.estimates["Q"].value == pytest.approx(LSB * DT / np.sqrt(12))
    assert fit.tones == ()
    assert not any(fit.short_corners.values())  # no vote for the other axes' corner
    assert any("beat with the mean rate" in said for said in remarks(fit, 0))
    still = np.zeros((1, 100, 3))
    static = Static("log", still, still, DT, 0.5, None, None)
    imu = yaml.safe_load(sensor_yaml("mine", [static], dict.fromkeys(PARTS, [fit] * 3)))
    size = np.rad2deg(LSB * DT / np.sqrt(12)) * 3600
    assert imu["gyro"]["quantisation_arcsec"] == pytest.approx([size] * 3, rel=1e-5)
    assert "rate_lsb_deg_per_s" not in imu["gyro"]  # its rounding is the quantisation
    assert counts.judged(rounded(0.3, rng)).kind == "coarse"
    two_minutes_at_1_hz = np.diff(np.round(np.cumsum(0.37 + 0.02 * rng.standard_normal(121)))) * LSB
    assert counts.judged(two_minutes_at_1_hz).hides_noise


@pytest.mark.parametrize("sigma", [0.3, 0.5, 1.0])
def test_carried_counts_are_known_from_rounded_samples(sigma, rng):
    angle = np.cumsum(rng.uniform(-3, 3) + sigma * rng.standard_normal(N))
    assert counts.judged(np.diff(np.round(angle)) * LSB).kind == "carried"
    assert counts.judged(rounded(sigma, rng)).kind != "carried"


@pytest.mark.parametrize("sigma", [0.3, 0.55, 0.8, 3.0])
def test_white_noise_is_fitted_through_counts(sigma, rng):
    """N = 1 within its own interval, widened to 4.5 sigma, whatever the count."""
    white = sigma * LSB * np.sqrt(DT)
    fit = resting_axis.fitted(rounded(sigma, rng)[None], DT, (1.0, 3600.0))
    e = fit.estimates["N"]
    assert abs(np.log(e.value / white)) < 4.5 * np.log(e.high / e.low) / 3.92
    assert np.log(e.high / e.low) / 3.92 < 0.03
    assert fit.counts.lsb == pytest.approx(LSB, rel=1e-9)


def test_what_is_slow_has_limits_as_wide_as_counts_may_bend_it(rng):
    """At 0.3 counts, by 1 + 2 exp(-2 pi^2 0.09) = 1.34."""
    slow = gaussian.sample((White(0.3 * 0.1), Flicker(0.03)), rng, (1, N), DT)[0]
    series = np.round(slow + 0.2) * LSB
    seen = counts.judged(series)
    assert seen.kind in ("coarse", "memory")
    assert seen.blur == pytest.approx(0.34, abs=0.05)  # 1 sigma of sigma, 1%, makes 0.012 of it
    fit = resting_axis.fitted(series[None], DT, (1.0, 3600.0))
    plain = noise_fit.choose(pooled(series[None], DT))
    for name in ("B", "K"):
        seen_through, bare = (f.estimates[name].high for f in (fit, plain))
        assert seen_through == pytest.approx(bare / (1 - seen.blur), rel=0.02)
    assert any("limits are widened" in said for said in remarks(fit, 0))
