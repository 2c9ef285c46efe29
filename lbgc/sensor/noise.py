"""The stochastic error terms: each is one frozen dataclass whose faces must agree.

A term can be drawn (`sample`), drawn already averaged with the same law (`sample_means`), it
predicts its Allan variance and its PSD (two-sided, as in IEEE Std 952), and it gives the covariance
of block means. Drawing and the covariance come from the state-space model that
`lbgc.sensor.gaussian` explains; the Allan variance and the PSD are closed forms of their own, so
that the two can be held against each other.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.sensor.gaussian import GaussianTerm, MeansModel


@dataclass(frozen=True)
class White(GaussianTerm):
    """White rate noise, whose integral is the angle (velocity) random walk.

    Two-sided PSD N^2; the mean over h is Normal(0, N^2/h), independent between intervals; Allan
    variance N^2/tau (IEEE Std 952, C.1.1).
    """

    N: float
    """unit/sqrt(Hz), two-sided: rad/sqrt(s) for a gyro."""

    def means_model(self, interval: float) -> MeansModel:
        none = np.zeros((0, 0))
        return MeansModel(none, none[0:0].reshape(0), none, np.zeros(0), self.N**2 / interval, none)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        return self.N**2 / np.asarray(tau, dtype=float)

    def psd(self, f: np.ndarray) -> np.ndarray:
        return np.full_like(np.asarray(f, dtype=float), self.N**2)


@dataclass(frozen=True)
class RandomWalk(GaussianTerm):
    """Rate random walk, w = K x Wiener process, zero at the recording's start.

    Over an interval h that starts at w: the end is w + du, the mean is w + v, with var(du) = K^2 h,
    var(v) = K^2 h/3, cov(du, v) = K^2 h/2 (integrals of the Wiener process). Allan variance
    K^2 tau/3, PSD K^2/(2 pi f)^2 (IEEE Std 952, C.1.4).
    """

    K: float
    """unit/s/sqrt(Hz): rad/s/sqrt(s) for a gyro."""

    def means_model(self, interval: float) -> MeansModel:
        q = self.K**2 * interval
        one = np.ones((1, 1))
        return MeansModel(one, np.ones(1), q * one, np.array([q / 2]), q / 3, 0 * one)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        return self.K**2 * np.asarray(tau, dtype=float) / 3

    def psd(self, f: np.ndarray) -> np.ndarray:
        return self.K**2 / (2 * np.pi * np.asarray(f, dtype=float)) ** 2


@dataclass(frozen=True)
class Flicker(GaussianTerm):
    """Bias instability: 1/f noise between two corners, PSD B^2/(2 pi f) inside them.

    A sum of independent stationary first-order Gauss-Markov processes whose correlation times T_i
    are a geometric series of ratio r. Each has PSD 2 s T_i/(1 + (2 pi f T_i)^2); with equal
    variances s = B^2 ln(r)/pi the sum is B^2/(2 pi f) times 1 +- 2/cosh(pi^2/ln r), a ripple below
    0.4% for r <= 4. The series runs from T_short/6 to 2 T_long. What an endless series would add
    beyond an end has, inside the band, the shape of the outermost process (f^-2 above, flat below)
    and the weight s/(r - 1) of it, so it is folded into that process: its variance is s r/(r - 1).

    So the Allan deviation is sqrt(2 ln 2/pi) B = 0.664 B, within 0.5% from 2 T_short to T_long/2
    and within 1.5% at T_short and T_long themselves (IEEE Std 952, C.1.3, has no corners). The
    total variance is finite, about B^2 (ln(T_long/T_short) + 4.8)/pi, and much of it looks like
    a constant bias within one recording: as it does in sensors.
    """

    B: float
    """unit: rad/s for a gyro."""
    T_short: float = 1.0
    """s: shortest averaging time of the flat floor."""
    T_long: float = 3600.0
    """s: longest averaging time of the flat floor."""

    def correlation_times(self) -> np.ndarray:
        """T_i in s, ascending, shape (p,)."""
        low, high = self.T_short / 6, self.T_long * 2
        count = int(np.ceil(np.log(high / low) / np.log(4.0))) + 1
        return np.geomspace(low, high, count)

    def variances(self) -> np.ndarray:
        """Each process's variance, unit^2, shape (p,)."""
        times = self.correlation_times()
        ratio = times[1] / times[0]
        variances = np.full(len(times), self.B**2 * np.log(ratio) / np.pi)
        variances[[0, -1]] *= ratio / (ratio - 1)
        return variances

    def means_model(self, interval: float) -> MeansModel:
        """Each process over h = u T, started at x: the end is e^-u x + ..., the mean is g x + ...
        with g = (1 - e^-u)/u; given x, var(end) = s (1 - e^-2u), cov(end, mean) = s g (1 - e^-u)
        and var(mean) = s (V(u) - g^2), V as in `_mean_variance`."""
        u, s = interval / self.correlation_times(), self.variances()
        decay, gain = np.exp(-u), -np.expm1(-u) / u
        q = s * -np.expm1(-2 * u)
        r = float(np.sum(s * _conditional_mean_variance(u)))
        return MeansModel(np.diag(decay), gain, np.diag(q), s * gain * -np.expm1(-u), r, np.diag(s))

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """Exact, corners included: V(tau) - cov of neighbours = 2 (V(tau) - V(2 tau))."""
        u = np.asarray(tau, dtype=float)[..., None] / self.correlation_times()
        return np.sum(self.variances() * 2 * (_mean_variance(u) - _mean_variance(2 * u)), axis=-1)

    def psd(self, f: np.ndarray) -> np.ndarray:
        """Of the model, corners and ripple included."""
        times = self.correlation_times()
        x = 2 * np.pi * np.asarray(f, dtype=float)[..., None] * times
        return np.sum(2 * self.variances() * times / (1 + x**2), axis=-1)


