"""How loud a sway is at the frequencies that a fit over a window looks like to it.

The error of a linear fit g' r to stationary r has variance sum of gamma_k (g * g)_k, gamma the
autocovariance of r as the residuals show it, tapered by Parzen's window (a third of the window
long) so that the sum cannot be negative.
"""

import numpy as np

STUDENT = 1.1
"""nu/(nu - 2), by which dividing by a variance of nu degrees of freedom raises the mean of squared
ratios: measured without it, 1.18 to 1.20 for white velocity and 1.00 to 1.06 for a sway about 1 Hz
(windows of 10 and 30 s). This lies between. With it a sway of a narrow band (1.5 Hz, damping 0.03,
10 s) gives 0.65, on differences 0.54: sigma is then too large by a quarter and a third
(`make study-estimators`)."""


def autocorrelation(series: np.ndarray) -> np.ndarray:
    """Sums of products at lags 0, 1, ... along the first axis, the others left as they are."""
    size = 2 * len(series)
    power = np.abs(np.fft.rfft(series, size, axis=0)) ** 2
    return np.fft.irfft(power, size, axis=0)[: len(series)]


def kernel(g: np.ndarray) -> np.ndarray:
    """What sums of products of residuals, at lags 0, 1, ..., are weighted by: (n, ...) ->
    (n // 3 + 1, ...). Both sides of lag zero are in it."""
    n = len(g)
    x = np.arange(n // 3 + 1) / (n // 3)
    taper = np.where(x <= 0.5, 1 - 6 * x**2 + 6 * x**3, 2 * (1 - x) ** 3)
    twice = np.where(x > 0, 2, 1) * taper / n
    return autocorrelation(g)[: len(x)] * twice.reshape(-1, *([1] * (g.ndim - 1)))


def velocity_noise(velocity: np.ndarray, columns: np.ndarray, g: np.ndarray) -> float:
    """The variance, (m/s)^2, of the white velocity that would err the fit's g as much as what the
    columns do not explain of this one.

    velocity : (n, 2), m/s; columns : (n, p), what a velocity can be without a sway, where it counts
    (zero elsewhere); g : (n, p'), those of them, orthonormal, that north looks like.
    """
    basis = np.linalg.qr(columns)[0]
    counts = np.any(columns != 0, axis=1)
    left = np.where(counts[:, None], velocity, 0.0)
    left = left - basis @ (basis.T @ left)
    weights = kernel(g).sum(axis=1)
    found, taken = (
        float(np.sum(weights @ autocorrelation(v)[: len(weights)])) for v in (left, basis)
    )
    return found / 2 / (len(g.T) * float(np.mean(counts)) - taken)
