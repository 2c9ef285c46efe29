"""What an estimator's errors amount to."""

from dataclasses import dataclass

import numpy as np

from lbgc.frames import wrap


@dataclass(frozen=True)
class Summary:
    """Of W heading errors. Every name says what it is; degrees."""

    windows: int
    rmse_deg: float
    """Root mean square of the wrapped error."""
    median_deg: float
    """Median of its size."""
    iqr_deg: float
    """Interquartile range of its size."""
    p95_deg: float
    """95th percentile of its size."""
    rmse_cos_latitude_deg: float
    """RMSE of the error times cos(latitude): navigators state gyrocompasses in degrees
    sec(latitude)."""


def heading_errors(estimate: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Estimate less truth on the circle, rad, (W,) in (-pi, pi]."""
    return wrap(estimate - heading)


def summarise(errors: np.ndarray, latitude: np.ndarray) -> Summary:
    """errors, latitude : (W,), rad, W >= 1."""
    degrees = np.rad2deg(errors)
    low, median, high, p95 = np.percentile(np.abs(degrees), [25, 50, 75, 95])
    return Summary(
        windows=len(degrees),
        rmse_deg=float(np.sqrt(np.mean(degrees**2))),
        median_deg=float(median),
        iqr_deg=float(high - low),
        p95_deg=float(p95),
        rmse_cos_latitude_deg=float(np.sqrt(np.mean((degrees * np.cos(latitude)) ** 2))),
    )
