"""Populations of units: what is known of a unit before anything was recorded of it, where that may
be no Gaussian law, and the heading of one more recording given labelled ones.

A level IMU at rest prints the mean rates of T intervals of each recording. Less Earth's rate at a
known heading, those of recording i on one axis are

    e_i = H(theta, c_i) x + r_i + in-run noise,     x standard normal,  r_i ~ Normal(0, R(theta))

x is the unit's own, one set an axis, r_i a bias that is new in each recording, c_i a condition that
is known of it (a temperature, the time since power-up), and theta is what of the unit is not
Gaussian: which kind of unit it is, a time constant, the temperature of a step. It takes M values,
the nodes, so that every law here is a mixture of M Gaussian ones: the sum over the nodes is the
exact posterior of the population. `linear` is the one Gaussian law of the same first and second
moments: by it, answers are linear in the data, and no other such ones are better.

In-run noise of covariance C = L L' is whitened and projected on what H and a constant can add,
e -> Q' L^-1 e, d figures an axis; nothing that tells of x, r or the heading is lost. Recordings of
different power-ups are meant: r_i has what a power-up adds in it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lbgc.estimators.block_means import Course, Levelled, Site
from lbgc.estimators.circle import posterior as on_circle
from lbgc.estimators.error_patterns import factors
from lbgc.estimators.estimate import Estimate
from lbgc.frames import wrap
from lbgc.sensor.imu import ImuModel

_FELT = 1e-6
"""Share of the largest singular value below which nothing of a pattern is felt."""
_LINEAR = 1e-3
"""The same of a standard deviation that adds to others: it changes a variance by a millionth."""
_GRID = np.deg2rad(np.arange(-180.0, 180.0, 0.5))


@dataclass(frozen=True, eq=False)
class Bench:
    """The recordings of a population: a sensor's in-run noise in T intervals of a resting one."""

    imu: ImuModel
    site: Site
    intervals: int
    """T"""
    interval_s: float

    @property
    def times(self) -> np.ndarray:
        """The middles of the intervals, (T,), s, from the recording's start."""
        return (np.arange(self.intervals) + 0.5) * self.interval_s

    @property
    def whitening(self) -> np.ndarray:
        """The inverses of the Cholesky factors of the gyros' in-run noise, (3, T, T)."""
        course = Course.planned(np.zeros(self.intervals), self.interval_s)
        return np.asarray(np.linalg.inv(factors(self.imu, course)[:3]))


@dataclass(frozen=True, eq=False)
class Context:
    """What labelled recordings of U units tell, summed over each unit's k recordings."""

    count: np.ndarray
    """(U, C), number of recordings at each condition"""
    total: np.ndarray
    """(U, C, 3, d), sums of their figures"""
    square: np.ndarray
    """(U, 3, d, d), sums of the outer products of all recordings' figures"""


@dataclass(frozen=True, eq=False)
class Told:
    """What a Gaussian law makes of a query after its context: log p(psi) = log + q' h - q' J q / 2
    with q = (cos psi, sin psi)."""

    h: np.ndarray
    """(U, 2)"""
    J: np.ndarray
    """(U, 2, 2), diagonal"""
    log: np.ndarray
    """(U,), the rest of the logarithm of the joint density of context and query"""
    expected: np.ndarray
    """(U, 3, d), figures that the unit's own errors are expected to add to the query"""


