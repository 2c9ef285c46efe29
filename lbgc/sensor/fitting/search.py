"""Which terms a recording's noise is made of.

From the core (white noise, bias instability, random walk) terms are added one by one, where the
likelihood gains more by them than chance would give in one log of some hundreds: an angle
quantisation, an output filter, a Gauss-Markov process, lines where the spectrum stands above the
model. Such a search sticks: two lines close to each other look like one, and a line hides a filter.
So what was found is also shaken: lines split and merge, every term is left out in turn, those that
imitate a filter or a flank are left out together, and where peaks remain the search starts a second
time from all of them at once.
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
_MOST_TRIALS = 600
"""Models that one search tries, at most; an axis with some ten lines takes 200 to 600. It bounds a
fit's time: counts coarser than the noise beat with the mean rate, in lines without end."""
_GLANCE, _ROUGH, _PROMISING, _FINE = 5, 10, 10, 4
"""Steps of each trial; steps, and how many, of those that promise most; how many of these are
fitted. With two of them a real axis ended 6,700 BIC units above its best, N 2% low."""


def search(
    data: Ordinates,
    corners: tuple[float, float],
    say: Callable[[str], None] = lambda what: None,
    found: Option | None = None,
) -> Trial:
    """The model that explains the data best.

    say : told what is being tried; found : the model of data that differ little, to go on from.
    """
    course = _Search(data, say)
    begin = try_out(data, core(corners), {})
    if found is not None:
        best = course.shaken(course.grown(try_out(data, *found)))
        return replace(best, is_cut_short=course.left <= 0)
    best = course.shaken(course.grown(begin))
    if peaks(data, best.model):  # it may have stuck
        together = course.all_peaks(begin)
        if together.lines:
            other = course.shaken(course.grown(together))
            best = course.ranked([best, other])[0]
    return replace(best, is_cut_short=course.left <= 0)


@dataclass
class _Search:
    """One search's way through the models, and what it may still try."""

    data: Ordinates
    say: Callable[[str], None]
    left: int = _MOST_TRIALS

    def best(self, options: Sequence[Option]) -> list[Trial]:
        """The most promising of a short trial of each, fitted; sensible ones only."""
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
        """Sensible ones first, by their cost: a line that was made wide explains much, too."""
        finite = [t for t in trials if np.isfinite(t.cost)]
        return sorted(finite, key=lambda t: (not is_sensible(t, self.data), t.cost))

    def grown(self, best: Trial) -> Trial:
        """The model with terms added while that gains."""
        while len(best.shapes) < MOST_TERMS:
            self.say(f"{len(best.shapes)} terms, one more")
            trials = self.best(list(extensions(self.data, best)))
            if not trials or trials[0].cost > best.cost - 0.5:
                break
            best = trials[0]
        return best

    def shaken(self, best: Trial) -> Trial:
        """Terms left out, lines split and merged, while any of that gains."""
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
        """The core and a line at every peak above the spectrum's local level, at once."""
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
