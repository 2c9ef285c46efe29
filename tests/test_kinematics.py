"""From poses to what is felt: exact where it says so."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lbgc.frames import rotation_matrix, rotation_vector, skew
from sim.kinematics import felt, joined, resting

angles = st.floats(-3.1, 3.1)


@given(st.tuples(angles, angles, angles).filter(lambda v: 1e-12 < np.linalg.norm(v) < 3.1))
def test_rotation_vectors_go_there_and_back(vector):
    found = rotation_vector(rotation_matrix(np.array(vector)))
    np.testing.assert_allclose(found, vector, atol=1e-9 + 1e-6 * (np.linalg.norm(vector) > 3))


@pytest.mark.parametrize("size", [1e-15, 1e-9, 1e-6, 1e-4, 1e-2, 1.0])
def test_small_rotations_keep_their_digits(size):
    vector = size * np.array([0.6, -0.64, 0.48])
    found = rotation_vector(rotation_matrix(vector))
    np.testing.assert_allclose(found, vector, rtol=1e-12, atol=2e-16)


def test_the_skew_matrix_is_the_cross_product(rng):
    a, b = rng.standard_normal((2, 7, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", skew(a), b), np.cross(a, b))


def test_a_steady_turn_is_exact_and_its_centripetal_force_to_the_square_of_a_step():
    """2 rad/s about a tilted axis, 0.3 m out, 1/1200 s: w^2 r to (w h)^2."""
    axis, w, h = np.array([0.48, 0.6, 0.64]), 2.0, 1 / 1200
    t = (np.arange(243) - 1) * h
    attitude = rotation_matrix(w * t[:, None] * axis)
    arm = np.array([0.3, 0.0, 0.0])
    found = felt(attitude, attitude @ arm, h, 2)
    np.testing.assert_allclose(found.rate, np.tile(w * axis, (120, 1)), rtol=1e-11)
    centripetal = w**2 * np.cross(axis, np.cross(axis, arm))
    np.testing.assert_allclose(
        found.acceleration, np.tile(centripetal, (120, 1)), rtol=(w * h) ** 2
    )
    earth = np.array([5e-5, 1e-5, -4e-5])
    body_velocity = w * np.cross(axis, arm)
    middle = rotation_matrix(w * (t[1:-2] + h / 2)[:, None] * axis)
    expected = 2 * np.cross(np.einsum("nij,i->nj", middle, earth), body_velocity)
    np.testing.assert_allclose(
        found.coriolis @ earth,
        expected.reshape(120, 2, 3).mean(axis=1),
        rtol=(w * h) ** 2,
        atol=1e-11,
    )


def test_what_is_carried_adds_its_own_increments():
    """A velocity beside: its change over a sample is felt whole, however fast it swings."""
    h, steps = 1 / 1200, 2
    t = (np.arange(1203) - 1) * h
    still = np.tile(np.eye(3), (len(t), 1, 1))
    carried = np.stack([np.sin(300 * t), 0 * t, np.cos(200 * t)], axis=1)
    found = felt(still, np.zeros((len(t), 3)), h, steps, carried)
    np.testing.assert_allclose(
        found.acceleration, np.diff(carried[1:-1:steps], axis=0) / (h * steps), atol=1e-9
    )
    assert not found.rate.any()


def test_stretches_join_and_rests_repeat():
    one = resting(rotation_matrix(np.array([0.1, 0.2, 0.3])))
    both = joined([one.repeated(3), one])
    assert both.rate.shape == (4, 3)
    np.testing.assert_array_equal(
        both.force(np.zeros(3), np.array([0, 0, 9.8])).T[0],
        both.force(np.zeros(3), np.array([0, 0, 9.8])).T[3],
    )
