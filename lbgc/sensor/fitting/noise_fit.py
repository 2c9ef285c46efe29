"""Which noise a static recording has: maximum likelihood, with profile-likelihood intervals."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.fft

from lbgc.sensor import gaussian, noise
from lbgc.sensor.deterministic import InRun, Ramp, Sinusoid
from lbgc.sensor.fitting import corner
from lbgc.sensor.fitting.counts import Counts
from lbgc.sensor.fitting.goodness import Goodness, judge
from lbgc.sensor.fitting.likelihood import Likelihood
from lbgc.sensor.fitting.ordinates import Ordinates
from lbgc.sensor.fitting.profile import FittedParameter, interval, mixture_quantiles, widened
from lbgc.sensor.fitting.search import search
from lbgc.sensor.fitting.shapes import BUTTERWORTH_WHITE, QUANTISATION, FlickerBetween, Shape
from lbgc.sensor.fitting.tones import Tone
from lbgc.sensor.fitting.trial import try_out
from lbgc.sensor.fitting.warmup import MeanChange
from lbgc.sensor.instability import allan_minimum


@dataclass(frozen=True, eq=False)
class Spectrum:
    """What was fitted to what: densities of the recording and of the model, (M,), unit^2 s."""

    f: np.ndarray
    """Hz"""
    recorded: np.ndarray
    model: np.ndarray


@dataclass(frozen=True)
class Fit:
    """A fitted model of one axis, SI units."""

    shapes: list[Shape]
    estimates: dict[str, FittedParameter]
    bic: float
    ramp: FittedParameter
    """Slope R of a linear drift R t, given the rest of the model: a random walk may explain it as
    well."""
    tones: tuple[Tone, ...]
    goodness: Goodness | None = None
    """How well the model explains the recording; None where that was not asked."""
    spectrum: Spectrum | None = None
    short_corners: dict[float, float] = field(default_factory=dict)
    """Twice the log-likelihood by the bias instability's shorter corner, s; see `corner`."""
    courses: tuple[MeanChange, ...] = ()
    """What the mean does beyond noise: taken out before the noise was fitted."""
    counts: Counts | None = None
    """The samples' counts, where they have any."""
    rounding: float = 0.0
    """Density of the samples' rounding, beside the terms: unit^2 s."""
    is_cut_short: bool = False
    """Whether the search for terms had more to try when it ended."""

    @property
    def printed(self) -> gaussian.Gaussians:
        """The fitted terms and the samples' rounding: the noise of what was printed."""
        own = (noise.White(float(np.sqrt(self.rounding))),) if self.rounding > 0 else ()
        return (*self.terms(), *own)

    @property
    def everything(self) -> tuple[InRun, ...]:
        """All that was found, the drift and the tones besides."""
        tones = tuple(Sinusoid(tone.amplitude, tone.f) for tone in self.tones)
        ramp = () if self.ramp.is_limit else (Ramp(self.ramp.value),)
        return (*self.printed, *ramp, *tones)

    @property
    def corners(self) -> tuple[float, float]:
        """Shorter and longer corner of the bias instability's floor, s."""
        build = next(s.build for s in self.shapes if s.names == ("B",))
        assert isinstance(build, FlickerBetween)
        return build.short, build.long

    @property
    def allan_minimum(self) -> tuple[float, float]:
        """The lowest point of the Allan deviation of N, B and K, unit, and its averaging time, s;
        what the data cannot tell from zero is zero, as the sensor's file has it."""
        told = (self.estimates[name] for name in ("N", "B", "K"))
        n, b, k = (0.0 if e.is_limit else e.value for e in told)
        return allan_minimum(n, b, k, self.corners)

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
    likelihood = Likelihood(data, shapes, begun.values)
    p, best = likelihood.minimise(np.log([begun.values[name] for name in likelihood.names]))
    estimates = {name: interval(likelihood, p, best, i) for i, name in enumerate(likelihood.names)}
    if "N" in estimates:
        estimates["N"] = _allowing(data, shapes, begun.values, estimates["N"], best)
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
    found: Fit | None = None,
) -> Fit:
    """Fit the core and whatever else the data ask for; see `lbgc.sensor.fitting.search`.

    say : told what is being tried; found : of data that differ little, to go on from.
    """
    values = {} if found is None else {name: e.value for name, e in found.estimates.items()}
    best = search(data, corners, say, None if found is None else (found.shapes, values))
    say(f"intervals of {len(best.values)} parameters")
    return replace(fit(data, best.shapes, best.values), is_cut_short=best.is_cut_short)


