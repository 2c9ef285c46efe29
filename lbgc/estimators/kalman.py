"""Fine alignment by an error-state Kalman filter, from any heading.

The filter works in axes n' that are level, fixed to Earth, and have the heading that the body had
when the plate's encoder read zero; their heading psi is what is sought. With q = (cos psi, sin psi)
Earth's rate there is linear in q (Scherzinger 1996, "Inertial navigation system error models for
large heading uncertainty"),

    w_ie = Omega (cos(lat) q_1, -cos(lat) q_2, -sin(lat))

so an unknown heading is a q of any size, and the filter stays linear however wrong it begins; with
a small-angle heading error it would not. The information on q at the end, less that of the prior at
the start, is a log-likelihood q' h - q' J q/2, which is then put on the circle (see
lbgc.estimators.posterior). The other states are errors of attitude phi (true C = (I + phi x) C),
velocity, and biases: of each gyro and accelerometer a constant that walks and one Gauss-Markov
process (see lbgc.estimators.reduced_order), and each gyro's error by the plate's rate: misalignment
towards its axis and that axis' scale factor. A sensor that warms up has each gyro's bias by the
kelvin besides, times the temperature's rise.

    phi' = -w_ie x phi - C (b_g + m w_a + white) - dw_ie(q)
    v'   = -f x phi - C (b_a + white)

(Shin 2005, "Estimation techniques for low-cost inertial navigation", with v relative to Earth and
its Coriolis force left out.) The gyros propagate C. Velocity is zero while the plate rests or turns
evenly (ZUPT, zero-velocity updates). While it does so on a base that rests, C follows the plate's
angle, and the gyros measure Earth's rate and their biases (zero angular rate, but for the plate's;
its vertical part is ZIHR, zero integrated heading rate). If the gyros propagated C there, north on
a carousel would come through the accelerometers' noise: a third more error than the optimum.

About a level axis C follows the plate's angle throughout, since nothing shows a heading that gyros
lose in a slew. Errors that follow gravity or Earth's rate turn with the plate there, as north does:
they are states of their own, multiplied by the cosine and the sine of its angle.

The filter itself shows whether the base rests: where its innovations are much larger than it
expects, the window is answered again at 10 Hz or faster, with C propagated by the gyros throughout,
and with velocity as noisy as the window shows it to be (see lbgc.estimators.sway_noise). Steps of a
tenth of a second blur a sway of one or two cycles a second: there sigma is too large, by a tenth
and more (`oba` uses the samples).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE
from lbgc.estimators import reduced_order
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.estimators.filter_law import BG, PHI, Q_SIGMA, SHAKEN, Law, Q, V
from lbgc.estimators.filter_steps import Steps, coarse, cut_steps, sway
from lbgc.estimators.least_squares import check, needs_model
from lbgc.estimators.plate import mean_turn
from lbgc.estimators.posterior import bayes
from lbgc.frames import DOWN, across, matrix_to_euler, rotation, rotation_matrix, skew, wrap
from lbgc.sensor.imu import ImuModel

_MOST_STEPS = 240
_FAST_HZ = 10.0
_SLOWEST_HZ = 5.0
_LEAST_SAMPLES = 10
_CHUNK = 256  # windows at once
_ENCODER = np.deg2rad(0.01)
_STILL = 1e-5
"""m/s, 1 sigma of the velocity of a base that rests."""
_MOVES = 2.0
"""Mean of normalised squared innovations above which the base is taken to move."""


def ekf(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Fine alignment by an error-state Kalman filter; see the module.

    It needs the sensor's model, and takes any tilt and any plate that rests or turns evenly for
    some of the window. On a base that moves it answers the mean heading over the window.
    """
    model = needs_model("ekf", imu)
    check("ekf", windows)
    samples = windows.gyro.shape[1]
    if samples < _LEAST_SAMPLES:
        raise refusal("ekf", samples, "", f"samples a window; it takes {_LEAST_SAMPLES} or more")
    found = [_answer(windows.rows(slice(i, i + _CHUNK)), model)
             for i in range(0, len(windows), _CHUNK)]  # fmt: skip
    none = np.zeros(0)
    return Estimate(
        np.concatenate([none, *(f.heading for f in found)]),
        np.concatenate([none, *(f.sigma for f in found)]),
    )


