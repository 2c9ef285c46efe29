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
    own = _numbers(np.zeros(len(size)) if recording is None else recording)
    size, latitude, own = size[order], latitude[order], own[order]
    told = sigma is not None and np.isfinite(sigma).all() and np.all(sigma > 0)
    normalised = size / np.rad2deg(sigma[order]) if sigma is not None and told else None
    sums = _Sums(size, latitude, normalised, own)
    figures = sums.figures(np.ones((1, sums.recordings)))
    intervals = None
    if recording is not None and len(size) > 1:
        parts = [sums.figures(weights) for weights in _resamples(sums.recordings)]
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


@dataclass(frozen=True)
class Ratio:
    """Of two RMSEs on the same windows."""

    value: float
    low: float
    """95%, paired bootstrap over recordings"""
    high: float


def rmse_ratio(errors: np.ndarray, others: np.ndarray, recording: np.ndarray) -> Ratio:
    """RMSE of `errors` over RMSE of `others`, (W,) each, of the same windows; recording : (W,)."""
    own = _numbers(recording)
    squares = [np.bincount(own, e**2) for e in (errors, others)]
    drawn = [
        np.sqrt((weights @ squares[0]) / (weights @ squares[1]))
        for weights in _resamples(len(squares[0]))
    ]
    low, high = np.percentile(np.concatenate(drawn), [2.5, 97.5])
    return Ratio(float(np.sqrt(squares[0].sum() / squares[1].sum())), float(low), float(high))


def _numbers(recording: np.ndarray) -> np.ndarray:
    """(W,), 0, 1, ...: whose each window is; of one recording, each its own, as if independent."""
    own = np.unique(recording, return_inverse=True)[1]
    return own if own.max() > 0 else np.arange(len(recording))


def _resamples(recordings: int) -> Iterator[np.ndarray]:
    """How often each recording is in each resample, in parts of (B, R): they are drawn whole, since
    a recording's windows share its bias."""
    rng = streams.figures()
    rows = max(1, int(_WEIGHTS // recordings))
    equal = np.full(recordings, 1 / recordings)
    for first in range(0, RESAMPLES, rows):
        yield rng.multinomial(recordings, equal, min(rows, RESAMPLES - first)).astype(float)


@dataclass(frozen=True)
class _Sums:
    """What figures of any resample are made of."""

    size: np.ndarray
    """(W,), degrees, ascending"""
    latitude: np.ndarray
    """(W,), rad"""
    normalised: np.ndarray | None
    """(W,), error over sigma"""
    own: np.ndarray
    """(W,), which recording"""

    @property
    def recordings(self) -> int:
        return int(self.own.max()) + 1

    def figures(self, weights: np.ndarray) -> dict[str, np.ndarray]:
        """Each figure for each row of weights (B, R): name -> (B,)."""
        total = weights @ self._by_recording(np.ones_like(self.size))
        q25, q50, q75, q95 = (self._quantile(p, weights, total) for p in (0.25, 0.5, 0.75, 0.95))

        def mean_square(values: np.ndarray) -> np.ndarray:
            return np.asarray(weights @ self._by_recording(values**2) / total)

        found = {
            "rmse_deg": np.sqrt(mean_square(self.size)),
            "median_deg": q50,
            "iqr_deg": q75 - q25,
            "p95_deg": q95,
            "rmse_cos_latitude_deg": np.sqrt(mean_square(self.size * np.cos(self.latitude))),
        }
        if self.normalised is not None:
            found["mean_normalised_squared_error"] = mean_square(self.normalised)
        return found

    def _by_recording(self, values: np.ndarray) -> np.ndarray:
        """Sums over the first len(values) windows, (R,)."""
        return np.bincount(self.own[: len(values)], values, self.recordings)

    def _quantile(self, share: float, weights: np.ndarray, total: np.ndarray) -> np.ndarray:
        """(B,): with equal weights NumPy's linear rule. Resamples differ little, so that only the
        sizes about the quantile are gone through, and more where that was not enough."""
        place = share * (total - 1)
        low, high = np.floor(place), np.ceil(place)
        count, reach = len(self.size), 8 * np.sqrt(share * (1 - share) / self.recordings)
        while True:
            first = max(0, int((share - reach) * count))
            last = min(count, int((share + reach) * count) + 1)
            before = weights @ self._by_recording(np.ones(first))
            inside = weights @ np.bincount(self.own[first:last], minlength=self.recordings)
            if np.all(before <= low) and np.all(before + inside > high):
                break
            reach *= 2
        found = np.empty(len(weights))
        rows = max(1, int(_WEIGHTS // (last - first)))
        for at in range(0, len(weights), rows):
            part = slice(at, at + rows)
            below = before[part, None] + np.cumsum(weights[part][:, self.own[first:last]], axis=1)
            left, right = (
                self.size[first + np.sum(below <= ends[part, None], axis=1)] for ends in (low, high)
            )
            found[part] = left + (place - low)[part] * (right - left)
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
