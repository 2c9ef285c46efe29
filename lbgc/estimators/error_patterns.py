"""The effect of a sensor's errors on means in the body's axes, on a plate whose base may lean.

The data of a window are six channels, gyros and accelerometers forward, right and down, means over
the parts of a course (see lbgc.estimators.block_means). With a the body's axis about which the
plate turns, theta its angle, L the rotation from the base's axes (the body's at angle zero) to
level ones, and u a vector in level axes whose forward axis is the base's heading,

    vector felt = Ra(theta)' L' u,    u = (Omega cos(lat) q_1, -Omega cos(lat) q_2, -Omega sin(lat))
                                      or (0, 0, -g)
                = a (a b) + cos(theta) (b - a (a b)) - sin(theta) a x b,    b = L' u (Rodrigues)

and the plate's rate about a besides. Noise that evolves within a recording is independent from
channel to channel and depends on neither heading nor lean: it has one covariance a channel. Every
other error is a number that is drawn once, times a known pattern: 1, cos theta, sin theta, the
plate's rate and its square, and the first four times the warming up so far. So each cause of errors
(a bias, a scale factor, a misalignment, g-sensitivity, the level's error, the latitude's) is a few
coefficients of patterns, and only these coefficients depend on how the base leans.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from lbgc.earth import EARTH_RATE
from lbgc.errors import InputError
from lbgc.estimators.block_means import ENCODER, Course, Site
from lbgc.frames import DOWN, across
from lbgc.sensor import errors
from lbgc.sensor.deterministic import InRun
from lbgc.sensor.imu import ImuModel
from lbgc.sensor.known import Coefficient
from lbgc.units import STANDARD_GRAVITY

CHANNELS = 6
PATTERNS = 9
ONE, COS, SIN, RATE, SQUARE, WARM = range(6)
"""The patterns' numbers; from WARM on, warming up times the first four."""
_LEVER_M = 0.3
"""m, 1 sigma of either component of the accelerometers' lever arm across the hinge."""
_LATITUDE = np.deg2rad(0.01)
"""rad, 1 sigma of the stated latitude: a kilometre."""
_GRAVITY = 1e-3
"""Relative 1 sigma of gravity: some kilometres of height."""
ANY_TILT = 0.2
"""rad, 1 sigma of the level's error: so large that the accelerometers alone tell the level."""
ANY_BIAS = 1e-2
"""rad/s, 1 sigma of the bias of a gyro of which nothing is known."""
_SLEW = 100.0
"""m/s^2, 1 sigma of the specific force during a slew: so large that it tells nothing."""
_LEAST = (1e-12, 1e-9)
"""rad/s and m/s^2, noise far below any sensor's: the covariance of a sensor without any error could
not be inverted."""


def patterns(imu: ImuModel, course: Course) -> np.ndarray:
    """Means of the nine patterns over a course's parts, (n, PATTERNS); see the module."""
    n = len(course.blocks)
    first = [np.ones(n), course.c, course.s, np.array(course.rate)]
    warmth = np.zeros(n)
    if imu.warming.rise_k != 0:
        rise = imu.warming.rise(course.start + course.count, course.interval)
        warmth = course.averaged() @ rise[course.start :]
    every = [*first, np.array(course.squared), *(warmth * pattern for pattern in first)]
    return np.stack(every, axis=1)


def felt_of(base: np.ndarray, u: np.ndarray, axis: int = DOWN) -> np.ndarray:
    """Coefficients of patterns, (G, 3, PATTERNS), of what the body's three axes feel of a vector u,
    (3,), that is constant in level axes. base : (G, 3, 3), L; axis : about which the plate
    turns."""
    b = np.swapaxes(base, 1, 2) @ u
    i, j = across(axis)
    found = np.zeros((len(base), 3, PATTERNS))
    found[:, i, COS], found[:, i, SIN] = b[:, i], b[:, j]
    found[:, j, COS], found[:, j, SIN] = b[:, j], -b[:, i]
    found[:, axis, ONE] = b[:, axis]
    return found


def _on_channels(rows: slice, coefficients: np.ndarray) -> np.ndarray:
    """Coefficients of one triad, (G, 3, PATTERNS), in the rows of all channels that are its own,
    (G, CHANNELS, PATTERNS); zero in the others."""
    found = np.zeros((len(coefficients), CHANNELS, PATTERNS))
    found[:, rows] = coefficients
    return found


