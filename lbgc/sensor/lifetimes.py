"""A bias split by lifetime: what a unit keeps, what a power-up adds, what each recording adds.

The one-way analysis of variance with unequal groups (Searle, Casella & McCulloch 1992, ch. 3): with
S sessions of n_s recordings, R in all, the mean square within sessions is run^2, the one between
them run^2 + n0 session^2, n0 = (R - sum n_s^2/R)/(S - 1).
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

LEVEL = 0.95
"""Confidence level of every interval here."""
_TAILS = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)


@dataclass(frozen=True)
class Lifetimes:
    """A constant and what scatters about it, each of A axes, in the errors' unit."""

    bias: np.ndarray
    """(A,), the constant"""
    bias_sigma: np.ndarray
    """(A,), its standard error"""
    bias_freedom: int
    """Degrees of freedom of that standard error"""
    run_sigma: np.ndarray
    """(A,), spread of the recordings about it, about their session's where there are several"""
    session_sigma: np.ndarray | None
    """(A,), spread of the sessions' own, zero where the scatter within sessions explains theirs;
    None where there is one session, or as many as recordings"""
    run_interval: np.ndarray
    """(2, A), 95%, of the run's, by chi-square"""
    session_interval: np.ndarray | None
    """(2, A), 95%, of the session's (Williams and Tukey)"""

    @property
    def bias_interval(self) -> np.ndarray:
        """(2, A), 95%, by Student's t."""
        return student_interval(self.bias, self.bias_sigma, self.bias_freedom)


def student_interval(value: np.ndarray, sigma: np.ndarray, freedom: float) -> np.ndarray:
    """95% interval of an estimate whose standard error has so many degrees of freedom: low and
    high, (2, ...)."""
    half = stats.t.ppf(_TAILS[1], freedom) * sigma
    return np.stack([value - half, value + half])


def by_lifetime(
    error: np.ndarray, session: np.ndarray, *, within: int = 0, between: int = 0
) -> Lifetimes:
    """Split these errors.

    error : (R, A), any unit, R >= 2; session : (R,), any labels; within, between : how many other
    parameters were fitted to the scatter within sessions, or to the sessions' means, before.
    """
    _, which, sizes = np.unique(session, return_inverse=True, return_counts=True)
    count, groups = len(error), len(sizes)
    if groups in (1, count):  # no session, or nothing but sessions: all of it is the run
        freedom = count - 1 - (within if groups == 1 else between)
        square = np.sum((error - error.mean(axis=0)) ** 2, axis=0) / freedom
        spread = np.sqrt(square)
        sigma = spread / np.sqrt(count)
        interval = _of_spread(square, freedom)
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
        run_interval=_of_spread(inside, inner),
        session_interval=_of_sessions(among, inside, outer, inner, effective),
    )


def _of_spread(square: np.ndarray, freedom: int) -> np.ndarray:
    """95% interval of a standard deviation of which the mean square has this freedom, (2, A)."""
    low, high = stats.chi2.ppf(_TAILS[::-1], freedom)
    return np.asarray(np.sqrt(np.stack([freedom * square / low, freedom * square / high])))


def _of_sessions(
    among: np.ndarray, inside: np.ndarray, outer: int, inner: int, effective: float
) -> np.ndarray:
    """95% interval of the sessions' standard deviation, (2, A) (Searle et al. 1992, sec. 3.6d):
    exact where the ratio of the mean squares alone counts and where sessions dominate, and holding
    95% between."""
    ends = []
    for tail in _TAILS[::-1]:
        explained = inside * stats.f.ppf(tail, outer, inner)
        square = outer * (among - explained) / (effective * stats.chi2.ppf(tail, outer))
        ends.append(np.sqrt(np.maximum(square, 0.0)))
    return np.stack(ends)
