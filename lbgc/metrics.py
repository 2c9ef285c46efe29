"""What an estimator's errors amount to, and how surely."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lbgc.frames import wrap
from lbgc.sensor import streams

RESAMPLES = 400
_WEIGHTS = 4e6  # held at once


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
    mean_normalised_squared_error: float | None = None
    """Of error/sigma: 1 where the stated sigma is true; None where none was stated, or zero."""
    microseconds_a_window: float | None = None
    """Processor time, of all threads."""
    intervals: Mapping[str, tuple[float, float]] | None = None
    """95%, by the names above: bootstrap over recordings, or over windows where one has them all;
    None where there is but one window."""


def heading_errors(estimate: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Estimate less truth on the circle, rad, (W,) in (-pi, pi]."""
    return wrap(estimate - heading)


def summarise(
    errors: np.ndarray,
    latitude: np.ndarray,
    sigma: np.ndarray | None = None,
    recording: np.ndarray | None = None,
    seconds: float | None = None,
) -> Summary:
    """errors, latitude, sigma : (W,), rad, W >= 1; recording : (W,), which window is whose, for
    the intervals; seconds : that answering took, altogether."""
    size = np.abs(np.rad2deg(errors))
    order = np.argsort(size)  # once, for the quantiles of every resample
    size, latitude = size[order], latitude[order]
    sigma, recording = (None if v is None else v[order] for v in (sigma, recording))
    figures = _figures(size, latitude, sigma, np.ones((1, len(size))))
    intervals = None
    if recording is not None and len(size) > 1:
        rows = max(1, int(_WEIGHTS // len(size)))
        parts = [
            _figures(size, latitude, sigma, weights) for weights in _resamples(recording, rows)
        ]
        drawn = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        intervals = {
            name: (float(low), float(high))
            for name, values in drawn.items()
            for low, high in [np.percentile(values, [2.5, 97.5])]
        }
    return Summary(
        windows=len(size),
        **{name: float(values[0]) for name, values in figures.items()},
        microseconds_a_window=None if seconds is None else 1e6 * seconds / len(size),
        intervals=intervals,
    )


def _resamples(recording: np.ndarray, rows: int) -> Iterator[np.ndarray]:
    """How often each window is in each resample, in parts of (rows, W): recordings are drawn
    whole, since a recording's windows share its bias."""
    names, own = np.unique(recording, return_inverse=True)
    if len(names) == 1:
        names = own = np.arange(len(recording))
    rng = streams.figures()
    equal = np.full(len(names), 1 / len(names))
    for first in range(0, RESAMPLES, rows):
        yield rng.multinomial(len(names), equal, min(rows, RESAMPLES - first))[:, own]


def _figures(
    size: np.ndarray, latitude: np.ndarray, sigma: np.ndarray | None, weights: np.ndarray
) -> dict[str, np.ndarray]:
    """Each figure for each row of weights (B, W): name -> (B,). size : ascending."""
    total = weights.sum(axis=1)
    q25, q50, q75, q95 = _quantiles(size, weights, (0.25, 0.5, 0.75, 0.95))
    found = {
        "rmse_deg": np.sqrt(weights @ size**2 / total),
        "median_deg": q50,
        "iqr_deg": q75 - q25,
        "p95_deg": q95,
        "rmse_cos_latitude_deg": np.sqrt(weights @ (size * np.cos(latitude)) ** 2 / total),
    }
    if sigma is not None and np.isfinite(sigma).all() and np.all(sigma > 0):
        normalised = (size / np.rad2deg(sigma)) ** 2
        found["mean_normalised_squared_error"] = weights @ normalised / total
    return found


def _quantiles(size: np.ndarray, weights: np.ndarray, wanted: Sequence[float]) -> list[np.ndarray]:
    """Of ascending sizes that occur so often, each (B,): with equal weights NumPy's linear rule."""
    below = np.cumsum(weights, axis=1)
    found = []
    for share in wanted:
        place = share * (below[:, -1] - 1)
        low, high = np.floor(place), np.ceil(place)
        left = np.array([np.searchsorted(b, at, "right") for b, at in zip(below, low, strict=True)])
        right = np.array(
            [np.searchsorted(b, at, "right") for b, at in zip(below, high, strict=True)]
        )
        found.append(size[left] + (place - low) * (size[right] - size[left]))
    return found


def time_to_reach(windows_s: Sequence[float], rmse_deg: Sequence[float], error_deg: float) -> str:
    """The window length at which an estimator's RMSE comes down to this error for good, in words:
    interpolated between window lengths, both in logarithms; "never" where it does not.

    windows_s : ascending, s.
    """
    above = [i for i, rmse in enumerate(rmse_deg) if rmse > error_deg]
    if not above:
        return f"<= {windows_s[0]:g} s"
    last = above[-1]
    if last == len(windows_s) - 1:
        return "never"
    x0, x1 = np.log(windows_s[last]), np.log(windows_s[last + 1])
    y0, y1 = np.log(rmse_deg[last]), np.log(max(rmse_deg[last + 1], 1e-12))
    return f"{np.exp(x0 + (np.log(error_deg) - y0) / (y1 - y0) * (x1 - x0)):.3g} s"
