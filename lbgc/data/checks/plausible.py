"""Whether a resting IMU's means are plausible with the units of its log's description, and with
possible gyro biases.

A wrong unit and a large bias both make a mean rate that is not Earth's, so their odds are compared:
nothing is called a wrong unit that a bias explains about as well.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.logconfig import LogConfig
from lbgc.data.record import Record
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.sensor.errors import FIELD, FORCE, ONE, TRUTH
from lbgc.sensor.imu import ImuModel, Triad
from lbgc.units import (
    ANGLE_UNITS,
    DEG,
    FORCE_UNITS,
    GAUSS,
    HOUR,
    RATE_UNITS,
    VELOCITY_UNITS,
    force_factor,
    rate_factor,
)

PER_HOUR = HOUR / DEG
"""One rad/s in deg/h."""
FIVE_SIGMA = 32.2
"""The chi-square with three degrees of freedom that is exceeded as seldom as 5 sigma, 6e-7."""
_FORCE_SHARE = 0.2
"""The largest relative difference of a mean force from gravity."""
_MENTIONED, _CERTAIN, _OTHER_KIND = 30.0, 1e6, 0.1
"""The odds from which on a unit is named beside a bias; those from which on it alone is a reason to
refuse; and the prior odds of an increment instead of a rate, or the other way round."""
_COUNTS = (8, 16, 32, 64)
"""Numbers of blocks whose means are compared."""
_STRONGEST = 0.65 * GAUSS
"""Earth's magnetic field is nowhere stronger."""
_ANGLES = np.linspace(0, 2 * np.pi, 720, endpoint=False)
"""Headings that are tried, rad."""


@dataclass(frozen=True)
class Resting:
    """The means of a resting recording, and the sizes of their errors."""

    name: str
    """The recording's name"""
    rate: np.ndarray
    """(3,), rad/s, mean rate in the body axes of the log's description"""
    noise: np.ndarray
    """(3,), rad/s, 1 sigma of `rate` by the recording's own scatter"""
    stated: np.ndarray | None
    """(3,), rad/s, 1 sigma of the errors that are stated of the gyros; None where none are"""
    force: np.ndarray
    """(3,), m/s^2, mean specific force"""
    latitude: float
    """Latitude, rad"""
    unsteady: float
    """rad/s, 1 sigma of the means over eighths of the recording, on the axis that varies most"""
    limit: float
    """rad/s, the largest gyro bias that is taken as possible, as the length of a vector"""

    @property
    def sigma(self) -> np.ndarray:
        """(3,), rad/s, 1 sigma of `rate` by noise and stated errors together, never quite zero."""
        stated = 0.0 if self.stated is None else self.stated
        return np.sqrt(self.noise**2 + stated**2 + (1e-5 * EARTH_RATE) ** 2)

    @property
    def horizontal(self) -> float:
        """Earth's horizontal rate at this latitude, rad/s."""
        return EARTH_RATE * float(np.cos(self.latitude))


def resting(record: Record, config: LogConfig, imu: ImuModel | None) -> Resting:
    """The means of a recording with their noise and the errors that the sensor's model states."""
    noise = mean_noise(record.gyro)
    stated = None if imu is None else stated_errors(imu.gyro, record.duration_s)
    limit = config.refuses_above[1] / PER_HOUR
    if stated is not None:
        limit = max(limit, float(np.sqrt(FIVE_SIGMA) * stated.max()))
    return Resting(
        record.name,
        record.gyro.mean(axis=0),
        noise,
        stated,
        record.accel.mean(axis=0),
        record.latitude,
        unsteady(record.gyro),
        limit,
    )


def mean_noise(values: np.ndarray) -> np.ndarray:
    """1 sigma of the mean of values (T, 3), by the scatter of block means: (3,).

    For white noise, blocks of any length give it. A larger scatter at longer blocks is slow noise,
    which does not average out, so the excess of the longest blocks is added whole.
    """
    n = len(values)
    variance = np.zeros(3)
    scatter = {}
    for count in _COUNTS:
        if n >= 2 * count:
            size = n // count
            means = values[: size * count].reshape(count, size, 3).mean(axis=1)
            scatter[count] = means.var(axis=0, ddof=1)
            variance = np.maximum(variance, scatter[count] / count)
    if not scatter:
        return np.asarray(np.ptp(values, axis=0) / np.sqrt(max(n, 1)))
    shortest, longest = max(scatter), min(scatter)
    white = scatter[shortest] * longest / shortest
    # With eight blocks the scatter exceeds twice that of white noise by chance in 1% of logs, which
    # is harmless.
    excess = np.maximum(scatter[longest] - 2 * white, 0.0)
    return np.asarray(np.sqrt(variance + excess))


