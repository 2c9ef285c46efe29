"""The entries of a fitted sensor's YAML that are not noise: warming up, counts, and the size of the
biases as far as one recording's mean tells."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np

from lbgc.data.static import PARTS, Static
from lbgc.frames import AXES, axis_names
from lbgc.sensor.fitting import bias_size
from lbgc.sensor.fitting.bias_size import BiasSize
from lbgc.sensor.fitting.noise_fit import Fit
from lbgc.sensor.fitting.temperature import Sensitivity
from lbgc.sensor.fitting.warmup import MeanChange
from lbgc.units import factor, unit_of

_PER_K = ("bias_per_k_deg_per_h_per_k", "bias_per_k_ug_per_k")
_COUNT = ("rate_lsb_deg_per_s", "lsb_ug")
_NAMES = {"gyro": "gyros", "accel": "accelerometers"}
_BIAS = ("bias_run_deg_per_h", "bias_run_mg")


Warmth: TypeAlias = dict[str, list[Sensitivity | None]]
"""Each axis's bias against temperature, by triad; None where the temperature tells nothing of it"""

Own = TypeVar("Own")


@dataclass(frozen=True)
class Beside:
    """Lines of YAML that stand beside a fitted sensor's noise terms."""

    top: list[str]
    """Lines of the whole sensor."""
    triads: dict[str, list[str]]
    """Lines of gyro and accel."""


def beside(
    fits: dict[str, list[Fit]],
    sizes: dict[str, BiasSize] | None = None,
    warmth: Warmth | None = None,
    said: Sequence[str] = (),
) -> Beside:
    """The lines of YAML for the results of a fit that are not noise terms. sizes : of the biases,
    where they are to be stated; warmth : what the recordings' own temperature told. Then a warm-up
    has no line: whatever is left of one did not follow that temperature. said : what else is
    assumed of the sensor, sentences."""
    time = None if warmth else _common_time(fits)
    assumed = []
    if sizes:
        said = " and ".join(
            f"{part} bias of {number(sizes[part].value / factor(key))} {unit_of(key)}"
            for part, key in zip(PARTS, _BIAS, strict=True)
            if part in sizes
        )
        about = "1 sigma, from the mean of one recording, which cannot say how long a bias lasts"
        assumed.append(f"{said}: {about}")
    assumed += [f"its {_NAMES[part]} were not measured and have no errors here"
                for part in PARTS if part not in fits]  # fmt: skip
    assumed += [own.removesuffix(".") for own in said]
    top = [f'assumed: "{"; ".join(assumed)}"'] if assumed else []
    if time is not None:
        top += ["temperature:", "  rise_k: 1  # so that biases per K are what warms away"]
        top.append(f"  time_s: {number(time)}")
    triads = {
        part: _per_k(fits[part], which, time)
        + _by_temperature((warmth or {}).get(part), which)
        + _counts(fits[part], which)
        + (_bias(sizes[part], which) if sizes and part in sizes else [])
        for which, part in enumerate(PARTS)
        if part in fits
    }
    return Beside(top, triads)


def unmeasured(part: str, fits: Sequence[Fit]) -> str:
    """The sentence on a triad's axes that were not measured, and whose figures stand for them;
    empty where all were. part : gyro or accel."""
    if len(fits) == len(AXES):
        return ""
    if len(fits) == 1:
        return f"one axis of its {_NAMES[part]} was measured, whose figures stand for all three"
    which = axis_names(len(fits))[_noisier(fits)]
    said = f"two axes of its {_NAMES[part]} were measured, here {AXES[0]} and {AXES[1]}; {AXES[2]} "
    return f"{said}was not, and has the figures of the {which} one, the noisier"


def whole(values: Sequence[Own], fits: Sequence[Fit]) -> list[Own]:
    """One value for each of three axes, by the axes that were measured: the noisier one's for the
    others. fits : of the axes that were measured."""
    more = len(AXES) - len(values)
    return [*values, *[values[_noisier(fits)]] * more] if more else list(values)


def _noisier(fits: Sequence[Fit]) -> int:
    """The number of the axis with the larger white noise."""
    return int(np.argmax([fit.estimates["N"].value for fit in fits]))


def number(value: float, digits: int = 4) -> str:
    """A value with a decimal point before an exponent, as every YAML reader needs it: 1.0e-05,
    since some read 1e-05 as text."""
    text = f"{value:.{digits}g}"
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _decays(fit: Fit) -> list[MeanChange]:
    """The exponential decays of the mean that were fitted: warming up."""
    return [c for c in fit.courses if c.kind == "decay"]


