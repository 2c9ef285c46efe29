"""What block means tell of the heading, when every error is Gaussian: the one linear model that the
weighted estimators answer by, that plain ones take their sigma from, and that the bound is made of.

In level axes that turn with the plate, with q = (cos psi, sin psi), theta the plate's angle and t
the tilt that levelling left (small, unknown, the same in the base's axes all the time),

    rate_k  = Omega cos(lat) R(theta_k) q - Omega sin(lat) P(theta_k) t + errors
    force_k =                                          -g  P(theta_k) t + errors

    R = [[cos, -sin], [-sin, -cos]],   P = [[cos, sin], [-sin, cos]]

so the data d have a mean that is linear in (q, t) and a covariance C that is the sensor's alone.
With D the design, J = D' C^-1 D is the information and h = D' C^-1 d all that the data tell; a flat
prior on t takes it out by the Schur complement. What remains is a 2-vector h and a 2 x 2 matrix J:

    log p(psi | d) = q' h - q' J q / 2 + constant

Gyros' errors: the in-run terms with their exact covariance of block means; biases by lifetime;
misalignment of x and y towards z times the vertical rate (Earth's, and the plate's); scale and
cross-axis errors times the horizontal rate, averaged over headings; g-sensitivity times gravity;
warming up. Accelerometers': the same, and the force of a lever arm of unknown length (0.3 m).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.linalg

from lbgc.estimators.course import Course, Site
from lbgc.estimators.estimate import Estimate
from lbgc.frames import wrap
from lbgc.sensor import gaussian, noise
from lbgc.sensor.imu import ImuModel, Triad

LIFETIMES = ("unit", "session", "run")
AS_LENGTHS = float(np.deg2rad(6.0))
"""Below it angles behave like lengths."""
_LEVER_M = 0.3
_LEAST = (1e-12, 1e-9)
"""rad/s and m/s^2: sensors without any error have no covariance to invert; far below all others."""


def known(imu: ImuModel, lifetimes: tuple[str, ...]) -> ImuModel:
    """The sensor when everything that lasts that long has been calibrated away."""
    none = (0.0, 0.0, 0.0)
    gone: dict[str, Any] = {f"bias_{name}": none for name in lifetimes}
    if "unit" in lifetimes:
        of_unit = ("scale_unit", "misalignment_unit", "g_sensitivity", "bias_per_k", "scale_per_k")
        gone |= dict.fromkeys(of_unit, none)
    return replace(imu, gyro=replace(imu.gyro, **gone), accel=replace(imu.accel, **gone))


def sources(imu: ImuModel, course: Course, site: Site) -> dict[str, np.ndarray]:
    """Covariance of the data by what causes it, each (4, n, n): the channels are independent of
    each other. (rad/s)^2 for the first two, (m/s^2)^2 for the others."""
    gyro, accel = _by_triad(imu, course, site)
    n = len(course.blocks)
    every = {name: np.zeros((4, n, n)) for name in (*gyro, *(f"accelerometer {a}" for a in accel))}
    for name, covariance in gyro.items():
        every[name][:2] = covariance
    for name, covariance in accel.items():
        every[f"accelerometer {name}"][2:] = covariance
    return every


def _by_triad(
    imu: ImuModel, course: Course, site: Site
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Of the gyros and of the accelerometers, (2, n, n) each."""
    rate = np.array(course.rate)
    gyro = _triad_sources(imu, imu.gyro, course, site.down + rate, site.north, site.gravity)
    accel = _triad_sources(imu, imu.accel, course, -site.gravity + 0 * rate, 0.0, 0.0)
    accel["lever arm"] = _LEVER_M**2 * _constant(rate**2)
    return gyro, accel


def _constant(pattern: np.ndarray) -> np.ndarray:
    """Of one unknown figure times a known pattern (n,): (2, n, n)."""
    one = np.outer(pattern, pattern)
    return np.stack([one, one])


def _triad_sources(
    imu: ImuModel, triad: Triad, course: Course, vertical: np.ndarray, north: float, g: float
) -> dict[str, np.ndarray]:
    """Of the x and y axes, (2, n, n) each. vertical : (n,), what the z axis feels."""
    n = len(course.blocks)
    one, angle = np.ones(n), np.array(course.angle)

    def scaled(sizes: tuple[float, ...], pattern: np.ndarray) -> np.ndarray:
        return np.array(sizes[:2])[:, None, None] ** 2 * _constant(pattern)

    found = {f"bias of the {name}": scaled(getattr(triad, f"bias_{name}"), one)
             for name in LIFETIMES}  # fmt: skip
    across = north**2 / 2 * np.cos(np.subtract.outer(angle, angle))  # averaged over headings
    errors = np.square(triad.scale_unit[:2]) + np.square(triad.misalignment_unit[:2])
    found["scale and misalignment"] = (
        scaled(triad.misalignment_unit, vertical) + errors[:, None, None] * across
    )
    found["g-sensitivity"] = scaled(triad.g_sensitivity, g * one)
    last = course.start + course.blocks[-1] + 1
    warmth = imu.warming.rise(last, course.interval)[course.start + np.array(course.blocks)]
    found["warming up"] = scaled(triad.bias_per_k, warmth)
    names = {noise.White: "white noise", noise.BandLimited: "white noise",
             noise.Flicker: "bias instability", noise.RandomWalk: "random walk"}  # fmt: skip
    for axis in (0, 1):
        for term in triad.terms[axis]:
            name = names.get(type(term), "other noise")
            found.setdefault(name, np.zeros((2, n, n)))[axis] += _of_term(term, course)
        other = found.setdefault("other noise", np.zeros((2, n, n)))
        other[axis] += _not_gaussian(imu, triad, axis, course)
    return found


