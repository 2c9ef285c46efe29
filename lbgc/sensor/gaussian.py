"""Gaussian error terms, and how they are drawn with their exact law at any sample interval.

A sample is the mean of a continuous-time process w over its interval (t_k - h, t_k]. Each term is
stated once, as a linear state-space model of such interval means,

    x[k+1] = A x[k] + u[k],    y[k] = C x[k] + v[k],    cov(u, v) = [[Q, S], [S', R]],

with x the process's state at the interval's start. Drawing, the covariance of block means and the
law at a lower rate all follow from it.

Because a mean over m samples is the process's mean over an interval of m h, block means of
``sample(dt)`` have exactly the law of ``sample(m dt)``: `sample_means` draws just that.

A path is drawn exactly, and with about one normal variate a sample: time is cut into blocks. Given
the state x at a block's start, the block's means are ``y = O x + L e`` with e standard normal and L
the lower-triangular (innovations) factor of their covariance, which a Kalman filter that starts
from a known state gives row by row. The state at the block's end, given y, is ``F x + G e + W w``
with a few more normals w. O, L, F, G, W are the same for every block; nothing is interpolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, TypeAlias

import numpy as np

from lbgc.sensor.low_pass import LowPass
from lbgc.sensor.means_model import MeansModel

BLOCK = 128
"""Samples in a block. Changing it changes every dataset's bytes and needs a new schema number."""
_GROUP = 32
"""Blocks whose states are found in one matrix product. Changing it changes bytes, too."""

Generators: TypeAlias = np.random.Generator | Sequence[np.random.Generator]
"""One random generator for all series, or several for as many equal parts of the series."""


@dataclass(frozen=True)
class Reduced:
    """The model of a term in a filter of few states, beside its first-order processes (see
    `GaussianTerm.processes`), for W windows: SI units."""

    white: float = 0.0
    """Two-sided PSD of the white noise"""
    angle: float = 0.0
    """Variance of an error of the integral (angle, velocity) that does not accumulate"""
    constant: np.ndarray | float = 0.0
    """Variance of a constant at each window's start, (W,)"""
    walk: np.ndarray | float = 0.0
    """Variance that this constant gains each second, (W,)"""


class GaussianTerm:
    """A Gaussian stochastic term. `sample`, `sample_means` and `covariance_of_means` follow from
    its model of interval means; the Allan variance and the PSD are each term's own closed forms."""

    cause: ClassVar[str] = "other noise"
    """The row of an error budget that it belongs to"""

    @property
    def density(self) -> float:
        """The density that makes it white noise in means over long times, N^2; 0 of what is
        none."""
        return self.reduced(np.zeros(0), 1.0).white

    @property
    def processes(self) -> tuple[tuple[float, float], ...]:
        """The variance and the correlation time (s) of each first-order Gauss-Markov process of
        which the term is the sum; empty where it is no such sum."""
        return ()

    def reduced(self, start_s: np.ndarray, duration_s: float) -> Reduced:
        """The term's model in a filter of few states, for windows of duration_s that begin start_s,
        (W,), after the recording's start (s)."""
        return Reduced()

    def behind(self, low_pass: LowPass) -> "GaussianTerm":
        """The term as it comes out of an output filter: what is slow passes unchanged."""
        return self

    @property
    def is_stationary(self) -> bool:
        """Whether its means have the same law at every time after the recording's start."""
        m = self.means_model(1.0)
        later = m.A @ m.P0 @ m.A.T + m.Q
        return bool(np.abs(later - m.P0).max(initial=0) <= 1e-7 * np.abs(later).max(initial=0))

    def means_model(self, interval: float) -> MeansModel:
        """The state-space model of the term's means over intervals of this length (s)."""
        raise NotImplementedError

    def allan_variance(self, tau: np.ndarray) -> np.ndarray:
        """Its Allan variance, unit^2, at averaging times tau (*S), s."""
        raise NotImplementedError

    def sample(self, rng: Generators, shape: tuple[int, ...], dt: float) -> np.ndarray:
        """Draw this term alone, as the module's `sample` does."""
        return sample((self,), rng, shape, dt)

    def sample_means(
        self, rng: Generators, shape: tuple[int, ...], dt: float, block: int
    ) -> np.ndarray:
        """Draw this term's block means alone, as the module's `sample_means` does."""
        return sample_means((self,), rng, shape, dt, block)

    def covariance_of_means(self, n: int, dt: float, block: int = 1, start: int = 0) -> np.ndarray:
        """The covariance of this term's block means, as in the module's `covariance_of_means`."""
        return covariance_of_means((self,), n, dt, block, start)


Gaussians: TypeAlias = tuple[GaussianTerm, ...]


