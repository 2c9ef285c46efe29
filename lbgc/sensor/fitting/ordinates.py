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
_AT_ONCE = 2**20
"""Coefficients that are binned at once, about."""
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
    low, power = np.empty((recordings, split - 1)), np.zeros(0)
    for i, one in enumerate(series):
        coefficients = transformed(one, dt)
        low[i] = coefficients[1:split]
        np.square(coefficients, out=coefficients)
        power = power + coefficients[split:] if i else coefficients[split:]
    sifted = sift(power, split, n, dt, recordings)
    count, sums, numbers = _binned(power, sifted.plain, split, _edges(split, n, sifted.narrow))
    used = count > 0
    count, sums, middle = count[used], sums[used], numbers[used] / count[used]
    return Ordinates(
        n,
        dt,
        low,
        np.concatenate([np.arange(1, split), middle]),
        np.concatenate([np.sum(low**2, axis=0), sums]),
        np.concatenate([np.ones(split - 1), count]) * recordings,
        sifted.tones,
    )


def transformed(one: np.ndarray, dt: float) -> np.ndarray:
    """The coefficients of one recording (n,) less its mean, times the square root of dt: (n,)."""
    own = one - np.mean(one, dtype=float)
    found = scipy.fft.dct(own, norm="ortho", overwrite_x=True)
    found *= np.sqrt(dt)
    return np.asarray(found)


def _binned(
    power: np.ndarray, plain: np.ndarray, split: int, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The number, the sum of powers and the sum of the coefficients' numbers of each bin, without
    tones. power, plain : (m,), of the coefficients from `split` on, and whether each is free of
    tones; edges : the bins' first coefficients. A bin is added up in one go, many bins at once."""
    ends = np.append(edges[1:], split + len(power))
    found: list[list[np.ndarray]] = [[], [], []]
    first = 0
    while first < len(edges):
        last = max(first + 1, int(np.searchsorted(ends, edges[first] + _AT_ONCE, side="right")))
        rows = slice(int(edges[first]) - split, int(ends[last - 1]) - split)
        free = plain[rows]
        k = np.arange(rows.start + split, rows.stop + split)[free]
        which = np.searchsorted(edges[first:last], k, side="right") - 1
        for own, weights in zip(found, (None, power[rows][free], k), strict=True):
            own.append(np.bincount(which, weights, last - first))
        first = last
    count, sums, numbers = (np.concatenate(own) for own in found)
    return count, sums, numbers


def _edges(split: int, n: int, narrow: np.ndarray) -> np.ndarray:
    """The first coefficient of each bin. Bins are as wide as a fortieth of the frequency, but not
    wider than a thousandth of the band, and of four coefficients around narrow lines."""
    edges = [split]
    while edges[-1] < n:
        step = min(edges[-1] / _BINS_PER_E_FOLD, n / _BINS)
        edges.append(edges[-1] + max(1, round(step)))
    around = (k + np.arange(-_AROUND, _AROUND + 1, 4) for k in narrow)
    return np.unique(np.concatenate([edges, *around]).clip(split, n))
