"""What a sensor's errors make of means in the body's axes, on a plate whose base may lean.

The data of a window are six channels, gyros and accelerometers forward, right and down, means over
the parts of a course (see lbgc.estimators.block_means). With theta the plate's angle, L from the
base's axes to level ones and u a vector in level axes that look where the base looks,

    vector felt = Rz(theta)' L' u,    u = (Omega cos(lat) q_1, -Omega cos(lat) q_2, -Omega sin(lat))
                                      or (0, 0, -g)

and the plate's rate besides, about down. What evolves within a recording is independent from
channel to channel and knows nothing of headings or leans: one covariance a channel. All else is
some number, drawn once, times a pattern that is known: 1, cos theta, sin theta, the plate's rate
and its square, and these times the warming up so far. So a cause of errors (a bias, a scale factor,
a misalignment, g-sensitivity, the level's error, the latitude's) is a few coefficients of patterns,
and only those depend on how the base leans.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lbgc.earth import EARTH_RATE
from lbgc.estimators.block_means import ENCODER, Course, Site
from lbgc.sensor import errors
from lbgc.sensor.deterministic import InRun
from lbgc.sensor.imu import ImuModel

CHANNELS = 6
PATTERNS = 9
ONE, COS, SIN, RATE, SQUARE, WARM = range(6)
"""The patterns' numbers; from WARM on, warming up times the first four."""
_LEVER_M = 0.3
_LATITUDE = np.deg2rad(0.01)
_GRAVITY = 1e-3
"""1 sigma: a kilometre of latitude; relative, of gravity, some kilometres of height."""
ANY_TILT = 0.2
"""rad: as good as nothing known beside the accelerometers."""
ANY_BIAS = 1e-2
"""rad/s, of a gyro of which nothing is known."""
_SLEW = 100.0
"""m/s^2"""
_LEAST = (1e-12, 1e-9)
"""rad/s and m/s^2: sensors without any error have no covariance to invert; far below all others."""


def patterns(imu: ImuModel, course: Course) -> np.ndarray:
    """Means over the parts, (n, PATTERNS); see the module."""
    n = len(course.blocks)
    first = [np.ones(n), course.c, course.s, np.array(course.rate)]
    warmth = np.zeros(n)
    if imu.warming.rise_k != 0:
        rise = imu.warming.rise(course.start + course.count, course.interval)
        warmth = course.averaged() @ rise[course.start :]
    every = [*first, np.array(course.squared), *(warmth * pattern for pattern in first)]
    return np.stack(every, axis=1)


def felt_of(base: np.ndarray, u: np.ndarray) -> np.ndarray:
    """A vector u (3,) of the level axes as the body's three channels feel it, by patterns: (G, 3,
    PATTERNS). base : (G, 3, 3), L."""
    b = np.swapaxes(base, 1, 2) @ u
    found = np.zeros((len(base), 3, PATTERNS))
    found[:, 0, COS], found[:, 0, SIN] = b[:, 0], b[:, 1]
    found[:, 1, COS], found[:, 1, SIN] = b[:, 1], -b[:, 0]
    found[:, 2, ONE] = b[:, 2]
    return found


def _on(rows: slice, coefficients: np.ndarray) -> np.ndarray:
    """(G, 3, PATTERNS) as that of all channels, (G, CHANNELS, PATTERNS)."""
    found = np.zeros((len(coefficients), CHANNELS, PATTERNS))
    found[:, rows] = coefficients
    return found


GYRO, ACCEL = slice(0, 3), slice(3, 6)


@dataclass(frozen=True)
class Signal:
    """What is felt without errors, by patterns; each (G, CHANNELS, PATTERNS)."""

    q: tuple[np.ndarray, np.ndarray]
    """What is felt of cos psi and of sin psi"""
    known: np.ndarray
    """What is felt whatever the heading"""
    tilt: tuple[np.ndarray, np.ndarray]
    """What is felt of an error of the level about level axes forward and right, by the rad. What
    Earth's horizontal rate makes of it is left out: it is vertical, and hardly felt"""


def signal(base: np.ndarray, site: Site) -> Signal:
    north, down, g = site.north, site.down, site.gravity

    def both(rate: tuple[float, float, float], force: tuple[float, float, float]) -> np.ndarray:
        return np.concatenate([felt_of(base, np.array(u)) for u in (rate, force)], axis=1)

    none = (0.0, 0.0, 0.0)
    return Signal(
        q=(both((north, 0.0, 0.0), none), both((0.0, -north, 0.0), none)),
        known=both((0.0, 0.0, down), (0.0, 0.0, -g)),
        tilt=(both((0.0, down, 0.0), (0.0, -g, 0.0)), both((-down, 0.0, 0.0), (g, 0.0, 0.0))),
    )


