"""The covariance of overlapping Allan variances at several averaging times, of one recording.

An overlapping estimate is the mean over start times of half the square of the second difference

    d(t) = (x(t + 2 tau) - 2 x(t + tau) + x(t))/tau

of the integrated signal x. For Gaussian noise the covariance of two such means follows from the
cross-covariance g(u) of their second differences at lag u,

    1/(4 L1 L2) integral w(u) (2 g^2 + 4 m1 m2 g) du,

with L = T - 2 tau + dt the range of start times, w(u) how long both starts are in range, and m the
mean of the second difference, R tau for a ramp R. Of x only a generalised covariance G(t) is
needed, since a second difference of a second difference removes constant and square: -N^2 |t|/2 of
white noise, K^2 |t|^3/12 of a random walk, w (1 - e^-u - u + u^2/2)/s^2, u = s |t|, of a process of
covariance w e^-s|t|, and Q^2 at t = 0 of quantisation. Lags are whole numbers of samples.

The degrees of freedom of one estimate, 2 variance^2/covariance, are Greenhall's.
"""

from collections.abc import Callable

import numpy as np

from lbgc.sensor.fitting.cosine_variance import exponentials
from lbgc.sensor.gaussian import GaussianTerm
from lbgc.sensor.noise import AngleQuantisation, RandomWalk, White

_SECOND = (1.0, -2.0, 1.0)
"""Weights of a second difference."""
_GROWTH = 1.4
"""Ratio of neighbouring steps of lag, away from where the cross-covariance bends."""
_FARTHEST = 20.0
"""The largest lag, over the sum of both averaging times, beyond which flicker has no correlation
that matters."""
_LEAST = 1e-3
"""The least eigenvalue that correlations are taken to have: the integrals are about as exact."""

Generalised = Callable[[np.ndarray], np.ndarray]
"""The generalised covariance G of the integrated signal at lags, s"""


class AllanCovariance:
    """The covariances of Allan variances at K averaging times, as the sum of what pairs of terms
    contribute."""

    def __init__(self, taus: np.ndarray, record_s: float, terms: list[GaussianTerm], dt: float):
        """taus : (K,), s; record_s : the recording's length, s; terms : with coefficient one; dt :
        s, the samples' interval, or the shortest averaging time where that is not known, which
        makes the variances a little less certain than they are."""
        self.taus = taus
        ranges = np.maximum(record_s - 2 * taus + dt, dt)
        functions = [_generalised(term, dt, float(taus.max())) for term in terms]
        pairs = [(i, j) for i in range(len(taus)) for j in range(i + 1)]
        self._pairs = np.array(pairs)
        squares, lines = [], []
        for i, j in pairs:
            lags = _lags(taus[i], taus[j], dt)
            weights = np.gradient(lags) * _overlap(lags, ranges[i], ranges[j])
            weights /= ranges[i] * ranges[j]
            unit = np.stack([_cross(one, lags, taus[i], taus[j]) for one in functions])
            squares.append((unit * weights) @ unit.T / 2)
            lines.append(taus[i] * taus[j] * unit @ weights)
        self._squares, self._lines = np.array(squares), np.array(lines)

    def matrix(self, q: np.ndarray, ramp_squared: float = 0.0) -> np.ndarray:
        """The covariance of the Allan variances, (K, K), unit^4. q : of each term, the square of
        its coefficient; ramp_squared : of a ramp R, unit^2/s^2."""
        own = self._squares @ q @ q + ramp_squared * (self._lines @ q)
        out = np.empty((len(self.taus),) * 2)
        i, j = self._pairs.T
        out[i, j] = out[j, i] = own
        size = np.sqrt(np.diag(out))
        values, vectors = np.linalg.eigh(out / np.outer(size, size))
        correlation = (vectors * np.maximum(values, _LEAST)) @ vectors.T
        return np.asarray(correlation * np.outer(size, size))


def _generalised(term: GaussianTerm, dt: float, longest: float) -> Generalised:
    """The generalised covariance of a term's integral. longest : the largest averaging time, s."""
    if isinstance(term, White):
        return lambda t: -(term.N**2) * np.abs(t) / 2
    if isinstance(term, RandomWalk):
        return lambda t: term.K**2 * np.abs(t) ** 3 / 12
    if isinstance(term, AngleQuantisation):
        return lambda t: term.Q**2 * np.maximum(1 - np.abs(t) / dt, 0.0)
    rates, weights = exponentials(term)

    def of_exponentials(t: np.ndarray) -> np.ndarray:
        """The sum over the exponentials; the square is left in only where it keeps digits."""
        total = np.zeros(t.shape)
        for s, w in zip(rates, weights, strict=True):
            u = float(s) * np.abs(t)
            slow = float(s) * longest < 1
            exact = -(np.expm1(-u) + u) + (u**2 / 2 if slow else 0.0)
            series = u**3 / 6 - u**4 / 24 + u**5 / 120
            total += float(w) / float(s) ** 2 * np.where(slow & (u < 0.03), series, exact)
        return total

    return of_exponentials


def _lags(first: float, second: float, dt: float) -> np.ndarray:
    """Lags, s, at which the cross-covariance of two second differences is integrated: every sample
    close to each of its nine bends, and farther apart away from them."""
    far = max(_FARTHEST * (first + second) / dt, 2.0)
    offsets = np.cumsum(_GROWTH ** np.arange(np.ceil(np.log(far) / np.log(_GROWTH))))
    offsets = np.concatenate([-offsets[::-1], [0.0], offsets])
    bends = ((a * first - b * second) / dt for a in range(3) for b in range(3))
    lags = np.unique(np.round(np.concatenate([bend + offsets for bend in bends])))
    return np.asarray(dt * lags[np.abs(lags) <= far])


def _overlap(lags: np.ndarray, first: float, second: float) -> np.ndarray:
    """How long a start t in (0, first) has t + lag in (0, second), s."""
    both = np.minimum(first, second - lags) - np.maximum(0.0, -lags)
    return np.asarray(np.maximum(both, 0.0))


def _cross(covariance: Generalised, lags: np.ndarray, first: float, second: float) -> np.ndarray:
    """The cross-covariance of the second differences over `first` and `second`, s, at these lags of
    the second behind the first."""
    total = np.zeros(len(lags))
    for a, wa in enumerate(_SECOND):
        for b, wb in enumerate(_SECOND):
            total += wa * wb * covariance(lags + b * second - a * first)
    return total / (first * second)
