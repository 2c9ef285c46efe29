"""The information in poses at rest on their headings, when every error is Gaussian.

With L_p the rotation from the body's axes to level ones in pose p, lat the latitude and

    v = (cos lat cos psi_p, cos lat sin psi_p, sin lat, psi_p+1 - psi_p - Delta_p)

the reduced data of a session are

    d = V v + T t + U e + noise,    e, noise standard normal

t the levels' errors, two a pose, of any size, e the errors that are drawn once for the session, and
V and U coefficients of each pose's means (see lbgc.estimators.error_patterns; at rest two of its
patterns are left, one and warming up). The means' covariance is that of the in-run terms over all
rests of the session, whitened as in lbgc.estimators.information. A turn between poses that the
gyros tell (lbgc.estimators.held) gives three figures more,

    L_p M L_p+1' = (1 + [d x]) Rz(Delta):
    d = (psi_p+1 - psi_p - Delta) e_z + T w_p - t_p + Rz(Delta) t_p+1 + L_p a

with T the time of the turn, w_p Earth's rate in level axes of pose p's heading, and a what the
gyros' errors integrate to. Its noise is angle random walk and what the bias wanders from its
constant by the session's end, as if new in each turn: that the rests tell most of that wandering is
not made use of, and sigma is a little too large by it.

t and e are taken out by least squares, and what remains is log p = v' h - v' J v / 2 + constant.
What follows the truth (scale factor, misalignment) depends on the headings besides; the columns U
are those at given headings, or, where none are given, those that follow the vertical rate alone.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg

from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.estimators.block_means import Site
from lbgc.estimators.error_patterns import (
    ANY_TILT,
    CHANNELS,
    COS,
    GYRO,
    ONE,
    PATTERNS,
    STEADY,
    WARM,
    bench_causes,
    drawn_columns,
    felt_of,
    signal,
)
from lbgc.estimators.held import ERRORS, Held, Layout, SensorErrors, Turn
from lbgc.frames import about_vertical, rotation_z
from lbgc.sensor import errors
from lbgc.sensor.imu import ImuModel
from lbgc.sensor.known import Coefficient

_MEAN_GRAVITY = normal_gravity(float(np.pi / 4))
_ANY_GRAVITY = 3.0
"""By how much gravity is less sure where the latitude is not known: it changes by 0.5% in all."""
_LEAST = np.repeat((1e-12, 1e-9), 3)
"""rad/s and m/s^2, noise far below any sensor's, as in lbgc.estimators.error_patterns."""


_BEGIN = {
    ("gyro", errors.ONE): 0,
    ("gyro", errors.TRUTH): 3,
    ("gyro", errors.FORCE): 12,
    ("accel", errors.ONE): 21,
    ("accel", errors.TRUTH): 24,
}
"""Where the errors of a kind begin in a row of `SensorErrors`."""


@dataclass(frozen=True, eq=False)
class Reduction:
    """How a sensor's means over the parts of a layout's rests are reduced, k figures a pose and
    channel: k = 1, or 2 where the sensor warms up."""

    R: np.ndarray
    """(CHANNELS, k P, k P), fewer rows where there are fewer parts"""
    reduce: np.ndarray
    """(CHANNELS, k P, n)"""

    def columns(self, coefficients: np.ndarray) -> np.ndarray:
        """Reduced data, (r, CHANNELS k P), of coefficients, (P, r, CHANNELS, PATTERNS), at rest."""
        at_rest = coefficients[..., ONE] + coefficients[..., COS]
        both = [at_rest]
        if self.R.shape[2] > len(coefficients):
            both.append(coefficients[..., WARM + ONE] + coefficients[..., WARM + COS])
        stacked = np.concatenate(both, axis=0)  # (k P, r, CHANNELS)
        found = np.einsum("cab,brc->rca", self.R, stacked)
        return np.asarray(found.reshape(stacked.shape[1], -1))

    def told(self, body: np.ndarray) -> np.ndarray:
        """Reduced data, (CHANNELS k P,), of means (CHANNELS, n)."""
        return np.asarray(np.einsum("can,cn->ca", self.reduce, body).ravel())


