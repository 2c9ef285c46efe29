"""How large the biases are, as one mean tells."""

import numpy as np
import pytest

from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.frames import euler_to_matrix
from lbgc.sensor import bias_size
from lbgc.sensor.noise import RandomWalk, White
from lbgc.units import DEG, HOUR

LATITUDE = 0.84


@pytest.mark.parametrize("size_deg_per_h", [0.5, 5.0, 300.0])
@pytest.mark.parametrize("known", [True, False])
def test_the_gyros_are_told_with_and_without_a_heading(size_deg_per_h, known, rng):
    """300 sensors leaning some degrees: half are above the estimate, and 95% intervals hold 95%,
    4.5 sampling errors each."""
    size, found = size_deg_per_h * DEG / HOUR, []
    for _ in range(300):
        heading = rng.uniform(-np.pi, np.pi)
        C = euler_to_matrix(*rng.normal(0, 0.05, 2), heading)
        rate = earth_rate_ned(LATITUDE) @ C + size * rng.standard_normal(3)
        force = np.array([0, 0, -9.81]) @ C
        given = heading if known else None
        found.append(bias_size.of_gyro(rate, force, LATITUDE, given, 0.01 * DEG / HOUR))
    above = np.mean([f.value < size for f in found])
    assert abs(above - 0.5) < 4.5 * np.sqrt(0.25 / 300)
    held = np.mean([f.low < size < f.high for f in found])
    assert abs(held - 0.95) < 4.5 * np.sqrt(0.95 * 0.05 / 300)


def test_a_mean_that_noise_explains_shows_no_bias():
    rate = earth_rate_ned(LATITUDE) + np.array([0.0, 0.0, 1e-8])
    found = bias_size.of_gyro(rate, np.array([0, 0, -9.81]), LATITUDE, 0.0, 1e-7)
    assert found.value < 1.5e-7


def test_the_accelerometers_are_told_by_the_forces_size(rng):
    found = [
        bias_size.of_accel(np.array([0, 0, -normal_gravity(LATITUDE) + e]), LATITUDE)
        for e in 0.05 * rng.standard_normal(300)
    ]
    assert abs(np.mean([f.low < 0.05 < f.high for f in found]) - 0.95) < 4.5 * 0.0126


def test_the_error_of_a_mean():
    assert bias_size.mean_error((), 100.0) == 0
    terms = (White(2.0), RandomWalk(0.1))
    assert bias_size.mean_error(terms, 100.0) == pytest.approx(np.sqrt(0.04 + 0.01 * 100 / 3))
