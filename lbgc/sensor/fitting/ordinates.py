"""A static series' cosine transform, as the noise likelihood takes it.

The orthonormal DCT-II coefficients are used as independent normal numbers. Cosines suit that: a
random walk's are independent on an interval whose mean was removed (they are its differences'
eigenfunctions), white noise's exactly, and the constant bias is the one coefficient left out.

Low coefficients are taken one by one; high ones are gathered into bins: within a bin the spectrum
is smooth, or narrow enough to be a line that the model averages over it, so its power is all that
matters. An hour at 100 Hz is some 1,500 numbers.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft

from lbgc.sensor.fitting.cosine_variance import Grid
from lbgc.sensor.fitting.tones import Tone, sift

_SINGLE = 256
_BINS_PER_E_FOLD = 40
_BINS = 1000
_AROUND = 60


@dataclass(frozen=True, eq=False)
class Ordinates:
    """A series' cosine transform, as the likelihood takes it. Powers are unit^2 s (as a PSD)."""

    n: int
    dt: float
    low: np.ndarray
    """(R, K), coefficients 1..K of each recording (not squared), times the square root of dt"""
    k: np.ndarray
    """(M,), which coefficients of n: of a bin, its middle"""
    power: np.ndarray
    """(M,), sum of squares in a bin"""
    count: np.ndarray
    """(M,), how many"""
    tones: tuple[Tone, ...] = ()
    """Found and left out of the bins."""
    rounding: float = 0.0
    """unit^2 s: white noise that is known to be the samples' rounding, and no term of the model."""

    @property
    def recordings(self) -> int:
        return len(self.low)

    @property
    def f(self) -> np.ndarray:
        """(M,), Hz, of the bins"""
        return self.grid.f

    @cached_property
    def grid(self) -> Grid:
        return Grid(self.n, self.dt, self.k, self.count / self.recordings)


def ordinates(series: np.ndarray, dt: float) -> Ordinates:
    """Ordinates of one recording. series : (n,), unit; dt : s."""
    return pooled(series[None], dt)


def pooled(series: np.ndarray, dt: float) -> Ordinates:
    """Ordinates of several recordings of one process. series : (R, n), unit; dt : s."""
    recordings, n = series.shape
    split = min(_SINGLE, n // 2) + 1
    low, power = np.empty((recordings, split - 1)), np.zeros(n - split)
    for i, one in enumerate(series):
        coefficients = scipy.fft.dct(one - np.mean(one, dtype=float), norm="ortho") * np.sqrt(dt)
        low[i] = coefficients[1:split]
        power += coefficients[split:] ** 2
    k = np.arange(split, n)
    sifted = sift(power, k, n, dt, recordings)
    k, power = k[sifted.plain], power[sifted.plain]
    edges = _edges(split, n, sifted.narrow)
    which = np.searchsorted(edges, k, side="right")
    count = np.bincount(which, minlength=len(edges) + 1)
    used = count > 0
    count, sums = count[used], np.bincount(which, power, minlength=len(edges) + 1)[used]
    middle = np.bincount(which, k, minlength=len(edges) + 1)[used] / count
    return Ordinates(
        n,
        dt,
        low,
        np.concatenate([np.arange(1, split), middle]),
        np.concatenate([np.sum(low**2, axis=0), sums]),
        np.concatenate([np.ones(split - 1), count]) * recordings,
        sifted.tones,
    )


def _edges(split: int, n: int, narrow: np.ndarray) -> np.ndarray:
    """The bins' first coefficients: a share of the frequency wide, but no wider than a thousandth
    of the band; and a few coefficients each around a line that is narrower than that."""
    edges = [split]
    while edges[-1] < n:
        step = min(edges[-1] / _BINS_PER_E_FOLD, n / _BINS)
        edges.append(edges[-1] + max(1, round(step)))
    around = (k + np.arange(-_AROUND, _AROUND + 1, 4) for k in narrow)
    return np.unique(np.concatenate([edges, *around]).clip(split, n))
