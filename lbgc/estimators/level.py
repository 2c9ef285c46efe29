"""Attitude of a resting IMU from one specific force and one rate."""

from collections.abc import Iterable

import numpy as np

from lbgc.errors import InputError
from lbgc.frames import level

_UPRIGHT = np.deg2rad(10.0)
"""Angle between the forward axis and the vertical, rad, below which there is no heading."""


def gyrocompass(omega_ib_b: np.ndarray, roll: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Heading from Earth's rate and a known level (the paper's eqs. 14-16; Groves 2013, eq. 5.105).

    omega_ib_b : (W, 3), rad/s; roll, pitch : (W,), rad. Returns heading, rad, (W,). It needs no
    latitude, and works in both hemispheres: its signal is Omega cos(lat).
    """
    x, y, z = omega_ib_b[:, 0], omega_ib_b[:, 1], omega_ib_b[:, 2]
    sine = -y * np.cos(roll) + z * np.sin(roll)
    cosine = x * np.cos(pitch) + y * np.sin(roll) * np.sin(pitch) + z * np.cos(roll) * np.sin(pitch)
    return np.asarray(np.arctan2(sine, cosine))


def tilts_of(force: np.ndarray, names: Iterable[str]) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch, (R,) each, rad, of mean specific forces at rest, (R, 3), m/s^2. Raises
    InputError with the force's own name where the forward axis is vertical and has no heading."""
    roll, pitch = level(force)
    for name, angle in zip(names, pitch, strict=True):
        if abs(angle) > np.pi / 2 - _UPRIGHT:
            raise InputError(
                name,
                f"{np.rad2deg(angle):.1f}",
                "deg",
                "is the forward axis's pitch: it is vertical and has no heading",
            )
    return roll, pitch
