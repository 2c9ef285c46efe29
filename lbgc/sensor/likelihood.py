"""The likelihood of a noise model: Whittle's, on the cosine transform.

Each coefficient (see `lbgc.sensor.ordinates`) is normal with the variance that the model gives it:
exact at low frequencies, the PSD of the samples above. What taking the coefficients as independent
gives away against the exact likelihood is below 3% of a standard error (`make study-noise`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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

_ALIASES = 6


@lru_cache(maxsize=256)
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


def high_variance(term: GaussianTerm, f: np.ndarray, dt: float) -> np.ndarray:
    """The PSD of samples at interval dt: the process's times sinc^2, folded at the sample rate."""
    if isinstance(term, White):
        return term.psd(f)
    if isinstance(term, AngleQuantisation):
        return term.psd(f, dt)
    assert isinstance(term, RandomWalk | Flicker | GaussMarkov | Line | BandLimited)
    folded = f[:, None] + np.arange(-_ALIASES, _ALIASES + 1) / dt
    return np.sum(term.psd(np.abs(folded)) * np.sinc(folded * dt) ** 2, axis=1)


@dataclass(frozen=True)
class Shape:
    """A term whose first parameter is its coefficient and whose others are its shape."""

    names: tuple[str, ...]
    build: Callable[..., GaussianTerm]

    def unit_term(self, shape: Sequence[float]) -> GaussianTerm:
        return self.build(1.0, *shape)


def core(corners: tuple[float, float] = (1.0, 3600.0)) -> list[Shape]:
    """White noise, bias instability and rate random walk: always fitted."""
    return [
        Shape(("N",), White),
        Shape(("B",), lambda b: Flicker(b, *corners)),
        Shape(("K",), RandomWalk),
    ]


QUANTISATION = Shape(("Q",), AngleQuantisation)
GAUSS_MARKOV = Shape(("GM_sigma", "GM_T"), GaussMarkov)
LINE = Shape(("line_sigma", "line_f0", "line_width"), Line)
FILTERED_WHITE = Shape(("N", "bandwidth", "damping"), BandLimited)


class Likelihood:
    """Minus the log-likelihood of log-parameters, with gradient and Fisher information."""

    def __init__(self, data: Ordinates, shapes: list[Shape]):
        self.data, self.shapes = data, shapes
        self.names = [name for shape in shapes for name in shape.names]
        recordings, self.lows = data.low.shape
        self.count = np.concatenate([np.full(self.lows, recordings), data.count])
        self.power = np.concatenate([np.sum(data.low**2, axis=0), data.power])

    def unit_variance(self, shape: Shape, parameters: Sequence[float]) -> np.ndarray:
        """Of a term with coefficient one, at every ordinate: unit^2 s."""
        d = self.data
        term = shape.unit_term(parameters)
        low = low_variance(term, d.blocks, d.interval, self.lows)
        return np.concatenate([low, _high_cached(term, d.f.tobytes(), d.dt)])

    def variance(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """v (m,) and its derivative by the log-parameters (m, P)."""
        values, columns, at = np.zeros(len(self.count)), [], 0
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
        v, _ = self.variance(p)
        return 0.5 * float(np.sum(self.count * np.log(v) + self.power / v))

    def minimise(
        self, start: np.ndarray, fixed: dict[int, float] | None = None
    ) -> tuple[np.ndarray, float]:
        """Fisher scoring with halved steps; `fixed` holds parameters at values. A coefficient that
        the data push to zero ends far below what they could show."""
        p = start.copy()
        for i, x in (fixed or {}).items():
            p[i] = x
        free = [i for i in range(len(p)) if i not in (fixed or {})]
        best = self.value(p)
        for _ in range(60):
            v, J = self.variance(p)
            A = J[:, free] / v[:, None]
            gradient = 0.5 * A.T @ (self.count - self.power / v)
            information = 0.5 * (A * self.count[:, None]).T @ A
            ridge = 1e-9 * np.trace(information) / max(len(free), 1) + 1e-12
            step = np.linalg.solve(information + ridge * np.eye(len(free)), gradient)
            step *= min(1.0, 1.0 / np.abs(step).max(initial=1e-300))
            for _ in range(30):
                trial = p.copy()
                trial[free] -= step
                value = self.value(trial)
                if value <= best + 1e-12:
                    break
                step = step / 2
            else:
                break
            gained, best, p = best - value, value, trial
            if gained < 1e-7 and np.abs(step).max(initial=0) < 1e-3:
                break
            if gained < 1e-9:
                break
        return p, best


@lru_cache(maxsize=256)
def _high_cached(term: GaussianTerm, key: bytes, dt: float) -> np.ndarray:
    return high_variance(term, np.frombuffer(key), dt)
