"""Headings by least squares, plain or weighted by the covariance of the sensor's errors.

This is what the estimators of a resting or turning plate share: how windows become levelled data,
and both ways to a heading that is linear in them.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.stats import chi2

from lbgc.data.windows import Windows
from lbgc.earth import heading_exists
from lbgc.estimators import circle
from lbgc.estimators.block_means import Course, Levelled, Site, levelled
from lbgc.estimators.error_patterns import timeless
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.estimators.information import apart, check_fit, fitted, spread_of
from lbgc.estimators.posterior import likeliest
from lbgc.frames import euler_to_matrix, turned, wrap
from lbgc.sensor.imu import ImuModel

LEANS = np.deg2rad(10.0)
"""Largest lean of a base that is answered, rad."""
_DOUBTED, _CONTRADICTED = 4.0, 5.0
"""Number of sigmas by which a rate's size must differ from Earth's to count as biased: for sigmas
by a window's own scatter, and for those by the sensor's model."""
_EIGHTHS = 8
_RARELY = 1e-7
_SAME_RATE = 1e-6
"""Relative uncertainty of the size of Earth's rate."""


def answer(
    windows: Windows,
    imu: ImuModel | None,
    each: Callable[[Levelled], Estimate],
    name: str,
) -> Estimate:
    """The answers of `each` to groups of windows that share a course, in the windows' order.

    name : the estimator's. Raises InputError where a window cannot be answered, or where the plate
    never rests or turns evenly, or the base leans by more than 10 degrees.
    """
    check(name, windows)
    heading, sigma = np.empty(len(windows)), np.empty(len(windows))
    at_least = False
    when = (None, True) if imu is None else (imu.dt, timeless(imu))
    for part in levelled(windows, *when):
        if not part.course.blocks:
            raise refusal(name, "the plate", "", "never rests or turns steadily in a window")
        if part.tilt.max() > LEANS:
            about = f"of lean; it takes a base within {np.rad2deg(LEANS):g} degrees of level"
            raise refusal(name, f"{np.rad2deg(part.tilt.max()):.3g}", "deg", about)
        found = each(part)
        heading[part.rows], sigma[part.rows] = found.heading, found.sigma
        at_least |= found.at_least
    return Estimate(heading, sigma, at_least)


def check(name: str, windows: Windows, whole: bool = False) -> None:
    """Raise InputError where a window has no heading to find, or no accelerometer to level by.
    whole : whether it must be recorded throughout."""
    if not heading_exists(windows.latitude).all():
        raise refusal(name, "a pole", "", "has no north: Earth's rate is vertical there")
    if not np.fmax.reduce(np.abs(windows.accel), axis=None, initial=0.0) > 0:
        raise refusal(name, "accel", "", "is zero throughout: without accelerometers nothing is "
                      "level")  # fmt: skip
    if whole and windows.unrecorded.any():
        raise refusal(name, "a window", "", "holds a time in which nothing was recorded")


def needs_model(name: str, imu: ImuModel | None) -> ImuModel:
    """The sensor's model. Raises InputError for the estimator `name` where it is not known."""
    if imu is None:
        raise refusal(name, "imu", "", "is not known: weighting needs the sensor's noise model; "
                      "give one of conf/imu, or fit yours (python lbgc/fit.py)")  # fmt: skip
    return imu


def turn(course: Course, site: Site) -> np.ndarray:
    """Design matrix, (4, n, 4), of data in level axes that turn with the plate, by q = (cos psi,
    sin psi) and the tilt t that levelling left (small, unknown, and constant in the base's axes):

        rate_k  = Omega cos(lat) R(theta_k) q - Omega sin(lat) P(theta_k) t
        force_k =                                          -g  P(theta_k) t
        R = [[cos, -sin], [-sin, -cos]],   P = [[cos, sin], [-sin, cos]]
    """
    c, s, none = course.c, course.s, np.zeros(len(course.blocks))
    R = np.array([[c, -s], [-s, -c]])
    P = np.array([[c, s], [-s, c]])
    rows = [
        [*(site.north * R[axis]), *(site.down * P[axis])] for axis in (0, 1)
    ] + [[none, none, *(-site.gravity * P[axis])] for axis in (0, 1)]  # fmt: skip
    return np.moveaxis(np.array(rows), 1, 2)


