"""Each term's faces agree with each other: drawn, averaged, predicted."""

import numpy as np
import pytest

from lbgc.sensor import gaussian, noise
from lbgc.sensor.deterministic import Ramp, Sinusoid
from lbgc.sensor.noise import (
    AngleQuantisation,
    BandLimited,
    Flicker,
    GaussMarkov,
    Line,
    RandomWalk,
    White,
)

# Coefficients such that every term matters at its own averaging times.
TERMS = {
    "white": (White(1.3),),
    "flicker": (Flicker(0.7, 1.0, 200.0),),
    "random walk": (RandomWalk(0.2),),
    "Gauss-Markov": (GaussMarkov(0.8, 2.0),),
    "line": (Line(1.5, 2.2, 0.3),),
    "resonance": (Line(1.5, 2.2, 0.3, 1),),
    "band-limited white": (BandLimited(0.4, 3.0),),
    "angle quantisation": (AngleQuantisation(0.02),),
    "a sum": (White(0.5), Flicker(0.7, 1.0, 200.0), RandomWalk(0.05)),
}
TONE = Sinusoid(2.0, 3.3)
every_term = pytest.mark.parametrize("terms", TERMS.values(), ids=TERMS)
every_rate = pytest.mark.parametrize("rate", [10, 100, 600])


def block_allan(y: np.ndarray, m: int) -> np.ndarray:
    """Non-overlapping Allan variance of each row at m samples."""
    n = y.shape[-1] // m * m
    means = y[..., :n].reshape(*y.shape[:-1], -1, m).mean(axis=-1, dtype=float)
    return 0.5 * np.mean(np.diff(means, axis=-1) ** 2, axis=-1)


@every_rate
@every_term
def test_drawn_allan_variance_is_the_formula(terms, rate, rng):
    """200 draws, octave taus from dt to T/4: z from the draws' own spread. Over the 12 cases there
    are 132 values of z; the worst of so many normals is beyond 4.5 once in a thousand such runs."""
    n = 4096
    y = gaussian.sample(terms, rng, (200, n), 1 / rate)
    assert y.dtype == np.float32
    z = []
    for m in 2 ** np.arange(11):
        drawn = block_allan(y, m)
        expected = noise.allan_variance(terms, np.array(m / rate))
        z.append((drawn.mean() - expected) / (drawn.std(ddof=1) / np.sqrt(len(drawn))))
    assert np.abs(z).max() < 4.5


@every_term
def test_covariance_of_means_is_that_of_averaged_samples(terms):
    """Exactly: averaging the covariance of samples gives the covariance of block means."""
    n, block, dt = 12, 5, 0.13
    average = np.kron(np.eye(n), np.ones((1, block)) / block)
    fine = average @ gaussian.covariance_of_means(terms, n * block, dt) @ average.T
    np.testing.assert_allclose(gaussian.covariance_of_means(terms, n, dt, block), fine, rtol=1e-11)


@every_term
def test_allan_variance_follows_from_the_covariance(terms):
    tau = 0.7
    difference = np.array([-1.0, 1.0])
    covariance = gaussian.covariance_of_means(terms, 2, tau)
    expected = difference @ covariance @ difference / 2
    np.testing.assert_allclose(noise.allan_variance(terms, np.array(tau)), expected, rtol=1e-9)


@pytest.mark.parametrize(
    "term",
    [
        White(1.3),
        RandomWalk(0.2),
        Flicker(0.7, 1.0, 200.0),
        GaussMarkov(0.8, 2.0),
        Line(1.5, 2.2, 0.3),
        Line(1.5, 2.2, 0.3, 1),
        BandLimited(0.4, 3.0),
    ],
    ids=lambda term: type(term).__name__,
)
@pytest.mark.parametrize("tau", [0.05, 3.0, 150.0])
def test_allan_variance_follows_from_the_psd(term, tau):
    """sigma^2 = 4 int_0^inf S(f) sin^4(pi f tau)/(pi f tau)^2 df, S two-sided (IEEE Std 952);
    beyond `top` (and 60 Hz), sin^4 is its mean 3/8 and S falls as f^-2 or f^-4, or is flat. Below,
    eight Gauss nodes on each stretch of 2%, and of a quarter of sin^4's period above x = 1."""
    top = max(600.0, 60 * np.pi * tau)
    edges = np.concatenate([np.geomspace(1e-9, 1, 1001), np.arange(1, top, np.pi / 4)[1:]])
    nodes, weights = np.polynomial.legendre.leggauss(8)
    half = np.diff(edges)[:, None] / 2
    x = edges[:-1, None] + half * (1 + nodes)
    f, last = x / (np.pi * tau), edges[-1]
    integral = np.sum(term.psd(f) * np.sin(x) ** 4 / x**2 * half * weights) / (np.pi * tau)
    slope = {White: 0, BandLimited: 4, Line: 4}.get(type(term), 2)
    end = term.psd(np.array([last / (np.pi * tau)]))[0]
    tail = end * 3 / 8 / last / (1 + slope) / (np.pi * tau)
    np.testing.assert_allclose(4 * (integral + tail), term.allan_variance(tau), rtol=2e-5)


