"""Detection of sinusoids in a spectrum, whose ordinates are then left out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.stats

_GROUP = 200
"""Ordinates in a group of which the median is taken."""
_SMOOTHED = 5
"""Groups over which the medians are smoothed."""
_AT_ONCE = 2**20
"""Ordinates that are looked at in one go."""
_FALSE = 0.003
"""Chance, at most, that a tone is found in a recording that has none."""


@dataclass(frozen=True)
class Tone:
    """A sinusoid, that is a spectral line too narrow to be resolved."""

    f: float
    """Frequency, Hz"""
    amplitude: float
    """Amplitude, unit"""


@dataclass(frozen=True)
class Sifted:
    """The result of looking for tones among m ordinates."""

    tones: tuple[Tone, ...]
    """The tones that were found"""
    plain: np.ndarray
    """(m,), whether an ordinate is free of tones"""
    narrow: np.ndarray
    """Numbers k of the peaks that are narrow lines, and no tones"""


def sift(fine: np.ndarray, first: int, n: int, dt: float, recordings: int) -> Sifted:
    """Find the tones among ordinates, and tell them from narrow lines.

    fine : (m,), squares of coefficients summed over the recordings, unit^2 s; first : the number
    of the first of them, of n; n, dt : samples of a recording and their interval, s.

    An ordinate far above the level around it belongs to a peak. The energy of a sinusoid, n
    amplitude^2/2, falls into a few neighbouring ordinates (86% or more into five), where samples
    show the amplitude times sinc(f dt). A wider peak is one whose frequency wanders: it is a line,
    and stays in the spectrum.
    """
    if len(fine) < _GROUP:
        return Sifted((), np.ones(len(fine), bool), np.zeros(0, int))
    level = _level(fine, recordings)  # for one recording
    most = scipy.stats.chi2.isf(_FALSE / len(fine), recordings)
    parts = (slice(at, min(at + _AT_ONCE, len(fine))) for at in range(0, len(fine), _AT_ONCE))
    peaks = np.concatenate(
        [own.start + np.flatnonzero(fine[own] > level(own.start, own.stop) * most) for own in parts]
    )
    clusters = np.split(peaks, np.flatnonzero(np.diff(peaks) > 20) + 1) if len(peaks) else []
    plain = np.ones(len(fine), bool)
    found, wandering = [], np.zeros(0, int)
    for cluster in sorted(clusters, key=lambda c: -np.max(fine[c])):
        top = cluster[np.argmax(fine[cluster])]
        # Its leakage falls as energy/(pi distance)^2. Ordinates are left out as far as it exceeds a
        # twentieth of the noise.
        reach = int(np.sqrt(2 * np.sum(fine[cluster]) / recordings / level(top, top + 1)[0]))
        reach = min(max(reach, 6), len(fine) // 50)
        around = slice(max(cluster[0] - reach, 0), min(cluster[-1] + reach + 1, len(fine)))
        beside = recordings * level(around.start, around.stop)
        excess = max(float(np.sum(fine[around] - beside)), 0.0)
        if np.sum(fine[max(top - 2, 0) : top + 3]) < 0.6 * excess:
            wandering = np.append(wandering, top)
        if np.any(np.abs(wandering - top) < _GROUP):  # the line itself, or its flank
            continue
        plain[around] = False
        f = float((first + top) / (2 * n * dt))
        size = np.sqrt(2 * excess / recordings / dt / n) / np.sinc(f * dt)
        found.append(Tone(f, float(size)))
    return Sifted(tuple(found), plain, first + wandering)


def _level(fine: np.ndarray, recordings: int) -> Callable[[int, int], np.ndarray]:
    """The level of the noise around the ordinates (m,), for one recording, as a function of the
    first of some of them and the one behind the last: the medians of groups, or these smoothed over
    five groups where that is more. The median of 200 ordinates alone errs by
    12%, which would find three times as many false tones as stated."""
    groups = len(fine) // _GROUP
    halves = scipy.stats.chi2.median(recordings)
    cut = fine[: groups * _GROUP].reshape(groups, -1)
    some = (cut[at : at + _AT_ONCE // _GROUP] for at in range(0, groups, _AT_ONCE // _GROUP))
    medians = np.concatenate([np.median(own, axis=1) for own in some]) / halves
    reach = min(_SMOOTHED, groups) // 2
    padded = np.pad(np.log(medians), reach, mode="reflect" if groups > reach else "edge")
    smooth = np.exp(np.convolve(padded, np.full(2 * reach + 1, 1 / (2 * reach + 1)), "valid"))
    middles = (np.arange(groups) + 0.5) * _GROUP
    highest = np.maximum(medians, smooth)
    return lambda first, last: np.interp(np.arange(first, last), middles, highest)