@dataclass(frozen=True)
class Sinusoid:
    """A tone, amplitude x sin(2 pi f t + phase), the phase uniform for each drawn series.

    Its interval means are amplitude x sinc(f h) x sin(2 pi f t_mid + phase). Allan variance
    amplitude^2 (sin^2(pi f tau)/(pi f tau))^2 (IEEE Std 952, C.1.6). All of its power is at f, so
    it has no density.
    """

    amplitude: float
    f: float
    """Hz"""

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...], dt: float) -> np.ndarray:
        return self.at_phase(rng.uniform(0, 2 * np.pi, shape[:-1]), shape[-1], dt)

    def sample_means(
        self, rng: np.random.Generator, shape: tuple[int, ...], dt: float, block: int
    ) -> np.ndarray:
        return self.sample(rng, shape, dt * block)

    def at_phase(self, phase: np.ndarray, n: int, dt: float) -> np.ndarray:
        """The interval means at given phases: phase (*S) in rad -> (*S, n)."""
        middle = (np.arange(n) + 0.5) * dt
        wave = np.sin(2 * np.pi * self.f * middle + np.asarray(phase)[..., None])
        return self.amplitude * np.sinc(self.f * dt) * wave

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        x = self.f * np.asarray(tau, dtype=float)
        return self.amplitude**2 * (np.sinc(x) * np.sin(np.pi * x)) ** 2

    def covariance_of_means(self, n: int, dt: float, block: int = 1) -> np.ndarray:
        lag = np.subtract.outer(np.arange(n), np.arange(n)) * dt * block
        power = (self.amplitude * np.sinc(self.f * dt * block)) ** 2 / 2
        return power * np.cos(2 * np.pi * self.f * lag)


def allan_variance(terms: tuple, tau: np.ndarray) -> np.ndarray:
    """Of the sum of independent terms (Gaussian or not), tau (*S) in s -> unit^2 (*S)."""
    return sum((t.allan_variance(tau) for t in terms), np.zeros(np.shape(tau)))


def _mean_variance(u: np.ndarray) -> np.ndarray:
    """Variance of a unit Gauss-Markov process's mean over u correlation times:
    2 (u - 1 + e^-u)/u^2, by its series 1 - u/3 + u^2/12 - ... where that cancels."""
    small = u < 0.1
    series = 1 - u / 3 + u**2 / 12 - u**3 / 60 + u**4 / 360 - u**5 / 2520 + u**6 / 20160
    safe = np.where(small, 1.0, u)
    return np.where(small, series, 2 * (safe + np.expm1(-safe)) / safe**2)


def _conditional_mean_variance(u: np.ndarray) -> np.ndarray:
    """The same given the process's value at the start: V(u) - ((1 - e^-u)/u)^2, by its series
    2u/3 - u^2/2 + 7u^3/30 - ... where that cancels."""
    small = u < 0.02
    series = 2 * u / 3 - u**2 / 2 + 7 * u**3 / 30 - u**4 / 12 + 31 * u**5 / 1260
    safe = np.where(small, 1.0, u)
    closed = _mean_variance(safe) - (np.expm1(-safe) / safe) ** 2
    return np.where(small, series, closed)
