"""Allan analysis of recordings; the deviations themselves are computed by allantools."""

from collections.abc import Iterable

import allantools
import numpy as np


def octave_taus(n: int, dt: float, most: float = 0.25) -> np.ndarray:
    """Averaging times dt, 2 dt, 4 dt, ... up to the share `most` of a recording of n samples, s."""
    octaves = int(np.floor(np.log2(max(n * most, 1))))
    return dt * 2.0 ** np.arange(octaves + 1)


def overlapping_deviation(rates: Iterable[np.ndarray], dt: float, taus: np.ndarray) -> np.ndarray:
    """Overlapping Allan deviation of rate-like samples, pooled over recordings.

    rates : R recordings of A axes, each (n, A), rad/s or m/s^2, as one array or one after the
    other; dt : s; taus : (K,), s, each a whole multiple of dt. Returns (A, K): the root of the
    Allan variance's mean over the recordings.

    It is the deviation of IEEE Std 952; the paper's eq. 25 lacks that standard's factor 1/tau^2.
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
