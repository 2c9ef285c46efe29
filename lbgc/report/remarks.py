"""Remarks on a fit in plain sentences: changes of the mean that are not noise, and the effect of
counts on what can be told."""

from lbgc.sensor.fitting.counts import Counts
from lbgc.sensor.fitting.noise_fit import Fit
from lbgc.sensor.fitting.outliers import Outliers
from lbgc.sensor.fitting.temperature import Sensitivity
from lbgc.sensor.fitting.warmup import MeanChange
from lbgc.units import factor, unit_of

# keys whose units a change of the mean, and a count, are told in, for a gyro and an accelerometer
_SIZE = ("warmup_deg_per_h", "warmup_ug")
_PER_K = ("bias_per_k_deg_per_h_per_k", "bias_per_k_ug_per_k")
_COUNT = ("count_deg_per_s", "count_ug")
_WORTH_SAYING = 5.0  # counts of noise, below which rounding is more than 0.3% of the variance


def remarks(fit: Fit, which: int) -> list[str]:
    """All remarks on one axis's fit. which : 0 for a gyro, 1 for an accelerometer."""
    said = [of_course(course, which) for course in fit.courses]
    if fit.counts is not None:
        said += of_counts(fit.counts, which)
    if fit.is_cut_short:
        said.append(
            "the search for terms was cut short: lines or terms may be there that are not here"
        )
    return said


def of_outliers(name: str, found: Outliers | None, which: int) -> str:
    """The remark on what was taken for spikes and knocks on an axis, of this name. which : 0 for a
    gyro, 1 for an accelerometer."""
    if found is None:
        return f"robust: {name}: its counts hide what would be far from its noise"
    if found.samples == 0:
        return f"robust: {name}: no spikes or knocks"
    key = _SIZE[which]
    return (
        f"robust: {name}: {found.samples} samples ({100 * found.share:.2g}%) in {found.places} "
        f"places were taken for spikes or knocks, from {found.threshold:.2g} sigma on and up to "
        f"{found.largest / factor(key):.3g} {unit_of(key)}: replaced by noise like that beside them"
    )


def of_temperature(name: str, found: Sensitivity | None, which: int) -> str:
    """The remark on the bias against temperature of an axis, of this name. which : 0 for a gyro, 1
    for an accelerometer."""
    if found is None:
        return f"temperature: {name}: it hardly changes, which tells nothing of its effect"
    key = _PER_K[which]
    value, low, high = (v / factor(key) for v in (found.value, found.low, found.high))
    said = f"{value:.3g} {unit_of(key)}, 95% {low:.3g} to {high:.3g}, over {found.span_k:.3g} K"
    if found.is_told:
        return f"temperature: {name}: {said}: taken out before the noise is fitted"
    return f"temperature: {name}: {said}: not told from zero, and left in"


def of_course(c: MeanChange, which: int) -> str:
    """The remark on a change of the mean: a warm-up, a drift or a step, and its size."""
    key = _SIZE[which]
    size, unit = c.size / factor(key), unit_of(key)
    what = {
        "decay": f"warms up: {size:.3g} {unit} off at the start, with a time constant of "
        f"{c.time:.3g} s (95% {c.low:.3g} to {c.high:.3g})",
        "rise": f"drifts by {size:.3g} {unit} towards the end, with a time constant of "
        f"{c.time:.3g} s (95% {c.low:.3g} to {c.high:.3g})",
        "step": f"steps by {size:.3g} {unit} at {c.time:.4g} s",
        "ramp": f"drifts steadily, by {size:.3g} {unit} in {c.duration:.4g} s",
    }[c.kind]
    how = "; no random walk: taken out before the noise is fitted"
    if c.skip_s is not None:
        return f"{what}{how}, or leave it out with skip_s={c.skip_s:.0f}"
    if c.kind == "rise":
        return f"{what}{how}, or cut the log {3 * c.time:.0f} s before its end"
    return what + how


def of_counts(c: Counts, which: int) -> list[str]:
    """The remark on the output's counts, if any: their size, and what they hide of the noise."""
    key = _COUNT[which]
    size = f"counts of {c.lsb / factor(key):.4g} {unit_of(key)}"
    slow = ""
    if c.blur > 0.9:
        slow = "; what changes slowly is hidden by them and cannot be told"
    elif c.blur > 0.02:
        slow = f"; a slow change may show up to {c.blur:.0%} too large or small: limits are widened"
    if c.kind == "memory":
        return [
            f"{size} are coarser than the noise, which is not white or changes them too rarely: "
            f"the angle (velocity) random walk cannot be told from them{slow}"
        ]
    if c.kind == "coarse" and c.low == 0:
        return [f"{size} hide the noise, which is below {c.upper:.2g} of one{slow}"]
    if c.kind == "coarse":
        return [
            f"{size} are coarser than the noise, {c.sigma:.2g} of one: the angle (velocity) random "
            f"walk is from how often each count comes{slow}"
        ]
    if c.kind == "beating":
        return [
            f"{size}, the rest of each carried over to the next, are coarser than the noise: they "
            "beat with the mean rate, in lines that hide it; the quantisation is theirs"
        ]
    if c.kind == "carried":
        return [f"{size}: the rest of each is carried over to the next: quantisation"]
    if c.sigma < _WORTH_SAYING:
        return [f"{size}, of which the noise is {c.sigma:.2g}: their rounding is taken out of it"]
    return []
