"""Alignment in the inertial frame: on swaying bases made with rotation matrices, and on a real
vehicle's."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import composed, labelled, needs_recording, with_noise
from scipy.signal import lfilter
from simulated import swaying
from test_indexed import IDEAL

from lbgc.data import logs
from lbgc.data.windows import cut
from lbgc.errors import InputError
from lbgc.estimators.inertial import oba, oba_bias, oba_interval, oba_textbook
from lbgc.evaluate import EvaluateConfig
from lbgc.frames import rotation_z, wrap
from lbgc.sensor.noise import Flicker, RandomWalk, White


def still(count, n):
    return np.zeros((count, n + 1, 3))


@pytest.mark.parametrize("estimate", [oba, oba_textbook, oba_interval])
@pytest.mark.parametrize("latitude", [-50.0, 0.0, 65.0])
@pytest.mark.parametrize("turn_deg_s", [0.0, 12.0])
def test_without_sway_the_heading_is_exact(estimate, latitude, turn_deg_s):
    """At 30 degrees of lean, in both hemispheres; on a plate that turns, level."""
    tilt = (0.0, 0.0) if turn_deg_s else (30.0, -20.0)
    w = swaying(8, 20.0, 50.0, latitude, tilt, still(8, 1000), turn=np.deg2rad(turn_deg_s))
    # the force's mean over half a sample's turn is known to its square: 0.12 degrees at 12 deg/s
    off = wrap(estimate(w.windows).heading - w.heading)
    np.testing.assert_allclose(off, 0.0, atol=np.deg2rad(0.15 if turn_deg_s else 1e-3))


# frequency in Hz and damping of the resonator
SWAYS = {"white": None, "one hertz": (1.2, 0.15), "narrow": (1.5, 0.03)}


def sway_of(kind, count, n, rate_hz, seed):
    """Velocity, (count, n + 1, 3): white, or white through a resonator."""
    lead = 500
    velocity = 1e-3 * np.random.default_rng(seed).standard_normal((count, n + lead + 1, 3))
    if SWAYS[kind] is not None:
        w0 = 2 * np.pi * SWAYS[kind][0] / rate_hz
        r = np.exp(-SWAYS[kind][1] * w0)
        velocity = lfilter([1], [1, -2 * r * np.cos(w0), r * r], velocity, axis=1)
    return velocity[:, lead:]


@pytest.mark.parametrize("estimate", [oba, oba_interval])
@pytest.mark.parametrize("sway", SWAYS)
def test_a_stated_sigma_is_true(estimate, sway):
    """Mean squared error over variance, 1,500 windows of 10 s: within the 10% asked for and four
    sampling errors, sqrt(2/1500) each with some more for heavy tails (5%)."""
    w = swaying(1500, 10.0, 20.0, 34.0, (2.0, -3.0), sway_of(sway, 1500, 200, 20.0, seed=3))
    found = estimate(w.windows)
    nse = np.mean((wrap(found.heading - w.heading) / found.sigma) ** 2)
    assert 0.9 - 0.2 < nse < 1.1 + 0.2


def test_from_zero_velocity_the_textbook_forms_sigma_is_true():
    velocity = sway_of("white", 1500, 200, 20.0, seed=5)
    velocity[:, 0] = 0.0
    w = swaying(1500, 10.0, 20.0, 34.0, (2.0, -3.0), velocity)
    found = oba_textbook(w.windows)
    nse = np.mean((wrap(found.heading - w.heading) / found.sigma) ** 2)
    assert 0.9 - 0.2 < nse < 1.1 + 0.2


@pytest.mark.parametrize("of", ["gyro", "accel"])
def test_a_sensors_own_errors_are_in_the_sigma(of):
    """Every in-run term and the run's bias, of one triad at a time, far above the sway: its
    residuals show next to nothing of it. 200 windows, the 10% asked for and four sampling errors;
    and what residuals show of an accelerometer's noise counts twice, up to a quarter."""
    count, n, rate = 200, 300, 10.0
    scale = 1.0 if of == "gyro" else 2.0
    law = White(scale * 1e-5), Flicker(scale * 2e-6), RandomWalk(scale * 2e-7)
    triad = getattr(IDEAL, of).with_bias(run=(scale * 5e-6,) * 3)
    triad = with_noise(triad, *law)
    imu = replace(IDEAL, dt=1 / rate, **{of: triad})
    rng = np.random.default_rng(8)
    velocity = 1e-6 * rng.standard_normal((count, n + 1, 3))
    made = swaying(count, n / rate, rate, 34.0, (30.0, -20.0), velocity)
    noise = triad.sample_noise(rng, count, n, 1 / rate)
    noise = noise + rng.standard_normal((count, 1, 3)) * triad.bias("run")
    w = replace(made.windows, **{of: getattr(made.windows, of) + noise})
    for estimate in (oba, oba_bias):
        found = estimate(w, imu)
        nse = np.mean((wrap(found.heading - made.heading) / found.sigma) ** 2)
        spread = 4 * np.sqrt(2 / count)
        assert (0.9 if of == "gyro" else 0.75) - spread < nse < 1.1 + spread, estimate


