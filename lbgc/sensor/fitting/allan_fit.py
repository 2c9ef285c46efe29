"""The fit of noise coefficients to the points of an Allan curve, where no log exists.

The Allan variance is linear in the squares q of the coefficients, so they follow by generalised
least squares with q >= 0. Where the recording's length is known, the points' covariance is that of
overlapping estimates (`lbgc.sensor.fitting.allan_covariance`) at the fitted model, found by
iteration, and the points' reading errors are added. Errors that a curve states replace the sizes of
these, and keep their correlation. Where neither is known all points count equally, and the
intervals are those of a recording that is `SHORTEST` times as long as the longest averaging time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.stats

from lbgc.sensor.deterministic import Ramp
from lbgc.sensor.fitting import corner
from lbgc.sensor.fitting.allan_covariance import AllanCovariance
from lbgc.sensor.fitting.noise_fit import Fit
from lbgc.sensor.fitting.profile import TWO_SIDED, FittedParameter
from lbgc.sensor.fitting.shapes import QUANTISATION, Shape, core

MOST = 24
"""Points of a curve that are used, at most. Neighbours of more would tell nearly the same."""
SHORTEST = 3.0
"""The length that a recording of unknown length is taken to have, over the longest averaging
time of its curve."""
FAILS = 0.05
"""Chance that a right model is called wrong."""
_NEEDED = 8.0
"""What quantisation or a ramp must gain in twice the log-likelihood to be taken, each."""
_ROUNDS = 60
"""Iterations of the weights, at most"""
_DETECTED = 1.645
"""Standard errors, of a coefficient that is zero, above which one is told from zero."""
_BEYOND = 1e4
"""A term's variance over that of the whole curve from which on a limit says nothing."""
_SPREAD_LEAST = 1e-4
"""The least relative error that a curve's points are taken to have, since they are printed."""


@dataclass(frozen=True, eq=False)
class AllanCurve:
    """The points of an Allan curve, in order of averaging time."""

    taus: np.ndarray
    """(K,), averaging times, s"""
    deviation: np.ndarray
    """(K,), Allan deviations, unit"""
    sigma: np.ndarray | None = None
    """(K,), standard errors of the deviations, unit; None where they are not stated"""
    record_s: float | None = None
    """Length of the recording that the curve is of, s; None where it is not known"""
    dt: float | None = None
    """Interval of that recording's samples, s; None: the shortest averaging time"""
    reading: float = 0.0
    """Relative error of a point, 1 sigma, from reading it off a figure"""

    def thinned(self) -> "AllanCurve":
        """The curve, or of one with more than `MOST` points those next to evenly spaced
        logarithms."""
        if len(self.taus) <= MOST:
            return self
        logs = np.log(self.taus)
        wanted = np.linspace(logs[0], logs[-1], MOST)
        at = np.unique([int(np.argmin(np.abs(logs - one))) for one in wanted])
        sigma = None if self.sigma is None else self.sigma[at]
        taus, deviation = self.taus[at], self.deviation[at]
        return replace(self, taus=taus, deviation=deviation, sigma=sigma)


@dataclass(frozen=True, eq=False)
class CurveFit:
    """The fit of a noise model to an Allan curve."""

    fit: Fit
    """The coefficients with their intervals"""
    curve: AllanCurve
    """The points that were used"""
    weights: str
    """recording: by the covariance of overlapping estimates; stated: by the errors that the curve
    states; equal: all points alike"""
    p: float
    """The chance that a right model leaves as much"""
    scatter: float
    """Root mean square of what the model leaves of the points, relative to its deviation"""

    @property
    def fails(self) -> bool:
        """Whether the model is rejected; the intervals are then wider by what it leaves."""
        return self.p < FAILS