GYRO, ACCEL = slice(0, 3), slice(3, 6)


@dataclass(frozen=True)
class Signal:
    """What an IMU without errors feels, as coefficients of patterns, each (G, CHANNELS, PATTERNS),
    in rad/s and m/s^2."""

    q: tuple[np.ndarray, np.ndarray]
    """The factor of cos psi and that of sin psi"""
    known: np.ndarray
    """The part that does not depend on the heading: Earth's vertical rate, and gravity"""
    tilt: tuple[np.ndarray, np.ndarray]
    """The factors, by the rad, of an error of the level about the level axes forward and right. The
    share of Earth's horizontal rate is left out: it is vertical, and hardly felt"""


def signal(base: np.ndarray, site: Site, axis: int = DOWN) -> Signal:
    """The error-free signal at a site, on G bases whose attitudes L are base, (G, 3, 3), whose
    plates turn about this axis."""
    north, down, g = site.north, site.down, site.gravity

    def both(rate: tuple[float, float, float], force: tuple[float, float, float]) -> np.ndarray:
        return np.concatenate([felt_of(base, np.array(u), axis) for u in (rate, force)], axis=1)

    none = (0.0, 0.0, 0.0)
    return Signal(
        q=(both((north, 0.0, 0.0), none), both((0.0, -north, 0.0), none)),
        known=both((0.0, 0.0, down), (0.0, 0.0, -g)),
        tilt=(both((0.0, down, 0.0), (0.0, -g, 0.0)), both((-down, 0.0, 0.0), (g, 0.0, 0.0))),
    )


STEADY = ""
"""The part of what errors follow that neither the heading nor a lever arm changes."""
_Felt: TypeAlias = dict[str, dict[str, np.ndarray]]


def causes(imu: ImuModel, base: np.ndarray, site: Site, axis: int = DOWN) -> dict[str, np.ndarray]:
    """Errors that are drawn once, by the name of their cause: coefficients of patterns times 1
    sigma, (G, r, CHANNELS, PATTERNS), of r independent errors each. base : (G, 3, 3), L; axis :
    about which the plates turn.

    Of a unit that is known (`ImuModel.known`) they are what is not known of it, all in one cause.
    """
    found: dict[str, list[np.ndarray]] = {}
    number = {} if imu.known is None else {c: k for k, c in enumerate(imu.known.coefficients)}
    left: dict[str, np.ndarray] = {}
    for cause, which, part, column in drawn_columns(imu, base, site, axis):
        if which in number:
            none = np.zeros((len(base), len(number), CHANNELS, PATTERNS))
            left.setdefault(part, none)[:, number[which]] = column
        else:
            found.setdefault(cause, []).append(column)
    if imu.known is not None and left:
        by = imu.known.correlated
        every = [np.einsum("grcp,rs->gscp", own, by, optimize=True) for own in left.values()]
        found["what is left of the unit"] = list(np.moveaxis(np.concatenate(every, axis=1), 1, 0))
    of_bench = bench_causes(base, site, axis)
    found |= {name: list(np.moveaxis(own, 1, 0)) for name, own in of_bench.items()}
    stacked = {name: np.stack(each, axis=1) for name, each in found.items() if each}
    return {name: c[:, c.any(axis=(0, 2, 3))] for name, c in stacked.items() if c.any()}


def bench_causes(base: np.ndarray, site: Site, axis: int = DOWN) -> dict[str, np.ndarray]:
    """What is drawn once and is none of the sensor's errors, as `causes` has it."""
    force = signal(base, site, axis).known[:, ACCEL]
    vertical = felt_of(base, np.array([0.0, 0.0, -site.north * _LATITUDE]), axis)
    return {
        "accelerometer lever arm": np.stack(
            [_on_channels(ACCEL, c) for c in _levers(len(base), axis)], 1
        ),
        "gravity": _GRAVITY * _on_channels(ACCEL, force)[:, None],
        "latitude": _on_channels(GYRO, vertical)[:, None],
    }


