import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lbgc.earth import EARTH_RATE, earth_rate_ned, heading_exists, normal_gravity
from lbgc.frames import euler_to_matrix, matrix_to_euler, rotation_z, wrap

angles = st.floats(-50.0, 50.0)


@given(angles)
def test_wrap_is_the_same_angle_in_the_half_open_circle(angle):
    wrapped = float(wrap(angle))
    assert -np.pi < wrapped <= np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-12)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-12)


def test_wrap_keeps_half_a_turn_positive():
    np.testing.assert_array_equal(wrap(np.array([np.pi, -np.pi, 0.0])), [np.pi, np.pi, 0.0])


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_euler_angles_survive_the_round_trip(roll, pitch, yaw):
    matrix = euler_to_matrix(roll, pitch, yaw)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    np.testing.assert_allclose(matrix_to_euler(matrix), [roll, pitch, yaw], atol=1e-9)


def test_rotations_broadcast_and_heading_is_clockwise():
    matrices = rotation_z(np.deg2rad([0.0, 90.0]))
    assert matrices.shape == (2, 3, 3)
    np.testing.assert_allclose(matrices[1] @ [1, 0, 0], [0, 1, 0], atol=1e-15)  # forward is east


def test_earth_rate_points_north_and_up_in_the_north():
    north = earth_rate_ned(np.deg2rad(np.array([60.0, -60.0, 90.0])))
    np.testing.assert_allclose(np.linalg.norm(north, axis=-1), EARTH_RATE)
    assert north[0, 0] > 0 > north[0, 2]
    assert north[1, 0] > 0
    assert north[1, 2] > 0
    np.testing.assert_allclose(north[2], [0, 0, -EARTH_RATE], atol=1e-20)


@pytest.mark.parametrize(
    ("latitude_deg", "gravity"), [(0, 9.7803253359), (45, 9.8061977694), (90, 9.8321849379)]
)
def test_normal_gravity_is_wgs84s(latitude_deg, gravity):
    """Published values of NIMA TR8350.2 and Moritz 1980 for the WGS-84 ellipsoid."""
    assert normal_gravity(np.deg2rad(latitude_deg)) == pytest.approx(gravity, abs=2e-8)


def test_heading_exists_everywhere_but_at_the_poles():
    latitudes = np.deg2rad([0.0, 89.99, -89.99, 90.0, -90.0])
    np.testing.assert_array_equal(heading_exists(latitudes), [1, 1, 1, 0, 0])


def test_gravity_falls_off_with_height():
    """3.086 um/s^2 a metre at the surface (the free-air gradient), 0.3% less by its curvature at
    10 km: (1 + h/R)^-2."""
    at = [normal_gravity(0.8, h) for h in (0.0, 1.0, 10_000.0)]
    assert at[0] - at[1] == pytest.approx(3.086e-6, rel=2e-3)
    assert at[2] / at[0] == pytest.approx((1 + 1.0e4 / 6.37e6) ** -2, rel=2e-5)
