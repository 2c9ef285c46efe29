"""Alignment in the inertial frame: north from a base that sways, by gravity's rotation with Earth.

The frame i does not rotate, and has the axes of n at the window's start; b0 is the body's
counterpart. With C the attitude of b0 in i,

    C alpha(t) = beta(t) + v(t) - v(0),   alpha = integral of C_b0_b f_b,   beta = -integral of g_i

where C_b0_b follows from the gyros alone and g_i from Earth's rotation. The sway's velocity v stays
small while beta grows, and beta bends: its bend tells north (Wu et al. 2011, "Optimization-based
alignment for inertial navigation systems"; Li et al. 2013). C comes from Davenport's matrix: the
eigenvector of its largest eigenvalue is the quaternion of the rotation that fits both series best.

At a window's start the sway has a velocity v(0), which is as large as all that follow. `oba` leaves
it free, by taking each series less its mean; `oba_textbook` sets it to zero. `oba_interval` fits
differences over a third of the window instead, which have no initial velocity and twice the noise.

A gyro's bias b turns C_b0_b by psi = A b, A the integral of C_b0_b, and so adds Gamma b to alpha,
Gamma the integral of [C_b0_b f x] A: to first order a linear unknown (`oba_bias`; Chang et al. 2015
estimate it along with the attitude). Unless the plate turns, an east bias b bends velocity just as
a heading error of b/(Omega cos(lat)) does. Only a known size of the bias tells the two apart.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, earth_rate_ned, normal_gravity
from lbgc.estimators import circle, reduced_order, velocity_errors
from lbgc.estimators.estimate import Estimate, refusal, require_down
from lbgc.estimators.least_squares import check
from lbgc.estimators.sway_noise import BLOCKS, variance
from lbgc.frames import matrix_to_euler, rotation_matrix, skew, wrap
from lbgc.sensor.imu import ImuModel

_LEAST_SAMPLES = 50
_PASSES = 3
_ANY_BIAS = 1e-2
"""rad/s, 1 sigma of the bias of a gyro of which nothing is known."""
_LEAST_BIAS = 1e-12
_LEAST_VELOCITY = 1e-9
"""rad/s and m/s: far below any sensor's, so that nothing is divided by zero."""
_LEAST_TURN = np.deg2rad(20.0)
_ONE_FOR_THE_OTHER = "is not known; the plate does not turn enough to tell a bias from north"
_RANK = 1e-9  # share of the largest singular value below which a direction counts as zero
_NO_ANSWER = 1.0  # rad, heading's standard deviation from which on a bias hides north


@dataclass(frozen=True)
class _Form:
    """A linear operator along time that is applied to both series (W, T, 3) before they are fitted,
    and its transpose, (T', 2) -> (T, 2), whose second argument is T."""

    of: Callable[[np.ndarray], np.ndarray]
    transpose: Callable[[np.ndarray, int], np.ndarray]


@dataclass(frozen=True)
class Series:
    """The integrals of specific force and of gravity in W windows of T samples."""

    alpha: np.ndarray
    """(W, T, 3), m/s, in b0, at the samples' ends"""
    beta: np.ndarray
    """(W, T, 3), m/s, in i"""
    turned: np.ndarray
    """(W, T, 3, 3): C_b0_b at the samples' ends"""

    @property
    def before(self) -> np.ndarray:
        """C_b0_b at the samples' starts, (W, T, 3, 3)."""
        return _before(self.turned)


