"""The stochastic error terms: each is one frozen dataclass whose faces must agree.

A term can be drawn (`sample`), drawn already averaged with the same law (`sample_means`), it
predicts its Allan variance and its PSD (two-sided, as in IEEE Std 952), and it gives the covariance
of block means. Drawing and the covariance come from the state-space model that
`lbgc.sensor.gaussian` explains; the Allan variance and the PSD are closed forms of their own, so
that the two can be held against each other.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from lbgc.sensor.exponential import (
    exponential_allan,
    gauss_markov_allan,
    gauss_markov_model,
    gauss_markov_psd,
)
from lbgc.sensor.gaussian import GaussianTerm, MeansModel, Reduced, sde_means_model
from lbgc.sensor.low_pass import BUTTERWORTH, LowPass


@dataclass(frozen=True)
class White(GaussianTerm):
    """White rate noise, whose integral is the angle (velocity) random walk.

    Two-sided PSD N^2; the mean over h is Normal(0, N^2/h), independent between intervals; Allan
    variance N^2/tau (IEEE Std 952, C.1.1).
    """

    cause: ClassVar[str] = "white noise"
    N: float
    """unit/sqrt(Hz), two-sided: rad/sqrt(s) for a gyro."""

    def behind(self, low_pass: LowPass) -> "BandLimited":
        return BandLimited(self.N, low_pass.bandwidth, low_pass.damping)

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        return Reduced(white=self.N**2)

    def means_model(self, interval: float) -> MeansModel:
        none = np.zeros((0, 0))
        return MeansModel(none, none[0:0].reshape(0), none, np.zeros(0), self.N**2 / interval, none)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        return self.N**2 / np.asarray(tau, dtype=float)

    def psd(self, f: np.ndarray) -> np.ndarray:
        return np.full_like(np.asarray(f, dtype=float), self.N**2)


@dataclass(frozen=True)
class Rounding(White):
    """Rounding of a rate to counts, each sample by itself: white where the noise shakes it across
    counts (lbgc.sensor.dither)."""

    cause: ClassVar[str] = "rounding"

    @classmethod
    def to(cls, lsb: float, dt: float) -> Self:
        """Rounding to this count at samples of dt s: LSB^2/12 a sample."""
        return cls(lsb * np.sqrt(dt / 12))


@dataclass(frozen=True)
class RandomWalk(GaussianTerm):
    """Rate random walk, w = K x Wiener process, zero at the recording's start.

    Over an interval h that starts at w: the end is w + du, the mean is w + v, with var(du) = K^2 h,
    var(v) = K^2 h/3, cov(du, v) = K^2 h/2 (integrals of the Wiener process). Allan variance
    K^2 tau/3, PSD K^2/(2 pi f)^2 (IEEE Std 952, C.1.4).
    """

    cause: ClassVar[str] = "random walk"
    K: float
    """unit/s/sqrt(Hz): rad/s/sqrt(s) for a gyro."""

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        return Reduced(constant=self.K**2 * start_s, walk=self.K**2)

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

    cause: ClassVar[str] = "bias instability"
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

    @property
    def processes(self) -> tuple[tuple[float, float], ...]:
        return tuple(zip(self.variances().tolist(), self.correlation_times().tolist(), strict=True))

    def means_model(self, interval: float) -> MeansModel:
        return gauss_markov_model(self.variances(), self.correlation_times(), interval)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """Exact Allan variance, corners included."""
        return gauss_markov_allan(self.variances(), self.correlation_times(), tau)

    def psd(self, f: np.ndarray) -> np.ndarray:
        """PSD of the model, corners and ripple included."""
        return gauss_markov_psd(self.variances(), self.correlation_times(), f)


@dataclass(frozen=True)
class GaussMarkov(GaussianTerm):
    """First-order Gauss-Markov process with a stationary start: covariance sigma^2 e^(-|t|/T).

    PSD 2 sigma^2 T/(1 + (2 pi f T)^2); Allan variance 2 (V(tau) - V(2 tau)) with V the variance of
    its mean, 2 sigma^2 (T/tau)^2 (tau/T - 1 + e^(-tau/T)) (IEEE Std 952, C.1.7).
    """

    sigma: float
    """unit"""
    T: float
    """s: correlation time."""

    @property
    def processes(self) -> tuple[tuple[float, float], ...]:
        return ((self.sigma**2, self.T),)

    def means_model(self, interval: float) -> MeansModel:
        return gauss_markov_model(np.array([self.sigma**2]), np.array([self.T]), interval)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        return gauss_markov_allan(np.array([self.sigma**2]), np.array([self.T]), tau)

    def psd(self, f: np.ndarray) -> np.ndarray:
        return gauss_markov_psd(np.array([self.sigma**2]), np.array([self.T]), f)


@dataclass(frozen=True)
class Line(GaussianTerm):
    """A narrow band of noise around f0, with a stationary start. Its flanks are one of two kinds.

    With two poles it is a wandering line: the real part of z e^(i w0 t), z the complex output of a
    low-pass of half the width (Butterworth, see BandLimited), so with a flat top and steep flanks:
    a vibration's power lies where its frequency goes and nowhere else. With g = pi x width, a =
    g/sqrt 2: covariance sigma^2 e^(-a|t|) (cos at + sin a|t|) cos w0 t; PSD sigma^2 sqrt 2/g times
    1/(1 + ((w - w0)/g)^4) + 1/(1 + ((w + w0)/g)^4), half its peak at f0 +- width/2.

    With one pole it is the rate of a damped resonance, x'' + 2 g x' + w0^2 x = white noise, whose
    flanks fall as the square of the distance: covariance sigma^2 e^(-g|t|) (cos w1 t -
    g/w1 sin w1|t|), w1^2 = w0^2 - g^2; PSD 4 g sigma^2 w^2/((w0^2 - w^2)^2 + 4 g^2 w^2).
    """

    sigma: float
    """unit, rms"""
    f0: float
    """Hz: centre."""
    width: float
    """Hz: full width at half maximum."""
    poles: int = 2
    """2: steep flanks; 1: a damped resonance, narrower than 2 f0."""

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        return Reduced(angle=(self.sigma / (2 * np.pi * self.f0)) ** 2)

    def ringing(self) -> tuple[complex, complex]:
        """Rate s and weight W of a resonance's covariance, Re(W e^(s |t|))."""
        g = np.pi * self.width
        turn = np.sqrt(max((2 * np.pi * self.f0) ** 2 - g**2, (1e-3 * g) ** 2))
        return complex(-g, turn), self.sigma**2 * complex(1.0, g / turn)

    def means_model(self, interval: float) -> MeansModel:
        g, w = np.pi * self.width, 2 * np.pi * self.f0
        if self.poles == 1:  # of w0 x and x'
            swinging = np.array([[0.0, w], [-w, -2 * g]])
            diffusion, start = np.diag([0.0, 4 * g * self.sigma**2]), self.sigma**2 * np.eye(2)
            return sde_means_model(swinging, diffusion, np.array([0.0, 1.0]), start, interval)
        turn = np.array([[0.0, -w], [w, 0.0]])
        # of the low-pass's output and its rate over g, real and imaginary, turning at w0
        low_pass = g * np.array([[0.0, 1.0], [-1.0, -2 * BUTTERWORTH]])
        F = np.kron(np.eye(2), low_pass) + np.kron(turn, np.eye(2))
        variance = self.sigma**2 * np.eye(4)
        diffusion = 4 * BUTTERWORTH * g * variance * np.diag([0.0, 1.0, 0.0, 1.0])
        return sde_means_model(F, diffusion, np.array([1.0, 0, 0, 0]), variance, interval)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        g, w = np.pi * self.width, 2 * np.pi * self.f0
        if self.poles == 1:
            return exponential_allan(*self.ringing(), tau)
        a = g * BUTTERWORTH
        each = [exponential_allan(a * (1j - 1) + 1j * turn, 1 - 1j, tau) for turn in (w, -w)]
        return np.asarray(self.sigma**2 / 2 * (each[0] + each[1]))

    def psd(self, f: np.ndarray) -> np.ndarray:
        g, f = np.pi * self.width, np.asarray(f, dtype=float)
        if self.poles == 1:
            w0, w = 2 * np.pi * self.f0, 2 * np.pi * f
            return 4 * g * (self.sigma * w) ** 2 / ((w0**2 - w**2) ** 2 + (2 * g * w) ** 2)
        x, y = (2 * (f - self.f0) / self.width) ** 2, (2 * (f + self.f0) / self.width) ** 2
        return np.asarray(self.sigma**2 * np.sqrt(2) / g * (1 / (1 + x**2) + 1 / (1 + y**2)))

    def power_below(self, f: np.ndarray) -> np.ndarray:
        """The integral of the PSD from 0 to f, both in Hz: sigma^2/2 in the end."""

        def shape(x: np.ndarray) -> np.ndarray:
            """int_0^x of sqrt 2/(pi (1 + t^4)) dt"""
            r = np.sqrt(2) * x
            ratio = np.log((x**2 + r + 1) / (x**2 - r + 1)) / 2
            return np.asarray((ratio + np.arctan(r + 1) + np.arctan(r - 1)) / (2 * np.pi))

        f = np.asarray(f, dtype=float)
        if self.poles == 1:
            s, weight = self.ringing()
            turns = np.log(-s + 2j * np.pi * f) - np.log(-s - 2j * np.pi * f)
            return np.imag(weight * turns) / (2 * np.pi)
        x, y = 2 * (f - self.f0) / self.width, 2 * (f + self.f0) / self.width
        return np.asarray(self.sigma**2 / 2 * (shape(x) + shape(y)))


