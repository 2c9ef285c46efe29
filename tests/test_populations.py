"""Populations of units: exact posteriors against one dense Gaussian of everything and against
importance sampling, and the linear law against the population's own second moments."""

import numpy as np
import pytest
from helpers import default_config
from unit_floor import simplex

from lbgc.estimators import populations
from lbgc.estimators.block_means import Site
from lbgc.estimators.populations import Bench, Population
from lbgc.estimators.posterior import along
from lbgc.frames import wrap
from lbgc.units import DEG, HOUR

DPH = DEG / HOUR
BENCH = Bench(default_config("imu=sdc500").imu.model(600.0), Site.at(0.57), 6, 10.0)
SPLIT = populations.splits(BENCH, DPH, simplex(2))
KINDS = populations.good_and_bad(BENCH, 0.3 * DPH, 3 * DPH, 0.2, 0.4 * DPH)
WARMING = populations.warm_ups(
    BENCH, 0.5 * DPH, 4 * DPH, 0.3 * DPH, (20.0, 200.0), 90.0, nodes=3, ages=4
)
STEP = populations.steps_in_temperature(
    BENCH, 0.5 * DPH, 1.5 * DPH, 0.3 * DPH, 0.1, nodes=5, temperatures=7
)
EVERY = [SPLIT, KINDS, WARMING, STEP]


def recordings(law: Population, units: int, k: int, seed: int = 3):
    """Figures and conditions of k labelled recordings and a query, and its heading."""
    rng = np.random.default_rng(seed)
    figures, condition, _ = law.draw(rng, units, k + 1)
    heading = rng.uniform(-np.pi, np.pi, units)
    return figures[:, :-1], condition, figures[:, -1] + law.signal(heading), heading


def dense(law: Population, node: int, figures, condition, query, psi: float) -> float:
    """Logarithm of the joint density of a unit's figures if its query's heading is psi, less that
    of 2 pi: one covariance matrix of all axes and recordings."""
    every = np.concatenate([figures, (query - law.signal(np.array(psi)))[None]])  # (k + 1, 3, d)
    total = 0.0
    for axis in range(3):
        H = law.columns[node][condition][:, axis]  # (k + 1, d, r)
        n, d, r = H.shape
        tall = H.reshape(n * d, r)
        new = np.kron(np.eye(n), law.run[node] * np.outer(law.one[axis], law.one[axis]))
        C = tall @ tall.T + new + np.eye(n * d)
        y = every[:, axis].ravel()
        total -= y @ np.linalg.solve(C, y) / 2 + np.linalg.slogdet(C)[1] / 2
    return total


@pytest.mark.parametrize("law", EVERY, ids=lambda law: law.name)
@pytest.mark.parametrize("k", [0, 1, 4])
def test_what_a_law_tells_is_one_dense_gaussian(law, k):
    figures, condition, query, _ = recordings(law, 2, k)
    context = law.context(figures, condition[:, :-1])
    for node in range(law.nodes):
        told = law.told(node, context, query, condition[:, -1])
        h, J, log = told.h, told.J, told.log
        for unit in range(2):
            for psi in (0.3, 2.0, -1.0):
                q = along(np.array(psi))
                found = log[unit] + q @ h[unit] - q @ J[unit] @ q / 2
                expected = dense(law, node, figures[unit], condition[unit], query[unit], psi)
                assert found == pytest.approx(expected, abs=1e-7 * abs(expected) + 1e-7)


@pytest.mark.parametrize("law", EVERY, ids=lambda law: law.name)
def test_the_linear_law_has_the_populations_second_moments(law):
    own = law.linear()
    w = law.weight
    for axis in range(3):
        H = law.columns[:, :, axis].reshape(law.nodes, -1, law.columns.shape[-1])
        exact = np.einsum("m,mir,mjr->ij", w, H, H)
        L = own.columns[0][:, axis].reshape(exact.shape[0], -1)
        # A pattern is left out below a thousandth of the largest: a millionth of its variance.
        assert np.abs(L @ L.T - exact).max() < 1e-5 * np.abs(exact).max()
    assert own.run[0] == pytest.approx(w @ law.run)


