"""Allan analysis of recordings; the deviations themselves are allantools'."""

import allantools
import numpy as np


def octave_taus(n: int, dt: float, most: float = 0.25) -> np.ndarray:
    """Averaging times dt, 2 dt, 4 dt, ... up to a share `most` of the record's n samples, in s."""
    octaves = int(np.floor(np.log2(max(n * most, 1))))
    return dt * 2.0 ** np.arange(octaves + 1)


def overlapping_deviation(rates: np.ndarray, dt: float, taus: np.ndarray) -> np.ndarray:
    """Overlapping Allan deviation of rate-like samples, pooled over recordings.

    rates : (R, n, 3), rad/s or m/s^2, R recordings of one kind; dt : s; taus : (K,), s, each
    a whole multiple of dt. Returns (3, K): the root of the mean variance over recordings.

    The paper's eq. 25 lacks the 1/tau^2 that makes it IEEE Std 952's; this is the standard's.
    """
    variances = np.empty((len(rates), 3, len(taus)))
    for r, record in enumerate(rates):
        for axis in range(3):
            _, deviation, _, _ = allantools.oadev(
                record[:, axis].astype(float), rate=1 / dt, data_type="freq", taus=taus
            )
            variances[r, axis, : len(deviation)] = deviation**2
            variances[r, axis, len(deviation) :] = np.nan
    return np.sqrt(variances.mean(axis=0))
