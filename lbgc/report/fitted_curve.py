"""A fit to published Allan curves in the user's words and units: table and JSON."""

from dataclasses import asdict

from lbgc.data.static import AXES
from lbgc.report.fitted import KEYS, WORDS, every_estimate, of_axis, spelled
from lbgc.sensor.fitting.allan_fit import SHORTEST, CurveFit
from lbgc.units import factor, unit_of

_WEIGHED = {
    "recording": "points weigh by the covariance of overlapping estimates from {record:g} s",
    "stated": "points weigh by the errors that the curve states, correlated as overlapping "
    "estimates are",
    "equal": "the recording's length is not known (curve.record_s): all points weigh equally, and "
    "intervals are those of a recording of {record:g} s, three times the longest averaging time",
}
_MODEL = "N, B and K, with quantisation or a drift where the curve shows them"


def report(part: str, file: str, found: list[CurveFit]) -> str:
    """The results of a triad's curves as text. part : gyro or accel; file : the curves' name; found
    : one for all axes, or one each."""
    which = 0 if part == "gyro" else 1
    lines = []
    for axis, one in zip(
        AXES if len(found) == 3 else ("forward, right, down",), found, strict=True
    ):
        taus = one.curve.taus
        lines.append(
            f"{part} {axis}: {len(taus)} points of {file} are used, from {taus[0]:g} to "
            f"{taus[-1]:g} s"
        )
        lines.append(f"  {weighed(one)}")
        for name, e in every_estimate(one.fit).items():
            lines.append(f"  {WORDS[name]:30s} {spelled(e, KEYS[name][which], 'curve')}")
        lowest, tau = one.fit.allan_minimum
        key = KEYS["B"][which]
        within = f"{lowest / factor(key):.4g} {unit_of(key)} at {tau:.3g} s"
        if tau > taus[-1]:
            within = f"not on this curve: N, B and K as told still fall at {taus[-1]:.3g} s"
        lines.append(f"  {'Allan minimum of N, B, K':30s} {within}")
        lines.append(f"  {'goodness of fit':30s} {explained(one)}")
    return "\n".join(lines)


def weighed(one: CurveFit) -> str:
    """How a curve's points were weighed, in words."""
    record = one.curve.record_s or SHORTEST * float(one.curve.taus[-1])
    said = _WEIGHED[one.weights].format(record=record)
    both = one.weights == "recording" and one.curve.sigma is not None
    return f"{said}, as large as the curve states" if both else said


def explained(one: CurveFit) -> str:
    """Whether the model explains the curve, in words."""
    left = f"its points are off by {100 * one.scatter:.2g}% rms"
    if one.fails:
        return f"FAILS: {_MODEL}, do not explain the curve (p = {one.p:.2g}): {left}; intervals " \
               "are wider by that"  # fmt: skip
    return f"p = {one.p:.2g}: {left}"


def of_curve(one: CurveFit) -> dict:
    """A curve's fit as JSON: as `of_axis` gives it, with the curve's points and how they are
    explained."""
    own = of_axis(one.fit)
    own["curve"] = {
        "weights": one.weights,
        "p": one.p,
        "fails": one.fails,
        "scatter": one.scatter,
        **asdict(one.curve),
    }
    return own