@lru_cache(maxsize=64)
def plain_weights(course: Course, site: Site, bias: bool) -> np.ndarray:
    """Least-squares weights, (2, 4, n), that make (cos psi, sin psi) of the levelled data.

    The rates are levelled by the mean force in the base's axes, rate - force Omega sin(lat)/g,
    and fitted by amplitudes along and across (Tian 2020's cosine) and, if asked for, a bias an
    axis. An amplitude that is free takes the scale factor out of the heading.
    """
    design = turn(course, site)
    n = design.shape[1]
    columns = 4 if bias else 2
    full = np.zeros((2, n, columns))
    full[..., :2] = design[:2, :, :2]
    if bias:
        full[0, :, 2] = full[1, :, 3] = 1.0
    fit = np.linalg.pinv(full.reshape(2 * n, columns))[:2].reshape(2, 2, n)
    weights = np.zeros((2, 4, n))
    weights[:, :2] = fit
    tilts = design[2:, :, 2:]  # force = tilts x t, whose least squares is the mean in base axes
    tilt = np.linalg.pinv(tilts.reshape(2 * n, 2)).reshape(2, 2, n)
    of_tilt = np.einsum("ian,anj->ij", fit, design[:2, :, 2:])
    weights[:, 2:] = -np.einsum("ij,jan->ian", of_tilt, tilt)
    return weights


def plain(part: Levelled, bias: bool, imu: ImuModel | None, bias_sigma: float = 0.0) -> Estimate:
    """The heading by `plain_weights` on a plate about down, and its sigma on the circle.

    The linear forms measure a rate whose size is known. Their covariance is that of the sensor's
    errors where its model is known. Else it is that of white noise as large as the residuals show,
    and the sigma is a lower bound unless a bias is stated.

    bias_sigma : rad/s, 1 sigma of each gyro's bias where nothing else is said of the sensor.
    """
    weights = plain_weights(part.course, part.site, bias)
    z = np.einsum("ian,van->vi", weights, part.data)
    heading = np.arctan2(z[:, 1], z[:, 0])
    if imu is not None:
        leans, which = apart(part.base)
        each = [
            _plain_covariance(imu, part.course, part.site, bias, *lean) for lean in leans.tolist()
        ]
        spread = each[0] if len(each) == 1 else np.stack(each)[which]
    else:
        spread = _block_variance(part, bias, weights, z)[:, None, None] * _unit_covariance(weights)
        if not bias:
            spread = spread + (bias_sigma / part.site.north) ** 2 * np.eye(2)
    spread = spread + _motion_covariance(part, bias, imu, weights, z)
    spread = widened(z, spread, known=imu is not None)
    sigma = circle.posterior(*circle.measured(z, spread), heading).sigma
    return Estimate(wrap(heading), sigma, imu is None and bias_sigma == 0.0)


def widened(z: np.ndarray, spread: np.ndarray, known: bool) -> np.ndarray:
    """Covariance, (V, 2, 2), of measurements z, (V, 2), of q, widened where they contradict it.

    Where their length differs from one by more than some sigmas, an error as large as that
    difference is added in all directions. known : whether the covariance is the sensor's model's.
    """
    sigmas = _CONTRADICTED if known else _DOUBTED
    length = np.linalg.norm(z, axis=1)
    n = z / np.maximum(length, 1e-300)[:, None]
    radial = np.sum((n[:, None] @ spread)[:, 0] * n, axis=1)
    off = (length - 1) ** 2
    more = np.where(off > sigmas**2 * radial + _SAME_RATE**2, off, 0.0)
    return np.asarray(spread + more[:, None, None] * np.eye(2))


@lru_cache(maxsize=4096)  # of a log's windows each has a course of its own
def _plain_covariance(
    imu: ImuModel, course: Course, site: Site, bias: bool, roll: float, pitch: float
) -> np.ndarray:
    """Covariance, (2, 2), of what the plain weights make of the sensor's errors, on a base that
    leans by roll and pitch, rad. On a lean, levelling takes part of the vertical gyro's errors into
    the horizontal rates."""
    return _covariance_of_forms(imu, course, site, plain_weights(course, site, bias), roll, pitch)


def _covariance_of_forms(
    imu: ImuModel, course: Course, site: Site, weights: np.ndarray, roll: float, pitch: float
) -> np.ndarray:
    """Covariance, (k, k), of what weights (k, 4, n) of the levelled data make of the sensor's
    errors, on a base that leans by roll and pitch, rad."""
    count = len(weights)
    weights = weights.reshape(count, 2, 2, -1)  # of triad, axis, part
    vectors = np.moveaxis(np.pad(weights, ((0, 0), (0, 0), (0, 1), (0, 0))), 2, 3)
    angle = np.array(course.angle)
    base_axes = turned(vectors, angle) @ euler_to_matrix(roll, pitch, 0.0)
    body = np.moveaxis(turned(base_axes, -angle), 3, 2).reshape(count, 6, -1)
    return spread_of(imu, course, site, body, (roll, pitch))


