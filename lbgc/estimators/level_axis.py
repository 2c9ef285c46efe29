"""Headings by plain least squares on a plate that turns about a level axis, or about down.

About a level axis the gyro along it feels the same part of Earth's rate at every angle of the
plate, and its bias besides; the rates across the axis turn. With T_k the mean of exp(i plate's
angle) over part k, and w and b Earth's rate and the biases across the axis as complex numbers,

    rate_k = conj(T_k) w + b + noise

So w follows by least squares without the biases, which are half the difference of two positions
half a turn apart, and the part along the axis is the mean. Levelled, they measure q = (cos psi,
sin psi) through errors of covariance S, which along the axis has the gyro's bias. The heading is
the most likely one under S (lbgc.estimators.circle). Where the bias along the axis is larger than
Earth's rate, a heading and its mirror image in the axis' vertical plane are equally likely: sigma
then says so.
"""

from functools import lru_cache

import numpy as np

from lbgc.estimators import circle, least_squares
from lbgc.estimators.block_means import Course, Levelled, Site
from lbgc.estimators.estimate import Estimate
from lbgc.estimators.information import apart, spread_of
from lbgc.estimators.least_squares import degrees, explained, groups, widened
from lbgc.frames import DOWN, across, euler_to_matrix
from lbgc.sensor.imu import ImuModel


@lru_cache(maxsize=64)
def _fit(course: Course, bias: bool) -> tuple[np.ndarray, np.ndarray]:
    """The weights, complex (n,), that make w of the rates across the axis, and the matrix, complex
    (n, n), that leaves the residuals of these. bias : whether b is free, or zero."""
    columns = np.conj(np.array(course.turned, complex))[:, None]
    if bias:
        columns = np.concatenate([columns, np.ones_like(columns)], axis=1)
    fit = np.linalg.pinv(columns)
    return fit[0], np.eye(len(columns)) - columns @ fit


def _real(course: Course, weights: np.ndarray) -> np.ndarray:
    """Complex weights, (*S, n), of what is measured across the axis as real ones, (2, *S, 3, n),
    of the three axes: those of the real part (the first axis across) and of the imaginary one."""
    i, j = across(course.axis)
    found = np.zeros((2, *weights.shape[:-1], 3, weights.shape[-1]))
    found[0, ..., i, :] = found[1, ..., j, :] = weights.real
    found[0, ..., j, :], found[1, ..., i, :] = -weights.imag, weights.imag
    return found


def _in_base(course: Course, bias: bool) -> np.ndarray:
    """Weights, (3, 3, n), that make the mean vector in the base's axes of means in the body's."""
    found = np.zeros((3, 3, len(course.blocks)))
    found[list(across(course.axis))] = _real(course, _fit(course, bias)[0])
    found[course.axis, course.axis] = 1 / len(course.blocks)
    return found


@lru_cache(maxsize=4096)  # of a log's windows each has a course of its own
def _weights(course: Course, site: Site, bias: bool, roll: float, pitch: float) -> np.ndarray:
    """Weights, (2, 6, n), that make (cos psi, sin psi) of means in the body's axes, on a base that
    leans by roll and pitch, rad. The forces make no part of it but errors: they are level, since
    the lean is theirs, and an error of the level takes a part of Earth's vertical rate along."""
    to_q = np.diag([1.0, -1.0, 0.0])[:2] @ euler_to_matrix(roll, pitch, 0.0) / site.north
    rates, forces = (to_q @ _in_base(course, own).reshape(3, -1) for own in (bias, False))
    both = [rates, site.down / site.gravity * forces]
    return np.concatenate([own.reshape(2, 3, -1) for own in both], axis=1)


@lru_cache(maxsize=4096)
def _covariance(
    imu: ImuModel, course: Course, site: Site, bias: bool, roll: float, pitch: float
) -> np.ndarray:
    """Covariance, (2, 2), of what the weights make of the sensor's errors."""
    lean = (roll, pitch)
    return spread_of(imu, course, site, _weights(course, site, bias, *lean), lean)


