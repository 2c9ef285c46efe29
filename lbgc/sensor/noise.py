"""The stochastic error terms of a sensor. Each is one frozen dataclass whose faces must agree.

A term can be drawn (`sample`), and drawn already averaged with the same law (`sample_means`). It
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
from lbgc.sensor.gaussian import GaussianTerm, Reduced
from lbgc.sensor.low_pass import BUTTERWORTH, LowPass
from lbgc.sensor.means_model import MeansModel, sde_means_model


@dataclass(frozen=True)
class White(GaussianTerm):
    """White rate noise, whose integral is the angle (velocity) random walk.

    Two-sided PSD N^2; the mean over h is Normal(0, N^2/h), independent between intervals; Allan
    variance N^2/tau (IEEE Std 952, C.1.1).
    """

    cause: ClassVar[str] = "white noise"
    N: float
    """Root of the two-sided PSD, unit/sqrt(Hz): rad/sqrt(s) for a gyro."""

    def behind(self, low_pass: LowPass) -> "BandLimited":
        """The noise as it comes out of an output filter."""
        return BandLimited(self.N, low_pass.bandwidth, low_pass.damping)

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        """White noise of two-sided PSD N^2."""
        return Reduced(white=self.N**2)

    def means_model(self, interval: float) -> MeansModel:
        """A model without states: each mean is independent, with variance N^2/h."""
        none = np.zeros((0, 0))
        return MeansModel(none, none[0:0].reshape(0), none, np.zeros(0), self.N**2 / interval, none)

    def covariance_of_means(self, n: int, dt: float, block: int = 1, start: int = 0) -> np.ndarray:
        """N^2/h on the diagonal: what the model of means gives, at once."""
        return np.eye(n) * (self.N**2 / (dt * block))

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """N^2/tau, unit^2, tau (*S) in s."""
        return self.N**2 / np.asarray(tau, dtype=float)

    def psd(self, f: np.ndarray) -> np.ndarray:
        """N^2 at every frequency f (*S), Hz: unit^2/Hz, two-sided."""
        return np.full_like(np.asarray(f, dtype=float), self.N**2)


@dataclass(frozen=True)
class Rounding(White):
    """The error of rounding each sample of a rate to counts by itself.

    It is white noise where the sensor's own noise dithers the output across counts
    (lbgc.sensor.dither).
    """

    cause: ClassVar[str] = "rounding"

    @classmethod
    def to(cls, lsb: float, dt: float) -> Self:
        """The error of rounding samples at interval dt (s) to counts of `lsb`: variance LSB^2/12 a
        sample."""
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
    """Root of the two-sided PSD of the rate's derivative, unit/s/sqrt(Hz): rad/s/sqrt(s) for a
    gyro."""

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        """A constant of variance K^2 start_s at the window's start, which walks by K^2 a second."""
        return Reduced(constant=self.K**2 * start_s, walk=self.K**2)

    def means_model(self, interval: float) -> MeansModel:
        """A model of one state, w at the interval's start; w is zero at the recording's start."""
        q = self.K**2 * interval
        one = np.ones((1, 1))
        return MeansModel(one, np.ones(1), q * one, np.array([q / 2]), q / 3, 0 * one)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """K^2 tau/3, unit^2, tau (*S) in s."""
        return self.K**2 * np.asarray(tau, dtype=float) / 3

    def psd(self, f: np.ndarray) -> np.ndarray:
        """K^2/(2 pi f)^2, unit^2/Hz, two-sided, f (*S) in Hz."""
        return self.K**2 / (2 * np.pi * np.asarray(f, dtype=float)) ** 2


