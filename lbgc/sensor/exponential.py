"""Closed forms for processes whose covariance is a sum of exponentials: the state-space model of
their means, Allan variance and PSD. Each form is replaced by its series where it would cancel."""

import numpy as np

from lbgc.sensor.means_model import MeansModel


def gauss_markov_model(s: np.ndarray, times: np.ndarray, interval: float) -> MeansModel:
    """The model of the interval means of a sum of first-order Gauss-Markov processes. Its states
    are the values of the processes at the interval's start.

    s, times : (p,), the processes' variances, unit^2, and correlation times, s; interval : s.
    Over an interval h = u T that starts at x, a process ends at e^-u x plus noise, and has the mean
    g x plus noise, g = (1 - e^-u)/u. Given x, with V as in `_mean_variance`, var(end) =
    s (1 - e^-2u), cov(end, mean) = s g (1 - e^-u) and var(mean) = s (V(u) - g^2).
    """
    u = interval / times
    gain = -np.expm1(-u) / u
    return MeansModel(
        A=np.diag(np.exp(-u)),
        C=gain,
        Q=np.diag(s * -np.expm1(-2 * u)),
        S=s * gain * -np.expm1(-u),
        R=float(np.sum(s * _conditional_mean_variance(u))),
        P0=np.diag(s),
    )


def gauss_markov_allan(s: np.ndarray, times: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Allan variance of a sum of first-order Gauss-Markov processes, of variances s (p,), unit^2,
    and correlation times (p,), s: unit^2 (*S), at averaging times tau (*S), s.

    With V(tau) the variance of a mean over tau, it is V(tau) less the covariance of neighbouring
    means, which is 2 (V(tau) - V(2 tau)).
    """
    u = np.asarray(tau, dtype=float)[..., None] / times
    return np.asarray(np.sum(s * 2 * (_mean_variance(u) - _mean_variance(2 * u)), axis=-1))


def gauss_markov_psd(s: np.ndarray, times: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Two-sided PSD of a sum of first-order Gauss-Markov processes, the sum over the processes of
    2 s T/(1 + (2 pi f T)^2), unit^2/Hz, f (*S) in Hz; s (p,) in unit^2, times (p,) in s."""
    x = 2 * np.pi * np.asarray(f, dtype=float)[..., None] * times
    return np.asarray(np.sum(2 * s * times / (1 + x**2), axis=-1))


def exponential_allan(rate: complex, weight: complex, tau: np.ndarray) -> np.ndarray:
    """Allan variance 2 (V(tau) - V(2 tau)) of a process with covariance Re(weight e^(rate |t|)),
    whose means have the variance V(tau) = 2 Re(weight (e^(rate tau) - 1 - rate tau)/(rate tau)^2).

    rate : 1/s, real part below zero; weight : unit^2; tau : (*S), s. Returns unit^2 (*S).
    """

    def variance(t: np.ndarray) -> np.ndarray:
        z = rate * t
        small = np.abs(z) < 1e-2
        safe = np.where(small, 1.0, z)
        series = 0.5 + z / 6 + z**2 / 24 + z**3 / 120 + z**4 / 720 + z**5 / 5040
        return 2 * np.real(weight * np.where(small, series, (np.expm1(safe) - safe) / safe**2))

    t = np.asarray(tau, dtype=float)
    return np.asarray(2 * (variance(t) - variance(2 * t)))


def _mean_variance(u: np.ndarray) -> np.ndarray:
    """Variance V(u) of the mean of a Gauss-Markov process of variance 1 over u correlation times:
    2 (u - 1 + e^-u)/u^2, by its series 1 - u/3 + u^2/12 - ... where that cancels."""
    small = u < 0.1
    series = 1 - u / 3 + u**2 / 12 - u**3 / 60 + u**4 / 360 - u**5 / 2520 + u**6 / 20160
    safe = np.where(small, 1.0, u)
    return np.where(small, series, 2 * (safe + np.expm1(-safe)) / safe**2)


def _conditional_mean_variance(u: np.ndarray) -> np.ndarray:
    """Variance of the mean of a Gauss-Markov process of variance 1 over u correlation times, given
    its value at the start: V(u) - ((1 - e^-u)/u)^2, by its series 2u/3 - u^2/2 + 7u^3/30 - ...
    where that cancels."""
    small = u < 0.02
    series = 2 * u / 3 - u**2 / 2 + 7 * u**3 / 30 - u**4 / 12 + 31 * u**5 / 1260
    safe = np.where(small, 1.0, u)
    closed = _mean_variance(safe) - (np.expm1(-safe) / safe) ** 2
    return np.where(small, series, closed)
