"""The output filter: a second-order low-pass, and what it does to whatever passes it."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

BUTTERWORTH = float(np.sqrt(0.5))
"""Damping of a maximally flat second-order low-pass."""


@dataclass(frozen=True)
class LowPass:
    """A second-order low-pass, 1/(1 + 2 damping s/w0 + (s/w0)^2) with w0 = 2 pi bandwidth.

    With the usual damping of 0.707 (Butterworth) its gain is -3 dB at `bandwidth`. A truth at rest
    passes unchanged. What it does to white noise is `lbgc.sensor.noise.BandLimited`.
    """

    bandwidth: float
    """Hz, the natural frequency"""
    damping: float = BUTTERWORTH

    def gain_squared(self, f: np.ndarray | float) -> np.ndarray:
        """The squared gain at f (Hz), 1/((1 - x^2)^2 + (2 damping x)^2) with x = f/bandwidth."""
        x = np.asarray(f, dtype=float) / self.bandwidth
        return 1 / ((1 - x**2) ** 2 + (2 * self.damping * x) ** 2)

    def filtered(self, signal: np.ndarray, dt: float) -> np.ndarray:
        """Interval means (*S, n) of the input -> interval means (*S, n) of the filter's output.

        dt : s. Within an interval the input is held at its mean, so that the group delay,
        2 damping/w0 at low frequency, and every step's area are exact; before the first interval
        the input stood there for ever.

        With x the output and its rate over w0, x' = F x + B u: x[k+1] = A x[k] + b u[k], and the
        output's mean over the interval is c x[k] + d u[k]. One matrix exponential gives all four.
        """
        from scipy.signal import lfilter, lfilter_zi, ss2tf  # half a second, and few sensors filter

        w = 2 * np.pi * self.bandwidth
        drift = np.zeros((4, 4))  # of the two states, the held input, the output's running integral
        drift[:2, :2] = w * np.array([[0.0, 1.0], [-1.0, -2 * self.damping]])
        drift[1, 2], drift[3, 0] = w, 1.0
        step = scipy.linalg.expm(drift * dt)
        A, b, c, d = step[:2, :2], step[:2, 2:3], step[3:, :2] / dt, step[3:, 2:3] / dt
        numerator, denominator = ss2tf(A, b, c, d)
        start = lfilter_zi(numerator[0], denominator) * signal[..., :1]
        return np.asarray(lfilter(numerator[0], denominator, signal, zi=start)[0])
