"""Detection of changes of a resting recording's mean that its noise does not explain: a warm-up
that decays, a step, a straight drift, a change towards the end.

A random walk explains every slow course of the mean a little, so the likelihood decides: noise
alone (white noise, bias instability and random walk, with their best sizes) is compared with noise
(with sizes fitted again) and one course of the mean. If a decay in white noise is taken for a
random walk, the quiet end of the recording contradicts that, since a true random walk does not
become quiet.

The likelihood is Whittle's on the cosine transform of block means, with exact variances (see
`lbgc.sensor.fitting.cosine_variance`). In it the size of a course follows by weighted least
squares.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from lbgc.sensor.fitting.cosine_variance import Grid, density
from lbgc.sensor.gaussian import GaussianTerm
from lbgc.sensor.noise import Flicker, RandomWalk, White

_BLOCKS = 512
"""Block means of a recording, at most"""
_FEWEST = 64
"""Block means below which nothing is looked for"""
_CERTAIN = {"decay": 20.0, "rise": 20.0, "step": 30.0, "ramp": 30.0}
"""Twice the logarithm of the likelihood ratio from which on a course is taken as present. True
random walks, bias instabilities and Gauss-Markov processes stay below 10 in 99 recordings of 100
(below 19 for steps, of which there are more to choose from), and every 4.6 more is ten times rarer.
A random walk beside a short Gauss-Markov process looks like a straight drift to this model, which
has no such process: 28 was seen."""
_MOST = 3
"""Courses in one recording, at most"""
_ITERATIONS = 25
"""Scoring steps of a fit, at most"""
_SETTLED = 3.0
"""Time constants of a decay to be cut, after which 5% of it is left"""


@dataclass(frozen=True)
class MeanChange:
    """A course of the mean, that is a change of it that noise does not explain."""

    kind: str
    """decay: size e^(-t/time); rise: size e^(-(T - t)/time), towards the end T; step: by size at
    `time`; ramp: size t/T."""
    size: float
    """Size with its sign, unit"""
    sigma: float
    """Standard error of the size where the time is known, unit"""
    time: float
    """The time constant, or the time of the step, s"""
    low: float
    """Lower end of the 95% interval of the time, s"""
    high: float
    """Upper end of that interval, s"""
    ratio: float
    """Twice the logarithm of the likelihood ratio to noise alone"""
    duration: float
    """The recording's duration T, s"""

    def means(self, edges: np.ndarray) -> np.ndarray:
        """The course's means between consecutive edges (J + 1,), s: (J,), unit."""
        return np.asarray(
            self.size * _means(self.kind, np.array([self.time]), edges, self.duration)[0]
        )

    @property
    def skip_s(self) -> float | None:
        """The seconds to cut from the recording's start so that at most 5% of the course is left;
        None where that would cut more than 60% of the recording, or for a rise or a ramp."""
        cut = {"decay": _SETTLED * self.time, "step": self.time}.get(self.kind, np.inf)
        return float(cut) if cut <= 0.6 * self.duration else None


def _means(kind: str, times: np.ndarray, edges: np.ndarray, T: float) -> np.ndarray:
    """Means of courses of size one between consecutive edges (J + 1,), s, for S times, s: (S, J).
    T : s, the recording's duration."""
    width, t = np.diff(edges), times[:, None]
    if kind == "ramp":
        return np.tile((edges[1:] + edges[:-1]) / (2 * T), (len(times), 1))
    if kind == "step":
        return np.asarray(np.clip((edges[1:] - t) / width, 0.0, 1.0))
    nearest = edges[:-1] if kind == "decay" else T - edges[1:]
    return np.asarray(t * np.exp(-np.maximum(nearest, 0.0) / t) * -np.expm1(-width / t) / width)


