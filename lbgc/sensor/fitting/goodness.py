"""Whether a fitted model explains what was recorded: its spectrum, its Allan curve, and that the
noise is the same from beginning to end.

If the model is right, the power of a bin of ordinates over the model's is chi-squared, whatever
the noise is made of. The parameters were fitted to the same powers, though, and that takes out of
the residuals what they can follow. So the law of every statistic is found by drawing chi-squared
powers and taking out, to first order, what fitting to them would have taken.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.fft
import scipy.stats

from lbgc.sensor.fitting.likelihood import Likelihood
from lbgc.sensor.fitting.ordinates import Ordinates
from lbgc.sensor.fitting.shapes import Shape

FAILS = 0.05
"""Nominal chance of calling a right model wrong."""
_DRAWS = 999
_LEVELS = (4, 8, 16, 32, 64)
_EIGHTHS = 8
_ENOUGH = 50
"""Ordinates that an eighth of the log must have for its power to be compared."""


@dataclass(frozen=True)
class Band:
    """How the spectrum stands to the model in a band of frequencies."""

    low_hz: float
    high_hz: float
    ratio: float
    """Power over the model's."""
    sigmas: float
    """Normal number, in standard deviations, as improbable as the band's power."""


@dataclass(frozen=True)
class Goodness:
    """How well a model explains a recording."""

    p: float
    """Chance that a right model looks as bad, all tests taken together"""
    p_spectrum: float
    p_allan: float
    p_time: float
    bands: tuple[Band, ...]
    """From low to high frequency, all there is"""
    worst: Band
    """The band least explained, of bands of several widths"""
    unsteady: Band
    """Where the power changes most in time: the highest eighth of the log over the mean"""
    widening: tuple[float, ...]
    """What each parameter's standard error must be multiplied by where the model fails, from how
    differently the bands want the parameters"""

    @property
    def fails(self) -> bool:
        return self.p < FAILS

    @property
    def says(self) -> str:
        """What is not explained, in a sentence; empty where all is."""
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
    """Hold a fitted model against the data. series : (R, n); values : every parameter's, SI."""
    felt = [s for s in shapes if values[s.names[0]] > 0]
    likelihood = Likelihood(data, felt)
    p = np.log([values[name] for name in likelihood.names])
    v, J = likelihood.variance(p)
    A = J / v[:, None]
    # A bin that a tone cut into has what is left of it.
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
    spectrum = _together(each[0], each[1])
    frequency = _together(each[0], each[1], each[2])
    p_time, unsteady, uneven = _steadiness(series, data, v)
    p_all = _of_the_least(min(float(frequency[0]), p_time), 2)
    bands = _bands(observed[0], data, edges)
    level = _LEVELS.index(16)
    start = sum(_LEVELS[:level])
    worst = bands[int(np.argmax(np.abs(scores[0][0])))]
    widening = _widening(observed[0], data.count, A, edges[-1])
    all_names = [name for s in shapes for name in s.names]
    # Fast noise that comes and goes is known as well as its eighths agree.
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
    """Powers over the model as a right model would have them after its fit, (draws, M)."""
    rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence(952)))
    powers = rng.chisquare(count, (_DRAWS, len(count)))
    information = (A * count[:, None]).T @ A
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=1e-9, hermitian=True)
    step = (powers - count) @ A / size @ inverse / size
    # The model moves by a factor, which stays above zero.
    return np.asarray(powers / np.exp(np.clip(step @ A.T, -1, 1)))


def _edges(data: Ordinates, level: int) -> np.ndarray:
    """So many bands' first bins and the end: equal shares between the logarithm of frequency and
    frequency itself, no band without eight ordinates."""
    f = data.grid.f
    place = np.log(f / f[0]) / np.log(f[-1] / f[0]) + (f - f[0]) / (f[-1] - f[0])
    edges = np.searchsorted(place, np.linspace(0, 2, level + 1)[:-1])
    return np.append(edges, len(f))