@dataclass(frozen=True, eq=False)
class Population:
    """A mixture of M Gaussian laws of a unit, in figures; rates in rad/s."""

    name: str
    bench: Bench
    weight: np.ndarray
    """(M,), probabilities of the nodes"""
    conditions: np.ndarray
    """(C,), values of the condition that a recording may have, from -1 to 1"""
    reduce: np.ndarray
    """(3, d, T), from an axis's interval means to its figures"""
    one: np.ndarray
    """(3, d), figures of a rate of 1 rad/s that stays"""
    columns: np.ndarray
    """(M, C, 3, d, r), H"""
    run: np.ndarray
    """(M,), (rad/s)^2, R"""

    @classmethod
    def of(
        cls,
        name: str,
        bench: Bench,
        patterns: np.ndarray,
        run: np.ndarray,
        weight: np.ndarray | None = None,
        conditions: np.ndarray | None = None,
    ) -> "Population":
        """The population whose units add patterns, (M, C, T, r), rad/s, to a recording's intervals,
        with biases of standard deviation run, (M,), rad/s, new in each. Without weights all nodes
        are equally probable; conditions : (C,), from -1 to 1."""
        nodes, count, intervals, _ = patterns.shape
        flat = np.moveaxis(patterns, 2, 0).reshape(intervals, -1)
        steady = np.ones((intervals, 1)) * max(np.abs(flat).max(), 1e-12)
        whitened = bench.whitening @ np.concatenate([steady, flat], axis=1)  # (3, T, 1 + M C r)
        U, size, _ = np.linalg.svd(whitened, full_matrices=False)
        d = int((size > _FELT * size[:, :1]).sum(axis=1).max())
        reduce = np.swapaxes(U[:, :, :d], 1, 2) @ bench.whitening
        columns = np.einsum("adt,mctr->mcadr", reduce, patterns, optimize=True)
        even = np.full(nodes, 1 / nodes) if weight is None else weight
        where = np.zeros(count) if conditions is None else conditions
        return cls(name, bench, even, where, reduce, reduce.sum(axis=2), columns, run**2)

    @property
    def nodes(self) -> int:
        """Number of values that theta may have."""
        return len(self.weight)

    @property
    def size(self) -> int:
        """Number of figures of an axis, d."""
        return int(self.one.shape[1])

    def linear(self) -> "Population":
        """The Gaussian law of the same first and second moments, at all conditions together."""
        m, c, _, d, r = self.columns.shape
        every = np.moveaxis(np.sqrt(self.weight)[:, None, None, None, None] * self.columns, 2, 0)
        wide = np.moveaxis(every, 1, 3).reshape(3, c * d, m * r)  # (3, C d, M r)
        U, size, _ = np.linalg.svd(wide, full_matrices=False)
        rank = int((size > _LINEAR * size.max()).sum(axis=1).max())
        own = (U[..., :rank] * size[:, None, :rank]).reshape(3, c, d, rank)
        return Population(
            self.name, self.bench, np.ones(1), self.conditions, self.reduce, self.one,
            np.moveaxis(own, 0, 1)[None], np.array([self.weight @ self.run]),
        )  # fmt: skip

    def figures(self, rates: np.ndarray) -> np.ndarray:
        """Figures, (..., 3, d), of interval means, (..., T, 3), rad/s."""
        return np.asarray(np.einsum("adt,...ta->...ad", self.reduce, rates, optimize=True))

    def level(self, part: Levelled) -> np.ndarray:
        """Figures, (V, 3, d), of recordings at rest, in level axes, less Earth's vertical rate."""
        rates = np.swapaxes(part.body[:, :3], 1, 2) @ np.swapaxes(part.base, 1, 2)  # (V, T, 3)
        rates[..., 2] -= part.site.down
        return self.figures(rates)

    def signal(self, heading: np.ndarray) -> np.ndarray:
        """Figures, (..., 3, d), of Earth's horizontal rate at headings, (...), rad."""
        north = self.bench.site.north
        felt = np.stack([np.cos(heading), -np.sin(heading), 0 * heading], axis=-1)
        return np.asarray(north * felt[..., None] * self.one)

    def draw(
        self, rng: np.random.Generator, units: int, recordings: int, sampled: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Recordings of units of one's own, less Earth's rate: their figures, (U, R, 3, d), their
        conditions' numbers, (U, R), and the unit's node, (U,). sampled : whether in-run noise is
        drawn as the sensor's means and then reduced, or as figures of the same law."""
        node = rng.choice(self.nodes, units, p=self.weight)
        condition = rng.integers(len(self.conditions), size=(units, recordings))
        r, d = self.columns.shape[-1], self.size
        x = rng.standard_normal((units, 1, 3, 1, r))
        own = np.sum(self.columns[node[:, None], condition] * x, axis=-1)
        new = rng.standard_normal((units, recordings, 3, 1))
        own += np.sqrt(self.run[node])[:, None, None, None] * new * self.one
        if not sampled:
            return own + rng.standard_normal((units, recordings, 3, d)), condition, node
        bench = self.bench
        noise = bench.imu.gyro.sample_noise(
            rng, units * recordings, bench.intervals, bench.interval_s
        )
        return own + self.figures(noise).reshape(own.shape), condition, node

    def context(self, figures: np.ndarray, condition: np.ndarray) -> Context:
        """The sums over labelled recordings. figures : (U, k, 3, d), less Earth's rate at their
        headings; condition : (U, k)."""
        u, k, _, d = figures.shape
        if len(self.conditions) == 1:
            count, total = np.full((u, 1), float(k)), figures.sum(axis=1)[:, None]
        else:
            there = (condition[:, None] == np.arange(len(self.conditions))[:, None]).astype(float)
            count = there.sum(axis=2)
            total = (there @ figures.reshape(u, k, 3 * d)).reshape(u, -1, 3, d)
        return Context(count, total, np.einsum("ukad,ukae->uade", figures, figures))

    def told(self, node: int, of: Context, query: np.ndarray, at: np.ndarray) -> Told:
        """What a node's law makes of queries. query : (U, 3, d), figures less those of Earth's
        vertical rate; at : (U,), their conditions' numbers."""
        H, one, d = self.columns[node], self.one, self.size
        V = np.eye(d) + self.run[node] * one[:, :, None] * one[:, None]  # (3, d, d)
        P = np.linalg.inv(V)
        weighted = np.einsum("ade,caer->cadr", P, H)
        G = np.einsum("cadr,cads->cars", H, weighted)
        J = np.eye(H.shape[-1]) + np.einsum("uc,cars->uars", of.count, G, optimize=True)
        g = np.einsum("ucad,cadr->uar", of.total, weighted, optimize=True)
        here = H[at]
        solved = np.linalg.solve(J, np.concatenate([g[..., None], np.swapaxes(here, -1, -2)], -1))
        mean, gain = solved[..., 0], solved[..., 1:]  # (U, 3, r), (U, 3, r, d)
        expected = np.einsum("uadr,uar->uad", here, mean)
        W = here @ gain + V
        off = query - expected
        both = np.concatenate([off[..., None], np.broadcast_to(one, off.shape)[..., None]], -1)
        byoff, byone = np.moveaxis(np.linalg.solve(W, both), -1, 0)
        k = of.count.sum(axis=1)
        log = np.einsum("uar,uar->u", g, mean) / 2 - np.linalg.slogdet(J)[1].sum(axis=1) / 2
        log -= np.einsum("ade,uade->u", P, of.square) / 2
        log -= k * np.linalg.slogdet(V)[1].sum() / 2
        log -= np.einsum("uad,uad->u", off, byoff) / 2 + np.linalg.slogdet(W)[1].sum(axis=1) / 2
        north = self.bench.site.north * np.array([1.0, -1.0])
        h = north * np.einsum("ad,uad->ua", one, byoff)[:, :2]
        J_q = north**2 * np.einsum("ad,uad->ua", one, byone)[:, :2]
        return Told(h, J_q[:, :, None] * np.eye(2), log, expected)

    def optimal(
        self, of: Context, query: np.ndarray, at: np.ndarray
    ) -> tuple[Estimate, np.ndarray]:
        """The Bayes-optimal headings, circular means of the posterior with its RMS angle about
        them, and the number of nodes that share each unit's posterior, 1/sum p^2, (U,)."""
        cos, sin = np.cos(_GRID), np.sin(_GRID)
        logs = np.empty((self.nodes, len(query), len(_GRID)))
        for node in range(self.nodes):
            told = self.told(node, of, query, at)
            h, J = told.h, told.J
            bent = J[:, :1, 0] * cos**2 + J[:, 1:, 1] * sin**2
            logs[node] = told.log[:, None] + h[:, :1] * cos + h[:, 1:] * sin - bent / 2
            logs[node] += np.log(self.weight[node])
        weight = np.exp(logs - logs.max(axis=(0, 2))[:, None])
        share = weight.sum(axis=2)
        share /= share.sum(axis=0)
        whole = weight.sum(axis=0)
        whole /= whole.sum(axis=1, keepdims=True)
        heading = np.angle(whole @ np.exp(1j * _GRID))
        sigma = np.sqrt(np.sum(whole * wrap(_GRID - heading[:, None]) ** 2, axis=1))
        return Estimate(heading, sigma), np.asarray(1 / np.sum(share**2, axis=0))

    def best_linear(self, of: Context, query: np.ndarray, at: np.ndarray) -> tuple[Estimate, Told]:
        """Headings by a law of one node, and what it makes of the queries: of a population's
        `linear`, those of its best linear estimate of a unit."""
        told = self.told(0, of, query, at)
        found = on_circle(told.h, told.J)
        return Estimate(wrap(found.heading), found.sigma), told


def splits(bench: Bench, bias: float, shares: np.ndarray, name: str = "split") -> Population:
    """Units whose bias, rad/s, has these shares, (M, 3), of its variance kept, new in each power-up
    and new in each recording; the split is told where there is one."""
    kept = bias * np.sqrt(shares[:, 0])
    patterns = kept[:, None, None, None] * np.ones((1, 1, bench.intervals, 1))
    return Population.of(name, bench, patterns, bias * np.sqrt(1 - shares[:, 0]))


def good_and_bad(bench: Bench, good: float, bad: float, share: float, run: float) -> Population:
    """Units of two kinds: a share of them bad. good, bad : rad/s, 1 sigma of the constant bias of
    either kind, the same kind on all axes; run : of what is new in each recording."""
    patterns = np.array([good, bad])[:, None, None, None] * np.ones((1, 1, bench.intervals, 1))
    return Population.of(
        "good and bad units", bench, patterns, np.full(2, run), np.array([1 - share, share])
    )


def warm_ups(
    bench: Bench,
    steady: float,
    warming: float,
    run: float,
    time_s: tuple[float, float],
    latest_s: float,
    nodes: int = 64,
    ages: int = 31,
) -> Population:
    """Units that warm up, each with a time constant of its own: b = x_1 steady + x_2 warming
    exp(-t/T), t from power-up, rad/s. time_s : s, least and largest T, whose logarithm is uniform;
    recordings start up to latest_s after power-up, which is known of each."""
    constants = np.geomspace(*time_s, 2 * nodes + 1)[1::2]
    starts = np.linspace(0, latest_s, ages)
    since = starts[:, None] + bench.times
    fall = np.exp(-since / constants[:, None, None])  # (M, C, T)
    patterns = np.stack([steady * np.ones_like(fall), warming * fall], axis=-1)
    even = np.linspace(-1, 1, ages)
    return Population.of("warm-up", bench, patterns, np.full(nodes, run), conditions=even)


def steps_in_temperature(
    bench: Bench,
    steady: float,
    step: float,
    run: float,
    width: float,
    nodes: int = 64,
    temperatures: int = 61,
) -> Population:
    """Units whose bias steps at a temperature of their own: b = x_1 steady + x_2 step
    tanh((c - c_0)/width), rad/s, at temperatures c from -1 to 1, the whole range, known of each
    recording; c_0 is anywhere in it."""
    where = np.linspace(-1, 1, temperatures)
    centres = (np.arange(nodes) + 0.5) / nodes * 2 - 1
    curve = np.tanh((where - centres[:, None]) / width)  # (M, C)
    ones = np.ones((1, 1, bench.intervals))
    curves = curve[..., None] * ones
    patterns = np.stack([steady * np.ones_like(curves), step * curves], axis=-1)
    return Population.of("step in temperature", bench, patterns, np.full(nodes, run),
                         conditions=where)  # fmt: skip


def in_parts(count: int, size: int) -> Iterator[slice]:
    """Slices of `size` that cover `count`, so that many units take little memory."""
    return (slice(first, min(first + size, count)) for first in range(0, count, size))
