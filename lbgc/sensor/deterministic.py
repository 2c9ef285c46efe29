"""In-run errors that are not Gaussian noise: a ramp of random sign, and a tone of random phase.

Each has the faces of a noise term (see lbgc.sensor.noise); its faces are right in the first two
moments, mean and covariance.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, TypeAlias

import numpy as np

from lbgc.sensor.gaussian import GaussianTerm, Reduced
from lbgc.sensor.low_pass import LowPass

_TONE_BLOCK = 256
"""Samples of a tone that are made from one sine and cosine."""


@dataclass(frozen=True)
class Ramp:
    """Rate ramp +-R t from the recording's start, the sign drawn for each series.

    The mean over (t - h, t] is +-R (t - h/2). Allan variance R^2 tau^2/2, exactly, in every
    realisation (IEEE Std 952, C.1.5, whose PSD for it, R^2/(2 pi f)^3, is nominal).
    """

    cause: ClassVar[str] = "ramp"
    drawn_as: ClassVar[str] = "ramp_sign"
    peak: ClassVar[float] = 0.0
    processes: ClassVar[tuple[tuple[float, float], ...]] = ()
    R: float
    """Size of the ramp, unit/s."""

    @staticmethod
    def of_uniform(uniform: np.ndarray) -> np.ndarray:
        """Signs, of numbers drawn evenly from 0 to 1, (*S) both."""
        return np.where(uniform < 0.5, -1.0, 1.0)

    def behind(self, low_pass: LowPass) -> "Ramp":
        """The ramp as it comes out of an output filter: unchanged, as what is slow is."""
        return self

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        """A constant that walks, with about the variance that the ramp's mean over the window has,
        and about the change within the window."""
        constant = self.R**2 * start_s * (start_s + duration_s)
        return Reduced(constant=constant, walk=self.R**2 * duration_s)

    @property
    def is_stationary(self) -> bool:
        """Never: a ramp grows from the recording's start."""
        return False

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...], dt: float) -> np.ndarray:
        """Draw one sign for each series, and give its samples at interval dt (s): (*S, n), unit."""
        sign = rng.choice([-1.0, 1.0], shape[:-1])
        return self.at(sign, shape[-1], dt)

    def sample_means(
        self, rng: np.random.Generator, shape: tuple[int, ...], dt: float, block: int
    ) -> np.ndarray:
        """Draw means over `block` samples at interval dt (s): samples at interval dt x block."""
        return self.sample(rng, shape, dt * block)

    def at(
        self, sign: np.ndarray, n: int, dt: float, start: int = 0, dtype: type = np.float64
    ) -> np.ndarray:
        """The interval means for given signs, from so many intervals after the recording's start
        on: (*S) -> (*S, n), float64 whatever dtype is asked for."""
        return np.asarray(sign)[..., None] * self.R * (np.arange(start, start + n) + 0.5) * dt

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """R^2 tau^2/2, unit^2, tau (*S) in s."""
        return self.R**2 * np.asarray(tau, dtype=float) ** 2 / 2

    def psd(self, f: np.ndarray) -> np.ndarray:
        """The nominal PSD of IEEE Std 952, R^2/(2 pi f)^3, unit^2/Hz, f (*S) in Hz."""
        return self.R**2 / (2 * np.pi * np.asarray(f, dtype=float)) ** 3

    def covariance_of_means(self, n: int, dt: float, block: int = 1, start: int = 0) -> np.ndarray:
        """Covariance of n means over `block` samples each, the first of them `start` such means
        after the recording's start: R^2 t_j t_k, t the middles of the blocks, (n, n), unit^2."""
        middle = self.at(np.ones(()), n, dt * block, start)
        return np.outer(middle, middle)


