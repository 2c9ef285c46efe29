"""Goodness of fit: whether a fitted model explains a recording's spectrum and its Allan curve, and
whether the noise is the same from beginning to end.

If the model is right, the power of a bin of ordinates over the model's is chi-squared, whatever
the noise is made of. But the parameters were fitted to the same powers, which removes from the
residuals what the parameters can follow. So the law of every statistic is found by drawing
chi-squared powers and removing, to first order, what a fit to them would remove.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.fft
import scipy.stats

from lbgc.sensor.fitting.likelihood import Likelihood
from lbgc.sensor.fitting.ordinates import Ordinates, transformed
from lbgc.sensor.fitting.shapes import Shape

FAILS = 0.05
"""Nominal chance that a right model is called wrong."""
_DRAWS = 999
"""Sets of powers that are drawn"""
_LEVELS = (4, 8, 16, 32, 64)
"""Numbers of bands into which the spectrum is divided"""
_EIGHTHS = 8
"""Parts of the log whose powers are compared"""
_AT_ONCE = 2**20
"""Coefficients that are whitened in one go."""
_ENOUGH = 50
"""Ordinates that an eighth of the log must have in a band for its power to be compared."""


@dataclass(frozen=True)
class Band:
    """The spectrum compared with the model in a band of frequencies."""

    low_hz: float
    """Lower end of the band, Hz"""
    high_hz: float
    """Upper end of the band, Hz"""
    ratio: float
    """The recorded power over the model's"""
    sigmas: float
    """The standard normal number that is as improbable as the band's power"""


@dataclass(frozen=True)
class Goodness:
    """The goodness of fit of a model to a recording."""

    p: float
    """The p-value of all tests together: the chance that a right model looks as bad"""
    p_spectrum: float
    """The p-value of the spectrum, by bands"""
    p_allan: float
    """The p-value of the Allan curve"""
    p_time: float
    """The p-value of the noise being steady in time"""
    bands: tuple[Band, ...]
    """Sixteen bands that cover the spectrum, from low to high frequency"""
    worst: Band
    """The band that is explained worst, among bands of several widths"""
    unsteady: Band
    """The band whose power changes most in time; its ratio is the power of the log's highest eighth
    over the mean's"""
    widening: tuple[float, ...]
    """The factor by which each parameter's standard error must be multiplied where the model fails,
    from how much the bands disagree about the parameters"""

    @property
    def fails(self) -> bool:
        """Whether the model is rejected: `p` is below `FAILS`."""
        return self.p < FAILS

    @property
    def says(self) -> str:
        """A sentence that says what the model does not explain; empty where it does not fail."""
        if not self.fails:
            return ""
        p = "p < 0.001" if self.p < 0.001 else f"p = {self.p:.2g}"
        if self.p_time <= min(self.p_spectrum, self.p_allan):
            u = self.unsteady
            return (
                f"the noise from {u.low_hz:.3g} to {u.high_hz:.3g} Hz is not steady: one eighth of "
                f"the log has {u.ratio:.3g} times the mean's power ({p})"
            )
        w = self.worst
        much = f"{abs(w.ratio - 1) * 100:.2g}% {'above' if w.ratio > 1 else 'below'}"
        return (
            f"the band from {w.low_hz:.3g} to {w.high_hz:.3g} Hz is not explained: its power is "
            f"{much} the model's ({p})"
        )


def judge(
    series: np.ndarray, data: Ordinates, shapes: list[Shape], values: dict[str, float]
) -> Goodness:
    """Test a fitted model against the data. series : (R, n), unit, the series that the data were
    made of; values : of every parameter, SI."""
    felt = [s for s in shapes if values[s.names[0]] > 0]
    likelihood = Likelihood(data, felt)
    p = np.log([values[name] for name in likelihood.names])
    v, J = likelihood.variance(p)
    A = J / v[:, None]
    observed = (data.power / v)[None]
    drawn = _drawn(data.count, A)
    edges = [_edges(data, level) for level in _LEVELS]
    scores = [_scores(both, data.count, edges) for both in (observed, drawn)]
    squares = [np.sum(s[:, -_LEVELS[-1] :] ** 2, axis=1) for s in scores]
    allan = [_allan(both, data, v) for both in (observed, drawn)]
    spread = np.std(allan[1], axis=0)
    off = [np.max(np.abs(a) / spread, axis=1) for a in allan]
    highest = [np.max(np.abs(s), axis=1) for s in scores]
    each = [_p(*both) for both in (highest, squares, off)]
    spectrum = _joint_p(each[0], each[1])
    frequency = _joint_p(each[0], each[1], each[2])
    p_time, unsteady, uneven = _steadiness(series, data, v)
    p_all = _p_of_least(min(float(frequency[0]), p_time), 2)
    bands = _bands(observed[0], data, edges)
    level = _LEVELS.index(16)
    start = sum(_LEVELS[:level])
    worst = bands[int(np.argmax(np.abs(scores[0][0])))]
    widening = _widening(observed[0], data.count, A, edges[-1])
    all_names = [name for s in shapes for name in s.names]
    # Where fast noise is not steady, it is known only as well as the log's eighths agree.
    fast = np.array([name == "N" or name.startswith("line_sigma") for name in likelihood.names])
    widening = np.where(fast & (p_time < FAILS), np.maximum(widening, uneven), widening)
    wide = dict(zip(likelihood.names, widening, strict=True))
    return Goodness(
        p_all,
        float(spectrum[0]),
        float(each[2][0]),
        float(p_time),
        tuple(bands[start : start + 16]),
        worst,
        unsteady,
        tuple(float(wide.get(name, 1.0)) for name in all_names),
    )


