"""Few figures in the place of a sensor's law: white noise with a random walk, or with one
first-order Gauss-Markov process, which is all that most other tools' error models have.

The figures are chosen on the Allan curve, at four averaging times an octave. The target has what is
white and what is slow; tones, lines, ramps and quantisation look like neither, and no figure is
bent towards them. For flicker of coefficient B over white noise N, let F = 2 ln 2/pi B^2 and tau_c
= N^2/F, where both are equal. White noise alone is the sensor within 5% up to 0.10 tau_c.

**A random walk** rises where flicker is level, and is like it at one averaging time. Filters take
it, and are judged by where it is worst, so its worst departure up to the longest time L is made the
least. It is level with the flicker at tau_K = 3 F/K^2. In between, at sqrt(tau_c tau_K), walk and
white noise together fall short by (tau_K/tau_c)^(1/4)/sqrt 2, and at L the walk exceeds by
sqrt(L/tau_K). These are equal for tau_K = (4 L^2 tau_c)^(1/3), where both are (L/(4 tau_c))^(1/6):
3 for L = 3000 tau_c. A shorter L makes a larger walk, which holds better up to there.

**A Gauss-Markov process** has a level stretch of its own. Simulators draw it, and are asked where
they are right, so it is the one that agrees at the most averaging times: two Allan deviations agree
where their ratio is between 1/1.05 and 1.05. Of a process whose Allan variance is s g(tau), beside
what is told as it is, w(tau), a size s agrees with a target A(tau) where

    (A/1.05^2 - w)/g <= s <= (1.05^2 A - w)/g.

At how many times a size agrees changes at the ends of these intervals only. The size that is taken
agrees at the most, and of those that do it has the least worst departure there; correlation times
are tried on a grid. For flicker T = 0.7 tau_c and sigma = 1.16 B come out, within 5% up to 3.3
tau_c. Beyond, the process's deviation falls, where flicker's stays at 0.664 B.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lbgc.sensor import noise
from lbgc.sensor.exponential import gauss_markov_allan
from lbgc.sensor.gaussian import GaussianTerm
from lbgc.sensor.imu import Triad

WITHIN = 1.05
"""Largest ratio of two Allan deviations that agree."""
FAR = 1000.0
"""Correlation time, in longest averaging times, with which a process is a random walk."""
_TIMES = 2.0 ** (1 / 8)
"""Ratio of neighbouring correlation times that are tried."""
_WALKS, _WIDE = 4000, 100.0
"""Sizes of a random walk that are tried, and how far beyond those that a curve is level with."""
_SIZES = 64
"""Sizes that are tried between the ends of the best ones."""


@dataclass(frozen=True)
class Figures:
    """White noise, a random walk and a first-order Gauss-Markov process of one axis, SI."""

    N: float
    """Root of the two-sided PSD of what is white, unit/sqrt(Hz)."""
    K: float = 0.0
    """Random walk, unit/s/sqrt(Hz)."""
    sigma: float = 0.0
    """Standard deviation of the process."""
    T: float = 1.0
    """Correlation time of the process, s."""

    @property
    def drive(self) -> float:
        """Root of the two-sided PSD of the white noise that drives the process, sigma sqrt(2/T),
        unit/s/sqrt(Hz)."""
        return float(self.sigma * np.sqrt(2 / self.T))

    def allan_variance(self, tau: np.ndarray, dt: float) -> np.ndarray:
        """The Allan variance of samples at dt (s) that have these errors, unit^2 (*S), at averaging
        times tau (*S), s.

        Unlike ours, such samples have the walk's and the process's values at their own times, as
        the tools draw them, and no means over intervals. With m = tau/dt a walk then has 1 + 1/(2
        m^2) times its Allan variance. With u = dt/T the values are an autoregression, whose Allan
        variance follows from its geometric series: the process's own, times (x/sinh x)^2 with x =
        u/2, plus sigma^2 (sinh u - u)/(2 m sinh^2 x).
        """
        m = np.asarray(tau, dtype=float) / dt
        total = np.asarray(noise.White(self.N).allan_variance(tau))
        if self.K:
            total = total + noise.RandomWalk(self.K).allan_variance(tau) * (1 + 1 / (2 * m**2))
        if self.sigma:
            u = dt / self.T
            ratio = (u / 2 / np.sinh(u / 2)) ** 2
            excess = u**3 / 6 * (1 + u**2 / 20) if u < 0.1 else np.sinh(u) - u
            total = total + ratio * noise.GaussMarkov(self.sigma, self.T).allan_variance(tau)
            total = total + self.sigma**2 * excess / (2 * m * np.sinh(u / 2) ** 2)
        return np.asarray(total)


@dataclass(frozen=True)
class Slow:
    """What of an axis's law is white or slow, SI: what few figures can tell, or stand in for."""

    N: float
    """Root of the two-sided PSD of all that is white."""
    K: float
    """Random walk."""
    processes: tuple[tuple[float, float], ...]
    """Variance and correlation time (s) of each first-order Gauss-Markov process."""

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """Its Allan variance, unit^2 (*S), at tau (*S), s."""
        known = noise.allan_variance((noise.White(self.N), noise.RandomWalk(self.K)), tau)
        if not self.processes:
            return known
        variances, times = np.array(self.processes).T
        return np.asarray(known + gauss_markov_allan(variances, times, tau))


def slow(triad: Triad, dt: float, rounding: bool = True) -> list[Slow]:
    """What is white or slow of each axis of samples at dt (s). rounding : whether the noise that
    rounding to counts makes is among it."""
    counted: tuple[GaussianTerm, ...] = triad.rounding(dt) if rounding else ()
    start = np.zeros(1)
    return [
        Slow(
            N=float(np.sqrt(sum(t.density for t in (*own, *counted)))),
            K=float(np.sqrt(sum(np.max(t.reduced(start, 1.0).walk) for t in own))),
            processes=tuple(p for t in own for p in t.processes),
        )
        for own in triad.terms
    ]


