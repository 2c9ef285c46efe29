"""The counts of a recording: their size, whether the noise dithers them, and the white noise before
rounding where it does not.

A sample is printed as the count it falls into, y = LSB round(x/LSB). Where x's fast noise exceeds
0.65 counts, rounding adds white noise of LSB^2/12 and nothing else (Sheppard's correction, whose
first neglected term is below 0.3% of the variance, wherever the mean lies). With less noise the
second moments of y tell x's noise wrongly, by an amount that depends on where the mean lies within
a count, and the likelihood of the counts themselves is needed. With the counts' edges known,

    P(y = k) = Phi((k + 1/2 - m(t))/sigma) - Phi((k - 1/2 - m(t))/sigma),

an ordered probit regression, with m(t) a few slow cosines and tones, whose log-likelihood is
concave in (1/sigma, m/sigma). It holds for white noise; correlated residuals show that it does not.

Where the remainder of each rounding is carried over to the next sample (pulses of an integrated
rate), the sum of counts follows the sum of x to within a count. If x's noise dithers the phase,
that is angle quantisation; if not, the counts beat with the mean rate: lines at all multiples of
rate over count, and their aliases, hide the noise.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize
import scipy.special

from lbgc.sensor.noise import Rounding

ENOUGH = 0.65
"""Counts of fast noise, 1 sigma, from which on rounding is plain white noise."""
_MOST_LEVELS = 4096  # different counts of a recording, at most
_SHAKEN = 0.15  # half the variance of differences, counts^2, below which roundings are correlated
_BLOCKS = 256  # stretches of a recording in which a slow mean is constant
_SLOW = (0, 6, 30, 100)  # numbers of cosines that are tried for a slow mean
_TONES = 4  # tones, at most
_LAGS = 30  # lags over which residuals are tested for correlation
_FIVE_SIGMA = 2.9e-7  # one-sided probability beyond five standard deviations
_MOST_SAMPLES = 200_000  # samples, at most, where they are taken one by one, as for tones
_QUIETEST = 0.04  # counts of noise, below which the counts tell nothing
_PHASE = 0.2  # counts of noise a sample that dither the phase of carried counts
_PHASES = 64  # samples, at most, over whose sum that dither is looked for
_STRETCH = 4.0  # variance of a stretch's sum, counts^2, for the test of carried counts
_STRETCHES = 16  # least number of stretches for that test
_BY_CHANCE = 1e-5  # p-value below which that test finds carried counts
_SEEN = 0.15  # standard error of ln sigma, above which the noise has an upper limit only


@dataclass(frozen=True)
class Counts:
    """The counts of a recording and what they do to its noise."""

    lsb: float
    """Size of a count, in the recording's unit, SI"""
    sigma: float
    """Standard deviation of the fast noise before rounding, in counts"""
    low: float
    """Lower end of sigma's 95% interval; 0: the counts give an upper limit only"""
    high: float
    """Upper end of sigma's 95% interval"""
    upper: float
    """One-sided 95% upper limit of sigma"""
    kind: str
    """dithered: rounding is white noise; carried: the remainder of each rounding is carried over to
    the next sample, so that it is angle quantisation; beating: carried over, and not dithered by
    the noise; coarse: not dithered, and sigma is from the counts' likelihood; memory: coarse, and
    the noise is not white, or changes of count are too few to tell whether the remainder is carried
    over, so that N cannot be told from sigma"""
    blur: float
    """The largest share of a slow change of the mean by which the mean of the counts can differ
    from it: 2 exp(-2 pi^2 sigma^2), less where tones dither the counts"""

    @property
    def hides_noise(self) -> bool:
        """Whether the noise does not dither the counts, so that no spectrum shows it."""
        return self.kind in ("coarse", "memory", "beating")

    def rounding(self, dt: float) -> float:
        """Density of the samples' rounding noise, unit^2 s; zero unless the counts are dithered."""
        return Rounding.to(self.lsb, dt).N ** 2 if self.kind == "dithered" else 0.0


