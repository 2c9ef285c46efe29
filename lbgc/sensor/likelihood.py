"""The likelihood of a noise model: Whittle's, on the cosine transform.

Each coefficient (see `lbgc.sensor.ordinates`) is normal with the variance that the model gives it:
exact at low frequencies, the PSD of the samples above. What taking the coefficients as independent
gives away against the exact likelihood is below 3% of a standard error (`make study-noise`).
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import scipy.fft

from lbgc.sensor import gaussian
from lbgc.sensor.gaussian import GaussianTerm
from lbgc.sensor.noise import (
    AngleQuantisation,
    BandLimited,
    Flicker,
    GaussMarkov,
    Line,
    RandomWalk,
    White,
)
from lbgc.sensor.ordinates import Ordinates
from lbgc.sensor.shapes import Shape

_ALIASES = 6
_ENOUGH = 1e-5  # of the likelihood's logarithm, whose steps by 2 are what an interval is made of


@lru_cache(maxsize=1024)
def low_variance(term: GaussianTerm, blocks: int, interval: float, most: int) -> np.ndarray:
    """Exact variances of coefficients 1..most of block means, times the interval: unit^2 s.

    A stationary term needs its autocovariance r only: the sum over i, j of r_(i-j) times both
    cosines is r_0 + 2/n sum_l r_l ((n - l) cos(pi k l/n) - sin(pi k l/n)/sin(pi k/n)).
    """
    k = np.arange(1, most + 1)
    if isinstance(term, White | BandLimited | Line):  # short memory: the PSD
        return term.psd(k / (2 * blocks * interval))
    if isinstance(term, AngleQuantisation):
        return term.psd(k / (2 * blocks * interval), interval)
    if isinstance(term, RandomWalk):
        covariance = gaussian.covariance_of_means((term,), blocks, interval)
        transformed = scipy.fft.dctn(covariance, norm="ortho")
        return np.diag(transformed)[1 : most + 1] * interval
    r = gaussian.autocovariance_of_means((term,), blocks, interval)
    lag = np.arange(1, blocks)
    # cosines and sines at all k l at once: the real transform of a sequence of length 2 n
    cosines = scipy.fft.rfft(np.concatenate([[0.0], r[1:] * (blocks - lag)]), 2 * blocks).real
    sines = -scipy.fft.rfft(np.concatenate([[0.0], r[1:]]), 2 * blocks).imag
    v = r[0] + 2 / blocks * (cosines[k] - sines[k] / np.sin(np.pi * k / blocks))
    return v * interval


def high_variance(
    term: GaussianTerm, f: np.ndarray, dt: float, width: np.ndarray | None = None
) -> np.ndarray:
    """The PSD of samples at interval dt: the process's times sinc^2, folded at the sample rate.

    width : (M,), Hz, of bins around f. A line may be as narrow, so that its mean over a bin counts.
    """
    if isinstance(term, White):
        return term.psd(f)
    if isinstance(term, AngleQuantisation):
        return term.psd(f, dt)
    assert isinstance(term, RandomWalk | Flicker | GaussMarkov | Line | BandLimited)
    aliases = 1 if isinstance(term, Line) else _ALIASES  # its flanks are steep
    folded = f[:, None] + np.arange(-aliases, aliases + 1) / dt
    density = term.psd(np.abs(folded))
    if isinstance(term, Line) and width is not None:
        inside = term.power_below(f + width / 2) - term.power_below(f - width / 2)
        density[:, aliases] = np.maximum(inside, 0) / width
    return np.sum(density * np.sinc(folded * dt) ** 2, axis=1)


def _range(name: str, data: Ordinates) -> tuple[float, float]:
    """Where a parameter ends. A filter's damping of 5 puts a factor of a hundred between its poles:
    it is of first order. A line narrower than 3/duration is one that the log does not resolve."""
    if name.startswith("line_width"):
        return 3 / (data.n * data.dt), np.inf
    return 0.0, 5.0 if name == "damping" else np.inf


class Likelihood:
    """Minus the log-likelihood of log-parameters, with gradient and Fisher information."""

    def __init__(self, data: Ordinates, shapes: list[Shape]):
        self.data, self.shapes = data, shapes
        self.names = [name for shape in shapes for name in shape.names]
        with np.errstate(divide="ignore"):
            ends = np.log([_range(name, data) for name in self.names]).reshape(-1, 2)
        self.least, self.most = ends.T
        recordings, self.lows = data.low.shape
        self.count = np.concatenate([np.full(self.lows, recordings), data.count])
        self.power = np.concatenate([np.sum(data.low**2, axis=0), data.power])

    def unit_variance(self, shape: Shape, parameters: Sequence[float]) -> np.ndarray:
        """Of a term with coefficient one, at every ordinate: unit^2 s."""
        d = self.data
        term = shape.unit_term(parameters)
        low = low_variance(term, d.blocks, d.interval, self.lows)
        return np.concatenate([low, _high_cached(term, d.f.tobytes(), d.dt, d.width.tobytes())])

    def variance(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """v (m,) and its derivative by the log-parameters (m, P)."""
        values, columns, at = np.full(len(self.count), self.data.rounding), [], 0
        for shape in self.shapes:
            own = p[at : at + len(shape.names)]
            scale = np.exp(2 * own[0])
            unit = self.unit_variance(shape, tuple(np.exp(own[1:])))
            values += scale * unit
            columns.append(2 * scale * unit)
            for j in range(1, len(own)):
                up = own.copy()
                up[j] += 1e-4
                moved = self.unit_variance(shape, tuple(np.exp(up[1:])))
                columns.append(scale * (moved - unit) / 1e-4)
            at += len(own)
        return values, np.stack(columns, axis=1)

    def bic(self, value: float) -> float:
        """Bayesian information criterion at the minimum's value."""
        return 2 * value + len(self.names) * float(np.log(self.count.sum()))

    def degrees_of_freedom(self, p: np.ndarray, i: int) -> float:
        """As many chi-squared degrees of freedom would tell parameter i as well: half its Fisher
        information, the others unknown."""
        v, J = self.variance(p)
        A = J / v[:, None]
        information = 0.5 * (A * self.count[:, None]).T @ A
        keep = np.diag(information) > 1e-9
        keep[i] = True
        inverse = np.linalg.pinv(information[np.ix_(keep, keep)])
        at = int(np.sum(keep[:i]))
        return float(1 / max(inverse[at, at], 1e-12) / 2)

    def value(self, p: np.ndarray) -> float:
        v, at = np.full(len(self.count), self.data.rounding), 0
        for shape in self.shapes:
            own = np.exp(p[at : at + len(shape.names)])
            v += own[0] ** 2 * self.unit_variance(shape, tuple(own[1:]))
            at += len(own)
        return 0.5 * float(np.sum(self.count * np.log(v) + self.power / v))

    def minimise(
        self, start: np.ndarray, fixed: dict[int, float] | None = None
    ) -> tuple[np.ndarray, float]:
        """Fisher scoring with halved steps; `fixed` holds parameters at values. A coefficient that
        the data push to zero ends far below what they could show."""
        p = np.clip(start, self.least, self.most)
        for i, x in (fixed or {}).items():
            p[i] = x
        loose = np.array([i not in (fixed or {}) for i in range(len(p))])
        best = self.value(p)
        for _ in range(60):
            v, J = self.variance(p)
            A = J / v[:, None]
            gradient = 0.5 * A.T @ (self.count - self.power / v)
            at_end = (p >= self.most - 1e-9, p <= self.least + 1e-9)
            free = loose & ~(at_end[0] & (gradient < 0)) & ~(at_end[1] & (gradient > 0))
            A = A[:, free]
            information = 0.5 * (A * self.count[:, None]).T @ A
            ridge = 1e-12 * np.trace(information) + 1e-12
            step = np.linalg.solve(information + ridge * np.eye(free.sum()), gradient[free])
            step *= min(1.0, 1.0 / np.abs(step).max(initial=1e-300))
            if gradient[free] @ step < _ENOUGH:  # all that is left to gain
                break
            room = np.where(step < 0, self.most[free] - p[free], p[free] - self.least[free])
            short = min(1.0, float(np.min(room / np.abs(step), initial=1.0)))  # of an end
            step *= short
            for _ in range(10):
                trial = p.copy()
                trial[free] -= step
                value = self.value(trial)
                if value <= best:
                    break
                step = step / 2
            else:
                break
            gained, best, p = best - value, value, trial
            if gained < _ENOUGH and short == 1.0:
                break
        return p, best


@lru_cache(maxsize=1024)
def _high_cached(term: GaussianTerm, f: bytes, dt: float, width: bytes) -> np.ndarray:
    return high_variance(term, np.frombuffer(f), dt, np.frombuffer(width))
