"""Spikes and short knocks in a resting recording, and the recording without them.

Each sample's distance from the running mean is told in units of the spread around it (by the median
absolute deviation, which a few wild samples do not move). The mean is of samples that are clipped
first where they are far from the running median; of a clean recording none are, so that distances
are a linear filter's, and as normal as the noise. Those too far for that are found by Benjamini and
Hochberg's rule: so far that at most one in a hundred of all that are found would be noise. The
threshold is high in a clean recording and falls with the number of outliers. A knock is longer than
its farthest samples: what is loud around these goes with them.

The mean runs over two seconds. Where the noise itself wanders farther in that time than from sample
to sample it runs over fewer samples, down to nine, and only what is shorter is found.

Found stretches are replaced by the mean without them, and the noise of a clean stretch beside them,
in reverse, so that no power is lost: with a few thousandths replaced the noise is told as well as
from a recording without outliers.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.ndimage
import scipy.stats

FALSE = 0.01
"""Share of noise among the samples that are found, at most, on average."""
LONGEST_S = 1.0
"""Knocks of up to this length are found, s."""
_FEWEST = 101
"""Samples over which mean and median run, at the least, unless the noise wanders."""
_SHORT = 9
"""Samples of the shortest running mean."""
_WANDERS = 1.5
"""The spread around a running mean over that around the shortest, from which on the noise is taken
to wander."""
_CLIPPED = 6.0
"""Standard deviations from the running median at which samples are clipped before they are
averaged."""
_BLOCK = 8192
"""Samples from which the spread is taken."""
_MAD = 0.6745
"""Median absolute deviation of normal noise over its standard deviation."""
_AROUND = 16
"""Samples among which loud ones are counted."""
_LOUD, _MANY = 2.0, 5
"""Standard deviations from which on a sample is loud, and how many of those around make a knock of
them: in normal noise a chance of one in a thousand."""
_TRIED = 50
"""Stretches on either side that are tried as a source of noise."""


@dataclass(frozen=True)
class Outliers:
    """What was taken for spikes and knocks in the recordings of one axis."""

    samples: int
    """Samples that were replaced"""
    places: int
    """Stretches that they make"""
    share: float
    """The samples' share of all"""
    largest: float
    """The largest distance from the running mean, unit"""
    threshold: float
    """The least distance of a sample that was found by itself, in standard deviations; infinite
    where there is none"""


def without_outliers(series: np.ndarray, dt: float) -> tuple[np.ndarray, Outliers | None]:
    """Recordings (R, n), unit, of one axis without spikes and knocks, and what these were; None,
    and the recordings as they are, where counts hide the spread. dt : s."""
    recordings, n = series.shape
    values = np.array(series, float)
    away = _from_mean(values, min(max(_FEWEST, round(2 * LONGEST_S / dt)), n // 8))
    if away is None:
        return series, None
    middle, window = away
    distance = values - middle
    spread = np.stack([_spread(x) for x in distance])
    if not (spread > 0).all():
        return series, None
    sigmas = np.abs(distance) / spread
    far = _too_far(sigmas)
    found = np.stack([_with_knocks(f, s) for f, s in zip(far, sigmas, strict=True)])
    places = 0
    for x, flags in zip(values, found, strict=True):
        runs = _runs(flags)
        places += len(runs)
        taken = np.concatenate([[0], np.cumsum(flags)])
        clean = np.flatnonzero(~flags)
        between = np.interp(np.arange(n), clean, x[clean]) if runs else x
        mean = scipy.ndimage.uniform_filter1d(between, window, mode="nearest")
        noise = x - mean
        for first, last in runs:
            x[first:last] = mean[first:last] + _noise_beside(noise, taken, first, last)
    count = int(found.sum())
    return values, Outliers(
        count,
        places,
        count / (recordings * n),
        float(np.abs(distance[found]).max(initial=0.0)),
        float(sigmas[far].min(initial=np.inf)),
    )


def _from_mean(series: np.ndarray, longest: int) -> tuple[np.ndarray, int] | None:
    """The running mean of recordings, (R, n), without what is far from the running median, and the
    samples that it is taken over: `longest`, or so few that the noise does not wander in them. None
    where counts hide the spread."""
    median = np.stack([scipy.ndimage.median_filter(x, longest, mode="nearest") for x in series])
    off = series - median
    bound = _CLIPPED * np.median(np.abs(off)) / _MAD
    if not bound > 0:
        return None
    clipped = median + np.clip(off, -bound, bound)
    shortest = scipy.ndimage.uniform_filter1d(clipped, _SHORT, mode="nearest")
    least = np.median(np.abs(series - shortest))
    window = longest
    while window > 2 * _SHORT:
        mean = scipy.ndimage.uniform_filter1d(clipped, window, mode="nearest")
        if np.median(np.abs(series - mean)) < _WANDERS * least:
            return mean, window
        window //= 2
    return shortest, _SHORT


def _spread(away: np.ndarray) -> np.ndarray:
    """The standard deviation around each sample, (n,), by medians over blocks."""
    n = len(away)
    edges = np.linspace(0, n, max(n // _BLOCK, 1) + 1).astype(int)
    spans = list(pairwise(edges))
    blocks = [np.median(np.abs(away[a:b])) / _MAD for a, b in spans]
    return np.asarray(np.interp(np.arange(n), [(a + b) / 2 for a, b in spans], blocks))


def _too_far(sigmas: np.ndarray) -> np.ndarray:
    """Which samples are too far for normal noise, by their distances in standard deviations."""
    flat = np.sort(sigmas[sigmas > 3.0])[::-1]
    chance = 2 * scipy.stats.norm.sf(flat)
    good = np.flatnonzero(chance <= FALSE * np.arange(1, len(flat) + 1) / sigmas.size)
    return np.asarray(sigmas >= (flat[good[-1]] if len(good) else np.inf))


def _with_knocks(far: np.ndarray, sigmas: np.ndarray) -> np.ndarray:
    """The samples that are too far, (n,), with the loud stretches that have such a sample."""
    loud = np.asarray(sigmas > _LOUD, float)
    many = scipy.ndimage.uniform_filter1d(loud, _AROUND, mode="constant") * _AROUND > _MANY - 0.5
    labels, count = scipy.ndimage.label(many | far)
    with_far = np.zeros(count + 1, bool)
    with_far[labels[far]] = True
    with_far[0] = False
    return np.asarray(with_far[labels])


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """The first sample of each stretch, and the first behind it."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in ends.reshape(-1, 2)]


def _noise_beside(noise: np.ndarray, taken: np.ndarray, first: int, last: int) -> np.ndarray:
    """Noise for the samples from `first` to `last`, of the nearest clean stretch before or behind
    them, reversed. taken : (n + 1,), how many samples before each were found."""
    size = last - first
    for k in range(1, _TRIED + 1):
        for start in (first - k * size, last + (k - 1) * size):
            stop = start + size
            if start >= 0 and stop <= len(noise) and taken[stop] == taken[start]:
                return noise[start:stop][::-1]
    return np.zeros(size)
