"""The posterior on the circle of a heading that is seen through a Gaussian measurement.

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
"""Steps of the circle over the narrowest width that the posterior can have: series end there at
exp(-12) of their first term."""
_MOST_WIDE = 256  # steps, above which one narrow peak is cheaper by itself
_MOST_STEPS = 2**14  # above which a series takes too long
_PEAK = np.linspace(-8.0, 8.0, 25)  # widths from the mode; such sums err by exp(-44)
_FAR = 30.0  # of log p: what lies so far below the mode weighs nothing
_NUMBERS = 2**18  # held at once
_LEAST = 1e-20


@dataclass(frozen=True)
class Posterior:
    """What is known of V headings."""

    first: np.ndarray
    """(V,), complex, E[exp(i psi)]"""
    sigma: np.ndarray
    """(V,), rad, the root mean square angle about the answer, at most 103.92 degrees"""

    @property
    def heading(self) -> np.ndarray:
        """(V,), rad, the circular mean."""
        return np.asarray(np.angle(self.first))


def measured(z: np.ndarray, S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """h (V, 2) and J of the measurements z (V, 2) of q, whose errors have the covariance S, (2, 2)
    or (V, 2, 2); it is taken to be 1e-20 at least, for a measurement without any error."""
    J = np.linalg.inv(S + _LEAST * np.eye(2))
    J = (J + np.swapaxes(J, -1, -2)) / 2
    return np.einsum("...ij,...j->...i", J, z), J


def posterior(h: np.ndarray, J: np.ndarray, answer: np.ndarray | None = None) -> Posterior:
    """The posteriors' moments. h : (V, 2); J : (2, 2), or (V, 2, 2); answer : (V,), rad, that sigma
    is about, or None for the circular mean. NaN where h or J is."""
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
    """Narrow peaks apart from what is spread over the circle, and these by their widths."""
    first, sigma = np.empty(len(terms), complex), np.empty(len(terms))
    steps = _steps(terms)
    at = np.zeros(len(terms))
    narrow = steps > _MOST_WIDE
    if narrow.any():
        rows = np.flatnonzero(narrow)
        at[rows], narrow[rows] = _peak(terms[rows])
    if narrow.any():
        rows = np.flatnonzero(narrow)
        about = None if answer is None else answer[rows]
        first[rows], sigma[rows] = _of_peak(terms[rows], at[rows], about)
    long = ~narrow & (steps > _MOST_STEPS)
    for row in np.flatnonzero(long):
        first[row], sigma[row] = _of_peaks(terms[row], None if answer is None else answer[row])
    for count in np.unique(steps[~narrow & ~long]):
        every = np.flatnonzero(~narrow & (steps == count))
        size = max(1, _NUMBERS // int(count))
        for rows in (every[i : i + size] for i in range(0, len(every), size)):
            about = None if answer is None else answer[rows]
            first[rows], sigma[rows] = _of_series(terms[rows], int(count), about)
    return Posterior(first, np.minimum(sigma, CHANCE))


def bent(sigma: np.ndarray) -> np.ndarray:
    """The standard deviation on the circle, (V,), rad, of an angle that one measures with this one,
    (V,), when errors are small: it grows to 103.92 degrees and no further."""
    J = np.eye(2) / np.maximum(sigma, np.sqrt(_LEAST))[:, None, None] ** 2
    return np.where(sigma > 0, posterior(J[:, 0], J).sigma, sigma)


def mode(h: np.ndarray, J: np.ndarray) -> np.ndarray:
    """The most likely headings, (V,), rad. h : (V, 2); J : (2, 2), or (V, 2, 2)."""
    return _mode(_terms(h, J))


def _terms(h: np.ndarray, J: np.ndarray) -> np.ndarray:
    """log p = terms x (cos psi, sin psi, cos 2 psi, sin 2 psi) and a constant, (V, 4)."""
    terms = np.empty((len(h), 4))
    terms[:, :2] = h
    terms[:, 2] = (J[..., 1, 1] - J[..., 0, 0]) / 4
    terms[:, 3] = -(J[..., 0, 1] + J[..., 1, 0]) / 4
    return terms


def _waves(psi: np.ndarray | float) -> np.ndarray:
    """(4, *S)"""
    return np.stack([np.cos(psi), np.sin(psi), np.cos(2 * psi), np.sin(2 * psi)])


def _most_curved(terms: np.ndarray) -> np.ndarray:
    """The most that log p can bend anywhere, (V,)."""
    bent: np.ndarray = np.hypot(terms[:, 0], terms[:, 1]) + 4 * np.hypot(terms[:, 2], terms[:, 3])
    return bent


def _steps(terms: np.ndarray) -> np.ndarray:
    """How many steps of the circle the posterior's series takes, (V,): powers of two."""
    wanted = _NODES_A_WIDTH * np.sqrt(_most_curved(terms))
    return np.asarray(2 ** np.ceil(np.log2(np.maximum(wanted, 32.0))).astype(int))


