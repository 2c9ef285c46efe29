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
process (see lbgc.estimators.reduced_order), and each gyro's error by the rate about z: misalignment
and the scale factor in z. A sensor that warms up has each gyro's bias by the kelvin besides, times
the temperature's rise.

    phi' = -w_ie x phi - C (b_g + m w_z + white) - dw_ie(q)
    v'   = -f x phi - C (b_a + white)

(Shin 2005, "Estimation techniques for low-cost inertial navigation", with v relative to Earth and
its Coriolis force left out.) The gyros propagate C. Velocity is zero while the plate rests or turns
evenly (ZUPT, zero-velocity updates). While it does so on a base that rests, C follows the plate's
angle, and the gyros measure Earth's rate and their biases (zero angular rate, but for the plate's;
its vertical part is ZIHR, zero integrated heading rate). If the gyros propagated C there, north on
a carousel would come through the accelerometers' noise: a third more error than the optimum.

The filter itself shows whether the base rests: where its innovations are much larger than it
expects, the window is answered again at 10 Hz or faster, with C propagated by the gyros throughout,
and with velocity as noisy as the window shows it to be (see lbgc.estimators.sway_noise). Steps of a
tenth of a second blur a sway of one or two cycles a second: there sigma is too large, by a tenth
and more (`oba` uses the samples).
"""

from dataclasses import dataclass

import numpy as np

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE
from lbgc.estimators import reduced_order
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.estimators.filter_steps import Steps, coarse, cut_steps, sway
from lbgc.estimators.least_squares import check, needs_model
from lbgc.estimators.plate import mean_turn
from lbgc.estimators.posterior import bayes
from lbgc.frames import matrix_to_euler, rotation_matrix, rotation_z, skew, wrap
from lbgc.sensor.errors import ONE
from lbgc.sensor.imu import ImuModel

PHI, V, Q, BG, BA, M, WG, WA, T = (
    slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 11), slice(11, 14), slice(14, 17),
    slice(17, 20), slice(20, 23), slice(23, 26),
)  # fmt: skip
"""States: attitude, velocity, q, gyro and accelerometer biases, each gyro's error by the rate about
z, Gauss-Markov parts of gyros and accelerometers, gyro biases by the kelvin."""
_STATES = 23  # without T, which only a sensor that warms up has
_MOST_STEPS = 240
_FAST_HZ = 10.0
_SLOWEST_HZ = 5.0
_LEAST_SAMPLES = 10
_CHUNK = 256  # windows at once
_LEVER_M = 0.3
_Q_SIGMA = 10.0
_TILT_SIGMA = np.deg2rad(2.0)
_SHAKEN = 1.0
"""m/s, 1 sigma added to velocity in steps in which the plate is not steady: while it speeds up, an
unknown lever arm causes velocities that the filter cannot follow."""
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

    def of_gyro(self, rate: np.ndarray, warmth: np.ndarray | None) -> np.ndarray:
        """The gyros' errors, (W, 3), rad/s. rate : (W, 3), rad/s; warmth : (W,), K, or None."""
        found = self.one(BG) + self.one(WG) + self.one(M) * rate[:, 2:]
        return np.asarray(found if warmth is None else found + self.one(T) * warmth[:, None])

    def of_accel(self) -> np.ndarray:
        """The accelerometers' errors, (W, 3), m/s^2."""
        return np.asarray(self.one(BA) + self.one(WA))


