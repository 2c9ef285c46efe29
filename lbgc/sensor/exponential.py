"""Processes whose covariance is made of exponentials: closed forms of what their means do, each by
its series where it would cancel."""

import numpy as np

from lbgc.sensor.gaussian import MeansModel


def gauss_markov_model(s: np.ndarray, times: np.ndarray, interval: float) -> MeansModel:
    """Means model of a sum of Gauss-Markov processes of variances s: each over h = u T, started at
    x, ends at e^-u x + ... and has mean g x + ..., g = (1 - e^-u)/u; given x, with V as in
    `_mean_variance`, var(end) = s (1 - e^-2u), cov(end, mean) = s g (1 - e^-u) and
    var(mean) = s (V(u) - g^2)."""
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
    """V(tau) - cov of neighbours = 2 (V(tau) - V(2 tau))."""
    u = np.asarray(tau, dtype=float)[..., None] / times
    return np.asarray(np.sum(s * 2 * (_mean_variance(u) - _mean_variance(2 * u)), axis=-1))


def gauss_markov_psd(s: np.ndarray, times: np.ndarray, f: np.ndarray) -> np.ndarray:
    x = 2 * np.pi * np.asarray(f, dtype=float)[..., None] * times
    return np.asarray(np.sum(2 * s * times / (1 + x**2), axis=-1))


def exponential_allan(rate: complex, weight: complex, tau: np.ndarray) -> np.ndarray:
    """Allan variance of a process with covariance Re(weight e^(rate |t|)):
    V(tau) = 2 Re(weight (e^(rate tau) - 1 - rate tau)/(rate tau)^2)."""

    def variance(t: np.ndarray) -> np.ndarray:
        z = rate * t
        small = np.abs(z) < 1e-2
        safe = np.where(small, 1.0, z)
        series = 0.5 + z / 6 + z**2 / 24 + z**3 / 120 + z**4 / 720 + z**5 / 5040
        return 2 * np.real(weight * np.where(small, series, (np.expm1(safe) - safe) / safe**2))

    t = np.asarray(tau, dtype=float)
    return np.asarray(2 * (variance(t) - variance(2 * t)))


def _mean_variance(u: np.ndarray) -> np.ndarray:
    """Variance of a unit Gauss-Markov process's mean over u correlation times:
    2 (u - 1 + e^-u)/u^2, by its series 1 - u/3 + u^2/12 - ... where that cancels."""
    small = u < 0.1
    series = 1 - u / 3 + u**2 / 12 - u**3 / 60 + u**4 / 360 - u**5 / 2520 + u**6 / 20160
    safe = np.where(small, 1.0, u)
    return np.where(small, series, 2 * (safe + np.expm1(-safe)) / safe**2)


def _conditional_mean_variance(u: np.ndarray) -> np.ndarray:
    """Variance of a unit Gauss-Markov process's mean over u, given its value at the start:
    V(u) - ((1 - e^-u)/u)^2, by its series 2u/3 - u^2/2 + 7u^3/30 - ... where that cancels."""
    small = u < 0.02
    series = 2 * u / 3 - u**2 / 2 + 7 * u**3 / 30 - u**4 / 12 + 31 * u**5 / 1260
    safe = np.where(small, 1.0, u)
    closed = _mean_variance(safe) - (np.expm1(-safe) / safe) ** 2
    return np.where(small, series, closed)
