"""A static series' cosine transform, as the noise likelihood takes it.

The orthonormal DCT-II coefficients are used as independent normal numbers. Cosines suit that: a
random walk's are nearly independent on an interval whose mean was removed (they are its
eigenfunctions in continuous time), white noise's exactly, and the constant bias is the one
coefficient left out.

Low frequencies are taken from block means, whose variances the model gives exactly, start of the
random walk and corners of the flicker included. High frequencies are taken from the samples and
gathered into bins: within a bin the spectrum is smooth, or narrow enough to be a line that the
model averages over it, so its power is all that matters.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
import scipy.stats

_BLOCKS = 1024
_BINS_PER_E_FOLD = 40
_AROUND = 60


@dataclass(frozen=True)
class Tone:
    """A spectral line too narrow to resolve: a sinusoid."""

    f: float
    """Hz"""
    amplitude: float
    """unit"""


@dataclass(frozen=True)
class Ordinates:
    """A series' cosine transform, as the likelihood takes it. Powers are unit^2 s (as a PSD)."""

    n: int
    dt: float
    block: int
    low: np.ndarray
    """(R, K), of block means, coefficients 1..K of each recording (not squared), times the square
    root of the block's length."""
    f: np.ndarray
    """(M,), Hz, of the high-frequency bins"""
    power: np.ndarray
    """(M,), sum of squares in a bin"""
    count: np.ndarray
    """(M,), how many"""
    tones: tuple[Tone, ...] = ()
    """Found and left out of the bins."""
    rounding: float = 0.0
    """unit^2 s: white noise that is known to be the samples' rounding, and no term of the model."""

    @property
    def blocks(self) -> int:
        return self.n // self.block

    @property
    def width(self) -> np.ndarray:
        """(M,), Hz, of the bins: an ordinate of each recording stands for 1/(2 n dt)."""
        return self.count / len(self.low) / (2 * self.n * self.dt)

    @property
    def interval(self) -> float:
        return self.dt * self.block


def pooled(series: np.ndarray, dt: float) -> Ordinates:
    """Of several recordings of one process. series : (R, n), unit; dt : s."""
    each = [ordinates(one, dt) for one in series]
    if len(each) == 1:
        return each[0]
    first = each[0]
    # Tones leave holes of their own in each recording, so bins are matched by their index.
    bins = [np.round(np.log(o.f) * 1e4).astype(int) for o in each]
    common = set(bins[0]).intersection(*bins[1:])
    pick = [np.array([b in common for b in own]) for own in bins]
    return replace(
        first,
        low=np.concatenate([o.low for o in each]),
        f=first.f[pick[0]],
        power=np.sum([o.power[p] for o, p in zip(each, pick, strict=True)], axis=0),
        count=np.sum([o.count[p] for o, p in zip(each, pick, strict=True)], axis=0),
    )


def ordinates(series: np.ndarray, dt: float) -> Ordinates:
    """series : (n,), unit; dt : s."""
    block = max(1, len(series) // _BLOCKS)
    blocks = len(series) // block
    y = np.asarray(series[: blocks * block], dtype=float) - np.mean(series, dtype=float)
    low = scipy.fft.dct(y.reshape(blocks, block).mean(axis=1), norm="ortho")
    split = blocks if block == 1 else blocks // 2
    low = low[None, 1:split] * np.sqrt(dt * block)
    fine = np.square(scipy.fft.dct(y, norm="ortho")[split:]) * dt
    k = np.arange(split, len(y))
    tones, plain, wandering = _tones(fine, k, len(y), dt)
    k, fine = k[plain], fine[plain]
    bins = int(_BINS_PER_E_FOLD * np.log(len(y) / split)) + 2
    edges = np.geomspace(split, len(y), bins).round().astype(int)
    # A line may be narrower than a bin: there, one for every few ordinates.
    around = (k_of_line + np.arange(-_AROUND, _AROUND + 1, 4) for k_of_line in wandering)
    edges = np.unique(np.concatenate([edges, *around]).clip(split, len(y)))
    which = np.searchsorted(edges, k, side="right")
    count = np.bincount(which, minlength=len(edges) + 1)
    used = count > 0
    count, power = count[used], np.bincount(which, fine, minlength=len(edges) + 1)[used]
    middle = np.bincount(which, k, minlength=len(edges) + 1)[used] / count
    return Ordinates(len(y), dt, block, low, middle / (2 * len(y) * dt), power, count, tones)


def _tones(
    fine: np.ndarray, k: np.ndarray, n: int, dt: float
) -> tuple[tuple[Tone, ...], np.ndarray, np.ndarray]:
    """Sinusoids among the ordinates, which ordinates are free of them, and the k of the peaks that
    are lines.

    An ordinate over its neighbourhood's median (0.455 of the mean of chi^2_1) is a tone's where
    noise would give one such in a hundred recordings. A sinusoid's energy, n amplitude^2/2, falls
    into a handful of neighbours (86% or more into five); what samples show of it is amplitude x
    sinc(f dt). A peak that spreads wider wanders: it is a line, and stays.
    """
    width = 200
    groups = max(1, len(fine) // width)
    medians = np.median(fine[: groups * width].reshape(groups, -1), axis=1)
    level = np.interp(np.arange(len(fine)), (np.arange(groups) + 0.5) * width, medians) / 0.455
    peaks = np.flatnonzero(fine > level * scipy.stats.chi2.isf(0.01 / len(fine), 1))
    clusters = np.split(peaks, np.flatnonzero(np.diff(peaks) > 20) + 1) if len(peaks) else []
    plain = np.ones(len(fine), bool)
    found, wandering = [], np.zeros(0, int)
    for cluster in sorted(clusters, key=lambda c: -np.max(fine[c])):
        top = cluster[np.argmax(fine[cluster])]
        # Its leakage falls as energy/(pi distance)^2: left out to a twentieth of the noise.
        reach = int(np.sqrt(2 * np.sum(fine[cluster]) / level[top]))
        reach = min(max(reach, 6), len(fine) // 50)
        around = slice(max(cluster[0] - reach, 0), cluster[-1] + reach + 1)
        excess = max(float(np.sum(fine[around] - level[around])), 0.0)
        if np.sum(fine[max(top - 2, 0) : top + 3]) < 0.6 * excess:
            wandering = np.append(wandering, top)
        if np.any(np.abs(wandering - top) < width):  # the line itself, or its flank
            continue
        plain[around] = False
        f = float(k[top] / (2 * n * dt))
        found.append(Tone(f, float(np.sqrt(2 * excess / dt / n) / np.sinc(f * dt))))
    return tuple(found), plain, k[wandering]
