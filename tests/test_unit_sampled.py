"""What labelled recordings tell of a unit, against brute force: a million units drawn, each counted
by how likely it makes the recordings (importance sampling from the prior). Nothing here is linear,
and nothing is shared with the posterior but the sensor's figures."""

import numpy as np
import pytest
from floor_cases import STATIC, Case

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.estimators.unit_posterior import Reference, evidence, posterior, undivided
from lbgc.estimators.unit_verdict import verdict, ways
from lbgc.units import DEG, HOUR

LATITUDE = 40 * DEG
BIAS, BLOCKS, INTERVAL = 1.0 * DEG / HOUR, 4, 30.0
NOISE = 0.9 * BIAS
"""1 sigma of a recording's mean rate, rad/s"""
IMU = Case("", "ideal", STATIC, 0.0, overrides=(
    "imu.gyro.bias_unit_deg_per_h=1",
    f"imu.gyro.arw_deg_per_sqrt_h={0.9 * np.sqrt(BLOCKS * INTERVAL / HOUR):.12g}",
)).model()  # fmt: skip
HEADINGS = np.deg2rad([20.0, 140.0, 250.0, 330.0])
SESSIONS = np.array([0, 0, 1, 1])
NEW, OFFSET = 1.5 * DEG, 1.0 * DEG
DRAWS = 1_000_000


def earth(heading: np.ndarray) -> np.ndarray:
    """Earth's rate in a level body, (*S, 3)."""
    north, down = EARTH_RATE * np.cos(LATITUDE), -EARTH_RATE * np.sin(LATITUDE)
    return np.stack(
        [north * np.cos(heading), -north * np.sin(heading), np.full_like(heading, down)], axis=-1
    )