def _sums(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Sums over the bands, (*S, bands)."""
    total = np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(values, axis=-1)], axis=-1)
    return np.asarray(total[..., edges[1:]] - total[..., edges[:-1]])


def _scores(powers: np.ndarray, count: np.ndarray, edges: list[np.ndarray]) -> np.ndarray:
    """Normal numbers as improbable as each band's power, all levels side by side: by Wilson and
    Hilferty's cube root, which is within a hundredth from eight ordinates on."""
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
    """Logarithm of the Allan variance over the model's at octaves of averaging time, (*S, K)."""
    f, dt = data.grid.f, data.dt
    octaves = int(np.log2(data.n / 8)) if data.n >= 16 else 0
    weights = []
    for tau in dt * 2.0 ** np.arange(octaves + 1):
        x = np.pi * f * tau
        turns = data.grid.width * tau
        # sin^4 over a bin that holds whole turns is 3/8
        wave = np.where(turns > 0.5, 0.375, np.sin(x) ** 4)
        weights.append(wave / np.sin(np.pi * f * dt) ** 2)
    model = np.array(weights) * v
    return np.asarray(np.log(powers @ model.T / (model @ data.count)))


def _p(observed: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """The share that is as large, of the observed statistic and of each drawn one, (1 + draws,)."""
    both = np.concatenate([observed, drawn])
    rank = len(both) - np.searchsorted(np.sort(both), both, side="left")
    return rank / len(both)


def _together(*each: np.ndarray) -> np.ndarray:
    """The share of draws in which the least of several such shares is as low, for the observed and
    each drawn one, (1 + draws,)."""
    least = -np.min(each, axis=0)
    return _p(least[:1], least[1:])


def _of_the_least(p: float, tests: int) -> float:
    """Chance that the least p of so many independent tests is as low: exact where p is tiny, and
    never zero."""
    return float(-np.expm1(tests * np.log1p(-np.clip(p, np.finfo(float).tiny, 1 - 1e-16))))


def _bands(powers: np.ndarray, data: Ordinates, edges: list[np.ndarray]) -> list[Band]:
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
    """Bartlett's test of the power in the log's eighths, in bands of three octaves of the whitened
    series: (p, where it changes most, the eighths' scatter in the highest band over chance's)."""
    n, dt = data.n, data.dt
    k = np.arange(n)
    root = np.exp(np.interp(k, data.k, np.log(v) / 2))
    tones = [round(t.f * 2 * n * dt) for t in data.tones]
    edges = [n]
    while edges[-1] / 8 * 7 / 8 / _EIGHTHS * len(series) >= _ENOUGH and edges[-1] > 64:
        edges.append(max(edges[-1] // 8, 1))
    energy = np.zeros((len(edges) - 1, len(series), _EIGHTHS))
    for r, one in enumerate(series):
        white = scipy.fft.dct(one - np.mean(one, dtype=float), norm="ortho") * np.sqrt(dt) / root
        for tone in tones:
            white[max(tone - 60, 0) : tone + 61] = 0
        for b, (high, low) in enumerate(pairwise(edges)):
            inside = np.where((k >= low) & (k < high), white, 0.0)
            squares = scipy.fft.idct(inside, norm="ortho") ** 2
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
    return _of_the_least(min(each), len(each)), where, scatter


def bartlett(energy: np.ndarray, freedom: float) -> float:
    """p of equal variances: energy (G,), each chi-squared with so many degrees of freedom."""
    groups = len(energy)
    statistic = groups * freedom * np.log(energy.mean()) - freedom * np.sum(np.log(energy))
    statistic /= 1 + (groups / freedom - 1 / (groups * freedom)) / (3 * (groups - 1))
    return float(scipy.stats.chi2.sf(statistic, groups - 1))


def _widening(
    powers: np.ndarray, count: np.ndarray, A: np.ndarray, edges: np.ndarray
) -> np.ndarray:
    """Standard errors that count how differently bands want each parameter (Huber's sandwich, band
    by band), over those of a right model: (P,), 1 or more."""
    scores = _sums(((powers - count)[:, None] * A).T / 2, edges)  # (P, bands)
    information = 0.5 * (A * count[:, None]).T @ A
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=1e-9, hermitian=True)
    inverse = inverse / np.outer(size, size)
    sandwich = inverse @ (scores @ scores.T) @ inverse
    plain = np.maximum(np.diag(inverse), 1e-300)
    return np.sqrt(np.maximum(np.diag(sandwich) / plain, 1.0))