def drawn_columns(
    imu: ImuModel,
    base: np.ndarray,
    site: Site,
    axis: int = DOWN,
    heading: np.ndarray | None = None,
) -> Iterator[tuple[str, Coefficient, str, np.ndarray]]:
    """What 1 sigma of each of a sensor's coefficients adds to the means: the name of its cause,
    which it is, the part of what it follows, and (G, CHANNELS, PATTERNS).

    base : (G, 3, 3), L; axis : about which the plates turn; heading : (G,), rad, of the bases.
    Where it is not known, what turns with it is in parts of its own, by its RMS over headings.
    """
    gyro, accel = _felt(imu, base, site, axis, heading)
    for name, rows, triad, felt, own in (
        ("gyro", GYRO, imu.gyro, gyro, ""),
        ("accel", ACCEL, imu.accel, accel, "accelerometer "),
    ):
        for error in triad.drawn:
            for part, of_part in felt[error.follows].items():
                for i, j, c in error.along(of_part):
                    warmed = np.pad(c[:, :SQUARE], ((0, 0), (WARM, 0))) if error.warms else c
                    column = _on_channels(rows, _on_axis(i, warmed))
                    yield own + error.cause, Coefficient(name, error.name, i, j), part, column


def _felt(
    imu: ImuModel, base: np.ndarray, site: Site, axis: int, heading: np.ndarray | None
) -> tuple[_Felt, _Felt]:
    """What the errors of gyros and of accelerometers follow, by its kind and part: coefficients of
    patterns, (G, 3, PATTERNS). Arguments as for `drawn_columns`."""
    earth = signal(base, site, axis)
    force = earth.known[:, ACCEL]
    turning = np.zeros_like(force)
    turning[:, axis, RATE] = 1.0
    one = np.zeros_like(force)
    one[..., ONE] = 1.0
    north, east, down = imu.field_ned
    level, declination = float(np.hypot(north, east)), float(np.arctan2(east, north))
    each_way = [felt_of(base, np.array(u), axis) for u in ((level, 0.0, 0.0), (0.0, -level, 0.0))]
    vertical = felt_of(base, np.array([0.0, 0.0, down]), axis)
    rates = _by_heading([q[:, GYRO] for q in earth.q], earth.known[:, GYRO] + turning, heading)
    away = None if heading is None else heading - declination
    forces = {STEADY: force} | {f"lever {k}": c for k, c in enumerate(_levers(len(base), axis))}
    fields = _by_heading(each_way, vertical, away)
    both = {errors.ONE: {STEADY: one}, errors.FORCE: forces, errors.FIELD: fields}
    return {**both, errors.TRUTH: rates}, {**both, errors.TRUTH: {STEADY: force}}


def _by_heading(
    turns: Sequence[np.ndarray], steady: np.ndarray, angle: np.ndarray | None
) -> dict[str, np.ndarray]:
    """The parts of a vector that turns[0] cos(angle) + turns[1] sin(angle) + steady makes, (G, 3,
    PATTERNS) each: one where the angle, (G,), rad, is known."""
    if angle is None:
        cos, sin = (own / np.sqrt(2) for own in turns)
        return {"along": cos, "across": sin, STEADY: steady}
    cos, sin = (f(angle)[:, None, None] for f in (np.cos, np.sin))
    return {STEADY: cos * turns[0] + sin * turns[1] + steady}


def _levers(count: int, axis: int) -> list[np.ndarray]:
    """What 1 sigma of a lever arm, either way across the axis, makes accelerometers feel, (G, 3,
    PATTERNS) each."""
    return [_on_axis(own, _single(count, SQUARE, _LEVER_M)) for own in across(axis)]


def _single(count: int, pattern: int, size: float) -> np.ndarray:
    """Coefficients, (count, PATTERNS), that are `size` at one pattern and zero elsewhere."""
    found = np.zeros((count, PATTERNS))
    found[:, pattern] = size
    return found


def _on_axis(axis: int, coefficients: np.ndarray) -> np.ndarray:
    """Coefficients, (G, PATTERNS), in the row of one axis of a triad, (G, 3, PATTERNS); zero in the
    other rows."""
    found = np.zeros((len(coefficients), 3, PATTERNS))
    found[:, axis] = coefficients
    return found


def free_bias(axis: int) -> np.ndarray:
    """A bias of unknown size on each gyro that the turning plate frees of it, as coefficients of
    patterns times ANY_BIAS, (1, r, CHANNELS, PATTERNS). Along a level axis of the plate nothing
    turns, and all that tells north from a bias is the bias's own size."""
    freed = range(3) if axis == DOWN else across(axis)
    each = [_on_channels(GYRO, _on_axis(own, _single(1, ONE, ANY_BIAS))) for own in freed]
    return np.stack(each, axis=1)


