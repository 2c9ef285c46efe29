"""What repeats of a unit's gyro error: bias, scale, misalignment, from labelled recordings.

Each recording gives a mean rate at a known heading and attitude. Earth's rate in the body is known
there, so what is left over is split: a constant is the unit's bias, what scatters about it is the
session's and the run's, and what follows Earth's horizontal rate is scale and misalignment
(`lbgc.sensor.scale_misalignment`). The vertical rate is the same at every heading, so the third
column of M hides in the bias. What all that is worth is told on recordings that it was not fitted
to.
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
"""Recordings without which nothing is split."""


@dataclass(frozen=True)
class LeftOut:
    """What taking an error out does to headings of recordings that it was not fitted to."""

    heading_rmse: float
    """rad, of the corrected mean, each group of recordings corrected by what all others tell"""
    gain: float
    """rad^2, by how much its mean square error is less than the plain mean's"""
    gain_sigma: float
    """rad^2, standard error of that, from group to group"""
    groups: int
    by_session: bool
    """Whether a group is a session; else it is one recording"""

    @property
    def says(self) -> int:
        """1: better; -1: worse; 0: these recordings cannot tell (two-sided, 95%)."""
        limit = stats.t.ppf(0.975, self.groups - 1) * self.gain_sigma
        return int(np.sign(self.gain)) if abs(self.gain) > limit else 0


@dataclass(frozen=True)
class Calibration:
    """SI units; (3,) are forward, right, down of the body."""

    recordings: int
    sessions: int | None
    """Power-ups that they are from; None where that is not known"""
    mean_error: np.ndarray
    """(3,), of the recordings' rates, whatever makes it"""
    bias: np.ndarray
    """(3,), the constant beside what follows Earth's horizontal rate; where the headings do not
    tell all of that, with what it is on average"""
    bias_sigma: np.ndarray
    """(3,), its standard error"""
    bias_interval: np.ndarray
    """(2, 3), 95%, by Student's t"""
    run_sigma: np.ndarray
    """(3,), spread of the recordings about it (about their session's, where sessions are known):
    run bias and in-run noise together"""
    run_interval: np.ndarray
    """(2, 3), 95%"""
    session_sigma: np.ndarray | None
    """(3,), spread of the sessions' own biases, zero where the scatter within sessions explains
    theirs; None where there is one session, or one recording a session"""
    session_interval: np.ndarray | None
    """(2, 3), 95%"""
    matrix: np.ndarray | None
    """(2, 2), scale and misalignment of the horizontal axes; None where the headings do not tell"""
    matrix_sigma: np.ndarray | None
    """(2, 2)"""
    matrix_interval: np.ndarray | None
    """(2, 2, 2), 95%, low and high first"""
    missing: str | None
    """What the headings lack for it"""
    across_rms: float
    """Rms of the horizontal rate error's part across north, rad/s: what turns the heading"""
    along_mean: float
    """Mean of the horizontal rate error's part along north, rad/s: what only changes the rate's
    size"""
    along_sigma: float
    heading_rmse: float
    """rad, of the plain mean"""
    without_bias: LeftOut
    without_all: LeftOut | None
    """Bias, scale and misalignment; None where they are not told, be it by all but one"""


@dataclass(frozen=True)
class LabelledMeans:
    """Mean rates of resting recordings of one unit, and the truth about them."""

    rates: np.ndarray
    """(R, 3), rad/s"""
    heading: np.ndarray
    """(R,), rad"""
    level: np.ndarray
    """(R, 3, 3), takes body vectors to the level frame whose x lies along the heading"""
    truth: np.ndarray
    """(R, 3), rad/s, Earth's rate in the body"""
    session: np.ndarray
    """(R,), labels"""

    @property
    def error(self) -> np.ndarray:
        return np.asarray(self.rates - self.truth)

    def rows(self, pick: np.ndarray) -> "LabelledMeans":
        return LabelledMeans(**{name: values[pick] for name, values in vars(self).items()})

    def heading_error(self, mended: np.ndarray) -> np.ndarray:
        """rad, (R,), of the heading that these rates (R, 3) give."""
        x, y, _ = np.einsum("rij,rj->ir", self.level, mended)
        return wrap(np.arctan2(-y, x) - self.heading)


def _resting(
    rates: np.ndarray,
    heading: np.ndarray,
    latitude: float | np.ndarray,
    session: np.ndarray | None,
    tilt: tuple[np.ndarray, np.ndarray] | None,
) -> LabelledMeans:
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
    """rates : (R, 3), rad/s, means of resting recordings, R >= 3; heading : (R,), rad; latitude :
    rad, of all or (R,); session : (R,), which power-up each is from, where that is known; tilt :
    roll and pitch, (R,) each, rad: level if not given."""
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
    """What follows Earth's rate, what does not by lifetime, and the constant's standard error,
    (3,): with what the uncertain slopes add at the headings' middle."""
    found = gain(data.error, data.truth, data.session)
    k = found.directions.shape[1]
    told = {"within": k} if found.within else {"between": k}
    times = by_lifetime(data.error - found.predicted(data.truth), data.session, **told)
    middle = data.truth[:, :2].mean(axis=0) @ found.directions
    added = middle @ found.covariance @ middle * found.scatter**2
    return found, times, np.sqrt(times.bias_sigma**2 + added)


Told = tuple[np.ndarray, np.ndarray | None]
"""A bias (3,), rad/s, and M (3, 3) or None."""


def _left_out_of_all(data: LabelledMeans, plain: np.ndarray) -> LeftOut | None:
    """Bias, scale and misalignment taken out of those left out; None where the headings of the
    others do not tell them."""

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
    """Scale and misalignment do not show in these recordings."""


def _left_out(
    data: LabelledMeans, plain: np.ndarray, told: Callable[[LabelledMeans], Told]
) -> LeftOut:
    """Each session's headings (each recording's, where there are not three sessions) corrected by
    what the others tell.

    plain : (R,), rad, heading errors of the plain mean; told : what some recordings tell.
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
    """The recording whose rate is none of the others': its number, axis, distance and the others'
    scatter, rad/s; None where there is none.

    By externally studentised residuals of what calibration fits, which are Student's t: of all of a
    set at rest, so many false alarms. Arguments as `calibrate` takes them.
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
    leverage = 1 - np.sum(q**2, axis=1)[:, None]  # the share of an own error left in its residual
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
