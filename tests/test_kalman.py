"""The error-state filter: exact where nothing errs, near the optimum on level benches, and beside
alignment in the inertial frame on a base that sways."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import composed, labelled, needs_recording
from simulated import windows
from test_indexed import IDEAL, SDC500
from test_inertial import rmse_deg, still, swaying

from lbgc.data import logs
from lbgc.errors import InputError
from lbgc.estimators import CLASSICAL
from lbgc.estimators.kalman import ekf
from lbgc.evaluate import EvaluateConfig
from lbgc.frames import wrap
from lbgc.sensor.noise import White

COUNT = 250
OPTIMUM = {"static": "gls", "two_position": "two_position_weighted",
           "carousel": "carousel_weighted"}  # fmt: skip


def nse(found, w):
    return np.mean((wrap(found.heading - w.heading) / found.sigma) ** 2)


@pytest.mark.parametrize("latitude", [-60.0, 32.76])
@pytest.mark.parametrize(
    ("protocol", "tilt"), [("static", (25.0, -15.0)), ("two_position", (8.0, -10.0)),
                           ("carousel", (3.0, -4.0))]
)  # fmt: skip
def test_without_errors_the_heading_is_exact(protocol, tilt, latitude):
    """Both hemispheres, all headings, a base that leans. What linearisation leaves is far below
    the sigma that this sensor has: a hundredth of it."""
    headings = np.deg2rad(np.arange(-170.0, 190.0, 60.0))
    w = windows(IDEAL, protocol, latitude, 120.0, len(headings), 0, tilt_deg=tilt, heading=headings)
    found = ekf(w.windows, SDC500)
    assert (np.abs(wrap(found.heading - headings)) < 0.01 * found.sigma).all()


@pytest.fixture(scope="module")
def drawn():
    return {p: windows(SDC500, p, 32.76, 240.0, COUNT, seed=8) for p in OPTIMUM}


@pytest.mark.parametrize("protocol", OPTIMUM)
def test_it_is_near_the_optimum_and_its_sigma_true(drawn, protocol):
    """Paired with the optimum, so that 3% is no sampling error; squares about 1 by four of
    sqrt(2/COUNT), within the 10% asked for."""
    w = drawn[protocol]
    found, best = ekf(w.windows, SDC500), CLASSICAL[OPTIMUM[protocol]](w.windows, SDC500)
    ratio = rmse_deg(wrap(found.heading - w.heading)) / rmse_deg(wrap(best.heading - w.heading))
    assert ratio == pytest.approx(1.0, abs=0.03)
    assert nse(found, w) == pytest.approx(1.0, abs=4 * np.sqrt(2 / COUNT))
    assert nse(found, w) == pytest.approx(nse(best, w), rel=0.1)


def test_white_noise_alone():
    known = SDC500.without("unit", "session", "run")
    none = ((), (), ())
    white = tuple(tuple(t for t in own if t.density > 0) for own in known.gyro.terms)
    quiet = replace(known.accel, terms=((White(1e-9),),) * 3, started=none)
    imu = replace(known, gyro=replace(known.gyro, terms=white, started=none), accel=quiet)
    w = windows(imu, "static", 32.76, 60.0, 1000, seed=2, interval=5.0)
    found = ekf(w.windows, imu)
    assert nse(found, w) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 1000))
    assert nse(found, w) == pytest.approx(nse(CLASSICAL["gls"](w.windows, imu), w), rel=0.02)


def test_on_a_base_that_sways_its_sigma_is_true():
    """White velocity, 250 windows: within the 10% asked for and four sampling errors."""
    velocity = 1e-3 * np.random.default_rng(4).standard_normal((250, 201, 3))
    w = swaying(250, 10.0, 20.0, 34.0, (2.0, -3.0), velocity)
    imu = replace(SDC500, gyro=IDEAL.gyro, accel=IDEAL.accel)
    found = ekf(w.windows, imu)
    assert 0.9 - 4 * np.sqrt(2 / 250) < nse(found, w) < 1.1 + 4 * np.sqrt(2 / 250)
    ratio = rmse_deg(wrap(found.heading - w.heading))
    ratio /= rmse_deg(wrap(CLASSICAL["oba"](w.windows).heading - w.heading))
    assert ratio == pytest.approx(1.0, abs=0.05)


def test_a_row_is_answered_from_itself_alone(drawn):
    """Also beside one whose base moves."""
    w = drawn["two_position"].windows.rows(slice(0, 3))
    w = replace(w, rate_hz=10.0)
    rocking = np.zeros((3, 1, 1))
    rocking[2] = 0.05
    w = replace(w, accel=w.accel + rocking * np.sin(np.arange(240.0))[:, None])
    together = ekf(w, SDC500)
    for row in range(3):
        alone = ekf(w.rows(slice(row, row + 1)), SDC500)
        np.testing.assert_allclose(alone.heading[0], together.heading[row], atol=1e-7)
        np.testing.assert_allclose(alone.sigma[0], together.sigma[row], rtol=1e-6)


def test_what_it_cannot_answer_it_refuses(drawn):
    w = drawn["static"].windows.rows(slice(0, 2))
    with pytest.raises(InputError, match="noise model"):
        ekf(w, None)
    with pytest.raises(InputError, match="without accelerometers"):
        ekf(replace(w, accel=0 * w.accel), SDC500)
    with pytest.raises(InputError, match="no north"):
        ekf(replace(w, latitude=0 * w.latitude - np.pi / 2), SDC500)
    with pytest.raises(InputError, match="samples a window"):
        ekf(windows(IDEAL, "static", 40.0, 5.0, 2, 0).windows, SDC500)
    rocking = 0.5 * np.sin(np.arange(w.accel.shape[1]))[None, :, None]
    with pytest.raises(InputError, match="the base moves"):
        ekf(replace(w, accel=w.accel + rocking), SDC500)
    slewing = swaying(1, 10.0, 20.0, 34.0, (0.0, 0.0), still(1, 200)).windows
    slewing = replace(slewing, plate_angle=np.linspace(0.0, 1.0, 200)[None] ** 2 * 3)
    with pytest.raises(InputError, match="never rests or turns steadily"):
        ekf(slewing, SDC500)


@needs_recording("lasergyro.imu")
@pytest.mark.parametrize(("window_s", "most"), [(10.0, 1.8), (30.0, 0.2), (60.0, 0.1)])
def test_on_a_real_vehicle(window_s, most):
    config = composed(EvaluateConfig, "evaluate", "log=lasergyro", "imu=lasergyro")
    record = next(iter(logs.read(config.log)))
    w = labelled(record, window_s)
    found = ekf(w.windows, config.imu.model(record.rate_hz))
    assert rmse_deg(wrap(found.heading - w.heading_reference)) <= most
