"""The posterior of one unit's lasting errors, given its recordings with known headings.

At a known heading psi the data of a recording (see lbgc.estimators.information) are linear in what
is not known of them,

    d - S q - known = X x - S q' (delta + delta_0) + T t + B b + in-run noise,    q' = dq/dpsi

x the sensor's coefficients by their prior sigmas (of the unit, of this power-up, of this
recording), delta the reference's error, new in each recording, delta_0 its constant offset, t the
level's error, b what the bench adds. Everything is Gaussian, so a recording's data are summed up by
the information (J, h) on (x, delta_0), from which the rest is eliminated. What a recording alone
has is eliminated from that, the sum over recordings of a power-up is formed, what the power-up
alone has is eliminated, and the sum over power-ups and the prior make the posterior: exact, and the
same as the joint covariance of all recordings gives.

How a gyro's bias splits into what a unit keeps, a power-up adds and a recording adds may itself be
unknown (lbgc.estimators.bias_split; the same for all axes, whose sum is the model's). Then the
posterior is the mixture over the shares, weighted by their evidence, and it is stated by its first
two moments.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbgc.data.windows import Windows
from lbgc.estimators.block_means import Levelled, levelled
from lbgc.estimators.error_patterns import (
    ANY_TILT,
    CHANNELS,
    PATTERNS,
    STEADY,
    bench_causes,
    drawn_columns,
    signal,
    timeless,
)
from lbgc.estimators.information import whitened
from lbgc.estimators.posterior import across, along
from lbgc.sensor import unit
from lbgc.sensor.errors import LIFETIMES, ONE
from lbgc.sensor.imu import ImuModel
from lbgc.sensor.known import Coefficient, Known
from lbgc.sensor.unit import coefficients

Shares = tuple[float, float, float]
"""Shares of a bias's variance that a unit keeps, a power-up adds and a recording adds."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The error of the instrument that told the headings, 1 sigma in rad."""

    new: np.ndarray
    """(R,), what is new in each recording"""
    offset: float = 0.0
    """What is the same in all of them"""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What R recordings tell of m unknowns: the coefficients, by their prior sigmas, and the
    reference's offset, by its own."""

    coefficients: tuple[Coefficient, ...]
    """(m - 1,)"""
    sigma: np.ndarray
    """(m - 1,), 1 sigma of each before anything is known, SI"""
    h: np.ndarray
    """(R, m)"""
    J: np.ndarray
    """(R, m, m)"""


def evidence(
    imu: ImuModel, several: list[Windows], heading: np.ndarray, reference: Reference
) -> Evidence:
    """What recordings of one unit tell of it, several of V windows each, R in all, a whole
    recording in each window. heading : (R,), rad, as the reference tells them."""
    parts, at = [], 0
    for windows in several:
        for part in levelled(windows, imu.dt, timeless(imu)):
            parts.append(replace(part, rows=at + part.rows))
        at += len(windows)
    return evidence_of(imu, parts, heading, reference)


def evidence_of(
    imu: ImuModel, parts: Sequence[Levelled], heading: np.ndarray, reference: Reference
) -> Evidence:
    """The same of recordings that are levelled already; `rows` are their numbers among all."""
    every = coefficients(imu, *LIFETIMES)
    m = len(every) + 1
    h, J = np.empty((len(heading), m)), np.empty((len(heading), m, m))
    for part in parts:
        own = part.rows
        h[own], J[own] = _told(
            imu, part, list(every), heading[own], reference.new[own], reference.offset
        )
    return Evidence(tuple(every), np.array(list(every.values())), h, J)


def _told(
    imu: ImuModel,
    part: Levelled,
    every: list[Coefficient],
    heading: np.ndarray,
    new: np.ndarray,
    offset: float,
) -> tuple[np.ndarray, np.ndarray]:
    """h, (V, m), and J, (V, m, m), of recordings that share a course. heading, new : (V,), rad."""
    base, site, axis = part.base, part.site, part.course.axis
    white, felt = whitened(imu, part.course), signal(base, site, axis)
    number = {c: k for k, c in enumerate(every)}
    X = np.zeros((len(base), len(every) + 1, CHANNELS, PATTERNS))
    aside = [ANY_TILT * np.stack(felt.tilt, axis=1), *bench_causes(base, site, axis).values()]
    for _, which, of, column in drawn_columns(imu, base, site, axis, heading):
        if of == STEADY:
            X[:, number[which]] = column
        else:
            aside.append(column[:, None])
    q, turn = along(heading)[..., None, None], across(heading)[..., None, None]
    by_heading = turn[:, 0] * felt.q[0] + turn[:, 1] * felt.q[1]
    X[:, -1] = -offset * by_heading
    aside.append(new[:, None, None, None] * by_heading[:, None])
    y = white.told(part.body)
    y = y - white.columns(felt.known + q[:, 0] * felt.q[0] + q[:, 1] * felt.q[1])
    X = np.swapaxes(white.columns(X), 1, 2)
    N = np.swapaxes(white.columns(np.concatenate(aside, axis=1)), 1, 2)
    both = np.concatenate([X, y[..., None]], axis=2)
    inner = np.eye(N.shape[2]) + np.swapaxes(N, 1, 2) @ N
    freed = both - N @ np.linalg.solve(inner, np.swapaxes(N, 1, 2) @ both)
    found = np.swapaxes(X, 1, 2) @ freed
    return found[..., -1], found[..., :-1]