@dataclass(frozen=True)
class Flicker(GaussianTerm):
    """Bias instability: 1/f noise between two corners, PSD B^2/(2 pi f) inside them.

    A sum of independent stationary first-order Gauss-Markov processes whose correlation times T_i
    are a geometric series of ratio r. Each has PSD 2 s T_i/(1 + (2 pi f T_i)^2); with equal
    variances s = B^2 ln(r)/pi the sum is B^2/(2 pi f) times 1 +- 2/cosh(pi^2/ln r), a ripple below
    0.4% for r <= 4. The series runs from T_short/6 to 2 T_long. The processes that an endless
    series would have beyond one end add up, inside the band, to the PSD of the outermost process
    (which falls as f^-2 above the band's upper end and is flat below its lower end) with the weight
    s/(r - 1). So they are added to that process: its variance is s r/(r - 1).

    So the Allan deviation is sqrt(2 ln 2/pi) B = 0.664 B, within 0.5% from 2 T_short to T_long/2
    and within 1.5% at T_short and T_long themselves (IEEE Std 952, C.1.3, has no corners). The
    total variance is finite, about B^2 (ln(T_long/T_short) + 4.8)/pi, and within one recording much
    of it looks like a constant bias, as it does in real sensors.
    """

    cause: ClassVar[str] = "bias instability"
    B: float
    """Bias instability of IEEE Std 952, in the term's unit: rad/s for a gyro."""
    T_short: float = 1.0
    """Shortest averaging time of the flat floor of the Allan deviation, s."""
    T_long: float = 3600.0
    """Longest averaging time of the flat floor of the Allan deviation, s."""

    def correlation_times(self) -> np.ndarray:
        """The processes' correlation times T_i in s, ascending, shape (p,)."""
        low, high = self.T_short / 6, self.T_long * 2
        count = int(np.ceil(np.log(high / low) / np.log(4.0))) + 1
        return np.geomspace(low, high, count)

    def variances(self) -> np.ndarray:
        """The variance of each process, unit^2, shape (p,), in the order of the times."""
        times = self.correlation_times()
        ratio = times[1] / times[0]
        variances = np.full(len(times), self.B**2 * np.log(ratio) / np.pi)
        variances[[0, -1]] *= ratio / (ratio - 1)
        return variances

    @property
    def processes(self) -> tuple[tuple[float, float], ...]:
        """The variance (unit^2) and the correlation time (s) of each of its p processes."""
        return tuple(zip(self.variances().tolist(), self.correlation_times().tolist(), strict=True))

    def means_model(self, interval: float) -> MeansModel:
        """A model of p states, the values of the p processes at the interval's start."""
        return gauss_markov_model(self.variances(), self.correlation_times(), interval)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """The exact Allan variance of the p processes, corners included: unit^2, tau (*S) in s."""
        return gauss_markov_allan(self.variances(), self.correlation_times(), tau)

    def psd(self, f: np.ndarray) -> np.ndarray:
        """The exact PSD of the p processes, corners and ripple included: unit^2/Hz, f (*S), Hz."""
        return gauss_markov_psd(self.variances(), self.correlation_times(), f)


@dataclass(frozen=True)
class GaussMarkov(GaussianTerm):
    """First-order Gauss-Markov process with a stationary start: covariance sigma^2 e^(-|t|/T).

    PSD 2 sigma^2 T/(1 + (2 pi f T)^2); Allan variance 2 (V(tau) - V(2 tau)) with V the variance of
    its mean, 2 sigma^2 (T/tau)^2 (tau/T - 1 + e^(-tau/T)) (IEEE Std 952, C.1.7).
    """

    sigma: float
    """Standard deviation of the process, in the term's unit."""
    T: float
    """Correlation time, s."""

    @property
    def processes(self) -> tuple[tuple[float, float], ...]:
        """The term itself: one process of variance sigma^2 (unit^2) and correlation time T (s)."""
        return ((self.sigma**2, self.T),)

    def means_model(self, interval: float) -> MeansModel:
        """A model of one state, the value of the process at the interval's start."""
        return gauss_markov_model(np.array([self.sigma**2]), np.array([self.T]), interval)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """2 (V(tau) - V(2 tau)), V as in the class, unit^2, tau (*S) in s."""
        return gauss_markov_allan(np.array([self.sigma**2]), np.array([self.T]), tau)

    def psd(self, f: np.ndarray) -> np.ndarray:
        """2 sigma^2 T/(1 + (2 pi f T)^2), unit^2/Hz, two-sided, f (*S) in Hz."""
        return gauss_markov_psd(np.array([self.sigma**2]), np.array([self.T]), f)


