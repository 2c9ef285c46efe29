"""One axis of a resting IMU, fitted as it comes: what its mean does beyond noise is taken out
first, and what its counts do to the noise is accounted for."""

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

_FLICKER = 0.02  # of N under coarse counts, 1 sigma
_HIDDEN = 0.9  # of a slow change, that counts may take away, above which they tell nothing of it


def fitted(
    series: np.ndarray,
    dt: float,
    corners: tuple[float, float],
    say: Callable[[str], None] = lambda what: None,
) -> Fit:
    """series : (R, n), unit, recordings of one axis; dt : s; corners : s, of the bias instability's
    floor; say : told what is being tried."""
    say("counts and warm-up")
    seen = counts.judged(series[0])
    settled = [warmup.taken_out(one, dt, corners, len(series)) for one in series]
    rest = np.stack([rest for rest, _ in settled])
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
    if seen is not None and seen.hides_noise:  # a Gaussian spectrum is no model of such counts
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
    """Whether angle quantisation of a count's size was found: that is how a count looks whose rest
    is carried over, and then no rounding is to be taken out. angle : of a count, unit s."""
    quantisation = fit.estimates.get("Q")
    least = 0.9 * AngleQuantisation.of_count(angle).Q
    return quantisation is not None and quantisation.high > least


def _slope(size: float, sigma: float) -> FittedParameter:
    size = abs(size)
    low = max(size - 1.96 * sigma, 0.0)
    return FittedParameter(size, low, size + 1.96 * sigma, size + 1.645 * sigma)


def _through_counts(fit: Fit, seen: Counts, dt: float) -> Fit:
    """The fit with what counts coarser than the noise leave of it: N by their own likelihood, or
    withheld where the noise is not white, and what is slow with intervals as wide as a slow change
    may be seen too large or too small."""
    if seen.kind == "beating":
        return _of_beats(fit, seen.lsb, dt)
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
        # What the log does not show but may have (a filter too fast for it) it has here, too.
        e, value = fit.estimates["N"], seen.sigma * scale
        room = 1.0 if e.is_limit or e.is_lower_limit else e.high / e.value
        low, high, upper = (_blunted(end, seen.sigma) for end in (seen.low, seen.high, seen.upper))
        high, upper = (max(end * scale, value * room) for end in (high, upper))
        estimates["N"] = FittedParameter(value, low * scale, float(high), float(upper))
    return replace(fit, estimates=estimates, ramp=_blurred(fit.ramp, seen.blur))


def _of_beats(fit: Fit, lsb: float, dt: float) -> Fit:
    """What is known of an axis whose counts beat: their quantisation, and nothing else."""
    quantisation = AngleQuantisation.of_count(lsb * dt)
    told = {name: FittedParameter(0.0, 0.0, np.inf, np.inf) for name in fit.estimates}
    told["Q"] = FittedParameter(*[quantisation.Q] * 4)
    spectrum = fit.spectrum
    if spectrum is not None:
        spectrum = replace(spectrum, model=quantisation.psd(spectrum.f, dt))
    return replace(fit, estimates=told, spectrum=spectrum, tones=())


def _blunted(end: float, sigma: float) -> float:
    """An end of an interval of sigma, as far away as if sigma were unsure by another 2%: noise that
    counts' likelihood takes for white has a share of flicker."""
    if end == 0 or end == sigma:
        return end
    off = np.log(end / sigma)
    return float(sigma * np.exp(np.sign(off) * np.hypot(off, 1.96 * _FLICKER)))


def _blurred(e: FittedParameter, blur: float) -> FittedParameter:
    if blur > _HIDDEN:
        return _withheld(e)
    return FittedParameter(e.value, e.low / (1 + blur), e.high / (1 - blur), e.upper / (1 - blur))


def _withheld(e: FittedParameter) -> FittedParameter:
    """A figure that the data do not tell: its value is what they look like."""
    return FittedParameter(e.value, 0.0, np.inf, np.inf)