@lru_cache(maxsize=8)  # megabytes each
def reduction(imu: ImuModel, layout: Layout) -> Reduction:
    """The reduction of a session's means, by the covariance of the sensor's in-run noise."""
    A, pose = layout.averaged(), layout.pose()
    B = (pose[:, None] == np.arange(len(layout.rests))).astype(float)
    if imu.warming.rise_k != 0 and any(
        e.warms and e.sigma.any() for triad in (imu.gyro, imu.accel) for e in triad.drawn
    ):
        rise = A @ imu.warming.rise(layout.count, layout.interval)
        B = np.concatenate([B, B * rise[:, None]], axis=1)
    found: dict[object, tuple[np.ndarray, np.ndarray]] = {}
    R, reduce = [], []
    for channel in range(CHANNELS):
        triad, axis = (imu.gyro if channel < 3 else imu.accel), channel % 3
        terms = triad.in_run(axis, imu.dt)
        if (key := (terms, channel < 3)) not in found:
            whole = sum(
                (t.covariance_of_means(layout.count, layout.interval, 1, 0) for t in terms),
                np.zeros((layout.count, layout.count)),
            )
            C = A @ whole @ A.T + _LEAST[channel] ** 2 * np.eye(len(A))
            by = scipy.linalg.solve_triangular(np.linalg.cholesky(C), np.eye(len(A)), lower=True)
            Q, own = np.linalg.qr(by @ B)
            found[key] = own, Q.T @ by
        R.append(found[key][0])
        reduce.append(found[key][1])
    return Reduction(np.array(R), np.array(reduce))


@dataclass(frozen=True, eq=False)
class Form:
    """log p of the headings of P poses, v' h - v' J v / 2 + a constant; see the module."""

    poses: int
    latitude: float | None
    """rad"""
    linked: np.ndarray
    """(K,), numbers of the poses from which the turn to the next is known"""
    delta: np.ndarray
    """(K,), rad, these turns"""
    h: np.ndarray
    """(2 P + 1 + K,)"""
    J: np.ndarray
    """(2 P + 1 + K, 2 P + 1 + K)"""
    lasting: np.ndarray
    """(ERRORS,), the sensor's errors (`lbgc.estimators.held.SensorErrors`), beyond what is known of
    the unit, were v zero"""
    lasting_by: np.ndarray
    """(ERRORS, 2 P + 1 + K): they are `lasting` less this times v"""
    bias_covariance: np.ndarray
    """(3, 3), (rad/s)^2, of the bias when v is known"""
    tilt: np.ndarray
    """(P, 2), rad: the levels' errors about the level axes forward and right, were v zero"""
    tilt_by: np.ndarray
    """(P, 2, 2 P + 1 + K): they are `tilt` less this times v"""

    def errors(self, v: np.ndarray) -> SensorErrors:
        """The sensor's errors where the poses are held by v."""
        return SensorErrors.of(self.lasting - self.lasting_by @ v)


def form(
    of: Held, imu: ImuModel, heading: np.ndarray | None = None, latitude: float | None = None
) -> Form:
    """What poses tell. heading : (P,), rad, at which errors that follow the truth are taken; None:
    their share of the horizontal rate is left out; latitude : rad, likewise, where the log's is not
    known."""
    known = of.latitude
    at = known if known is not None else (0.0 if latitude is None else latitude)
    site = Site(at, normal_gravity(at) if known is not None else _MEAN_GRAVITY)
    V, T, U, d, lasting = _rests(of, imu, site, heading)
    if len(of.linked):
        every = _turns(of, imu, site, heading)
        K = len(of.linked)
        V = np.concatenate([np.pad(V, ((0, K), (0, 0))), every[0]], axis=1)
        T, U = np.concatenate([T, every[1]], axis=1), np.concatenate([U, every[2]], axis=1)
        d = np.concatenate([d, every[3]])
    N = np.concatenate([T, U]).T
    ones = np.eye(N.shape[1])
    both = np.column_stack([V.T, d])
    Q, S = np.linalg.qr(np.concatenate([N, ones]))
    taken = Q[: len(N)]
    left = np.pad(both, ((0, len(ones)), (0, 0))) - Q @ (taken.T @ both)
    J = left[:, :-1].T @ left
    wanted = np.concatenate([np.pad(lasting, ((0, 0), (len(T), 0))), ANY_TILT * ones[: len(T)]])
    root = scipy.linalg.solve_triangular(S, wanted.T, trans="T").T
    by = root @ (taken.T @ both)
    tilt = np.moveaxis(by[len(lasting) :].reshape(2, of.count, -1), 0, 1)
    delta = about_vertical(of.between())
    return Form(
        of.count, known, of.linked, delta, J[:, -1], J[:, :-1], by[:ERRORS, -1], by[:ERRORS, :-1],
        root[:3] @ root[:3].T, tilt[..., -1], tilt[..., :-1],
    )  # fmt: skip


