"""The output filter acting on what moves: a second-order low-pass and its group delay.

What it does to white noise is `noise.BandLimited`, what it does to a tone its gain; this is the
rest. A truth at rest passes unchanged.
"""

import numpy as np
import scipy.linalg


def low_pass(signal: np.ndarray, bandwidth: float, damping: float, dt: float) -> np.ndarray:
    """Interval means (*S, n) of the input -> interval means (*S, n) of the filter's output.

    bandwidth : Hz, the natural frequency w0/(2 pi); dt : s. Within an interval the input is held
    at its mean, so that the group delay, 2 damping/w0 at low frequency, and every step's area are
    exact; before the first interval the input stood there for ever.

    With x the output and its rate over w0, x' = F x + B u: x[k+1] = A x[k] + b u[k], and the
    output's mean over the interval is c x[k] + d u[k]. One matrix exponential gives all four.
    """
    from scipy.signal import lfilter, lfilter_zi, ss2tf  # half a second, and few sensors filter

    w = 2 * np.pi * bandwidth
    drift = np.zeros((4, 4))  # of the two states, the held input, the output's running integral
    drift[:2, :2] = w * np.array([[0.0, 1.0], [-1.0, -2 * damping]])
    drift[1, 2], drift[3, 0] = w, 1.0
    step = scipy.linalg.expm(drift * dt)
    A, b, c, d = step[:2, :2], step[:2, 2:3], step[3:, :2] / dt, step[3:, 2:3] / dt
    numerator, denominator = ss2tf(A, b, c, d)
    start = lfilter_zi(numerator[0], denominator) * signal[..., :1]
    return np.asarray(lfilter(numerator[0], denominator, signal, zi=start)[0])
