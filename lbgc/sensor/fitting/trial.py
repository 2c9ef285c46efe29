"""A trial of a model on an axis's ordinates: its terms, their fitted parameters, and its cost."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lbgc.sensor.fitting.likelihood import WIDEST, Likelihood
from lbgc.sensor.fitting.ordinates import Ordinates
from lbgc.sensor.fitting.shapes import BUTTERWORTH_WHITE, Shape, given_damping, is_line

_COSTS = {"Q": 8.0, "N": 17.0, "fast": 8.0, "GM_sigma": 17.0, "line_sigma": 34.0}
"""What a term must gain in twice the log-likelihood to stay. By chance, chi-squared with as many
degrees of freedom as the term has parameters exceeds it in a few of a thousand logs; for a line,
over all frequencies and widths that it could have."""


@dataclass(frozen=True)
class Trial:
    """A model with its fitted parameters and its cost."""

    shapes: list[Shape]
    """The model's terms"""
    values: dict[str, float]
    """The fitted parameters, SI, by name"""
    cost: float
    """Minus twice the log-likelihood, plus what the terms must gain; the least is the best"""
    model: np.ndarray
    """(M,), the model's density at every ordinate, unit^2 s"""
    is_cut_short: bool = False
    """Whether the search ended before it had tried all models"""

    @property
    def lines(self) -> list[Shape]:
        """The terms that are lines."""
        return [s for s in self.shapes if is_line(s)]

    @property
    def white(self) -> Shape:
        """The term of white noise, filtered or not."""
        return next(s for s in self.shapes if s.names[0] == "N")

    def has(self, shape: Shape) -> bool:
        """Whether the model has a term with this term's parameters."""
        return any(s.names == shape.names for s in self.shapes)


def try_out(
    data: Ordinates,
    shapes: list[Shape],
    start: dict[str, float],
    steps: int = 0,
) -> Trial:
    """Fit a model.

    start : values at which parameters start, SI, by name; coefficients without one start from the
    data. steps : 0 for a full fit; otherwise a rough trial of at most so many steps, in which lines
    are held except near the last term, if that is a line.
    """
    likelihood = Likelihood(data, shapes, start)
    guess = np.log([first_guess(data, s, n, start) for s in shapes for n in s.names])
    if steps:
        held = {likelihood.names.index(n): np.log(start[n]) for n in _far_lines(shapes, start)}
        p, value = likelihood.minimise(guess, held, steps, 0.3)
    else:
        p, value = likelihood.minimise(guess, None, 40, 1e-3)
    values = dict(zip(likelihood.names, np.exp(p).tolist(), strict=True))
    return Trial(shapes, values, 2 * value + _needed(shapes), likelihood.variance(p)[0])


def _needed(shapes: list[Shape]) -> float:
    """What all optional terms together must gain in twice the log-likelihood."""
    total = 0.0
    for shape in shapes:
        if shape.names not in (("N",), ("B",), ("K",)):
            name = "line_sigma" if is_line(shape) else shape.names[0]
            total += _COSTS["fast" if shape.names == BUTTERWORTH_WHITE.names else name]
    return total


def _far_lines(shapes: list[Shape], values: dict[str, float]) -> Iterator[str]:
    """The parameters of the lines that are far from the last term, if that is a line, and of all
    lines if it is not."""
    lines = [s for s in shapes if is_line(s)]
    last = shapes[-1] if is_line(shapes[-1]) else None
    for shape in lines:
        if last is not None:
            f, w = ([values[s.names[i]] for s in (shape, last)] for i in (1, 2))
            if abs(f[0] - f[1]) < 4 * (w[0] + w[1]):
                continue
        yield from shape.names


def is_sensible(trial: Trial, data: Ordinates) -> bool:
    """Whether each term is what its name says, and does not make up for another term's wrong shape:
    a line is narrow; a Gauss-Markov process is slower than the samples and faster than the whole
    log; and a filter's half-power frequency is one that the log holds or, where its damping is
    given, one that still has an effect on means over the samples' interval."""
    values = trial.values
    duration = data.n * data.dt
    time = values.get("GM_T", 0.1 * duration)
    narrow = all(is_narrow(shape, values) for shape in trial.lines)
    shows = True
    if "bandwidth" in values:
        white = trial.white
        damping = values["damping"] if "damping" in values else given_damping(white)
        most = 20.0 if white is BUTTERWORTH_WHITE else 0.75
        shows = half_power_ratio(damping) * values["bandwidth"] < most / data.dt
    return narrow and shows and 10 * data.dt <= time <= 0.3 * duration


def is_narrow(line: Shape, values: dict[str, float]) -> bool:
    """Whether a line is no wider than lines may be, with a margin of 10%."""
    return values[line.names[2]] <= 1.1 * WIDEST * values[line.names[1]]


def half_power_ratio(damping: float) -> float:
    """The half-power frequency of a second-order low-pass over its natural frequency: the x with
    (1 - x^2)^2 + (2 damping x)^2 = 2."""
    b = 1 - 2 * damping**2
    return float(np.sqrt(b + np.sqrt(b**2 + 1)))


def first_guess(data: Ordinates, shape: Shape, name: str, given: dict[str, float]) -> float:
    """The value at which a parameter starts, SI: the given one, or for a coefficient one from the
    ordinates' powers."""
    if name in given:
        return given[name]
    top = data.f > 0.05 * data.f[-1]
    white = float(np.sqrt(np.sum(data.power[top]) / np.sum(data.count[top])))
    if name == "N":
        several = data.count > 2  # of single ordinates the median would be half the mean
        if not several.any():
            return white
        return float(np.sqrt(np.median((data.power / data.count)[several])))
    if name == "Q":
        return float(white * np.sqrt(data.dt) / 10)
    # The term is given half of the power that the lowest twenty ordinates hold.
    low = float(np.sum(data.power[:20]) / np.sum(data.count[:20]))
    others = tuple(given[n] for n in shape.names[1:])
    unit = Likelihood(data, []).unit_variance(shape, others)
    return float(np.sqrt(max(low, 1e-3 * white**2) / unit[:20].mean() / 2))
