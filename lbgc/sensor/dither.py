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
    """The white noise of the quietest axis in means over dt (s): 1 sigma, SI. What wanders slowly
    and what swings steadily is no dither that can be relied on."""
    white = (tuple(t for t in own if t.density > 0) for own in triad.terms)
    variances = [gaussian.covariance_of_means(t, 1, dt)[0, 0] if t else 0.0 for t in white]
    return float(np.sqrt(min(variances)))


def undithered(triad: Triad, dt: float, mean_s: float) -> float | None:
    """The noise (1 sigma, SI in the count's unit) that does not shake the output across counts;
    None where there is no count, or it does.

    dt : s, of samples, by which a rate's counts are read; mean_s : s, the means that are taken.
    """
    if triad.counts is None:
        return None
    noise = triad.counts.dither(lambda h: quietest(triad, h), dt, mean_s)
    return None if noise >= ENOUGH * triad.counts.lsb else noise


def check_means(triad: Triad, name: str, dt: float, mean_s: float, largest_truth: float) -> None:
    """Raise InputError where block means cannot have the law of averaged samples: where there is a
    dead band, or where signal and noise (6 sigma, and the tones) exceed the range.

    name : the triad's key, for the message; dt, mean_s : s, the intervals of samples and of means;
    largest_truth : the largest true rate or force, SI.
    """
    noise = undithered(triad, dt, mean_s)
    if noise is not None and triad.counts is not None:
        over = (
            f"the noise over {mean_s:g} s is"
            if triad.counts.is_carried
            else "the samples' noise is"
        )
        key = f"{name}.{triad.keys[triad.counts.part]}"
        _refuse(key, triad.counts.lsb, noise, over, "has a dead band")
    swings = [sum(term.peak for term in own) for own in triad.started]
    loudest = largest_truth + 6 * max(triad.N) / np.sqrt(dt) + max(swings)
    if triad.range is not None and loudest > triad.range:
        key = f"{name}.{triad.keys['range']}"
        _refuse(key, triad.range, loudest, "signal and noise reach", "clips")


def _refuse(key: str, stated: float, value: float, what: str, why: str) -> None:
    unit, scale = units.unit_of(key), units.factor(key)
    raise InputError(
        key,
        round(stated / scale, 9),
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
        noise = undithered(triad, imu.dt, mean_s)
        if noise is None or triad.counts is None:
            continue
        key = triad.keys[triad.counts.part]
        unit, scale = units.unit_of(key), units.factor(key)
        said.append(
            f"imu.{name}.{key} = {round(triad.counts.lsb / scale, 9):g} {unit} has a dead "
            f"band: the noise that should shake it is {noise / scale:.3g} {unit}. Here it counts "
            "as noise of the same power, which floor and sigmas take on trust"
        )
    return said