@lru_cache(maxsize=16)  # as many as one course's axes share; each may have half a megabyte
def _of_term(term: gaussian.GaussianTerm, course: Course) -> np.ndarray:
    blocks = np.array(course.blocks)
    whole = gaussian.covariance_of_means((term,), blocks[-1] + 1, course.interval, 1, course.start)
    return whole[np.ix_(blocks, blocks)]


def _not_gaussian(imu: ImuModel, triad: Triad, axis: int, course: Course) -> np.ndarray:
    """Of tone, ramp and counting, by their second moments."""
    blocks = course.start + np.array(course.blocks)
    count, n = blocks[-1] + 1, len(blocks)
    covariance = np.zeros((n, n))
    if triad.tone[axis] > 0:
        lag = np.subtract.outer(blocks, blocks) * course.interval
        tone = triad.tone_of(axis)
        power = (tone.amplitude * np.sinc(tone.f * course.interval)) ** 2 / 2
        covariance += power * np.cos(2 * np.pi * tone.f * lag)
    if triad.R[axis] > 0:
        ramp = noise.Ramp(triad.R[axis]).with_sign(np.ones(()), count, course.interval)[blocks]
        covariance += np.outer(ramp, ramp)
    if triad.carried_lsb is not None:
        covariance += _of_term(noise.AngleQuantisation(triad.carried_lsb / np.sqrt(12)), course)
    elif triad.lsb is not None:
        covariance += np.eye(n) * triad.lsb**2 * imu.dt / (12 * course.interval)
    return covariance


@lru_cache(maxsize=64)
def covariance(imu: ImuModel, course: Course, site: Site) -> np.ndarray:
    """Of the data, (4, n, n)."""
    n = len(course.blocks)
    total = np.repeat(np.square(_LEAST), 2)[:, None, None] * np.eye(n)
    for rows, found in zip((slice(2), slice(2, 4)), _by_triad(imu, course, site), strict=True):
        for source in found.values():
            total[rows] += source
    return total


def turn(course: Course, site: Site) -> np.ndarray:
    """Design of the data, (4, n, 4), for (q, t): see the module."""
    c, s, none = course.c, course.s, np.zeros(len(course.blocks))
    R = np.array([[c, -s], [-s, -c]])
    P = np.array([[c, s], [-s, c]])
    rows = [
        [*(site.north * R[axis]), *(site.down * P[axis])] for axis in (0, 1)
    ] + [[none, none, *(-site.gravity * P[axis])] for axis in (0, 1)]  # fmt: skip
    return np.moveaxis(np.array(rows), 1, 2)


def along(heading: np.ndarray) -> np.ndarray:
    """q, (*S, 2)."""
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def across(heading: np.ndarray) -> np.ndarray:
    """dq/dpsi, (*S, 2)."""
    return np.stack([-np.sin(heading), np.cos(heading)], axis=-1)


@dataclass(frozen=True, eq=False)
class Information:
    """What data (V, 4, n) tell: h = sum of weights x data, and J."""

    weights: np.ndarray
    """(2, 4, n)"""
    J: np.ndarray
    """(2, 2)"""

    def told(self, data: np.ndarray) -> np.ndarray:
        """h, (V, 2)."""
        return np.einsum("ian,van->vi", self.weights, data)

    def sigma(self, heading: np.ndarray) -> np.ndarray:
        """Of a heading, rad, when errors are small: 1/sqrt(n' J n), n across it."""
        n = across(heading)
        return 1 / np.sqrt(np.einsum("...i,ij,...j->...", n, self.J, n))