def unsteady(values: np.ndarray) -> float:
    """1 sigma of the means over eighths of values (T, 3), of the column that varies most."""
    size = len(values) // 8
    if size == 0:
        return 0.0
    return float(values[: 8 * size].reshape(8, size, 3).mean(axis=1).std(axis=0).max())


def stated_errors(gyro: Triad, duration_s: float) -> np.ndarray | None:
    """1 sigma, (3,), rad/s, of the stated errors of the gyros' mean over a recording at rest,
    without noise that averages out. None where no bias is stated, since that does not state that
    there is none.
    """
    bias = gyro.bias() ** 2
    if not bias.any():
        return None
    felt = gyro.variance(FORCE).max(axis=1) * normal_gravity(0.0) ** 2
    felt = felt + gyro.variance(ONE, warms=True).diagonal() * 30.0**2  # a usual warm-up, K
    felt = felt + gyro.variance(FIELD).sum(axis=1) * _STRONGEST**2
    turned = gyro.variance(TRUTH).sum(axis=1) * EARTH_RATE**2
    return np.asarray(np.sqrt(bias + gyro.slow_variance(duration_s) + felt + turned))


def residual(
    rate: np.ndarray, force: np.ndarray, latitude: float, sigma: np.ndarray
) -> tuple[float, np.ndarray]:
    """The difference of a mean rate from the nearest one that Earth's rate can cause at any
    heading: its chi-square (of vertical and horizontal part together), and itself, (3,), rad/s.

    rate : (3,), rad/s; force : (3,), mean specific force of any size; latitude : rad; sigma : (3,),
    rad/s.
    """
    earth = _possible(force, latitude, _ANGLES)
    chi = np.sum(((rate - earth) / sigma) ** 2, axis=1)
    step = _ANGLES[1] - _ANGLES[0]
    fine = _ANGLES[chi.argmin()] + np.linspace(-step, step, 201)
    earth = _possible(force, latitude, fine)
    chi = np.sum(((rate - earth) / sigma) ** 2, axis=1)
    best = int(chi.argmin())
    return float(chi[best]), rate - earth[best]


def _possible(force: np.ndarray, latitude: float, angles: np.ndarray) -> np.ndarray:
    """Earth's rate in body axes, (A, 3), rad/s, at angles (A,) about the measured vertical, which
    cover all headings."""
    down = down_of(force)
    side = np.eye(3)[np.abs(down).argmin()]
    first = side - down * (side @ down)
    first /= np.linalg.norm(first)
    second = np.cross(down, first)
    level = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    return np.asarray(EARTH_RATE * (np.cos(latitude) * level - np.sin(latitude) * down))


def down_of(force: np.ndarray) -> np.ndarray:
    """The measured down, a unit vector, (3,): at rest the specific force points up."""
    norm = float(np.linalg.norm(force))
    return -force / norm if norm > 0 else np.array([0.0, 0.0, 1.0])


def force_finding(
    name: str, force: np.ndarray, latitude: float, config: LogConfig, rate_hz: float
) -> Finding | None:
    """The finding that a mean force, (3,), m/s^2, differs from gravity by a fifth or more, because
    of a wrong unit or a broken sensor; None where it does not. name : the recording's."""
    g = normal_gravity(latitude)
    norm = float(np.linalg.norm(force))
    if abs(norm / g - 1) < _FORCE_SHARE:
        return None
    unit = config.accel_unit
    if unit == "auto":
        own, shown = 1.0, "auto"
        fitting = []
    else:
        own, shown = force_factor(unit, rate_hz), unit
        every = {u: force_factor(u, rate_hz) for u in (*FORCE_UNITS, *VELOCITY_UNITS)}
        fitting = [u for u, f in every.items() if abs(norm / own * f / g - 1) < _FORCE_SHARE]
    why = f"in {' or '.join(fitting)} it would make sense"
    if not fitting:
        why = "no unit makes sense of it: is it at rest, and its scale right?"
        if norm < _FORCE_SHARE * g:
            why += " Or was gravity taken out of it?"
    says = f"{name} would rest at {norm:.4g} m/s2, not within 20% of g; {why}"
    return Finding("force", "log.accel_unit", shown, "", says)


