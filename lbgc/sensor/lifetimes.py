"""A bias split by lifetime: what a unit keeps, what a power-up adds, and what each recording adds.

This is the one-way analysis of variance with unequal groups (Searle, Casella & McCulloch 1992,
ch. 3). With S sessions of n_s recordings, R in all, the expected mean square within sessions is
run^2, and the one between sessions run^2 + n0 session^2, n0 = (R - sum n_s^2/R)/(S - 1).
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

LEVEL = 0.95
"""Confidence level of every interval here."""
_TAILS = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)
"""The probabilities below the two ends of an interval."""


@dataclass(frozen=True)
class Lifetimes:
    """A unit's bias and the standard deviations of what sessions and runs add to it, for each of A
    axes, in the errors' unit."""

    bias: np.ndarray
    """(A,), the constant bias"""
    bias_sigma: np.ndarray
    """(A,), the standard error of the bias"""
    bias_freedom: int
    """Degrees of freedom of that standard error"""
    run_sigma: np.ndarray
    """(A,), standard deviation of the recordings about the bias, or about their session's mean
    where there are several sessions"""
    session_sigma: np.ndarray | None
    """(A,), standard deviation of the sessions' own biases, zero where the scatter within sessions
    explains that of their means; None where there is one session, or as many as recordings"""
    run_interval: np.ndarray
    """(2, A), 95% interval of `run_sigma`, by chi-square"""
    session_interval: np.ndarray | None
    """(2, A), 95% interval of `session_sigma` (Williams and Tukey)"""

    @property
    def bias_interval(self) -> np.ndarray:
        """(2, A), 95% interval of the bias, by Student's t."""
        return student_interval(self.bias, self.bias_sigma, self.bias_freedom)


def student_interval(value: np.ndarray, sigma: np.ndarray, freedom: float) -> np.ndarray:
    """95% interval of an estimate by Student's t with these degrees of freedom of its standard
    error: low and high, (2, ...), in the estimate's unit."""
    half = stats.t.ppf(_TAILS[1], freedom) * sigma
    return np.stack([value - half, value + half])


def by_lifetime(
    error: np.ndarray, session: np.ndarray, *, within: int = 0, between: int = 0
) -> Lifetimes:
    """Split the bias errors of R recordings by lifetime.

    error : (R, A), any unit, R >= 2; session : (R,), any labels; within, between : how many other
    parameters were fitted before to the scatter within sessions, or to the sessions' means.
    """
    _, which, sizes = np.unique(session, return_inverse=True, return_counts=True)
    count, groups = len(error), len(sizes)
    if groups in (1, count):  # sessions cannot be told from runs: all scatter is the runs'
        freedom = count - 1 - (within if groups == 1 else between)
        square = np.sum((error - error.mean(axis=0)) ** 2, axis=0) / freedom
        spread = np.sqrt(square)
        sigma = spread / np.sqrt(count)
        interval = _chi_square_interval(square, freedom)
        return Lifetimes(error.mean(axis=0), sigma, freedom, spread, None, interval, None)
    means = np.stack([error[which == s].mean(axis=0) for s in range(groups)])
    inner, outer = count - groups - within, groups - 1 - between
    inside = np.sum((error - means[which]) ** 2, axis=0) / inner
    among = sizes @ (means - error.mean(axis=0)) ** 2 / outer
    effective = (count - np.sum(sizes**2) / count) / (groups - 1)
    variance = np.maximum((among - inside) / effective, 0.0)
    each = variance + inside / sizes[:, None]  # variance of a session's mean, (S, A)
    weight = 1 / np.maximum(each, np.finfo(float).tiny)
    return Lifetimes(
        bias=np.sum(weight * means, axis=0) / weight.sum(axis=0),
        bias_sigma=1 / np.sqrt(weight.sum(axis=0)),
        bias_freedom=outer,
        run_sigma=np.sqrt(inside),
        session_sigma=np.sqrt(variance),
        run_interval=_chi_square_interval(inside, inner),
        session_interval=_session_interval(among, inside, outer, inner, effective),
    )


def _chi_square_interval(square: np.ndarray, freedom: int) -> np.ndarray:
    """95% interval, (2, A), of a standard deviation, given its mean square (A,) with this many
    degrees of freedom."""
    low, high = stats.chi2.ppf(_TAILS[::-1], freedom)
    return np.asarray(np.sqrt(np.stack([freedom * square / low, freedom * square / high])))


def _session_interval(
    among: np.ndarray, inside: np.ndarray, outer: int, inner: int, effective: float
) -> np.ndarray:
    """95% interval of the sessions' standard deviation, (2, A) (Searle et al. 1992, sec. 3.6d).

    among, inside : (A,), mean squares between and within sessions, with `outer` and `inner` degrees
    of freedom; effective : n0 of the module. The interval is exact where the ratio of the mean
    squares alone counts and where sessions dominate, and holds 95% in between.
    """
    ends = []
    for tail in _TAILS[::-1]:
        explained = inside * stats.f.ppf(tail, outer, inner)
        square = outer * (among - explained) / (effective * stats.chi2.ppf(tail, outer))
        ends.append(np.sqrt(np.maximum(square, 0.0)))
    return np.stack(ends)
