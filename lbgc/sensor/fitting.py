"""Which noise a static recording has: maximum likelihood, with profile-likelihood intervals."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.optimize
import scipy.stats

from lbgc.sensor import gaussian, noise
from lbgc.sensor.counts import Counts
from lbgc.sensor.likelihood import Likelihood, low_variance
from lbgc.sensor.ordinates import Ordinates, Tone
from lbgc.sensor.shapes import (
    FILTERED_WHITE,
    GAUSS_MARKOV,
    QUANTISATION,
    Shape,
    core,
    line,
)
from lbgc.sensor.warmup import Course

TWO_SIDED, ONE_SIDED = 3.841, 2.706  # 95% points of the likelihood ratio
_MOST_PARTS = 10
_WORTH = 6.0  # what a further part must gain in the information criterion: strong evidence


@dataclass(frozen=True)
class Estimate:
    """A parameter, SI: its value and two-sided 95% interval. Where the data cannot tell it from
    zero (at 95%, one-sided), `low` is zero and only the upper limit means anything; where they tell
    nothing of it, that limit is infinite."""

    value: float
    low: float
    high: float
    upper: float
    """One-sided 95% upper limit."""

    @property
    def is_limit(self) -> bool:
        return self.low == 0.0

    @property
    def is_withheld(self) -> bool:
        return bool(np.isinf(self.upper))


@dataclass(frozen=True)
class Fit:
    """A fitted model of one axis, SI units."""

    shapes: list[Shape]
    estimates: dict[str, Estimate]
    bic: float
    ramp: Estimate
    """Of a linear drift R t, given the rest of the model: a random walk may explain it as well."""
    tones: tuple[Tone, ...]
    courses: tuple[Course, ...] = ()
    """What the mean does beyond noise: taken out before the noise was fitted."""
    counts: Counts | None = None
    """The samples' counts, where they have any."""
    rounding: float = 0.0
    """Density of the samples' rounding, beside the terms: unit^2 s."""

    @property
    def printed(self) -> gaussian.Gaussians:
        """The fitted terms and the samples' rounding: the noise of what was printed."""
        own = (noise.White(float(np.sqrt(self.rounding))),) if self.rounding > 0 else ()
        return (*self.terms(), *own)

    def terms(self) -> gaussian.Gaussians:
        """The fitted terms, at the maximum of the likelihood."""
        return tuple(
            shape.build(*(self.estimates[name].value for name in shape.names))
            for shape in self.shapes
            if self.estimates[shape.names[0]].value > 0
        )


def fit(data: Ordinates, shapes: list[Shape], start: dict[str, float] | None = None) -> Fit:
    """Fit these parts and give each parameter its interval.

    start : first guesses of shape parameters, SI; coefficients start from the data.
    """
    likelihood = Likelihood(data, shapes)
    p, best = likelihood.minimise(_start(data, shapes, start or {}))
    estimates = {name: _interval(likelihood, p, best, i) for i, name in enumerate(likelihood.names)}
    return Fit(
        shapes,
        estimates,
        likelihood.bic(best),
        _ramp(likelihood, p),
        data.tones,
        rounding=data.rounding,
    )


def choose(
    data: Ordinates,
    corners: tuple[float, float] = (1.0, 3600.0),
    say: Callable[[str], None] = lambda what: None,
) -> Fit:
    """Fit the core and whatever else the Bayesian information criterion prefers, one by one:
    angle quantisation, an output filter, narrow-band lines, a Gauss-Markov process.

    say : told what is being tried.
    """
    best = _bic(data, core(corners), {})
    for _ in range(_MOST_PARTS):
        say(f"{len(best.shapes)} terms and one more")
        trials = [_bic(data, *option) for option in _extensions(data, best)]
        trials = [t for t in trials if _is_sensible(t.start, data)]
        better = min(trials, key=lambda trial: trial.bic, default=best)
        if better.bic > best.bic - _WORTH:
            break
        best = better
    say(f"intervals of {len(best.start)} parameters")
    return fit(data, best.shapes, best.start)