@dataclass(frozen=True)
class _Law:
    """The dynamics of the errors in W windows: initial variances, decay and driving noise."""

    gyro: reduced_order.Drift
    accel: reduced_order.Drift
    earth: np.ndarray
    """(W, 3, 2), rad/s: the matrix by which q makes Earth's horizontal rate"""
    vertical: np.ndarray
    """(W, 3), rad/s: Earth's rate about down"""
    gravity: np.ndarray
    """(W, 3), m/s^2"""
    start: np.ndarray
    """(W, states), initial variances"""
    decay: np.ndarray
    """(states,), factor by which a state decays in a step"""
    driven: np.ndarray
    """(W, states), variances that a step adds"""
    warmth: np.ndarray | None
    """(W, n), K, temperature's rise since power-up in each step; None where it changes no gyro's
    bias"""

    def warmth_at(self, k: int) -> np.ndarray | None:
        """The temperature's rise in step k, (W,), K, or None."""
        return None if self.warmth is None else self.warmth[:, k]

    @classmethod
    def of(cls, windows: Windows, imu: ImuModel, steps: Steps, still: bool) -> "_Law":
        """The dynamics for a sensor in these windows and steps."""
        latitude, when = windows.latitude, reduced_order.When.of(windows)
        w, h = len(windows), steps.interval
        # How a bias changes by the kelvin is a state of its own.
        by_kelvin = imu.gyro.variance(ONE, warms=True).diagonal()
        gyro = reduced_order.of_gyro(imu, when, warming_bias=False, at_rest=False)
        accel = reduced_order.of_accel(imu, when)
        earth = np.zeros((w, 3, 2))
        earth[:, 0, 0] = EARTH_RATE * np.cos(latitude)
        earth[:, 1, 1] = -earth[:, 0, 0]
        vertical, gravity = np.zeros((w, 3)), np.zeros((w, 3))
        vertical[:, 2], gravity[:, 2] = -EARTH_RATE * np.sin(latitude), when.gravity
        warms = imu.warming.rise_k != 0 and by_kelvin.any()
        states = T.stop if warms else _STATES
        start, driven, decay = np.zeros((w, states)), np.zeros((w, states)), np.ones(states)
        start[:, PHI] = _TILT_SIGMA**2, _TILT_SIGMA**2, 0.0
        start[:, V], start[:, Q] = _SHAKEN**2, _Q_SIGMA**2
        start[:, M], of_turning = reduced_order.turning(imu, when)
        driven[:, M] = of_turning * h
        for law, constant, wanders in ((gyro, BG, WG), (accel, BA, WA)):
            start[:, constant], start[:, wanders] = law.constant, law.wander
            driven[:, constant] = law.walk * h
            decay[wanders] = np.exp(-h / law.time)
            driven[:, wanders] = law.wander * (1 - decay[wanders] ** 2)
        # An even turn at an unknown lever arm is felt as a constant force in the body's axes.
        spin = np.abs(np.where(steps.even, 2 * steps.half / h, 0.0)).max(axis=1)
        start[:, BA.start : BA.start + 2] += ((_LEVER_M * spin**2) ** 2)[:, None]
        driven[:, V] = accel.white * h
        warmth = None
        if warms:
            start[:, T] = by_kelvin
            middles = (np.arange(steps.angle.shape[1]) + 0.5) * h
            warmth = imu.warming.rise_at(when.start_s[:, None] + middles)
        return cls(gyro, accel, earth, vertical, gravity, start, decay, driven, warmth)


def _filter(
    windows: Windows, imu: ImuModel, steps: Steps, noise: np.ndarray, still: bool
) -> tuple[Estimate, np.ndarray]:
    """Run the filter over the steps: the answers, and the mean of the normalised squared
    innovations, (W,).

    noise : (W,), (m/s)^2, variance of velocities that should be zero; still : whether the base is
    taken to rest.
    """
    law = _Law.of(windows, imu, steps, still)
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
            _carry(state, none, np.where(begun, carried[:, k], 0.0))
        state.P[:, V, V] += (~even * _SHAKEN**2)[:, None, None] * np.eye(3)
        z, H = _innovation(state, law, steps, k, base, start)
        used = np.stack([even & held] * 3 + [even] * 3 + [even & still], axis=1)
        surprise += _update(state, z, H, R, used)
        count += used.sum(axis=1)
        at_zero = state.c_nb @ rotation_z(-steps.angle[:, k] - steps.half[:, k])
        turned += np.exp(1j * matrix_to_euler(at_zero)[2]) * even
    # A base that rests does not turn: what the gyros add in a slew is their error.
    off = 0.0 if still else np.angle(turned)
    when = reduced_order.When.of(windows)
    mimics = reduced_order.like_north(imu, when, windows.plate_angle)
    mimics = mimics / np.square(EARTH_RATE * np.cos(when.latitude))
    return _on_the_circle(state, off, mimics), surprise / np.maximum(count, 1)


