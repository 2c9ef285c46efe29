"""A fit's results in the user's words and units: names of parameters, table, and JSON."""

import re
from dataclasses import asdict

import numpy as np

from lbgc.data.static import Static
from lbgc.frames import axis_names
from lbgc.report.remarks import remarks
from lbgc.sensor.fitting.goodness import Goodness
from lbgc.sensor.fitting.noise_fit import Fit
from lbgc.sensor.fitting.profile import FittedParameter
from lbgc.sensor.fitting.shapes import given_damping, is_line
from lbgc.sensor.fitting.trial import half_power_ratio
from lbgc.units import factor, unit_of

# parameter -> the key of `conf/imu/`, for a gyro and for an accelerometer
KEYS = {
    "N": ("arw_deg_per_sqrt_h", "vrw_m_per_s_per_sqrt_h"),
    "B": ("bias_instability_deg_per_h", "bias_instability_ug"),
    "K": ("rrw_deg_per_h_per_sqrt_h", "random_walk_ug_per_sqrt_h"),
    "Q": ("quantisation_arcsec", "quantisation_ug_s"),
    "ramp": ("ramp_deg_per_h_per_h", "ramp_ug_per_h"),
    "GM_sigma": ("gauss_markov_deg_per_h", "gauss_markov_ug"),
    "GM_T": ("gauss_markov_s", "gauss_markov_s"),
    "line_sigma": ("deg_per_h", "ug"),
    "line_f0": ("hz", "hz"),
    "line_width": ("width_hz", "width_hz"),
    "bandwidth": ("bandwidth_hz", "bandwidth_hz"),
    "damping": ("filter_damping", "filter_damping"),
    "tone": ("tone_deg_per_h", "tone_ug"),
    "tone_f": ("tone_hz", "tone_hz"),
}
WORDS = {
    "N": "angle (velocity) random walk",
    "B": "bias instability",
    "K": "rate random walk",
    "Q": "quantisation",
    "ramp": "linear drift",
    "GM_sigma": "Gauss-Markov process",
    "GM_T": "its correlation time",
    "line_sigma": "narrow-band line, rms",
    "line_f0": "its frequency",
    "line_width": "its width",
    "bandwidth": "output filter, half power at",
    "damping": "its damping",
}


def every_estimate(fit: Fit) -> dict[str, FittedParameter]:
    """All parameters of a fit, estimated or taken as given, by name."""
    out: dict[str, FittedParameter] = {}
    for name, e in fit.estimates.items():
        out[name] = e
        if name == "bandwidth" and "damping" not in fit.estimates:
            white = next(s for s in fit.shapes if s.names[0] == "N")
            out["damping"] = FittedParameter(*[given_damping(white)] * 4)
    return {**out, "ramp": fit.ramp}


def unnumbered(name: str) -> str:
    """A parameter's name without the number that tells a model's lines apart: line_f0 for
    line_f0_2."""
    return name if name in KEYS else re.sub(r"_[0-9]+$", "", name)


def scale_of(key: str) -> float:
    """SI per unit of the key; a key without a unit is a plain number."""
    return factor(key) if unit_of(key) else 1.0


def report(static: Static, fits: dict[str, list[Fit]]) -> str:
    """The results of all axes as text. fits : with a fit for each axis of each triad."""
    count, samples = static.shape
    n = samples * static.dt
    lines = [f"{static.name}: {count} recording(s) of {n:g} s at {1 / static.dt:g} Hz"]
    for which, part in enumerate(("gyro", "accel")):
        if part not in static.triads:
            continue
        for axis, fit in zip(axis_names(len(fits[part])), fits[part], strict=True):
            lines.append(f"{part} {axis}")
            for name, e in every_estimate(fit).items():
                plain = unnumbered(name)
                e = half_power(fit) if name == "bandwidth" else e
                said = spelled(e, KEYS[plain][which])
                if plain == "line_sigma":
                    said += _in_samples(fit, name, KEYS[plain][which], static.dt)
                lines.append(f"  {WORDS[plain]:30s} {said}")
            lines += [f"  {said}" for said in _overlapping_lines(fit, KEYS["line_sigma"][which])]
            lines.append(
                f"  {'Allan minimum of N, B, K':30s} {_allan_minimum(fit, KEYS['B'][which], n)}"
            )
            for tone in fit.tones:
                size = tone.amplitude / factor(KEYS["tone"][which])
                unit = unit_of(KEYS["tone"][which])
                lines.append(f"  {'tone':30s} {size:.3g} {unit} at {tone.f:.4g} Hz")
            lines += [f"  {said}" for said in remarks(fit, which)]
            lines.append(f"  {'goodness of fit':30s} {explained(fit)}")
    return "\n".join(lines)


def _allan_minimum(fit: Fit, key: str, seconds: float) -> str:
    """The lowest point of the fitted Allan curve, in words, if it is within the log's half length.
    seconds : the log's length."""
    if fit.estimates["N"].is_withheld:
        return "cannot be told from this log"
    lowest, tau = fit.allan_minimum
    if tau > seconds / 2:
        return f"not within this log: N, B and K as told still fall at {seconds / 2:.3g} s"
    return f"{lowest / factor(key):.4g} {unit_of(key)} at {tau:.3g} s"