def _is_sensible(values: dict[str, float], data: Ordinates) -> bool:
    """Whether each part is what its name says, and does not mend another part's shape: a line is
    narrow, a Gauss-Markov process slower than the samples and not the whole log."""
    duration = data.n * data.dt
    time = values.get("GM_T", 0.1 * duration)
    narrow = all(
        values[name.replace("f0", "width")] <= 0.3 * f0
        for name, f0 in values.items()
        if name.startswith("line_f0")
    )
    return narrow and 10 * data.dt <= time <= 0.3 * duration


@dataclass(frozen=True)
class _Trial:
    """A model without its intervals, and what its parameters came to."""

    shapes: list[Shape]
    start: dict[str, float]
    bic: float
    ratio: np.ndarray
    """(M,) power over the model, of the high-frequency bins"""


def _bic(data: Ordinates, shapes: list[Shape], start: dict[str, float]) -> _Trial:
    likelihood = Likelihood(data, shapes)
    p, best = likelihood.minimise(_start(data, shapes, start))
    v, _ = likelihood.variance(p)
    ratio = (likelihood.power / likelihood.count / v)[likelihood.lows :]
    values = dict(zip(likelihood.names, np.exp(p), strict=True))
    return _Trial(shapes, values, likelihood.bic(best), ratio)


def _lines(values: dict[str, float]) -> set[str]:
    """The names of the lines' coefficients."""
    return {name for name in values if name.startswith("line_sigma")}


def _extensions(data: Ordinates, best: _Trial) -> list[tuple[list[Shape], dict[str, float]]]:
    """The model with one part more, each way; a filter also together with a line, since either
    may hide the other. Shapes found so far are kept as guesses, and coefficients guessed afresh:
    a model that lacked a part may have pushed them to zero."""
    names = {shape.names for shape in best.shapes}
    afresh = {shape.names[0] for shape in best.shapes} - _lines(best.start)
    known = {n: v for n, v in best.start.items() if n not in afresh}
    filtered = [*(s for s in best.shapes if s.names != ("N",)), FILTERED_WHITE]
    options = []
    if QUANTISATION.names not in names:
        options.append(([*best.shapes, QUANTISATION], known))
    if FILTERED_WHITE.names not in names:
        options += [
            (filtered, {**known, "bandwidth": b / data.dt, "damping": z})
            for b in (0.1, 0.3, 1.0)
            for z in (0.7, 2.0)
        ]
    if GAUSS_MARKOV.names not in names:
        options += [
            ([*best.shapes, GAUSS_MARKOV], {**known, "GM_T": time}) for time in (3.0, 30.0, 300.0)
        ]
    local = scipy.ndimage.median_filter(data.power / data.count, 15, mode="nearest")
    unexplained, sharp = (
        np.where(data.count > 3, (ratio - 1) * np.sqrt(data.count), 0)
        for ratio in (best.ratio, data.power / data.count / local)
    )
    first = int(np.argmax(unexplained))
    elsewhere = np.abs(np.log(data.f / data.f[first])) > 0.1
    peaks = {first, int(np.argmax(unexplained * elsewhere)), int(np.argmax(sharp))}
    another = line(1 + len(_lines(best.start)))
    for at in peaks:
        f0, density = float(data.f[at]), float(data.power[at] / data.count[at])
        excess = max(density - min(density / best.ratio[at], local[at]), 0.01 * density)
        for width in (0.01 * f0, 0.1 * f0):
            sigma = np.sqrt(excess * np.pi * max(width, data.width[at]) / np.sqrt(2))
            guess = {**known, **dict(zip(another.names, (float(sigma), f0, width), strict=True))}
            options.append(([*best.shapes, another], guess))
            if FILTERED_WHITE.names not in names:
                both = {**guess, "bandwidth": 0.3 / data.dt, "damping": 0.7}
                options.append(([*filtered, another], both))
    return options


def _ramp(likelihood: Likelihood, p: np.ndarray) -> Estimate:
    """Generalised least squares of a straight line in the low coefficients."""
    d = likelihood.data
    time = (np.arange(d.blocks) + 0.5) * d.interval
    line = scipy.fft.dct(time, norm="ortho")[1 : likelihood.lows + 1] * np.sqrt(d.interval)
    weights = line / likelihood.variance(p)[0][: likelihood.lows]
    slope, sigma = weights @ d.low[0] / (weights @ line), 1 / np.sqrt(weights @ line)
    size = float(abs(slope))
    low = size - 1.96 * sigma if size > 1.96 * sigma else 0.0
    return Estimate(size, float(low), float(size + 1.96 * sigma), float(size + 1.645 * sigma))


