"""How loud a sway is at the frequencies that a fit over a window looks like to it.

The error g' r of a linear fit to stationary r has variance integral |g(f)|^2 S(f) df, S the
spectrum of r. A fit of north looks at about one cycle a window, of which a window has but one; and
a narrow resonance far above comes in through the side lobes of g. So S is an autoregression's,
which every frequency tells of: Burg's (1967), its order by Schwarz's criterion.

Residuals lack what the fit explained, most of it where the fit looks. Each of its directions u is
put back as large as S makes it on average, u' R u, as one more stretch of r, and S is found anew
(expectation-maximisation, Dempster et al. 1977).

An estimate of variance whose logarithm errs by e raises the mean of squared ratios by exp(e^2). S
has its coefficients a with covariance v (n Gamma)^-1, v the variance of what they do not foretell,
Gamma the autocovariances, and v with 2 v^2/n (Brockwell & Davis 1991, 8.8): the variance is raised
by what follows for it.
"""

import numpy as np

BLOCKS = 240
"""Blocks of a window, at most: far above one cycle, and coarse enough that an autoregression spans
a sway."""
_ORDER = 12
_PASSES = 4
_MOST_ERRS = 1.0
"""Largest change of the variance's logarithm: beyond it the first order says nothing."""
_SINGULAR = 1e-9
"""Share of a variance that is added to it: a pure tone is foretold from itself."""
_LEAST_VELOCITY = 1e-9
"""m/s: far below all others, so that nothing is divided by zero."""


def variance(
    left: np.ndarray, taken: np.ndarray, g: np.ndarray, inside: np.ndarray | None = None
) -> np.ndarray:
    """Variance of g' r, (W,), in the squared unit of g times r; summed over the K rows of g.

    left : (W, C, n), what a fit left of r in C directions whose spectrum is one; taken : (W or 1,
    J, n), orthonormal, what it explained; g : (W or 1, K, n); inside : bool (n,), where left, taken
    and g count and are not zero.
    """
    directions, n = left.shape[1:]
    inside = np.ones(n, bool) if inside is None else inside
    samples = directions * int(inside.sum())
    size = 4 * n
    once = np.full(size // 2 + 1, 2 / size)  # of a spectrum's two sides
    once[[0, -1]] = 1 / size
    looks = once * np.sum(np.abs(np.fft.rfft(g, size)) ** 2, axis=1)
    along = once * np.abs(np.fft.rfft(taken, size)) ** 2
    share = np.repeat(np.sum(left**2, axis=(1, 2))[:, None] / samples, taken.shape[1], axis=1)
    for _ in range(_PASSES):
        back = np.sqrt(directions * share)[..., None] * taken
        a, v, order = _burg(np.concatenate([left, back], axis=1), inside, samples)
        response = np.fft.rfft(a, size)
        spectrum = v[:, None] / np.abs(response) ** 2
        share = np.sum(spectrum[:, None] * along, axis=2)
    parts = spectrum * looks
    total = parts.sum(axis=1)
    slopes = parts / total[:, None] / response
    errs = (2 + _of_coefficients(slopes, spectrum, v, order)) / samples
    return np.asarray(total * np.exp(np.minimum(errs, _MOST_ERRS)))


def _burg(
    stretches: np.ndarray, inside: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients, (W, _ORDER + 1), the first 1, those beyond the order 0; the variance that they
    leave, (W,); and the order. stretches : (W, S, T), of one process; n : how many samples they
    stand for."""
    w = len(stretches)
    forward = backward = stretches
    whole = inside
    a = np.zeros((w, _ORDER + 1))
    a[:, 0] = 1.0
    v = np.sum(stretches**2, axis=(1, 2)) / n + _LEAST_VELOCITY**2
    best = a.copy(), v.copy(), np.zeros(w, int)
    least = n * np.log(v)
    for order in range(1, _ORDER + 1):
        whole = whole[1:] & inside[:-order]
        ahead, behind = forward[..., 1:] * whole, backward[..., :-1] * whole
        both = np.sum(ahead**2 + behind**2, axis=(1, 2)) + _LEAST_VELOCITY**2
        k = -2 * np.sum(ahead * behind, axis=(1, 2)) / both
        forward = ahead + k[:, None, None] * behind
        backward = behind + k[:, None, None] * ahead
        a[:, : order + 1] += k[:, None] * a[:, order::-1]
        v = v * (1 - k**2) + _LEAST_VELOCITY**2
        score = n * np.log(v) + order * np.log(n)
        better = score < least
        least[better] = score[better]
        for kept, new in zip(best, (a, v, np.full(w, order)), strict=True):
            kept[better] = new[better]
    return best


def _of_coefficients(
    slopes: np.ndarray, spectrum: np.ndarray, v: np.ndarray, order: np.ndarray
) -> np.ndarray:
    """What the coefficients' errors do to the logarithm of the variance: its variance, (W,), times
    n. slopes : (W, F), each frequency's share of it over the response there."""
    size = 2 * (slopes.shape[1] - 1)
    d = -2 * np.real(np.fft.fft(slopes, size)[:, 1 : _ORDER + 1])
    autocovariance = np.fft.irfft(spectrum, size)
    autocovariance[:, 0] *= 1 + _SINGULAR
    found = np.zeros(len(d))
    for p in np.unique(order[order > 0]):
        rows = order == p
        gamma = autocovariance[rows][:, np.abs(np.subtract.outer(np.arange(p), np.arange(p)))]
        own = d[rows, :p]
        solved = np.linalg.solve(gamma, own[..., None])[..., 0]
        found[rows] = v[rows] * np.einsum("wi,wi->w", own, solved)
    return found


def velocity_noise(velocity: np.ndarray, columns: np.ndarray, g: np.ndarray) -> float:
    """The variance, (m/s)^2, of the white velocity that would err the fit's g as much as what the
    columns do not explain of this one.

    velocity : (n, 2), m/s; columns : (n, p), what a velocity can be without a sway, where it counts
    (zero elsewhere); g : (n, p'), those of them, orthonormal, that north looks like.
    """
    basis = np.linalg.qr(columns)[0]
    counts = np.any(columns != 0, axis=1)
    left = np.where(counts[:, None], velocity, 0.0)
    left = left - basis @ (basis.T @ left)
    return float(float(variance(left.T[None], basis.T[None], g.T[None], counts)[0]) / g.shape[1])