def _block_variance(part: Levelled, bias: bool, weights: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Variance of a block's rate, (V,), (rad/s)^2, by the fit's residuals, if every block has an
    independent error; NaN where no degree of freedom is left."""
    left = _residuals(part, bias, z)
    n = left.shape[2]
    free = 2 * n - 2 - 2 * bias
    return np.sum(left**2, axis=(1, 2)) / free if free > 0 else np.full(len(z), np.nan)


def _residuals(part: Levelled, bias: bool, z: np.ndarray) -> np.ndarray:
    """Residuals of the rates, (V, 2, n), rad/s."""
    rates = turn(part.course, part.site)[:2, :, :2]
    left = part.data[:, :2] - np.einsum("ani,vi->van", rates, z)
    return np.asarray(left - left.mean(axis=2, keepdims=True) if bias else left)


def _motion_covariance(
    part: Levelled, bias: bool, imu: ImuModel | None, weights: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """Covariance of the measurements, (V, 2, 2), that the base's own motion adds.

    It is zero where the model explains what is seen. Where residuals averaged over eighths of the
    window scatter far more than the sensor's model says, it is that of white noise of such scatter.
    A base that sways about one attitude averages out faster; one that turns on does not.
    """
    summed, free = groups(part.data.shape[2]), degrees(part.data.shape[2], bias)
    if imu is None or free <= 0:
        return np.zeros((len(z), 2, 2))
    seen = np.sum((_residuals(part, bias, z) @ summed.T) ** 2, axis=(1, 2))
    leans, which = apart(part.base)
    most = np.array(
        [_largest_explained(imu, part.course, part.site, bias, *a) for a in leans.tolist()]
    )
    white = np.where(seen > most[which], seen / free, 0.0)
    return np.asarray(white[:, None, None] * _unit_covariance(weights))


def groups(n: int) -> np.ndarray:
    """Matrix, (m, n), that sums n parts within m <= 8 consecutive groups, each divided by the root
    of its number, so that independent errors keep their variance."""
    of = np.array_split(np.arange(n), min(n, _EIGHTHS))
    matrix = np.zeros((len(of), n))
    for row, own in zip(matrix, of, strict=True):
        row[own] = 1 / np.sqrt(len(own))
    return matrix


def degrees(n: int, bias: bool) -> int:
    """Degrees of freedom that the fit leaves to grouped residuals of n parts."""
    return 2 * min(n, _EIGHTHS) - 2 - 2 * bias


@lru_cache(maxsize=4096)
def _largest_explained(
    imu: ImuModel, course: Course, site: Site, bias: bool, roll: float, pitch: float
) -> float:
    """The sum of squares of grouped residuals, (rad/s)^2, that the sensor's model rarely
    exceeds."""
    n = len(course.blocks)
    weights = plain_weights(course, site, bias)
    left = np.zeros((2, n, 4, n))
    left[0, :, 0], left[1, :, 1] = np.eye(n), np.eye(n)
    left -= np.einsum("ani,ibm->anbm", turn(course, site)[:2, :, :2], weights)
    if bias:
        left -= left.mean(axis=1, keepdims=True)
    grouped = np.einsum("gn,anbm->agbm", groups(n), left, optimize=True).reshape(-1, 4, n)
    return explained(_covariance_of_forms(imu, course, site, grouped, roll, pitch))


def explained(C: np.ndarray) -> float:
    """The sum of squares of residuals of covariance C, (k, k), that is exceeded once in 1e7: by
    Satterthwaite's chi-square, which has the sum's own mean and variance."""
    mean, square = float(np.trace(C)), float(np.sum(C**2))
    free = mean**2 / square
    return float(mean / free * chi2.isf(_RARELY, free))


def _unit_covariance(weights: np.ndarray) -> np.ndarray:
    """Covariance, (2, 2), of what the weights make of rates whose errors are independent and of
    variance one."""
    return np.asarray(np.einsum("ian,jan->ij", weights[:, :2], weights[:, :2]))


def weighted(name: str, part: Levelled, imu: ImuModel, free_bias: bool, checked: bool) -> Estimate:
    """The most likely heading under the covariance of the sensor's errors. If `checked`, raises
    InputError where the data contradict it. free_bias : see `lbgc.estimators.information`; name :
    the estimator's."""
    found = fitted(imu, part, free_bias)
    if checked:
        check_fit(name, part.course, found.misfit)
    return likeliest(found.h, found.J)