@every_term
def test_blocks_join_with_the_exact_covariance(terms):
    """Two blocks of the sampler's own factor, multiplied out, are covariance_of_means."""
    size, dt = 16, 0.31
    f = gaussian._block_factor(terms, dt, size)
    start = f.start @ f.start.T
    L, O = np.hsplit(f.LO.astype(float), [size])  # noqa: E741
    G, W = np.hsplit(f.GW.astype(float), [size])
    end = f.F @ start @ f.F.T + G @ G.T + W @ W.T
    first = O @ start @ O.T + L @ L.T
    second = O @ end @ O.T + L @ L.T
    across = (O @ start @ f.F.T + L @ G.T) @ O.T
    joined = np.block([[first, across], [across.T, second]])
    expected = gaussian.covariance_of_means(terms, 2 * size, dt)
    np.testing.assert_allclose(joined, expected, atol=1e-6 * expected.max())


@pytest.mark.parametrize("start", [0, 40])
@every_term
def test_drawn_series_have_the_covariance_across_blocks(terms, rng, start):
    """From a recording's start, and from later on. Variances of means over the first, middle and
    last third of 300 samples (over two block borders) and of their differences, from 4,000 draws:
    relative sd sqrt(2/4000) = 2.2%, 4.5 of them allowed."""
    n, dt, draws = 300, 0.02, 4000
    y = gaussian.sample(terms, rng, (draws, n), dt, start=start).astype(float)
    thirds = np.kron(np.eye(3), np.full((1, 100), 0.01))
    looks = np.vstack([np.eye(3), [[-1, 1, 0], [0, -1, 1], [-1, 0, 1]]]) @ thirds
    whole = gaussian.covariance_of_means(terms, n, dt, start=start)
    expected = np.diag(looks @ whole @ looks.T)
    drawn = np.mean((y @ looks.T) ** 2, axis=0)
    np.testing.assert_allclose(drawn, expected, rtol=4.5 * np.sqrt(2 / draws))


@pytest.mark.parametrize("n", [1, 131, 960])
def test_a_series_is_the_same_to_the_bit_in_whatever_company(n):
    """Else a recording would depend on how many others are made with it."""
    terms = TERMS["a sum"]

    def generators(count):
        return [np.random.Generator(np.random.SFC64(i)) for i in range(count)]

    together = gaussian.sample(terms, generators(64), (64, n), 0.1)
    for count in (1, 7, 33):
        few = gaussian.sample(terms, generators(count), (count, n), 0.1)
        np.testing.assert_array_equal(few, together[:count])
    alone = gaussian.sample(terms, generators(1)[0], (n,), 0.1)
    np.testing.assert_array_equal(alone, together[0])


def test_sample_means_has_the_law_of_averaged_samples(rng):
    """Both drawn; covariances compared elementwise against their sampling error."""
    terms, draws, n, block, dt = TERMS["a sum"], 4000, 6, 20, 0.05
    fine = gaussian.sample(terms, rng, (draws, n * block), dt).astype(float)
    averaged = fine.reshape(draws, n, block).mean(axis=-1)
    direct = gaussian.sample_means(terms, rng, (draws, n), dt, block).astype(float)
    expected = gaussian.covariance_of_means(terms, n, dt, block)
    spread = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / draws)
    for drawn in (averaged, direct):
        z = (drawn.T @ drawn / draws - expected) / spread
        assert np.abs(z).max() < 4.5


def test_flicker_floor_is_flat_between_its_corners():
    b, short, long = 0.3, 1.0, 3600.0
    flicker = Flicker(b, short, long)
    taus = np.geomspace(short, long, 200)
    deviation = np.sqrt(flicker.allan_variance(taus)) / (np.sqrt(2 * np.log(2) / np.pi) * b)
    inside = (taus >= 2 * short) & (taus <= long / 2)
    assert np.abs(deviation[inside] - 1).max() < 0.005
    assert np.abs(deviation - 1).max() < 0.015
    slope = np.gradient(np.log(deviation), np.log(taus))
    assert np.abs(slope[(taus > 10 * short) & (taus < long / 10)]).max() < 0.002


def test_flicker_is_the_same_process_at_every_rate():
    """Its Allan variance at one tau does not know the sample rate."""
    terms = (Flicker(1.0),)
    by_rate = [
        gaussian.covariance_of_means(terms, 2, 1 / rate, 4 * rate) for rate in (10, 100, 600)
    ]
    np.testing.assert_allclose(by_rate[1], by_rate[0], rtol=1e-9)
    np.testing.assert_allclose(by_rate[2], by_rate[0], rtol=1e-9)


def test_random_walk_starts_at_zero_and_flicker_does_not(rng):
    dt = 1e-3
    walk = RandomWalk(1.0).sample(rng, (2000, 2), dt)[:, 0]
    np.testing.assert_allclose(walk.var(), dt / 3, rtol=4.5 * np.sqrt(2 / 2000))
    flicker = Flicker(1.0)
    first = flicker.sample(rng, (2000, 2), dt)[:, 0]
    assert first.var() == pytest.approx(flicker.variances().sum(), rel=0.15)


