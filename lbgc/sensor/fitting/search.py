"""The search for the terms that a recording's noise is made of.

It begins with the core (white noise, bias instability, random walk) and adds terms one by one where
the likelihood gains more by them than it would by chance in one log of some hundreds: an angle
quantisation, an output filter, a Gauss-Markov process, lines where the spectrum exceeds the model.
Such a search may end at a model that is not the best: two lines close to each other look like one,
and a line hides a filter. So the model found is also changed in other ways: lines are split and
merged, every term is left out in turn, and terms that imitate a filter or a line's flank are left
out together. Where peaks remain, the search starts a second time from all of them at once.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage

from lbgc.sensor.fitting.ordinates import Ordinates
from lbgc.sensor.fitting.proposals import (
    MOST_TERMS,
    Option,
    extensions,
    other_flanks,
    peaks,
    reductions,
    splits,
    without_pedestals,
)
from lbgc.sensor.fitting.shapes import Shape, core, is_line, line, renumbered
from lbgc.sensor.fitting.trial import Trial, is_narrow, is_sensible, try_out

_ROUNDS = 12
"""Rounds of leaving out, splitting and merging terms, at most."""
_MOST_TRIALS = 600
"""Models that one search tries, at most; an axis with some ten lines takes 200 to 600. It bounds
the time of a fit, since counts coarser than the noise beat with the mean rate and make lines
without end."""
_GLANCE, _ROUGH, _PROMISING, _FINE = 5, 10, 10, 4
"""Scoring steps of each trial; scoring steps of the most promising trials, and the number of these;
the number of these that are fitted fully. With two fitted fully, a real axis ended 6,700 BIC units
above its best, and N was 2% low."""


def search(
    data: Ordinates,
    corners: tuple[float, float],
    say: Callable[[str], None] = lambda what: None,
    found: Option | None = None,
) -> Trial:
    """Search for the model that explains the data best.

    corners : s, of the bias instability's floor; say : is told what is being tried; found : the
    model of data that differ little, from which the search starts.
    """
    course = _Search(data, say)
    begin = try_out(data, core(corners), {})
    if found is not None:
        best = course.shaken(course.grown(try_out(data, *found)))
        return replace(best, is_cut_short=course.left <= 0)
    best = course.shaken(course.grown(begin))
    if peaks(data, best.model):  # a better model may have been missed
        together = course.all_peaks(begin)
        if together.lines:
            other = course.shaken(course.grown(together))
            best = course.ranked([best, other])[0]
    return replace(best, is_cut_short=course.left <= 0)


@dataclass
class _Search:
    """The state of one search: the data, and how many models it may still try."""

    data: Ordinates
    """The ordinates that models are fitted to"""
    say: Callable[[str], None]
    """Is told what is being tried"""
    left: int = _MOST_TRIALS
    """Number of models that may still be tried"""

    def best(self, options: Sequence[Option]) -> list[Trial]:
        """The best of several models, fitted and ranked: each is tried with few steps, the most
        promising are fitted fully, and those that are not sensible are left out."""
        if self.left <= 0:
            return []
        self.left -= len(options)
        rough = self.ranked(try_out(self.data, *option, steps=_GLANCE) for option in options)
        if len(options) > _PROMISING:
            rough = rough[:_PROMISING]
            rough = self.ranked(try_out(self.data, t.shapes, t.values, _ROUGH) for t in rough)
        fine: list[Trial] = []
        for trial in rough:
            fitted = try_out(self.data, trial.shapes, trial.values)
            if is_sensible(fitted, self.data):
                fine.append(fitted)
            if len(fine) == _FINE:
                break
        return self.ranked(fine)

    def ranked(self, trials: Iterable[Trial]) -> list[Trial]:
        """Trials by their cost, the sensible ones first: a line that became wide explains much, but
        is not sensible."""
        finite = [t for t in trials if np.isfinite(t.cost)]
        return sorted(finite, key=lambda t: (not is_sensible(t, self.data), t.cost))

    def grown(self, best: Trial) -> Trial:
        """The model with terms added one by one for as long as the cost falls."""
        while len(best.shapes) < MOST_TERMS:
            self.say(f"{len(best.shapes)} terms, one more")
            trials = self.best(list(extensions(self.data, best)))
            if not trials or trials[0].cost > best.cost - 0.5:
                break
            best = trials[0]
        return best

    def shaken(self, best: Trial) -> Trial:
        """The model with terms left out, lines split, merged or given other flanks, for as long as
        the cost falls."""
        for _ in range(_ROUNDS):
            self.say(f"{len(best.shapes)} terms, shaken")
            fewer = self.best([*reductions(best), *without_pedestals(self.data, best)])
            if fewer and fewer[0].cost < best.cost:
                best = fewer[0]
                continue
            if not best.lines:
                break
            trials = self.best([*splits(best), *other_flanks(best)])
            if not trials or trials[0].cost > best.cost - 0.5:
                break
            best = self.grown(trials[0])
        return best

    def all_peaks(self, begin: Trial) -> Trial:
        """The core with a line at each of up to eight peaks above the spectrum's local level,
        fitted together; lines that become wide are left out."""
        self.say("all peaks at once")
        spectrum = self.data.power / self.data.count
        level = scipy.ndimage.median_filter(spectrum, 101, mode="nearest")
        shapes: list[Shape] = list(begin.shapes)
        values: dict[str, float] = {}
        for i, peak in enumerate(peaks(self.data, level, 8)):
            another = line(i + 1)
            shapes.append(another)
            values |= dict(zip(another.names, peak, strict=True))
        together = try_out(self.data, shapes, values)
        while not is_sensible(together, self.data) and together.lines:
            rest = [s for s in together.shapes if not is_line(s) or is_narrow(s, together.values)]
            if len(rest) == len(together.shapes):
                break
            together = try_out(self.data, *renumbered(rest, together.values))
        return together
