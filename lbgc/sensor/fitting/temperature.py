"""The bias of a resting sensor against its temperature, told from noise that wanders.

Bias and noise are fitted together: white noise, bias instability and random walk, and the
temperature's course times a sensitivity, which follows by weighted least squares where the noise is
known (`lbgc.sensor.fitting.warmup`). The sizes of bias instability and random walk are not known:
the interval is of the mixture over all of them, weighted by their likelihood under a prior that is
flat in each size. So a slope that a random walk explains as well has a wide interval. Means over
blocks are taken of temperature and series alike; each recording has a bias of its own.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.sensor.fitting.profile import mixture_quantiles
from lbgc.sensor.fitting.warmup import CourseLikelihood

LEAST_K = 0.1
"""Change of temperature, K, below which a recording tells nothing of its effect."""
_BLOCKS = 512
"""Block means of a recording, at most"""
_FEWEST = 64
"""Block means at the least"""
_SIZES = np.linspace(-14.0, 8.0, 45)
"""Logarithms of the weights of bias instability, and of random walk, that are tried."""

_COUNTS = 1e-4
"""Weight in the mixture, over the largest, from which on a noise counts."""


@dataclass(frozen=True)
class Sensitivity:
    """A bias's change with temperature, unit/K, with its sign."""

    value: float
    """The estimate"""
    low: float
    """Lower end of the 95% interval"""
    high: float
    """Upper end of the 95% interval"""
    span_k: float
    """The largest change of temperature in a recording, K"""

    @property
    def is_told(self) -> bool:
        """Whether the interval leaves zero out."""
        return self.low > 0 or self.high < 0


def sensitivity(
    series: np.ndarray, temperature: np.ndarray, dt: float, corners: tuple[float, float]
) -> Sensitivity | None:
    """The change of one axis's bias with temperature; None where the temperature hardly changes, or
    the recordings are too short.

    series, temperature : (R, n), unit and K; dt : s; corners : s, of the bias instability's floor.
    """
    block = max(1, series.shape[1] // _BLOCKS)
    blocks = series.shape[1] // block
    if blocks < _FEWEST:
        return None
    shape = (len(series), blocks, block)
    means, course = (
        np.asarray(x[:, : blocks * block], float).reshape(shape).mean(axis=2)
        for x in (series, temperature)
    )
    found = []
    for own, warmth in zip(means, course - course.mean(axis=1, keepdims=True), strict=True):
        if np.ptp(warmth) >= LEAST_K and np.ptp(own) > 0:
            found.append(_of_one(CourseLikelihood(own, block * dt, corners), warmth))
    if not found:
        return None
    low, value, high = np.array(found).T
    weights = 1 / (high - low) ** 2
    weights /= weights.sum()
    middle = float(weights @ value)
    below, above = (float(np.sqrt(weights**2 @ (end - value) ** 2)) for end in (low, high))
    span = float(np.ptp(course, axis=1).max())
    return Sensitivity(middle, middle - below, middle + above, span)


def _of_one(likelihood: CourseLikelihood, warmth: np.ndarray) -> tuple[float, float, float]:
    """The sensitivity by one recording, unit/K: its 95% interval's lower end, median, upper end.
    warmth : (J,), block means of the temperature about their mean, K."""
    _, _, _, v = likelihood.fit(warmth[None])
    weights = np.linalg.lstsq((likelihood.unit / v[0]).T, np.ones(v.shape[1]), rcond=None)[0]
    white = np.log(max(float(weights[0]), 1e-6))
    flicker, walk = (x.ravel() for x in np.meshgrid(_SIZES, _SIZES))
    p = np.stack([np.full(len(flicker), white), flicker, walk], axis=1)
    value, size, sigma = likelihood.at(p, warmth)
    log = -value / 2 + np.log(sigma) + (flicker + walk) / 2
    share = np.exp(log - log.max())
    kept = share > _COUNTS * share.max()
    share = share[kept] / share[kept].sum()
    ends = mixture_quantiles(share, size[kept], sigma[kept], (0.025, 0.5, 0.975))
    return float(ends[0]), float(ends[1]), float(ends[2])
