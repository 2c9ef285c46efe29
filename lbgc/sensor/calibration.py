"""What repeats of a unit's gyro error: bias, scale, misalignment, from labelled recordings.

Each recording gives a mean rate at a known heading, level. Earth's rate there is known, so what is
left over is regressed: a constant is the unit's bias, what scatters about it is the run's, and what
follows Earth's horizontal rate is scale and misalignment. The vertical rate is the same at every
heading, so the third column of M hides in the bias. Where it is known which power-up a recording is
from, the scatter is split between session and run.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.earth import earth_rate_ned
from lbgc.frames import rotation_z, wrap


@dataclass(frozen=True)
class Calibration:
    """SI units."""

    recordings: int
    bias: np.ndarray
    """(3,), constant over the recordings"""
    bias_sigma: np.ndarray
    """(3,), its standard error"""
    run_sigma: np.ndarray
    """(3,), spread of the recordings about it (about their session's, where sessions are known):
    run bias and in-run noise together"""
    session_sigma: np.ndarray | None
    """(3,), spread of the sessions' own biases, zero where the scatter within sessions explains
    theirs; None where there is one session"""
    matrix: np.ndarray
    """(2, 2), scale and misalignment of the horizontal axes, fitted together with a bias"""
    matrix_sigma: np.ndarray
    """(2, 2)"""
    across_rms: float
    """Of the horizontal error across north: what turns the heading"""
    along_mean: float
    """Along north: what only changes the rate's size"""
    along_sigma: float
    heading_rmse: float
    """rad, of the plain mean"""
    heading_rmse_without_bias: float
    """rad, that bias taken out"""
    heading_rmse_without_all: float
    """rad, bias, scale and misalignment taken out"""


def by_lifetime(
    error: np.ndarray, session: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Constant, its standard error, and the standard deviations of run and session (None where
    there is but one): the one-way analysis of variance with unequal groups (Searle, Casella &
    McCulloch 1992, ch. 3).

    error : (R, A); session : (R,), any labels. With S sessions of n_s recordings, the mean square
    within is run^2, the one between run^2 + n0 session^2, n0 = (R - sum n_s^2/R)/(S - 1).
    """
    _, which, sizes = np.unique(session, return_inverse=True, return_counts=True)
    count, groups = len(error), len(sizes)
    if groups == 1 or count == groups:  # no session, or nothing but sessions: all of it is the run
        spread = error.std(axis=0, ddof=1)
        return error.mean(axis=0), spread / np.sqrt(count), spread, None
    means = np.stack([error[which == s].mean(axis=0) for s in range(groups)])
    within = np.sum((error - means[which]) ** 2, axis=0) / (count - groups)
    between = sizes @ (means - error.mean(axis=0)) ** 2 / (groups - 1)
    effective = (count - np.sum(sizes**2) / count) / (groups - 1)
    session_variance = np.maximum((between - within) / effective, 0.0)
    each = session_variance + within / sizes[:, None]  # variance of a session's mean, (S, A)
    weight = 1 / each
    bias = np.sum(weight * means, axis=0) / weight.sum(axis=0)
    return bias, 1 / np.sqrt(weight.sum(axis=0)), np.sqrt(within), np.sqrt(session_variance)


def calibrate(
    rates: np.ndarray, heading: np.ndarray, latitude: float, session: np.ndarray | None = None
) -> Calibration:
    """rates : (R, 3), rad/s, means of level resting recordings, R >= 6; heading : (R,), rad;
    session : (R,), which power-up each is from, where that is known."""
    truth = np.einsum("j,rji->ri", earth_rate_ned(latitude), rotation_z(heading))
    error = rates - truth
    count = len(rates)
    bias, bias_sigma, run_sigma, session_sigma = by_lifetime(
        error, np.zeros(count) if session is None else session
    )
    matrix, sigma, offset = np.empty((2, 2)), np.empty((2, 2)), np.empty(2)
    design = np.column_stack([truth[:, 0], truth[:, 1], np.ones(count)])
    for axis in range(2):
        found, *_ = np.linalg.lstsq(design, error[:, axis], rcond=None)
        rest = error[:, axis] - design @ found
        covariance = rest @ rest / (count - 3) * np.linalg.inv(design.T @ design)
        matrix[axis], offset[axis] = found[:2], found[2]
        sigma[axis] = np.sqrt(np.diag(covariance))[:2]
    north = truth[:, :2] / np.linalg.norm(truth[:, :2], axis=1, keepdims=True)
    across = -(error[:, 0] * np.sin(heading) + error[:, 1] * np.cos(heading))
    along = np.sum(error[:, :2] * north, axis=1)
    horizontal = rates[:, :2]
    mended = np.linalg.solve(np.eye(2) + matrix, (horizontal - offset).T).T

    def rmse(xy: np.ndarray) -> float:
        return float(np.sqrt(np.mean(wrap(np.arctan2(-xy[:, 1], xy[:, 0]) - heading) ** 2)))

    return Calibration(
        recordings=count,
        bias=bias,
        bias_sigma=bias_sigma,
        run_sigma=run_sigma,
        session_sigma=session_sigma,
        matrix=matrix,
        matrix_sigma=sigma,
        across_rms=float(np.sqrt(np.mean(across**2))),
        along_mean=float(along.mean()),
        along_sigma=float(along.std(ddof=1)),
        heading_rmse=rmse(horizontal),
        heading_rmse_without_bias=rmse(horizontal - bias[:2]),
        heading_rmse_without_all=rmse(mended),
    )
