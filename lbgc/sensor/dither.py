"""Whether a sensor's own noise dithers its output across counts, so that rounding is plain noise.

Where the noise before rounding exceeds half a count, rounding samples adds white noise of variance
LSB^2/12, and rounding a carried angle or velocity adds the quantisation noise of IEEE Std 952: the
rounding error's first harmonic is then below exp(-2 pi^2/4) = 0.7% of its full size. With less
noise the output depends on where the mean lies within a count. There is a dead band, whose errors
are not described by second moments.
"""

import numpy as np

from lbgc import units
from lbgc.errors import InputError
from lbgc.sensor import gaussian
from lbgc.sensor.imu import ImuModel, Triad

ENOUGH = 0.5
"""Noise before rounding, in counts, 1 sigma, above which rounding is noise."""


def quietest(triad: Triad, dt: float) -> float:
    """The white noise of the triad's quietest axis in means over dt (s): 1 sigma, SI. Slow noise
    and tones are left out, because they cannot be relied on to dither."""
    sigmas = [
        float(np.sqrt(gaussian.covariance_of_means(terms[:1], 1, dt)[0, 0])) if N > 0 else 0.0
        for N, terms in zip(triad.N, triad.terms, strict=True)
    ]
    return min(sigmas)


def undithered(triad: Triad, dt: float, mean_s: float) -> tuple[str, float] | None:
    """The count that the noise does not dither: its field of the triad, `lsb` or `carried_lsb`, and
    the noise (1 sigma, SI, in the count's unit). None where there is no such count.

    dt : s, the samples' interval, at which a rate is rounded; mean_s : s, the interval of the means
    that are taken. A carried count is rounded once a mean, and dithered by the noise of the angle
    over that mean.
    """
    if triad.lsb is not None:
        noise = quietest(triad, dt)
        return None if noise >= ENOUGH * triad.lsb else ("lsb", noise)
    if triad.carried_lsb is not None:
        noise = quietest(triad, mean_s) * mean_s
        return None if noise >= ENOUGH * triad.carried_lsb else ("carried_lsb", noise)
    return None


def check_means(triad: Triad, name: str, dt: float, mean_s: float, largest_truth: float) -> None:
    """Raise InputError where block means cannot have the law of averaged samples: where there is a
    dead band, or where signal and noise (6 sigma, and the tones) exceed the range.

    name : the triad's key, for the message; dt, mean_s : s, the intervals of samples and of means;
    largest_truth : the largest true rate or force, SI.
    """
    found = undithered(triad, dt, mean_s)
    if found is not None:
        part, noise = found
        what = "the samples' noise is" if part == "lsb" else f"the noise over {mean_s:g} s is"
        _refuse(triad, name, part, noise, what, "has a dead band")
    loudest = largest_truth + 6 * max(triad.N) / np.sqrt(dt) + max(triad.tone)
    if triad.range is not None and loudest > triad.range:
        _refuse(triad, name, "range", loudest, "signal and noise reach", "clips")


def _refuse(triad: Triad, name: str, part: str, value: float, what: str, why: str) -> None:
    """Raise the InputError of `check_means`, with all figures in the unit of the triad's key."""
    key = triad.keys[part]
    unit, scale = units.unit_of(key), units.factor(key)
    raise InputError(
        f"{name}.{key}",
        round(getattr(triad, part) / scale, 9),
        unit,
        f"{what} {value / scale:.3g} {unit}, so this {why}, which means cannot represent; "
        "use output=samples, or null for this key",
    )


def unstated(imu: ImuModel) -> list[str]:
    """The warning that no bias of the gyros is stated, for whatever prints a floor; an empty list
    where one is stated."""
    if imu.gyro.bias().any():
        return []
    return [
        "NO BIAS IS STATED of the gyros (imu.gyro.bias_unit_deg_per_h, bias_session_deg_per_h, "
        "bias_run_deg_per_h): it is taken as zero. At rest a bias turns north by itself over "
        "Earth's horizontal rate, and these figures are too small by that"
    ]


def warnings(imu: ImuModel | None, mean_s: float) -> list[str]:
    """The warnings that belong to results that use the law of a sensor's means, one sentence each:
    what is assumed of the sensor, and each triad whose counts the noise does not dither. mean_s :
    s, the interval of the means."""
    if imu is None:
        return []
    said = [f"assumed of the sensor, not measured: {imu.assumed}"] if imu.assumed else []
    for name in ("gyro", "accel"):
        triad: Triad = getattr(imu, name)
        found = undithered(triad, imu.dt, mean_s)
        if found is None:
            continue
        part, noise = found
        key = triad.keys[part]
        unit, scale = units.unit_of(key), units.factor(key)
        said.append(
            f"imu.{name}.{key} = {round(getattr(triad, part) / scale, 9):g} {unit} has a dead "
            f"band: the noise that should shake it is {noise / scale:.3g} {unit}. Here it counts "
            "as noise of the same power, which floor and sigmas take on trust"
        )
    return said
