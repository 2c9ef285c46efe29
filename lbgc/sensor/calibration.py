"""Calibration of a unit's repeatable gyro error, that is bias, scale factor and misalignment, from
labelled recordings.

Each recording gives a mean rate at a known heading and attitude. Earth's rate in the body is known
there, so the rest is the gyros' error, and it is split: its constant is the unit's bias, its
scatter is the session's and the run's bias, and the part proportional to Earth's horizontal rate is
scale factor and misalignment (`lbgc.sensor.scale_misalignment`). The vertical rate is the same at
every heading, so the third column of M cannot be told from the bias. What the calibration is worth
is judged on recordings that it was not fitted to.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from lbgc.earth import EARTH_RATE, earth_rate_ned
from lbgc.frames import euler_to_matrix, wrap
from lbgc.sensor.lifetimes import Lifetimes, by_lifetime, student_interval
from lbgc.sensor.scale_misalignment import Gain, gain

FEWEST = 3
"""The least number of recordings that can be split."""


@dataclass(frozen=True)
class LeftOut:
    """The result of a cross-validation: how much correcting an error improves the headings of
    recordings that it was not estimated from."""

    heading_rmse: float
    """rad, heading RMSE of the corrected means, each group of recordings corrected by the estimate
    from all others"""
    gain: float
    """rad^2, by how much the mean square heading error is below that of uncorrected means"""
    gain_sigma: float
    """rad^2, standard error of the gain, from its scatter over the groups"""
    groups: int
    """Number of groups"""
    by_session: bool
    """Whether a group is a session; else it is one recording"""

    @property
    def says(self) -> int:
        """Whether the correction makes headings better (1) or worse (-1); 0 where these recordings
        cannot tell (two-sided, 95%)."""
        limit = stats.t.ppf(0.975, self.groups - 1) * self.gain_sigma
        return int(np.sign(self.gain)) if abs(self.gain) > limit else 0


@dataclass(frozen=True)
class Calibration:
    """A unit's calibration: its repeatable gyro error, split. SI units; axes (3,) are forward,
    right and down of the body."""

    recordings: int
    """Number of recordings"""
    sessions: int | None
    """Number of power-ups that they are from; None where that is not known"""
    mean_error: np.ndarray
    """(3,), rad/s, mean error of the recordings' rates, whatever its causes"""
    bias: np.ndarray
    """(3,), rad/s, the constant error besides the part that follows Earth's horizontal rate. Where
    the headings do not tell all of that part, its mean is in the bias"""
    bias_sigma: np.ndarray
    """(3,), rad/s, standard error of the bias"""
    bias_interval: np.ndarray
    """(2, 3), rad/s, 95% interval of the bias, by Student's t"""
    run_sigma: np.ndarray
    """(3,), rad/s, standard deviation of the recordings about the bias (about their session's,
    where sessions are known): run bias and in-run noise together"""
    run_interval: np.ndarray
    """(2, 3), rad/s, 95% interval of `run_sigma`"""
    session_sigma: np.ndarray | None
    """(3,), rad/s, standard deviation of the sessions' own biases, zero where the scatter within
    sessions explains that of their means; None where there is one session, or one recording a
    session"""
    session_interval: np.ndarray | None
    """(2, 3), rad/s, 95% interval of `session_sigma`"""
    matrix: np.ndarray | None
    """(2, 2), scale factor errors and misalignments of the horizontal axes; None where the headings
    do not tell them"""
    matrix_sigma: np.ndarray | None
    """(2, 2), standard errors of `matrix`"""
    matrix_interval: np.ndarray | None
    """(2, 2, 2), 95% intervals of `matrix`, low and high along the first axis"""
    missing: str | None
    """The headings or recordings that are missing for `matrix`; None where it is told"""
    across_rms: float
    """Rms of the horizontal rate error's part across north, rad/s, which turns the heading"""
    along_mean: float
    """Mean of the horizontal rate error's part along north, rad/s, which changes only the size of
    the horizontal rate"""
    along_sigma: float
    """Standard deviation of that part over the recordings, rad/s"""
    heading_rmse: float
    """rad, heading RMSE of the uncorrected means"""
    without_bias: LeftOut
    """Cross-validation of taking the mean error out as a bias"""
    without_all: LeftOut | None
    """Cross-validation of taking bias, scale factor and misalignment out; None where these are not
    told by all groups but one, whichever is left out"""