def _of_series(
    terms: np.ndarray, count: int, answer: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """E[exp(i psi)] and the root mean square angle about the answer, over the whole circle."""
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
    weight[-1] /= 2  # the last one is its own mirror
    square = np.pi**2 / 3 + (series * turn).real @ weight
    return first, np.sqrt(np.maximum(square, 0.0))


def _mode(terms: np.ndarray) -> np.ndarray:
    """The most likely headings, (V,), rad: on a grid, then Newton's steps: log p has four waves at
    most, however narrow p is."""
    psi = _COARSE[np.argmax(terms @ _waves(_COARSE), axis=1)]
    most = np.maximum(_most_curved(terms), 1e-300)
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


def _peak(terms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Modes, and whether all that weighs anything is one peak there of nearly Gaussian shape."""
    at = _mode(terms)
    most = _most_curved(terms)
    good = -_slope(terms, at)[1] > most / 20
    # where the first wave prevails there is but one peak; elsewhere a grid shows another one
    unsure = np.hypot(terms[:, 0], terms[:, 1]) < 4 * np.hypot(terms[:, 2], terms[:, 3])
    for rows in np.array_split(np.flatnonzero(unsure), 1 + unsure.sum() * 32 // _NUMBERS):
        log_p = terms[rows] @ _waves(_COARSE)
        highest = (log_p > np.roll(log_p, 1, axis=1)) & (log_p >= np.roll(log_p, -1, axis=1))
        elsewhere = np.abs(wrap(_COARSE[None] - at[rows, None])) > 1.5 * (_COARSE[1] - _COARSE[0])
        top = np.einsum("vi,iv->v", terms[rows], _waves(at[rows]))
        hidden = most[rows] * (_COARSE[1] - _COARSE[0]) ** 2 / 8  # how far a grid is below a peak
        likely = log_p > (top - _FAR - hidden)[:, None]
        good[rows] &= ~(highest & elsewhere & likely).any(axis=1)
    return at, good


def _of_peak(
    terms: np.ndarray, at: np.ndarray, answer: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """E[exp(i psi)] and the root mean square angle about the answer, about one narrow peak."""
    first, sigma = np.empty(len(at), complex), np.empty(len(at))
    size = _NUMBERS // (4 * len(_PEAK))
    for rows in (slice(i, i + size) for i in range(0, len(at), size)):
        own = terms[rows]
        off = _PEAK / np.sqrt(-_slope(own, at[rows])[1])[:, None]
        log_p = _below(own.T[..., None], at[rows][:, None], off)
        p = np.exp(log_p)
        p /= p.sum(axis=1, keepdims=True)
        first[rows] = np.sum(p * np.exp(1j * off), axis=1) * np.exp(1j * at[rows])
        about = np.angle(first[rows]) if answer is None else answer[rows]
        sigma[rows] = np.sqrt(np.sum(p * wrap(off + (at[rows] - about)[:, None]) ** 2, axis=1))
    return first, sigma


def _of_peaks(terms: np.ndarray, answer: float | None) -> tuple[complex, float]:
    """E[exp(i psi)] and the root mean square angle about the answer, of one posterior, (4,), whose
    peaks are narrow but two, or flat."""
    psi, log_p, width = [], [], []
    nodes, node_weights = np.polynomial.legendre.leggauss(200)
    maxima = _maxima(terms)
    height = [float(terms @ _waves(at)) for _, at, _ in maxima]
    for (before, at, after), own in zip(maxima, height, strict=True):
        least, most = (-_reach(terms, at, before - at), _reach(terms, at, after - at))
        off = (most + least) / 2 + (most - least) / 2 * nodes
        psi.append(at + off)
        log_p.append(own - max(height) + _below(terms, at, off))
        width.append(node_weights * (most - least))
    angles, p = np.concatenate(psi), np.concatenate(width) * np.exp(np.concatenate(log_p))
    p /= p.sum()
    first = complex(p @ np.exp(1j * angles))
    about = np.angle(first) if answer is None else answer
    return first, float(np.sqrt(p @ wrap(angles - about) ** 2))


def _extremes(terms: np.ndarray) -> np.ndarray:
    """Where log p is level, rad, in order: the roots on the unit circle of its slope's polynomial
    of order four in exp(i psi). Those between which it changes by no more than some units are one:
    a flat peak has three."""
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
    """The maxima of log p, rad, each between the minima before and after it: there are two of
    each at most."""
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
    """How far from a maximum p is above exp(-30) of its top, rad, within this room on one side."""
    far = abs(room) * 2.0 ** -np.arange(60)
    beyond = far[_below(terms, at, np.sign(room) * far) < -_FAR]
    return float(beyond.min(initial=abs(room)))


def _below(terms: np.ndarray, at: np.ndarray | float, off: np.ndarray) -> np.ndarray:
    """log p over that at an angle, rad, so far from it: without the digits that large terms share,
    cos(a + t) - cos(a) = -sin(a) sin(t) - 2 cos(a) sin(t/2)^2. terms : (4, *S); at, off : *S."""
    c, s, c2, s2 = _waves(at)
    x, y, x2, y2 = terms
    log_p = (y * c - x * s) * np.sin(off) - 2 * (x * c + y * s) * np.sin(off / 2) ** 2
    log_p += (y2 * c2 - x2 * s2) * np.sin(2 * off)
    return np.asarray(log_p - 2 * (x2 * c2 + y2 * s2) * np.sin(off) ** 2)
