"""The information on the heading in means in the body's axes, when every error is Gaussian: the
floor, `gls`, the weighted estimators and the bound are made of it.

With q = (cos psi, sin psi) the data d of the six channels (see lbgc.estimators.error_patterns) are

    d = S q + known + T t + U e + in-run noise of covariance C,    e standard normal

t the level's error about the accelerometers' level, of any size, U the causes that are drawn once.
C is one matrix a channel and the same for all windows of a course; S, T and U are coefficients of
nine patterns. So each channel's patterns B, whitened by C's Cholesky factor L, are split once:
L^-1 B = Q R. All that the data tell of q is then in y = Q' L^-1 d, nine figures a channel, and with
N = [T U], whitened likewise, t and e are taken out by least squares on [N; 1]. What remains are the
information vector h and the information matrix J, with

    log p(psi | d) = q' h - q' J q / 2 + constant
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg
from scipy.stats import chi2

from lbgc.estimators.block_means import Course, Levelled, Site
from lbgc.estimators.error_patterns import (
    ANY_TILT,
    CHANNELS,
    PATTERNS,
    causes,
    factors,
    free_bias,
    patterns,
    signal,
    within,
)
from lbgc.estimators.estimate import refusal
from lbgc.estimators.posterior import across
from lbgc.frames import euler_to_matrix
from lbgc.sensor.imu import ImuModel

LEVEL = np.eye(3)[None]
_FINE, _COARSE = np.deg2rad(0.02), np.deg2rad(0.1)
_LEANS = np.deg2rad(0.5)
"""Leans are rounded to the first step, those below half a degree to the second; what rounding
leaves is part of the level's error, which is unknown anyway."""
_CHUNK = 256  # leans at once
_MANY = 5.0  # standard deviations of chi-square, beyond which slews do not fit
_TWICE, _RARELY = 2.0, 1e-8  # scatter over the model's, and the chance of a scatter, to refuse at


@dataclass(frozen=True, eq=False)
class Whitened:
    """A course's patterns, whitened by the covariance of a sensor's in-run noise."""

    unexplained: np.ndarray
    """(CHANNELS, n, n), (1 - Q Q') L^-1: what no pattern explains of the whitened data, with L the
    lower Cholesky factor of C and Q, (n, PATTERNS), orthonormal"""
    R: np.ndarray
    """(CHANNELS, PATTERNS, PATTERNS), upper triangular"""
    reduce: np.ndarray
    """(CHANNELS, PATTERNS, n), Q' L^-1"""

    def told(self, body: np.ndarray) -> np.ndarray:
        """The reduced data y, (V, CHANNELS PATTERNS), of data body, (V, CHANNELS, n)."""
        return np.asarray(
            np.einsum("can,vcn->vca", self.reduce, body, optimize=True).reshape(len(body), -1)
        )

    def columns(self, coefficients: np.ndarray) -> np.ndarray:
        """The share in y, (*S, CHANNELS PATTERNS), of data that are patterns times these
        coefficients, (*S, CHANNELS, PATTERNS)."""
        found = np.einsum("cab,...cb->...ca", self.R, coefficients)
        return np.asarray(found.reshape(*found.shape[:-2], -1))

    def beside(self, body: np.ndarray) -> np.ndarray:
        """Sum of squares, (V,), of the whitened data's part that no pattern explains.
        body : (V, CHANNELS, n)."""
        left = body.swapaxes(0, 1) @ self.unexplained.swapaxes(1, 2)
        return np.asarray(np.einsum("cvn,cvn->v", left, left))


@lru_cache(maxsize=32)  # megabytes each
def whitened(imu: ImuModel, course: Course) -> Whitened:
    """The patterns of a course, whitened by the in-run noise of a sensor; computed once each."""
    factor, B = factors(imu, course), patterns(imu, course)
    n, k = len(B), min(len(B), PATTERNS)
    unexplained, R = np.empty((CHANNELS, n, n)), np.zeros((CHANNELS, PATTERNS, PATTERNS))
    reduce = np.zeros((CHANNELS, PATTERNS, n))
    for channel, L in enumerate(factor):
        by = scipy.linalg.solve_triangular(L, np.eye(n), lower=True)
        Q, R[channel, :k] = np.linalg.qr(by @ B)
        reduce[channel, :k] = Q.T @ by
        unexplained[channel] = by - Q @ reduce[channel, :k]
    return Whitened(unexplained, R, reduce)


@dataclass(frozen=True, eq=False)
class Information:
    """The information on q in a course, for G leans of the base: h = weights (y - known), and J."""

    J: np.ndarray
    """(G, 2, 2), the information matrix"""
    weights: np.ndarray
    """(G, 2, CHANNELS PATTERNS), by which y less its known part makes h"""
    known: np.ndarray
    """(G, CHANNELS PATTERNS), the part of y that does not depend on the heading"""
    taken: np.ndarray
    """(G, CHANNELS PATTERNS, r), orthonormal: the part of y that t and e explain"""

    def sigma(self, heading: np.ndarray) -> np.ndarray:
        """Standard deviation, (V,), rad, of headings, (V,), rad, when errors are small:
        1/sqrt(n' J n), n = dq/dpsi; each under its own lean, or all under the only one."""
        n = across(heading)
        return np.asarray(1 / np.sqrt(np.sum(np.sum(n[..., None] * self.J, axis=-2) * n, axis=-1)))


