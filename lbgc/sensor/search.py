"""Which terms a recording's noise is made of.

From the core (white noise, bias instability, random walk) terms are added one by one, where the
likelihood gains more by them than chance would give in one log of some hundreds: an angle
quantisation, an output filter, a Gauss-Markov process, lines where the spectrum stands above the
model. Such a search sticks: two lines close to each other look like one, and a line hides a filter.
So what was found is also shaken: lines split and merge, every term is left out in turn, and the
search starts a second time from all the peaks of the spectrum at once.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.ndimage

from lbgc.sensor.likelihood import Likelihood
from lbgc.sensor.ordinates import Ordinates
from lbgc.sensor.shapes import (
    BUTTERWORTH_WHITE,
    FILTERED_WHITE,
    FIRST_ORDER,
    GAUSS_MARKOV,
    QUANTISATION,
    Shape,
    core,
    given_damping,
    is_line,
    line,
    poles,
    renumbered,
)

_COSTS = {"Q": 8.0, "N": 17.0, "fast": 8.0, "GM_sigma": 17.0, "line_sigma": 34.0}
"""What a term must gain in twice the log-likelihood: chi-squared with its parameters' number of
degrees of freedom exceeds that in a few of a thousand logs; a line's, over all places and widths
where one could be."""
_MOST_TERMS = 12
_ROUNDS = 12
_WINDOWS = (1, 2, 4, 8, 16, 32, 64, 128)
_PEAK = 15.0
"""Gain in log-likelihood that a peak must promise to be tried; noise alone reaches it once in some
400 spectra, and a line must gain more to stay."""

Option = tuple[list[Shape], dict[str, float]]


@dataclass(frozen=True)
class Trial:
    """A model and what its parameters came to."""

    shapes: list[Shape]
    values: dict[str, float]
    cost: float
    """Minus twice the log-likelihood, and what the terms must gain: the least is the best"""
    model: np.ndarray
    """(M,), the density of every ordinate, unit^2 s"""

    @property
    def lines(self) -> list[Shape]:
        return [s for s in self.shapes if is_line(s)]

    @property
    def white(self) -> Shape:
        """White noise, filtered or not."""
        return next(s for s in self.shapes if s.names[0] == "N")

    def has(self, shape: Shape) -> bool:
        return any(s.names == shape.names for s in self.shapes)


def search(
    data: Ordinates, corners: tuple[float, float], say: Callable[[str], None] = lambda what: None
) -> Trial:
    """The model that explains the data best. say : told what is being tried."""
    begin = try_out(data, core(corners), {})
    best = _shaken(data, _grown(data, begin, say), say)
    if best.lines and peaks(data, best.model):  # it may have stuck
        together = _all_peaks(data, begin, say)
        if together.lines:
            other = _shaken(data, _grown(data, together, say), say)
            best = min(best, other, key=lambda t: t.cost)
    return best


def try_out(
    data: Ordinates,
    shapes: list[Shape],
    start: dict[str, float],
    rough: bool = False,
) -> Trial:
    """Fit a model from this start; coefficients without one start from the data. A rough trial
    takes few steps, and lines stay as they are except where another is near."""
    likelihood = Likelihood(data, shapes)
    guess = np.log([first_guess(data, s, n, start) for s in shapes for n in s.names])
    if rough:
        held = {likelihood.names.index(n): np.log(start[n]) for n in _far_lines(shapes, start)}
        p, value = likelihood.minimise(guess, held, 10, 0.3)
    else:
        p, value = likelihood.minimise(guess, None, 40, 1e-3)
    values = dict(zip(likelihood.names, np.exp(p).tolist(), strict=True))
    return Trial(shapes, values, 2 * value + _needed(shapes), likelihood.variance(p)[0])


def _needed(shapes: list[Shape]) -> float:
    """What all optional terms together must gain."""
    total = 0.0
    for shape in shapes:
        if shape.names not in (("N",), ("B",), ("K",)):
            name = "line_sigma" if is_line(shape) else shape.names[0]
            total += _COSTS["fast" if shape.names == BUTTERWORTH_WHITE.names else name]
    return total


def _far_lines(shapes: list[Shape], values: dict[str, float]) -> Iterator[str]:
    """The parameters of lines that are far from the last term, if that is a line, and of all but
    those, if not."""
    lines = [s for s in shapes if is_line(s)]
    last = shapes[-1] if is_line(shapes[-1]) else None
    for shape in lines:
        if last is not None:
            f, w = ([values[s.names[i]] for s in (shape, last)] for i in (1, 2))
            if abs(f[0] - f[1]) < 4 * (w[0] + w[1]):
                continue
        yield from shape.names


def is_sensible(trial: Trial, data: Ordinates) -> bool:
    """Whether each part is what its name says, and does not mend another part's shape: a line is
    narrow, a Gauss-Markov process slower than the samples and not the whole log, and a filter lets
    half of the power through at a frequency that the log holds, or, where its damping is given, at
    one that still shows in what the means over samples let through."""
    values = trial.values
    duration = data.n * data.dt
    time = values.get("GM_T", 0.1 * duration)
    narrow = all(
        values[name.replace("f0", "width")] <= 0.3 * f0
        for name, f0 in values.items()
        if name.startswith("line_f0")
    )
    shows = True
    if "bandwidth" in values:
        white = trial.white
        damping = values["damping"] if "damping" in values else given_damping(white)
        most = 20.0 if white is BUTTERWORTH_WHITE else 0.75
        shows = half_power_ratio(damping) * values["bandwidth"] < most / data.dt
    return narrow and shows and 10 * data.dt <= time <= 0.3 * duration


def half_power_ratio(damping: float) -> float:
    """The frequency at which a second-order low-pass lets half of the power through, over its
    natural one: x with (1 - x^2)^2 + (2 damping x)^2 = 2."""
    b = 1 - 2 * damping**2
    return float(np.sqrt(b + np.sqrt(b**2 + 1)))


def _best(data: Ordinates, options: Sequence[Option]) -> list[Trial]:
    """The two most promising of a short trial of each, fitted; sensible ones only."""
    rough = [try_out(data, *option, rough=True) for option in options]
    rough = sorted((t for t in rough if np.isfinite(t.cost)), key=lambda t: t.cost)[:2]
    fine = [try_out(data, t.shapes, t.values) for t in rough]
    return sorted((t for t in fine if is_sensible(t, data)), key=lambda t: t.cost)


def _grown(data: Ordinates, best: Trial, say: Callable[[str], None]) -> Trial:
    """The model with terms added while that gains."""
    while len(best.shapes) < _MOST_TERMS:
        say(f"{len(best.shapes)} terms, one more")
        trials = _best(data, list(_extensions(data, best)))
        if not trials or trials[0].cost > best.cost - 0.5:
            break
        best = trials[0]
    return best


def _shaken(data: Ordinates, best: Trial, say: Callable[[str], None]) -> Trial:
    """Terms left out, lines split and merged, while any of that gains."""
    for _ in range(_ROUNDS):
        say(f"{len(best.shapes)} terms, shaken")
        fewer = _best(data, list(_reductions(best)))
        if fewer and fewer[0].cost < best.cost:
            best = fewer[0]
            continue
        if not best.lines:
            break
        trials = _best(data, [*_splits(best), *_other_flanks(best)])
        if not trials or trials[0].cost > best.cost - 0.5:
            break
        best = _grown(data, trials[0], say)
    return best


def _extensions(data: Ordinates, best: Trial) -> Iterator[Option]:
    """The model with one part more, each way; a filter also together with a line, since either
    may hide the other. Shapes found so far are kept as guesses, and coefficients guessed afresh:
    a model that lacked a part may have pushed them to zero."""
    own = {s.names[0] for s in best.lines}
    known = {n: v for n, v in best.values.items() if n in own or _is_shape(n)}
    if not best.has(QUANTISATION):
        yield [*best.shapes, QUANTISATION], known
    others = [s for s in best.shapes if s is not best.white]
    unfiltered = len(best.white.names) == 1
    if unfiltered:
        yield [BUTTERWORTH_WHITE, *others], {**known, "bandwidth": 2 / data.dt}
    if unfiltered or best.white is BUTTERWORTH_WHITE:
        for b in (0.1, 0.3, 0.6):
            yield [FILTERED_WHITE, *others], {**known, "bandwidth": b / data.dt, "damping": 0.7}
    elif best.white is FILTERED_WHITE and best.values["damping"] > 0.9:
        yield [FIRST_ORDER, *others], {**known, "bandwidth": 3 * best.values["bandwidth"]}
    if not best.has(GAUSS_MARKOV):
        for time in (1.0, 10.0, 100.0):
            yield [*best.shapes, GAUSS_MARKOV], {**known, "GM_T": time}
    another, resonance = (line(1 + len(best.lines), n) for n in (2, 1))
    for peak in peaks(data, best.model):
        guess = {**known, **dict(zip(another.names, peak, strict=True))}
        yield [*best.shapes, another], guess
        yield [*best.shapes, resonance], guess
        if unfiltered:
            both = {**guess, "bandwidth": 0.3 / data.dt, "damping": 0.7}
            yield [FILTERED_WHITE, *others, another], both


def _is_shape(name: str) -> bool:
    return name.startswith(("line_", "GM_T", "bandwidth", "damping"))


def _reductions(best: Trial) -> Iterator[Option]:
    """The model without each of its optional parts, and with each pair of lines as one."""
    for shape in best.shapes:
        rest = [s for s in best.shapes if s is not shape]
        values = {n: v for n, v in best.values.items() if n not in shape.names or n == "N"}
        if shape.names[0] == "N":
            if len(shape.names) > 1:
                yield [core()[0], *rest], values
        elif len(shape.names) > 1 or shape.names == QUANTISATION.names:
            yield renumbered(rest, values)
    ordered = sorted(best.lines, key=lambda s: best.values[s.names[1]])
    for one, two in pairwise(ordered):
        (s1, f1, w1), (s2, f2, w2) = ([best.values[n] for n in s.names] for s in (one, two))
        if f2 - f1 > 3 * (w1 + w2):
            continue
        share = s1**2 / (s1**2 + s2**2)
        merged = {
            one.names[0]: float(np.hypot(s1, s2)),
            one.names[1]: share * f1 + (1 - share) * f2,
            one.names[2]: max(w1, w2, f2 - f1),
        }
        rest = [s for s in best.shapes if s is not two]
        values = {n: v for n, v in best.values.items() if n not in two.names}
        yield renumbered(rest, {**values, **merged})


def _splits(best: Trial) -> Iterator[Option]:
    """The model with a line made two: side by side, or a sharp one on a wide one."""
    another = line(1 + len(best.lines))
    for shape in best.lines:
        sigma, f0, width = (best.values[n] for n in shape.names)
        for (s1, f1, w1), (s2, f2, w2) in (
            ((0.7, -0.35, 0.5), (0.7, 0.35, 0.5)),
            ((0.85, -0.15, 0.6), (0.5, 0.45, 0.4)),
            ((0.85, 0.15, 0.6), (0.5, -0.45, 0.4)),
            ((0.85, 0.0, 0.6), (0.5, 0.0, 2.5)),
        ):
            first = (s1 * sigma, f0 + f1 * width, w1 * width)
            second = (s2 * sigma, f0 + f2 * width, w2 * width)
            guess = {**best.values, **dict(zip(shape.names, first, strict=True))}
            guess |= dict(zip(another.names, second, strict=True))
            yield [*best.shapes, another], guess


def _other_flanks(best: Trial) -> Iterator[Option]:
    """The model with a line a resonance, or the other way, each and all of them."""
    turned = {id(s): line(i + 1, 3 - poles(s)) for i, s in enumerate(best.lines)}
    yield [turned.get(id(s), s) for s in best.shapes], best.values
    for shape in best.lines if len(best.lines) > 1 else ():
        yield [turned[id(s)] if s is shape else s for s in best.shapes], best.values


def peaks(data: Ordinates, model: np.ndarray, most: int = 3) -> list[tuple[float, float, float]]:
    """Where the spectrum stands highest above the model, smoothed over windows of several widths:
    a line's rms, frequency and width for each such place, the most promising first."""
    count, power = data.count, data.power / model
    total = np.concatenate([[0.0], np.cumsum(power)])
    number = np.concatenate([[0.0], np.cumsum(count)])
    found: list[tuple[float, int, int]] = []
    for window in _WINDOWS:
        if window >= len(count):
            break
        r, c = total[window:] - total[:-window], number[window:] - number[:-window]
        ratio = np.maximum(r / c, 1.0)
        gain = 0.5 * c * (ratio - 1 - np.log(ratio))
        gain[c < 4] = 0
        top = gain == scipy.ndimage.maximum_filter1d(gain, 2 * window + 1)
        found += [(float(gain[i]), int(i), int(i + window)) for i in np.flatnonzero(top)]
    out: list[tuple[float, float, float]] = []
    taken = np.zeros(len(count), bool)
    for gain_, begin, end in sorted(found, reverse=True):
        if gain_ < _PEAK or len(out) == most:
            break
        if taken[begin:end].any():
            continue
        taken[max(begin - 1, 0) : end + 1] = True
        out.append(_peak(data, model, begin, end))
    return out


