"""The planet: WGS-84's rotation rate and normal gravity."""

import numpy as np

EARTH_RATE = 7.292115e-5
"""Earth's rotation rate, rad/s, WGS-84."""

# WGS-84 normal gravity (Somigliana), as in Groves 2013, eq. 2.134.
_GRAVITY_EQUATOR = 9.7803253359
_SOMIGLIANA_K = 0.00193185265241
_ECCENTRICITY_SQUARED = 0.00669437999014
_EQUATORIAL_RADIUS = 6378137.0
_FLATTENING = 1 / 298.257223563
_CENTRIFUGAL_SHARE = 3.449786506841e-3  # omega^2 R0^2 RP/mu


def earth_rate_ned(latitude: float | np.ndarray) -> np.ndarray:
    """Earth's rotation rate in n = NED.

    latitude : rad, any shape S. Returns (*S, 3), rad/s.
    """
    lat = np.asarray(latitude, dtype=float)
    return EARTH_RATE * np.stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)], axis=-1)


def normal_gravity(latitude: float, height: float = 0.0) -> float:
    """WGS-84 normal gravity, m/s^2, downward, with Earth's centrifugal acceleration included.

    latitude : rad; height : m above the ellipsoid (Groves 2013, eqs. 2.134 and 2.139).
    """
    return float(normal_gravities(np.asarray(latitude), height))


def normal_gravities(latitude: np.ndarray, height: float = 0.0) -> np.ndarray:
    """WGS-84 normal gravity, m/s^2, at many latitudes, rad, any shape; see `normal_gravity`."""
    s2 = np.sin(latitude) ** 2
    surface = _GRAVITY_EQUATOR * (1 + _SOMIGLIANA_K * s2) / np.sqrt(1 - _ECCENTRICITY_SQUARED * s2)
    slope = 1 + _FLATTENING * (1 - 2 * s2) + _CENTRIFUGAL_SHARE
    h = height / _EQUATORIAL_RADIUS
    return np.asarray(surface * (1 - 2 * slope * h + 3 * h**2))


def heading_exists(latitude: float | np.ndarray) -> np.ndarray:
    """Whether heading is defined: everywhere but within a millionth of a degree of a pole.
    latitude : rad, any shape."""
    return np.asarray(np.cos(np.asarray(latitude)) > np.deg2rad(1e-6))
