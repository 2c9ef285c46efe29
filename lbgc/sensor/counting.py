"""How a sensor's output is counted: each sample of a rate by itself, or increments of its integral.

Rounding samples adds white noise, and counting increments adds IEEE Std 952's quantisation, where
the sensor's own noise shakes the output across counts (`lbgc.sensor.dither` says where it does).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np

from lbgc.sensor.gaussian import GaussianTerm
from lbgc.sensor.noise import AngleQuantisation, Rounding


@dataclass(frozen=True)
class RateCounts:
    """A rate (or force) output: each sample is rounded to whole counts."""

    part: ClassVar[str] = "lsb"
    is_carried: ClassVar[bool] = False
    lsb: float
    """rad/s or m/s^2"""

    def noise(self, dt: float) -> GaussianTerm:
        """What rounding adds to samples of dt s: white noise of LSB^2/12 a sample."""
        return Rounding.to(self.lsb, dt)

    def scale(self, dt: float) -> float:
        """SI units of a rate per stored count."""
        return self.lsb

    def counted(self, signal: np.ndarray, dt: float) -> np.ndarray:
        """The counts of samples (3, n), float32, which are overwritten: int32 (3, n)."""
        np.divide(signal, np.float32(self.lsb), out=signal)
        counts = signal.view(np.int32)  # in the same memory, for fresh memory is not free
        np.rint(signal, out=counts, casting="unsafe")
        return counts

    def dither(self, sigma: Callable[[float], float], dt: float, mean_s: float) -> float:
        """The noise that shakes the output across counts, 1 sigma in the count's unit, where means
        over h seconds have noise sigma(h): that of the samples."""
        return sigma(dt)


@dataclass(frozen=True)
class CarriedCounts:
    """An angle (or velocity) output: whole counts of each increment are given out, and the rest is
    carried over to the next."""

    part: ClassVar[str] = "carried_lsb"
    is_carried: ClassVar[bool] = True
    lsb: float
    """rad or m/s"""

    def noise(self, dt: float) -> GaussianTerm:
        """What counting adds, at any interval of samples: quantisation of LSB/sqrt(12)."""
        return AngleQuantisation.of_count(self.lsb)

    def scale(self, dt: float) -> float:
        """SI units of a rate per stored count, of samples of dt s."""
        return self.lsb / dt

    def counted(self, signal: np.ndarray, dt: float) -> np.ndarray:
        """The counts of each increment of samples (3, n) of dt s: int32 (3, n)."""
        total = np.cumsum(signal, axis=1, dtype=np.float64) * (dt / self.lsb)
        return np.diff(np.rint(total), axis=1, prepend=0.0).astype(np.int32)

    def dither(self, sigma: Callable[[float], float], dt: float, mean_s: float) -> float:
        """The noise that shakes the output across counts, 1 sigma in the count's unit, where means
        over h seconds have noise sigma(h): that of the angle within a mean, for it is rounded once
        a mean."""
        return sigma(mean_s) * mean_s


Counts: TypeAlias = RateCounts | CarriedCounts