def causes(imu: ImuModel, base: np.ndarray, site: Site) -> dict[str, np.ndarray]:
    """What is drawn once and known but for its size, times 1 sigma, by patterns: by name (G, r,
    CHANNELS, PATTERNS). base : (G, 3, 3)."""
    earth = signal(base, site)
    force = earth.known[:, ACCEL]
    turning = np.zeros_like(force)
    turning[:, 2, RATE] = 1.0
    horizontal = [part[:, GYRO] / np.sqrt(2) for part in earth.q]  # squared, averaged over headings
    rates = [*horizontal, earth.known[:, GYRO] + turning]
    levers = [_channel(axis, _one(len(base), SQUARE, _LEVER_M)) for axis in (0, 1)]
    one = np.zeros_like(force)
    one[..., ONE] = 1.0
    north, east, down = imu.field_ned
    level = float(np.hypot(north, east))
    each_way = [(level, 0.0, 0.0), (0.0, -level, 0.0)]  # of cos and sin of its angle to the base
    fields = [felt_of(base, np.array(u)) / np.sqrt(2) for u in each_way]
    fields.append(felt_of(base, np.array([0.0, 0.0, down])))
    found: dict[str, list[np.ndarray]] = {}
    for rows, triad, truths, own in (
        (GYRO, imu.gyro, rates, ""),
        (ACCEL, imu.accel, [force], "accelerometer "),
    ):
        felt = {errors.ONE: [one], errors.TRUTH: truths, errors.FORCE: [force, *levers],
                errors.FIELD: fields}  # fmt: skip
        for error in triad.drawn:
            each = found.setdefault(own + error.cause, [])
            for axis, c in (one for part in felt[error.follows] for one in error.along(part)):
                warmed = np.pad(c[:, :SQUARE], ((0, 0), (WARM, 0))) if error.warms else c
                each.append(_on(rows, _channel(axis, warmed)))
    found["accelerometer lever arm"] = [_on(ACCEL, lever) for lever in levers]
    found["gravity"] = [_GRAVITY * _on(ACCEL, force)]
    vertical = felt_of(base, np.array([0.0, 0.0, -site.north * _LATITUDE]))
    found["latitude"] = [_on(GYRO, vertical)]
    stacked = {name: np.stack(each, axis=1) for name, each in found.items() if each}
    return {name: c[:, c.any(axis=(0, 2, 3))] for name, c in stacked.items() if c.any()}


def _one(count: int, pattern: int, size: float) -> np.ndarray:
    found = np.zeros((count, PATTERNS))
    found[:, pattern] = size
    return found


def _channel(axis: int, coefficients: np.ndarray) -> np.ndarray:
    """(G, PATTERNS) as that of one of three channels, (G, 3, PATTERNS)."""
    found = np.zeros((len(coefficients), 3, PATTERNS))
    found[:, axis] = coefficients
    return found


def free_bias() -> np.ndarray:
    """A constant of any size on each gyro, (1, 3, CHANNELS, PATTERNS)."""
    each = [_on(GYRO, _channel(axis, _one(1, ONE, ANY_BIAS))) for axis in range(3)]
    return np.stack(each, axis=1)


def within(imu: ImuModel, course: Course) -> dict[str, np.ndarray]:
    """Covariance of what evolves within a recording, by name (CHANNELS, n, n), (rad/s)^2 and
    (m/s^2)^2: the channels are independent of each other."""
    n = len(course.blocks)
    found: dict[str, np.ndarray] = {}
    for name, channel, covariance in _within(imu, course):
        own = name if channel < 3 else f"accelerometer {name}"
        found.setdefault(own, np.zeros((CHANNELS, n, n)))[channel] += covariance
    return found


def _within(imu: ImuModel, course: Course) -> Iterator[tuple[str, int, np.ndarray]]:
    """Name, channel and covariance (n, n), one after the other."""
    for first, triad in ((0, imu.gyro), (3, imu.accel)):
        for axis in range(3):
            for term in triad.in_run(axis, imu.dt):
                yield term.cause, first + axis, _of_term(term, course)
    misread = ENCODER * course.encoder_errors()
    yield "encoder", 2, misread @ misread.T
    unsure = np.diag(np.square(EARTH_RATE * np.array(course.unsure)))
    yield from (("encoder", channel, unsure) for channel in (0, 1))
    if course.slewing.any():  # what an accelerometer feels there is the slew's
        for channel in (3, 4, 5):
            yield "slews", channel, np.diag(np.where(course.slewing, _SLEW**2, 0.0))


@lru_cache(maxsize=16)
def timeless(imu: ImuModel) -> bool:
    """Whether its errors in a window have the same law whenever the recording began: nothing warms
    up, and no term's state spreads as time goes on."""
    triads = (imu.gyro, imu.accel)
    if imu.warming.rise_k != 0 and any(e.warms and e.sigma.any() for t in triads for e in t.drawn):
        return False
    return all(
        term.is_stationary for t in triads for axis in range(3) for term in t.in_run(axis, imu.dt)
    )


@lru_cache(maxsize=16)  # as many as one course's axes share; each may have half a megabyte
def _of_term(term: InRun, course: Course) -> np.ndarray:
    whole = term.covariance_of_means(course.count, course.interval, 1, course.start)
    return _averaged(whole, course)


def _averaged(covariance: np.ndarray, course: Course) -> np.ndarray:
    """Covariance of the parts' means, (n, n), from that of all blocks."""
    if not course.slewing.any():
        return covariance[np.ix_(course.blocks, course.blocks)]
    A = course.averaged()
    return np.asarray(A @ covariance @ A.T)


@lru_cache(maxsize=32)  # megabytes each
def factors(imu: ImuModel, course: Course) -> np.ndarray:
    """Cholesky factors of the channels' covariance, lower, (CHANNELS, n, n)."""
    total = np.repeat(np.square(_LEAST), 3)[:, None, None] * np.eye(len(course.blocks))
    for _, channel, covariance in _within(imu, course):
        total[channel] += covariance
    return np.linalg.cholesky(total)
