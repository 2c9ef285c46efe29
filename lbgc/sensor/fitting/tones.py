"""Sinusoids among the ordinates of a spectrum, found and left out."""

from dataclasses import dataclass

import numpy as np
import scipy.stats

_GROUP = 200
_SMOOTHED = 5
_FALSE = 0.003
"""Chance of a tone in a recording that has none, at the most."""


@dataclass(frozen=True)
class Tone:
    """A spectral line too narrow to resolve: a sinusoid."""

    f: float
    """Hz"""
    amplitude: float
    """unit"""


@dataclass(frozen=True)
class Sifted:
    """What became of the ordinates."""

    tones: tuple[Tone, ...]
    plain: np.ndarray
    """(m,), which ordinates are free of them"""
    narrow: np.ndarray
    """the k of peaks that are lines, narrow ones"""


def sift(fine: np.ndarray, k: np.ndarray, n: int, dt: float, recordings: int) -> Sifted:
    """Tell tones from what wanders.

    fine : (m,), squares summed over the recordings, unit^2 s; k : (m,), which ordinates of n.

    An ordinate far above its neighbourhood's level is a tone's. A sinusoid's energy, n
    amplitude^2/2, falls into a handful of neighbours (86% or more into five); what samples show of
    it is amplitude x sinc(f dt). A peak that spreads wider wanders: it is a line, and stays.
    """
    if len(fine) < _GROUP:
        return Sifted((), np.ones(len(fine), bool), np.zeros(0, int))
    level = _level(fine, recordings)  # of one recording's ordinates
    peaks = np.flatnonzero(fine > level * scipy.stats.chi2.isf(_FALSE / len(fine), recordings))
    clusters = np.split(peaks, np.flatnonzero(np.diff(peaks) > 20) + 1) if len(peaks) else []
    plain = np.ones(len(fine), bool)
    found, wandering = [], np.zeros(0, int)
    for cluster in sorted(clusters, key=lambda c: -np.max(fine[c])):
        top = cluster[np.argmax(fine[cluster])]
        # Its leakage falls as energy/(pi distance)^2: left out to a twentieth of the noise.
        reach = int(np.sqrt(2 * np.sum(fine[cluster]) / recordings / level[top]))
        reach = min(max(reach, 6), len(fine) // 50)
        around = slice(max(cluster[0] - reach, 0), cluster[-1] + reach + 1)
        excess = max(float(np.sum(fine[around] - recordings * level[around])), 0.0)
        if np.sum(fine[max(top - 2, 0) : top + 3]) < 0.6 * excess:
            wandering = np.append(wandering, top)
        if np.any(np.abs(wandering - top) < _GROUP):  # the line itself, or its flank
            continue
        plain[around] = False
        f = float(k[top] / (2 * n * dt))
        size = np.sqrt(2 * excess / recordings / dt / n) / np.sinc(f * dt)
        found.append(Tone(f, float(size)))
    return Sifted(tuple(found), plain, k[wandering])


def _level(fine: np.ndarray, recordings: int) -> np.ndarray:
    """The noise around each ordinate, of one recording: the medians of groups, and those smoothed
    over five groups where that is more. A median of 200 alone is 12% off, which would let three
    times as many through as were meant to."""
    groups = len(fine) // _GROUP
    halves = scipy.stats.chi2.median(recordings)
    medians = np.median(fine[: groups * _GROUP].reshape(groups, -1), axis=1) / halves
    reach = min(_SMOOTHED, groups) // 2
    padded = np.pad(np.log(medians), reach, mode="reflect" if groups > reach else "edge")
    smooth = np.exp(np.convolve(padded, np.full(2 * reach + 1, 1 / (2 * reach + 1)), "valid"))
    middles = (np.arange(groups) + 0.5) * _GROUP
    return np.asarray(np.interp(np.arange(len(fine)), middles, np.maximum(medians, smooth)))
