"""The posterior on the circle of a heading that is measured with Gaussian noise.

Whatever measures Earth's horizontal rate, whose size is known, sees q = (cos psi, sin psi) through
noise: z = q + e, e ~ Normal(0, S). With a flat prior on the circle, J = S^-1 and h = J z,

    log p(psi | z) = q' h - q' J q / 2 + constant,

a polynomial in the heading's sines and cosines of order two at most (the generalised von Mises law;
von Mises itself where J is a multiple of the identity). Its first moment E[exp(i psi)] gives the
circular mean, the answer that minimises the mean of 1 - cos(error); its root mean square angle
about an answer is the sigma that this answer has. A heading of which nothing is known has a sigma
of 180/sqrt 3 = 103.92 degrees, and none is said to be worse than that: two peaks opposite each
other would be, which changes the mean normalised squared error by 4% at the very most.

Moments are exact to a part in a million. Where the posterior is wide they come of its Fourier
series, p_k = sum of p exp(-i k psi) over N equal steps, for which

    E[wrap(psi - a)^2] = pi^2/3 + 4 sum over k >= 1 of (-1)^k Re(p_k exp(i k a)) / (k^2 p_0);

where it is one narrow peak, of a sum over eight of its widths either way; where it is narrow but no
such peak (two of them, or a flat one), of a sum over each down to exp(-30) of its top.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.frames import wrap

CHANCE = np.pi / np.sqrt(3.0)
"""Root mean square error, rad, of a heading that is guessed: 103.92 degrees."""
_COARSE = np.linspace(-np.pi, np.pi, 32, endpoint=False)
_NODES_A_WIDTH = 10.0
"""Grid steps within the smallest width that the posterior can have: with so many, the last term of
its Fourier series is exp(-12) of the first."""
_MOST_WIDE = 256  # grid steps above which a sum over one narrow peak costs less than a series
_MOST_STEPS = 2**14  # grid steps above which a series takes too long
_PEAK = np.linspace(-8.0, 8.0, 25)  # nodes in widths from the mode; such sums err by exp(-44)
_FAR = 30.0  # drop of log p below the mode from which on a density weighs nothing
_NUMBERS = 2**18  # array elements held at once
_LEAST = 1e-20  # smallest variance of a measurement


@dataclass(frozen=True)
class Posterior:
    """The first moment of the posteriors of V headings, and their spread about an answer."""

    first: np.ndarray
    """(V,), complex, E[exp(i psi)]"""
    sigma: np.ndarray
    """(V,), rad, the root mean square angle about the answer, at most 103.92 degrees"""

    @property
    def heading(self) -> np.ndarray:
        """The circular mean, (V,), rad."""
        return np.asarray(np.angle(self.first))


def measured(z: np.ndarray, S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """h, (V, 2), and J, shaped like S, of measurements z, (V, 2), of q.

    S : (2, 2) or (V, 2, 2), covariance of their errors. 1e-20 is added to its diagonal, so that a
    measurement without any error has a J too.
    """
    J = np.linalg.inv(S + _LEAST * np.eye(2))
    J = (J + np.swapaxes(J, -1, -2)) / 2
    return np.einsum("...ij,...j->...i", J, z), J


def posterior(h: np.ndarray, J: np.ndarray, answer: np.ndarray | None = None) -> Posterior:
    """First moment and spread of V posteriors; NaN where h or J is.

    h : (V, 2); J : (2, 2), or (V, 2, 2); answer : (V,), rad, the angle about which sigma is taken,
    or None for the circular mean.
    """
    terms = _terms(h, J)
    first, sigma = np.full(len(h), np.nan + 0j), np.full(len(h), np.nan)
    known = np.isfinite(terms).all(axis=1)
    if not known.all():
        about = None if answer is None else answer[known]
        own = _posterior(terms[known], about)
        first[known], sigma[known] = own.first, own.sigma
        return Posterior(first, sigma)
    return _posterior(terms, answer)


def _posterior(terms: np.ndarray, answer: np.ndarray | None) -> Posterior:
    """First moment and spread, each posterior by the way that suits its shape: a sum over one
    narrow peak, a sum over each of several peaks, or a Fourier series of the whole circle."""
    first, sigma = np.empty(len(terms), complex), np.empty(len(terms))
    steps = _steps(terms)
    at = np.zeros(len(terms))
    narrow = steps > _MOST_WIDE
    if narrow.any():
        rows = np.flatnonzero(narrow)
        at[rows], narrow[rows] = _narrow_peak(terms[rows])
    if narrow.any():
        rows = np.flatnonzero(narrow)
        about = None if answer is None else answer[rows]
        first[rows], sigma[rows] = _moments_of_peak(terms[rows], at[rows], about)
    long = ~narrow & (steps > _MOST_STEPS)
    for row in np.flatnonzero(long):
        first[row], sigma[row] = _moments_of_peaks(
            terms[row], None if answer is None else answer[row]
        )
    for count in np.unique(steps[~narrow & ~long]):
        every = np.flatnonzero(~narrow & (steps == count))
        size = max(1, _NUMBERS // int(count))
        for rows in (every[i : i + size] for i in range(0, len(every), size)):
            about = None if answer is None else answer[rows]
            first[rows], sigma[rows] = _moments_by_series(terms[rows], int(count), about)
    return Posterior(first, np.minimum(sigma, CHANCE))


def bent(sigma: np.ndarray) -> np.ndarray:
    """Standard deviation on the circle, (V,), rad, of an angle measured with the standard deviation
    sigma, (V,), rad. It equals sigma where that is small, and never exceeds 103.92 degrees."""
    J = np.eye(2) / np.maximum(sigma, np.sqrt(_LEAST))[:, None, None] ** 2
    return np.where(sigma > 0, posterior(J[:, 0], J).sigma, sigma)


def mode(h: np.ndarray, J: np.ndarray) -> np.ndarray:
    """The most likely headings, (V,), rad. h : (V, 2); J : (2, 2), or (V, 2, 2)."""
    return _mode(_terms(h, J))


def _terms(h: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Coefficients, (V, 4), of cos psi, sin psi, cos 2 psi and sin 2 psi in log p, which is their
    sum and a constant."""
    terms = np.empty((len(h), 4))
    terms[:, :2] = h
    terms[:, 2] = (J[..., 1, 1] - J[..., 0, 0]) / 4
    terms[:, 3] = -(J[..., 0, 1] + J[..., 1, 0]) / 4
    return terms


