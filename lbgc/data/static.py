"""A static recording to which noise is fitted: several recordings of a resting IMU, cut to one
length, and the test that they are one steady state."""

from dataclasses import dataclass

import numpy as np
import scipy.fft

from lbgc.errors import InputError
from lbgc.sensor.fitting.counts import ENOUGH, count_size
from lbgc.sensor.fitting.goodness import bartlett

AXES = ("forward", "right", "down")
PARTS = ("gyro", "accel")
_EIGHTHS = 8
"""Stretches of a recording whose powers are compared."""
_MATTERS = 3.0
"""Ratio of powers from which on a recording is not steady."""
_CHANCE = 5.7e-7 / 18
"""Chance of five sigma, divided among three axes of two sensors at three time scales."""


@dataclass(frozen=True)
class Static:
    """R resting recordings of one length."""

    name: str
    """The log's name in messages"""
    gyro: np.ndarray
    """(R, n, 3), rad/s"""
    accel: np.ndarray
    """(R, n, 3), m/s^2"""
    dt: float
    """The samples' interval, s"""
    latitude: float
    """Latitude, rad; NaN where it is not known"""
    heading: np.ndarray | None
    """(R,), rad, headings; None unless all are known"""
    session: np.ndarray | None
    """(R,), the power-up that each recording is from; None where that is not known"""
    temperature: np.ndarray | None = None
    """(R, n), of the sensor, K or degrees Celsius; None unless all recordings have one"""


def require_steady(static: Static) -> None:
    """Raise InputError where a recording is not one steady state, or where a channel never changes.

    For a resting IMU the differences between neighbouring samples, means over 0.1 s and means over
    1 s have the same power throughout. A recording is refused where the powers of eight stretches
    differ by a factor of three, and by more than five sigma of what as many differences may have by
    chance.
    """
    for part in PARTS:
        still = np.ptp(getattr(static, part), axis=1).min(axis=0)
        if not still.all():
            dead = AXES[int(np.argmin(still))]
            raise InputError(
                static.name,
                f"{part} {dead}",
                "",
                "never changes: a dead channel, or counts far coarser than its noise; there is "
                "none to fit",
            )
    for part, axis in ((part, axis) for part in PARTS for axis in range(3)):
        one = getattr(static, part)[:, :, axis]
        if _is_coarse(one):
            continue  # how often a count changes depends on where the mean lies within it
        for seconds in (static.dt, 0.1, 1.0):
            block = max(1, round(seconds / static.dt))
            count = one.shape[1] // block
            if count < _EIGHTHS * 10:
                continue
            means = one[:, : count * block].reshape(len(one), count, block).mean(axis=2)
            ratio, p = _unsteadiness(np.diff(means, axis=1))
            if ratio > _MATTERS and p < _CHANCE:
                raise InputError(
                    static.name, f"{ratio:.3g}", "", f"times as much {part} noise in one eighth of "
                    f"the log as in another, on the {AXES[axis]} axis: something moved, or shook "
                    "it; noise is fitted to a resting IMU, so cut the log to a quiet stretch"
                )  # fmt: skip


def _is_coarse(series: np.ndarray) -> bool:
    """Whether samples (R, n) have counts that the noise from sample to sample does not dither."""
    lsb = count_size(series[0])
    noise = np.mean(np.diff(series, axis=1) ** 2) / 2
    return lsb is not None and noise < (ENOUGH**2 + 1 / 12) * lsb**2


def _unsteadiness(differences: np.ndarray) -> tuple[float, float]:
    """The largest power of an eighth over the least, and the p-value that eighths differ as much.

    differences : (R, n), unit. The number of independent ones among them is (sum of S)^2/(sum of
    S^2) over the frequencies, with S their spectrum, the mean over the eighths; the squares of a
    raw periodogram are twice as large as those of S.
    """
    size = scipy.fft.prev_fast_len(differences.shape[1] // _EIGHTHS, real=True)
    eighths = np.array_split(differences, _EIGHTHS, axis=1)
    power = np.array([np.mean(e**2) for e in eighths])
    periodogram = np.zeros(size // 2 + 1)
    for one in eighths:
        periodogram += np.sum(np.abs(np.fft.rfft(one[:, :size], axis=1)) ** 2, axis=0)
    series = _EIGHTHS * len(differences)
    spread = 1 + 1 / series  # mean square of the mean periodogram over S^2
    freedom = 2 * spread * np.sum(periodogram) ** 2 / np.sum(periodogram**2) * series
    ratio = float(power.max() / max(power.min(), 1e-300))
    return ratio, bartlett(np.maximum(power, 1e-300), freedom / _EIGHTHS)
