"""The models that a search for terms tries next: with a term more or less, with lines split, merged
or made resonances, and with lines at the peaks of the spectrum above the model.

Each proposal is the terms of a model and the values at which their parameters start. Shape
parameters that were found so far are kept as such values.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import scipy.ndimage

from lbgc.sensor.fitting.likelihood import WIDEST
from lbgc.sensor.fitting.ordinates import Ordinates
from lbgc.sensor.fitting.shapes import (
    BUTTERWORTH_WHITE,
    FILTERED_WHITE,
    FIRST_ORDER,
    GAUSS_MARKOV,
    QUANTISATION,
    Shape,
    core,
    is_line,
    line,
    poles,
    renumbered,
)
from lbgc.sensor.fitting.trial import Trial

MOST_TERMS = 12
"""Terms of a model, at most."""
_WINDOWS = (1, 2, 4, 8, 16, 32, 64, 128)
"""Widths, in ordinates, over which the spectrum is smoothed to find peaks."""
_PEAK = 15.0
"""Gain in log-likelihood that a peak must promise to be tried. Noise alone reaches it once in some
400 spectra, and a line must gain more to stay."""

Option = tuple[list[Shape], dict[str, float]]
"""A proposal: the terms of a model, and start values of parameters, SI, by name."""


def extensions(data: Ordinates, best: Trial) -> Iterator[Option]:
    """The model with one term more, in each possible way; a filter also together with a line, since
    either may hide the other. Shape parameters found so far are kept as start values. Coefficients
    are guessed anew, because a model that lacked a term may have pushed them to zero."""
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
    """Whether a parameter is kept as a start value when a term is added."""
    return name.startswith(("line_", "GM_T", "bandwidth", "damping"))


def reductions(best: Trial) -> Iterator[Option]:
    """The model without each of its optional terms in turn, and with each pair of neighbouring
    lines merged into one."""
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


def without_pedestals(data: Ordinates, best: Trial) -> Iterator[Option]:
    """The model without its pedestals, the lines that are as wide as lines may be or that surround
    a narrower one: together they may imitate an output filter, or the flanks of a resonance. So a
    filter is put in their place, or lines are turned into resonances."""
    rest = [s for s in best.shapes if not is_line(s) or not _is_pedestal(s, best)]
    if len(rest) == len(best.shapes):
        return
    for b in (0.1, 0.3, 0.6):
        shapes = [FILTERED_WHITE if s is best.white else s for s in rest]
        yield renumbered(shapes, {**best.values, "bandwidth": b / data.dt, "damping": 0.7})
    steep = [s for s in rest if is_line(s) and poles(s) == 2]
    for turned in [*([s] for s in steep), steep]:
        shapes, values = renumbered([*(s for s in rest if s not in turned), *turned], best.values)
        first = len(shapes) - len(turned)
        number = 1 + sum(map(is_line, shapes[:first]))
        yield [*shapes[:first], *(line(number + i, 1) for i in range(len(turned)))], values


def _is_pedestal(shape: Shape, best: Trial) -> bool:
    """Whether a line is nearly as wide as lines may be, or wide and around a narrower line."""
    f0, width = (best.values[n] for n in shape.names[1:])
    others = ([best.values[n] for n in s.names[1:]] for s in best.lines if s is not shape)
    return width > 0.8 * WIDEST * f0 or any(abs(f - f0) < width > 1.5 * w for f, w in others)


def splits(best: Trial) -> Iterator[Option]:
    """The model with one of its lines split into two, side by side or a narrow one on a wide
    one."""
    another = line(1 + len(best.lines))
    for shape in best.lines if len(best.shapes) < MOST_TERMS else ():
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


def other_flanks(best: Trial) -> Iterator[Option]:
    """The model with lines of two poles turned into resonances of one pole, and the other way: all
    of them, and each alone."""
    turned = {id(s): line(i + 1, 3 - poles(s)) for i, s in enumerate(best.lines)}
    yield [turned.get(id(s), s) for s in best.shapes], best.values
    for shape in best.lines if len(best.lines) > 1 else ():
        yield [turned[id(s)] if s is shape else s for s in best.shapes], best.values


def peaks(data: Ordinates, model: np.ndarray, most: int = 3) -> list[tuple[float, float, float]]:
    """The peaks of the spectrum above the model, smoothed over windows of several widths: for each
    the rms (unit), the frequency (Hz) and the width (Hz) of a line, the most promising first.

    model : (M,), density at every ordinate, unit^2 s; most : the largest number of peaks.
    """
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
    """The rms, frequency and width of a line from the excess of ordinates begin to end - 1."""
    inside, f = slice(begin, end), data.grid.f
    excess = (data.power / data.count - model)[inside] * data.grid.width[inside]
    weight = np.maximum(excess, 0)
    centre = float(np.sum(weight * f[inside]) / np.sum(weight))
    width = max(float(np.sum(data.grid.width[inside])), 4 / (data.n * data.dt))
    width = min(width, 0.25 * centre)
    return float(np.sqrt(2 * max(np.sum(excess), 1e-3 * np.sum(weight)))), centre, width
