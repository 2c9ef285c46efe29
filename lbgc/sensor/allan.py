"""Allan analysis of recordings; the deviations themselves are allantools'."""

from collections.abc import Iterable

import allantools
import numpy as np


def octave_taus(n: int, dt: float, most: float = 0.25) -> np.ndarray:
    """Averaging times dt, 2 dt, 4 dt, ... up to a share `most` of the record's n samples, in s."""
    octaves = int(np.floor(np.log2(max(n * most, 1))))
    return dt * 2.0 ** np.arange(octaves + 1)


def overlapping_deviation(rates: Iterable[np.ndarray], dt: float, taus: np.ndarray) -> np.ndarray:
    """Overlapping Allan deviation of rate-like samples, pooled over recordings.

    rates : R recordings of A axes, each (n, A), rad/s or m/s^2, an array of all or one after the
    other; dt : s; taus : (K,), s, each a whole multiple of dt. Returns (A, K): the root of the mean
    variance over recordings.

    The paper's eq. 25 lacks the 1/tau^2 that makes it IEEE Std 952's; this is the standard's.
    """
    variances = []
    for record in rates:
        own = np.full((record.shape[1], len(taus)), np.nan)
        for axis in range(record.shape[1]):
            _, deviation, _, _ = allantools.oadev(
                record[:, axis].astype(float), rate=1 / dt, data_type="freq", taus=taus
            )
            own[axis, : len(deviation)] = deviation**2
        variances.append(own)
    return np.asarray(np.sqrt(np.mean(variances, axis=0)))


def confidence_band(
    deviation: np.ndarray, taus: np.ndarray, n: int, dt: float, slopes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """95% band of an overlapping Allan deviation, by the degrees of freedom of its noise type.

    deviation, taus, slopes : (K,); slopes are the model's, of log deviation against log tau: they
    tell the noise type at each tau. n : samples of the one series. Returns low, high, (K,).
    """
    low, high = np.empty_like(deviation), np.empty_like(deviation)
    for k, (value, tau, slope) in enumerate(zip(deviation, taus, slopes, strict=True)):
        # slope -1: phase noise (alpha 2), -1/2: white rate (0), 0: flicker (-1), 1/2: walk (-2)
        alpha = int(np.clip(np.round(-2 * slope - 1), -2, 0)) if slope > -0.75 else 2
        freedom = allantools.edf_greenhall(alpha, 2, round(tau / dt), n + 1, overlapping=True)
        low[k], high[k] = allantools.confidence_interval(value, freedom, ci=0.95)
    return low, high
