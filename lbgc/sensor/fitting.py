"""Which noise a static recording has: maximum likelihood, with profile-likelihood intervals."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.fft

from lbgc.sensor import gaussian, noise
from lbgc.sensor.counts import Counts
from lbgc.sensor.likelihood import Likelihood
from lbgc.sensor.ordinates import Ordinates
from lbgc.sensor.profile import Estimate, interval
from lbgc.sensor.search import search, try_out
from lbgc.sensor.shapes import Shape
from lbgc.sensor.tones import Tone
from lbgc.sensor.warmup import Course


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
    begun = try_out(data, shapes, start or {})
    likelihood = Likelihood(data, shapes)
    p, best = likelihood.minimise(np.log([begun.values[name] for name in likelihood.names]))
    estimates = {name: interval(likelihood, p, best, i) for i, name in enumerate(likelihood.names)}
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
    """Fit the core and whatever else the data ask for; see `lbgc.sensor.search`.

    say : told what is being tried.
    """
    best = search(data, corners, say)
    say(f"intervals of {len(best.values)} parameters")
    return fit(data, best.shapes, best.values)


def _ramp(likelihood: Likelihood, p: np.ndarray) -> Estimate:
    """Generalised least squares of a straight line in the low coefficients."""
    d = likelihood.data
    time = (np.arange(d.n) + 0.5) * d.dt
    lows = d.low.shape[1]
    line = scipy.fft.dct(time, norm="ortho")[1 : lows + 1] * np.sqrt(d.dt)
    weights = line / likelihood.variance(p)[0][:lows]
    slope, sigma = weights @ d.low[0] / (weights @ line), 1 / np.sqrt(weights @ line)
    size = float(abs(slope))
    low = size - 1.96 * sigma if size > 1.96 * sigma else 0.0
    return Estimate(size, float(low), float(size + 1.96 * sigma), float(size + 1.645 * sigma))