def _allowing(
    data: Ordinates, shapes: list[Shape], values: dict[str, float], n: FittedParameter, best: float
) -> FittedParameter:
    """White noise's interval, with an allowance for what the log does not show but may have: a
    filter too fast for it, a quantisation too fine. Models with one of these are weighed by
    their likelihood, and the interval is that of the mixture."""
    if n.is_limit or n.is_lower_limit:
        return n
    white = next(s for s in shapes if s.names[0] == "N")
    others = [s for s in shapes if s is not white]
    options = []
    if len(white.names) == 1:
        start = {**values, "bandwidth": 0.6 / data.dt}
        options.append(([BUTTERWORTH_WHITE, *others], start))
    if all(s.names != QUANTISATION.names for s in shapes):
        options.append(([*shapes, QUANTISATION], dict(values)))
    centres, sigmas, gains = [np.log(n.value)], [np.log(n.high / n.low) / (2 * 1.96)], [0.0]
    for terms, start in options:
        begun = try_out(data, terms, start)
        likelihood = Likelihood(data, terms, begun.values)
        p = np.log([begun.values[name] for name in likelihood.names])
        at = likelihood.names.index("N")
        centres.append(max(p[at], centres[0] - 3))
        sigma = np.sqrt(max(likelihood.covariance(p, keep=[at])[at, at], 0.0))
        sigmas.append(min(sigma, 1.0))  # a factor of 2.7 either way is no knowledge at all
        gains.append(max(2 * (best - likelihood.value(p)), 0.0))
    weights = np.exp((np.array(gains) - max(gains)) / 2)
    ends = mixture_quantiles(weights / weights.sum(), centres, sigmas, (0.025, 0.975, 0.95))
    return FittedParameter(n.value, *np.exp(ends).tolist())


def judged(series: np.ndarray, data: Ordinates, fit: Fit) -> Fit:
    """The fit with its goodness. Where the model fails, every interval is as wide as the bands of
    the spectrum differ about its parameter. series : (R, n), what the data are of."""
    values = {name: e.value for name, e in fit.estimates.items()}
    goodness = judge(series, data, fit.shapes, values)
    felt = [s for s in fit.shapes if values[s.names[0]] > 0]
    p = np.log([values[name] for s in felt for name in s.names])
    model = Likelihood(data, felt).variance(p)[0]
    estimates = fit.estimates
    if goodness.fails:
        wide = zip(estimates.items(), goodness.widening, strict=True)
        estimates = {name: widened(e, by) for (name, e), by in wide}
    spectrum = Spectrum(data.grid.f, data.power / data.count, model)
    shorts = corner.profile(data, fit.shapes, values, fit.corners)
    return replace(
        fit, estimates=estimates, goodness=goodness, spectrum=spectrum, short_corners=shorts
    )


def _ramp(likelihood: Likelihood, p: np.ndarray) -> FittedParameter:
    """Generalised least squares of a straight line in the low coefficients."""
    d = likelihood.data
    time = (np.arange(d.n) + 0.5) * d.dt
    lows = d.low.shape[1]
    line = scipy.fft.dct(time, norm="ortho")[1 : lows + 1] * np.sqrt(d.dt)
    weights = line / likelihood.variance(p)[0][:lows]
    slope, sigma = weights @ d.low[0] / (weights @ line), 1 / np.sqrt(weights @ line)
    size = float(abs(slope))
    low = size - 1.96 * sigma if size > 1.96 * sigma else 0.0
    return FittedParameter(
        size, float(low), float(size + 1.96 * sigma), float(size + 1.645 * sigma)
    )