def _advance(state: _State, law: _Law, steps: Steps, k: int, held: np.ndarray) -> None:
    """Propagate estimates and covariance through step k. held : bool (W,), where C follows the
    plate's angle alone."""
    h, rate = steps.interval, steps.rate[:, k]
    plate = steps.half[:, k] * steps.even[:, k]
    earth = law.vertical + np.einsum("wij,wj->wi", law.earth, state.q)
    warmth = law.warmth_at(k)
    of_gyro = state.of_gyro(rate, warmth)
    c_nb = state.c_nb
    middle = np.where(held[:, None, None], rotation_z(plate), rotation_matrix(rate * h / 2))
    middle = c_nb @ middle
    on = rotation_matrix(-earth * h) @ c_nb @ steps.turned[:, k] @ rotation_matrix(-of_gyro * h)
    stays = held & (plate == 0.0)
    stays &= ~steps.unrecorded[:, k]
    push = np.where(stays[:, None], steps.force[:, k] * h, steps.push[:, k])
    pushed = np.einsum("wij,wj->wi", c_nb, push)
    pushed -= np.einsum("wij,wj->wi", middle, state.of_accel()) * h
    state.velocity += pushed + law.gravity * h
    state.c_nb = np.where(held[:, None, None], c_nb @ rotation_z(2 * plate), on)

    carried = (~held)[:, None, None]
    D = np.zeros((len(held), 6, len(law.decay)))  # the transition of phi and v, less identity
    D[:, PHI, PHI] = -skew(earth * h) * carried
    D[:, PHI, Q] = -law.earth * h * carried
    D[:, PHI, BG] = D[:, PHI, WG] = -middle * h * carried
    D[:, PHI, M] = D[:, PHI, BG] * rate[:, None, 2:]
    if warmth is not None:
        D[:, PHI, T] = D[:, PHI, BG] * warmth[:, None, None]
    D[:, V, PHI] = -skew(pushed)
    D[:, V, BA] = D[:, V, WA] = -middle * h
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
    turns by this angle, (W,), rad, and nothing is known of a velocity."""
    state.c_nb = np.where(none[:, None, None], state.c_nb @ rotation_z(by), state.c_nb)
    state.velocity[none] = 0.0
    state.P[none, V] = 0.0
    state.P[none, :, V] = 0.0


def _innovation(
    state: _State, law: _Law, steps: Steps, k: int, base: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The innovations of step k, (W, 7), and their derivatives by the errors, (W, 7, states).

    The innovations are the measured rate less what is expected on the plate (3, rad/s), zero less
    velocity (3, m/s), and the plate's angle less the one that C implies (rad).

    base : (W, 3, 3), the base's initial attitude; start : (W, 3, 3), C at the step's start.
    """
    rate = steps.rate[:, k]
    earth = law.vertical + np.einsum("wij,wj->wi", law.earth, state.q)
    half = steps.half[:, k] * steps.even[:, k]
    c_bn = np.swapaxes(state.c_nb @ rotation_z(-half), 1, 2)  # in the middle, and its mean
    c_bn[:, :2] *= mean_turn(0 * half, 2 * half).real[:, None, None]
    warmth = law.warmth_at(k)
    of_gyro = state.of_gyro(rate, warmth)
    z = np.zeros((len(rate), 7))
    z[:, :3] = rate - of_gyro - np.einsum("wij,wj->wi", c_bn, earth)
    z[:, 2] -= 2 * half / steps.interval
    back = np.einsum("wij,wj->wi", start, steps.push[:, k] - steps.mean_push[:, k])
    short = steps.interval - steps.mean_time
    free = law.gravity - np.einsum("wij,wj->wi", start, state.of_accel())
    z[:, 3:6] = back + free * short - state.velocity
    angle = steps.angle[:, k] + steps.half[:, k]
    z[:, 6] = wrap(angle - matrix_to_euler(np.swapaxes(base, 1, 2) @ state.c_nb)[2])
    H = np.zeros((len(rate), 7, len(law.decay)))
    H[:, :3, PHI] = c_bn @ skew(earth)
    H[:, :3, Q] = c_bn @ law.earth
    H[:, :3, BG] = H[:, :3, WG] = np.eye(3)
    H[:, :3, M] = np.eye(3) * rate[:, None, 2:]
    if warmth is not None:
        H[:, :3, T] = np.eye(3) * warmth[:, None, None]
    H[:, 3:6, V] = np.eye(3)
    H[:, 3:6, PHI] = skew(back)
    H[:, 3:6, BA] = H[:, 3:6, WA] = start * short
    H[:, 6, PHI] = state.c_nb[:, :, 2]
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
    J = inverse - np.eye(2) / _Q_SIGMA**2
    told = np.linalg.inv(np.eye(2) + mimics[:, None, None] * J)
    found = bayes(np.einsum("wij,wj->wi", told, h), told @ J)
    return Estimate(wrap(found.heading + off), found.sigma)