@dataclass(frozen=True)
class BandLimited(GaussianTerm):
    """White noise N behind a second-order low-pass of natural frequency `bandwidth`.

    PSD N^2/((1 - x^2)^2 + (2 damping x)^2), x = f/bandwidth; with the usual damping of 0.707
    (Butterworth) that is N^2/(1 + x^4), -3 dB at `bandwidth`. With w0 = 2 pi bandwidth the poles
    l1, l2 are w0 (-damping +- sqrt(damping^2 - 1)), the output's variance is N^2 w0/(4 damping) and
    its covariance that times (l1 e^(l2 |t|) - l2 e^(l1 |t|))/(l1 - l2). Slow terms pass the filter
    unchanged; a constant too.
    """

    cause: ClassVar[str] = "white noise"
    N: float
    """unit/sqrt(Hz), two-sided, before the filter."""
    bandwidth: float
    """Hz"""
    damping: float = BUTTERWORTH

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        return Reduced(white=self.N**2)

    def _variance(self) -> float:
        return self.N**2 * 2 * np.pi * self.bandwidth / (4 * self.damping)

    def means_model(self, interval: float) -> MeansModel:
        w = 2 * np.pi * self.bandwidth
        # of the output and its rate over w
        F = w * np.array([[0.0, 1.0], [-1.0, -2 * self.damping]])
        diffusion = np.diag([0.0, (w * self.N) ** 2])
        start = self._variance() * np.eye(2)
        return sde_means_model(F, diffusion, np.array([1.0, 0.0]), start, interval)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        # critical damping has one double pole; a hair beside it is the same to rounding
        damping = self.damping + 1e-6 * (abs(self.damping - 1) < 1e-6)
        root = np.sqrt(complex(damping**2 - 1))
        w = 2 * np.pi * self.bandwidth
        one, two = w * (-damping + root), w * (-damping - root)
        first = exponential_allan(one, -two / (one - two), tau)
        return np.asarray(
            self._variance() * (first + exponential_allan(two, one / (one - two), tau))
        )

    def psd(self, f: np.ndarray) -> np.ndarray:
        return self.N**2 * LowPass(self.bandwidth, self.damping).gain_squared(f)


