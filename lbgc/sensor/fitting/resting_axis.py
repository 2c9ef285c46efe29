"""The noise fit of one axis of a resting IMU as recorded: changes of the mean that noise does not
explain are taken out first, and the effect of counts on the noise is allowed for."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lbgc.sensor.fitting import counts, warmup
from lbgc.sensor.fitting.counts import Counts
from lbgc.sensor.fitting.noise_fit import Fit, choose, judged
from lbgc.sensor.fitting.noise_fit import fit as fit_terms
from lbgc.sensor.fitting.ordinates import pooled
from lbgc.sensor.fitting.profile import FittedParameter
from lbgc.sensor.fitting.shapes import QUANTISATION, core
from lbgc.sensor.noise import AngleQuantisation

_FLICKER = 0.02
"""Relative error of N under coarse counts, 1 sigma, from flicker that is taken for white noise."""
_HIDDEN = 0.9
"""Share of a slow change that counts may hide, above which the counts tell nothing of it."""


def fitted(
    series: np.ndarray,
    dt: float,
    corners: tuple[float, float],
    say: Callable[[str], None] = lambda what: None,
) -> Fit:
    """Fit the noise of one axis.

    series : (R, n), unit, R recordings of the axis; dt : s; corners : s, of the bias instability's
    floor; say : is told what is being tried.
    """
    say("counts and warm-up")
    seen = counts.judged(series[0])
    settled = [warmup.taken_out(one, dt, corners, len(series)) for one in series]
    rest = settled[0][0][None] if len(settled) == 1 else np.stack([own for own, _ in settled])
    plain = pooled(rest, dt)
    rounding = 0.0 if seen is None else seen.rounding(dt)
    data = replace(plain, rounding=rounding)
    if seen is not None and seen.kind == "beating":
        fit = fit_terms(data, [*core(corners), QUANTISATION])
    else:
        fit = choose(data, corners, say)
    if seen is not None and rounding > 0 and _is_carried(fit, seen.lsb * dt):
        seen, data = replace(seen, kind="carried"), plain
        fit = choose(data, corners, say, fit)
    say("goodness of fit")
    found = judged(rest, data, fit)
    if seen is not None and seen.hides_noise:  # no Gaussian model describes such counts
        no_vote = dict.fromkeys(found.short_corners, 0.0)
        found = replace(found, estimates=fit.estimates, goodness=None, short_corners=no_vote)
    fit = found
    courses = tuple(course for _, own in settled for course in own)
    ramp = next((c for c in courses if c.kind == "ramp"), None)
    fit = replace(fit, courses=courses, counts=seen)
    if ramp is not None:
        fit = replace(fit, ramp=_slope(ramp.size / ramp.duration, ramp.sigma / ramp.duration))
    return fit if seen is None else _through_counts(fit, seen, dt)


def _is_carried(fit: Fit, angle: float) -> bool:
    """Whether the fit found angle quantisation as large as a count's, which shows that the counts'
    remainder is carried over; then no rounding noise is to be taken out. angle : of a count, unit
    s."""
    quantisation = fit.estimates.get("Q")
    least = 0.9 * AngleQuantisation.of_count(angle).Q
    return quantisation is not None and quantisation.high > least


def _slope(size: float, sigma: float) -> FittedParameter:
    """The slope of a ramp, unit/s, with its interval from a normal law."""
    size = abs(size)
    low = max(size - 1.96 * sigma, 0.0)
    return FittedParameter(size, low, size + 1.96 * sigma, size + 1.645 * sigma)


def _through_counts(fit: Fit, seen: Counts, dt: float) -> Fit:
    """The fit as far as it holds where counts are coarser than the noise. N comes from the counts'
    own likelihood, or is withheld where the noise is not white. Intervals of slow terms are widened
    by the share by which counts may show a slow change too large or too small."""
    if seen.kind == "beating":
        return _beating(fit, seen.lsb, dt)
    if not seen.hides_noise:
        return fit
    coefficients = {shape.names[0] for shape in fit.shapes} - {"N", "Q"}
    estimates = {
        name: _blurred(e, seen.blur) if name in coefficients else e
        for name, e in fit.estimates.items()
    }
    scale = seen.lsb * np.sqrt(dt)
    if seen.kind == "memory":
        estimates["N"] = _withheld(fit.estimates["N"])
    else:
        # The allowance for terms that the log does not show (a filter too fast for it) holds here,
        # too: the upper ends are at least as far away as the fit's.
        e, value = fit.estimates["N"], seen.sigma * scale
        room = 1.0 if e.is_limit or e.is_lower_limit else e.high / e.value
        low, high, upper = (_blunted(end, seen.sigma) for end in (seen.low, seen.high, seen.upper))
        high, upper = (max(end * scale, value * room) for end in (high, upper))
        estimates["N"] = FittedParameter(value, low * scale, float(high), float(upper))
    return replace(fit, estimates=estimates, ramp=_blurred(fit.ramp, seen.blur))


def _beating(fit: Fit, lsb: float, dt: float) -> Fit:
    """The fit of an axis whose counts beat with the mean rate: only their quantisation is known."""
    quantisation = AngleQuantisation.of_count(lsb * dt)
    told = {name: FittedParameter(0.0, 0.0, np.inf, np.inf) for name in fit.estimates}
    told["Q"] = FittedParameter(*[quantisation.Q] * 4)
    spectrum = fit.spectrum
    if spectrum is not None:
        spectrum = replace(spectrum, model=quantisation.psd(spectrum.f, dt))
    return replace(fit, estimates=told, spectrum=spectrum, tones=())


def _blunted(end: float, sigma: float) -> float:
    """An end of sigma's interval, moved out as if sigma had another error of 2%, because the
    likelihood of the counts takes all noise for white, and some of it is flicker."""
    if end == 0 or end == sigma:
        return end
    off = np.log(end / sigma)
    return float(sigma * np.exp(np.sign(off) * np.hypot(off, 1.96 * _FLICKER)))


def _blurred(e: FittedParameter, blur: float) -> FittedParameter:
    """The estimate with its interval widened, because counts may change a slow change by the share
    `blur`; withheld where they may hide it."""
    if blur > _HIDDEN:
        return _withheld(e)
    return FittedParameter(e.value, e.low / (1 + blur), e.high / (1 - blur), e.upper / (1 - blur))


def _withheld(e: FittedParameter) -> FittedParameter:
    """The estimate without an interval, because the data do not tell the figure; its value is only
    what they look like."""
    return FittedParameter(e.value, 0.0, np.inf, np.inf)
