"""Conversion of datasheet units to SI. The end of a key's name states its unit."""

import math
from functools import lru_cache

STANDARD_GRAVITY = 9.80665
"""The g of datasheets, m/s^2; it is not gravity at any place on Earth."""

DEG = math.pi / 180.0
GAUSS = 1e-4
"""T"""
HOUR = 3600.0

# suffix of a key -> (factor to SI, how the unit is written)
_SUFFIXES: dict[str, tuple[float, str]] = {
    "deg_per_h_per_sqrt_h": (DEG / HOUR / math.sqrt(HOUR), "deg/h/sqrt(h)"),
    "deg_per_sqrt_h": (DEG / math.sqrt(HOUR), "deg/sqrt(h)"),
    "deg_per_h_per_h": (DEG / HOUR**2, "deg/h/h"),
    "deg_per_h_per_g": (DEG / HOUR / STANDARD_GRAVITY, "deg/h/g"),
    "deg_per_h_per_gauss": (DEG / HOUR / GAUSS, "deg/h/gauss"),
    "deg_per_h_per_k": (DEG / HOUR, "deg/h/K"),
    "deg_per_h": (DEG / HOUR, "deg/h"),
    "arcsec": (DEG / HOUR, "arcsec"),
    "arcsec_per_h": (DEG / HOUR**2, "arcsec/h"),
    "deg_per_s": (DEG, "deg/s"),
    "deg_per_s2": (DEG, "deg/s2"),
    "deg": (DEG, "deg"),
    # A density per sqrt(Hz) is one-sided, the coefficient N is two-sided: hence sqrt(2).
    "deg_per_s_per_sqrt_hz": (DEG / math.sqrt(2.0), "deg/s/sqrt(Hz)"),
    "m_per_s_per_sqrt_h": (1 / math.sqrt(HOUR), "m/s/sqrt(h)"),
    "ug_per_h": (1e-6 * STANDARD_GRAVITY / HOUR, "ug/h"),
    "ug_per_k": (1e-6 * STANDARD_GRAVITY, "ug/K"),
    "ppm_per_k": (1e-6, "ppm/K"),
    "m_per_s": (1.0, "m/s"),
    "k": (1.0, "K"),
    "ug_s": (1e-6 * STANDARD_GRAVITY, "ug s"),
    "ug_per_sqrt_hz": (1e-6 * STANDARD_GRAVITY / math.sqrt(2.0), "ug/sqrt(Hz)"),
    "ug_per_sqrt_h": (1e-6 * STANDARD_GRAVITY / math.sqrt(HOUR), "ug/sqrt(h)"),
    "ug": (1e-6 * STANDARD_GRAVITY, "ug"),
    "mg": (1e-3 * STANDARD_GRAVITY, "mg"),
    "g": (STANDARD_GRAVITY, "g"),
    "ppm": (1e-6, "ppm"),
    "mrad": (1e-3, "mrad"),
    "hz": (1.0, "Hz"),
    "gauss": (GAUSS, "gauss"),
    "nm_s_per_rad": (1.0, "N m s/rad"),
    "nm_per_rad": (1.0, "N m/rad"),
    "nm": (1.0, "N m"),
    "n": (1.0, "N"),
    "kg_m2": (1.0, "kg m2"),
    "kg": (1.0, "kg"),
    "m": (1.0, "m"),
    "s": (1.0, "s"),
    "latitude": (DEG, "deg"),
}
_LONGEST_FIRST = sorted(_SUFFIXES, key=len, reverse=True)


@lru_cache(maxsize=1024)
def _suffix(key: str) -> str | None:
    """The longest suffix of a key's name that is a unit."""
    return next((s for s in _LONGEST_FIRST if f"_{key}".endswith(f"_{s}")), None)


def unit_of(key: str) -> str:
    """The unit that a key's name states, in its usual notation; empty where it states none."""
    suffix = _suffix(key.rsplit(".", 1)[-1])
    return _SUFFIXES[suffix][1] if suffix else ""


def factor(key: str) -> float:
    """One unit of this key in SI, such as 1 deg/sqrt(h) in rad/sqrt(s) for arw_deg_per_sqrt_h.
    Raises KeyError where the key's name ends in no unit."""
    suffix = _suffix(key)
    if suffix is None:
        raise KeyError(f"the key {key!r} ends in no unit")
    return _SUFFIXES[suffix][0]


# Units of a log's columns -> factor to SI. Increments are per sample and become rates by 1/dt.
RATE_UNITS: dict[str, float] = {
    "rad/s": 1.0,
    "deg/s": DEG,
    "deg/h": DEG / HOUR,
    "mrad/s": 1e-3,
}
ANGLE_UNITS: dict[str, float] = {"rad": 1.0, "deg": DEG, "arcsec": DEG / HOUR}
FORCE_UNITS: dict[str, float] = {
    "m/s2": 1.0,
    "g": STANDARD_GRAVITY,
    "mg": 1e-3 * STANDARD_GRAVITY,
}
VELOCITY_UNITS: dict[str, float] = {
    "m/s": 1.0,
    "g*s": STANDARD_GRAVITY,
    "ug*s": 1e-6 * STANDARD_GRAVITY,
}


def rate_factor(unit: str, rate_hz: float) -> float:
    """The value in rad/s of a unit of a rate, or of an angle increment at `rate_hz`."""
    return RATE_UNITS[unit] if unit in RATE_UNITS else ANGLE_UNITS[unit] * rate_hz


def force_factor(unit: str, rate_hz: float) -> float:
    """The value in m/s^2 of a unit of a force, or of a velocity increment at `rate_hz`."""
    return FORCE_UNITS[unit] if unit in FORCE_UNITS else VELOCITY_UNITS[unit] * rate_hz