def _drawn(count: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Drawn powers over the model's, as a right model has them after it was fitted, (draws, M).
    A : (M, P), derivative of the logarithm of the model's density by the log-parameters."""
    rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence(952)))
    powers = rng.chisquare(count, (_DRAWS, len(count)))
    information = (A * count[:, None]).T @ A
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=1e-9, hermitian=True)
    step = (powers - count) @ A / size @ inverse / size
    # The fit multiplies the model's density by this factor, which is bounded.
    return np.asarray(powers / np.exp(np.clip(step @ A.T, -1, 1)))


def _edges(data: Ordinates, level: int) -> np.ndarray:
    """The edges, in bins, of `level` bands: (level + 1,). The bands are equally wide on the scale
    that is the sum of frequency and its logarithm, each over its range."""
    f = data.grid.f
    place = np.log(f / f[0]) / np.log(f[-1] / f[0]) + (f - f[0]) / (f[-1] - f[0])
    edges = np.searchsorted(place, np.linspace(0, 2, level + 1)[:-1])
    return np.append(edges, len(f))


def _sums(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Sums of values (*S, M) over the bands, (*S, bands)."""
    total = np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(values, axis=-1)], axis=-1)
    return np.asarray(total[..., edges[1:]] - total[..., edges[:-1]])


def _scores(powers: np.ndarray, count: np.ndarray, edges: list[np.ndarray]) -> np.ndarray:
    """The standard normal numbers that are as improbable as each band's power, of all levels side
    by side. They come from Wilson and Hilferty's cube root, which is within a hundredth from eight
    ordinates on; a band with fewer has 0."""
    out = []
    for one in edges:
        c = _sums(count, one)
        ratio = _sums(powers, one) / np.maximum(c, 1)
        cube = (np.cbrt(ratio) - (1 - 2 / (9 * np.maximum(c, 1)))) / np.sqrt(
            2 / (9 * np.maximum(c, 1))
        )
        out.append(np.where(c >= 8, cube, 0.0))
    return np.concatenate(out, axis=-1)


def _allan(powers: np.ndarray, data: Ordinates, v: np.ndarray) -> np.ndarray:
    """Logarithm of the Allan variance over the model's, at octaves of averaging time, (*S, K), from
    powers over the model's (*S, M) and the model's density v (M,)."""
    f, dt = data.grid.f, data.dt
    octaves = int(np.log2(data.n / 8)) if data.n >= 16 else 0
    weights = []
    for tau in dt * 2.0 ** np.arange(octaves + 1):
        x = np.pi * f * tau
        turns = data.grid.width * tau
        # The mean of sin^4 over a bin that is as wide as whole periods is 3/8.
        wave = np.where(turns > 0.5, 0.375, np.sin(x) ** 4)
        weights.append(wave / np.sin(np.pi * f * dt) ** 2)
    model = np.array(weights) * v
    return np.asarray(np.log(powers @ model.T / (model @ data.count)))


def _p(observed: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """The p-values of an observed statistic and of each drawn one, (1 + draws,): the share of all
    of them that is as large."""
    both = np.concatenate([observed, drawn])
    rank = len(both) - np.searchsorted(np.sort(both), both, side="left")
    return rank / len(both)


def _joint_p(*each: np.ndarray) -> np.ndarray:
    """The p-values of several tests together, (1 + draws,), from those of each test: the share of
    the draws in which the least of the tests' p-values is as low."""
    least = -np.min(each, axis=0)
    return _p(least[:1], least[1:])


def _p_of_least(p: float, tests: int) -> float:
    """The chance that the least p-value of several independent tests is as low as p: exact where p
    is tiny, and never zero."""
    return float(-np.expm1(tests * np.log1p(-np.clip(p, np.finfo(float).tiny, 1 - 1e-16))))


def _bands(powers: np.ndarray, data: Ordinates, edges: list[np.ndarray]) -> list[Band]:
    """The bands of all levels, one level after the other; powers : (M,), over the model's."""
    scores = _scores(powers[None], data.count, edges)[0]
    f, half = data.grid.f, data.grid.width / 2
    out = []
    for one in edges:
        c, s = _sums(data.count, one), _sums(powers, one)
        for a, b, cc, ss in zip(one[:-1], one[1:], c, s, strict=True):
            last = max(b - 1, a)
            at = min(a, len(f) - 1), min(last, len(f) - 1)
            low, high = f[at[0]] - half[at[0]], f[at[1]] + half[at[1]]
            out.append(Band(float(low), float(high), float(ss / max(cc, 1)), 0.0))
    return [Band(b.low_hz, b.high_hz, b.ratio, float(s)) for b, s in zip(out, scores, strict=True)]


def _steadiness(series: np.ndarray, data: Ordinates, v: np.ndarray) -> tuple[float, Band, float]:
    """Test by Bartlett's test whether the power is the same in the eighths of the log, in bands of
    three octaves of the whitened series. Returns the p-value, the band where the power changes
    most, and the scatter of the eighths in the highest band over the scatter by chance."""
    n, dt = data.n, data.dt
    tones = [round(t.f * 2 * n * dt) for t in data.tones]
    edges = [n]
    while edges[-1] / 8 * 7 / 8 / _EIGHTHS * len(series) >= _ENOUGH and edges[-1] > 64:
        edges.append(max(edges[-1] // 8, 1))
    energy = np.zeros((len(edges) - 1, len(series), _EIGHTHS))
    for r, one in enumerate(series):
        white = transformed(one, dt)
        for first in range(0, n, _AT_ONCE):
            k = np.arange(first, min(first + _AT_ONCE, n))
            white[first : first + len(k)] /= np.exp(np.interp(k, data.k, np.log(v) / 2))
        for tone in tones:
            white[max(tone - 60, 0) : tone + 61] = 0
        for b, (high, low) in enumerate(pairwise(edges)):
            inside = np.zeros(n)
            inside[low:high] = white[low:high]
            squares = scipy.fft.idct(inside, norm="ortho", overwrite_x=True)
            np.square(squares, out=squares)
            energy[b, r] = [np.sum(e) for e in np.array_split(squares, _EIGHTHS)]
    if len(edges) == 1:
        return 1.0, Band(0.0, 0.5 / dt, 1.0, 0.0), 1.0
    flat = energy.reshape(len(energy), -1)
    freedom = [(high - low) / _EIGHTHS for high, low in pairwise(edges)]
    each = [bartlett(e, d) for e, d in zip(flat, freedom, strict=True)]
    at = int(np.argmin(each))
    ratio = float(flat[at].max() / flat[at].mean())
    sigmas = float(scipy.stats.norm.isf(max(each[at], 1e-300)))
    where = Band(edges[at + 1] / (2 * n * dt), edges[at] / (2 * n * dt), ratio, sigmas)
    scatter = float(np.std(flat[0]) / flat[0].mean() / np.sqrt(2 / freedom[0]))
    return _p_of_least(min(each), len(each)), where, scatter


def bartlett(energy: np.ndarray, freedom: float) -> float:
    """The p-value of Bartlett's test of equal variances: energy (G,), sums of squares that are
    chi-squared with `freedom` degrees of freedom each."""
    groups = len(energy)
    statistic = groups * freedom * np.log(energy.mean()) - freedom * np.sum(np.log(energy))
    statistic /= 1 + (groups / freedom - 1 / (groups * freedom)) / (3 * (groups - 1))
    return float(scipy.stats.chi2.sf(statistic, groups - 1))


def _widening(
    powers: np.ndarray, count: np.ndarray, A: np.ndarray, edges: np.ndarray
) -> np.ndarray:
    """The factor on each parameter's standard error, (P,), 1 or more: standard errors from how much
    the bands disagree about the parameter (Huber's sandwich estimator with bands as groups) over
    those of a right model."""
    scores = _sums(((powers - count)[:, None] * A).T / 2, edges)  # (P, bands)
    information = 0.5 * (A * count[:, None]).T @ A
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=1e-9, hermitian=True)
    inverse = inverse / np.outer(size, size)
    sandwich = inverse @ (scores @ scores.T) @ inverse
    plain = np.maximum(np.diag(inverse), 1e-300)
    return np.sqrt(np.maximum(np.diag(sandwich) / plain, 1.0))