def count_size(series: np.ndarray) -> float | None:
    """The size of a recording's counts, the common increment of its values, or None where there is
    none. series : (...), unit. Values may be printed to a few digits or as float32: increments are
    multiples of the count to within that."""
    if len(np.unique(series[..., :_MOST_SAMPLES])) > _MOST_LEVELS:
        return None
    levels = np.unique(series)
    if not 2 <= len(levels) <= _MOST_LEVELS or len(levels) > np.size(series) / 2:
        return None
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-6 * (levels[-1] - levels[0])]
    smallest = np.sort(gaps)[: max(1, len(gaps) // 5)]
    lsb = float(np.median(smallest))
    for _ in range(3):
        multiples = np.maximum(np.round(gaps / lsb), 1)
        lsb = float(np.sum(gaps) / np.sum(multiples))
    off = np.abs(gaps / lsb - multiples)
    return lsb if np.quantile(off, 0.95) < 0.15 else None


def judged(series: np.ndarray) -> Counts | None:
    """Find a recording's counts and what they do to its noise, or None where it has no counts.
    series : (n,), unit, one recording at even intervals."""
    lsb = count_size(series)
    if lsb is None:
        return None
    y = np.asarray(series, float) / lsb
    y = np.round(y - y.min())
    some = y[:_MOST_SAMPLES]
    slow = _cosines(len(some), _SLOW[-2] + 1)
    waves = _tones(some - some.mean())
    design = np.column_stack([slow, waves])
    rest = some - design @ np.linalg.lstsq(design, some, rcond=None)[0]
    variance = float(np.var(rest)) - 1 / 12
    differences = float(np.mean(np.diff(rest) ** 2)) / 2 - 1 / 12
    level = some - slow @ np.linalg.lstsq(slow, some, rcond=None)[0]
    undone = _sums_cancel(level)
    carried = _carried(rest) or bool(undone)
    if carried or (variance > ENOUGH**2 and differences > _SHAKEN):
        sigma = float(np.sqrt(max(variance - carried / 12, 0.0)))
        kind = "dithered" if not carried else "carried" if _is_shaken(level) else "beating"
        return Counts(lsb, sigma, sigma, sigma, sigma, kind, 0.0)
    coarse = _coarse(lsb, y, waves)
    if undone is None and coarse.kind == "coarse" and coarse.low > 0:
        return replace(coarse, kind="memory")
    return coarse


def _carried(rest: np.ndarray) -> bool:
    """Whether the rounding errors of neighbours cancel: their covariance is -1/12 where the
    remainder is carried over, and zero or more where each sample is rounded by itself."""
    covariance = np.mean(rest[1:] * rest[:-1])
    sigma = np.var(rest) / np.sqrt(len(rest))
    return bool(covariance < -1 / 24 and covariance < -3 * sigma)


def _sums_cancel(rest: np.ndarray) -> bool | None:
    """Whether sums over stretches scatter far less than those of samples that are rounded one by
    one, as they do where the remainder is carried over; None where changes of count are too few."""
    variance = float(np.var(rest))
    length = max(1, int(_STRETCH / max(variance, 1e-12)))
    number = len(rest) // length
    if number < _STRETCHES:
        return None
    ratio = _sum_variance(rest, length) / (length * variance)
    freedom = (number - 1) * 2 / 3  # of a variance from differences between neighbours
    chance = float(scipy.special.gammainc(freedom / 2, ratio * freedom / 2))
    return ratio < 0.3 and chance < _BY_CHANCE


def _is_shaken(rest: np.ndarray) -> bool:
    """Whether noise moves the phase of carried counts enough that they do not beat. With 0.2 counts
    a sample a beat is gone in two periods. Sums over stretches differ by the noise between them and
    by three roundings, one of them twice: var/2 = n sigma^2 + 6/24."""
    length = max(1, min(_PHASES, len(rest) // _STRETCHES))
    noise = _sum_variance(rest, length) - 0.25
    return noise > length * _PHASE**2


def _sum_variance(rest: np.ndarray, length: int) -> float:
    """Variance of sums over `length` samples, from their differences, which leave slow noise
    out."""
    number = len(rest) // length
    sums = rest[: number * length].reshape(number, length).sum(axis=1)
    return float(np.mean(np.diff(sums) ** 2)) / 2


def _cosines(n: int, count: int) -> np.ndarray:
    """The constant and the slowest cosines on an even grid of n samples, (n, count)."""
    return np.cos(np.pi * np.outer(np.arange(n) + 0.5, np.arange(count)) / n)


def _tones(y: np.ndarray) -> np.ndarray:
    """Cosine and sine, (n, 2 T), of each steady tone that stands out of the spectrum of y (n,) and
    exceeds a twentieth of a count. Frequencies are found to a hundredth of the resolution."""
    n = len(y)
    window = np.hanning(n)
    found: list[np.ndarray] = []
    t = np.arange(n)
    for _ in range(_TONES):
        power = np.abs(np.fft.rfft(y * window)) ** 2
        power[: max(40, n // 2000)] = 0
        if not power.any():  # too short to tell a tone from a slow change
            break
        top = int(np.argmax(power[:-1]))
        level = float(np.mean(power[power > 0])) + 1e-300
        amplitude = 2 * np.sqrt(power[top]) / np.sum(window)
        if amplitude < 0.05 or power[top] < 40 * level:
            break

        def away(f: float, y: np.ndarray = y) -> float:
            return float(-abs(np.sum(y * window * np.exp(-2j * np.pi * f * t))))

        best = scipy.optimize.minimize_scalar(
            away,
            bounds=((top - 1) / n, (top + 1) / n),
            method="bounded",
            options={"xatol": 0.005 / n},
        )
        phase = 2 * np.pi * best.x * t
        wave = np.column_stack([np.cos(phase), np.sin(phase)])
        found.append(wave)
        y = y - wave @ np.linalg.lstsq(wave, y, rcond=None)[0]
    return np.column_stack(found) if found else np.empty((n, 0))


@dataclass(frozen=True)
class _Rows:
    """The data of the likelihood: each row stands for `weight` samples of the count `level` whose
    mean has the regressors `design` (rows, b)."""

    design: np.ndarray
    level: np.ndarray
    weight: np.ndarray
    of_sample: np.ndarray
    """(n,), each sample's row"""


def _rows(y: np.ndarray, waves: np.ndarray, slow: int) -> _Rows:
    """The rows of counts y (n,) with `slow` cosines for the mean, and with tones' waves (n, 2 T).
    Without tones, equal counts in a stretch are one row."""
    n = len(y)
    if waves.size:
        n = min(n, _MOST_SAMPLES)
        design = np.column_stack([_cosines(n, slow + 1), waves[:n]])
        return _Rows(design, y[:n], np.ones(n), np.arange(n))
    block = np.minimum(np.arange(n) * _BLOCKS // n, _BLOCKS - 1)
    pairs, row, weight = np.unique(
        block * (_MOST_LEVELS + 1) + y.astype(int), return_inverse=True, return_counts=True
    )
    at, level = np.divmod(pairs, _MOST_LEVELS + 1)
    return _Rows(_cosines(_BLOCKS, slow + 1)[at], level.astype(float), weight, row.ravel())


def _cell(rows: _Rows, gamma: float, eta: np.ndarray) -> tuple[np.ndarray, ...]:
    """Logarithm of each row's probability; the normal density at its upper and lower edge, over the
    probability; and these edges over sigma, about the mean eta sigma. Each is evaluated in the tail
    where both edges' probabilities are small, so that nothing cancels."""
    upper, lower = gamma * (rows.level + 0.5) - eta, gamma * (rows.level - 0.5) - eta
    flip = upper + lower > 0
    a, b = np.where(flip, -upper, lower), np.where(flip, -lower, upper)
    larger, smaller = scipy.special.log_ndtr(b), scipy.special.log_ndtr(a)
    log_p = larger + np.log1p(-np.exp(np.minimum(smaller - larger, -1e-12)))
    constant = 0.5 * np.log(2 * np.pi)
    at_upper, at_lower = (np.exp(-0.5 * e**2 - constant - log_p) for e in (upper, lower))
    return log_p, at_upper, at_lower, upper, lower


def _maximise(
    rows: _Rows, gamma: float, b: np.ndarray, fixed: bool = False
) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Maximise the concave log-likelihood by Newton's method, from 1/sigma = gamma and mean/sigma =
    design b; `fixed` holds gamma. Returns the log-likelihood, gamma, b and minus the Hessian."""
    w, X = rows.weight, rows.design
    most = 1 / _QUIETEST
    value = float(w @ _cell(rows, gamma, X @ b)[0])
    hessian = np.eye(1 + len(b))
    for _ in range(50):
        _, up, low, u, v = _cell(rows, gamma, X @ b)
        k_up, k_low = rows.level + 0.5, rows.level - 0.5
        s = low - up  # derivative by eta
        g = k_up * up - k_low * low  # derivative by gamma
        bend = u * up - v * low + s**2  # minus the second derivatives
        mixed = k_up * (-u * up) - k_low * (-v * low) + g * s
        own = k_up**2 * u * up - k_low**2 * v * low + g**2
        gradient = np.concatenate([[w @ g], X.T @ (w * s)])
        corner, side = w @ own, X.T @ (w * mixed)
        inner = X.T @ (X * (w * bend)[:, None])
        hessian = np.block([[np.array([[corner]]), side[None]], [side[:, None], inner]])
        free = slice(1, None) if fixed else slice(None)
        part = hessian[free, free]
        ridge = 1e-10 * np.trace(part) / len(part) + 1e-12
        step = np.zeros(len(gradient))
        step[free] = np.linalg.solve(part + ridge * np.eye(len(part)), gradient[free])
        for _ in range(30):
            new = float(np.clip(gamma + step[0], 1e-3, most))
            trial = float(w @ _cell(rows, new, X @ (b + step[1:]))[0])
            if trial >= value - 1e-12 * abs(value):
                break
            step = step / 2
        gained, gamma, b, value = trial - value, new, b + step[1:], trial
        if gained < 1e-6:
            break
    return value, gamma, b, hessian


def _coarse(lsb: float, y: np.ndarray, waves: np.ndarray) -> Counts:
    """The counts by their own likelihood, with the number of slow cosines that suits them best."""
    best = None
    for slow in _SLOW:
        if slow > len(y) / 200:
            break
        rows = _rows(y, waves, slow)
        centre = np.average(rows.level, weights=rows.weight)
        b = np.zeros(rows.design.shape[1])
        b[0] = centre / 0.4
        found = _maximise(rows, 1 / 0.4, b)
        cost = -2 * found[0] + len(b) * np.log(len(rows.of_sample))
        if best is None or cost < best[0] - 6:
            best = cost, rows, found
    assert best is not None
    _, rows, (value, gamma, b, hessian) = best
    s = _residuals(rows, gamma, b)
    spread = _batch_spread(rows, gamma, b, hessian)
    low, high, upper = _limits(rows, gamma, b, value, spread, hessian)
    sigma = 1 / gamma
    swing = rows.design[:, len(b) - waves.shape[1] :] @ b[len(b) - waves.shape[1] :] * sigma
    shaken = abs(np.average(np.exp(2j * np.pi * swing), weights=rows.weight)) if waves.size else 1.0
    seen = sigma if low > 0 else upper
    blur = float(2 * np.exp(-2 * (np.pi * (sigma if low > 0 else 0.0)) ** 2) * shaken)
    kind = "coarse"
    if _are_correlated(s):
        kind = "memory" if seen < 0.5 else "dithered"
    elif sigma > ENOUGH:
        kind = "dithered"
    return Counts(lsb, sigma, low, high, upper, kind, blur)


def _residuals(rows: _Rows, gamma: float, b: np.ndarray) -> np.ndarray:
    """The residual of each sample, (n,): the derivative of its log-likelihood by its mean."""
    _, up, low, *_ = _cell(rows, gamma, rows.design @ b)
    return np.asarray((low - up)[rows.of_sample])


def _are_correlated(s: np.ndarray) -> bool:
    """Whether the residuals s (n,) are correlated at short lags, by five standard errors at one of
    the lags or over them all.

    Where few samples leave the commonest count, residuals are few and large, and their products at
    a lag are events that can be counted: with e = (sum s^2)^2/sum s^4 large residuals, e^2/n pairs
    are expected at each lag, by Poisson's law."""
    n = len(s)
    s = s - s.mean()
    spectrum = np.abs(np.fft.rfft(s, 2 * n)) ** 2
    covariance = np.fft.irfft(spectrum)[: _LAGS + 1]
    z = covariance[1:] / max(covariance[0], 1e-300) * np.sqrt(n)
    events = np.sum(s**2) ** 2 / max(np.sum(s**4), 1e-300)
    pairs = events**2 / n
    return bool(_is_rare(z, pairs).any() or _is_rare(z.sum() / np.sqrt(_LAGS), pairs * _LAGS).any())


def _is_rare(z: np.ndarray, expected: float) -> np.ndarray:
    """Whether numbers of events that are z standard deviations off the expected number are as
    improbable, by Poisson's law, as a standard normal number beyond 5."""
    number = np.maximum(expected + z * np.sqrt(expected), 1e-9)
    above = scipy.special.gammainc(number, expected)
    below = scipy.special.gammaincc(number + 1, expected)
    return np.asarray(np.minimum(above, below) < _FIVE_SIGMA)


def _batch_spread(rows: _Rows, gamma: float, b: np.ndarray, hessian: np.ndarray) -> float:
    """The variance of the score of 1/sigma, with the mean's parameters eliminated, over its value
    for independent samples, at least 1. It is taken from sums over a hundred batches of neighbours
    (the middle of a sandwich estimator)."""
    _, up, low, *_ = _cell(rows, gamma, rows.design @ b)
    g = (rows.level + 0.5) * up - (rows.level - 0.5) * low
    side = np.linalg.lstsq(hessian[1:, 1:], hessian[1:, 0], rcond=None)[0]
    effective = (g - (low - up) * (rows.design @ side))[rows.of_sample]
    sums = np.array([part.sum() for part in np.array_split(effective - effective.mean(), 100)])
    ratio = float(np.mean(sums**2) / (len(effective) / 100) / max(np.var(effective), 1e-300))
    return ratio if ratio > 1 + 3 * np.sqrt(2 / 100) else 1.0


def _limits(
    rows: _Rows, gamma: float, b: np.ndarray, value: float, spread: float, hessian: np.ndarray
) -> tuple[float, float, float]:
    """sigma's 95% interval and one-sided upper limit, in counts. They come from the profile
    likelihood, whose ratio is divided by the spread, or from the curvature at the maximum where
    sigma is known to within 2%."""
    side = hessian[1:, 0] @ np.linalg.lstsq(hessian[1:, 1:], hessian[1:, 0], rcond=None)[0]
    curvature = max(float(hessian[0, 0] - side) * gamma**2 / spread, 1e-12)
    error, sigma = 1 / np.sqrt(curvature), 1 / gamma
    if error < 0.02:
        return tuple(float(sigma * np.exp(z * error)) for z in (-1.96, 1.96, 1.645))  # type: ignore[return-value]

    def excess(log_sigma: float) -> float:
        g = float(np.exp(-log_sigma))
        return 2 * (value - _maximise(rows, g, b * g / gamma, fixed=True)[0]) / spread

    centre = float(np.log(sigma))
    most = centre + 3.0
    high, upper = (
        scipy.optimize.brentq(lambda x, t=t: excess(x) - t, centre, most, xtol=1e-3)
        if excess(most) > t
        else most
        for t in (3.841, 2.706)
    )
    least = float(np.log(_QUIETEST))
    told = error < _SEEN and centre > least + 0.1 and excess(least) > 3.841
    low = (
        scipy.optimize.brentq(lambda x: excess(x) - 3.841, least, centre, xtol=1e-3) if told else 0
    )
    return float(np.exp(low)) if told else 0.0, float(np.exp(high)), float(np.exp(upper))
