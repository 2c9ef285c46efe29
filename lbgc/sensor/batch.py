"""Means of many recordings at once: the law of `Triad.measure_means`, row by row, with what lasts
longer than a recording given and everything else drawn afresh."""

from dataclasses import dataclass

import numpy as np

from lbgc.sensor import gaussian, noise
from lbgc.sensor.imu import Disturbance, Triad


@dataclass(frozen=True)
class Lasting:
    """Errors that recordings begin with, one row a recording."""

    bias: np.ndarray
    """(W, 3), the unit's and the session's together"""
    matrix: np.ndarray
    """(W, 3, 3), M"""
    g_sensitivity: np.ndarray
    """(W, 3, 3)"""
    bias_per_k: np.ndarray
    """(W, 3)"""
    scale_per_k: np.ndarray
    """(W, 3)"""

    def rows(self, pick: np.ndarray) -> "Lasting":
        return Lasting(**{name: values[pick] for name, values in vars(self).items()})


def measure_means(
    triad: Triad,
    rng: np.random.Generator,
    truth: np.ndarray,
    lasting: Lasting,
    n: int,
    dt: float,
    block: int,
    force: np.ndarray | None = None,
    warming: Disturbance | None = None,
    start: int = 0,
) -> np.ndarray:
    """What the sensor prints on average over blocks, (W, n, 3), of which `start` lie between the
    recording's start and the first: noise that wanders has come so far.

    truth, force : (W, n or 1, 3), block means of what is measured and of the specific force, once
    where nothing moves; dt : s, the sensor's own interval. An output filter on what moves is left
    out: where the plate turns steadily it only lags, and by far less than a block.
    """
    count = len(truth)
    interval = dt * block
    bias = lasting.bias + rng.standard_normal((count, 3)) * triad.bias_run
    signal = truth @ np.swapaxes(np.eye(3) + lasting.matrix, 1, 2) + bias[:, None]
    if force is not None:
        signal += force @ np.swapaxes(lasting.g_sensitivity, 1, 2)
    if warming is not None and warming.rise_k != 0:
        warmth = warming.rise(start + n, interval)[start:, None]
        of_warmth = lasting.bias_per_k[:, None] + lasting.scale_per_k[:, None] * truth
        signal = signal + of_warmth * warmth
    signal = signal + gaussian.sample_axes(triad.terms_of_means(dt), rng, count, n, interval, start)
    for axis in range(3):
        if triad.tone[axis] > 0:
            phases = rng.uniform(0, 2 * np.pi, (count,))
            signal[..., axis] += triad.tone_of(axis).at_phase(phases, n, interval)
        if triad.R[axis] > 0:
            sign = rng.choice([-1.0, 1.0], count)
            ramp = noise.Ramp(triad.R[axis]).with_sign(sign, start + n, interval)
            signal[..., axis] += ramp[:, start:]
    return signal
