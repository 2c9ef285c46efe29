"""Intervals of fitted parameters: where the likelihood, the others maximised, falls off."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize
import scipy.stats

from lbgc.sensor.fitting.likelihood import Likelihood

TWO_SIDED, ONE_SIDED = 3.841, 2.706  # 95% points of the likelihood ratio
_SHARP = 0.04  # of a log-parameter's standard error, below which its likelihood is a parabola


@dataclass(frozen=True)
class FittedParameter:
    """A parameter, SI: its value and two-sided 95% interval. Where the data cannot tell it from
    zero (at 95%, one-sided), `low` is zero and only the upper limit means anything; where they
    cannot tell it from infinity, `high` is infinite and only `low` means anything. Where they tell
    nothing of it, both are so, and the value is what they look like."""

    value: float
    low: float
    high: float
    upper: float
    """One-sided 95% upper limit."""

    @property
    def is_limit(self) -> bool:
        """Whether it is an upper limit."""
        return self.low == 0.0

    @property
    def is_lower_limit(self) -> bool:
        return bool(np.isinf(self.high))

    @property
    def is_withheld(self) -> bool:
        """Whether the data tell nothing of it."""
        return self.is_limit and self.is_lower_limit


def mixture_quantiles(
    weights: Sequence[float], centres: Sequence[float], sigmas: Sequence[float], at: Sequence[float]
) -> np.ndarray:
    """Quantiles of a mixture of normal laws."""
    centre, sigma = np.array(centres), np.array(sigmas)
    x = np.linspace((centre - 5 * sigma).min(), (centre + 5 * sigma).max(), 4001)
    below = scipy.stats.norm.cdf((x[:, None] - centre) / sigma) @ np.array(weights)
    return np.interp(at, below, x)


def widened(e: FittedParameter, by: float) -> FittedParameter:
    """The estimate with its interval's ends so many times as far away, on the scale of logarithms;
    limits of what may be zero, as far as they are."""
    if e.value == 0 or by == 1:
        return FittedParameter(e.value, e.low, e.high * by, e.upper * by)
    ends = [e.value * (end / e.value) ** by for end in (e.low, e.high, e.upper)]
    return FittedParameter(e.value, *ends)


def interval(likelihood: Likelihood, p: np.ndarray, best: float, i: int) -> FittedParameter:
    """The 95% interval of exp(p[i])."""
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
        """Likelihood ratio at the fixed log-value, the others maximised."""
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
    # At an end of a parameter's range the data tell no more than that it is beyond.
    low = -np.inf if low <= likelihood.least[i] else low
    high = np.inf if high >= likelihood.most[i] else high
    upper = min(upper, likelihood.most[i])
    return FittedParameter(value, *np.exp([low, high, upper]).tolist())


def _unrelated(covariance: np.ndarray, i: int) -> np.ndarray:
    """The parameters whose errors have nothing to do with those of parameter i: left where they
    are, they change its likelihood by a thousandth."""
    sigmas = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore"):
        related = np.abs(covariance[i] / (sigmas * sigmas[i]))
    return np.flatnonzero((related < 0.03) & np.isfinite(sigmas))


def _freedom(likelihood: Likelihood, p: np.ndarray, i: int) -> float:
    """As many chi-squared degrees of freedom would tell parameter i as well: half its Fisher
    information, the others unknown."""
    return float(1 / max(likelihood.covariance(p, keep=[i])[i, i], 1e-12) / 2)


def _one_sided(freedom: float) -> float:
    """The likelihood ratio at the 95% upper limit of a variance known with so many degrees of
    freedom: with r = freedom/chi^2_5%, freedom (ln r + 1/r - 1). It tends to 2.706; a random walk
    that only a handful of coefficients tell has 4, and 3.6: the usual 2.706 would hold 92%."""
    freedom = min(max(freedom, 0.5), 1e6)
    r = freedom / scipy.stats.chi2.ppf(0.05, freedom)
    return float(freedom * (np.log(r) + 1 / r - 1))


def _crossing(
    excess: Callable[[float], float], centre: float, side: int, threshold: float, sigma: float
) -> float:
    """Where the likelihood ratio reaches the threshold on one side of the maximum. The first guess
    is the parabola's, if there is one."""
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