@dataclass(frozen=True)
class Sinusoid:
    """A tone, amplitude x sin(2 pi f t + phase), with a phase drawn uniformly for each series.

    Its interval means are amplitude x sinc(f h) x sin(2 pi f t_mid + phase). Allan variance
    amplitude^2 (sin^2(pi f tau)/(pi f tau))^2 (IEEE Std 952, C.1.6). All of its power is at f, so
    it has no density.
    """

    cause: ClassVar[str] = "tone"
    drawn_as: ClassVar[str] = "tone_phase"
    processes: ClassVar[tuple[tuple[float, float], ...]] = ()
    amplitude: float
    """Amplitude, in the term's unit."""
    f: float
    """Frequency, Hz."""

    @property
    def peak(self) -> float:
        """How far it swings from zero."""
        return self.amplitude

    @staticmethod
    def of_uniform(uniform: np.ndarray) -> np.ndarray:
        """Phases, rad, of numbers drawn evenly from 0 to 1, (*S) both."""
        return np.asarray(2 * np.pi * uniform)

    def behind(self, low_pass: LowPass) -> "Sinusoid":
        """The tone as it comes out of an output filter."""
        return replace(
            self, amplitude=self.amplitude * float(np.sqrt(low_pass.gain_squared(self.f)))
        )

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        """Noise of the integral that does not accumulate, of variance
        (amplitude/(2 pi f))^2/2."""
        return Reduced(angle=(self.amplitude / (2 * np.pi * self.f)) ** 2 / 2)

    @property
    def is_stationary(self) -> bool:
        """Always: the phase is uniform, so the law is the same at every time."""
        return True

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...], dt: float) -> np.ndarray:
        """Draw one phase for each series, and give samples at interval dt (s): (*S, n), unit."""
        return self.at(rng.uniform(0, 2 * np.pi, shape[:-1]), shape[-1], dt)

    def sample_means(
        self, rng: np.random.Generator, shape: tuple[int, ...], dt: float, block: int
    ) -> np.ndarray:
        """Draw means over `block` samples at interval dt (s): samples at interval dt x block."""
        return self.sample(rng, shape, dt * block)

    def at(
        self, phase: np.ndarray, n: int, dt: float, start: int = 0, dtype: type = np.float64
    ) -> np.ndarray:
        """The interval means at given phases: phase (*S) in rad, at the first interval's start,
        whichever that is -> (*S, n), of this dtype.

        Samples are made in blocks by sin(a + b) = sin a cos b + cos a sin b, with a the phase at
        the block's start and b the phase since, so that few sines are evaluated.
        """
        size = min(n, _TONE_BLOCK)
        step, blocks = 2 * np.pi * self.f * dt, -(-n // size)
        a = np.asarray(phase)[..., None] + step * (np.arange(blocks) * size + 0.5)
        b = step * np.arange(size)
        starts = self.amplitude * np.sinc(self.f * dt) * np.stack([np.sin(a), np.cos(a)], axis=-1)
        within = np.stack([np.cos(b), np.sin(b)])
        wave: np.ndarray = starts.astype(dtype) @ within.astype(dtype)  # (*S, blocks, size)
        return wave.reshape(*np.shape(phase), blocks * size)[..., :n]

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """amplitude^2 (sin^2(pi f tau)/(pi f tau))^2, unit^2, tau (*S) in s."""
        x = self.f * np.asarray(tau, dtype=float)
        return self.amplitude**2 * (np.sinc(x) * np.sin(np.pi * x)) ** 2

    def covariance_of_means(self, n: int, dt: float, block: int = 1, start: int = 0) -> np.ndarray:
        """Covariance of n means over `block` samples each: amplitude^2 sinc^2(f h)/2 times
        cos(2 pi f lag), h the blocks' length, (n, n), unit^2. `start` changes nothing."""
        lag = np.subtract.outer(np.arange(n), np.arange(n)) * dt * block
        power = (self.amplitude * np.sinc(self.f * dt * block)) ** 2 / 2
        return power * np.cos(2 * np.pi * self.f * lag)


def vibration(
    amplitude: float, hz: float, phase: np.ndarray, n: int, interval: float
) -> np.ndarray:
    """Interval means of a steady vibration of frequency `hz` (Hz) and given phases (*S), rad:
    (*S, n), in the amplitude's unit, with intervals in s."""
    return Sinusoid(amplitude, hz).at(phase, n, interval)


STARTED: tuple[type["Started"], ...] = (Sinusoid, Ramp)
"""Kinds of which one number an axis is drawn at a recording's start, in the order of drawing."""
Started: TypeAlias = Sinusoid | Ramp
InRun: TypeAlias = GaussianTerm | Started
"""Whatever evolves within a recording."""