def _common_time(fits: dict[str, list[Fit]]) -> float | None:
    """One time constant for all axes, s: the mean of the decays' logarithms, weighted by the
    inverse squares of their intervals' widths. None where nothing decays."""
    every = [c for part in fits for fit in fits[part] for c in _decays(fit)]
    if not every:
        return None
    width = np.array([max(np.log(c.high / c.low), 1e-3) for c in every])
    return float(np.exp(np.average(np.log([c.time for c in every]), weights=1 / width**2)))


def _per_k(fits: list[Fit], which: int, time: float | None) -> list[str]:
    """The line for a triad's bias by the kelvin, or none. which : 0 for gyro, 1 for accel."""
    sizes = [float(np.sqrt(np.mean([c.size**2 for c in _decays(f)] or [0.0]))) for f in fits]
    if time is None or not any(sizes):
        return []
    own = ", ".join(number(size / factor(_PER_K[which])) for size in sizes)
    said = [f"{c.time:.4g} s" for f in fits for c in _decays(f)]
    return [f"  {_PER_K[which]}: [{own}]  # warms away; time constants of {', '.join(said)}"]


def _by_temperature(found: Sequence[Sensitivity | None] | None, which: int) -> list[str]:
    """The line for a triad's bias by the kelvin as its temperature told it, or none."""
    if not any(found or ()):
        return []
    scale = factor(_PER_K[which])
    sizes = [abs(s.value) / scale if s is not None and s.is_told else 0.0 for s in found or ()]
    said = ["-" if s is None else f"{s.low / scale:.3g}..{s.high / scale:.3g}" for s in found or ()]
    values = ", ".join(number(size) for size in sizes)
    return [f"  {_PER_K[which]}: [{values}]  # by its temperature: {', '.join(said)}"]


def _counts(fits: list[Fit], which: int) -> list[str]:
    """The line for a triad's count where its axes share one, or none. Counts whose rest is carried
    over are fitted as quantisation, and have none."""
    kinds = {None if f.counts is None else f.counts.kind for f in fits}
    if kinds & {None, "carried", "beating"}:
        return []
    sizes = [f.counts.lsb for f in fits if f.counts is not None]
    if max(sizes) > 1.01 * min(sizes):
        return []
    return [f"  {_COUNT[which]}: {number(float(np.median(sizes)) / factor(_COUNT[which]))}"]


def _bias(size: BiasSize, which: int) -> list[str]:
    """The line for the size of a triad's run bias."""
    value, low, high = (v / factor(_BIAS[which]) for v in (size.value, size.low, size.high))
    return [f"  {_BIAS[which]}: {number(value)}  # assumed; {low:.3g}..{high:.3g}"]


def bias_sizes(statics: Sequence[Static], fits: dict[str, list[Fit]]) -> dict[str, BiasSize]:
    """Sizes of the triads' biases by the first recording's means; none where the latitude is not
    known, since Earth's rate and gravity are not. Where it is the only recording, exponential
    changes of the mean are subtracted first. Without accelerometers the gyros' mean tells as much
    as Earth's rate, of any direction, leaves; one or two axes have too little of either."""
    mean: dict[str, np.ndarray] = {}
    if not np.isfinite(statics[0].latitude):
        return {}
    for static in statics:
        count, samples = static.shape
        for part, values in static.triads.items():
            mean[part] = values[0].mean(axis=0)
            for axis, fit in enumerate(fits[part] if count == 1 else ()):
                passing = [c for c in fit.courses if c.kind in ("decay", "rise")]
                whole = np.array([0.0, samples * static.dt])
                mean[part][axis] -= sum(float(c.means(whole)[0]) for c in passing)
    first, latitude = statics[0], statics[0].latitude
    sizes = {}
    if "gyro" in mean and len(mean["gyro"]) == len(AXES):
        seconds = first.shape[1] * first.dt
        error = max(bias_size.mean_error(fit.terms(), seconds) for fit in fits["gyro"])
        heading = None if first.heading is None else float(first.heading[0])
        known = "accel" in mean
        sizes["gyro"] = (
            bias_size.of_gyro(mean["gyro"], mean["accel"], latitude, heading, error)
            if known
            else bias_size.of_gyro_alone(mean["gyro"], error)
        )
    if "accel" in mean:
        sizes["accel"] = bias_size.of_accel(mean["accel"], latitude)
    return sizes
