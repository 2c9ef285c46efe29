"""North from a base that sways: gravity turns with Earth, and an IMU can watch it turn.

In the frame i that stands still since the window's start (its axes those of n at that instant, and
its body counterpart b0), with C the attitude of b0 in i,

    C alpha(t) = beta(t) + v(t) - v(0),   alpha = integral of C_b0_b f_b,   beta = -integral of g_i

where C_b0_b follows from the gyros alone and g_i from Earth's rotation. The sway's velocity v stays
small while beta grows, and bends: its bend is what tells north (Wu et al. 2011, "Optimization-based
alignment for inertial navigation systems"; Li et al. 2013). C comes from Davenport's matrix, whose
largest eigenvector is the quaternion of the rotation that fits the two series best.

Where a window starts the sway has some velocity v(0), which is as large as all that follow. `oba`
has it free, which takes each series less its mean; `oba_textbook` has it zero. `oba_interval` fits
differences over a third of the window instead: no initial velocity there, twice the noise.

A gyro's bias b turns C_b0_b by psi = A b, A the integral of C_b0_b, and so adds Gamma b to alpha,
Gamma the integral of [C_b0_b f x] A: to first order a linear unknown (`oba_bias`; Chang et al. 2015
estimate it along with the attitude). Unless the plate turns, an east bias b bends velocity just as
a heading error of b/(Omega cos(lat)) does. No window can tell them apart; what is known of the bias
can.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, earth_rate_ned, normal_gravities, normal_gravity
from lbgc.estimators import drift
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.estimators.linear import check
from lbgc.estimators.longrun import STUDENT, autocorrelation, kernel
from lbgc.frames import matrix_to_euler, rotation_matrix, skew, wrap
from lbgc.sensor.imu import ImuModel

_LEAST_SAMPLES = 50
_PASSES = 3
_ANY_BIAS = 1e-2
"""rad/s, of a gyro of which nothing is known."""
_LEAST_BIAS = 1e-12
_LEAST_VELOCITY = 1e-9
"""rad/s and m/s: far below all others, so that nothing is divided by zero."""
_RANK = 1e-9
_NO_ANSWER = 1.0
"""rad"""
_UNIFORM = np.pi / np.sqrt(3)
"""rad, RMS of an angle of which nothing is known"""


@dataclass(frozen=True)
class _Form:
    """What is done to both series (W, T, 3) alike before they are fitted: a linear operator along
    time, and its transpose, (T', 2) -> (T, 2), told T."""

    of: Callable[[np.ndarray], np.ndarray]
    transpose: Callable[[np.ndarray, int], np.ndarray]


@dataclass(frozen=True)
class _Series:
    alpha: np.ndarray
    """(W, T, 3), m/s, in b0, at the samples' ends"""
    beta: np.ndarray
    """(W, T, 3), m/s, in i"""
    turned: np.ndarray
    """(W, T, 3, 3): C_b0_b at the samples' ends"""

    @property
    def before(self) -> np.ndarray:
        """The same at their starts."""
        return _before(self.turned)


def oba(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Velocity alignment with the sway's initial velocity free."""
    return _align("oba", windows, _CENTRED)


def oba_textbook(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Velocity alignment as published, the initial velocity taken as zero (Wu et al. 2011)."""
    return _align("oba_textbook", windows, _AS_IT_IS)


def oba_interval(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Velocity alignment on differences over a sliding interval of a third of the window
    (Li et al. 2013)."""
    return _align("oba_interval", windows, _DIFFERENCES)


def oba_bias(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Velocity alignment with a constant bias of each gyro unknown too, as large as the sensor's
    model says; of any size where that is not known. The sway's initial velocity is free.

    Its sigma takes a sway that goes on as it is, and constant biases: where the sensors' own noise
    is larger than the sway (a bench at rest), or the plate slews, it is too small; `ekf` is for
    those.

    Raises InputError where the sensor is not known and no plate turns enough to tell its bias.
    """
    name = "oba_bias"
    _check(name, windows)
    bias = np.zeros((len(windows), 3))
    size = _bias_sizes(windows, imu)
    series = _integrate(windows)
    c_ib0 = _davenport(_centred(series.alpha), _centred(series.beta))
    for again in range(_PASSES):
        if again:
            series = _integrate(replace(windows, gyro=windows.gyro - bias[:, None]))
        of_bias = _of_bias(windows, series)
        fits = [
            _fit(series.beta[row], c_ib0[row] @ series.alpha[row].T, c_ib0[row] @ of_bias[row],
                 bias[row], size[row])
            for row in range(len(windows))
        ]  # fmt: skip
        turn, step, sigma = (np.array(part) for part in zip(*fits, strict=True))
        c_ib0, bias = rotation_matrix(turn) @ c_ib0, bias + step
    if imu is None and sigma.max(initial=0.0) > _NO_ANSWER:
        about = "is not known, and the plate does not turn enough to tell a gyro's bias from north"
        raise refusal(name, "imu", "", about)
    series = _integrate(replace(windows, gyro=windows.gyro - bias[:, None]))
    return Estimate(_mean_heading(c_ib0, series, windows), np.minimum(sigma, _UNIFORM))


def _bias_sizes(windows: Windows, imu: ImuModel | None) -> np.ndarray:
    """1 sigma, (W, 3), rad/s, of what stays constant in the gyros: on a plate that turns,
    misalignment towards z is one more bias, and z's scale error."""
    if imu is None:
        return np.full((len(windows), 3), _ANY_BIAS)
    g = normal_gravities(windows.latitude)
    law = drift.of_gyro(imu, windows.duration_s, windows.start_s, windows.latitude, g)
    of_z = np.square([*imu.gyro.misalignment_unit[:2], imu.gyro.scale_unit[2]])
    turning = np.outer(np.mean(windows.gyro[..., 2], axis=1) ** 2, of_z)
    return np.asarray(np.sqrt(law.constant + law.wander + turning) + _LEAST_BIAS)


def _of_bias(windows: Windows, series: _Series) -> np.ndarray:
    """Gamma, (W, T, 3, 3): how alpha moves with the gyros' biases."""
    dt = 1 / windows.rate_hz
    before = series.before
    turned = np.cumsum(series.turned + before, axis=1) / 2 * dt
    middle = turned - series.turned * dt / 2
    force = np.einsum("wnij,wnj->wni", before, windows.accel)
    return np.asarray(np.cumsum(skew(force) @ middle, axis=1) * dt)


def _fit(
    beta: np.ndarray, fitted: np.ndarray, of_bias: np.ndarray, bias: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """The rotation still missing, (3,), the bias still missing, (3,), and the heading's sigma, rad.

    beta : (T, 3); fitted : C alpha, (3, T); of_bias : C Gamma, (T, 3, 3); bias, size : (3,), what
    was taken off already, and 1 sigma of the whole. Least squares with the bias's law as three more
    equations; velocity's noise by what is left when biases are free, as in `_sigma`.
    """
    n = len(beta)
    left = (beta - fitted.T)[:, :2]
    free = _regressor_columns(beta, offsets=True)
    columns = np.concatenate([free, of_bias[:, :2].swapaxes(0, 1).reshape(2 * n, 3)], axis=1)
    flat, length = left.T.ravel(), np.linalg.norm(columns, axis=0)
    basis, values, _ = np.linalg.svd(columns / np.maximum(length, 1e-300), full_matrices=False)
    basis = basis[:, values > _RANK * values[0]]
    rest = (flat - basis @ (basis.T @ flat)).reshape(2, n).T
    explained = np.moveaxis(basis.reshape(2, n, -1), 0, 1)
    law = np.concatenate([np.zeros((3, free.shape[1])), np.diag(1 / size)], axis=1)
    at = free.shape[1] - 1
    noise = np.sqrt(np.sum(rest**2) / (2 * n - basis.shape[1])) + _LEAST_VELOCITY
    for last in (False, True):  # the noise where the fit itself looks
        every = np.concatenate([columns / noise, law])
        length = np.linalg.norm(every, axis=0)
        solve = np.linalg.pinv(every / length, rcond=1e-13) / length[:, None]
        if not last:
            g = solve[at, : 2 * n].reshape(2, n).T
            weights, of_white = kernel(g), np.sum(g**2)
            found = np.sum(weights * autocorrelation(rest)[: len(weights)])
            taken = np.sum(weights[..., None] * autocorrelation(explained)[: len(weights)])
            noise = np.sqrt(STUDENT * found / (of_white - taken)) + _LEAST_VELOCITY
    missing = solve @ np.concatenate([flat / noise, -bias / size])
    return missing[[0, 1, at]], missing[at + 1 :], float(np.linalg.norm(solve[at]))


def _centred(series: np.ndarray) -> np.ndarray:
    return np.asarray(series - series.mean(axis=1, keepdims=True))


def _differences(series: np.ndarray) -> np.ndarray:
    lag = series.shape[1] // 3
    return np.asarray(series[:, lag:] - series[:, :-lag])


def _undifferenced(weights: np.ndarray, n: int) -> np.ndarray:
    none = np.zeros((n // 3, weights.shape[1]))
    return np.concatenate([none, weights]) - np.concatenate([weights, none])


def _unchanged(series: np.ndarray) -> np.ndarray:
    return series


_CENTRED = _Form(_centred, lambda weights, n: weights - weights.mean(axis=0))
_AS_IT_IS = _Form(_unchanged, lambda weights, n: weights)
_DIFFERENCES = _Form(_differences, _undifferenced)


def _check(name: str, windows: Windows) -> None:
    check(name, windows)
    samples = windows.gyro.shape[1]
    if samples < _LEAST_SAMPLES:
        about = f"samples a window; it takes {_LEAST_SAMPLES} or more, fast enough to see the sway"
        raise refusal(name, samples, "", about)


def _align(name: str, windows: Windows, form: _Form) -> Estimate:
    _check(name, windows)
    series = _integrate(windows)
    c_ib0 = _davenport(form.of(series.alpha), form.of(series.beta))
    heading = _mean_heading(c_ib0, series, windows)
    return Estimate(heading, _sigma(c_ib0, series, form))


def _integrate(windows: Windows) -> _Series:
    """Attitude by the samples' rotation vectors, velocity by their forces turned half-way."""
    w, n, dt = len(windows), windows.gyro.shape[1], 1 / windows.rate_hz
    angle = windows.gyro * dt
    step = Rotation.from_rotvec(angle.reshape(-1, 3)).as_matrix().reshape(w, n, 3, 3)
    turned = np.empty((w, n, 3, 3))
    at = np.broadcast_to(np.eye(3), (w, 3, 3))
    for k in range(n):
        at = at @ step[:, k]
        turned[:, k] = at
    force = windows.accel + np.cross(angle, windows.accel) / 2
    alpha = np.cumsum(np.einsum("wnij,wnj->wni", _before(turned), force), axis=1) * dt
    return _Series(alpha, _apparent_gravity(windows, n, dt), turned)


def _before(turned: np.ndarray) -> np.ndarray:
    """From attitudes at the samples' ends to those at their starts, (W, T, 3, 3)."""
    none = np.broadcast_to(np.eye(3), (len(turned), 1, 3, 3))
    return np.concatenate([none, turned[:, :-1]], axis=1)


def _apparent_gravity(windows: Windows, n: int, dt: float) -> np.ndarray:
    """beta, (W, n, 3): minus the integral of gravity, which turns about Earth's axis by Omega t
    in i (Rodrigues' formula, integrated)."""
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
    """The rotation (W, 3, 3) that fits beta = C alpha best, both (W, T, 3): the eigenvector of
    the largest eigenvalue of Davenport's K (Wu et al. 2011, eq. 24; Markley & Mortari 2000)."""
    B = np.einsum("wti,wtj->wij", beta, alpha)
    z = np.stack([B[:, 2, 1] - B[:, 1, 2], B[:, 0, 2] - B[:, 2, 0], B[:, 1, 0] - B[:, 0, 1]], -1)
    trace = np.trace(B, axis1=1, axis2=2)
    K = np.empty((len(B), 4, 4))
    K[:, :3, :3] = B + np.swapaxes(B, 1, 2) - trace[:, None, None] * np.eye(3)
    K[:, :3, 3] = K[:, 3, :3] = z
    K[:, 3, 3] = trace
    return np.asarray(Rotation.from_quat(np.linalg.eigh(K)[1][..., -1]).as_matrix())


def _mean_heading(c_ib0: np.ndarray, series: _Series, windows: Windows) -> np.ndarray:
    """Of the body over the window, less the plate's angle: n turns with Earth in i meanwhile."""
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


def _sigma(c_ib0: np.ndarray, series: _Series, form: _Form) -> np.ndarray:
    """Of the heading, (W,), from what the fit leaves: the sway's velocity r.

    A small rotation phi of the fit moves it by phi x beta, so phi is a linear regression and the
    heading's error is G' D r/(G' G): G the heading's regressor with the tilts' and the offset's
    share taken out, D the form that was fitted. The variance of g' r, g = D' G, is estimated as
    lbgc.estimators.longrun says. The fit took some of r with it, most where g lies: the sum is
    divided by what it would be on average if r were white, over what that should be. It has few
    degrees of freedom, see STUDENT.
    """
    left = series.beta - np.einsum("wij,wtj->wti", c_ib0, series.alpha)
    if form is not _AS_IT_IS:
        left = _centred(left)
    n = left.shape[1]
    fitted = form.of(series.beta)
    sigma = np.empty(len(left))
    for row in range(len(left)):
        if row == 0 or (series.beta[row] != series.beta[row - 1]).any():  # they share a latitude
            G = _regressor(fitted[row], offsets=False)[1]
            basis = _regressor(series.beta[row], offsets=True)[0]
            g, size = form.transpose(G, n), np.sum(G**2)
            weights = kernel(g)
            taken = np.sum(weights[..., None] * autocorrelation(basis)[: len(weights)])
        found = np.sum(weights * autocorrelation(left[row, :, :2])[: len(weights)])
        of_white = np.sum(g**2)
        sigma[row] = np.sqrt(STUDENT * found * of_white / (of_white - taken)) / size
    return sigma


def _regressor(beta: np.ndarray, offsets: bool) -> tuple[np.ndarray, np.ndarray]:
    """How the horizontal velocity moves with the heading alone, (T, 2): phi_z x beta with what
    tilts, and offsets, could explain projected out; and an orthonormal basis (T, 2, 3 or 5) of all
    that a fit can explain."""
    basis, triangle = np.linalg.qr(_regressor_columns(beta, offsets))
    G = basis[:, -1] * triangle[-1, -1]
    return np.moveaxis(basis.reshape(2, -1, basis.shape[1]), 0, 1), G.reshape(2, -1).T


def _regressor_columns(beta: np.ndarray, offsets: bool) -> np.ndarray:
    """How horizontal velocity moves with both tilts, offsets if asked for, and last the heading:
    (2 T, 3 or 5), forward above right."""
    x, y, z = beta.T
    none, one = np.zeros_like(x), np.ones_like(x)
    others = [(none, -z), (z, none), *([(one, none), (none, one)] if offsets else [])]
    return np.stack([np.concatenate(pair) for pair in (*others, (-y, x))], axis=1)