def test_slow_terms_survive_under_fast_ones(rng):
    """Samples whose white noise hides the walk fifteen times over: averaged, the walk is all there,
    though the samples are float32."""
    white, n, dt = White(1.0), 20_000, 1 / 600
    walk = RandomWalk(0.3)
    with_walk = gaussian.sample((white, walk), rng, (400, n), dt)
    end = with_walk[:, -2000:].astype(float).mean(axis=1)
    m = 2000 * dt
    expected = white.N**2 / m + walk.K**2 * (n * dt - m + m / 3)
    np.testing.assert_allclose(end.var(), expected, rtol=4.5 * np.sqrt(2 / 400))


def test_angle_quantisation_follows_from_its_samples_psd():
    """sigma^2(m dt) = 4 int_0^(1/2dt) S(f) sin^4(m x)/(m sin x)^2 df, x = pi f dt."""
    term, dt, m = AngleQuantisation(0.02), 0.1, 7
    x = (np.arange(200_000) + 0.5) / 200_000 * np.pi / 2  # pi f dt
    gain = 2 * np.sin(m * x) ** 4 / (m * np.sin(x)) ** 2
    integral = 2 * np.mean(term.psd(x / np.pi / dt, dt) * gain) / (2 * dt)
    np.testing.assert_allclose(integral, term.allan_variance(m * dt), rtol=1e-6)


def test_a_ramp_is_exact_in_every_realisation(rng):
    ramp, dt = Ramp(0.3), 0.1
    y = ramp.sample(rng, (50, 400), dt)
    for m in (1, 10, 100):
        np.testing.assert_allclose(block_allan(y, m), ramp.allan_variance(m * dt), rtol=1e-9)
    assert set(np.sign(y[:, 0])) == {-1.0, 1.0}
    means = Ramp(0.3).at(np.ones(1), 400, dt).reshape(1, 40, 10).mean(axis=-1)
    np.testing.assert_allclose(ramp.at(np.ones(1), 40, 1.0), means)
    np.testing.assert_allclose(ramp.covariance_of_means(40, dt, 10), means.T @ means)


def test_a_line_at_frequency_zero_is_band_limited_noise():
    """Of half its width, and of the white noise that gives its variance, N^2 w0/(2 sqrt 2)."""
    line = Line(0.8, 0.0, 1.2)
    low_pass = BandLimited(0.8 * np.sqrt(2 * np.sqrt(2) / (2 * np.pi * 0.6)), 0.6)
    tau = np.geomspace(0.01, 100, 30)
    np.testing.assert_allclose(line.allan_variance(tau), low_pass.allan_variance(tau), rtol=1e-7)
    np.testing.assert_allclose(line.psd(tau), low_pass.psd(tau), rtol=1e-9)
    np.testing.assert_allclose(
        line.covariance_of_means(5, 0.7), low_pass.covariance_of_means(5, 0.7), rtol=1e-9
    )


def test_sinusoid_averages_to_its_own_means(rng):
    phase, dt, block = np.array([0.4, 2.0]), 0.01, 25
    fine = TONE.at(phase, 500, dt).reshape(2, 20, block).mean(axis=-1)
    np.testing.assert_allclose(fine, TONE.at(phase, 20, dt * block), atol=1e-12)


@pytest.mark.parametrize("m", [1, 7, 40])
def test_sinusoid_allan_variance_and_covariance(m, rng):
    dt = 0.01
    y = TONE.sample(rng, (3000, 2 * m), dt)
    drawn = block_allan(y, m)
    expected = TONE.allan_variance(np.array(m * dt))
    assert abs(drawn.mean() - expected) < 4.5 * drawn.std() / np.sqrt(len(drawn)) + 1e-12
    covariance = TONE.covariance_of_means(2, dt, m)
    np.testing.assert_allclose(covariance[0, 0] - covariance[0, 1], expected, atol=1e-12)


def test_each_term_alone_is_the_modules_sum_of_one(rng):
    again = np.random.Generator(np.random.SFC64(3))
    term = Flicker(1.0)
    alone = term.sample_means(np.random.Generator(np.random.SFC64(3)), (2, 40), 0.1, 5)
    np.testing.assert_array_equal(alone, gaussian.sample((term,), again, (2, 40), 0.5))
    np.testing.assert_array_equal(
        term.covariance_of_means(4, 0.1), gaussian.covariance_of_means((term,), 4, 0.1)
    )


def test_a_lines_power_is_the_integral_of_its_density():
    for line in (Line(0.8, 3.0, 1.2), Line(0.8, 3.0, 1.2, 1)):
        f = np.linspace(0, 40, 400_001)
        below = np.concatenate([[0], np.cumsum((line.psd(f)[1:] + line.psd(f)[:-1]) / 2) * 1e-4])
        np.testing.assert_allclose(line.power_below(f), below, atol=1e-6)
    assert line.power_below(np.array(1e9)) == pytest.approx(0.8**2 / 2)