def _information(
    imu: ImuModel, course: Course, site: Site, base: np.ndarray, free: bool
) -> Information:
    """The information on q on bases whose attitudes L are base, (G, 3, 3); free : whether each
    gyro's bias is of unknown size."""
    white, felt = whitened(imu, course), signal(base, site, course.axis)
    drawn = np.concatenate(list(causes(imu, base, site, course.axis).values()), axis=1)
    if free:
        any_bias = np.repeat(free_bias(course.axis), len(base), axis=0)
        drawn = np.concatenate([drawn, any_bias], axis=1)
    tilt = ANY_TILT * np.stack(felt.tilt, axis=1)
    N = white.columns(np.concatenate([tilt, drawn], axis=1))
    N = np.swapaxes(N[:, (N != 0).any(axis=(0, 2))], 1, 2)
    S = np.swapaxes(white.columns(np.stack(felt.q, axis=1)), 1, 2)
    m, r = N.shape[1:]
    ones = np.broadcast_to(np.eye(r), (len(N), r, r))
    taken = np.linalg.qr(np.concatenate([N, ones], axis=1))[0]
    left = np.pad(S, ((0, 0), (0, r), (0, 0)))
    left = left - taken @ (np.swapaxes(taken[:, :m], 1, 2) @ S)
    J = np.swapaxes(left, 1, 2) @ left
    return Information(J, np.swapaxes(left[:, :m], 1, 2), white.columns(felt.known), taken[:, :m])


@lru_cache(maxsize=64)
def information(
    imu: ImuModel,
    course: Course,
    site: Site,
    free_bias: bool = False,
    lean: tuple[float, float] = (0.0, 0.0),
) -> Information:
    """The information on q in a whole course on a base that leans by roll and pitch, rad.

    free_bias : with a bias of unknown size on each gyro that the plate frees of it, as an estimator
    assumes that is not told how large a bias can be.
    """
    base = euler_to_matrix(*lean, 0.0)[None]
    return _information(imu, course, site, base, free_bias)


@dataclass(frozen=True, eq=False)
class Told:
    """What the data of V windows tell of q, and how well the sensor's model fits them."""

    h: np.ndarray
    """(V, 2), the information vectors"""
    J: np.ndarray
    """(V, 2, 2), the information matrices, or (1, 2, 2) where one serves all windows"""
    misfit: np.ndarray
    """(V,): mean of the normalised squares that the best q, level and causes leave; 1 where the
    sensor's model is right. NaN where it was not asked for, or no data are left for it"""


def told(imu: ImuModel, part: Levelled, free_bias: bool = False, check: bool = False) -> Told:
    """What windows that share a course tell of q. free_bias : as for `information`; check : whether
    the misfit is asked for."""
    white = whitened(imu, part.course)
    leans, which = apart(part.base)
    if len(leans) == 1:
        lean = (float(leans[0, 0]), float(leans[0, 1]))
        every = information(imu, part.course, part.site, free_bias, lean)
    else:
        every = _information_by_lean(imu, part, leans, free_bias)
    y = white.told(part.body) - every.known[which]
    h = np.einsum("via,va->vi", every.weights[which], y)
    J = every.J if len(leans) == 1 else every.J[which]
    misfit, free = np.full(len(y), np.nan), degrees(part.course)
    if check and free > 0:
        left = np.sum(y**2, axis=1) - np.sum(
            np.einsum("var,va->vr", every.taken[which], y) ** 2, axis=1
        )
        left -= np.einsum("vi,vij,vj->v", h, np.linalg.pinv(every.J, hermitian=True)[which], h)
        misfit = (white.beside(part.body) + left) / free
    return Told(h, J, misfit)


def fitted(imu: ImuModel, part: Levelled, free_bias: bool = False) -> Told:
    """What windows tell of q, each with its slews where these fit the sensor's model.

    Where they do not (an axis that wobbles, an encoder that lags), that window's other parts alone
    are used. For a sensor that is stated without noise, each window's own scatter is taken as the
    noise: it comes from the bench, which no sensor's model describes.
    """
    found = _fitted(imu, part, free_bias)
    if not imu.is_noiseless:
        return found
    scatter = np.fmax(found.misfit, 1.0)
    by = scatter[:, None, None]
    return Told(found.h / by[:, 0], found.J / by, found.misfit / scatter)


def _fitted(imu: ImuModel, part: Levelled, free_bias: bool) -> Told:
    """What windows tell of q, without the slews of those whose slews do not fit the model: these
    add more to chi-square than its mean, 3 a slew, and five of its standard deviations."""
    every, slews = told(imu, part, free_bias, check=True), part.course.slewing
    if not slews.any() or slews.all():
        return every
    rest = part.only(~slews)
    alone = told(imu, rest, free_bias, check=True)
    added = every.misfit * degrees(part.course) - alone.misfit * degrees(rest.course)
    count = 3 * int(slews.sum())
    wrong = added > count + _MANY * np.sqrt(2 * count)
    if not wrong.any():
        return every
    J = np.where(wrong[:, None, None], alone.J, every.J)
    h = np.where(wrong[:, None], alone.h, every.h)
    return Told(h, J, np.where(wrong, alone.misfit, every.misfit))


