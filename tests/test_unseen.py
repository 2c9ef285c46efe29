"""North that cannot be seen: sigmas that say so, verdicts, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import default_config

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.estimators import circle
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


def resting(count, seconds, arw, bias=0.0, rate_hz=4.0, seed=0, latitude=LATITUDE) -> Windows:
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
    at = np.full(count, latitude)
    return Windows(rate, force, np.zeros((count, n)), rate_hz, at, psi, psi, np.zeros(count))


def nees(found, windows):
    return np.mean((wrap(found.heading - windows.heading) / found.sigma) ** 2)


@pytest.mark.parametrize("seconds", [10.0, 60.0])
@pytest.mark.parametrize("estimate", [mean, triad, gls])
def test_sigma_is_true_where_noise_drowns_earths_rate(estimate, seconds):
    """8.7 deg/sqrt(h), told of it: over 4,000 windows within 0.1 of one, six sampling errors."""
    windows = resting(4000, seconds, 8.7)
    found = estimate(windows, white_only(8.7))
    assert nees(found, windows) == pytest.approx(1.0, abs=0.1)
    assert found.sigma.max() <= circle.CHANCE
    assert not found.at_least


@pytest.mark.parametrize("seconds", [10.0, 60.0])
def test_scatter_alone_is_a_lower_bound_and_true_of_white_noise(seconds):
    windows = resting(4000, seconds, 8.7)
    found = mean(windows)
    assert found.at_least
    assert nees(found, windows) == pytest.approx(1.0, abs=0.12)  # its variance is estimated, too
    biased = resting(2000, seconds, 0.1, bias=20.0)
    assert nees(mean(biased), biased) > 2  # which is why it is called a lower bound


def test_a_users_limit_on_the_bias_is_the_prior():
    """A bias of 20 deg/h, 1 sigma, where Earth's horizontal rate is 12.6: north is not seen."""
    windows = resting(4000, 60.0, 0.1, bias=20.0)
    for estimate in (mean, triad):
        found = estimate(windows, None, bias_sigma=20.0 * DEG / HOUR)
        assert not found.at_least
        assert nees(found, windows) == pytest.approx(1.0, abs=0.1)


def test_at_high_signal_sigma_is_the_old_one():
    """Small errors: sigma is the rate's error across north over Earth's horizontal rate."""
    windows = resting(200, 60.0, 0.1)
    found = mean(windows, white_only(0.1))
    error = 0.1 * DEG / np.sqrt(HOUR) / np.sqrt(60.0)
    small = error / (EARTH_RATE * np.cos(LATITUDE))
    assert np.median(found.sigma) == pytest.approx(small, rel=0.02)


@pytest.mark.parametrize("latitude_deg", [48.1, -48.1, 33.9, -33.9])
@pytest.mark.parametrize("bias", [0.0, 500.0])
def test_oba_bias_is_left_out_at_rest_whatever_noise_is_drawn(latitude_deg, bias):
    for seed in (2, 3):
        windows = resting(1, 60.0, 0.1, bias, seed=seed, latitude=np.deg2rad(latitude_deg))
        with pytest.raises(InputError, match="tell a gyro's bias from north"):
            oba_bias(windows)
    flicker = windows.plate_angle + np.deg2rad(0.01) * (np.arange(240) % 2)
    with pytest.raises(InputError, match="tell a gyro's bias from north"):
        oba_bias(replace(windows, plate_angle=flicker))
