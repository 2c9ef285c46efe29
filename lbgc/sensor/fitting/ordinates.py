"""The cosine transform of a static series, in the form that the noise likelihood needs.

The orthonormal DCT-II coefficients are taken as independent normal numbers. Cosines suit that:
those of a random walk are independent on an interval whose mean was removed (they are the
eigenfunctions of its differences), those of white noise are exactly so, and the constant bias is
the one coefficient that is left out.

Low coefficients are taken one by one, and high ones are gathered into bins. Within a bin either the
spectrum is smooth or there is a line, which the model averages over the bin, so that the bin's
power is all that matters. An hour at 100 Hz becomes some 1,500 numbers.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft

from lbgc.sensor.fitting.cosine_variance import Grid
from lbgc.sensor.fitting.tones import Tone, sift

_SINGLE = 256
"""Coefficients that are taken one by one, at most."""
_BINS_PER_E_FOLD = 40
"""Bins per factor e of frequency."""
_BINS = 1000
"""The whole band over the width of the widest bin."""
_AROUND = 60
"""Coefficients on either side of a narrow line where bins are of four coefficients."""


@dataclass(frozen=True, eq=False)
class Ordinates:
    """The cosine transform of R recordings of one process, single coefficients and bins. Powers are
    in unit^2 s, as a PSD."""

    n: int
    """Samples of a recording"""
    dt: float
    """The samples' interval, s"""
    low: np.ndarray
    """(R, K), coefficients 1..K of each recording (not squared), times the square root of dt"""
    k: np.ndarray
    """(M,), the coefficients' numbers, of n; of a bin, its middle"""
    power: np.ndarray
    """(M,), sum of squares of a bin's coefficients, over all recordings"""
    count: np.ndarray
    """(M,), number of coefficients in that sum"""
    tones: tuple[Tone, ...] = ()
    """Sinusoids that were found, and left out of the bins"""
    rounding: float = 0.0
    """Density of white noise that is known to be the samples' rounding, and is no term of the
    model: unit^2 s"""

    @property
    def recordings(self) -> int:
        """The number of recordings R."""
        return len(self.low)

    @property
    def f(self) -> np.ndarray:
        """(M,), the ordinates' frequencies, Hz."""
        return self.grid.f

    @cached_property
    def grid(self) -> Grid:
        """The coefficients of one recording, for which a model gives variances."""
        return Grid(self.n, self.dt, self.k, self.count / self.recordings)


def ordinates(series: np.ndarray, dt: float) -> Ordinates:
    """The ordinates of one recording. series : (n,), unit; dt : s."""
    return pooled(series[None], dt)


def pooled(series: np.ndarray, dt: float) -> Ordinates:
    """The ordinates of several recordings of one process, taken together: each recording's mean is
    removed, tones are left out, and powers are summed. series : (R, n), unit; dt : s."""
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
    """The first coefficient of each bin. Bins are as wide as a fortieth of the frequency, but not
    wider than a thousandth of the band, and of four coefficients around narrow lines."""
    edges = [split]
    while edges[-1] < n:
        step = min(edges[-1] / _BINS_PER_E_FOLD, n / _BINS)
        edges.append(edges[-1] + max(1, round(step)))
    around = (k + np.arange(-_AROUND, _AROUND + 1, 4) for k in narrow)
    return np.unique(np.concatenate([edges, *around]).clip(split, n))
