"""Allan analysis of recordings; the confidence of deviations is computed by allantools."""

from collections.abc import Iterable

import allantools
import numpy as np

_AT_ONCE = 2**16
"""Samples that are differenced at once."""


def octave_taus(n: int, dt: float, most: float = 0.25) -> np.ndarray:
    """Averaging times dt, 2 dt, 4 dt, ... up to the share `most` of a recording of n samples, s."""
    octaves = int(np.floor(np.log2(max(n * most, 1))))
    return dt * 2.0 ** np.arange(octaves + 1)


def overlapping_deviation(rates: Iterable[np.ndarray], dt: float, taus: np.ndarray) -> np.ndarray:
    """Overlapping Allan deviation of rate-like samples, pooled over recordings.

    rates : R recordings of A axes, each (n, A), rad/s or m/s^2, as one array or one after the
    other; dt : s; taus : (K,), s, each a whole multiple of dt. Returns (A, K): the root of the
    Allan variance's mean over the recordings; NaN where they are too short.

    It is the deviation of IEEE Std 952; the paper's eq. 25 lacks that standard's factor 1/tau^2.
    With the angle x, of n + 1 samples,

        sigma^2(m dt) = mean over i of (x[i + 2m] - 2 x[i + m] + x[i])^2 / (2 m^2 dt^2).
    """
    variances = []
    for record in rates:
        own = [_variances(record[:, axis], dt, taus) for axis in range(record.shape[1])]
        variances.append(own)
    return np.asarray(np.sqrt(np.mean(variances, axis=0)))


def _variances(rate: np.ndarray, dt: float, taus: np.ndarray) -> np.ndarray:
    """Overlapping Allan variances (K,) of one axis's samples (n,)."""
    x = np.empty(len(rate) + 1)
    x[0] = 0.0
    np.cumsum(rate, out=x[1:])
    found = np.full(len(taus), np.nan)
    for k, m in enumerate(np.round(taus / dt).astype(int)):
        count, total = len(x) - 2 * m, 0.0
        if count < 1:
            continue
        for first in range(0, count, _AT_ONCE):
            last = min(first + _AT_ONCE, count)
            bend = x[first + 2 * m : last + 2 * m] - 2 * x[first + m : last + m] + x[first:last]
            total += float(bend @ bend)
        found[k] = total / count / (2 * m**2)
    return found


def confidence_band(
    deviation: np.ndarray, taus: np.ndarray, n: int, dt: float, slopes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """95% confidence band of an overlapping Allan deviation, by the degrees of freedom of the noise
    type at each averaging time.

    deviation, taus, slopes : (K,); the slopes are those of the model's log deviation over log tau,
    and tell the noise type. n : samples of the one series; dt : s. Returns low and high, (K,) each.
    """
    low, high = np.empty_like(deviation), np.empty_like(deviation)
    for k, (value, tau, slope) in enumerate(zip(deviation, taus, slopes, strict=True)):
        # Slope -1 is quantisation (alpha 2), -1/2 white rate noise (0), 0 flicker (-1), and 1/2
        # rate random walk (-2).
        alpha = int(np.clip(np.round(-2 * slope - 1), -2, 0)) if slope > -0.75 else 2
        freedom = allantools.edf_greenhall(alpha, 2, round(tau / dt), n + 1, overlapping=True)
        low[k], high[k] = allantools.confidence_interval(value, freedom, ci=0.95)
    return low, high
