"""A sensor's output filter, a second-order low-pass with its group delay, applied to the truth.

Its effect on white noise is `noise.BandLimited`, and its effect on a tone is a gain; this file
filters the signal. A truth at rest passes unchanged.
"""

import numpy as np
import scipy.linalg


def low_pass(signal: np.ndarray, bandwidth: float, damping: float, dt: float) -> np.ndarray:
    """Filter a signal: from the interval means (*S, n) of the input to the interval means (*S, n)
    of the filter's output.

    bandwidth : Hz, the natural frequency w0/(2 pi); dt : s. Within an interval the input is held
    at its mean, so that the group delay, 2 damping/w0 at low frequency, and the area of every step
    are exact. Before the first interval the input is taken to have been at its first mean for ever.

    With x the output and its rate over w0, x' = F x + B u: x[k+1] = A x[k] + b u[k], and the
    output's mean over the interval is c x[k] + d u[k]. One matrix exponential gives all four.
    """
    from scipy.signal import lfilter, lfilter_zi, ss2tf  # its import takes 0.5 s, and few need it

    w = 2 * np.pi * bandwidth
    # The order is: the filter's two states, the held input, the running integral of the output.
    drift = np.zeros((4, 4))
    drift[:2, :2] = w * np.array([[0.0, 1.0], [-1.0, -2 * damping]])
    drift[1, 2], drift[3, 0] = w, 1.0
    step = scipy.linalg.expm(drift * dt)
    A, b, c, d = step[:2, :2], step[:2, 2:3], step[3:, :2] / dt, step[3:, 2:3] / dt
    numerator, denominator = ss2tf(A, b, c, d)
    start = lfilter_zi(numerator[0], denominator) * signal[..., :1]
    return np.asarray(lfilter(numerator[0], denominator, signal, zi=start)[0])
