"""The posterior of several headings that depend on each other, and of the latitude.

log p(theta) = v' h - v' J v / 2 + log prior, theta the headings psi_p of P poses (each on a circle,
flat prior) and, where it is not known, the latitude (its sine uniform beforehand), v as in
lbgc.estimators.pose_information: a quadratic form on a torus, with any number of maxima.

Maxima are found by Levenberg and Marquardt's steps from many starts: headings of the Gaussian that
the posterior would be, were q any vectors of about the right length, and where turns are known,
chains of them. About each the posterior is nearly Normal(mode, H^-1): the mixture of these is what
particles are drawn from. They are weighted, and where the weights scatter too much they go from
the mixture to the posterior by steps (sequential Monte Carlo: p^t times the mixture^(1 - t), the
particles chosen anew by weight and moved by Metropolis' rule). All draws are seeded.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.errors import require_choice
from lbgc.estimators.pose_information import Form
from lbgc.frames import wrap
from lbgc.sensor import streams

HEMISPHERES = ("either", "north", "south")
STARTS = 64
PARTICLES = 1000
_ROUNDS, _LARGEST = 60, 0.5  # of steps to a maximum; rad, the largest step
_SAME = 0.02  # rad, within which two maxima are one
_UNLIKELY = 12.0  # log, by which a maximum may be less likely than the likeliest
_MOST = 24  # maxima
_WIDER = 1.1  # standard deviations of the mixture over those of the maxima
_WIDEST = 0.9  # rad, largest standard deviation in any direction of a part of the mixture
_ENOUGH = 0.3  # share of the particles that must count
_MOVES = 10  # at each step
_STEPS = 40  # at the most
_POLE = np.pi / 2 - 1e-6


@dataclass(frozen=True, eq=False)
class Torus:
    """A posterior of n coordinates: P headings, and the latitude where it is not known."""

    of: Form
    hemisphere: str = "either"
    """Where the latitude is known to be: one of HEMISPHERES"""

    def __post_init__(self) -> None:
        require_choice("hemisphere", self.hemisphere, HEMISPHERES)

    @property
    def free(self) -> bool:
        """Whether the latitude is a coordinate."""
        return self.of.latitude is None

    @property
    def size(self) -> int:
        """n."""
        return self.of.poses + self.free

    def _latitude(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """cos and sin of the latitude, (*S,)."""
        at = theta[..., -1] if self.free else np.full(theta.shape[:-1], self.of.latitude)
        return np.cos(at), np.sin(at)

    def v(self, theta: np.ndarray) -> np.ndarray:
        """v, (*S, 2 P + 1 + K), at theta, (*S, n)."""
        P, at = self.of.poses, self.of.linked
        psi = theta[..., :P]
        c, s = (own[..., None] for own in self._latitude(theta))
        off = wrap(psi[..., at + 1] - psi[..., at] - self.of.delta)
        return np.concatenate([c * np.cos(psi), c * np.sin(psi), s, off], axis=-1)

    def slopes(self, theta: np.ndarray) -> np.ndarray:
        """dv/dtheta, (K, 2 P + 1 + links, n), at theta, (K, n)."""
        P, at = self.of.poses, self.of.linked
        psi, k = theta[:, :P], np.arange(P)
        c, s = self._latitude(theta)
        D = np.zeros((len(theta), 2 * P + 1 + len(at), self.size))
        D[:, k, k] = -c[:, None] * np.sin(psi)
        D[:, P + k, k] = c[:, None] * np.cos(psi)
        link = 2 * P + 1 + np.arange(len(at))
        D[:, link, at + 1], D[:, link, at] = 1.0, -1.0
        if self.free:
            D[:, k, P], D[:, P + k, P] = -s[:, None] * np.cos(psi), -s[:, None] * np.sin(psi)
            D[:, 2 * P, P] = c
        return D

    def log_p(self, theta: np.ndarray) -> np.ndarray:
        """log p, (*S,), up to a constant; -inf where the latitude is none."""
        v = self.v(theta)
        log = v @ self.of.h - np.einsum("...i,...i->...", v @ self.of.J, v) / 2
        if not self.free:
            return np.asarray(log)
        low = 0.0 if self.hemisphere == "north" else -_POLE
        high = 0.0 if self.hemisphere == "south" else _POLE
        inside = (theta[..., -1] > low) & (theta[..., -1] < high)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(inside, log + np.log(np.cos(theta[..., -1])), -np.inf)

    def curved(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gradient of log p, (K, n), and minus its second derivative, (K, n, n), exact and by the
        slopes alone, which is never negative."""
        P = self.of.poses
        D, v = self.slopes(theta), self.v(theta)
        left = self.of.h - v @ self.of.J
        gradient = np.einsum("kv,kvn->kn", left, D)
        gauss = np.swapaxes(D, 1, 2) @ (self.of.J @ D)
        exact, k = gauss.copy(), np.arange(P)
        exact[:, k, k] += left[:, :P] * v[:, :P] + left[:, P : 2 * P] * v[:, P : 2 * P]
        if self.free:
            c, s = self._latitude(theta)
            tan = s / c
            cross = -tan[:, None] * (-left[:, :P] * v[:, P : 2 * P] + left[:, P : 2 * P] * v[:, :P])
            exact[:, k, P] -= cross
            exact[:, P, k] -= cross
            own = np.einsum("kv,kv->k", left[:, : 2 * P + 1], v[:, : 2 * P + 1])
            exact[:, P, P] += own + 1 / c**2
            gauss[:, P, P] += 1 / c**2
            gradient[:, P] -= tan
        return gradient, exact, gauss

    def starts(self, rng: np.random.Generator) -> np.ndarray:
        """Where to look for maxima, (STARTS, n)."""
        P, links = self.of.poses, 2 * self.of.poses + 1
        share = 3.0 if self.free else 2.0 / np.cos(self.of.latitude or 0.0) ** 2
        if self.free:
            A, b = self.of.J[:links, :links] + share * np.eye(links), self.of.h[:links]
        else:
            sine = np.sin(self.of.latitude or 0.0)
            A = self.of.J[: 2 * P, : 2 * P] + share * np.eye(2 * P)
            b = self.of.h[: 2 * P] - self.of.J[: 2 * P, 2 * P] * sine
        values, vectors = np.linalg.eigh(A)
        draws = rng.standard_normal((STARTS, len(A))) / np.sqrt(values)
        q = (draws + (b @ vectors) / values) @ vectors.T
        psi = np.arctan2(q[:, P : 2 * P], q[:, :P])
        if len(self.of.linked):
            psi[::2, 0] = 2 * np.pi * np.arange(STARTS // 2) / (STARTS // 2)
            for k, p in enumerate(self.of.linked):
                psi[::2, p + 1] = psi[::2, p] + self.of.delta[k]
        if not self.free:
            return np.asarray(psi)
        length = np.sqrt(np.mean(q[:, :P] ** 2 + q[:, P : 2 * P] ** 2, axis=1))
        latitude = np.clip(np.arctan2(q[:, 2 * P], length), -1.5, 1.5)
        if self.hemisphere != "either":
            latitude = np.abs(latitude) * (1 if self.hemisphere == "north" else -1)
        else:
            latitude[1::4] *= -1
        return np.column_stack([psi, latitude])

    def climbed(self, theta: np.ndarray) -> np.ndarray:
        """Maxima, (K, n), that are reached from theta, (K, n)."""
        damping = np.full(len(theta), 1e-2)
        log, n = self.log_p(theta), self.size
        for _ in range(_ROUNDS):
            gradient, exact, gauss = self.curved(theta)
            scale = np.maximum(np.einsum("kii->ki", gauss), 1e-12)
            H = gauss + damping[:, None, None] * scale[:, :, None] * np.eye(n)
            near = damping < 1e-6
            if near.any():
                values = np.linalg.eigvalsh(exact[near])
                sound = np.flatnonzero(near)[values[:, 0] > 0]
                H[sound] = exact[sound]
            step = np.linalg.solve(H, gradient[..., None])[..., 0]
            most = np.abs(step).max(axis=1, keepdims=True)
            tried = theta + step * np.minimum(1.0, _LARGEST / np.maximum(most, 1e-300))
            there = self.log_p(tried)
            better = there > log
            theta, log = np.where(better[:, None], tried, theta), np.where(better, there, log)
            damping = np.where(better, damping / 8, damping * 8).clip(1e-9, 1e6)
            if most.max() < 1e-9:
                break
        theta = theta.copy()
        theta[:, : self.of.poses] = wrap(theta[:, : self.of.poses])
        return theta

    def off(self, theta: np.ndarray, about: np.ndarray) -> np.ndarray:
        """theta less other coordinates, the headings' differences wrapped."""
        found = theta - about
        found[..., : self.of.poses] = wrap(found[..., : self.of.poses])
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class Mixture:
    """A normal distribution about each of M maxima, the likeliest first."""

    torus: Torus
    modes: np.ndarray
    """(M, n)"""
    weight: np.ndarray
    """(M,)"""
    spread: np.ndarray
    """(M, n, n), S with covariance S S'"""
    inverse: np.ndarray
    """(M, n, n), S^-1"""

    def draw(self, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Particles, (count, n), and the number of the mode that each is about."""
        # As many about each as its weight says, and no more left to chance than a fraction.
        edges = np.cumsum(self.weight) / self.weight.sum()
        which = np.searchsorted(edges, (np.arange(count) + rng.random()) / count)
        which = np.minimum(which, len(edges) - 1)
        normal = rng.standard_normal((count, self.modes.shape[1]))
        theta = self.modes[which] + np.einsum("kij,kj->ki", self.spread[which], normal)
        return theta, which

    def distance(self, theta: np.ndarray) -> np.ndarray:
        """Squared distance of particles, (K, n), from each mode, by its spread, (K, M)."""
        off = self.torus.off(theta[:, None], self.modes[None])
        by = np.einsum("mij,kmj->kmi", self.inverse, off, optimize=True)
        return np.asarray(np.einsum("kmi,kmi->km", by, by))

    def log_g(self, theta: np.ndarray) -> np.ndarray:
        """Log density, (K,), up to a constant."""
        size = np.linalg.slogdet(self.inverse)[1] + np.log(self.weight)
        log = size - self.distance(theta) / 2
        top = log.max(axis=1)
        return np.asarray(top + np.log(np.exp(log - top[:, None]).sum(axis=1)))


def mixture(torus: Torus, starts: np.ndarray) -> Mixture:
    """The mixture about the maxima that are reached from these starts, (K, n)."""
    reached = torus.climbed(starts)
    exact = torus.curved(reached)[1]
    log = torus.log_p(reached)
    values, vectors = np.linalg.eigh(exact)
    least = _WIDEST**-2
    wide = np.maximum(values, least)
    evidence = np.where(np.isfinite(log), log, -np.inf) - np.log(wide).sum(axis=1) / 2
    kept: list[int] = []
    for k in np.argsort(-evidence):
        if evidence[k] < evidence.max() - _UNLIKELY or len(kept) == _MOST:
            break
        if all(np.abs(torus.off(reached[k], reached[j])).max() > _SAME for j in kept):
            kept.append(int(k))
    of = vectors[kept], np.minimum(_WIDER / np.sqrt(wide[kept]), _WIDEST)
    weight = np.exp(evidence[kept] - evidence.max())
    return Mixture(
        torus,
        reached[kept],
        weight / weight.sum(),
        of[0] * of[1][:, None],
        np.swapaxes(of[0], 1, 2) / of[1][:, :, None],
    )


@dataclass(frozen=True, eq=False)
class Particles:
    """K weighted draws of the posterior."""

    theta: np.ndarray
    """(K, n)"""
    weight: np.ndarray
    """(K,), whose sum is one"""
    steps: int
    """In how many steps they came from the mixture; one, where weighting sufficed"""

    def mean_and_spread(self, poses: int) -> tuple[np.ndarray, np.ndarray]:
        """The circular means of the headings, rad, and the root mean square angles about them,
        (P,) both."""
        psi = self.theta[:, :poses]
        heading = np.angle(self.weight @ np.exp(1j * psi))
        return heading, np.sqrt(self.weight @ wrap(psi - heading) ** 2)

    def covered(self, poses: int) -> np.ndarray:
        """The least share of the circle that holds 95% of each heading's probability, in steps of
        ten degrees, (P,). Two narrow peaks opposite each other take little, however wide sigma."""
        bins = (np.mod(self.theta[:, :poses], 2 * np.pi) * 36 / (2 * np.pi)).astype(int) % 36
        each = np.stack([np.bincount(own, self.weight, 36) for own in bins.T])
        most = np.cumsum(np.sort(each, axis=1)[:, ::-1], axis=1)
        return np.asarray((1 + np.sum(most < 0.95, axis=1)) / 36)


def particles(of: Mixture, count: int = PARTICLES) -> Particles:
    """Draws of the posterior."""
    rng, torus = streams.figures(), of.torus
    theta, which = of.draw(rng, count)
    log_p, log_g = torus.log_p(theta), of.log_g(theta)
    at, size = 0.0, 1.0
    for step in range(1, _STEPS + 1):
        ratio = np.maximum(log_p - log_g, -1e300)
        rest = 1 - at
        if _counting(rest * ratio) < _ENOUGH:
            low, high = 0.0, rest
            for _ in range(30):
                middle = (low + high) / 2
                low, high = (middle, high) if _counting(middle * ratio) > 0.5 else (low, middle)
            rest = max(low, 1e-4)
        last = at + rest >= 1 or step == _STEPS
        at = 1.0 if last else at + rest
        weight = np.exp(rest * ratio - (rest * ratio).max())
        weight /= weight.sum()
        if last and step == 1:
            return Particles(theta, weight, 1)
        chosen = np.searchsorted(np.cumsum(weight), (np.arange(count) + rng.random()) / count)
        chosen = np.minimum(chosen, count - 1)
        theta, which, log_p, log_g = theta[chosen], which[chosen], log_p[chosen], log_g[chosen]
        for _ in range(_MOVES * (2 if last else 1)):
            normal = rng.standard_normal(theta.shape)
            length = size * rng.choice([0.3, 1.0, 2.0], len(theta))[:, None]
            push = np.einsum("kij,kj->ki", of.spread[which], normal)
            tried = theta + length * push * 1.5 / np.sqrt(torus.size)
            there, base = torus.log_p(tried), of.log_g(tried)
            gain = at * (there - log_p) + (1 - at) * (base - log_g)
            taken = np.log(rng.random(len(theta))) < gain
            theta = np.where(taken[:, None], tried, theta)
            log_p, log_g = np.where(taken, there, log_p), np.where(taken, base, log_g)
            size *= np.exp(0.3 * (taken.mean() - 0.3))
        if last:
            break
    return Particles(theta, np.full(count, 1 / count), step)


def _counting(log: np.ndarray) -> float:
    """Share of particles that count by their log weights."""
    weight = np.exp(log - log.max())
    return float(weight.sum() ** 2 / np.sum(weight**2) / len(weight))
