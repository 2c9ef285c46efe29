"""The terms of a fitted model: noise terms whose parameters are free."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from lbgc.sensor.gaussian import GaussianTerm
from lbgc.sensor.noise import (
    AngleQuantisation,
    BandLimited,
    Flicker,
    GaussMarkov,
    Line,
    RandomWalk,
    White,
)


@dataclass(frozen=True)
class Shape:
    """A noise term with free parameters: the first is its coefficient, and the others are its
    shape parameters. It can be sent to another process."""

    names: tuple[str, ...]
    """The parameters' names, the coefficient first"""
    build: Callable[..., GaussianTerm]
    """Makes the term from the parameters' values, SI"""

    def unit_term(self, shape: Sequence[float]) -> GaussianTerm:
        """The term with coefficient one and these shape parameters, SI."""
        return self.build(1.0, *shape)


@dataclass(frozen=True)
class FlickerBetween:
    """A function that makes a bias instability with given corners of its floor from B."""

    short: float
    """Shorter corner, s"""
    long: float
    """Longer corner, s"""

    def __call__(self, b: float) -> Flicker:
        """The term of this B."""
        return Flicker(b, self.short, self.long)


def flicker(corners: tuple[float, float]) -> Shape:
    """Bias instability with given corners, s; its one parameter is B."""
    return Shape(("B",), FlickerBetween(*corners))


def core(corners: tuple[float, float] = (1.0, 3600.0)) -> list[Shape]:
    """The terms that are always fitted: white noise, bias instability and rate random walk."""
    return [Shape(("N",), White), flicker(corners), Shape(("K",), RandomWalk)]


QUANTISATION = Shape(("Q",), AngleQuantisation)
GAUSS_MARKOV = Shape(("GM_sigma", "GM_T"), GaussMarkov)
FILTERED_WHITE = Shape(("N", "bandwidth", "damping"), BandLimited)
BUTTERWORTH_WHITE = Shape(("N", "bandwidth"), BandLimited)
"""Filtered white noise with the usual damping, for a filter faster than the samples, whose damping
the log does not show."""
FIRST_ORDER_DAMPING = 2.0
"""Damping ratio of `FIRST_ORDER`."""
FIRST_ORDER = Shape(("N", "bandwidth"), partial(BandLimited, damping=FIRST_ORDER_DAMPING))
"""White noise behind a filter of nearly first order, whose second pole is fourteen times as
fast."""


def line(k: int, poles: int = 2) -> Shape:
    """The k-th line of a model, counted from 1. The names of its parameters end in the number,
    except for the first."""
    number = "" if k == 1 else f"_{k}"
    names = ("line_sigma", "line_f0", "line_width")
    return Shape(tuple(name + number for name in names), partial(Line, poles=poles))


def given_damping(shape: Shape) -> float:
    """The damping ratio of filtered white noise of which the damping is not a parameter."""
    term = shape.unit_term((1.0,))
    assert isinstance(term, BandLimited)
    return term.damping


def is_line(shape: Shape) -> bool:
    """Whether a term is a line."""
    return shape.names[0].startswith("line_sigma")


def poles(shape: Shape) -> int:
    """The number of poles of a line, 1 or 2 (see `noise.Line`)."""
    term = shape.unit_term((1.0, 1.0))
    assert isinstance(term, Line)
    return term.poles


def renumbered(
    shapes: Sequence[Shape], values: dict[str, float]
) -> tuple[list[Shape], dict[str, float]]:
    """A model's terms and values with its lines numbered from 1 on, in the order of the terms."""
    out: list[Shape] = []
    named = {n: v for n, v in values.items() if not n.startswith("line_")}
    for shape in shapes:
        new = shape
        if is_line(shape):
            new = line(1 + sum(map(is_line, out)), poles(shape))
            named |= dict(zip(new.names, (values[n] for n in shape.names), strict=True))
        out.append(new)
    return out, named
