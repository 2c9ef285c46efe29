"""A piece of a file in SI and along the body's axes: its samples, and the other fields of its
record."""

import math
from typing import Any

import numpy as np

from lbgc.data.logconfig import LogConfig
from lbgc.data.readers.axes import matrix_of
from lbgc.data.readers.blocks import blocks, some
from lbgc.data.readers.raw import Raw
from lbgc.errors import InputError, require
from lbgc.frames import AXES, DOWN, wrap
from lbgc.units import DEG, STANDARD_GRAVITY, force_factor, rate_factor

_UNITS_OF_G = ("g", "mg", "g*s", "ug*s")
"""Units that depend on the value of g that a file states."""
_LEVEL = 1.0 * DEG
"""Angle of a plate about a level axis, rad, within which a reference's heading counts."""
_UNEVEN_DEG = 5.0
"""Largest scatter of a reference instrument's headings, degrees, about one that turns with the
plate."""


def fields_of(raw: Raw, rate: float, notes: tuple[str, ...]) -> dict[str, Any]:
    """The fields of the record of one piece at this rate, Hz, but for the triads' samples."""
    config = raw.config
    for key, column in (("plate_column", raw.plate), ("heading_column", raw.heading)):
        given = getattr(config, key)
        about = f"is not read from {raw.name}: log.reader={config.reader} has no further columns"
        require(given is None or column is not None, f"log.{key}", given, about)
    angle = np.zeros(max(len(raw.gyro), len(raw.accel)))
    if raw.plate is not None:
        factor = 1.0 if config.plate_unit == "rad" else DEG
        angle = np.unwrap(raw.plate * (config.plate_scale * factor))
    sigma = config.heading_sigma_deg
    return {
        "name": raw.name,
        "plate_angle": angle,
        "rate_hz": rate,
        "latitude": math.nan if config.latitude is None else config.latitude * DEG,
        "heading_reference": _reference(raw, angle),
        "reference_sigma": None if sigma is None else sigma * DEG,
        "unit": config.unit,
        "session": config.session,
        "temperature": raw.temperature,
        "axis": AXES.index(config.plate_axis),
        "notes": notes,
    }


def _reference(raw: Raw, angle: np.ndarray) -> float | None:
    """The reference heading where the plate's angle is zero, rad: the stated one, or the circular
    mean of the column's less the angle, (T,), rad. Raises InputError where the column does not turn
    with the plate."""
    config = raw.config
    if raw.heading is None:
        return None if config.heading_deg is None else config.heading_deg * DEG
    at_zero = np.exp(1j * (raw.heading * DEG - angle))
    if config.plate_axis != AXES[DOWN]:  # on its side, or over, a body has another heading
        at_zero = np.exp(1j * raw.heading[np.abs(wrap(angle)) < _LEVEL] * DEG)
        about = f"needs a time in which the plate about {config.plate_axis} is at zero"
        require(len(at_zero) > 0, "log.heading_column", config.heading_column, about)
    mean = float(np.angle(at_zero.mean()))
    off = float(np.sqrt(np.mean(np.angle(at_zero * np.exp(-1j * mean)) ** 2))) / DEG
    if off > _UNEVEN_DEG:
        raise InputError(
            "log.heading_column", config.heading_column, "", f"differs by {off:.3g} deg RMS from "
            f"one heading of {raw.name} that turns with the plate: its unit is degrees, clockwise "
            "from north; or the plate's angle is wrong"
        )  # fmt: skip
    return mean


def rates(raw: Raw, rate_hz: float) -> np.ndarray:
    """The gyros' rates, rad/s, along the body's axes."""
    unit = rate_factor(raw.config.gyro_unit, rate_hz)
    return _converted(raw.gyro, raw.config, "gyro", unit, raw.config.axes)


def forces(raw: Raw, rate_hz: float) -> np.ndarray:
    """The specific forces, m/s^2, along the body's axes. The unit "auto" is g where the median of
    their sizes is below 3, else m/s2: their mean is small where the IMU is held in opposite
    attitudes."""
    config, unit = raw.config, raw.config.accel_unit
    if unit == "auto":
        counted = config.counted("accel", some(raw.accel).copy())  # in its place
        sizes = np.linalg.norm(counted, axis=1)
        unit = "g" if np.median(sizes) < 3 else "m/s2"
    factor = force_factor(unit, rate_hz)
    if raw.gravity is not None and unit in _UNITS_OF_G:
        factor *= raw.gravity / STANDARD_GRAVITY
    return _converted(raw.accel, config, "accel", factor, config.axes_of_accel)


def _converted(
    values: np.ndarray, config: LogConfig, part: str, unit: float, axes: list[str]
) -> np.ndarray:
    """Values (T, 3) of a triad, scale (count - offset), in a unit of this SI value, and along the
    body's axes, in the place of the file's."""
    values = values if values.flags.c_contiguous else np.ascontiguousarray(values)
    matrix = matrix_of(axes)
    for own in blocks(len(values)):
        counted = config.counted(part, values[own])
        counted *= unit
        values[own] = counted @ matrix.T if values.shape[1] == len(matrix) else counted
    return values