def test_figures_have_noise_of_unit_variance_as_the_sensor_samples_it():
    """Covariance of n draws: each entry's standard error is at most sqrt(2/n)."""
    n = 20_000
    law = WARMING
    noise = BENCH.imu.gyro.sample_noise(np.random.default_rng(1), n, 6, 10.0)
    figures = law.figures(noise)
    for axis in range(3):
        own = figures[:, axis].T @ figures[:, axis] / n
        assert np.abs(own - np.eye(law.size)).max() < 5 * np.sqrt(2 / n) + 0.02


def test_a_steady_rate_and_every_pattern_are_told_by_the_figures():
    """Information on a pattern is not less in the figures than in the interval means."""
    steady = np.ones((6, 3)) * DPH
    np.testing.assert_allclose(WARMING.figures(steady), DPH * WARMING.one)
    whole = BENCH.whitening @ np.ones(6)  # (3, T)
    np.testing.assert_allclose(np.sum(WARMING.one**2, axis=1), np.sum(whole**2, axis=1), rtol=1e-9)


@pytest.mark.parametrize("law", [KINDS, STEP], ids=lambda law: law.name)
def test_the_optimum_agrees_with_importance_sampling(law):
    """Units are drawn from the population and weighed by what they make of the recordings; the
    effective number of draws sets the tolerance."""
    k, draws = 1, 300_000
    figures, condition, query, _ = recordings(law, 2, k, seed=8)
    best, _ = law.optimal(law.context(figures, condition[:, :-1]), query, condition[:, -1])
    rng = np.random.default_rng(5)
    grid = np.deg2rad(np.arange(0.0, 360.0, 1.0))
    for unit in range(2):
        node = rng.choice(law.nodes, draws, p=law.weight)
        x = rng.standard_normal((draws, 1, 3, 1, law.columns.shape[-1]))
        own = np.sum(law.columns[node[:, None], condition[unit]] * x, axis=-1)
        V = np.eye(law.size) + law.run[0] * law.one[:, :, None] * law.one[:, None]
        P = np.linalg.inv(V)  # R is the same for all nodes here
        left = figures[unit] - own[:, :-1]
        log = -np.einsum("ukad,ade,ukae->u", left, P, left, optimize=True) / 2
        off = query[unit] - own[:, -1]  # (draws, 3, d)
        weight = np.exp(log - log.max())
        some = rng.choice(draws, 4000, p=weight / weight.sum())
        gap = off[some][:, None] - law.signal(grid)
        density = np.exp(-np.einsum("ugad,ade,ugae->ug", gap, P, gap, optimize=True) / 2)
        whole = density.sum(axis=0)
        mean = np.angle(whole @ np.exp(1j * grid))
        effective = min(weight.sum() ** 2 / np.sum(weight**2), 4000.0)
        assert effective > 100
        tolerance = 4 * float(best.sigma[unit]) / np.sqrt(effective)
        assert abs(wrap(mean - best.heading[unit])) < tolerance


def test_a_gaussian_populations_optimum_is_its_linear_estimate():
    law = populations.splits(BENCH, DPH, np.array([[0.75, 0.0, 0.25]]))
    figures, condition, query, heading = recordings(law, 400, 3)
    context = law.context(figures, condition[:, :-1])
    best, nodes = law.optimal(context, query, condition[:, -1])
    linear, _ = law.linear().best_linear(context, query, condition[:, -1])
    assert np.abs(wrap(best.heading - linear.heading)).max() < 1e-6
    assert nodes == pytest.approx(1.0)
    # Chi-square of 400 queries: sigma sqrt(2/400) = 0.071.
    assert np.mean((wrap(linear.heading - heading) / linear.sigma) ** 2) == pytest.approx(
        1, abs=0.3
    )


def test_what_is_not_gaussian_is_worth_something():
    """After one recording of good and bad units the optimum is well below the best linear one."""
    figures, condition, query, heading = recordings(KINDS, 2000, 1)
    context = KINDS.context(figures, condition[:, :-1])
    best, _ = KINDS.optimal(context, query, condition[:, -1])
    linear, _ = KINDS.linear().best_linear(context, query, condition[:, -1])
    square = [np.mean(wrap(own.heading - heading) ** 2) for own in (best, linear)]
    assert square[0] < 0.9 * square[1]