def within(imu: ImuModel, course: Course) -> dict[str, np.ndarray]:
    """Covariance of the noise that evolves within a recording, by the name of its cause: (CHANNELS,
    n, n), (rad/s)^2 and (m/s^2)^2. The channels are independent of each other."""
    n = len(course.blocks)
    found: dict[str, np.ndarray] = {}
    for name, channel, covariance in _within(imu, course):
        own = name if channel < 3 else f"accelerometer {name}"
        found.setdefault(own, np.zeros((CHANNELS, n, n)))[channel] += covariance
    return found


def _within(imu: ImuModel, course: Course) -> Iterator[tuple[str, int, np.ndarray]]:
    """What `within` sums, one by one: name of the cause, channel, covariance (n, n). Beside the
    sensor's terms these are the encoder's error and, during slews, the unknown specific force."""
    for first, triad in ((0, imu.gyro), (3, imu.accel)):
        for axis in range(3):
            for term in triad.in_run(axis, imu.dt):
                yield term.cause, first + axis, _parts_covariance(term, course)
    misread = ENCODER * course.encoder_errors()
    yield "encoder", course.axis, misread @ misread.T
    unsure = np.diag(np.square(EARTH_RATE * np.array(course.unsure)))
    yield from (("encoder", channel, unsure) for channel in across(course.axis))
    if course.axis != DOWN:
        for channel, C in zip(across(course.axis), _turned_gravity(course), strict=True):
            yield "encoder", ACCEL.start + channel, C
    if course.slewing.any():  # accelerometers feel the slew's own acceleration there
        for channel in (3, 4, 5):
            yield "slews", channel, np.diag(np.where(course.slewing, _SLEW**2, 0.0))


def _turned_gravity(course: Course) -> Iterator[np.ndarray]:
    """Covariances, (n, n), of what errors of the plate's angle make of gravity on either axis
    across a level axis of the plate, (m/s^2)^2. The encoder errs alike over a rest, and anew in
    each."""
    new = np.abs(np.diff(course.angle, prepend=np.inf)) > ENCODER
    alike = np.equal.outer(np.cumsum(new), np.cumsum(new)) * (STANDARD_GRAVITY * ENCODER) ** 2
    gravity = np.array([0.0, -1.0]) if across(course.axis)[1] == DOWN else np.array([-1.0, 0.0])
    c, s = course.c, course.s
    for slope in (-s * gravity[0] + c * gravity[1], -c * gravity[0] - s * gravity[1]):
        yield np.outer(slope, slope) * alike


@lru_cache(maxsize=16)
def timeless(imu: ImuModel) -> bool:
    """Whether the law of the sensor's errors in a window is the same whenever the recording began:
    nothing warms up, and no term's variance grows with time."""
    triads = (imu.gyro, imu.accel)
    if imu.warming.rise_k != 0 and any(e.warms and e.sigma.any() for t in triads for e in t.drawn):
        return False
    return all(
        term.is_stationary for t in triads for axis in range(3) for term in t.in_run(axis, imu.dt)
    )


@lru_cache(maxsize=16)  # as many as one course's axes share; each may have half a megabyte
def _parts_covariance(term: InRun, course: Course) -> np.ndarray:
    """Covariance, (n, n), of one term's means over the parts."""
    whole = term.covariance_of_means(course.count, course.interval, 1, course.start)
    return _averaged(whole, course)


def _averaged(covariance: np.ndarray, course: Course) -> np.ndarray:
    """Covariance of the parts' means, (n, n), from that of the blocks' means, (count, count)."""
    if not course.slewing.any():
        return covariance[np.ix_(course.blocks, course.blocks)]
    A = course.averaged()
    return np.asarray(A @ covariance @ A.T)


@lru_cache(maxsize=32)  # megabytes each
def factors(imu: ImuModel, course: Course) -> np.ndarray:
    """Lower Cholesky factors of each channel's covariance of in-run noise, (CHANNELS, n, n)."""
    total = np.repeat(np.square(_LEAST), 3)[:, None, None] * np.eye(len(course.blocks))
    for _, channel, covariance in _within(imu, course):
        total[channel] += covariance
    try:
        return np.linalg.cholesky(total)
    except np.linalg.LinAlgError:
        what = "has noise terms in this window whose sizes differ by more than numbers can hold"
        raise InputError("imu", "its model", "", what) from None