@dataclass(frozen=True)
class Line(GaussianTerm):
    """Narrow-band noise around the frequency f0, with a stationary start and one of two shapes.

    With two poles it is a line whose frequency wanders: the real part of z e^(i w0 t), where z is
    complex white noise behind a low-pass of half the width (Butterworth, see BandLimited). Its PSD
    has a flat top and steep flanks, as a vibration's has, whose power lies where its frequency goes
    and nowhere else. With g = pi x width, a = g/sqrt 2: covariance sigma^2 e^(-a|t|) (cos at +
    sin a|t|) cos w0 t; PSD sigma^2 sqrt 2/g times 1/(1 + ((w - w0)/g)^4) + 1/(1 + ((w + w0)/g)^4),
    half its peak at f0 +- width/2.

    With one pole it is the rate x' of a damped resonance, x'' + 2 g x' + w0^2 x = white noise. Its
    flanks fall as the square of the distance from f0: covariance sigma^2 e^(-g|t|) (cos w1 t -
    g/w1 sin w1|t|), w1^2 = w0^2 - g^2; PSD 4 g sigma^2 w^2/((w0^2 - w^2)^2 + 4 g^2 w^2).
    """

    sigma: float
    """Standard deviation (rms), in the term's unit."""
    f0: float
    """Centre frequency, Hz."""
    width: float
    """Full width at half maximum of the PSD, Hz."""
    poles: int = 2
    """2: a wandering line with steep flanks; 1: a damped resonance, whose width is below 2 f0."""

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        """Noise of the integral that does not accumulate, of variance (sigma/(2 pi f0))^2."""
        return Reduced(angle=(self.sigma / (2 * np.pi * self.f0)) ** 2)

    def ringing(self) -> tuple[complex, complex]:
        """The complex rate s (1/s) and the complex weight W (unit^2) with which the covariance of
        a damped resonance is Re(W e^(s |t|))."""
        g = np.pi * self.width
        turn = np.sqrt(max((2 * np.pi * self.f0) ** 2 - g**2, (1e-3 * g) ** 2))
        return complex(-g, turn), self.sigma**2 * complex(1.0, g / turn)

    def means_model(self, interval: float) -> MeansModel:
        """With one pole the states are w0 x and x'. With two poles they are four: real and
        imaginary part of the low-pass's output and of its derivative over g, turning at w0."""
        g, w = np.pi * self.width, 2 * np.pi * self.f0
        if self.poles == 1:
            swinging = np.array([[0.0, w], [-w, -2 * g]])
            diffusion, start = np.diag([0.0, 4 * g * self.sigma**2]), self.sigma**2 * np.eye(2)
            return sde_means_model(swinging, diffusion, np.array([0.0, 1.0]), start, interval)
        turn = np.array([[0.0, -w], [w, 0.0]])
        low_pass = g * np.array([[0.0, 1.0], [-1.0, -2 * BUTTERWORTH]])
        F = np.kron(np.eye(2), low_pass) + np.kron(turn, np.eye(2))
        variance = self.sigma**2 * np.eye(4)
        diffusion = 4 * BUTTERWORTH * g * variance * np.diag([0.0, 1.0, 0.0, 1.0])
        return sde_means_model(F, diffusion, np.array([1.0, 0, 0, 0]), variance, interval)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """The Allan variance in closed form, unit^2, tau (*S) in s: the class's covariances are
        sums of exponentials (see `lbgc.sensor.exponential`)."""
        g, w = np.pi * self.width, 2 * np.pi * self.f0
        if self.poles == 1:
            return exponential_allan(*self.ringing(), tau)
        a = g * BUTTERWORTH
        each = [exponential_allan(a * (1j - 1) + 1j * turn, 1 - 1j, tau) for turn in (w, -w)]
        return np.asarray(self.sigma**2 / 2 * (each[0] + each[1]))

    def psd(self, f: np.ndarray) -> np.ndarray:
        """The two-sided PSD as the class states it for either shape, unit^2/Hz, f (*S) in Hz."""
        g, f = np.pi * self.width, np.asarray(f, dtype=float)
        if self.poles == 1:
            w0, w = 2 * np.pi * self.f0, 2 * np.pi * f
            return 4 * g * (self.sigma * w) ** 2 / ((w0**2 - w**2) ** 2 + (2 * g * w) ** 2)
        x, y = (2 * (f - self.f0) / self.width) ** 2, (2 * (f + self.f0) / self.width) ** 2
        return np.asarray(self.sigma**2 * np.sqrt(2) / g * (1 / (1 + x**2) + 1 / (1 + y**2)))

    def power_below(self, f: np.ndarray) -> np.ndarray:
        """The integral of the two-sided PSD from 0 to f (*S), Hz, in unit^2. It tends to sigma^2/2
        as f grows."""

        def shape(x: np.ndarray) -> np.ndarray:
            """The integral of sqrt 2/(pi (1 + t^4)) from 0 to x."""
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
    """White noise of density N behind a second-order low-pass of natural frequency `bandwidth`.

    PSD N^2/((1 - x^2)^2 + (2 damping x)^2), x = f/bandwidth; with the usual damping of 0.707
    (Butterworth) that is N^2/(1 + x^4), -3 dB at `bandwidth`. With w0 = 2 pi bandwidth the poles
    l1, l2 are w0 (-damping +- sqrt(damping^2 - 1)), the output's variance is N^2 w0/(4 damping) and
    its covariance that times (l1 e^(l2 |t|) - l2 e^(l1 |t|))/(l1 - l2). A constant passes the
    filter unchanged, and so do slow terms.
    """

    cause: ClassVar[str] = "white noise"
    N: float
    """Root of the two-sided PSD before the filter, unit/sqrt(Hz)."""
    bandwidth: float
    """Natural frequency of the low-pass, Hz."""
    damping: float = BUTTERWORTH
    """Damping ratio of the low-pass."""

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        """White noise of two-sided PSD N^2, as before the filter."""
        return Reduced(white=self.N**2)

    def _variance(self) -> float:
        """The variance of the filter's output, unit^2: N^2 w0/(4 damping)."""
        return self.N**2 * 2 * np.pi * self.bandwidth / (4 * self.damping)

    def means_model(self, interval: float) -> MeansModel:
        """A model of two states: the filter's output, and its derivative over w0."""
        w = 2 * np.pi * self.bandwidth
        F = w * np.array([[0.0, 1.0], [-1.0, -2 * self.damping]])
        diffusion = np.diag([0.0, (w * self.N) ** 2])
        start = self._variance() * np.eye(2)
        return sde_means_model(F, diffusion, np.array([1.0, 0.0]), start, interval)

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """The Allan variance in closed form, unit^2, tau (*S) in s: the output's covariance is a
        sum of two exponentials (see `lbgc.sensor.exponential`)."""
        # With critical damping the two poles coincide, and the closed form divides by zero. A
        # damping ratio that differs by 1e-6 gives the same result to rounding.
        damping = self.damping + 1e-6 * (abs(self.damping - 1) < 1e-6)
        root = np.sqrt(complex(damping**2 - 1))
        w = 2 * np.pi * self.bandwidth
        one, two = w * (-damping + root), w * (-damping - root)
        first = exponential_allan(one, -two / (one - two), tau)
        return np.asarray(
            self._variance() * (first + exponential_allan(two, one / (one - two), tau))
        )

    def psd(self, f: np.ndarray) -> np.ndarray:
        """N^2 times the filter's squared gain, at f in Hz."""
        return self.N**2 * LowPass(self.bandwidth, self.damping).gain_squared(f)