def _answer(windows: Windows, imu: ImuModel) -> Estimate:
    """The filter's answers on a base that rests, and anew for those windows that show it moving.
    Raises InputError where these have samples too slow to follow a motion."""
    samples = windows.gyro.shape[1]
    steps = cut_steps(windows, imu, -(-samples // _MOST_STEPS), False, "ekf")
    quiet = np.full(
        len(windows),
        _STILL**2 + reduced_order.of_accel(imu, reduced_order.When.of(windows)).angle.max(),
    )
    found, surprise = _filter(windows, imu, steps, quiet, still=True)
    moves = np.flatnonzero(surprise > _MOVES)
    if not len(moves):
        return found
    if windows.axis != DOWN:
        about = "times the squared innovations that the sensor's model explains: the base moves, "
        about += "which takes a plate about down, or the model is not this sensor's"
        raise refusal("ekf", f"{surprise.max():.3g}", "", about)
    if windows.rate_hz < _SLOWEST_HZ:
        about = ("times the squared innovations that the sensor's model explains: the base moves, "
                 f"which takes samples at {_SLOWEST_HZ:g} Hz or faster, or the model is not this "
                 "sensor's")  # fmt: skip
        raise refusal("ekf", f"{surprise.max():.3g}", "", about)
    swaying = windows.rows(moves)
    fast = cut_steps(swaying, imu, max(1, int(windows.rate_hz / _FAST_HZ)), True, "ekf")
    noise = sway(fast, "ekf")
    again, _ = _filter(swaying, imu, fast, noise, still=False)
    found.heading[moves], found.sigma[moves] = again.heading, again.sigma
    return found


@dataclass
class _State:
    """The filter's estimates for W windows, and their covariance."""

    c_nb: np.ndarray
    """(W, 3, 3), attitude C of the body in n'"""
    velocity: np.ndarray
    """(W, 3), m/s, in n'"""
    q: np.ndarray
    """(W, 2)"""
    other: np.ndarray
    """(W, states - 8): biases, misalignment, Gauss-Markov parts, biases by the kelvin, as in P"""
    P: np.ndarray
    """(W, states, states), covariance of the errors"""

    def take(self, error: np.ndarray) -> None:
        """Correct the estimates by the errors found, (W, states)."""
        self.c_nb = rotation_matrix(error[:, PHI]) @ self.c_nb
        self.velocity += error[:, V]
        self.q += error[:, Q]
        self.other += error[:, BG.start :]

    def one(self, which: slice) -> np.ndarray:
        """The estimates in `other` of three states, which are numbered as in P, (W, 3)."""
        return self.other[:, which.start - BG.start : which.stop - BG.start]

    def summed(self, parts: Iterable[tuple[slice, np.ndarray | float]]) -> np.ndarray:
        """A triad's errors, (W, 3), as the sum of states times factors (see `Law.of_gyro`)."""
        none = np.zeros((len(self.q), 3))
        return sum((self.one(own) * np.reshape(by, (-1, 1)) for own, by in parts), none)


def _filter(
    windows: Windows, imu: ImuModel, steps: Steps, noise: np.ndarray, still: bool
) -> tuple[Estimate, np.ndarray]:
    """Run the filter over the steps: the answers, and the mean of the normalised squared
    innovations, (W,).

    noise : (W,), (m/s)^2, variance of velocities that should be zero; still : whether the base is
    taken to rest.
    """
    law = Law.of(windows, imu, steps, still)
    base, c_nb, first = coarse(steps)
    w, n = steps.angle.shape
    states = law.start.shape[1]
    P = law.start[:, :, None] * np.eye(states)
    other = np.zeros((w, states - BG.start))
    state = _State(c_nb, np.zeros((w, 3)), np.zeros((w, 2)), other, P)
    R = np.full((w, 7), _ENCODER**2)
    R[:, :3] = (law.gyro.white + 2 * law.gyro.angle / windows.duration_s) / steps.interval
    R[:, 3:6] = noise[:, None]
    surprise, count = np.zeros(w), np.zeros(w)
    turned, carried = np.zeros(w, complex), steps.carried
    for k in range(n):
        begun = k >= first
        even, none = steps.even[:, k] & begun, steps.unrecorded[:, k]
        held = (even & still) | ~begun | none
        start = state.c_nb
        _advance(state, law, steps, k, held)
        if none.any():
            by = rotation(np.where(begun, carried[:, k], 0.0), law.axis)
            _carry(state, none, by)
        state.P[:, V, V] += (~even * SHAKEN**2)[:, None, None] * np.eye(3)
        z, H = _innovation(state, law, steps, k, base, start)
        encoder = even & still & (law.axis == DOWN)  # elsewhere C is the encoder's throughout
        used = np.stack([even & held] * 3 + [even] * 3 + [encoder], axis=1)
        surprise += _update(state, z, H, R, used)
        count += used.sum(axis=1)
        at_zero = state.c_nb @ rotation(-steps.angle[:, k] - steps.half[:, k], law.axis)
        turned += np.exp(1j * matrix_to_euler(at_zero)[2]) * even
    # A base that rests does not turn: what the gyros add in a slew is their error.
    off = 0.0 if still else np.angle(turned)
    when = reduced_order.When.of(windows)
    mimics = np.zeros(w)
    if not when.about_level:
        mimics = reduced_order.like_north(imu, when, windows.plate_angle)
    mimics = mimics / np.square(EARTH_RATE * np.cos(when.latitude))
    return _on_the_circle(state, off, mimics), surprise / np.maximum(count, 1)


def _advance(state: _State, law: Law, steps: Steps, k: int, held: np.ndarray) -> None:
    """Propagate estimates and covariance through step k. held : bool (W,), where C follows the
    plate's angle alone."""
    h, rate = steps.interval, steps.rate[:, k]
    plate = steps.half[:, k] * steps.even[:, k]
    earth = law.vertical + np.einsum("wij,wj->wi", law.earth, state.q)
    of_gyro = state.summed(law.of_gyro(rate, k))
    c_nb = state.c_nb
    by_plate = rotation(plate, law.axis)
    middle = np.where(held[:, None, None], by_plate, rotation_matrix(rate * h / 2))
    middle = c_nb @ middle
    on = rotation_matrix(-earth * h) @ c_nb @ steps.turned[:, k] @ rotation_matrix(-of_gyro * h)
    stays = held & (plate == 0.0)
    stays &= ~steps.unrecorded[:, k]
    push = np.where(stays[:, None], steps.force[:, k] * h, steps.push[:, k])
    pushed = np.einsum("wij,wj->wi", c_nb, push)
    pushed -= np.einsum("wij,wj->wi", middle, state.summed(law.of_accel(k))) * h
    state.velocity += pushed + law.gravity * h
    state.c_nb = np.where(held[:, None, None], c_nb @ rotation(2 * plate, law.axis), on)

    carried = (~held)[:, None, None]
    D = np.zeros((len(held), 6, len(law.decay)))  # the transition of phi and v, less identity
    D[:, PHI, PHI] = -skew(earth * h) * carried
    D[:, PHI, Q] = -law.earth * h * carried
    for own, by in law.of_gyro(rate, k):
        D[:, PHI, own] = -middle * h * carried * np.reshape(by, (-1, 1, 1))
    D[:, V, PHI] = -skew(pushed)
    for own, by in law.of_accel(k):
        D[:, V, own] = -middle * h * np.reshape(by, (-1, 1, 1))
    P = state.P
    moved = D @ P
    P[:, :6] += moved
    P[:, :, :6] += np.swapaxes(moved, 1, 2)
    P[:, :6, :6] += moved @ np.swapaxes(D, 1, 2)
    P *= law.decay[:, None] * law.decay
    state.other *= law.decay[BG.start :]
    diagonal = np.arange(len(law.decay))
    P[:, diagonal, diagonal] += law.driven
    P[:, PHI, PHI] += carried * (law.gyro.white * h) * np.eye(3)


def _carry(state: _State, none: np.ndarray, by: np.ndarray) -> None:
    """Carry windows over a step that was not recorded, none, bool (W,): the base rests, the plate
    turns by this rotation, (W, 3, 3), and nothing is known of a velocity."""
    state.c_nb = np.where(none[:, None, None], state.c_nb @ by, state.c_nb)
    state.velocity[none] = 0.0
    state.P[none, V] = 0.0
    state.P[none, :, V] = 0.0


def _innovation(
    state: _State, law: Law, steps: Steps, k: int, base: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The innovations of step k, (W, 7), and their derivatives by the errors, (W, 7, states).

    The innovations are the measured rate less what is expected on the plate (3, rad/s), zero less
    velocity (3, m/s), and the plate's angle less the one that C implies (rad).

    base : (W, 3, 3), the base's initial attitude; start : (W, 3, 3), C at the step's start.
    """
    rate = steps.rate[:, k]
    earth = law.vertical + np.einsum("wij,wj->wi", law.earth, state.q)
    half = steps.half[:, k] * steps.even[:, k]
    i, j = across(law.axis)
    c_bn = np.swapaxes(state.c_nb @ rotation(-half, law.axis), 1, 2)  # in the middle, and its mean
    c_bn[:, [i, j]] *= mean_turn(0 * half, 2 * half).real[:, None, None]
    of_gyro = state.summed(law.of_gyro(rate, k))
    z = np.zeros((len(rate), 7))
    z[:, :3] = rate - of_gyro - np.einsum("wij,wj->wi", c_bn, earth)
    z[:, law.axis] -= 2 * half / steps.interval
    back = np.einsum("wij,wj->wi", start, steps.push[:, k] - steps.mean_push[:, k])
    short = steps.interval - steps.mean_time
    free = law.gravity - np.einsum("wij,wj->wi", start, state.summed(law.of_accel(k)))
    z[:, 3:6] = back + free * short - state.velocity
    angle = steps.angle[:, k] + steps.half[:, k]
    implied = np.swapaxes(base, 1, 2) @ state.c_nb
    z[:, 6] = wrap(angle - np.arctan2(implied[:, j, i], implied[:, i, i]))
    H = np.zeros((len(rate), 7, len(law.decay)))
    H[:, :3, PHI] = c_bn @ skew(earth)
    H[:, :3, Q] = c_bn @ law.earth
    for own, by in law.of_gyro(rate, k):
        H[:, :3, own] = np.eye(3) * np.reshape(by, (-1, 1, 1))
    H[:, 3:6, V] = np.eye(3)
    H[:, 3:6, PHI] = skew(back)
    for own, by in law.of_accel(k):
        H[:, 3:6, own] = start * short * np.reshape(by, (-1, 1, 1))
    H[:, 6, PHI] = state.c_nb[:, :, law.axis]
    return z, H


def _update(
    state: _State, z: np.ndarray, H: np.ndarray, R: np.ndarray, used: np.ndarray
) -> np.ndarray:
    """Correct estimates and covariance by the innovations z, (W, m), that are used, bool (W, m).
    R : (W, m), their variances. Returns the sum of the normalised squared innovations, (W,)."""
    z, H, R = z * used, H * used[..., None], np.where(used, R, 1.0)
    PH = state.P @ np.swapaxes(H, 1, 2)
    S = H @ PH + R[:, None, :] * np.eye(R.shape[1])
    K = np.swapaxes(np.linalg.solve(S, np.swapaxes(PH, 1, 2)), 1, 2)
    state.P -= K @ np.swapaxes(PH, 1, 2)
    state.take(np.einsum("wij,wj->wi", K, z))
    return np.asarray(np.einsum("wi,wi->w", z, np.linalg.solve(S, z[..., None])[..., 0]))


def _on_the_circle(state: _State, off: np.ndarray | float, mimics: np.ndarray) -> Estimate:
    """The heading's posterior mean and spread under a flat prior on the circle, from the
    information on q that the window has added.

    off : rad, (W,), by which the body's mean heading differs from that of n'; mimics : (W,), the
    variance of errors that add to each component of q and cannot be told from it.
    """
    inverse = np.linalg.inv(state.P[:, Q, Q])
    h = np.einsum("wij,wj->wi", inverse, state.q)
    J = inverse - np.eye(2) / Q_SIGMA**2
    told = np.linalg.inv(np.eye(2) + mimics[:, None, None] * J)
    found = bayes(np.einsum("wij,wj->wi", told, h), told @ J)
    return Estimate(wrap(found.heading + off), found.sigma)