@pytest.mark.parametrize("latitude", [-50.0, 40.0])
def test_a_plate_that_turns_tells_bias_from_north(latitude):
    """5 degrees an hour on each gyro, nothing known of it: a third of Earth's rate. What is left is
    the force's mean over half a sample's turn, as without a bias."""
    made = swaying(8, 60.0, 50.0, latitude, (0.0, 0.0), still(8, 3000), turn=np.deg2rad(12.0))
    biased = made.windows.gyro + np.deg2rad([5.0, -5.0, 5.0]) / 3600
    w = replace(made.windows, gyro=biased)
    off = wrap(oba_bias(w).heading - made.heading)
    np.testing.assert_allclose(off, 0.0, atol=np.deg2rad(0.15))
    assert rmse_deg(wrap(oba(w).heading - made.heading)) > 5 * rmse_deg(off)


@pytest.mark.parametrize("turn_deg_s", [0.0, 12.0])
def test_with_a_gyro_bias_the_stated_sigma_is_true(turn_deg_s):
    """1 degree an hour of run bias under a sway: the same 10% and four sampling errors. At rest the
    bias is all of the error, 1/(15.04 cos lat), and says so; on a turning plate it is gone."""
    count, rng = 300, np.random.default_rng(6)
    velocity = 1e-3 * rng.standard_normal((count, 601, 3))
    turn, size = np.deg2rad(turn_deg_s), np.deg2rad(1.0) / 3600
    made = swaying(count, 30.0, 20.0, 34.0, (0.0, 0.0), velocity, turn=turn)
    biased = made.windows.gyro + size * rng.standard_normal((count, 1, 3))
    w = replace(made.windows, gyro=biased)
    only_bias = replace(IDEAL, gyro=IDEAL.gyro.with_bias(run=(size,) * 3))
    found = oba_bias(w, only_bias)
    errors = wrap(found.heading - made.heading)
    nse = np.mean((errors / found.sigma) ** 2)
    assert 0.9 - 4 * np.sqrt(2 / count) < nse < 1.1 + 4 * np.sqrt(2 / count)
    of_bias = np.rad2deg(1.0 / 15.04 / np.cos(np.deg2rad(34.0)))
    if turn_deg_s:
        assert rmse_deg(errors) < 0.6 * of_bias
    else:
        assert rmse_deg(errors) == pytest.approx(of_bias, rel=0.2)


def test_at_rest_a_bias_of_any_size_has_no_answer():
    w = swaying(2, 30.0, 20.0, 34.0, (2.0, 3.0), still(2, 600)).windows
    with pytest.raises(InputError, match="does not turn enough"):
        oba_bias(w)


def test_what_it_cannot_answer_it_refuses():
    w = swaying(2, 10.0, 20.0, 34.0, (0.0, 0.0), still(2, 200)).windows
    with pytest.raises(InputError, match="without accelerometers"):
        oba(replace(w, accel=0 * w.accel))
    with pytest.raises(InputError, match="no north"):
        oba(replace(w, latitude=w.latitude * 0 - np.pi / 2))
    with pytest.raises(InputError, match="fast enough to see the sway"):
        oba(swaying(2, 10.0, 2.0, 34.0, (0.0, 0.0), still(2, 20)).windows)


@pytest.fixture(scope="module")
def lasergyro():
    return next(iter(logs.read(composed(EvaluateConfig, "evaluate", "log=lasergyro").log)))


def rmse_deg(errors):
    return np.rad2deg(np.sqrt(np.mean(errors**2)))


@needs_recording("lasergyro.imu")
@pytest.mark.parametrize(("window_s", "most"), [(10.0, 1.8), (30.0, 0.2), (60.0, 0.1)])
def test_on_a_real_vehicle(lasergyro, window_s, most):
    w = labelled(lasergyro, window_s)
    free, zero = (wrap(f(w.windows).heading - w.heading_reference) for f in (oba, oba_textbook))
    assert rmse_deg(free) <= most
    assert rmse_deg(zero) > 3 * rmse_deg(free)


@needs_recording("lasergyro.imu")
def test_its_sigma_tells_good_windows_from_bad_ones(lasergyro):
    w = labelled(lasergyro, 10.0)
    found = oba(w.windows)
    errors = wrap(found.heading - w.heading_reference)[np.argsort(found.sigma)]
    half = len(errors) // 2
    assert rmse_deg(errors[:half]) <= 0.6 * rmse_deg(errors[half:])


@needs_recording("lasergyro.imu")
def test_turned_about_its_z_axis_the_answer_follows(lasergyro):
    w = cut(lasergyro, 10.0).rows(slice(0, 4))
    straight = oba(w).heading
    for angle in np.deg2rad(np.arange(10.0, 360.0, 10.0)):
        R = rotation_z(angle)
        turned = oba(replace(w, gyro=w.gyro @ R, accel=w.accel @ R)).heading
        # the mean yaw of a body that leans by a: turning about z moves it by the angle to a^2
        np.testing.assert_allclose(wrap(turned - straight - angle), 0.0, atol=2e-4)
