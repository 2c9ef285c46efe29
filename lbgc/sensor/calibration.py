"""What repeats of a unit's gyro error: bias, scale, misalignment, from labelled recordings.

Each recording gives a mean rate at a known heading, level. Earth's rate there is known, so what is
left over is regressed: a constant is the unit's bias, what scatters about it is the run's, and what
follows Earth's horizontal rate is scale and misalignment. The vertical rate is the same at every
heading, so the third column of M hides in the bias.
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
    """(3,), spread of the recordings about it: run bias and in-run noise together"""
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


def calibrate(rates: np.ndarray, heading: np.ndarray, latitude: float) -> Calibration:
    """rates : (R, 3), rad/s, means of level resting recordings, R >= 6; heading : (R,), rad."""
    truth = np.einsum("j,rji->ri", earth_rate_ned(latitude), rotation_z(heading))
    error = rates - truth
    count = len(rates)
    bias, spread = error.mean(axis=0), error.std(axis=0, ddof=1)
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
        bias_sigma=spread / np.sqrt(count),
        run_sigma=spread,
        matrix=matrix,
        matrix_sigma=sigma,
        across_rms=float(np.sqrt(np.mean(across**2))),
        along_mean=float(along.mean()),
        along_sigma=float(along.std(ddof=1)),
        heading_rmse=rmse(horizontal),
        heading_rmse_without_bias=rmse(horizontal - bias[:2]),
        heading_rmse_without_all=rmse(mended),
    )