def _waves(psi: np.ndarray | float) -> np.ndarray:
    """cos psi, sin psi, cos 2 psi and sin 2 psi of angles of shape *S, rad: (4, *S)."""
    return np.stack([np.cos(psi), np.sin(psi), np.cos(2 * psi), np.sin(2 * psi)])


def _largest_curvature(terms: np.ndarray) -> np.ndarray:
    """Upper bound, (V,), on the absolute second derivative of log p over the circle."""
    bent: np.ndarray = np.hypot(terms[:, 0], terms[:, 1]) + 4 * np.hypot(terms[:, 2], terms[:, 3])
    return bent


def _steps(terms: np.ndarray) -> np.ndarray:
    """Number of grid steps on the circle that the posterior's series needs, (V,), powers of two."""
    wanted = _NODES_A_WIDTH * np.sqrt(_largest_curvature(terms))
    return np.asarray(2 ** np.ceil(np.log2(np.maximum(wanted, 32.0))).astype(int))


def _moments_by_series(
    terms: np.ndarray, count: int, answer: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """E[exp(i psi)] and the root mean square angle about the answer, (V,) each, by the Fourier
    series of p on a grid of `count` steps over the whole circle."""
    log_p = terms @ _waves(2 * np.pi * np.arange(count) / count)
    p = np.exp(log_p - log_p.max(axis=1, keepdims=True))
    series = np.fft.rfft(p, axis=1)
    series = series[:, 1:] / series[:, :1].real
    first = series[:, 0].conj()
    about = np.angle(first) if answer is None else answer
    turn = np.repeat(np.exp(1j * about)[:, None], series.shape[1], axis=1)
    turn = np.multiply.accumulate(turn, axis=1)  # exp(i k a), k = 1, 2, ...
    k = np.arange(1, series.shape[1] + 1)
    weight = 4 * (1 - 2 * (k % 2)) / k**2
    weight[-1] /= 2  # the last term, k = count/2, is its own complex conjugate
    square = np.pi**2 / 3 + (series * turn).real @ weight
    return first, np.sqrt(np.maximum(square, 0.0))


def _mode(terms: np.ndarray) -> np.ndarray:
    """The most likely headings, (V,), rad: the highest point of a coarse grid, then Newton's steps.
    The grid suffices however narrow p is, since log p is made of four waves at most."""
    psi = _COARSE[np.argmax(terms @ _waves(_COARSE), axis=1)]
    most = np.maximum(_largest_curvature(terms), 1e-300)
    for _ in range(8):
        slope, bend = _slope(terms, psi)
        step = slope / np.maximum(-bend, 0.05 * most)
        psi = psi + np.clip(step, -0.1, 0.1)
    return wrap(psi)


def _slope(terms: np.ndarray, psi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first and second derivative of log p, (V,) each."""
    c, s, c2, s2 = _waves(psi)
    x, y, x2, y2 = terms.T
    return y * c - x * s + 2 * (y2 * c2 - x2 * s2), -(x * c + y * s) - 4 * (x2 * c2 + y2 * s2)


def _narrow_peak(terms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Modes, (V,), rad, and whether all the probability that counts is in one peak of nearly
    Gaussian shape about the mode, bool (V,)."""
    at = _mode(terms)
    most = _largest_curvature(terms)
    good = -_slope(terms, at)[1] > most / 20
    # Where cos psi and sin psi prevail there is only one peak; elsewhere a grid shows another one.
    unsure = np.hypot(terms[:, 0], terms[:, 1]) < 4 * np.hypot(terms[:, 2], terms[:, 3])
    for rows in np.array_split(np.flatnonzero(unsure), 1 + unsure.sum() * 32 // _NUMBERS):
        log_p = terms[rows] @ _waves(_COARSE)
        highest = (log_p > np.roll(log_p, 1, axis=1)) & (log_p >= np.roll(log_p, -1, axis=1))
        elsewhere = np.abs(wrap(_COARSE[None] - at[rows, None])) > 1.5 * (_COARSE[1] - _COARSE[0])
        top = np.einsum("vi,iv->v", terms[rows], _waves(at[rows]))
        hidden = (
            most[rows] * (_COARSE[1] - _COARSE[0]) ** 2 / 8
        )  # most by which a grid misses a top
        likely = log_p > (top - _FAR - hidden)[:, None]
        good[rows] &= ~(highest & elsewhere & likely).any(axis=1)
    return at, good


def _moments_of_peak(
    terms: np.ndarray, at: np.ndarray, answer: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """E[exp(i psi)] and the root mean square angle about the answer, (V,) each, of posteriors that
    are one narrow peak at the mode `at`, (V,), rad: by a sum over eight widths either way."""
    first, sigma = np.empty(len(at), complex), np.empty(len(at))
    size = _NUMBERS // (4 * len(_PEAK))
    for rows in (slice(i, i + size) for i in range(0, len(at), size)):
        own = terms[rows]
        off = _PEAK / np.sqrt(-_slope(own, at[rows])[1])[:, None]
        log_p = _log_ratio(own.T[..., None], at[rows][:, None], off)
        p = np.exp(log_p)
        p /= p.sum(axis=1, keepdims=True)
        first[rows] = np.sum(p * np.exp(1j * off), axis=1) * np.exp(1j * at[rows])
        about = np.angle(first[rows]) if answer is None else answer[rows]
        sigma[rows] = np.sqrt(np.sum(p * wrap(off + (at[rows] - about)[:, None]) ** 2, axis=1))
    return first, sigma


def _moments_of_peaks(terms: np.ndarray, answer: float | None) -> tuple[complex, float]:
    """E[exp(i psi)] and the root mean square angle about the answer of one posterior, terms (4,),
    that is narrow but has two peaks, or a flat one: by Gauss-Legendre sums over each."""
    psi, log_p, width = [], [], []
    nodes, node_weights = np.polynomial.legendre.leggauss(200)
    maxima = _maxima(terms)
    height = [float(terms @ _waves(at)) for _, at, _ in maxima]
    for (before, at, after), own in zip(maxima, height, strict=True):
        least, most = (-_reach(terms, at, before - at), _reach(terms, at, after - at))
        off = (most + least) / 2 + (most - least) / 2 * nodes
        psi.append(at + off)
        log_p.append(own - max(height) + _log_ratio(terms, at, off))
        width.append(node_weights * (most - least))
    angles, p = np.concatenate(psi), np.concatenate(width) * np.exp(np.concatenate(log_p))
    p /= p.sum()
    first = complex(p @ np.exp(1j * angles))
    about = np.angle(first) if answer is None else answer
    return first, float(np.sqrt(p @ wrap(angles - about) ** 2))


def _extremes(terms: np.ndarray) -> np.ndarray:
    """Angles at which log p is stationary, rad, ascending: the roots on the unit circle of its
    derivative, a polynomial of order four in exp(i psi). Roots between which log p changes by no
    more than some units count as one: a flat peak has three."""
    size = np.abs(terms).max()
    near = (30.0 / size) ** (1 / 3) + 2e-5
    x, y, x2, y2 = terms / size
    roots = np.roots([y2 + 1j * x2, (y + 1j * x) / 2, 0, (y - 1j * x) / 2, y2 - 1j * x2])
    at = np.sort(np.angle(roots[np.abs(np.abs(roots) - 1) < near]))
    begins = np.flatnonzero(np.diff(at, prepend=at[-1] - 2 * np.pi) > near)
    ends = np.roll(begins, -1) + len(at) * (np.arange(len(begins)) == len(begins) - 1)
    twice = np.concatenate([at, at + 2 * np.pi])
    return np.sort(wrap(np.array([twice[i:j].mean() for i, j in zip(begins, ends, strict=True)])))


def _maxima(terms: np.ndarray) -> list[tuple[float, float, float]]:
    """The maxima of log p, each as (minimum before it, maximum, minimum after it), rad. There are
    two at most."""
    at = _extremes(terms)
    height = _waves(at).T @ terms
    tops = np.flatnonzero((height >= np.roll(height, 1)) & (height >= np.roll(height, -1)))
    lows = np.flatnonzero((height <= np.roll(height, 1)) & (height <= np.roll(height, -1)))
    found = []
    for top in tops:
        ahead = np.mod(at[lows] - at[top], 2 * np.pi)
        found.append((at[top] + ahead.max() - 2 * np.pi, at[top], at[top] + ahead.min()))
    return found


def _reach(terms: np.ndarray, at: float, room: float) -> float:
    """Distance from a maximum, rad, up to which p is above exp(-30) of its top, and at most |room|;
    room : rad, signed, from the maximum to the minimum on the side that is asked for."""
    far = abs(room) * 2.0 ** -np.arange(60)
    beyond = far[_log_ratio(terms, at, np.sign(room) * far) < -_FAR]
    return float(beyond.min(initial=abs(room)))


def _log_ratio(terms: np.ndarray, at: np.ndarray | float, off: np.ndarray) -> np.ndarray:
    """log p at the angle at + off less log p at the angle `at`. The difference of large terms is
    taken without cancellation, by cos(a + t) - cos(a) = -sin(a) sin(t) - 2 cos(a) sin(t/2)^2.
    terms : (4, *S); at, off : *S, rad."""
    c, s, c2, s2 = _waves(at)
    x, y, x2, y2 = terms
    log_p = (y * c - x * s) * np.sin(off) - 2 * (x * c + y * s) * np.sin(off / 2) ** 2
    log_p += (y2 * c2 - x2 * s2) * np.sin(2 * off)
    return np.asarray(log_p - 2 * (x2 * c2 + y2 * s2) * np.sin(off) ** 2)