@dataclass(frozen=True)
class AngleQuantisation(GaussianTerm):
    """The error of angle increments that are read from a counter: differences of white angle
    errors.

    A sample is (q_k - q_(k-1))/h with the angle errors q independent, of variance Q^2 (for counts
    of size c whose remainder is carried over, Q = c/sqrt 12). Means telescope to (q_end -
    q_start)/tau, so the law at any rate is the same and the Allan variance is 3 Q^2/tau^2 at every
    tau = m dt (IEEE Std 952, C.1.2). q is drawn Gaussian here; counting itself stands in
    `lbgc.sensor.imu`.
    """

    Q: float
    """Standard deviation of an angle error, unit s: rad for a gyro."""

    @classmethod
    def of_count(cls, lsb: float) -> Self:
        """The error of counting an integrated output in counts of `lsb` (unit s), the remainder
        carried over to the next sample."""
        return cls(lsb / np.sqrt(12))

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        """Noise of the integral that does not accumulate, of variance Q^2."""
        return Reduced(angle=self.Q**2)

    def means_model(self, interval: float) -> MeansModel:
        """A model of one state, the angle error q at the interval's start."""
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
        """3 Q^2/tau^2, unit^2, tau (*S) in s."""
        return 3 * self.Q**2 / np.asarray(tau, dtype=float) ** 2

    def psd(self, f: np.ndarray, dt: float) -> np.ndarray:
        """The two-sided PSD of samples at interval dt (s): 4 Q^2/dt sin^2(pi f dt), about
        (2 pi f)^2 Q^2 dt at low frequency, unit^2/Hz, f (*S) in Hz."""
        return 4 * self.Q**2 / dt * np.sin(np.pi * np.asarray(f, dtype=float) * dt) ** 2


def allan_variance(terms: tuple[Any, ...], tau: np.ndarray) -> np.ndarray:
    """The Allan variance of a sum of independent terms, Gaussian or not: unit^2 (*S), at averaging
    times tau (*S), s."""
    return sum((t.allan_variance(tau) for t in terms), np.zeros(np.shape(tau)))