@dataclass(frozen=True)
class LabelledMeans:
    """Mean rates of R resting recordings of one unit, and the truth about them."""

    rates: np.ndarray
    """(R, 3), rad/s, mean rates in the body"""
    heading: np.ndarray
    """(R,), rad, true heading"""
    level: np.ndarray
    """(R, 3, 3), matrix from the body to the level frame whose x axis lies along the heading"""
    truth: np.ndarray
    """(R, 3), rad/s, Earth's rate in the body"""
    session: np.ndarray
    """(R,), label of each recording's session"""

    @property
    def error(self) -> np.ndarray:
        """(R, 3), rad/s, the gyros' errors: mean rates less Earth's rate."""
        return np.asarray(self.rates - self.truth)

    def rows(self, pick: np.ndarray) -> "LabelledMeans":
        """The recordings that `pick` selects, an index or a mask along the recordings."""
        return LabelledMeans(**{name: values[pick] for name, values in vars(self).items()})

    def heading_error(self, mended: np.ndarray) -> np.ndarray:
        """The error, rad, (R,), of the headings that these rates (R, 3), rad/s, give when they are
        levelled."""
        x, y, _ = np.einsum("rij,rj->ir", self.level, mended)
        return wrap(np.arctan2(-y, x) - self.heading)


def _resting(
    rates: np.ndarray,
    heading: np.ndarray,
    latitude: float | np.ndarray,
    session: np.ndarray | None,
    tilt: tuple[np.ndarray, np.ndarray] | None,
) -> LabelledMeans:
    """The labelled means for the arguments of `calibrate`."""
    none = np.zeros(len(rates))
    roll, pitch = (none, none) if tilt is None else tilt
    level = euler_to_matrix(roll, pitch, none)
    earth = np.broadcast_to(earth_rate_ned(latitude), (len(rates), 3))
    truth = np.einsum("rij,ri->rj", euler_to_matrix(roll, pitch, heading), earth)
    return LabelledMeans(rates, heading, level, truth, none if session is None else session)


def calibrate(
    rates: np.ndarray,
    heading: np.ndarray,
    latitude: float | np.ndarray,
    session: np.ndarray | None = None,
    tilt: tuple[np.ndarray, np.ndarray] | None = None,
) -> Calibration:
    """Calibrate a unit's gyros from its resting recordings at known headings.

    rates : (R, 3), rad/s, the recordings' means, R >= 3; heading : (R,), rad; latitude : rad, one
    for all or (R,); session : (R,), the power-up that each is from, where that is known; tilt :
    roll and pitch, (R,) each, rad, level where not given.
    """
    data = _resting(rates, heading, latitude, session, tilt)
    found, times, bias_sigma = _fitted(data)
    turned = np.einsum("rij,rj->ri", data.level, data.error)
    across = -(turned[:, 0] * np.sin(heading) + turned[:, 1] * np.cos(heading))
    along = turned[:, 0] * np.cos(heading) - turned[:, 1] * np.sin(heading)
    plain = data.heading_error(rates)
    matrix, sigma = found.matrix, found.matrix_sigma
    own = None if matrix is None else matrix[:2, :2]
    return Calibration(
        recordings=len(rates),
        sessions=None if session is None else len(np.unique(session)),
        mean_error=data.error.mean(axis=0),
        bias=times.bias,
        bias_sigma=bias_sigma,
        bias_interval=student_interval(times.bias, bias_sigma, times.bias_freedom),
        run_sigma=times.run_sigma,
        run_interval=times.run_interval,
        session_sigma=times.session_sigma,
        session_interval=times.session_interval,
        matrix=own,
        matrix_sigma=sigma,
        matrix_interval=None
        if own is None or sigma is None
        else student_interval(own, sigma, found.freedom),
        missing=found.missing,
        across_rms=float(np.sqrt(np.mean(across**2))),
        along_mean=float(along.mean()),
        along_sigma=float(along.std(ddof=1)),
        heading_rmse=float(np.sqrt(np.mean(plain**2))),
        without_bias=_left_out(data, plain, lambda others: (others.error.mean(axis=0), None)),
        without_all=_left_out_of_all(data, plain),
    )


