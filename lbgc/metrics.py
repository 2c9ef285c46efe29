"""The figures of an estimator's errors, RMSE and others, and their 95% intervals."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from lbgc.frames import wrap
from lbgc.sensor import streams

RESAMPLES = 400
"""Number of bootstrap resamples."""
_WEIGHTS = 4e6  # array elements held at once


@dataclass(frozen=True)
class Summary:
    """Figures of W heading errors, in degrees; each is what its name says."""

    windows: int
    independent: int
    """Number of errors that count as independent: the recordings, since windows of one share its
    bias; the windows, where one recording has them all."""
    rmse_deg: float
    """Root mean square of the wrapped error."""
    median_deg: float
    """Median of the error's size."""
    iqr_deg: float
    """Interquartile range of the error's size."""
    p95_deg: float
    """95th percentile of the error's size."""
    rmse_cos_latitude_deg: float
    """RMSE of the error times cos(latitude): navigators state gyrocompasses in degrees
    sec(latitude)."""
    mean_normalised_squared_error: float | None = None
    """Mean of (error/sigma)^2, with the variance of the reference, where it is known, added to that
    of the estimate: 1 where the stated sigma is true; None where none was stated, or zero."""
    sigma_deg: float | None = None
    """Root mean square of the stated sigmas; None where none was stated."""
    sigma_is_at_least: bool = False
    """Whether that sigma is a lower bound: the estimator was told nothing of the sensor."""
    microseconds_a_window: float | None = None
    """Processor time of an answer, by the one thread that is used."""
    intervals: Mapping[str, tuple[float, float]] | None = None
    """95% intervals by the names above: bootstrap over recordings, or over windows where one
    recording has them all; None where there is only one window."""


TRUE_SIGMA = (0.9, 1.1)
"""Range of the mean normalised squared error in which a sigma counts as true: the sigma is wrong by
5% at either end."""


def is_untrue(summary: Summary) -> bool:
    """Whether the stated sigma is not that of the errors: the 95% interval of the mean normalised
    squared error lies outside TRUE_SIGMA.

    The squares of n errors over true sigmas have a chi-square sum of n degrees of freedom: at n = 8
    a mean of 0.27 to 2.2. A true sigma is called untrue in fewer than 5 of 100 tables' rows.
    """
    value, n = summary.mean_normalised_squared_error, summary.independent
    if value is None:
        return False
    low, high = n * value / chi2.ppf([0.975, 0.025], n)
    return bool(low > TRUE_SIGMA[1] or high < TRUE_SIGMA[0])


