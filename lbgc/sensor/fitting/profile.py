"""Intervals of fitted parameters from the profile likelihood, which is the likelihood as a function
of one parameter with the others at their best."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize
import scipy.stats

from lbgc.sensor.fitting.likelihood import Likelihood

TWO_SIDED, ONE_SIDED = 3.841, 2.706
"""Thresholds of twice the log-likelihood ratio for 95%."""
_SHARP = 0.04
"""Standard error of a log-parameter below which its log-likelihood is taken as a parabola."""


@dataclass(frozen=True)
class FittedParameter:
    """An estimated parameter, SI: its value and two-sided 95% interval.

    Where the data cannot tell it from zero (at 95%, one-sided), `low` is zero and only the upper
    limit is meaningful. Where they cannot tell it from infinity, `high` is infinite and only `low`
    is meaningful. Where they tell nothing of it, both hold, and the value is only what they look
    like.
    """

    value: float
    """The estimate"""
    low: float
    """Lower end of the two-sided 95% interval"""
    high: float
    """Upper end of the two-sided 95% interval"""
    upper: float
    """One-sided 95% upper limit"""

    @property
    def is_limit(self) -> bool:
        """Whether it is only an upper limit."""
        return self.low == 0.0

    @property
    def is_lower_limit(self) -> bool:
        """Whether it is only a lower limit."""
        return bool(np.isinf(self.high))

    @property
    def is_withheld(self) -> bool:
        """Whether the data tell nothing of it."""
        return self.is_limit and self.is_lower_limit


def mixture_quantiles(
    weights: Sequence[float], centres: Sequence[float], sigmas: Sequence[float], at: Sequence[float]
) -> np.ndarray:
    """Quantiles, at the probabilities `at`, of a mixture of normal laws with these weights (whose
    sum is 1), means and standard deviations."""
    centre, sigma = np.array(centres), np.array(sigmas)
    x = np.linspace((centre - 5 * sigma).min(), (centre + 5 * sigma).max(), 4001)
    below = scipy.stats.norm.cdf((x[:, None] - centre) / sigma) @ np.array(weights)
    return np.interp(at, below, x)


def widened(e: FittedParameter, by: float) -> FittedParameter:
    """The estimate with the ends of its interval `by` times as far away on a logarithmic scale.
    Where the value is zero, its upper limits are multiplied by the factor."""
    if e.value == 0 or by == 1:
        return FittedParameter(e.value, e.low, e.high * by, e.upper * by)
    ends = [e.value * (end / e.value) ** by for end in (e.low, e.high, e.upper)]
    return FittedParameter(e.value, *ends)


def interval(likelihood: Likelihood, p: np.ndarray, best: float, i: int) -> FittedParameter:
    """The estimate exp(p[i]) of parameter i with its 95% interval.

    p : (P,), the log-parameters at the maximum of the likelihood; best : minus the log-likelihood
    there.
    """
    centre, name = float(p[i]), likelihood.names[i]
    covariance = likelihood.covariance(p, keep=[i])
    sigma = float(np.sqrt(max(covariance[i, i], 0.0)))
    inside = likelihood.least[i] + 4 * sigma < centre < likelihood.most[i] - 4 * sigma
    if sigma < _SHARP and inside:
        ends = np.exp(centre + sigma * np.array([0, -1.96, 1.96, 1.645])).tolist()
        return FittedParameter(*ends)
    warm, known = {centre: p}, {centre: 0.0}
    still = {j: float(p[j]) for j in _unrelated(covariance, i)}

    def excess(x: float) -> float:
        """Twice the log-likelihood ratio of the maximum to the log-value x of parameter i, with the
        other parameters at their best."""
        x = min(max(x, likelihood.least[i]), likelihood.most[i])
        if x not in known:
            nearest = min(warm, key=lambda at: abs(at - x))
            warm[x], value = likelihood.minimise(warm[nearest], {**still, i: x}, 25, 3e-3)
            known[x] = 2 * (value - best)
        return known[x]

    is_shape = name not in {shape.names[0] for shape in likelihood.shapes}
    at_zero = np.inf if is_shape else excess(centre - 30.0)
    high = _crossing(excess, centre, +1, TWO_SIDED, sigma)
    upper = _crossing(excess, centre, +1, ONE_SIDED, sigma)
    if not is_shape:
        freedom = _freedom(likelihood, warm[min(warm, key=lambda at: abs(at - upper))], i)
        upper = _crossing(excess, centre, +1, _one_sided(freedom), sigma)
    low = -np.inf
    if at_zero >= ONE_SIDED and centre > likelihood.least[i]:
        low = _crossing(excess, centre, -1, min(TWO_SIDED, at_zero), sigma)
    value = float(np.exp(centre)) if at_zero > 1e-3 else 0.0
    # Where the interval reaches an end of the parameter's range, it is open on that side.
    low = -np.inf if low <= likelihood.least[i] else low
    high = np.inf if high >= likelihood.most[i] else high
    upper = min(upper, likelihood.most[i])
    return FittedParameter(value, *np.exp([low, high, upper]).tolist())


def _unrelated(covariance: np.ndarray, i: int) -> np.ndarray:
    """The parameters whose errors are not correlated (below 0.03) with those of parameter i. Held
    where they are, they change its likelihood by a thousandth."""
    sigmas = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore"):
        related = np.abs(covariance[i] / (sigmas * sigmas[i]))
    return np.flatnonzero((related < 0.03) & np.isfinite(sigmas))


def _freedom(likelihood: Likelihood, p: np.ndarray, i: int) -> float:
    """The degrees of freedom of a chi-squared variance that would be known as well as parameter i:
    half its Fisher information, the others unknown."""
    return float(1 / max(likelihood.covariance(p, keep=[i])[i, i], 1e-12) / 2)


def _one_sided(freedom: float) -> float:
    """Twice the log-likelihood ratio at the 95% upper limit of a variance that is known with this
    many degrees of freedom: with r = freedom/chi^2_5%, freedom (ln r + 1/r - 1). It tends to 2.706.
    A random walk of which only a few coefficients tell has 4 degrees of freedom, and 3.6; the usual
    2.706 would hold only 92%."""
    freedom = min(max(freedom, 0.5), 1e6)
    r = freedom / scipy.stats.chi2.ppf(0.05, freedom)
    return float(freedom * (np.log(r) + 1 / r - 1))


def _crossing(
    excess: Callable[[float], float], centre: float, side: int, threshold: float, sigma: float
) -> float:
    """The log-value at which `excess` reaches the threshold on one side of the maximum `centre`:
    side +1 above, -1 below. The first guess is that of a parabola, where sigma is finite."""
    inner = centre
    step = min(max(sigma * np.sqrt(threshold), 0.02), 1.0) if np.isfinite(sigma) else 0.5
    for _ in range(12):
        outer = inner + side * step
        if excess(outer) > threshold:
            break
        inner, step = outer, 2 * step
    else:
        return float(side * np.inf) if side > 0 else outer
    near = scipy.optimize.brentq(
        lambda x: excess(x) - threshold, inner, outer, rtol=1e-3, xtol=3e-3
    )
    return float(near)