def _peak(data: Ordinates, model: np.ndarray, begin: int, end: int) -> tuple[float, float, float]:
    inside, f = slice(begin, end), data.grid.f
    excess = (data.power / data.count - model)[inside] * data.grid.width[inside]
    weight = np.maximum(excess, 0)
    centre = float(np.sum(weight * f[inside]) / np.sum(weight))
    width = max(float(np.sum(data.grid.width[inside])), 4 / (data.n * data.dt))
    width = min(width, 0.25 * centre)
    return float(np.sqrt(2 * max(np.sum(excess), 1e-3 * np.sum(weight)))), centre, width


def _all_peaks(data: Ordinates, begin: Trial, say: Callable[[str], None]) -> Trial:
    """The core and a line at every peak above the spectrum's local level, at once."""
    say("all peaks at once")
    level = scipy.ndimage.median_filter(data.power / data.count, 101, mode="nearest")
    shapes: list[Shape] = list(begin.shapes)
    values: dict[str, float] = {}
    for i, peak in enumerate(peaks(data, level, 8)):
        another = line(i + 1)
        shapes.append(another)
        values |= dict(zip(another.names, peak, strict=True))
    return try_out(data, shapes, values)


def first_guess(data: Ordinates, shape: Shape, name: str, given: dict[str, float]) -> float:
    if name in given:
        return given[name]
    top = data.f > 0.05 * data.f[-1]
    white = float(np.sqrt(np.sum(data.power[top]) / np.sum(data.count[top])))
    if name == "N":
        several = data.count > 2  # of one, the median would be half the mean
        if not several.any():
            return white
        return float(np.sqrt(np.median((data.power / data.count)[several])))
    if name == "Q":
        return white * np.sqrt(data.dt) / 10
    # As much as the lowest twenty coefficients hold, shared.
    low = float(np.sum(data.power[:20]) / np.sum(data.count[:20]))
    others = tuple(given[n] for n in shape.names[1:])
    unit = Likelihood(data, []).unit_variance(shape, others)
    return float(np.sqrt(max(low, 1e-3 * white**2) / unit[:20].mean() / 2))