def _every(
    imu: ImuModel, of: Held, site: Site, heading: np.ndarray | None
) -> dict[Coefficient, np.ndarray]:
    """What 1 sigma of each coefficient adds to the means, (P, CHANNELS, PATTERNS)."""
    return {
        which: column
        for _, which, part, column in drawn_columns(imu, of.base, site, heading=heading)
        if part == STEADY
    }


def _independent(imu: ImuModel, which: list[Coefficient], columns: np.ndarray) -> np.ndarray:
    """Columns, (r, m), by coefficients of known units' own law, (r, m) by independent normals."""
    if imu.known is None:
        return columns
    number = {c: k for k, c in enumerate(which)}
    own = [(k, number[c]) for k, c in enumerate(imu.known.coefficients) if c in number]
    rows, at = (list(each) for each in zip(*own, strict=True)) if own else ([], [])
    columns = columns.copy()
    rest = imu.known.correlated[rows].T @ columns[at]
    columns[at] = 0.0
    return np.concatenate([columns, rest])


def _rests(
    of: Held, imu: ImuModel, site: Site, heading: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the means at rest: V (2 P + 1, m), T (2 P, m), U (r, m), d (m,), and what each of e makes
    of the sensor's errors, (ERRORS, r)."""
    white, P = reduction(imu, of.layout), of.count
    felt = signal(of.base, site)
    north = signal(of.base, Site(0.0, site.gravity))

    def apart(each: np.ndarray) -> np.ndarray:
        """(P, CHANNELS, PATTERNS), of each pose alone: (P, m)."""
        return white.columns(np.eye(P)[:, :, None, None] * each[:, None])

    vertical = np.zeros((P, 1, CHANNELS, PATTERNS))
    vertical[:, 0, GYRO] = felt_of(of.base, np.array([0.0, 0.0, -EARTH_RATE]))
    V = np.concatenate([apart(north.q[0]), apart(north.q[1]), white.columns(vertical)])
    tilts = [own.copy() for own in felt.tilt]
    if heading is not None:  # such an error makes a part of Earth's horizontal rate vertical
        down = felt_of(of.base, np.array([0.0, 0.0, site.north]))
        for own, share in zip(tilts, (np.sin(heading), np.cos(heading)), strict=True):
            own[:, GYRO] += share[:, None, None] * down
    T = ANY_TILT * np.concatenate([apart(tilts[0]), apart(tilts[1])])
    every = _every(imu, of, site, heading)
    which = list(every)
    raw = white.columns(np.stack(list(every.values()), 1)) if which else np.zeros((0, V.shape[1]))
    bench = bench_causes(of.base, site)
    aside = white.columns(bench["gravity"])
    if of.latitude is None:
        aside = _ANY_GRAVITY * aside
    else:
        aside = np.concatenate([aside, white.columns(bench["latitude"])])
    U = np.concatenate([_independent(imu, which, raw), aside])
    lasting = np.zeros((ERRORS, len(which)))
    for k, c in enumerate(which):
        triad = imu.gyro if c.triad == "gyro" else imu.accel
        error = next(e for e in triad.drawn if e.name == c.error)
        begin = _BEGIN.get((c.triad, error.follows))
        if begin is not None and not error.warms:
            row = begin + (c.i if error.follows == errors.ONE else 3 * c.i + c.j)
            lasting[row, k] = error.sigma[c.i, c.j]
    lasting = np.pad(_independent(imu, which, lasting.T), ((0, len(aside)), (0, 0))).T
    force = white.columns(np.pad(felt.known[:, None, 3:], ((0, 0), (0, 0), (3, 0), (0, 0))))[0]
    return V, T, U, white.told(of.body) - force, lasting


def _turns(
    of: Held, imu: ImuModel, site: Site, heading: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of K known turns, 3 K figures: V (2 P + 1 + K, 3 K), T (2 P, 3 K), U (r, 3 K), d (3 K,)."""
    P, K = of.count, len(of.linked)
    every = list(_every(imu, of, site, heading))
    V, T = np.zeros((2 * P + 1 + K, K, 3)), np.zeros((2, P, K, 3))
    raw, d = np.zeros((len(every), K, 3)), np.zeros((K, 3))
    kinds = {e.name: (e.follows, e.warms, e.sigma) for e in imu.gyro.drawn}
    for k, (p, D) in enumerate(zip(of.linked.tolist(), of.between(), strict=True)):
        turn = of.turns[p]
        assert turn is not None
        slow = _wandered(imu, of.layout.duration_s, turn.seconds)
        about = rotation_z(about_vertical(D))
        L = of.base[p]
        E = D @ about.T
        d[k] = np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]) / 2
        d[k] += L @ turn.taken
        V[2 * P + 1 + k, k, 2] = 1.0
        V[p, k, 0], V[P + p, k, 1] = np.array([1, -1]) * EARTH_RATE * turn.seconds
        V[2 * P, k, 2] = -EARTH_RATE * turn.seconds
        T[0, p, k, 0] = T[1, p, k, 1] = -ANY_TILT
        T[0, p + 1, k], T[1, p + 1, k] = ANY_TILT * about[:, 0], ANY_TILT * about[:, 1]
        for row, which in zip(raw, every, strict=True):
            if which.triad == "gyro":
                follows, warms, sigma = kinds[which.error]
                size = sigma[which.i, which.j] * (turn.warmth if warms else 1.0)
                row[k] = size * (L @ _integral(turn, follows, which.i, which.j))
        spread = sum(
            imu.gyro.N[i] ** 2 * turn.square[i] + slow[i] * np.outer(turn.one[:, i], turn.one[:, i])
            for i in range(3)
        )
        lower = np.linalg.cholesky(L @ (spread + 1e-18 * np.eye(3)) @ L.T)
        own = (V[:, k], T[0, :, k], T[1, :, k], raw[:, k])
        for each in own:
            each[:] = scipy.linalg.solve_triangular(lower, each.T, lower=True).T
        d[k] = scipy.linalg.solve_triangular(lower, d[k], lower=True)
    U = _independent(imu, every, raw.reshape(len(every), 3 * K))
    bench = 1 if of.latitude is None else 2
    return (
        V.reshape(len(V), 3 * K),
        T.reshape(2 * P, 3 * K),
        np.pad(U, ((0, bench), (0, 0))),
        d.ravel(),
    )


@lru_cache(maxsize=64)
def _wandered(imu: ImuModel, duration_s: float, seconds: float) -> np.ndarray:
    """Variance of what evolves within a session, all but white noise, in the mean over so many
    seconds at the end of it, of each gyro, (3,), (rad/s)^2."""
    start = max(0, int(duration_s / seconds) - 1)
    each = [
        sum(t.covariance_of_means(1, seconds, 1, start)[0, 0] for t in imu.gyro.in_run(i, imu.dt))
        for i in range(3)
    ]
    return np.maximum(np.array(each) - imu.gyro.N**2 / seconds, 0.0)


def _integral(turn: Turn, follows: str, i: int, j: int) -> np.ndarray:
    """What a gyro error c_ij = 1 that follows this integrates to over a turn, (3,), in the axes of
    the body before it. What follows the magnetic field is left out: it is not known there."""
    if follows == errors.ONE:
        return turn.one[:, i]
    return {errors.TRUTH: turn.truth, errors.FORCE: turn.force}.get(follows, np.zeros((3, 3, 3)))[
        :, i, j
    ]
