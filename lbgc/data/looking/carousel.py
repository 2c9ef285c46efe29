"""Whether a log turned evenly about its vertical throughout, on a carousel, or its gyro has a bias.

In the body of what turns evenly, that which is fixed in the world, Earth's rate and the vertical,
turns the other way at the same rate. A bias does not do that.
"""

from collections.abc import Sequence

import numpy as np

from lbgc.data.looking.guess import Guess
from lbgc.data.looking.sensor import Means
from lbgc.data.readers.axes import matrix_of
from lbgc.units import DEG, rate_factor

_TURNS = 2.0
"""Turns of a carousel, at the least."""
_A_TURN = 24
"""Means in a turn, of which spectra are taken."""
_AROUND, _BINS = 0.2, 2
"""The share by which the rate may differ from the gyros' mean, by their bias, and frequencies on
either side besides."""
_PEAK, _WIDTH, _BESIDE = 10.0, 3, 6
"""Times as much power a peak has as anything near it the other way, and beside it from so many
frequencies on; and how far from it that is. Slow noise has more below, which hides a peak and makes
none; of white noise one is so in ten million."""
_ASKED = 2.0 * DEG
"""Rate, rad/s, from which on it is asked whether it is a bias; above what gyros usually have."""


def guess(means: Means, unit: str, axes: Sequence[str]) -> Guess | None:
    """The question for the column of a carousel's angle, where the gyros turn evenly; None where
    they do not. unit : of the gyros; axes : forward, right and down, in the file's notation."""
    matrix = matrix_of(list(axes))
    factor = rate_factor(unit, means.rate_hz)
    rate = float(matrix[2] @ means.gyro.mean(axis=0)) * factor
    turns = abs(rate) * len(means.gyro) / means.rate_hz / (2 * np.pi)
    if turns < _TURNS:
        return None
    which = [
        name
        for name, values in (("Earth's rate", means.gyro), ("the vertical", means.accel))
        if _turns_against(values @ matrix[:2].T, rate, means.rate_hz)
    ]
    said = f"its gyros turn at {rate / DEG:+.4g} deg/s about the vertical, {turns:.3g} turns in all"
    if which:
        why = f"{said}, and {' and '.join(which)} against it at that rate: a carousel, whose "
        why += "angle no column has"
        doubt = "which column has its angle? Without it there is no heading, and noise is not told "
        return Guess("plate_column", None, why, f"{doubt}from the turning's.", sure=False)
    if abs(rate) < _ASKED:
        return None
    doubt = "is it a carousel, whose angle is in a column, or a bias (log.most_bias_deg_per_h=...)?"
    return Guess("plate_column", None, said, doubt, sure=False, heading_only=True)


def _turns_against(level: np.ndarray, rate: float, rate_hz: float) -> bool:
    """Whether level components (T, 2), forward and right, turn against a rate, rad/s, about down:
    as e^(-i rate t), with much more power than beside that frequency and the other way."""
    size = max(1, int(2 * np.pi / abs(rate) * rate_hz / _A_TURN))
    count = len(level) // size
    values = level[: count * size].reshape(count, size, 2).mean(axis=1)
    series = (values - values.mean(axis=0)) @ np.array([1.0, 1j])
    power = np.abs(np.fft.fft(series * np.hanning(count))) ** 2
    at = abs(rate) / (2 * np.pi) * count * size / rate_hz
    few = range(max(1, int(at * (1 - _AROUND)) - _BINS), int(at * (1 + _AROUND)) + _BINS + 1)
    sense = -int(np.sign(rate))
    peak = max(few, key=lambda k: float(power[sense * k % count]))
    near = [-sense * (peak + k) % count for k in range(-_BESIDE, _BESIDE + 1)]
    near += [sense * (peak + k) % count for k in range(-_BESIDE, _BESIDE + 1) if abs(k) >= _WIDTH]
    return bool(power[sense * peak % count] > _PEAK * power[near].max())