def octaves(dt: float, longest: float, parts: int = 1) -> np.ndarray:
    """Averaging times dt, 2 dt, 4 dt, ... up to the longest, s; parts : how many an octave."""
    most = int(parts * np.log2(longest / dt) + 1e-9)
    return np.asarray(dt * 2.0 ** (np.arange(most + 1) / parts))


def agrees(variance: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Where two Allan variances (*S) are of deviations that agree, bool (*S)."""
    edge = WITHIN**2 * (1 + 1e-9)
    return np.asarray((variance <= edge * target) & (target <= edge * variance))


def white(axes: Sequence[Slow]) -> list[Figures]:
    """The figures of each axis's white noise alone."""
    return [Figures(axis.N) for axis in axes]


def walking(axes: Sequence[Slow], tau: np.ndarray) -> Figures:
    """White noise and a random walk that stand for all of these axes: at each averaging time tau
    (L,), s, from the sample interval on, the largest of their Allan variances is meant. Where one
    has a random walk of its own, the largest of these is it; else one stands for the processes,
    whose worst departure is least."""
    N, own = max(axis.N for axis in axes), max(axis.K for axis in axes)
    if own > 0 or not any(axis.processes for axis in axes):
        return Figures(N, own)
    target = np.max([axis.allan_variance(tau) for axis in axes], axis=0)
    known, unit = (f.allan_variance(tau, tau[0]) for f in (Figures(N), Figures(0.0, 1.0)))
    level = target / unit
    tried = np.geomspace(level.min() / _WIDE, level.max() * _WIDE, _WALKS)
    departure = np.abs(np.log((known + tried[:, None] * unit) / target)).max(axis=1)
    return Figures(N, float(np.sqrt(tried[np.argmin(departure)])))


def reverting(axes: Sequence[Slow], tau: np.ndarray, walk: bool = False) -> list[Figures]:
    """White noise and one process for each axis, of one correlation time T, chosen at averaging
    times tau (L,), s, from the sample interval on. walk : whether each axis's random walk is told
    beside; else the process stands for it too, or is it, by a T that is FAR beyond."""
    far = FAR * float(tau[-1])
    own = _own_process(axes, walk, far)
    if own is not None:
        return own
    kept = [Figures(axis.N, axis.K if walk else 0.0) for axis in axes]
    target = np.stack([axis.allan_variance(tau) for axis in axes])
    known = np.stack([figures.allan_variance(tau, tau[0]) for figures in kept])
    tried = np.geomspace(tau[0], far, int(np.log(far / tau[0]) / np.log(_TIMES)) + 1)

    units = (Figures(0.0, 0.0, 1.0, T).allan_variance(tau, tau[0]) for T in tried)
    found = [_best(unit, target, known) for unit in units]
    at = max(range(len(tried)), key=lambda i: (found[i][2], -found[i][1]))
    return [
        Figures(figures.N, figures.K, float(np.sqrt(size)), float(tried[at]))
        for figures, size in zip(kept, found[at][0], strict=True)
    ]


def _own_process(axes: Sequence[Slow], walk: bool, far: float) -> list[Figures] | None:
    """The figures of axes whose own law has no more than one process, of the same correlation time;
    None where something must stand in."""
    walks = [axis.K > 0 and not walk for axis in axes]
    times = {T for axis in axes for _, T in axis.processes} | {far for own in walks if own}
    most = max(len(axis.processes) + own for axis, own in zip(axes, walks, strict=True))
    if len(times) > 1 or most > 1:
        return None
    T = times.pop() if times else 1.0
    return [
        Figures(
            axis.N,
            axis.K if walk else 0.0,
            float(axis.K * np.sqrt(T / 2) if own else np.sqrt(sum(v for v, _ in axis.processes))),
            T,
        )
        for axis, own in zip(axes, walks, strict=True)
    ]


def _best(unit: np.ndarray, target: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, float, int]:
    """Sizes s (A,) with which `known + s unit` agrees with `target` at the most times, the worst
    departure there (log of a ratio of variances), and at how many times the axes agree.

    unit : (L,); target, known : (A, L); Allan variances.
    """
    each = [_best_of_axis(unit, own, w) for own, w in zip(target, known, strict=True)]
    sizes, worst, counts = zip(*each, strict=True)
    return np.array(sizes), max(worst), sum(counts)


def _best_of_axis(
    unit: np.ndarray, target: np.ndarray, known: np.ndarray
) -> tuple[float, float, int]:
    """The size, the worst departure and the number of times of one axis, (L,) each."""
    edges_of_target = (target / WITHIN**2, WITHIN**2 * target)
    ends = np.concatenate([(edge - known) / unit for edge in edges_of_target])
    edges = np.unique(np.append(ends[ends > 0], 0.0))
    counts = _agreeing(edges, unit, target, known)[0]
    best = edges[counts == counts.max()]
    sizes = np.linspace(best[0], best[-1], _SIZES)
    counts, worst = _agreeing(sizes, unit, target, known)
    at = int(np.lexsort((worst, -counts))[0])
    return float(sizes[at]), float(worst[at]), int(counts[at])


def _agreeing(
    sizes: np.ndarray, unit: np.ndarray, target: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The number of times at which each size (S,) agrees, and its worst departure at these."""
    variance = known + sizes[:, None] * unit
    good = agrees(variance, target)
    departure = np.log(variance / target, out=np.zeros_like(variance), where=good)
    return good.sum(axis=1), np.abs(departure).max(axis=1)
