"""The paper's baseline against truth made with rotation matrices, and against its error formula."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lbgc.data.record import mock_record
from lbgc.data.windows import cut
from lbgc.earth import EARTH_RATE, earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.estimators.level import gyrocompass
from lbgc.estimators.static import mean
from lbgc.frames import euler_to_matrix, level, wrap

ANY_HEADING = np.deg2rad(np.arange(0.0, 360.0, 7.5))


def resting(latitude: float, roll: float, pitch: float, heading: np.ndarray):
    """omega_ib_b and f_ib_b of a resting IMU, (W, 3) each."""
    c_nb = euler_to_matrix(roll, pitch, heading)
    gravity = np.array([0.0, 0.0, -normal_gravity(latitude)])
    return earth_rate_ned(latitude) @ c_nb, gravity @ c_nb


@given(st.floats(-1.5, 1.5), st.floats(-3.0, 3.0), st.floats(-1.4, 1.4), st.floats(-np.pi, np.pi))
def test_exact_data_give_the_exact_attitude(latitude, roll, pitch, heading):
    """Both hemispheres, all quadrants, any tilt short of pitch 90 degrees."""
    omega, f = resting(latitude, roll, pitch, np.array([heading]))
    told_roll, told_pitch = level(f)
    assert abs(wrap(told_roll[0] - roll)) < 1e-9
    assert told_pitch[0] == pytest.approx(pitch, abs=1e-9)
    assert abs(wrap(gyrocompass(omega, told_roll, told_pitch)[0] - heading)) < 1e-8


@pytest.mark.parametrize("latitude_deg", [-45.0, 0.0, 32.76, 60.0])
def test_small_errors_move_the_heading_as_the_general_formula_says(latitude_deg):
    """-(dw_x sin psi + dw_y cos psi)/(Omega cos lat) + tan(lat) (df_x sin psi + df_y cos psi)/g"""
    lat = np.deg2rad(latitude_deg)
    g = normal_gravity(float(lat))
    omega, f = resting(float(lat), 0.0, 0.0, ANY_HEADING)
    s, c = np.sin(ANY_HEADING), np.cos(ANY_HEADING)
    for axis in range(3):
        dw, df = np.zeros(3), np.zeros(3)
        dw[axis], df[axis] = 1e-5 * EARTH_RATE, 1e-5 * g
        by_rate = gyrocompass(omega + dw, *level(f)) - ANY_HEADING
        by_force = gyrocompass(omega, *level(f + df)) - ANY_HEADING
        expected_rate = -(dw[0] * s + dw[1] * c) / (EARTH_RATE * np.cos(lat))
        expected_force = np.tan(lat) * (df[0] * s + df[1] * c) / g
        np.testing.assert_allclose(wrap(by_rate), expected_rate, atol=1e-9)
        np.testing.assert_allclose(wrap(by_force), expected_force, atol=1e-9)


def test_the_papers_equation_24_is_psi_zero_with_the_other_sign():
    lat, dw = np.deg2rad(32.76), 1e-5 * EARTH_RATE
    omega, f = resting(float(lat), 0.0, 0.0, np.zeros(1))
    error = gyrocompass(omega + np.array([0, dw, 0]), *level(f))[0]
    assert error == pytest.approx(-dw / EARTH_RATE / np.cos(lat), rel=1e-4)


def test_the_mean_of_a_window_is_answered_for_each_row():
    windows = cut(mock_record(), 5.0)
    np.testing.assert_allclose(mean(windows).heading, np.deg2rad(40.0), atol=1e-9)


def test_headings_are_those_of_the_encoders_zero():
    """A plate that had already turned when the window began: its angle is taken off again."""
    record = mock_record(plate_angle=np.full(250, 0.3))
    np.testing.assert_allclose(mean(cut(record, 5.0)).heading, np.deg2rad(40.0) - 0.3, atol=1e-9)


def test_a_turning_plate_is_refused():
    turning = mock_record(plate_angle=np.linspace(0, 1, 250))
    with pytest.raises(InputError, match="of plate travel within a window"):
        mean(cut(turning, 5.0))
