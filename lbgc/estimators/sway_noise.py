"""Variance of the error that a base's sway gives a linear fit over a window, from its residuals.

The error g' r of a linear fit to stationary r has variance integral |g(f)|^2 S(f) df, S the
spectrum of r. A fit of north is most sensitive at about one cycle a window, where a window has a
single cycle to estimate S from; and a narrow resonance far above enters through the side lobes of
g. So S is that of an autoregression, to which all frequencies contribute: Burg's (1967), of the
order that Schwarz's criterion chooses.

Residuals lack what the fit explained, most of all at the frequencies to which the fit is most
sensitive. So each direction u that the fit explained is put back, as large as S makes it on
average, u' R u, R the covariance of r, as one more stretch of r, and S is estimated anew
(expectation-maximisation, Dempster et al. 1977).

A variance whose logarithm is estimated with standard deviation e raises the mean of squared ratios
by exp(e^2). The autoregression's coefficients a have the covariance v (n Gamma)^-1, with v the
variance of its innovations and Gamma the autocovariances, and v has the variance 2 v^2/n (Brockwell
& Davis 1991, 8.8). The e^2 of `variance` follows from both, and its result is raised by that
factor.
"""

import numpy as np

BLOCKS = 240
"""Largest number of blocks in a window: fine enough for frequencies far above one cycle a window,
and coarse enough that an autoregression spans a period of the sway."""
_ORDER = 12  # largest order of the autoregression
_PASSES = 4  # of expectation-maximisation
_MOST_ERRS = 1.0
"""Largest e^2 that is used: a larger one is beyond what first-order propagation can tell."""
_SINGULAR = 1e-9
"""Share of the variance that is added to it: the autocovariances of a pure tone are singular."""
_LEAST_VELOCITY = 1e-9
"""m/s, far below any velocity of interest, so that nothing is divided by zero."""


def variance(
    left: np.ndarray, taken: np.ndarray, g: np.ndarray, inside: np.ndarray | None = None
) -> np.ndarray:
    """Variance of g' r, (W,), in the squared unit of g times r; summed over the K rows of g.

    left : (W, C, n), a fit's residuals of r in C directions that share one spectrum; taken : (W or
    1, J, n), orthonormal, the directions that the fit explained; g : (W or 1, K, n); inside : bool
    (n,), where left, taken and g count; they are zero elsewhere.
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
    errs = (2 + _coefficient_variance(slopes, spectrum, v, order)) / samples
    return np.asarray(total * np.exp(np.minimum(errs, _MOST_ERRS)))


def _burg(
    stretches: np.ndarray, inside: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Burg's autoregression: coefficients, (W, _ORDER + 1), the first 1 and those beyond the order
    0; the variance of its innovations, (W,); and its order by Schwarz's criterion, (W,).

    stretches : (W, S, T), realisations of one process; inside : bool (T,), see `variance`; n : the
    number of samples that they stand for.
    """
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


def _coefficient_variance(
    slopes: np.ndarray, spectrum: np.ndarray, v: np.ndarray, order: np.ndarray
) -> np.ndarray:
    """Variance, (W,), times n, of the logarithm of the variance due to errors of the coefficients.

    slopes : (W, F), each frequency's share of the variance, over the response there; spectrum :
    (W, F); v : (W,), variance of the innovations; order : (W,).
    """
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
    """Variance, (m/s)^2, of the white velocity noise that would give a fit by g the same error as
    the part of this velocity that the columns do not explain.

    velocity : (n, 2), m/s; columns : (n, p), courses that a velocity can take without a sway, zero
    where it does not count; g : (n, p'), orthonormal, those that an error of north resembles.
    """
    basis = np.linalg.qr(columns)[0]
    counts = np.any(columns != 0, axis=1)
    left = np.where(counts[:, None], velocity, 0.0)
    left = left - basis @ (basis.T @ left)
    return float(float(variance(left.T[None], basis.T[None], g.T[None], counts)[0]) / g.shape[1])
