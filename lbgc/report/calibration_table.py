"""A calibration as text: deg/h, degrees, percent and mrad."""

from collections.abc import Sequence

import numpy as np

from lbgc.data.static import AXES
from lbgc.sensor.calibration import Calibration, LeftOut
from lbgc.units import DEG, HOUR

_DPH = DEG / HOUR


def report(c: Calibration, name: str, notes: Sequence[str] = ()) -> str:
    """The calibration's results as text; intervals are 95%, by Student's t and chi-square.
    name : of the recordings; notes : remarks on them."""
    told = "" if c.sessions is None else f", {c.sessions} session{'s' * (c.sessions != 1)}"
    lines = [f"{name}: {c.recordings} recordings of one unit{told}; 95% intervals"]
    lines += [f"  note: {note}" for note in notes]
    lines += [_bias_line(c, axis) for axis in range(3)]
    if c.missing is not None:
        lines.append(f"  scale and misalignment cannot be told from the bias: {c.missing};")
        lines.append("    what they make of Earth's rate on average over these headings is in it")
    else:
        lines += [_matrix_line(c, axis) for axis in range(2)]
    forward, right, _ = c.mean_error / _DPH
    lines += [
        f"  across north {c.across_rms / _DPH:.2f} deg/h RMS: that turns the heading",
        f"  along it mean {c.along_mean / _DPH:+.2f}, spread {c.along_sigma / _DPH:.2f} deg/h: "
        "that changes the rate's size only",
        f"  heading RMSE of the plain mean {c.heading_rmse / DEG:.2f} deg",
        f"  their mean error, {forward:+.2f} forward and {right:+.2f} deg/h right, taken out: "
        f"{_verdict(c.without_bias)}",
    ]
    if c.without_all is not None:
        lines.append(f"  bias, scale and misalignment taken out: {_verdict(c.without_all)}")
    lines.append(_how(c.without_bias))
    return "\n".join(lines)


def _bias_line(c: Calibration, axis: int) -> str:
    """The line on one axis's bias and its spread by lifetime."""
    bias, low, high = (v[axis] / _DPH for v in (c.bias, *c.bias_interval))
    whose = "unit" if c.sessions is not None and c.sessions > 1 else "unit and session"
    between = ""
    if c.session_sigma is not None and c.session_interval is not None:
        between = f"between sessions {_spread(c.session_sigma, c.session_interval, axis)}, "
    d = _decimals(c.bias_sigma[axis] / _DPH)
    return (
        f"  bias {AXES[axis]:8s} {whose} {bias:+.{d}f} ({low:+.{d}f} to {high:+.{d}f}) deg/h, "
        f"{between}run to run {_spread(c.run_sigma, c.run_interval, axis)}"
    )


def _spread(sigma: np.ndarray, interval: np.ndarray, axis: int) -> str:
    """A standard deviation, rad/s, with its interval, in deg/h."""
    value, low, high = (v[axis] / _DPH for v in (sigma, *interval))
    d = _decimals(value)
    return f"{value:.{d}f} ({low:.{d}f} to {high:.{d}f}) deg/h"


def _decimals(doubt: float) -> int:
    """Number of decimals that show two digits of an uncertainty; from two to six."""
    return int(np.clip(1 - np.floor(np.log10(max(doubt, 1e-6))), 2, 6))


def _matrix_line(c: Calibration, axis: int) -> str:
    """The line on one horizontal axis's scale factor error and misalignment."""
    assert c.matrix is not None
    assert c.matrix_interval is not None
    scale, *ends = (m[axis, axis] for m in (c.matrix, *c.matrix_interval))
    cross, *crossed = (1e3 * m[axis, 1 - axis] for m in (c.matrix, *c.matrix_interval))
    return (
        f"  {AXES[axis]:13s} scale {scale:+.2%} ({ends[0]:+.2%} to {ends[1]:+.2%}), misalignment "
        f"{cross:+.1f} ({crossed[0]:+.1f} to {crossed[1]:+.1f}) mrad"
    )


def _verdict(left: LeftOut) -> str:
    """What taking errors out did to the heading, in words: "better" only where it was for sessions
    that the correction was not fitted to."""
    change, sigma = -left.gain / DEG**2, left.gain_sigma / DEG**2
    figures = f"mean square {change:+.3g} deg^2, standard error {sigma:.2g}"
    words = {
        -1: "worse: it is no constant of this unit, however significant it looks",
        0: "no difference that these recordings can tell",
        1: "better" if left.by_session else "less, for these power-ups",
    }
    return f"{left.heading_rmse / DEG:.2f} deg, {words[left.says]} ({figures})"


def _how(left: LeftOut) -> str:
    """The line on how corrections were tried: on which recordings, fitted to which others."""
    if left.by_session:
        return f"  (each of {left.groups} sessions by what the others tell)"
    return (
        f"  (each of {left.groups} recordings by what the others tell; whether it lasts beyond a "
        "power-up takes three sessions or more)"
    )
