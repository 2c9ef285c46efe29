"""In-run errors that are no Gaussian noise: a ramp of random sign, and a tone of random phase.

Each has the faces that a noise term has (see lbgc.sensor.noise), by its first two moments.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, TypeAlias

import numpy as np

from lbgc.sensor.gaussian import GaussianTerm, Reduced
from lbgc.sensor.low_pass import LowPass

_TONE_BLOCK = 256


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
    """unit/s"""

    @staticmethod
    def of_uniform(uniform: np.ndarray) -> np.ndarray:
        """Signs, of numbers drawn evenly from 0 to 1, (*S) both."""
        return np.where(uniform < 0.5, -1.0, 1.0)

    def behind(self, low_pass: LowPass) -> "Ramp":
        """The ramp as it comes out of an output filter: unchanged, as what is slow is."""
        return self

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        # What the mean over a window is, and how far it changes within, are about right so.
        constant = self.R**2 * start_s * (start_s + duration_s)
        return Reduced(constant=constant, walk=self.R**2 * duration_s)

    @property
    def is_stationary(self) -> bool:
        return False

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...], dt: float) -> np.ndarray:
        sign = rng.choice([-1.0, 1.0], shape[:-1])
        return self.at(sign, shape[-1], dt)

    def sample_means(
        self, rng: np.random.Generator, shape: tuple[int, ...], dt: float, block: int
    ) -> np.ndarray:
        return self.sample(rng, shape, dt * block)

    def at(
        self, sign: np.ndarray, n: int, dt: float, start: int = 0, dtype: type = np.float64
    ) -> np.ndarray:
        """The interval means for given signs, from so many intervals after the recording's start
        on: (*S) -> (*S, n), float64 whatever dtype is asked for."""
        return np.asarray(sign)[..., None] * self.R * (np.arange(start, start + n) + 0.5) * dt

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        return self.R**2 * np.asarray(tau, dtype=float) ** 2 / 2

    def psd(self, f: np.ndarray) -> np.ndarray:
        return self.R**2 / (2 * np.pi * np.asarray(f, dtype=float)) ** 3

    def covariance_of_means(self, n: int, dt: float, block: int = 1, start: int = 0) -> np.ndarray:
        middle = self.at(np.ones(()), n, dt * block, start)
        return np.outer(middle, middle)


@dataclass(frozen=True)
class Sinusoid:
    """A tone, amplitude x sin(2 pi f t + phase), the phase uniform for each drawn series.

    Its interval means are amplitude x sinc(f h) x sin(2 pi f t_mid + phase). Allan variance
    amplitude^2 (sin^2(pi f tau)/(pi f tau))^2 (IEEE Std 952, C.1.6). All of its power is at f, so
    it has no density.
    """

    cause: ClassVar[str] = "tone"
    drawn_as: ClassVar[str] = "tone_phase"
    processes: ClassVar[tuple[tuple[float, float], ...]] = ()
    amplitude: float
    f: float
    """Hz"""

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
        return Reduced(angle=(self.amplitude / (2 * np.pi * self.f)) ** 2 / 2)

    @property
    def is_stationary(self) -> bool:
        return True

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...], dt: float) -> np.ndarray:
        return self.at(rng.uniform(0, 2 * np.pi, shape[:-1]), shape[-1], dt)

    def sample_means(
        self, rng: np.random.Generator, shape: tuple[int, ...], dt: float, block: int
    ) -> np.ndarray:
        return self.sample(rng, shape, dt * block)

    def at(
        self, phase: np.ndarray, n: int, dt: float, start: int = 0, dtype: type = np.float64
    ) -> np.ndarray:
        """The interval means at given phases: phase (*S) in rad, at the first interval's start,
        whichever that is -> (*S, n), of this dtype.

        By blocks, within which sin(a + b) = sin a cos b + cos a sin b: few sines are taken.
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
        x = self.f * np.asarray(tau, dtype=float)
        return self.amplitude**2 * (np.sinc(x) * np.sin(np.pi * x)) ** 2

    def covariance_of_means(self, n: int, dt: float, block: int = 1, start: int = 0) -> np.ndarray:
        lag = np.subtract.outer(np.arange(n), np.arange(n)) * dt * block
        power = (self.amplitude * np.sinc(self.f * dt * block)) ** 2 / 2
        return power * np.cos(2 * np.pi * self.f * lag)


def vibration(
    amplitude: float, hz: float, phase: np.ndarray, n: int, interval: float
) -> np.ndarray:
    """Interval means of a steady vibration, (*S, n), for phases (*S), rad."""
    return Sinusoid(amplitude, hz).at(phase, n, interval)


STARTED: tuple[type["Started"], ...] = (Sinusoid, Ramp)
"""Kinds of which one number an axis is drawn at a recording's start, in the order of drawing."""
Started: TypeAlias = Sinusoid | Ramp
InRun: TypeAlias = GaussianTerm | Started
"""Whatever evolves within a recording."""