def check_fit(name: str, course: Course, misfit: np.ndarray) -> None:
    """Raise InputError where a window's data scatter far more than the sensor's model says: twice
    in mean square, or, where data are few, by the factor that the model exceeds once in 1e8. Each
    window is judged by itself.

    name : the estimator's; misfit : (V,), see `Told`.
    """
    free = degrees(course)
    if free <= 0:
        return
    most = max(_TWICE, float(chi2.isf(_RARELY, free)) / free)
    wrong = int(np.sum(misfit > most))
    if wrong:
        some = f"{wrong} of {len(misfit)} windows" if len(misfit) > 1 else "a window"
        raise refusal(
            name, f"{np.max(misfit):.3g}", "", "times the scatter that the sensor's model explains "
            f"in {some}: the base moves, or the model is not this sensor's"
        )  # fmt: skip


def degrees(course: Course) -> int:
    """Degrees of freedom of the misfit: the number of data less those fitted, which are q and the
    level, two each. Specific forces during slews do not count as data."""
    n, slews = len(course.blocks), int(course.slewing.sum())
    return CHANNELS * n - 3 * slews - 4


def apart(base: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rounded leans, (G, 2), roll and pitch in rad, that stand for those of bases, (V, 3, 3); and
    the number of each base's own among them, (V,)."""
    pitch, roll = np.arcsin(-base[:, 2, 0]), np.arctan2(base[:, 2, 1], base[:, 2, 2])
    lean = np.stack([roll, pitch], axis=1)
    step = np.where(np.abs(lean).max(axis=1, keepdims=True) < _LEANS, _COARSE, _FINE)
    found, which = np.unique(np.round(lean / step) * step, axis=0, return_inverse=True)
    return found + 0.0, which.reshape(-1)


def _information_by_lean(
    imu: ImuModel, part: Levelled, leans: np.ndarray, free: bool
) -> Information:
    """The information under many leans, (G, 2), worked out some at a time to save memory."""
    base = euler_to_matrix(leans[:, 0], leans[:, 1], 0.0)
    some = [
        _information(imu, part.course, part.site, base[i : i + _CHUNK], free)
        for i in range(0, len(base), _CHUNK)
    ]
    names = ("J", "weights", "known", "taken")
    return Information(*(np.concatenate([getattr(one, n) for one in some]) for n in names))


def spread_of(
    imu: ImuModel, course: Course, site: Site, weights: np.ndarray, lean: tuple[float, float]
) -> np.ndarray:
    """Covariance, (k, k), of k linear forms of the sensor's errors, on a base that leans by roll
    and pitch, rad. weights : (k, CHANNELS, n), the forms' coefficients of the parts' means."""
    base = euler_to_matrix(*lean, 0.0)[None]
    factor, B = factors(imu, course), patterns(imu, course)
    noise = np.einsum("kcn,cnm->kcm", weights, factor)
    drawn = np.concatenate(list(causes(imu, base, site, course.axis).values()), axis=1)[0]
    of_causes = np.einsum("kcn,nb,rcb->kr", weights, B, drawn, optimize=True)
    return np.asarray(np.einsum("icm,jcm->ij", noise, noise) + of_causes @ of_causes.T)


def budget(
    imu: ImuModel,
    course: Course,
    site: Site,
    heading: np.ndarray,
    lean: tuple[float, float] = (0.0, 0.0),
) -> dict[str, float]:
    """The error budget: each cause's contribution to the error of the most likely heading, rad, RMS
    over headings, (V,). Contributions below 1e-6 of the largest are left out.

    Small errors are n'(h - J q)/(n' J n), n = dq/dpsi, and h - J q is the weights times the causes'
    errors: the squares of the contributions add up to the bound's.
    """
    found, white = information(imu, course, site, lean=lean), whitened(imu, course)
    n, size = across(heading), found.sigma(heading) ** 2
    own = found.weights[0].reshape(2, CHANNELS, PATTERNS)
    weights = np.einsum("kca,can->kcn", own, white.reduce)
    parts = {
        name: np.einsum("icn,cnm,jcm->ij", weights, C, weights, optimize=True)
        for name, C in within(imu, course).items()
    }
    base = euler_to_matrix(*lean, 0.0)[None]
    for name, drawn in causes(imu, base, site, course.axis).items():
        of_cause = found.weights[0] @ white.columns(drawn[0]).T
        parts[name] = parts.get(name, 0.0) + of_cause @ of_cause.T
    rms = {k: np.sqrt(max(float(np.mean(np.sum((n @ v) * n, axis=1) * size**2)), 0.0))
           for k, v in parts.items()}  # fmt: skip
    least = 1e-6 * max(rms.values())
    return {name: float(size) for name, size in rms.items() if size > least}