class CourseLikelihood:
    """The likelihood of noise and one course of the mean, evaluated for many courses at once. The
    series is scaled so that its white noise has density 1."""

    def __init__(self, means: np.ndarray, interval: float, corners: tuple[float, float]):
        blocks = len(means)
        self.most, self.interval = blocks // 2 - 1, interval
        z = self.transform(means - means.mean())
        self.scale = float(np.sqrt(np.median(z[self.most // 4 :] ** 2) / 0.455))
        self.z = z / max(self.scale, 1e-300)
        terms: tuple[GaussianTerm, ...] = (White(1.0), Flicker(1.0, *corners), RandomWalk(1.0))
        grid = Grid(blocks, interval, np.arange(1.0, self.most + 1), np.ones(self.most))
        unit = np.stack([density(term, grid) for term in terms])
        self.unit = unit / unit[:, self.most // 2, None]

    def transform(self, means: np.ndarray) -> np.ndarray:
        """The cosine coefficients 1 to K of block means (*S, J), times the square root of the
        interval: (*S, K)."""
        every = scipy.fft.dct(means, norm="ortho", axis=-1)
        return np.asarray(every[..., 1 : self.most + 1] * np.sqrt(self.interval))

    def fit(self, courses: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Fit noise and the size of each of S courses, whose means of size one are (S, J). Returns
        twice minus the log-likelihood (S,), the size and its sigma, (S,) in the series' unit, and
        the variances (S, K) of the scaled series."""
        s = self.transform(courses)
        starts = np.log([[1.0, 0.1, 1e-3], [0.8, 1e-4, 1e-6], [0.8, 1e-3, 1.0]])
        found = [self._minimise(s, start) for start in starts]
        best = np.argmin([f[0] for f in found], axis=0)
        value, size, sigma, v = (
            np.stack([f[i] for f in found])[best, np.arange(len(s))] for i in range(4)
        )
        return value, size * self.scale, sigma * self.scale, v

    def _minimise(
        self, s: np.ndarray, start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Minimise by Fisher scoring over the logarithms of the three noise weights, the size
        profiled out. s : (S, K), the transformed courses. Returns as `fit` does, scaled."""
        p = np.tile(start, (len(s), 1))
        *kept, step = self._scored(p, s)
        for _ in range(_ITERATIONS):
            trial = np.clip(p - step, -25.0, 25.0)
            *new, further = self._scored(trial, s)
            better = new[0] <= kept[0]
            p = np.where(better[:, None], trial, p)
            kept = [
                np.where(better if a.ndim == 1 else better[:, None], a, b)
                for a, b in zip(new, kept, strict=True)
            ]
            step = np.where(better[:, None], further, step / 3)
            if np.abs(step).max() < 1e-3:
                break
        value, size, sigma, v = kept
        return value, size, sigma, v

    def _scored(self, p: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, ...]:
        """Twice minus the log-likelihood, the size, its sigma, the variances and the scoring step
        at log-weights p (S, 3)."""
        parts = np.exp(p)[:, :, None] * self.unit
        v = parts.sum(axis=1)
        information = np.maximum(np.sum(s**2 / v, axis=1), 1e-300)
        size = np.sum(s * self.z / v, axis=1) / information
        r2 = (self.z - size[:, None] * s) ** 2 / v
        A = parts / v[:, None]
        gradient = 0.5 * np.einsum("sjk,sk->sj", A, 1 - r2)
        fisher = 0.5 * np.einsum("sjk,sik->sji", A, A) + 1e-3 * np.eye(3)
        step = np.linalg.solve(fisher, gradient[..., None])[..., 0]
        value = np.sum(np.log(v) + r2, axis=1)
        return value, size, 1 / np.sqrt(information), v, np.clip(step, -2, 2)

    def at(self, p: np.ndarray, course: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Twice minus the log-likelihood, and a course's size and its sigma, in the series' unit,
        with noise of these log-weights p, (S, 3). course : (J,), its means where its size is
        one."""
        value, size, sigma = self._scored(p, self.transform(course)[None])[:3]
        return value, size * self.scale, sigma * self.scale

    def gains(self, courses: np.ndarray, v: np.ndarray) -> np.ndarray:
        """What each course gains in twice the log-likelihood with the noise's variances v (K,)
        kept, (S,)."""
        s = self.transform(courses)
        return np.asarray((s @ (self.z / v)) ** 2 / np.maximum(s**2 @ (1 / v), 1e-300))


def found(
    series: np.ndarray,
    dt: float,
    corners: tuple[float, float] = (1.0, 3600.0),
    most: int = _BLOCKS,
) -> MeanChange | None:
    """The course of the mean that explains one recording best, or None where noise alone explains
    it.

    series : (n,), unit; dt : s; corners : s, of the bias instability's floor; most : the largest
    number of block means to take.
    """
    block = max(1, len(series) // most)
    blocks = len(series) // block
    if blocks < _FEWEST or np.ptp(series) == 0:
        return None
    means = np.asarray(series[: blocks * block], float).reshape(blocks, block).mean(axis=1)
    edges = np.arange(blocks + 1) * block * dt
    likelihood, T = CourseLikelihood(means, block * dt, corners), float(edges[-1])
    ends = np.stack([np.zeros(blocks), _means("ramp", np.array([T]), edges, T)[0]])
    (alone, straight), size, sigma, v = likelihood.fit(ends)
    taus = np.geomspace(T / 100, 2 * T, 28)
    grid = {"decay": taus, "rise": taus, "step": _likely_steps(likelihood, edges, v[0])}
    trials = [_refined(likelihood, edges, *one, float(alone)) for one in grid.items()]
    allowed = float(max(0.0, alone - straight))
    sure = [c for c in trials if c.ratio > allowed + _CERTAIN[c.kind]]
    if sure:
        best = max(sure, key=lambda c: c.ratio)
        return _at_its_sample(best, series, dt) if best.kind == "step" else best
    if allowed > _CERTAIN["ramp"]:
        return MeanChange("ramp", float(size[1]), float(sigma[1]), T, T, T, allowed, T)
    return None


def _likely_steps(likelihood: CourseLikelihood, edges: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The times at which a step is most likely, (S,), s: those that gain most if the noise is all
    white, and if it is the noise v (K,) fitted without a step."""
    at = edges[2:-2]
    courses = _means("step", at, edges, float(edges[-1]))
    best = [np.argsort(-likelihood.gains(courses, own))[:12] for own in (v, np.ones_like(v))]
    return at[np.unique(np.concatenate(best))]


def _refined(
    likelihood: CourseLikelihood, edges: np.ndarray, kind: str, times: np.ndarray, alone: float
) -> MeanChange:
    """The best course of one kind, over a grid of times and then over finer grids near the best
    time, with the interval of times that the likelihood does not tell from it. alone : twice minus
    the log-likelihood of noise alone."""
    T, width = float(edges[-1]), float(edges[1])
    span, best, low, high = (width if kind == "step" else 0.25), 0, 0.0, 0.0
    for _ in range(4):
        value, size, sigma, _v = likelihood.fit(_means(kind, times, edges, T))
        best = int(np.argmin(value))
        time, near = float(times[best]), times[value < value[best] + 3.84]
        if len(near) > 1 or low == 0.0:
            low, high = float(near.min()), float(near.max())
        gained = float(alone - value[best])
        course = MeanChange(kind, float(size[best]), float(sigma[best]), time, low, high, gained, T)
        around = np.linspace(-span, span, 15)
        times = time + around if kind == "step" else time * np.exp(around)
        span = span / 4
    return course


def _at_its_sample(step: MeanChange, series: np.ndarray, dt: float) -> MeanChange:
    """The step moved from a block's edge to the sample that divides its neighbourhood best."""
    reach = max(3, round(max(step.high - step.time, step.time - step.low) / dt))
    reach += max(1, len(series) // _BLOCKS) // 4
    middle = round(step.time / dt)
    first, last = max(0, middle - reach), min(len(series), middle + reach)
    around = np.asarray(series[first:last], float)
    before = np.mean(series[max(0, first - 10 * reach) : first]) if first else around[0]
    gain = np.cumsum((around - before - step.size / 2)[::-1])[::-1] * np.sign(step.size)
    return replace(step, time=float((first + int(np.argmax(gain))) * dt))


def taken_out(
    series: np.ndarray,
    dt: float,
    corners: tuple[float, float] = (1.0, 3600.0),
    recordings: int = 1,
) -> tuple[np.ndarray, list[MeanChange]]:
    """A recording without the courses of its mean, and these courses, at most three.

    series : (n,), unit; dt : s; corners : s, of the bias instability's floor; recordings : the
    number of recordings that are fitted together, by which the number of block means is divided.
    """
    most = max(_FEWEST, _BLOCKS // recordings)
    courses: list[MeanChange] = []
    edges = np.arange(len(series) + 1) * dt
    while len(courses) < _MOST:
        one = found(series, dt, corners, most)
        if one is None:
            break
        courses.append(one)
        series = series - one.means(edges)
    return series, courses