def _in_samples(fit: Fit, name: str, key: str, dt: float) -> str:
    """The RMS of a line in samples, in words; empty unless averaging over dt, s, reduces it by 2%
    or more."""
    left = float(np.sinc(fit.estimates[name.replace("sigma", "f0")].value * dt))
    size = left * fit.estimates[name].value / factor(key)
    return f"; {size:.4g} {unit_of(key)} in the samples" if left < 0.98 else ""


def _overlapping_lines(fit: Fit, key: str) -> list[str]:
    """Groups of lines that overlap, in words: each one's frequency range and joint RMS."""
    lines = [
        [fit.estimates[name].value for name in shape.names]
        for shape in fit.shapes
        if is_line(shape)
    ]
    groups: list[list[list[float]]] = []
    for one in sorted(lines, key=lambda line: line[1]):
        last = groups[-1][-1] if groups else None
        if last is not None and one[1] - last[1] < one[2] + last[2]:
            groups[-1].append(one)
        else:
            groups.append([one])
    out = []
    for group in (g for g in groups if len(g) > 1):
        low, high = min(f - w / 2 for _, f, w in group), max(f + w / 2 for _, f, w in group)
        rms = float(np.sqrt(sum(s**2 for s, _, _ in group))) / factor(key)
        what = f"{len(group)} lines overlap: together"
        out.append(f"{what:30s} {rms:.4g} {unit_of(key)}, from {low:.4g} to {high:.4g} Hz")
    return out


def explained(fit: Fit) -> str:
    """Whether the model explains the recording, and what it does not explain, in words."""
    g = fit.goodness
    if g is None:
        return "not tested: counts coarser than the noise hide its spectrum"
    if g.fails:
        return f"FAILS: {g.says}; intervals are wider by that"
    return f"p = {g.p:.2g}: spectrum {g.p_spectrum:.2g}, Allan {g.p_allan:.2g}, time {g.p_time:.2g}"


def half_power(fit: Fit) -> FittedParameter:
    """The half-power frequency of the fitted output filter, Hz. It is better known than the natural
    frequency, whose estimate is correlated with the damping's."""
    e = fit.estimates["bandwidth"]
    damping = every_estimate(fit)["damping"].value
    ratio = half_power_ratio(damping)
    return FittedParameter(ratio * e.value, ratio * e.low, ratio * e.high, ratio * e.upper)


def spelled(e: FittedParameter, key: str, source: str = "log") -> str:
    """An estimate with its interval, or its limit, in words and in its key's unit. source : what it
    was fitted to."""
    scale, unit = scale_of(key), f" {unit_of(key)}".rstrip()
    if e.is_withheld:
        return f"cannot be told from this {source}"
    if e.is_limit:
        return (
            f"below {e.upper / scale:.3g}{unit} (95%); this {source} cannot tell it from zero, a "
            "longer one may"
        )
    if e.is_lower_limit:
        return f"above {e.low / scale:.3g}{unit} (95%)"
    if e.low == e.high:
        return f"{e.value / scale:.4g}{unit}, taken as such"
    return f"{e.value / scale:.4g}{unit}, 95% {e.low / scale:.4g} to {e.high / scale:.4g}"


def of_axes(fits: dict[str, list[Fit]]) -> dict:
    """The fits of all axes as JSON: what `of_axis` gives, for every axis of both triads."""
    return {part: [of_axis(fit) for fit in axes] for part, axes in fits.items()}


def of_axis(fit: Fit) -> dict:
    """One axis's fit as JSON: every estimate in SI, tones, Allan minimum, changes of the mean,
    counts and goodness."""
    return {
        "estimates": {n: _plain(e) for n, e in every_estimate(fit).items()},
        "tones": [asdict(t) for t in fit.tones],
        "allan_minimum": dict(zip(("value", "tau_s"), fit.allan_minimum, strict=True)),
        "courses": [asdict(c) for c in fit.courses],
        "counts": None if fit.counts is None else asdict(fit.counts),
        "bic": fit.bic,
        "search_cut_short": fit.is_cut_short,
        "goodness": None if fit.goodness is None else _goodness(fit.goodness),
    }


def _goodness(g: Goodness) -> dict:
    """The goodness of fit as JSON: p-values, what is not explained, and the ratio of recorded to
    modelled power in bands."""
    return {
        "p": g.p,
        "p_spectrum": g.p_spectrum,
        "p_allan": g.p_allan,
        "p_time": g.p_time,
        "fails": g.fails,
        "says": g.says,
        "bands": [asdict(band) for band in g.bands],
        "worst_band": asdict(g.worst),
        "unsteady_band": asdict(g.unsteady),
        "widened_by": list(g.widening) if g.fails else None,
    }


def _plain(e: FittedParameter) -> dict[str, float | None]:
    """An estimate as JSON, with null for an end of the interval that is not finite."""
    return {key: value if np.isfinite(value) else None for key, value in asdict(e).items()}