class _Model:
    """A set of terms fitted to a curve: squares of coefficients, and of a ramp where it has one."""

    def __init__(self, curve: AllanCurve, shapes: list[Shape], ramp: bool, errors: "_Errors"):
        self.curve, self.shapes, self.errors = curve, shapes, errors
        units = [shape.unit_term(()).allan_variance(curve.taus) for shape in shapes]
        self.units = np.stack([*units, *([Ramp(1.0).allan_variance(curve.taus)] if ramp else [])])
        self.ramp = ramp
        self.y = curve.deviation**2
        self.q = self._fitted(np.ones(len(self.units), bool))

    def _whitened(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Units (K, P) and points (K,) divided by a root of the weights' covariance at q, and the
        covariance (K, K) that the points then have."""
        model = q @ self.units
        weights = self.errors.weights(model, q, len(self.shapes))
        root = np.linalg.cholesky(weights)
        both = scipy.linalg.solve_triangular(
            root, np.column_stack([self.units.T, self.y]), lower=True
        )
        if self.errors.kind != "equal":
            return both[:, :-1], both[:, -1], np.eye(len(self.y))
        half = scipy.linalg.solve_triangular(
            root, self.errors.covariance(model, q, len(self.shapes)), lower=True
        )
        own = scipy.linalg.solve_triangular(root, half.T, lower=True)
        return both[:, :-1], both[:, -1], own

    def _fitted(self, allowed: np.ndarray) -> np.ndarray:
        """The squares by least squares whose weights are those of the fitted model; zero where they
        are not allowed."""
        scaled = self.units[allowed] / self.y
        q = np.zeros(len(self.units))
        q[allowed] = _non_negative(scaled.T, np.ones(len(self.y)))
        for _ in range(_ROUNDS):
            X, z, _ = self._whitened(q)
            new = np.zeros(len(q))
            new[allowed] = _non_negative(X[:, allowed], z)
            change = np.abs((new - q) @ self.units) / (q @ self.units)
            q = (new + q) / 2
            if change.max() < 1e-6:
                break
        return q

    @cached_property
    def left(self) -> tuple[float, float]:
        """The weighted sum of squares of what the model leaves, over its expected value, and the
        p-value of that, by a chi-squared law with the same mean and variance."""
        X, z, covariance = self._whitened(self.q)
        X = X[:, self.q > 0]
        rest = np.eye(len(z)) - X @ np.linalg.pinv(X)
        spread = rest @ covariance @ rest
        mean, square = float(np.trace(spread)), float(np.sum(spread * spread.T))
        found = float(np.sum((z - X @ self.q[self.q > 0]) ** 2))
        return found / mean, float(scipy.stats.chi2.sf(found * mean / square, mean**2 / square))

    @property
    def cost(self) -> float:
        """Minus twice the log-likelihood of normal points, and what further terms must gain."""
        model = self.q @ self.units
        covariance = self.errors.covariance(model, self.q, len(self.shapes))
        off = self.y - model
        value = off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(covariance)[1]
        return float(value + _NEEDED * (len(self.units) - 3))

    def error(self, j: int, at: np.ndarray, active: np.ndarray) -> tuple[float, float]:
        """The estimate of q[j] by the weights at these squares, free to be negative, with its
        standard error; the other squares that are active are estimated along with it."""
        X, z, covariance = self._whitened(at)
        with_it = active.copy()
        with_it[j] = True
        names = np.flatnonzero(with_it)
        size = np.linalg.norm(X[:, names], axis=0)
        place = int(np.searchsorted(names, j))
        row = np.linalg.pinv(X[:, names] / size)[place] / size[place]
        return float(row @ z), float(np.sqrt(row @ covariance @ row))

    def interval(self, j: int, wider: float) -> FittedParameter:
        """The coefficient whose square is q[j], with its 95% interval: from chi-squared with the
        degrees of freedom that the square's standard error comes to, or a limit where zero is
        within reach. wider : factor on standard errors."""
        without = self._fitted(np.arange(len(self.q)) != j)
        q = float(self.q[j])
        by_zero, chance = self.error(j, without, without > 0)
        if q > 0 and by_zero > _DETECTED * wider * chance:
            sigma = wider * self.error(j, self.q, self.q > 0)[1]
            freedom = max(2 * (q / sigma) ** 2, 1.0)
            ends = scipy.stats.chi2.ppf([0.975, 0.025, 0.05], freedom)
            return FittedParameter(float(np.sqrt(q)), *np.sqrt(q * freedom / ends).tolist())
        highs = []
        for z in (1.96, _DETECTED):
            most = 0.0
            for _ in range(30):
                at = without.copy()
                at[j] = most
                estimate, sigma = self.error(j, at, without > 0)
                most = (most + max(estimate, 0.0) + z * wider * sigma) / 2
                if (most * self.units[j] > _BEYOND * self.y).all():
                    most = np.inf
                    break
            highs.append(float(np.sqrt(most)))
        return FittedParameter(float(np.sqrt(q)), 0.0, *highs)


class _Errors:
    """The covariance of a curve's points, and that by which they weigh, as functions of the
    model."""

    def __init__(self, curve: AllanCurve, shapes: list[Shape]):
        self.curve = curve
        told = [curve.record_s is not None, curve.sigma is not None, True]
        self.kind = ("recording", "stated", "equal")[told.index(True)]
        self._terms = len(shapes)
        self._overlap = AllanCovariance(
            curve.taus,
            curve.record_s or SHORTEST * float(curve.taus[-1]),
            [shape.unit_term(()) for shape in shapes],
            curve.dt or float(curve.taus[0]),
        )

    def covariance(self, model: np.ndarray, q: np.ndarray, terms: int) -> np.ndarray:
        """The points' covariance, (K, K), at a model's variances (K,); q are the squares that make
        it, those of so many terms first and that of a ramp last."""
        own = np.zeros(self._terms)
        own[:terms] = q[:terms]
        out = self._overlap.matrix(own, float(q[terms:].sum()))
        if self.curve.sigma is not None:
            size = 2 * self.curve.sigma * np.sqrt(model) / np.sqrt(np.diag(out))
            out = out * np.outer(size, size)
        return out + np.diag((2 * max(self.curve.reading, _SPREAD_LEAST) * model) ** 2)

    def weights(self, model: np.ndarray, q: np.ndarray, terms: int) -> np.ndarray:
        """The covariance by whose inverse the points weigh, (K, K), as `covariance` takes it."""
        if self.kind == "equal":
            return np.asarray(np.diag((2 * model) ** 2))
        return self.covariance(model, q, terms)


def _non_negative(X: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The coefficients, zero or more, with the least sum of squares of z - X c."""
    size = np.linalg.norm(X, axis=0)
    return np.asarray(scipy.optimize.nnls(X / size, z)[0] / size)


def fitted_together(
    curves: Sequence[AllanCurve], corners: tuple[float, float], free: bool
) -> list[CurveFit]:
    """Fit the curves of a sensor's axes, which share the corners of the bias instability's floor.

    corners : s; free : whether the shorter one is taken from the curves. Intervals then cover all
    corners that the curves do not tell from the best one.
    """
    curves = [one.thinned() for one in curves]
    if not free:
        return [fitted(one, corners) for one in curves]
    errors = [_Errors(one, [*core(corners), QUANTISATION]) for one in curves]
    first, last = (sorted(float(c.taus[at]) for c in curves)[at] for at in (0, -1))
    usable = [s for s in corner.OFFERED if first < s <= min(corners[1], last) / 20]
    tried: dict[float, list[CurveFit]] = {}
    for short in {first, corner.USUAL, *usable}:
        own = (short, corners[1])
        tried[short] = [_fit(*pair, own) for pair in zip(curves, errors, strict=True)]
    costs = {short: sum(one.fit.bic for one in fits) for short, fits in tried.items()}
    best = min(costs, key=lambda short: costs[short])
    alike = [tried[short] for short in costs if costs[short] < costs[best] + TWO_SIDED]
    found = [fitted(one, (best, corners[1])) for one in curves]
    return [_covering(one, [fits[k] for fits in alike]) for k, one in enumerate(found)]


def _covering(found: CurveFit, others: Sequence[CurveFit]) -> CurveFit:
    """The fit with intervals that cover those of others, as far as these have its parameters."""

    def wide(own: FittedParameter, more: Sequence[FittedParameter]) -> FittedParameter:
        """The estimate with an interval from the lowest end to the highest."""
        every = [own, *more]
        return FittedParameter(
            own.value, *(f(getattr(e, end) for e in every) for f, end in _ENDS)
        )  # fmt: skip

    same = [one.fit for one in others]
    estimates = {
        name: wide(e, [f.estimates[name] for f in same if name in f.estimates])
        for name, e in found.fit.estimates.items()
    }
    ramp = wide(found.fit.ramp, [f.ramp for f in same])
    return replace(found, fit=replace(found.fit, estimates=estimates, ramp=ramp))


_ENDS = ((min, "low"), (max, "high"), (max, "upper"))


def fitted(curve: AllanCurve, corners: tuple[float, float] = (1.0, 3600.0)) -> CurveFit:
    """Fit N, B and K, and quantisation and a ramp where the curve shows them. corners : s, of the
    bias instability's floor."""
    curve = curve.thinned()
    return _fit(curve, _Errors(curve, [*core(corners), QUANTISATION]), corners)


def _fit(curve: AllanCurve, errors: _Errors, corners: tuple[float, float]) -> CurveFit:
    """The best fit of a curve whose points err so."""
    terms = core(corners)
    every = [*terms, QUANTISATION]
    models = [_Model(curve, own, ramp, errors) for own in (terms, every) for ramp in (False, True)]
    best = min(models, key=lambda one: one.cost)
    ratio, p = best.left
    wider = float(np.sqrt(ratio)) if p < FAILS else 1.0
    estimates = {s.names[0]: best.interval(j, wider) for j, s in enumerate(best.shapes)}
    with_ramp = best if best.ramp else next(m for m in models if m.ramp and m.shapes == best.shapes)
    ramp = with_ramp.interval(len(best.shapes), wider)
    if not best.ramp:
        ramp = FittedParameter(ramp.value, 0.0, ramp.high, ramp.upper)
    fit = Fit(best.shapes, estimates, best.cost, ramp, ())
    off = curve.deviation / np.sqrt(best.q @ best.units) - 1
    return CurveFit(fit, curve, errors.kind, p, float(np.sqrt(np.mean(off**2))))
