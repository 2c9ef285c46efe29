"""The planet: WGS-84's rotation rate and normal gravity."""

import numpy as np

EARTH_RATE = 7.292115e-5
"""rad/s, WGS-84."""

# WGS-84 normal gravity (Somigliana), as in Groves 2013, eq. 2.134.
_GRAVITY_EQUATOR = 9.7803253359
_SOMIGLIANA_K = 0.00193185265241
_ECCENTRICITY_SQUARED = 0.00669437999014


def earth_rate_ned(latitude: float | np.ndarray) -> np.ndarray:
    """Earth's rotation rate in n = NED.

    latitude : rad, any shape S. Returns (*S, 3), rad/s.
    """
    lat = np.asarray(latitude, dtype=float)
    return EARTH_RATE * np.stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)], axis=-1)


def normal_gravity(latitude: float) -> float:
    """WGS-84 normal gravity on the ellipsoid, m/s^2: down, Earth's centrifugal part included.

    latitude : rad.
    """
    s2 = np.sin(latitude) ** 2
    return float(
        _GRAVITY_EQUATOR * (1 + _SOMIGLIANA_K * s2) / np.sqrt(1 - _ECCENTRICITY_SQUARED * s2)
    )


def heading_exists(latitude: float | np.ndarray) -> np.ndarray:
    """Whether north is a direction: everywhere but within a millionth of a degree of a pole."""
    return np.cos(np.asarray(latitude)) > np.deg2rad(1e-6)
