"""The maximum-likelihood fit of a noise model to a static recording, with profile-likelihood
intervals."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from lbgc.errors import require
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
    """The spectrum of a recording and that of the model fitted to it, at M frequencies."""

    f: np.ndarray
    """(M,), frequencies, Hz"""
    recorded: np.ndarray
    """(M,), density of the recording, unit^2 s"""
    model: np.ndarray
    """(M,), density of the model, unit^2 s"""


@dataclass(frozen=True)
class Fit:
    """A fitted noise model of one axis, SI units."""

    shapes: list[Shape]
    """The terms of the model"""
    estimates: dict[str, FittedParameter]
    """Each parameter's value and interval, by its name"""
    bic: float
    """Bayesian information criterion of the model"""
    ramp: FittedParameter
    """Slope R of a linear drift R t, unit/s, given the rest of the model: a random walk may explain
    it as well."""
    tones: tuple[Tone, ...]
    """The sinusoids, which were left out of the spectrum"""
    goodness: Goodness | None = None
    """How well the model explains the recording; None where that was not asked."""
    spectrum: Spectrum | None = None
    """The spectra of recording and model; None where they were not asked."""
    short_corners: dict[float, float] = field(default_factory=dict)
    """Twice the log-likelihood by the bias instability's shorter corner, s; see `corner`."""
    courses: tuple[MeanChange, ...] = ()
    """The mean's changes beyond noise, which were taken out before the noise was fitted."""
    counts: Counts | None = None
    """The samples' counts; None where they have none that matter."""
    rounding: float = 0.0
    """Density of the samples' rounding noise, which is no term of the model: unit^2 s."""
    is_cut_short: bool = False
    """Whether the search for terms ended before it had tried all models."""

    @property
    def printed(self) -> gaussian.Gaussians:
        """The noise of the printed samples: the fitted terms and the samples' rounding."""
        own = (noise.White(float(np.sqrt(self.rounding))),) if self.rounding > 0 else ()
        return (*self.terms(), *own)

    @property
    def everything(self) -> tuple[InRun, ...]:
        """All in-run errors that were found: the printed samples' noise, the drift (unless it is
        only an upper limit) and the tones."""
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
        """The minimum of the Allan deviation of N, B and K, unit, and its averaging time, s. A
        coefficient that the data cannot tell from zero is zero, as in the sensor's file."""
        told = (self.estimates[name] for name in ("N", "B", "K"))
        n, b, k = (0.0 if e.is_limit else e.value for e in told)
        return allan_minimum(n, b, k, self.corners)

    def terms(self) -> gaussian.Gaussians:
        """The fitted terms with their parameters at the maximum of the likelihood, without those
        whose coefficient is zero."""
        return tuple(
            shape.build(*(self.estimates[name].value for name in shape.names))
            for shape in self.shapes
            if self.estimates[shape.names[0]].value > 0
        )


def fit(data: Ordinates, shapes: list[Shape], start: dict[str, float] | None = None) -> Fit:
    """Fit a model of these terms, with an interval for each parameter.

    start : first guesses of parameters, SI; coefficients without one start from the data.
    """
    begun = try_out(data, shapes, start or {})
    likelihood = Likelihood(data, shapes, begun.values)
    p, best = likelihood.minimise(np.log([begun.values[name] for name in likelihood.names]))
    estimates = {name: interval(likelihood, p, best, i) for i, name in enumerate(likelihood.names)}
    if "N" in estimates:
        estimates["N"] = _with_unseen_terms(data, shapes, begun.values, estimates["N"], best)
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
    """Fit the core and the further terms that improve the likelihood enough, with intervals; see
    `lbgc.sensor.fitting.search`.

    corners : s, of the bias instability's floor; say : is told what is being tried; found : a fit
    of data that differ little, from which the search starts.
    """
    values = {} if found is None else {name: e.value for name, e in found.estimates.items()}
    best = search(data, corners, say, None if found is None else (found.shapes, values))
    say(f"intervals of {len(best.values)} parameters")
    return replace(fit(data, best.shapes, best.values), is_cut_short=best.is_cut_short)


def _with_unseen_terms(
    data: Ordinates, shapes: list[Shape], values: dict[str, float], n: FittedParameter, best: float
) -> FittedParameter:
    """White noise with an interval that allows for terms that the sensor may have although the log
    does not show them: a filter too fast for the samples, or a quantisation too fine. Models with
    one of these are weighted by their likelihood, and the interval is that of the mixture."""
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
        sigmas.append(min(sigma, 1.0))  # at most a factor of 2.7 either way
        gains.append(max(2 * (best - likelihood.value(p)), 0.0))
    weights = np.exp((np.array(gains) - max(gains)) / 2)
    ends = mixture_quantiles(weights / weights.sum(), centres, sigmas, (0.025, 0.975, 0.95))
    return FittedParameter(n.value, *np.exp(ends).tolist())


def judged(series: np.ndarray, data: Ordinates, fit: Fit) -> Fit:
    """The fit with its goodness of fit, the spectra and the profile of the shorter corner. Where
    the model fails, each interval is widened by how much the bands of the spectrum disagree about
    its parameter. series : (R, n), unit, the series that the data were made of."""
    values = {name: e.value for name, e in fit.estimates.items()}
    shows = any(values[s.names[0]] > 0 for s in fit.shapes)
    what = "show no noise beside their tones and their rounding to counts; give a longer log"
    require(shows, "samples", data.n, what)
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
    """The slope of a straight line, unit/s, by generalised least squares in the low cosine
    coefficients of the first recording, at log-parameters p of the noise."""
    d = likelihood.data
    k = np.arange(1, d.low.shape[1] + 1)
    lows = len(k)
    # The cosine transform of t: the sum of (j + 1/2) cos(pi k (j + 1/2)/n) over j.
    line = -(k % 2) / 2 / np.sin(np.pi * k / (2 * d.n)) ** 2 * np.cos(np.pi * k / (2 * d.n))
    line = line * np.sqrt(2 / d.n) * d.dt * np.sqrt(d.dt)
    weights = line / likelihood.variance(p)[0][:lows]
    slope, sigma = weights @ d.low[0] / (weights @ line), 1 / np.sqrt(weights @ line)
    size = float(abs(slope))
    low = size - 1.96 * sigma if size > 1.96 * sigma else 0.0
    return FittedParameter(
        size, float(low), float(size + 1.96 * sigma), float(size + 1.645 * sigma)
    )