@dataclass(frozen=True)
class AngleQuantisation(GaussianTerm):
    """Error of angle increments that are read from a counter: differences of white angle errors.

    A sample is (q_k - q_(k-1))/h with q independent of variance Q^2 (for counts of size c that are
    carried, Q = c/sqrt 12). Means telescope to (q_end - q_start)/tau, so the law at any rate is the
    same and the Allan variance is 3 Q^2/tau^2 at every tau = m dt (IEEE Std 952, C.1.2). q is drawn
    Gaussian here; counting itself is `lbgc.sensor.imu`'s.
    """

    Q: float
    """unit s: rad for a gyro."""

    @classmethod
    def of_count(cls, lsb: float) -> Self:
        """Counting an integrated output in such counts, the rest of each carried over."""
        return cls(lsb / np.sqrt(12))

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        return Reduced(angle=self.Q**2)

    def means_model(self, interval: float) -> MeansModel:
        q = np.array([[self.Q**2]])
        return MeansModel(
            A=np.zeros((1, 1)),
            C=np.array([-1 / interval]),
            Q=q,
            S=q[0] / interval,
            R=self.Q**2 / interval**2,
            P0=q,
        )

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        return 3 * self.Q**2 / np.asarray(tau, dtype=float) ** 2

    def psd(self, f: np.ndarray, dt: float) -> np.ndarray:
        """PSD of samples at interval dt: 4 Q^2/dt sin^2(pi f dt), about (2 pi f)^2 Q^2 dt."""
        return 4 * self.Q**2 / dt * np.sin(np.pi * np.asarray(f, dtype=float) * dt) ** 2


def allan_variance(terms: tuple[Any, ...], tau: np.ndarray) -> np.ndarray:
    """Allan variance of the sum of independent terms (Gaussian or not), tau (*S) in s -> unit^2
    (*S)."""
    return sum((t.allan_variance(tau) for t in terms), np.zeros(np.shape(tau)))
