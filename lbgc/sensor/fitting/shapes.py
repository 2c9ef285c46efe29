"""What a fitted model is made of: noise terms whose parameters are free."""

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
    """A term whose first parameter is its coefficient and whose others are its shape. It can be
    sent to another process."""

    names: tuple[str, ...]
    build: Callable[..., GaussianTerm]

    def unit_term(self, shape: Sequence[float]) -> GaussianTerm:
        return self.build(1.0, *shape)


@dataclass(frozen=True)
class FlickerBetween:
    """Builds a bias instability between these corners of its floor."""

    short: float
    """s"""
    long: float
    """s"""

    def __call__(self, b: float) -> Flicker:
        return Flicker(b, self.short, self.long)


def flicker(corners: tuple[float, float]) -> Shape:
    """Bias instability, whose corners (s) are given."""
    return Shape(("B",), FlickerBetween(*corners))


def core(corners: tuple[float, float] = (1.0, 3600.0)) -> list[Shape]:
    """White noise, bias instability and rate random walk: always fitted."""
    return [Shape(("N",), White), flicker(corners), Shape(("K",), RandomWalk)]


QUANTISATION = Shape(("Q",), AngleQuantisation)
GAUSS_MARKOV = Shape(("GM_sigma", "GM_T"), GaussMarkov)
FILTERED_WHITE = Shape(("N", "bandwidth", "damping"), BandLimited)
BUTTERWORTH_WHITE = Shape(("N", "bandwidth"), BandLimited)
"""Filtered white noise with the usual damping: of a filter faster than the samples no more shows
than that."""
FIRST_ORDER_DAMPING = 2.0
FIRST_ORDER = Shape(("N", "bandwidth"), partial(BandLimited, damping=FIRST_ORDER_DAMPING))
"""White noise behind a filter whose other pole is fourteen times as fast."""


def line(k: int, poles: int = 2) -> Shape:
    """The k-th line of a model, from 1 on; the first goes without a number."""
    number = "" if k == 1 else f"_{k}"
    names = ("line_sigma", "line_f0", "line_width")
    return Shape(tuple(name + number for name in names), partial(Line, poles=poles))


def given_damping(shape: Shape) -> float:
    """Damping ratio of filtered white noise whose damping is no parameter."""
    term = shape.unit_term((1.0,))
    assert isinstance(term, BandLimited)
    return term.damping


def is_line(shape: Shape) -> bool:
    return shape.names[0].startswith("line_sigma")


def poles(shape: Shape) -> int:
    """Number of poles of a line: 1 or 2."""
    term = shape.unit_term((1.0, 1.0))
    assert isinstance(term, Line)
    return term.poles


def renumbered(
    shapes: Sequence[Shape], values: dict[str, float]
) -> tuple[list[Shape], dict[str, float]]:
    """A model with its lines numbered from 1 on."""
    out: list[Shape] = []
    named = {n: v for n, v in values.items() if not n.startswith("line_")}
    for shape in shapes:
        new = shape
        if is_line(shape):
            new = line(1 + sum(map(is_line, out)), poles(shape))
            named |= dict(zip(new.names, (values[n] for n in shape.names), strict=True))
        out.append(new)
    return out, named