def sample(
    terms: Gaussians,
    rng: Generators,
    shape: tuple[int, ...],
    dt: float,
    out: np.ndarray | None = None,
    start: int = 0,
) -> np.ndarray:
    """Draw samples of the sum of Gaussian terms, with their exact joint law.

    shape : (*S, n), independent series of n samples; dt : s; rng : one for all, or one for each of
    the first axis; out : the array to write to, float32; start : how many samples after the
    recording's start the first one is, where nothing before it is drawn. Returns float32 (*S, n),
    in the terms' unit. The state is carried in float64.
    """
    *series, n = shape
    count = int(np.prod(series))
    drawn_to = np.empty(shape, np.float32) if out is None else out
    if not terms:
        drawn_to[...] = 0
        return drawn_to
    factor = _block_factor(terms, dt, min(BLOCK, n))
    size, states, blocks = factor.size, len(factor.start), -(-n // factor.size)
    parts = 1 if isinstance(rng, np.random.Generator) else len(rng)
    drawn = _normals(rng, count, states + blocks * (size + states))
    # Each part has products of its own: how BLAS rounds depends on the number of rows.
    root = factor.start if start == 0 else _later_root(terms, dt, start)
    x = drawn[:, :states].reshape(parts, count // parts, states) @ root.T
    e = drawn[:, states:].reshape(parts, -1, size + states)  # e and w of each block
    if states:
        # The normals w are needed no more: the states at the blocks' starts take their place.
        e[..., size:] = _starts(factor.F, x, e @ factor.GW.T)
    if count == 1 and n == blocks * size:  # written in place, since new memory costs time
        np.matmul(e[0], factor.LO.T, out=drawn_to.reshape(blocks, size))
    else:
        drawn_to[...] = (e @ factor.LO.T).reshape(count, -1)[:, :n].reshape(shape)
    return drawn_to


def _normals(rng: Generators, count: int, each: int) -> np.ndarray:
    """Standard normals, float32 (count, each); several generators draw equally many rows each."""
    if isinstance(rng, np.random.Generator):
        return rng.standard_normal((count, each), dtype=np.float32)
    drawn = np.empty((count, each), np.float32)
    for own, rows in zip(rng, drawn.reshape(len(rng), -1), strict=True):
        own.standard_normal(out=rows, dtype=np.float32)
    return drawn


def _starts(F: np.ndarray, x: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """States at the blocks' starts, by x[b + 1] = F x[b] + steps[b]. x : (parts, series, p), the
    first; steps : (parts, series blocks, p), float32. Returns float64 of the shape of steps.

    Blocks are taken in groups: one product in float32 gives what the steps in each group do to the
    states in it, so that only the groups' first states are found one after the other."""
    parts, series, p = x.shape
    blocks = steps.shape[1] // series
    group = min(_GROUP, blocks)
    groups = -(-blocks // group)
    reach, inner = _group(F.tobytes(), p, group)
    padded = np.zeros((parts, series, groups * group, p), np.float32)
    padded[:, :, :blocks] = steps.reshape(parts, series, blocks, p)
    own = padded.reshape(parts, series * groups, group * p) @ inner.T
    ends = own[..., -p:].reshape(parts, series, groups, p)
    first = np.empty((parts, series, groups, p))
    for g in range(groups):
        first[:, :, g] = x
        x = x @ reach[-p:].T + ends[:, :, g]
    starts = own[..., :-p] + first.reshape(parts, series * groups, p) @ reach[:-p].T
    whole = starts.reshape(parts, series, groups * group, p)[:, :, :blocks]
    return np.asarray(whole.reshape(parts, series * blocks, p))


@lru_cache(maxsize=64)
def _group(F: bytes, p: int, group: int) -> tuple[np.ndarray, np.ndarray]:
    """Two matrices that give the states at the starts of a group's blocks and at its end, stacked:
    from the first state, ((group + 1) p, p), and from the steps, float32
    ((group + 1) p, group p)."""
    powers = [np.eye(p)]
    for _ in range(group):
        powers.append(np.frombuffer(F).reshape(p, p) @ powers[-1])
    inner = np.zeros((group + 1, p, group, p))
    for after in range(1, group + 1):
        for k in range(after):
            inner[after, :, k] = powers[after - 1 - k]
    flat = inner.reshape((group + 1) * p, group * p)
    return np.concatenate(powers), flat.astype(np.float32)


def sample_axes(
    axes: Sequence[Gaussians], rng: np.random.Generator, count: int, n: int, dt: float
) -> np.ndarray:
    """Draw `count` independent series of n samples for each of several axes, given each axis's
    terms: float32 (count, n, axes)."""
    return np.stack([sample(terms, rng, (count, n), dt) for terms in axes], axis=-1)


def sample_means(
    terms: Gaussians, rng: Generators, shape: tuple[int, ...], dt: float, block: int
) -> np.ndarray:
    """Draw means over `block` samples, with exactly the law of averaging what `sample` draws.
    shape : (*S, n), n means each; dt : s, the samples' interval. Returns float32 (*S, n)."""
    return sample(terms, rng, shape, dt * block)


def covariance_of_means(
    terms: Gaussians, n: int, dt: float, block: int = 1, start: int = 0
) -> np.ndarray:
    """The covariance of n consecutive means over `block` samples each.

    start : how many such blocks after the recording's start they begin, which matters to a term
    that is not stationary. Returns (n, n), unit^2: cov(y_j, y_k) = C A^(k-j-1) (A P_j C' + S) for
    j < k, with P_j the covariance of the state at the start of block j.
    """
    model = _sum_model(terms, dt * block)
    P, states = _later(model, start), len(model.C)
    decay, toward = np.empty((n, states)), np.empty((n, states))
    covariance = np.zeros((n, n))
    power = np.eye(states)
    for j in range(n):
        covariance[j, j] = (model.C @ P @ model.C + model.R) / 2
        toward[j] = model.A @ P @ model.C + model.S
        decay[j] = model.C @ power
        power = model.A @ power
        P = model.A @ P @ model.A.T + model.Q
    after = toward @ decay.T  # [j, l]: the covariance of the means j and j + l + 1
    for j in range(n - 1):
        covariance[j, j + 1 :] = after[j, : n - 1 - j]
    return covariance + covariance.T


def _later(model: MeansModel, start: int) -> np.ndarray:
    """Covariance of the state `start` intervals after the recording's start, (p, p). It advances by
    powers of two of an interval, over each of which P becomes A P A' + Q."""
    P, A, Q = model.P0, model.A, model.Q
    while start:
        if start % 2:
            P = A @ P @ A.T + Q
        A, Q, start = A @ A, A @ Q @ A.T + Q, start // 2
    return P


@lru_cache(maxsize=1024)
def _later_root(terms: Gaussians, interval: float, start: int) -> np.ndarray:
    """A square root of `_later` of the terms' sum, (p, p)."""
    return _square_root(_later(_sum_model(terms, interval), start))


def autocovariance_of_means(terms: Gaussians, n: int, dt: float) -> np.ndarray:
    """The first row of `covariance_of_means`, (n,), unit^2, which is all of it for stationary
    terms."""
    model = _sum_model(terms, dt)
    row = np.empty(n)
    row[0] = model.C @ model.P0 @ model.C + model.R
    toward = model.A @ model.P0 @ model.C + model.S
    decay, lags = np.diag(model.A), np.arange(n - 1)
    if np.array_equal(np.diag(decay), model.A):  # independent first-order processes
        row[1:] = (model.C * toward) @ decay[:, None] ** lags
        return row
    for k in range(1, n):
        row[k] = model.C @ toward
        toward = model.A @ toward
    return row


def _sum_model(terms: Gaussians, interval: float) -> MeansModel:
    """The model of a sum of independent terms, whose states are stacked."""
    parts = [term.means_model(interval) for term in terms]
    return MeansModel(
        _block_diagonal([m.A for m in parts]),
        np.concatenate([m.C for m in parts]),
        _block_diagonal([m.Q for m in parts]),
        np.concatenate([m.S for m in parts]),
        sum(m.R for m in parts),
        _block_diagonal([m.P0 for m in parts]),
    )


def _block_diagonal(blocks: list[np.ndarray]) -> np.ndarray:
    size = sum(len(b) for b in blocks)
    out, at = np.zeros((size, size)), 0
    for b in blocks:
        out[at : at + len(b), at : at + len(b)] = b
        at += len(b)
    return out


@dataclass(frozen=True, eq=False)
class _BlockFactor:
    """The matrices of y = L e + O x and x_end = F x + G e + W w for one block (see the module)."""

    LO: np.ndarray  # (M, M + p), float32, L and O side by side
    F: np.ndarray  # (p, p)
    GW: np.ndarray  # (p, M + p), float32, G and W side by side
    start: np.ndarray  # (p, p), square root of P0

    @property
    def size(self) -> int:
        return len(self.LO)


@lru_cache(maxsize=64)
def _block_factor(terms: Gaussians, interval: float, size: int) -> _BlockFactor:
    """A block's matrices, by the Kalman filter of its means from a known state (P = 0). Each
    innovation's standard deviation is L's diagonal element; its effect on later means, through the
    filter's state, is the column below. O is the means' response to the state at the start."""
    m = _sum_model(terms, interval)
    p = len(m.C)
    O, L = np.zeros((size, p)), np.zeros((size, size))  # noqa: E741
    response = np.zeros((p, size))  # response of the predicted state to each innovation so far
    P, F = np.zeros((p, p)), np.eye(p)
    for k in range(size):
        O[k] = m.C @ F
        L[k] = m.C @ response
        variance = m.C @ P @ m.C + m.R
        L[k, k] = np.sqrt(variance)
        gain = (m.A @ P @ m.C + m.S) / variance if variance > 0 else np.zeros(p)
        response = m.A @ response
        response[:, k] = gain * L[k, k]
        P = m.A @ P @ m.A.T + m.Q - np.outer(gain, gain) * variance
        P = (P + P.T) / 2
        F = m.A @ F
    LO, GW = np.hstack([L, O]), np.hstack([response, _square_root(P)])
    return _BlockFactor(LO.astype(np.float32), F, GW.astype(np.float32), _square_root(m.P0))


def _square_root(covariance: np.ndarray) -> np.ndarray:
    """A matrix W with W W' = covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0, None)))