@dataclass(frozen=True, eq=False)
class Posterior:
    """What is known of a unit after its labelled recordings."""

    known: Known
    """The law of the unit's coefficients, and of those of the power-up that was asked for"""
    imu: ImuModel
    """The sensor's model as it is now: what is left of the unit, and what a power-up and a
    recording add"""
    shares: np.ndarray
    """(S, 3), the splits that were weighed; one, where the split is the model's"""
    weight: np.ndarray
    """(S,), the posterior probability of each"""
    logs: np.ndarray
    """(S,), logarithm of the recordings' probability by each, as below"""
    log_evidence: float
    """Logarithm of the recordings' probability by the model, less that of a model without any of
    these coefficients"""


def posterior(
    imu: ImuModel,
    told: Evidence,
    session: np.ndarray,
    now: object | None = None,
    shares: np.ndarray | None = None,
    mass: np.ndarray | None = None,
) -> Posterior:
    """The posterior of a unit. imu : the model that `told` was made with; session : (R,), the
    power-up that each recording is from; now : the power-up that is still on, whose own errors are
    known likewise; None: it has been switched off. shares : (S, 3), the splits of the gyros' bias
    to weigh, and mass : (S,), how probable each is beforehand (None: all alike), where `imu` has
    the whole bias in each lifetime (see `undivided`)."""
    part = _parts(session, now)
    every = np.ones((1, part.max(initial=-1) + 1))
    return _posteriors(imu, told, session, now, shares, mass, every)[0]


def of_others(
    imu: ImuModel,
    told: Evidence,
    session: np.ndarray,
    now: object | None,
    shares: np.ndarray,
    mass: np.ndarray,
) -> tuple[np.ndarray, list[Posterior]]:
    """The part, (R,), that each recording belongs to, a power-up, or a recording of that which is
    still on; and of each part the posterior by all others. Arguments : as of `posterior`."""
    part = _parts(session, now)
    others = 1.0 - np.eye(part.max() + 1)
    return part, _posteriors(imu, told, session, now, shares, mass, others)


def _parts(session: np.ndarray, now: object | None) -> np.ndarray:
    """Which recordings, (R,), tell of the unit together: those of a power-up that is over, whose
    errors they share; and each of that which is still on."""
    _, number = np.unique(session, return_inverse=True)
    alone = len(session) + np.arange(len(session))
    return np.unique(np.where(session == now, alone, number), return_inverse=True)[1]


def _posteriors(
    imu: ImuModel,
    told: Evidence,
    session: np.ndarray,
    now: object | None,
    shares: np.ndarray | None,
    mass: np.ndarray | None,
    several: np.ndarray,
) -> list[Posterior]:
    """The posterior by some of the parts, for each of K choices of them, (K, P), 1 or 0."""
    power = "session" if now is not None else None
    lasts = [_lifetime(imu, c) for c in told.coefficients]
    names = [k for k, lifetime in enumerate(lasts) if lifetime in ("unit", power)]
    every = np.ones((1, 3)) if shares is None else shares
    part, sigma = _parts(session, now), told.sigma[names]
    which = tuple(told.coefficients[k] for k in names)
    before = (
        {} if imu.known is None else dict(zip(imu.known.coefficients, imu.known.mean, strict=True))
    )
    already = np.array([before.get(c, 0.0) for c in which])
    found = []
    for own in every:
        prior = _prior(imu, told, own)
        (h, J, log), kept = _sums(told, lasts, part, session == now, prior)
        sums = several @ h, np.tensordot(several, J, 1), several @ log
        found.append(_concluded(*sums, prior[names][:, kept]))
    posteriors = []
    by_choice = (np.stack(each, axis=1) for each in zip(*found, strict=True))
    for of_mean, of_covariance, of_log in zip(*by_choice, strict=True):
        before_it = np.full(len(every), 1 / len(every)) if mass is None else mass
        weight = before_it * np.exp(of_log - of_log.max())
        log_evidence = float(of_log.max() + np.log(weight.sum()))
        weight /= weight.sum()
        mean = weight @ of_mean
        off = of_mean - mean
        covariance = np.tensordot(weight, of_covariance, 1) + (weight * off.T) @ off
        known = Known(which, already + sigma * mean, covariance * sigma * sigma[:, None])
        split = imu if shares is None else divided(imu, weight @ every)
        left = unit.told(split, known)
        posteriors.append(Posterior(known, left, every, weight, of_log, log_evidence))
    return posteriors