def _start(data: Ordinates, shapes: list[Shape], given: dict[str, float]) -> np.ndarray:
    guesses = [_first_guess(data, s, name, given) for s in shapes for name in s.names]
    return np.log(guesses)


def _first_guess(data: Ordinates, shape: Shape, name: str, given: dict[str, float]) -> float:
    if name in given:
        return given[name]
    top = data.f > 0.05 * data.f[-1]
    white = np.sqrt(np.sum(data.power[top]) / np.sum(data.count[top]))
    if name == "N" and "bandwidth" in shape.names:
        middle = slice(max(4, len(data.f) // 4))
        return float(np.sqrt(np.median(data.power[middle] / data.count[middle])))
    if name == "N":
        return float(white)
    if name == "Q":
        return float(white * np.sqrt(data.dt) / 10)
    # As much as the lowest twenty coefficients hold, shared.
    low = np.mean(data.low[:, :20] ** 2)
    others = tuple(given[n] for n in shape.names[1:])
    unit = low_variance(shape.unit_term(others), data.blocks, data.interval, data.low.shape[1])
    return float(np.sqrt(max(low, 1e-3 * white**2) / unit[:20].mean() / 2))


def _interval(likelihood: Likelihood, p: np.ndarray, best: float, i: int) -> Estimate:
    """The profile likelihood's limits of exp(p[i])."""
    centre = float(p[i])
    warm, known = {centre: p}, {centre: 0.0}

    def excess(x: float) -> float:
        """Likelihood ratio at the fixed log-value, the others maximised."""
        x = min(max(x, likelihood.least[i]), likelihood.most[i])
        if x not in known:
            nearest = min(warm, key=lambda at: abs(at - x))
            warm[x], value = likelihood.minimise(warm[nearest], {i: x})
            known[x] = 2 * (value - best)
        return known[x]

    is_shape = likelihood.names[i] not in {shape.names[0] for shape in likelihood.shapes}
    at_zero = np.inf if is_shape else excess(centre - 30.0)
    high = _crossing(excess, centre, +1, TWO_SIDED)
    upper = _crossing(excess, centre, +1, ONE_SIDED)
    if not is_shape:
        freedom = likelihood.degrees_of_freedom(warm[min(warm, key=lambda at: abs(at - upper))], i)
        upper = _crossing(excess, centre, +1, _one_sided(freedom))
    low = -np.inf
    if at_zero >= ONE_SIDED:
        low = _crossing(excess, centre, -1, min(TWO_SIDED, at_zero))
    value = float(np.exp(centre)) if at_zero > 1e-3 else 0.0
    ends = np.clip([low, high, upper], likelihood.least[i], likelihood.most[i])
    low, high, upper = np.exp(ends).tolist()
    return Estimate(value, low, high, upper)


def _one_sided(freedom: float) -> float:
    """The likelihood ratio at the 95% upper limit of a variance known with so many degrees of
    freedom: with r = freedom/chi^2_5%, freedom (ln r + 1/r - 1). It tends to 2.706; a random walk
    that only a handful of coefficients tell has 4, and 3.6: the usual 2.706 would hold 92%."""
    freedom = min(max(freedom, 0.5), 1e6)
    r = freedom / scipy.stats.chi2.ppf(0.05, freedom)
    return float(freedom * (np.log(r) + 1 / r - 1))


def _crossing(
    excess: Callable[[float], float], centre: float, side: int, threshold: float
) -> float:
    """Where the likelihood ratio reaches the threshold on one side of the maximum."""
    inner, step = centre, 0.02
    for _ in range(12):
        outer = inner + side * step
        if excess(outer) > threshold:
            break
        inner, step = outer, 2 * step
    else:
        return outer
    return float(scipy.optimize.brentq(lambda x: excess(x) - threshold, inner, outer, xtol=1e-3))