def rate_finding(rest: Resting, config: LogConfig, rate_hz: float, north: bool) -> Finding | None:
    """The finding that a mean rate cannot be Earth's with a possible bias: the unit is another, or
    the bias exceeds the limit. None where neither is so."""
    _, off = residual(rest.rate, rest.force, rest.latitude, np.ones(3))
    bias = max(0.0, float(np.linalg.norm(off)) - 5 * float(rest.noise.max()))
    too_large = bool(bias > rest.limit)
    odds = _odds_of_units(rest, config.gyro_unit, rate_hz)
    best = max(odds.values(), default=0.0)
    enough = max(_MENTIONED if too_large else _CERTAIN, best / _MENTIONED)
    named = sorted((u for u in odds if odds[u] > enough), key=lambda u: -odds[u])
    mean = float(np.linalg.norm(rest.rate)) * PER_HOUR
    limit = rest.limit * PER_HOUR
    said = f"{rest.name}'s mean rate would be {mean:.4g} deg/h where Earth's is "
    said += f"{EARTH_RATE * PER_HOUR:.4g}: "
    if named and best > _CERTAIN:
        says = f"{said}a bias does not hide Earth's rate so well; in {' or '.join(named)} it would "
        return Finding("unit", "log.gyro_unit", config.gyro_unit, "", says + "make sense")
    if not too_large or not north:
        return None
    says = f"{said}a bias of at least {bias * PER_HOUR:.3g}, above the largest that is thought "
    says += f"possible ({limit:.4g}); Earth's horizontal rate here is "
    says += f"{rest.horizontal * PER_HOUR:.3g}, so such a bias hides north from a resting IMU. "
    enough = float(f"{1.5 * (bias + 5 * float(rest.noise.max())) * PER_HOUR:.1g}")
    says += f"If this sensor may have it, say so: log.bias_limit_deg_per_h={enough:g}"
    if rest.unsteady > 0.5 * bias:
        says += "; if it moved meanwhile, cut the log to where it rests"
    elif named:
        says += f"; in {' or '.join(named)} Earth's rate would be there, along the vertical, too"
    elif bias * PER_HOUR > 1e5:
        says += "; no unit makes sense of it: is it at rest, and its scale right?"
    return Finding("bias", *config.refuses_above, "deg/h", says)


def _odds_of_units(rest: Resting, stated: str, rate_hz: float) -> dict[str, float]:
    """The odds of each other unit against the stated one, given the mean rate, where every order of
    magnitude of the bias is equally probable."""
    own = rate_factor(stated, rate_hz)
    least = density(rest, 1.0)
    odds = {}
    for unit in (*RATE_UNITS, *ANGLE_UNITS):
        c = rate_factor(unit, rate_hz) / own
        _, off = residual(c * rest.rate, rest.force, rest.latitude, np.ones(3))
        fits = float(np.linalg.norm(off)) <= max(rest.limit, 5 * c * float(rest.noise.max()))
        if unit != stated and fits:
            same_kind = (unit in RATE_UNITS) == (stated in RATE_UNITS)
            odds[unit] = density(rest, c) / least * (1.0 if same_kind else _OTHER_KIND)
    return odds


def density(rest: Resting, c: float) -> float:
    """The density of a mean rate w if it were c times as large, s^3, but for a constant, where
    every order of magnitude of the bias is equally probable.

    It is about |w - e|^-3, averaged over Earth's rates e at all headings and bounded at the noise.
    With another unit w becomes c w, and the density c^3 times that at c w.
    """
    earth = _possible(rest.force, rest.latitude, _ANGLES)
    floor = (0.005 * EARTH_RATE) ** 2 + float(np.sum((c * rest.noise) ** 2))
    square = np.sum((c * rest.rate - earth) ** 2, axis=1) + floor
    return c**3 * float(np.mean(square**-1.5))