def _lifetime(imu: ImuModel, which: Coefficient) -> str:
    """How long a coefficient lasts."""
    triad = imu.gyro if which.triad == "gyro" else imu.accel
    return next(error.lifetime for error in triad.drawn if error.name == which.error)


def _prior(imu: ImuModel, told: Evidence, shares: np.ndarray) -> np.ndarray:
    """Matrix, (m, m), that makes the unknowns, as they are before the recordings, of independent
    normals of variance one. shares : (3,), of the gyros' bias; ones where it is not divided."""
    scale = np.ones(len(told.coefficients) + 1)
    biases = {e.name: e.lifetime for e in imu.gyro.drawn if e.follows == ONE and not e.warms}
    for k, c in enumerate(told.coefficients):
        if c.triad == "gyro" and c.error in biases:
            scale[k] = np.sqrt(shares[LIFETIMES.index(biases[c.error])])
    prior = np.diag(scale)
    if imu.known is not None:
        own = [told.coefficients.index(c) for c in imu.known.coefficients]
        prior[np.ix_(own, own)] = imu.known.correlated
    return prior


def _sums(
    told: Evidence, lasts: list[str], part: np.ndarray, on: np.ndarray, prior: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """What P parts tell of what lasts through them: h, (P, n), J, (P, n, n), and the logarithms of
    what was integrated out, (P,); and which of the m unknowns those are. lasts : the lifetime of
    each coefficient; part : see `_parts`; on : (R,), whether a recording's power-up is still on;
    prior : see `_prior`."""
    run, power = (np.array([*(own == life for own in lasts), False]) for life in ("run", "session"))
    one_h, one_J, one_log = _eliminated(told.h @ prior, prior.T @ told.J @ prior, run)
    power, count = power[~run], part.max(initial=-1) + 1
    member = (part == np.arange(count)[:, None]).astype(float)
    h, J, log = member @ one_h, np.tensordot(member, one_J, 1), member @ one_log
    off = np.ones(count, bool)
    off[part[on]] = False
    of_h, of_J, of_log = _eliminated(h[off], J[off], power)
    h[off], J[off], log[off] = 0.0, 0.0, log[off] + of_log
    h[np.ix_(off, ~power)] = of_h
    J[np.ix_(off, ~power, ~power)] = of_J
    return (h, J, log), ~run


def _concluded(
    h: np.ndarray, J: np.ndarray, log: np.ndarray, prior: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, (K, r), and covariance, (K, r, r), of what is asked for, by prior sigmas, and the log
    evidence, (K,), of what K choices of recordings tell, h (K, n) and J (K, n, n), of unknowns that
    are normals of variance one before. prior : (r, n), what is asked for by those."""
    factor = np.linalg.cholesky(np.eye(h.shape[1]) + J)
    half = np.linalg.solve(factor, h[..., None])[..., 0]
    size = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    root = np.linalg.solve(factor, np.broadcast_to(prior.T, (len(h), *prior.T.shape)))
    turned = np.swapaxes(root, 1, 2)
    log = log + np.einsum("ki,ki->k", half, half) / 2 - size
    return (turned @ half[..., None])[..., 0], turned @ root, log


def _eliminated(
    h: np.ndarray, J: np.ndarray, which: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Information vectors, (R, n), and matrices, (R, n, n), of the other unknowns when those that
    `which` marks, (n,), are integrated out over their prior, and the logarithms of the integrals,
    (R,)."""
    inner = np.eye(int(which.sum())) + J[:, which][:, :, which]
    cross = J[:, which][:, :, ~which]
    right = np.concatenate([cross, h[:, which, None]], axis=2)
    solved = np.linalg.solve(inner, right)
    less = np.swapaxes(cross, 1, 2) @ solved
    log = np.einsum("ri,ri->r", h[:, which], solved[..., -1]) / 2
    log -= np.linalg.slogdet(inner)[1] / 2
    rest = J[:, ~which][:, :, ~which] - less[..., :-1]
    return h[:, ~which] - less[..., -1], rest, log


def undivided(imu: ImuModel) -> ImuModel:
    """The model with the whole of the gyros' bias in each lifetime, of which shares are then
    taken."""
    whole = tuple(imu.gyro.bias().tolist())
    return replace(imu, gyro=imu.gyro.with_bias(unit=whole, session=whole, run=whole))


def divided(imu: ImuModel, shares: np.ndarray) -> ImuModel:
    """An undivided model with these shares, (3,)."""
    whole = imu.gyro.bias("unit")
    sizes = {
        life: tuple((np.sqrt(own) * whole).tolist())
        for life, own in zip(LIFETIMES, shares, strict=True)
    }
    return replace(imu, gyro=imu.gyro.with_bias(**sizes))