def oba(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Velocity alignment with the sway's initial velocity free.

    imu : without it sigma covers the sway alone, and is too small on a quiet base; see
    lbgc.estimators.velocity_errors. With it, accelerometer noise that the residuals show counts
    twice: where it is most of the residuals, sigma is up to a tenth too large.
    """
    return _align("oba", windows, imu, _CENTRED)


def oba_textbook(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Velocity alignment as published, the initial velocity taken as zero (Wu et al. 2011)."""
    return _align("oba_textbook", windows, imu, _AS_IT_IS)


def oba_interval(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Velocity alignment on differences over a sliding interval of a third of the window
    (Li et al. 2013)."""
    return _align("oba_interval", windows, imu, _DIFFERENCES)


def oba_bias(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Velocity alignment that estimates each gyro's constant bias too, with the 1 sigma of the
    sensor's model, or of any size where that is not known. The sway's initial velocity is free.

    Raises InputError where the sensor is not known and the plate does not turn enough to tell it.
    """
    name = "oba_bias"
    _check(name, windows)
    if imu is None:
        _check_turns(name, windows)
    bias = np.zeros((len(windows), 3))
    turning, size = _bias_sizes(windows, imu)
    series = integrate(windows)
    c_ib0 = _davenport(_centred(series.alpha), _centred(series.beta))
    noise = np.empty(len(windows))
    for again in range(_PASSES):
        if again:
            series = integrate(replace(windows, gyro=windows.gyro - bias[:, None]))
        of_bias = np.einsum("wij,wnjk->wnik", c_ib0, _bias_response(windows, series))[:, :, :2]
        left = (series.beta - np.einsum("wij,wtj->wti", c_ib0, series.alpha))[..., :2]
        every = list(zip(series.beta, left, of_bias, size, bias, strict=True))
        if not again:
            noise = np.array([_equivalent_noise(*own[:4]) for own in every])
        fits = [
            _fit(*own[:3], bias=own[4], size=own[3], noise=n)
            for own, n in zip(every, noise, strict=True)
        ]
        turn, step, g = (np.array(part) for part in zip(*fits, strict=True))
        c_ib0, bias = rotation_matrix(turn) @ c_ib0, bias + step
    sway = noise**2 * np.sum(g**2, axis=(1, 2))
    unknown = sway + np.sum((np.einsum("wni,wnik->wk", g, of_bias) * turning) ** 2, axis=1)
    if imu is not None:
        c_ib = c_ib0[:, None] @ series.turned
        unknown = unknown + velocity_errors.variance(windows, imu, c_ib, g)
    elif unknown.max(initial=0.0) > _NO_ANSWER**2:
        raise refusal(name, "imu", "", _ONE_FOR_THE_OTHER)
    series = integrate(replace(windows, gyro=windows.gyro - bias[:, None]))
    sigma = circle.bent(np.sqrt(unknown))
    return Estimate(_mean_heading(c_ib0, series, windows), sigma, imu is None)


def _check_turns(name: str, windows: Windows) -> None:
    """Raise InputError where the encoder shows no turn that could tell a bias from north. Gyros
    cannot show one: a bias looks like a turn to them."""
    if np.ptp(windows.plate_angle, axis=1).min(initial=np.inf) < _LEAST_TURN:
        raise refusal(name, "imu", "", _ONE_FOR_THE_OTHER)


def _bias_sizes(windows: Windows, imu: ImuModel | None) -> tuple[np.ndarray, np.ndarray]:
    """1 sigma, (W, 3) each, rad/s, of the gyros' constant errors: the part that a turning plate
    adds (misalignment towards z and z's scale error act as a bias, which velocity_errors lacks),
    or all where the sensor is not known; and the whole."""
    if imu is None:
        of_any = np.full((len(windows), 3), _ANY_BIAS)
        return of_any, of_any
    when = reduced_order.When.of(windows)
    law = reduced_order.of_gyro(imu, when)
    start, walk = reduced_order.turning(imu, when)
    by_rate = start + walk * when.duration_s / 2
    turning = np.mean(windows.gyro[..., 2], axis=1)[:, None] ** 2 * by_rate
    every = np.sqrt(law.constant + law.wander + turning) + _LEAST_BIAS
    return np.sqrt(turning), np.asarray(every)


def _bias_response(windows: Windows, series: Series) -> np.ndarray:
    """Gamma, (W, T, 3, 3): the derivative of alpha with respect to the gyros' biases."""
    dt = 1 / windows.rate_hz
    before = series.before
    turned = np.cumsum(series.turned + before, axis=1) / 2 * dt
    middle = turned - series.turned * dt / 2
    force = np.einsum("wnij,wnj->wni", before, windows.accel)
    return np.asarray(np.cumsum(skew(force) @ middle, axis=1) * dt)


def _equivalent_noise(
    beta: np.ndarray, left: np.ndarray, of_bias: np.ndarray, size: np.ndarray
) -> float:
    """1 sigma, m/s, of the white velocity noise that would give the heading the same error as the
    sway does. It follows from the residuals with biases free, weighted as the fit weights them.
    Arguments as for `_fit`."""
    columns = _with_biases(beta, of_bias)
    flat = left.T.ravel()
    basis, values, _ = np.linalg.svd(columns / _lengths(columns), full_matrices=False)
    basis = basis[:, values > _RANK * values[0]]
    rest = flat - basis @ (basis.T @ flat)
    about = float(np.sqrt(np.sum(rest**2) / (len(flat) - basis.shape[1]))) + _LEAST_VELOCITY
    _, _, g = _fit(beta, left, of_bias, 0 * size, size, about)
    heard = _sway_variance(rest.reshape(1, 2, -1).swapaxes(1, 2), columns, g)[0]
    return float(np.sqrt(heard / np.sum(g**2))) + _LEAST_VELOCITY


def _fit(
    beta: np.ndarray,
    left: np.ndarray,
    of_bias: np.ndarray,
    bias: np.ndarray,
    size: np.ndarray,
    noise: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least squares for corrections of the rotation, (3,), and of the bias, (3,); and the weights,
    (T, 2), with which velocity enters the heading.

    beta : (T, 3); left : beta less C alpha, (T, 2); of_bias : C Gamma, (T, 2, 3); bias, size :
    (3,), the bias taken off already and the 1 sigma of the whole; noise : m/s, 1 sigma. The bias's
    prior is three more equations.
    """
    n = len(beta)
    columns = _with_biases(beta, of_bias)
    at = columns.shape[1] - 4
    law = np.concatenate([np.zeros((3, at + 1)), np.diag(1 / size)], axis=1)
    every = np.concatenate([columns / noise, law])
    length = _lengths(every)
    solve = np.linalg.pinv(every / length, rcond=1e-13) / length[:, None]
    missing = solve @ np.concatenate([left.T.ravel() / noise, -bias / size])
    return missing[[0, 1, at]], missing[at + 1 :], solve[at, : 2 * n].reshape(2, n).T / noise


def _with_biases(beta: np.ndarray, of_bias: np.ndarray) -> np.ndarray:
    """The columns of `_regressor_columns`, and velocity's derivatives by the three biases."""
    free = _regressor_columns(beta, offsets=True)
    return np.concatenate([free, of_bias.swapaxes(0, 1).reshape(len(free), 3)], axis=1)


def _lengths(columns: np.ndarray) -> np.ndarray:
    return np.asarray(np.maximum(np.linalg.norm(columns, axis=0), 1e-300))


def _centred(series: np.ndarray) -> np.ndarray:
    return np.asarray(series - series.mean(axis=1, keepdims=True))


def _differences(series: np.ndarray) -> np.ndarray:
    """Differences of a series, (W, T, 3), over a third of the window."""
    lag = series.shape[1] // 3
    return np.asarray(series[:, lag:] - series[:, :-lag])


def _undifferenced(weights: np.ndarray, n: int) -> np.ndarray:
    """The transpose of `_differences` over n samples, applied to weights, (T', 2)."""
    none = np.zeros((n // 3, weights.shape[1]))
    return np.asarray(np.concatenate([none, weights]) - np.concatenate([weights, none]))


def _unchanged(series: np.ndarray) -> np.ndarray:
    return series


_CENTRED = _Form(_centred, lambda weights, n: weights - weights.mean(axis=0))
_AS_IT_IS = _Form(_unchanged, lambda weights, n: weights)
_DIFFERENCES = _Form(_differences, _undifferenced)


def _check(name: str, windows: Windows) -> None:
    """Raise InputError where windows cannot be answered, or have fewer than 50 samples."""
    check(name, windows, whole=True)
    require_down(name, windows)
    samples = windows.gyro.shape[1]
    if samples < _LEAST_SAMPLES:
        about = f"samples a window; it takes {_LEAST_SAMPLES} or more, fast enough to see the sway"
        raise refusal(name, samples, "", about)


def _align(name: str, windows: Windows, imu: ImuModel | None, form: _Form) -> Estimate:
    """The answers of the estimator `name`, which fits the series in this form."""
    _check(name, windows)
    series = integrate(windows)
    c_ib0 = _davenport(form.of(series.alpha), form.of(series.beta))
    heading = _mean_heading(c_ib0, series, windows)
    sigma = circle.bent(_sigma(c_ib0, series, form, windows, imu))
    return Estimate(heading, sigma, imu is None)


def integrate(windows: Windows) -> Series:
    """Both series: attitude by the samples' rotation vectors, velocity by forces turned halfway."""
    w, n, dt = len(windows), windows.gyro.shape[1], 1 / windows.rate_hz
    angle = windows.gyro * dt
    # A fifth of the time of lbgc.frames.rotation_matrix, whose last bits do not matter here.
    step = Rotation.from_rotvec(angle.reshape(-1, 3)).as_matrix().reshape(w, n, 3, 3)
    turned = np.empty((w, n, 3, 3))
    at = np.broadcast_to(np.eye(3), (w, 3, 3))
    for k in range(n):
        turned[:, k] = at = at @ step[:, k]
    force = windows.accel + np.cross(angle, windows.accel) / 2
    alpha = np.cumsum(np.einsum("wnij,wnj->wni", _before(turned), force), axis=1) * dt
    return Series(alpha, apparent_gravity(windows, n, dt), turned)


def _before(turned: np.ndarray) -> np.ndarray:
    """Attitudes at the samples' starts, from those at their ends, (W, T, 3, 3)."""
    none = np.broadcast_to(np.eye(3), (len(turned), 1, 3, 3))
    return np.concatenate([none, turned[:, :-1]], axis=1)


def apparent_gravity(windows: Windows, n: int, dt: float) -> np.ndarray:
    """beta, (W, n, 3), m/s: minus the integral of gravity, which turns about Earth's axis by
    Omega t in i (Rodrigues' formula, integrated). dt : s."""
    t = (np.arange(n) + 1.0) * dt
    beta = np.empty((len(windows), n, 3))
    for latitude in np.unique(windows.latitude):
        axis = earth_rate_ned(latitude) / EARTH_RATE
        down = np.array([0.0, 0.0, normal_gravity(float(latitude))])
        cross = skew(axis) @ down
        twice = skew(axis) @ cross
        phase = EARTH_RATE * t
        once = 2 * np.sin(phase / 2) ** 2 / EARTH_RATE  # (1 - cos)/Omega
        slow = t**3 * EARTH_RATE**2 / 6 * (1 - phase**2 / 20)  # t - sin/Omega, without cancellation
        beta[windows.latitude == latitude] = -(
            np.outer(t, down) + np.outer(once, cross) + np.outer(slow, twice)
        )
    return beta


def _davenport(alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """The rotation C, (W, 3, 3), that fits beta = C alpha best, both (W, T, 3): the eigenvector of
    the largest eigenvalue of Davenport's K (Wu et al. 2011, eq. 24; Markley & Mortari 2000)."""
    B = np.einsum("wti,wtj->wij", beta, alpha)
    z = np.stack([B[:, 2, 1] - B[:, 1, 2], B[:, 0, 2] - B[:, 2, 0], B[:, 1, 0] - B[:, 0, 1]], -1)
    trace = np.trace(B, axis1=1, axis2=2)
    K = np.empty((len(B), 4, 4))
    K[:, :3, :3] = B + np.swapaxes(B, 1, 2) - trace[:, None, None] * np.eye(3)
    K[:, :3, 3] = K[:, 3, :3] = z
    K[:, 3, 3] = trace
    return np.asarray(Rotation.from_quat(np.linalg.eigh(K)[1][..., -1]).as_matrix())


def _mean_heading(c_ib0: np.ndarray, series: Series, windows: Windows) -> np.ndarray:
    """Mean of the body's heading less the plate's angle, (W,), rad; n turns with Earth in i."""
    t = (np.arange(series.turned.shape[1]) + 1.0) / windows.rate_hz
    heading = np.empty(len(windows))
    for latitude in np.unique(windows.latitude):
        rows = np.flatnonzero(windows.latitude == latitude)
        earth = rotation_matrix(earth_rate_ned(latitude) * t[:, None])  # C_in
        for row in rows:
            c_nb = np.swapaxes(earth, 1, 2) @ (c_ib0[row] @ series.turned[row])
            off = matrix_to_euler(c_nb)[2] - windows.plate_angle[row]
            heading[row] = np.angle(np.mean(np.exp(1j * off)))
    return wrap(heading)


def _sigma(
    c_ib0: np.ndarray, series: Series, form: _Form, windows: Windows, imu: ImuModel | None
) -> np.ndarray:
    """Standard deviation of the heading, (W,), rad, by the sway and, if known, the sensor's errors.

    A small rotation phi moves the fitted series by phi x beta, so phi is a linear regression and
    the heading's error is G' D r/(G' G), with r the error of velocity, G the heading's regressor
    less what the tilts and the offset explain of it, and D the form that was fitted.
    """
    left = series.beta - np.einsum("wij,wtj->wti", c_ib0, series.alpha)
    fitted = form.of(series.beta)
    total = np.empty(len(left))
    for latitude in np.unique(windows.latitude):  # whose windows share beta
        rows = np.flatnonzero(windows.latitude == latitude)
        G = _regressor(fitted[rows[0]])
        g, size = form.transpose(G, left.shape[1]), np.sum(G**2)
        columns = _regressor_columns(series.beta[rows[0]], offsets=form is not _AS_IT_IS)
        total[rows] = _sway_variance(left[rows], columns, g)
        if imu is not None:
            c_ib = c_ib0[rows, None] @ series.turned[rows]
            total[rows] += velocity_errors.variance(windows.rows(rows), imu, c_ib, g[None])
        total[rows] /= size**2
    return np.sqrt(total)


def _sway_variance(left: np.ndarray, columns: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Variance of g' r, (W,), (m/s)^2 times the square of g's unit, r the sway's velocity: see
    lbgc.estimators.sway_noise.

    left : (W, T, >= 2), the fit's residuals, m/s; columns : (2 T, p), forward above right, what the
    fit could explain; g : (T, 2). Forward and right are taken as independent of each other.
    """
    n = len(g)
    size = -(-n // BLOCKS)
    whole = n // size * size

    def blocks(values: np.ndarray) -> np.ndarray:
        return np.asarray(values[..., :whole].reshape(*values.shape[:-1], -1, size).sum(axis=-1))

    total = np.zeros(len(left))
    for axis in (0, 1):
        own = blocks(columns[axis * n : (axis + 1) * n].T).T
        basis, values, _ = np.linalg.svd(own / np.linalg.norm(columns, axis=0), full_matrices=False)
        basis = basis[:, values > _RANK * values[0]]
        velocity = blocks(left[..., axis]) / size
        velocity = velocity - velocity @ basis @ basis.T
        total += variance(velocity[:, None], basis.T[None], blocks(g[:, axis])[None, None])
    return total


def _regressor(beta: np.ndarray) -> np.ndarray:
    """The heading's regressor, (T, 2): phi_z x beta, horizontal, less what tilts could explain."""
    basis, triangle = np.linalg.qr(_regressor_columns(beta, offsets=False))
    return np.asarray((basis[:, -1] * triangle[-1, -1]).reshape(2, -1).T)


def _regressor_columns(beta: np.ndarray, offsets: bool) -> np.ndarray:
    """Derivatives of horizontal velocity by both tilts, by offsets if asked for, and last by the
    heading: (2 T, 3 or 5), forward above right."""
    x, y, z = beta.T
    none, one = np.zeros_like(x), np.ones_like(x)
    others = [(none, -z), (z, none), *([(one, none), (none, one)] if offsets else [])]
    return np.stack([np.concatenate(pair) for pair in (*others, (-y, x))], axis=1)
