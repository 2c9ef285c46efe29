"""A static recording, as noise is fitted to it: several recordings of a resting IMU, cut to one
length, and whether they are one steady state."""

from dataclasses import dataclass

import numpy as np

from lbgc.errors import InputError

AXES = ("forward", "right", "down")
PARTS = ("gyro", "accel")
_EIGHTHS = 8
_STEADY = 3.0


@dataclass(frozen=True)
class Static:
    """Resting recordings of one length: gyro and accel (R, n, 3), SI."""

    name: str
    gyro: np.ndarray
    accel: np.ndarray
    dt: float
    latitude: float
    heading: np.ndarray | None
    """(R,), rad, where every recording's is known"""
    session: np.ndarray | None
    """(R,), which power-up each is from, where that is known"""


def require_steady(static: Static) -> None:
    """Raise InputError where the recording is not one steady state: a resting IMU's differences
    between neighbours (samples, means over 0.1 s, over 1 s) have one power throughout. Over 50
    differences each, the powers of eight steady stretches are within a factor of three."""
    for part in ("gyro", "accel"):
        still = np.ptp(getattr(static, part), axis=1).min(axis=0)
        if not still.all():
            axis = AXES[int(np.argmin(still))]
            raise InputError(
                static.name,
                f"{part} {axis}",
                "",
                "never changes: a dead channel has no noise to fit",
            )
    for part, seconds in ((p, s) for p in ("gyro", "accel") for s in (static.dt, 0.1, 1.0)):
        block = max(1, round(seconds / static.dt))
        series = getattr(static, part)
        count = series.shape[1] // block
        if count < _EIGHTHS * 50:
            continue
        means = series[:, : count * block].reshape(len(series), count, block, 3).mean(axis=2)
        eighths = np.array_split(np.diff(means, axis=1), _EIGHTHS, axis=1)
        power = np.array([np.mean(e**2, axis=(0, 1)) for e in eighths])
        ratio = float(np.max(power.max(axis=0) / np.maximum(power.min(axis=0), 1e-300)))
        if ratio > _STEADY:
            raise InputError(
                static.name, f"{ratio:.3g}", "", f"times as much {part} noise in one eighth of the "
                "log as in another: something moved, or shook it; noise is fitted to a resting "
                "IMU, so cut the log to a quiet stretch"
            )  # fmt: skip
