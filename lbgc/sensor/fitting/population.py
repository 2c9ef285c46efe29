"""The spread of a coefficient between units of one make, from each unit's fit.

A unit's coefficient c is lognormal, ln c ~ N(mu, sigma^2), and its fit errs by s on top, which its
own interval tells: y ~ N(mu, sigma^2 + s^2). The weighted sum of squares about the weighted mean,

    Q(sigma) = sum w (y - mean)^2,   w = 1/(sigma^2 + s^2),

is chi-squared with one degree of freedom less than there are units, however few these are. So sigma
is where Q is its expected value (Mandel and Paule 1970), and its interval is where Q is within its
own 95% (Viechtbauer 2007, doi 10.1002/sim.2514). The interval of the mean is Hartung and Knapp's,
by Student's law and the scatter that there is, and no narrower than the fits' errors alone make it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize
import scipy.stats

from lbgc.sensor.fitting.profile import FittedParameter

FEWEST = 3
"""Units from which a spread can be told."""
_NORMAL = 1.96
_WIDEST = 1e3
"""The largest standard deviation of a logarithm that is looked for."""


@dataclass(frozen=True)
class Population:
    """A coefficient in a population of units."""

    median: FittedParameter
    """The coefficient of the median unit, SI"""
    spread: FittedParameter
    """Standard deviation of its logarithm between units: 0.2 is 20%"""
    units: int
    """Number of units"""
    p_alike: float
    """The p-value of all units being alike"""


def population(estimates: Sequence[FittedParameter]) -> Population | None:
    """The population that units' estimates of one coefficient come from; None where one of them is
    only a limit, since leaving that unit out would make the coefficient too large and its spread
    too small. Raises ValueError for fewer than three units."""
    if len(estimates) < FEWEST:
        raise ValueError(f"a spread between {len(estimates)} units is not told")
    if any(e.is_limit or e.is_lower_limit for e in estimates):
        return None
    y = np.log([e.value for e in estimates])
    s = np.log([e.high / e.low for e in estimates]) / (2 * _NORMAL)
    k = len(y)
    law = scipy.stats.chi2(k - 1)
    value = _where(y, s, k - 1.0)
    low, high, upper = (_where(y, s, float(law.isf(p))) for p in (0.025, 0.975, 0.95))
    alike = _scatter(y, s, 0.0)
    if alike < law.isf(0.975):  # closer together than their own errors make likely
        high = upper = np.inf
    elif alike < law.isf(0.05):
        low = 0.0
    weights = 1 / (value**2 + s**2)
    mean = float(weights @ y / weights.sum())
    inflated = max(_scatter(y, s, value) / (k - 1), 1.0)
    error = float(np.sqrt(inflated / weights.sum()))
    reach = [scipy.stats.t.isf(p, k - 1) * error for p in (0.975, 0.025, 0.05)]
    median = FittedParameter(float(np.exp(mean)), *np.exp(mean + np.array(reach)).tolist())
    return Population(median, FittedParameter(value, low, high, upper), k, float(law.sf(alike)))


def _scatter(y: np.ndarray, s: np.ndarray, sigma: float) -> float:
    """The weighted sum of squares Q about the weighted mean. y, s : (k,), the logarithms and their
    standard errors; sigma : of the population."""
    weights = 1 / (sigma**2 + np.maximum(s, 1e-12) ** 2)
    return float(weights @ (y - weights @ y / weights.sum()) ** 2)


def _where(y: np.ndarray, s: np.ndarray, scatter: float) -> float:
    """The standard deviation of the population with which Q, which falls with it, has this value;
    zero where Q is less throughout."""
    if _scatter(y, s, 0.0) <= scatter:
        return 0.0
    return float(
        scipy.optimize.brentq(lambda x: _scatter(y, s, x) - scatter, 0.0, _WIDEST, xtol=1e-9)
    )