def heading_errors(estimate: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Estimate less truth on the circle, rad, (W,) in (-pi, pi]."""
    return wrap(estimate - heading)


def summarise(
    errors: np.ndarray,
    latitude: np.ndarray,
    sigma: np.ndarray | None = None,
    recording: np.ndarray | None = None,
    seconds: float | None = None,
    at_least: bool = False,
    reference: np.ndarray | None = None,
) -> Summary:
    """The figures of W >= 1 heading errors.

    errors, latitude, sigma : (W,), rad; recording : (W,), each window's recording, for the
    intervals; seconds : processor time of all answers; at_least : whether sigma is a lower bound;
    reference : (W,), rad, 1 sigma of the headings that errors are from, which adds to the errors.
    """
    size = np.abs(np.rad2deg(errors))
    order = np.argsort(size)  # once, for the quantiles of every resample
    own = _numbers(np.zeros(len(size)) if recording is None else recording)
    size, latitude, own = size[order], latitude[order], own[order]
    told = sigma is not None and np.isfinite(sigma).all() and np.all(sigma > 0)
    normalised = None
    if sigma is not None and told:
        whole = sigma if reference is None else np.hypot(sigma, reference)
        normalised = size / np.rad2deg(whole[order])
    sums = _Sums(size, latitude, normalised, own)
    figures = sums.figures(np.ones((1, sums.recordings)))
    intervals = None
    if recording is not None and len(size) > 1:
        parts = [sums.figures(weights) for weights in _resamples(sums.recordings)]
        drawn = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        intervals = {name: _interval(values) for name, values in drawn.items()}
    return Summary(
        windows=len(size),
        independent=sums.recordings,
        **{name: float(values[0]) for name, values in figures.items()},
        sigma_deg=_rmse_deg(sigma) if sigma is not None and told else None,
        sigma_is_at_least=at_least,
        microseconds_a_window=None if seconds is None else 1e6 * seconds / len(size),
        intervals=intervals,
    )


@dataclass(frozen=True)
class Ratio:
    """Ratio of two RMSEs on the same windows."""

    value: float
    low: float
    """Lower end of its 95% interval, by a paired bootstrap over recordings"""
    high: float
    """Upper end, likewise"""


def rmse_ratio(errors: np.ndarray, others: np.ndarray, recording: np.ndarray) -> Ratio:
    """RMSE of `errors` over RMSE of `others`, (W,) each, of the same windows; recording : (W,)."""
    own = _numbers(recording)
    squares = [np.bincount(own, e**2) for e in (errors, others)]
    drawn = [
        np.sqrt((weights @ squares[0]) / (weights @ squares[1]))
        for weights in _resamples(len(squares[0]))
    ]
    value = float(np.sqrt(squares[0].sum() / squares[1].sum()))
    return Ratio(value, *_interval(np.concatenate(drawn)))


def _interval(drawn: np.ndarray) -> tuple[float, float]:
    """The 95% interval of a figure, by its values in the resamples, (B,)."""
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(low), float(high)


def _numbers(recording: np.ndarray) -> np.ndarray:
    """The number, from 0, of the group that each window is resampled with, (W,): its recording; or
    a group of its own, as if independent, where one recording has all windows."""
    own = np.unique(recording, return_inverse=True)[1]
    return own if own.max() > 0 else np.arange(len(recording))


def _resamples(recordings: int) -> Iterator[np.ndarray]:
    """Number of times that each recording is in each resample, in parts of (B, R). Recordings are
    drawn whole, since a recording's windows share its bias."""
    rng = streams.figures()
    rows = max(1, int(_WEIGHTS // recordings))
    equal = np.full(recordings, 1 / recordings)
    for first in range(0, RESAMPLES, rows):
        yield rng.multinomial(recordings, equal, min(rows, RESAMPLES - first)).astype(float)


@dataclass(frozen=True)
class _Sums:
    """The data from which the figures of any resample are computed."""

    size: np.ndarray
    """(W,), absolute errors, degrees, ascending"""
    latitude: np.ndarray
    """(W,), rad"""
    normalised: np.ndarray | None
    """(W,), error over sigma; None where no sigma is stated"""
    own: np.ndarray
    """(W,), number of each window's recording"""

    @property
    def recordings(self) -> int:
        """Number of recordings."""
        return int(self.own.max()) + 1

    def figures(self, weights: np.ndarray) -> dict[str, np.ndarray]:
        """Each figure for each row of weights (B, R): name -> (B,)."""
        total = weights @ self._by_recording(np.ones_like(self.size))
        q25, q50, q75, q95 = self._quantiles(np.array([0.25, 0.5, 0.75, 0.95]), weights)

        def mean_square(values: np.ndarray) -> np.ndarray:
            """Weighted mean square of the windows' values, (B,)."""
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
        """Sums of values by recording, (R,)."""
        return np.bincount(self.own, values)

    def _quantiles(self, shares: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Quantiles of the absolute errors in each resample, (P, B), by NumPy's linear rule. Sorted
        sizes that are repeated stay sorted, which np.quantile cannot know: this takes half its time
        or less."""
        found = np.empty((len(shares), len(weights)))
        for at, times in enumerate(weights.astype(int)):
            drawn = np.repeat(self.size, times[self.own])
            found[:, at] = np.interp(shares * (len(drawn) - 1), np.arange(len(drawn)), drawn)
        return found


def rmse_interval(errors: np.ndarray, recording: np.ndarray) -> tuple[float, float] | None:
    """The 95% interval of the RMSE of errors, (W,), in their unit, by bootstrap over recordings,
    (W,); None for one window."""
    if len(errors) < 2:
        return None
    own = _numbers(recording)
    squares, windows = np.bincount(own, errors**2), np.bincount(own)
    drawn = [np.sqrt((w @ squares) / (w @ windows)) for w in _resamples(len(squares))]
    return _interval(np.concatenate(drawn))


@dataclass(frozen=True)
class Reach:
    """The window length at which an RMSE comes down to an error, in words."""

    value: str
    low: str | None
    """Lower end of its 95% interval, by bootstrap over recordings, the same ones at every length
    (over windows where one recording has them all); None with one window a length"""
    high: str | None
    """Upper end, likewise"""


def times_to_reach(
    errors: Mapping[float, tuple[np.ndarray, np.ndarray]], targets_deg: Sequence[float]
) -> dict[float, Reach]:
    """The window length that each target takes, by target, degrees.

    errors : window length in s -> errors (W,), rad, and each window's recording, (W,).
    """
    windows_s = sorted(errors)
    rmse = [_rmse_deg(errors[w][0]) for w in windows_s]
    drawn = _drawn_rmse_deg([errors[w] for w in windows_s])
    found = {}
    for target in targets_deg:
        low = high = None
        if drawn is not None:
            seconds = [_seconds(windows_s, row, target) for row in drawn]
            # The nearest drawn value, since infinity (no time at all) cannot be interpolated.
            low, high = (
                _in_words(float(end), windows_s)
                for end in np.percentile(seconds, [2.5, 97.5], method="nearest")
            )
        found[target] = Reach(time_to_reach(windows_s, rmse, target), low, high)
    return found


def _rmse_deg(errors: np.ndarray) -> float:
    """Root mean square of errors in rad, degrees."""
    return float(np.rad2deg(np.sqrt(np.mean(errors**2))))


def _drawn_rmse_deg(errors: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray | None:
    """RMSE of each resample at each window length, degrees, (B, L); None where one recording has
    only one window at some length."""
    every = np.unique(np.concatenate([recording for _, recording in errors]))
    if len(every) == 1:
        if min(len(e) for e, _ in errors) < 2:
            return None
        drawn = []
        for e, _ in errors:
            parts = [np.sqrt(w @ np.rad2deg(e) ** 2 / len(e)) for w in _resamples(len(e))]
            drawn.append(np.concatenate(parts))
        return np.stack(drawn, axis=1)
    squares, windows = np.zeros((2, len(every), len(errors)))
    for column, (e, recording) in enumerate(errors):
        own = np.searchsorted(every, recording)
        squares[:, column] = np.bincount(own, np.rad2deg(e) ** 2, len(every))
        windows[:, column] = np.bincount(own, minlength=len(every))
    sums = [(w @ squares, w @ windows) for w in _resamples(len(every))]
    total, count = (np.concatenate(part) for part in zip(*sums, strict=True))
    answered = (count > 0).all(
        axis=1
    )  # a resample may lack the few recordings that are long enough
    return np.asarray(np.sqrt(total[answered] / count[answered]))


def time_to_reach(windows_s: Sequence[float], rmse_deg: Sequence[float], error_deg: float) -> str:
    """The window length from which on an estimator's RMSE is not above this error, in words. It is
    interpolated between window lengths, both in logarithms; "not within 240 s" where the longest
    window is too short.

    windows_s : ascending, s.
    """
    return _in_words(_seconds(windows_s, rmse_deg, error_deg), windows_s)


def _in_words(seconds: float, windows_s: Sequence[float]) -> str:
    """A window length by `_seconds` in words."""
    if seconds <= windows_s[0]:
        return f"<= {windows_s[0]:g} s"
    return f"not within {windows_s[-1]:g} s" if np.isinf(seconds) else f"{seconds:.3g} s"


def _seconds(
    windows_s: Sequence[float], rmse_deg: Sequence[float] | np.ndarray, error_deg: float
) -> float:
    """The window length, s, from which on the RMSE is not above this error: the shortest length
    where that is enough already, infinity where the longest is too short."""
    above = [i for i, rmse in enumerate(rmse_deg) if rmse > error_deg]
    if not above:
        return windows_s[0]
    last = above[-1]
    if last == len(windows_s) - 1:
        return np.inf
    x0, x1 = np.log(windows_s[last]), np.log(windows_s[last + 1])
    y0, y1 = np.log(rmse_deg[last]), np.log(max(rmse_deg[last + 1], 1e-12))
    return float(np.exp(x0 + (np.log(error_deg) - y0) / (y1 - y0) * (x1 - x0)))