def _fitted(data: LabelledMeans) -> tuple[Gain, Lifetimes, np.ndarray]:
    """The gain on Earth's rate, the rest of the error split by lifetime, and the standard error
    (3,) of the bias, which includes what the uncertain gain adds at the mean horizontal rate."""
    found = gain(data.error, data.truth, data.session)
    k = found.directions.shape[1]
    told = {"within": k} if found.within else {"between": k}
    times = by_lifetime(data.error - found.predicted(data.truth), data.session, **told)
    middle = data.truth[:, :2].mean(axis=0) @ found.directions
    added = middle @ found.covariance @ middle * found.scatter**2
    return found, times, np.sqrt(times.bias_sigma**2 + added)


Told = tuple[np.ndarray, np.ndarray | None]
"""An estimated correction: a bias (3,), rad/s, and M (3, 3) or None."""


def _left_out_of_all(data: LabelledMeans, plain: np.ndarray) -> LeftOut | None:
    """Cross-validation of correcting bias, scale factor and misalignment; None where the headings
    of some group's others do not tell these.

    plain : (R,), rad, heading errors of the uncorrected means.
    """

    def told(others: LabelledMeans) -> Told:
        found, times, _ = _fitted(others)
        if found.matrix is None:
            raise _NotTold
        return times.bias, found.matrix

    try:
        return _left_out(data, plain, told)
    except _NotTold:
        return None


class _NotTold(Exception):
    """The headings of these recordings do not tell scale factor and misalignment."""


def _left_out(
    data: LabelledMeans, plain: np.ndarray, told: Callable[[LabelledMeans], Told]
) -> LeftOut:
    """Cross-validation of a correction: the headings of each session (of each recording, where
    there are fewer than three sessions) are corrected by the estimate from all others.

    plain : (R,), rad, heading errors of the uncorrected means; told : estimates the correction from
    recordings.
    """
    by_session = len(np.unique(data.session)) > 2
    group = data.session if by_session else np.arange(len(plain))
    left, gains = np.empty(len(plain)), []
    for label in np.unique(group):
        out = group == label
        one = data.rows(out)
        bias, matrix = told(data.rows(~out))
        mended = one.rates - bias
        if matrix is not None:
            mended = np.linalg.solve(np.eye(3) + matrix, mended.T).T
        left[out] = one.heading_error(mended)
        gains.append(np.mean(plain[out] ** 2 - left[out] ** 2))
    spread = np.std(gains, ddof=1) / np.sqrt(len(gains))
    return LeftOut(
        float(np.sqrt(np.mean(left**2))),
        float(np.mean(gains)),
        float(spread),
        len(gains),
        by_session,
    )


def odd_one_out(
    rates: np.ndarray,
    heading: np.ndarray,
    latitude: float | np.ndarray,
    session: np.ndarray | None = None,
    tilt: tuple[np.ndarray, np.ndarray] | None = None,
    false_alarms: float = 1e-6,
) -> tuple[int, int, float, float] | None:
    """The outlier among recordings, whose rate does not agree with the others': its number, its
    axis, its distance and the others' scatter, rad/s. None where there is no outlier.

    The test takes the externally studentised residuals of the model that `calibrate` fits, whose
    law is Student's t. false_alarms : the chance that a set of recordings, all at rest, has an
    outlier by chance. The other arguments are those of `calibrate`.
    """
    data = _resting(rates, heading, latitude, session, tilt)
    found = gain(data.error, data.truth, data.session)
    _, which = np.unique(data.session, return_inverse=True)
    constants = np.eye(int(which.max()) + 1)[which]
    if not found.within and found.directions.shape[1]:
        constants = np.ones((len(rates), 1))
    design = np.column_stack([constants, data.truth[:, :2] @ found.directions / EARTH_RATE])
    q, _ = np.linalg.qr(design)
    rest = data.error - q @ (q.T @ data.error)
    # One less the leverage: the share of a recording's own error that is left in its residual.
    leverage = 1 - np.sum(q**2, axis=1)[:, None]
    freedom = len(rates) - design.shape[1] - 1
    if freedom < 2:
        return None
    square = rest**2 / np.maximum(leverage, 1e-9)
    others = np.maximum(np.sum(rest**2, axis=0) - square, 0.0) / freedom
    rounding = (1e-6 * EARTH_RATE) ** 2
    t = np.where(leverage > 1e-6, np.sqrt(square / np.maximum(others, rounding)), 0.0)
    at, axis = np.unravel_index(int(np.argmax(t)), t.shape)
    if t[at, axis] <= stats.t.ppf(1 - false_alarms / (2 * t.size), freedom):
        return None
    distance = float(rest[at, axis] / leverage[at, 0])
    return int(at), int(axis), distance, float(np.sqrt(others[at, axis]))
