"""Conversion between the bias instability B and the minimum of the Allan deviation, which is what a
datasheet prints.

A printed "bias instability" is, on most datasheets, the minimum of the Allan deviation. That is not
IEEE Std 952's B: flicker alone has a floor of sqrt(2 ln 2/pi) B = 0.664 B, and white noise N and a
random walk K raise the curve's lowest point above it. The Allan variance is

    N^2/tau + B^2 F(tau) + K^2 tau/3,

with F flat at 2 ln 2/pi between the flicker's corners. Without corners its minimum is at tau =
sqrt(3) N/K and is (2 ln 2/pi) B^2 + 2 N K/sqrt(3). With corners the minimum is looked for between
them only, where the model describes the sensor: beyond the longer corner F falls, which no measured
curve is known to do.
"""

from functools import lru_cache

import numpy as np

from lbgc.sensor import noise

FLOOR_SQUARED = 2 * np.log(2) / np.pi
"""Allan variance of flicker noise over B^2, 0.664^2."""
_POINTS = 1000
"""Averaging times between the corners at which the Allan variance is evaluated."""

Corners = tuple[float, float]
"""Shortest and longest averaging time of the flat floor of flicker noise, s."""


def allan_minimum(
    N: float, B: float, K: float, corners: Corners | None = None
) -> tuple[float, float]:
    """The minimum of the Allan deviation, in B's unit, and the averaging time where it is, s.

    N : unit sqrt(s), two-sided; B : unit; K : unit/sqrt(s); corners : of the flicker, or None where
    its floor is flat at all times. The time is infinite where the curve falls for ever.
    """
    if corners is None:
        squared = FLOOR_SQUARED * B**2 + 2 * N * K / np.sqrt(3)
        return float(np.sqrt(squared)), float(np.sqrt(3) * N / K) if K > 0 else np.inf
    tau, flicker = _unit_flicker(*corners)
    variance = N**2 / tau + B**2 * flicker + K**2 * tau / 3
    at = int(np.argmin(variance))
    return float(np.sqrt(variance[at])), float(tau[at])


def instability(minimum: float, N: float, K: float, corners: Corners | None = None) -> float:
    """The B, in the minimum's unit, for which the Allan deviation of N, B and K has this minimum.

    The variance at every tau is linear in B^2, so the smallest B^2 with which the curve is nowhere
    below the minimum is the maximum over tau of (minimum^2 - N^2/tau - K^2 tau/3)/F(tau).

    Raises ValueError where N and K alone make the minimum larger.
    """
    least, _ = allan_minimum(N, 0.0, K, corners)
    if minimum < least:
        raise ValueError(f"white noise and random walk alone have a minimum of {least:g}")
    if corners is None:
        squared = (minimum**2 - least**2) / FLOOR_SQUARED
    else:
        tau, flicker = _unit_flicker(*corners)
        squared = np.max((minimum**2 - N**2 / tau - K**2 * tau / 3) / flicker)
    return float(np.sqrt(max(squared, 0.0)))


@lru_cache(maxsize=32)
def _unit_flicker(short: float, long: float) -> tuple[np.ndarray, np.ndarray]:
    """Averaging times between the corners, s, and the Allan variance of flicker of B = 1 there."""
    tau = np.geomspace(short, long, _POINTS)
    return tau, noise.Flicker(1.0, short, long).allan_variance(tau)
