"""The exact variance that a noise term gives to each cosine coefficient of a finite series.

The orthonormal DCT-II of n samples, coefficient k >= 1, angle a = pi k/n. With the samples'
autocovariance r_l its variance is

    r_0 + 2/n sum_l r_l ((n - l) cos(a l) - sin(a l)/sin(a)),   l = 1 ... n - 1.

A term whose covariance is a sum of exponentials has r_l = Re sum_j c_j z_j^l for l >= 1, so that
the sum is geometric and has a closed form at any sample rate: no aliases are summed, no series is
truncated. All variances are given times the samples' interval: they are densities, unit^2 s.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lbgc.sensor.gaussian import GaussianTerm
from lbgc.sensor.noise import (
    AngleQuantisation,
    BandLimited,
    Flicker,
    GaussMarkov,
    Line,
    RandomWalk,
    White,
)


@dataclass(frozen=True, eq=False)
class Grid:
    """The cosine coefficients of n samples for which variances are computed: single coefficients,
    or bins of neighbouring ones, of which the middle represents all."""

    n: int
    """Number of samples"""
    dt: float
    """The samples' interval, s"""
    k: np.ndarray
    """(M,), the coefficients' numbers, from 1 to n - 1; of a bin, its middle"""
    count: np.ndarray
    """(M,), how many coefficients each represents"""

    @cached_property
    def f(self) -> np.ndarray:
        """(M,), the coefficients' frequencies, Hz."""
        return self.k / (2 * self.n * self.dt)

    @cached_property
    def width(self) -> np.ndarray:
        """(M,), the bins' widths, Hz."""
        return self.count / (2 * self.n * self.dt)

    @cached_property
    def angle(self) -> np.ndarray:
        """(M,), the angles a = pi k/n, rad."""
        return np.pi * self.k / self.n

    @cached_property
    def turn(self) -> np.ndarray:
        """(M,), e^(i a)."""
        return np.exp(1j * self.angle)

    @cached_property
    def one_less_turn(self) -> np.ndarray:
        """(M,), 1 - e^(i a), without cancellation."""
        return np.asarray(2 * np.sin(self.angle / 2) ** 2 - 1j * np.sin(self.angle))

    @cached_property
    def sine(self) -> np.ndarray:
        """(M,), sin a."""
        return np.asarray(np.sin(self.angle))

    @cached_property
    def sinc_squared(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The power gain of averaging over an interval, (M,) each: at f and at its images
        1/dt - f and 1/dt + f."""
        x = self.f * self.dt
        return np.sinc(x) ** 2, np.sinc(1 - x) ** 2, np.sinc(1 + x) ** 2

    @cached_property
    def last_turn(self) -> np.ndarray:
        """(M,), e^(i a (n - 1)), and zero for a bin, where the e^(i a n) of even and odd
        coefficients cancel."""
        parity = np.where(self.count == 1, 1 - 2 * (np.round(self.k) % 2), 0.0)
        return np.asarray(parity * np.conj(self.turn))


def density(term: GaussianTerm, grid: Grid) -> np.ndarray:
    """The variances that a term gives to a grid's coefficients, times dt: (M,), unit^2 s."""
    cos = np.cos(grid.angle)
    if isinstance(term, White):
        return np.full(len(cos), term.N**2)
    if isinstance(term, RandomWalk):
        # With the mean removed, the walk's covariance is that of -|i - j|/2, whose eigenvectors are
        # the cosines; that samples are means over intervals takes away the sixth.
        return term.K**2 * grid.dt**2 * (0.25 / np.sin(grid.angle / 2) ** 2 - 1 / 6)
    if isinstance(term, AngleQuantisation):
        return np.asarray(2 * term.Q**2 / grid.dt * (1 - cos + (1 + cos) / grid.n))
    if isinstance(term, Line):
        return _line(term, grid)
    rates, weights = exponentials(term)
    total = np.zeros(len(cos))
    for s, w in zip(rates, weights, strict=True):
        total += _exponential_variance(complex(s), complex(w), grid)
    return grid.dt * total


def exponentials(term: GaussianTerm) -> tuple[np.ndarray, np.ndarray]:
    """The rates s_j (1/s, real part above zero) and the weights w_j (unit^2) with which a term's
    covariance is Re sum_j w_j e^(-s_j |t|). Raises TypeError for a term that is no such sum."""
    if isinstance(term, Flicker):
        return 1 / term.correlation_times(), term.variances()
    if isinstance(term, GaussMarkov):
        return np.array([1 / term.T]), np.array([term.sigma**2])
    if isinstance(term, BandLimited):
        # With critical damping the two poles coincide, and the weights divide by zero. A damping
        # ratio that differs by 1e-5 gives the same result to rounding.
        damping = term.damping + 1e-5 * (abs(term.damping - 1) < 1e-5)
        root, w = np.sqrt(complex(damping**2 - 1)), 2 * np.pi * term.bandwidth
        one, two = w * (damping - root), w * (damping + root)
        variance = term.N**2 * w / (4 * damping)
        return np.array([one, two]), variance * np.array([two, -one]) / (two - one)
    raise TypeError(f"{type(term).__name__} has no covariance of exponentials")


def _exponential_variance(s: complex, weight: complex, grid: Grid) -> np.ndarray:
    """The coefficients' variances, (M,), unit^2, of the interval means of a process of covariance
    Re(weight e^(-s |t|)).

    With u = s dt the means have r_0 = 2 w (u - 1 + e^-u)/u^2 and, for l >= 1,
    r_l = w ((1 - e^-u)/u)^2 e^(-u (l - 1)).
    """
    u = s * grid.dt
    small = abs(u) < 1e-3
    start = weight * (1 - u / 3 + u**2 / 12 if small else 2 * (u + np.expm1(-u)) / u**2)
    gain = weight * (-np.expm1(-u) / u) ** 2
    if u.imag == 0 and weight.imag == 0:
        both, plain = _weighted(u.real, grid.turn, grid.one_less_turn, grid.last_turn, grid.n)
        return np.asarray(
            start.real + 2 / grid.n * gain.real * (both.real - plain.imag / grid.sine)
        )
    up = _weighted(u, grid.turn, grid.one_less_turn, grid.last_turn, grid.n)
    back = (np.conj(grid.turn), np.conj(grid.one_less_turn), np.conj(grid.last_turn))
    down = _weighted(u, *back, grid.n)
    total = (up[0] + down[0]) / 2 - (up[1] - down[1]) / 2j / grid.sine
    return np.asarray(start.real + 2 / grid.n * np.real(gain * total))


def _weighted(
    u: complex, turn: np.ndarray, less: np.ndarray, last_turn: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sums over l = 1 ... n - 1 of (n - l) x^(l-1) e^(i a) and of x^(l-1) e^(i a), where
    x = e^(-u + i a)."""
    rest = less - np.expm1(-u) * turn  # 1 - x
    plain = (1 - np.exp(-u * (n - 1)) * last_turn) / rest
    weighted = (n - 1 - plain * (np.exp(-u) * turn)) / rest
    return turn * weighted, turn * plain


def _line(term: Line, grid: Grid) -> np.ndarray:
    """The coefficients' variances times dt, (M,), unit^2 s, of a narrow-band process. In bins near
    the line that are coarse compared with its width, the PSD is averaged over the bin. With two
    poles the flanks are steep, so that only the nearest aliases are added."""
    f, half = grid.f, grid.width / 2
    coarse, close = half > 0.03 * term.width, np.abs(f - term.f0) < 6 * term.width + 3 * half
    near = np.flatnonzero(coarse & close)
    if term.poles == 1:
        rate, weight = term.ringing()
        total = grid.dt * _exponential_variance(-rate, weight, grid)
    else:
        total = term.psd(f) * grid.sinc_squared[0]
        if term.f0 + 8 * term.width > 0.4 / grid.dt:
            for image, passed in zip((-f, f), grid.sinc_squared[1:], strict=True):
                total += term.psd(1 / grid.dt + image) * passed
    if len(near):
        at, by = f[near], half[near]
        inside = np.maximum(term.power_below(at + by) - term.power_below(at - by), 0) / (2 * by)
        total[near] = inside * grid.sinc_squared[0][near]
    return total
