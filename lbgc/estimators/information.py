"""Headings from what Gaussian data tell of them: the mode, and the mean of the posterior.

Whatever data tell of q = (cos psi, sin psi) is a 2-vector h and a 2 x 2 matrix J, the information
(see lbgc.estimators.optimal), and with a flat prior on the circle

    log p(psi | d) = q' h - q' J q / 2 + constant
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from lbgc.estimators.estimate import Estimate
from lbgc.frames import wrap
from lbgc.sensor.imu import ImuModel

LIFETIMES = ("unit", "session", "run")
AS_LENGTHS = float(np.deg2rad(6.0))
"""Below it angles behave like lengths."""


def known(imu: ImuModel, lifetimes: tuple[str, ...]) -> ImuModel:
    """The sensor when everything that lasts that long has been calibrated away."""
    none = (0.0, 0.0, 0.0)
    gone: dict[str, Any] = {f"bias_{name}": none for name in lifetimes}
    if "unit" in lifetimes:
        of_unit = ("scale_unit", "misalignment_unit", "g_sensitivity", "bias_per_k", "scale_per_k")
        gone |= dict.fromkeys(of_unit, none)
    return replace(imu, gyro=replace(imu.gyro, **gone), accel=replace(imu.accel, **gone))


def along(heading: np.ndarray) -> np.ndarray:
    """q, (*S, 2)."""
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def across(heading: np.ndarray) -> np.ndarray:
    """dq/dpsi, (*S, 2)."""
    return np.stack([-np.sin(heading), np.cos(heading)], axis=-1)


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


def likeliest(h: np.ndarray, J: np.ndarray) -> Estimate:
    """The most likely headings, and their sigma by the curvature there; by the posterior's spread
    on the circle where that is above 6 degrees. h : (V, 2); J : (V or 1, 2, 2)."""
    heading = mode(h, J)
    n = across(heading)
    sigma = 1 / np.sqrt(np.maximum(np.sum(_along(n, J) * n, axis=1), 1e-30))
    wide = sigma > AS_LENGTHS
    if wide.any():
        sigma[wide] = bayes(h[wide], J if len(J) == 1 else J[wide]).sigma
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