def _residual_forms(course: Course, bias: bool) -> tuple[np.ndarray, np.ndarray]:
    """The linear forms, (k, 6, n) each, of means in the body's axes that are the fit's residuals
    summed in groups: across the axis, and along it."""
    sums = groups(len(course.blocks))
    two = _real(course, sums @ _fit(course, bias)[1]).reshape(-1, 3, sums.shape[1])
    one = np.zeros((len(sums), 3, sums.shape[1]))
    one[:, course.axis] = sums - sums.mean(axis=1, keepdims=True)
    across_it, along_it = (np.concatenate([own, 0 * own], axis=1) for own in (two, one))
    return across_it, along_it


@lru_cache(maxsize=4096)
def _most(
    imu: ImuModel, course: Course, site: Site, bias: bool, roll: float, pitch: float
) -> tuple[float, ...]:
    """The sums of squares of either residuals, (rad/s)^2, that the sensor's model rarely
    exceeds."""
    forms = _residual_forms(course, bias)
    return tuple(explained(spread_of(imu, course, site, own, (roll, pitch))) for own in forms)


def _motion(
    part: Levelled,
    bias: bool,
    own: list[tuple[ImuModel, Course, Site, bool, float, float]],
    which: np.ndarray,
) -> np.ndarray:
    """Variance of a block's rate, (V,), (rad/s)^2, that the base's own motion adds: zero where the
    model explains the residuals, else that of white noise that scatters as the largest of them
    do. own : the arguments of `_most`, of each lean; which : (V,), the window's own among them."""
    n, found = part.body.shape[2], np.zeros(len(part.body))
    free = degrees(n, bias), degrees(n, False) // 2
    if min(free) <= 0:
        return found
    most = np.array([_most(*lean) for lean in own])[which]
    forms = _residual_forms(part.course, bias)
    seen = np.stack([np.sum(np.einsum("kcn,vcn->vk", f, part.body) ** 2, axis=1) for f in forms], 1)
    moves = (seen > most).any(axis=1)
    return np.where(moves, (seen / free).max(axis=1), 0.0)


def plain(part: Levelled, bias: bool, imu: ImuModel | None, bias_sigma: float = 0.0) -> Estimate:
    """The heading by least squares, and its sigma on the circle.

    bias : whether each gyro's bias is free, but for the gyro's along a level axis; imu : without
    it, sigma is by the residuals, and a lower bound unless a bias is stated; bias_sigma : rad/s,
    1 sigma of each gyro's bias where nothing else is said of the sensor.
    """
    course, site = part.course, part.site
    if course.axis == DOWN:
        return least_squares.plain(part, bias, imu, bias_sigma)
    rate = np.einsum("cdn,vdn->vc", _in_base(course, bias), part.body[:, :3])
    z = np.einsum("vij,vj->vi", part.base, rate)[:, :2] * [1, -1] / site.north
    level = _weights(course, site, bias, 0.0, 0.0)
    unit = np.einsum("ian,jan->ij", level[:, :3], level[:, :3])
    if imu is None:
        i, j = across(course.axis)
        left = (part.body[:, i] + 1j * part.body[:, j]) @ _fit(course, bias)[1].T
        whole = 2 * left.shape[1] - 2 - 2 * bias
        square = np.sum(np.abs(left) ** 2, axis=1) / whole if whole > 0 else np.full(len(z), np.nan)
        spread = square[:, None, None] * unit + (bias_sigma / site.north) ** 2 * np.eye(2)
        spread = widened(z, spread, known=False)
    else:
        leans, which = apart(part.base)
        own = [(imu, course, site, bias, *lean) for lean in leans.tolist()]
        spread = np.stack([_covariance(*lean) for lean in own])[which]
        spread = spread + _motion(part, bias, own, which)[:, None, None] * unit
        spread = widened(z, spread, known=True)
    h, J = circle.measured(z, spread)
    heading = circle.mode(h, J)
    at_least = imu is None and bias_sigma == 0.0
    return Estimate(heading, circle.posterior(h, J, heading).sigma, at_least)