def drawn(rng: np.random.Generator, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Units whose biases split by these shares, (n, 3): what each keeps, (n, 3), and the mean rate
    of each recording but for noise, (n, 4, 3)."""
    n, (unit, power, run) = len(shares), BIAS * np.sqrt(shares.T)[..., None]
    kept = unit * rng.standard_normal((n, 3))
    of_power = power[:, None] * rng.standard_normal((n, 2, 3))
    of_run = run[:, None] * rng.standard_normal((n, 4, 3))
    misread = NEW * rng.standard_normal((n, 4)) + OFFSET * rng.standard_normal((n, 1))
    return kept, earth(HEADINGS - misread) + kept[:, None] + of_power[:, SESSIONS] + of_run


@pytest.fixture(scope="module", params=[1, 2])
def rates(request):
    """The mean rates of four recordings of one unit, (4, 3)."""
    rng = np.random.default_rng(request.param)
    _, rate = drawn(rng, np.array([[0.6, 0.3, 0.1]]))
    return rate[0] + NOISE * rng.standard_normal((4, 3))


def told(rates: np.ndarray) -> Windows:
    still = np.array([0.0, 0.0, -normal_gravity(float(LATITUDE))])
    return Windows(
        gyro=np.repeat(rates[:, None], BLOCKS, axis=1),
        accel=np.broadcast_to(still, (len(rates), BLOCKS, 3)),
        plate_angle=np.zeros((len(rates), BLOCKS)),
        rate_hz=1 / INTERVAL,
        latitude=np.full(len(rates), LATITUDE),
        start_s=np.zeros(len(rates)),
    )


def log_likelihood(rates: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Of recordings that printed these rates, (4, 3), whose means are rate, (n, 4, 3)."""
    return -np.square((rates - rate) / NOISE).sum(axis=(1, 2)) / 2


def log_mean(logs: np.ndarray) -> tuple[float, float]:
    """The logarithm of the mean of what has these logarithms, (n,), and its standard error."""
    own = np.exp(logs - logs.max())
    error = own.std() / own.mean() / np.sqrt(len(own))
    return float(np.log(own.mean()) + logs.max()), float(error)


def test_it_is_what_a_million_drawn_units_say(rates):
    """Its mean, covariance, weights of the splits and evidence, within 4.5 standard errors of the
    sampling, and 2% of a sigma for what is not linear in a label that is 1.8 degrees off."""
    base = undivided(IMU)
    reference = Reference(np.full(4, NEW), OFFSET)
    of = evidence(base, [told(rates)], HEADINGS, reference)
    _, both = ways(base, of, SESSIONS)
    found = posterior(base, of, SESSIONS, None, both[0].shares, both[0].mass)
    mean, covariance = found.known.mean / BIAS, found.known.covariance / BIAS**2

    rng = np.random.default_rng(7)
    split = rng.dirichlet([1, 1, 1], size=DRAWS)
    kept, rate = drawn(rng, split)
    log = log_likelihood(rates, rate)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    assert 1 / np.square(weight).sum() > 1000  # draws that count

    def agrees(value: float, each: np.ndarray, beside: float) -> bool:
        """Whether a figure is the weighted mean of a million."""
        sampled = weight @ each
        error = np.sqrt(np.square(weight * (each - sampled)).sum())
        return bool(abs(value - sampled) < 4.5 * error + beside)

    off = kept / BIAS - mean
    for i in range(3):
        assert agrees(0.0, off[:, i], 0.02 * np.sqrt(covariance[i, i]))
        for j in range(i, 3):
            assert agrees(covariance[i, j], off[:, i] * off[:, j], 0.02 * covariance[i, i])
    shares = found.weight @ found.shares
    for life in range(3):
        assert agrees(shares[life], split[:, life], 0.005)
    # The evidence against none of these errors: there labels alone are drawn, without an offset.
    misread = NEW * rng.standard_normal((DRAWS // 10, 4))
    bare = log_likelihood(rates, earth(HEADINGS - misread))
    (with_it, one), (without, other) = log_mean(log), log_mean(bare)
    assert abs(found.log_evidence - (with_it - without)) < 4.5 * np.hypot(one, other) + 0.02
    # And of a constant of the unit against none.
    left = rng.uniform(size=DRAWS)
    _, rate = drawn(rng, np.stack([0 * left, 1 - left, left], axis=1))
    no_constant, third = log_mean(log_likelihood(rates, rate))
    factor = verdict(both).log_bayes_factor
    assert abs(factor - (with_it - no_constant)) < 4.5 * np.hypot(one, third) + 0.02


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_that_repeats_far_better_than_it_says(seed):
    """A data sheet's 65 deg/h, of which a power-up adds 0.2 and a recording 0.1: what a recording
    adds is told by 3 (24 - 6) degrees of freedom, what a power-up adds by 3 (6 - 1)."""
    rng, sheet = np.random.default_rng(seed), 65.0
    headings, session = rng.uniform(-np.pi, np.pi, 24), np.arange(24) % 6
    unit = rng.standard_normal(3)
    of_power = 0.2 * rng.standard_normal((6, 3))
    of_run = 0.1 * rng.standard_normal((24, 3))
    rates = earth(headings) + BIAS * (unit + of_power[session] + of_run)
    imu = Case("", "ideal", STATIC, 0.0, overrides=(
        f"imu.gyro.bias_unit_deg_per_h={sheet}", "imu.gyro.arw_deg_per_sqrt_h=0.0001",
    )).model()  # fmt: skip
    base = undivided(imu)
    of = evidence(base, [told(rates)], headings, Reference(np.zeros(24)))
    _, both = ways(base, of, session)
    found = posterior(base, of, session, None, both[0].shares, both[0].mass)
    sizes = sheet * np.sqrt(found.weight @ found.shares)
    within = of_run - np.stack([of_run[session == k].mean(axis=0) for k in session])
    assert sizes[2] == pytest.approx(np.sqrt(np.square(within).sum() / 54), rel=0.05)
    assert sizes[2] == pytest.approx(0.1, rel=4.5 / np.sqrt(2 * 54))
    assert sizes[1] == pytest.approx(0.2, rel=4.5 / np.sqrt(2 * 15))
    off = (found.known.mean - BIAS * unit) / found.known.sigma
    assert np.abs(off).max() < 4.5
    assert found.known.sigma == pytest.approx(BIAS * sizes[1] / np.sqrt(6), rel=0.25)