@lru_cache(maxsize=64)
def information(imu: ImuModel, course: Course, site: Site, free_bias: bool = False) -> Information:
    """Of all blocks of the course. free_bias : with a constant of unknown size on each gyro, which
    is what an estimator assumes that is not told how large a bias can be."""
    design, C = turn(course, site), covariance(imu, course, site)
    n, columns = len(course.blocks), 6 if free_bias else 4
    full = np.zeros((4, n, columns))
    full[..., :4] = design
    if free_bias:
        full[0, :, 4] = full[1, :, 5] = 1.0
    weights, J = np.zeros((columns, 4, n)), np.zeros((columns, columns))
    for channel in range(4):
        factor = scipy.linalg.cho_factor(C[channel], lower=True)
        weights[:, channel] = scipy.linalg.cho_solve(factor, full[channel]).T
        J += weights[:, channel] @ full[channel]
    nuisance = slice(2, columns)
    # scaled, since tilts and rates differ by five orders of magnitude
    size = np.sqrt(np.diag(J))
    out = np.linalg.solve((J / np.outer(size, size))[nuisance, nuisance],
                          (J[:2, nuisance] / size[nuisance]).T).T / size[nuisance]  # fmt: skip
    reduced = weights[:2] - np.tensordot(out, weights[nuisance], axes=1)
    J = J[:2, :2] - out @ J[nuisance, :2]
    return Information(reduced, (J + J.T) / 2)


_GRID = np.linspace(-np.pi, np.pi, 180, endpoint=False)
_NARROW = np.deg2rad(3.0)
_NODES = 240
"""Of the posterior: half a width apart on the circle where it is wider than 3 degrees, closer where
it is narrow; the sum's error is of the order of exp(-2 pi^2 (width/step)^2)."""
_CHUNK = 4096  # headings on grids at once


def mode(h: np.ndarray, J: np.ndarray) -> np.ndarray:
    """The heading of the largest log p, (V,): on a grid, then Newton's steps. J : (2, 2), or
    (V, 2, 2) for one a window."""
    return _in_chunks(_mode, h, J)[0]


def _in_chunks(
    each: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]], h: np.ndarray, J: np.ndarray
) -> tuple[np.ndarray, ...]:
    J = J.reshape(-1, 2, 2)  # one for all stays one: what follows from it alone is worked out once
    chunks = [slice(i, i + _CHUNK) for i in range(0, len(h), _CHUNK)]
    parts = [each(h[rows], J if len(J) == 1 else J[rows]) for rows in chunks]
    return tuple(np.concatenate(p) for p in zip(*parts, strict=True))


def _mode(h: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, ...]:
    psi = _GRID[np.argmax(_log_p(h, J, _GRID[None]), axis=1)]
    for _ in range(6):
        q, n = along(psi), across(psi)
        slope = np.sum(n * (h - _along(q, J)), axis=1)
        curvature = np.sum(q * (h - _along(q, J)), axis=1) + np.sum(_along(n, J) * n, axis=1)
        psi = psi + np.clip(slope / np.maximum(curvature, 1e-30), -0.01, 0.01)
    return (wrap(psi),)


def _along(q: np.ndarray, J: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...ij->...j", q, J)


def _log_p(h: np.ndarray, J: np.ndarray, psi: np.ndarray) -> np.ndarray:
    """psi : (V, G), or (1, G) for all alike; J likewise."""
    c, s = np.cos(psi), np.sin(psi)
    xx, xy, yy = (J[..., i, j, None] for i, j in ((0, 0), (0, 1), (1, 1)))
    quadratic = xx * c * c + 2 * xy * c * s + yy * s * s
    linear = h @ np.concatenate([c, s]) if len(psi) == 1 else h[:, :1] * c + h[:, 1:] * s
    return linear - quadratic / 2


def likeliest(told: Information, data: np.ndarray) -> Estimate:
    """The most likely headings, and their sigma by the curvature there; by the posterior's spread
    on the circle where that is above 6 degrees. data : (V, 4, n)."""
    h = told.told(data)
    heading = mode(h, told.J)
    sigma = told.sigma(heading)
    wide = sigma > AS_LENGTHS
    if wide.any():
        sigma[wide] = bayes(h[wide], told.J).sigma
    return Estimate(heading, sigma)


def bayes(h: np.ndarray, J: np.ndarray) -> Estimate:
    """The Bayes-optimal estimate: with a flat prior on the circle the posterior's circular mean,
    which minimises the mean of 1 - cos(error); and the posterior's RMS error about it."""
    heading, sigma = _in_chunks(_bayes, h, J)
    return Estimate(heading, sigma)


def _bayes(h: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, ...]:
    (at,) = _mode(h, J)
    n = across(at)
    width = 1 / np.sqrt(np.maximum(np.sum(_along(n, J) * n, axis=1), 1e-30))
    narrow = width < _NARROW  # all of it within nine widths, which a grid of the circle would miss
    spread = np.where(narrow, 9 * width, np.pi)
    steps = 2 * (np.arange(_NODES) + 0.5) / _NODES - 1
    psi = at[:, None] + spread[:, None] * steps
    log_p = _log_p(h, J, psi)
    p = np.exp(log_p - log_p.max(axis=1, keepdims=True))
    p /= p.sum(axis=1, keepdims=True)
    off = psi - at[:, None]
    mean = np.arctan2(np.sum(p * np.sin(off), axis=1), np.sum(p * np.cos(off), axis=1))
    sigma = np.sqrt(np.sum(p * wrap(off - mean[:, None]) ** 2, axis=1))
    return wrap(at + mean), sigma
