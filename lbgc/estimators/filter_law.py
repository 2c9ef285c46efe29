"""The dynamics of the errors that the Kalman filter estimates: its states, how they begin, and what
drives them. See lbgc.estimators.kalman."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE
from lbgc.estimators import reduced_order
from lbgc.estimators.filter_steps import Steps
from lbgc.estimators.plate import mean_turn
from lbgc.frames import across
from lbgc.sensor.errors import ONE
from lbgc.sensor.imu import ImuModel

PHI, V, Q, BG, BA, M, WG, WA = (
    slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 11), slice(11, 14), slice(14, 17),
    slice(17, 20), slice(20, 23),
)  # fmt: skip
"""States: attitude, velocity, q, gyro and accelerometer biases, each gyro's error by the plate's
rate, Gauss-Markov parts of gyros and accelerometers. Those of a sensor that warms up, and of a
plate that turns about a level axis, follow."""
_STATES = 23
SHAKEN = 1.0
"""m/s, 1 sigma added to velocity in steps in which the plate is not steady: while it speeds up, an
unknown lever arm causes velocities that the filter cannot follow."""
Q_SIGMA = 10.0
_LEVER_M = 0.3
_TILT_SIGMA = np.deg2rad(2.0)


@dataclass(frozen=True)
class Law:
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
    axis: int
    """The body's axis about which the plate turns"""
    warms: tuple[slice, np.ndarray] | None
    """The states that are gyro biases by the kelvin, and (W, n), K, temperature's rise since
    power-up in each step; None where it changes no gyro's bias"""
    turns: tuple[tuple[slice, ...], np.ndarray] | None
    """The states that follow the cosine and the sine of the plate's angle, the gyros' and the
    accelerometers', and (W, n), complex, the mean of exp(i angle) over each step; None about down
    """

    def of_gyro(self, rate: np.ndarray, k: int) -> Iterator[tuple[slice, np.ndarray | float]]:
        """The states that add to the gyros' errors in step k, and by what each is multiplied, (W,).
        rate : (W, 3), rad/s."""
        yield from ((BG, 1.0), (WG, 1.0), (M, rate[:, self.axis]))
        if self.warms is not None:
            yield self.warms[0], self.warms[1][:, k]
        yield from self._turned(k, slice(0, 2))

    def of_accel(self, k: int) -> Iterator[tuple[slice, np.ndarray | float]]:
        """The states that add to the accelerometers' errors in step k, likewise."""
        yield from ((BA, 1.0), (WA, 1.0))
        yield from self._turned(k, slice(2, 4))

    def _turned(self, k: int, which: slice) -> Iterator[tuple[slice, np.ndarray]]:
        """The states that turn with the plate, of one triad, and their factors in step k."""
        if self.turns is not None:
            states, turn = self.turns
            yield from zip(states[which], (turn[:, k].real, turn[:, k].imag), strict=True)

    @classmethod
    def of(cls, windows: Windows, imu: ImuModel, steps: Steps, still: bool) -> "Law":
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
        by_turn = _STATES + 3 * int(warms)
        states = by_turn + 12 * when.about_level
        start, driven, decay = np.zeros((w, states)), np.zeros((w, states)), np.ones(states)
        start[:, PHI] = _TILT_SIGMA**2, _TILT_SIGMA**2, 0.0
        start[:, V], start[:, Q] = SHAKEN**2, Q_SIGMA**2
        start[:, M], of_turning = reduced_order.turning(imu, when)
        driven[:, M] = of_turning * h
        for law, constant, wanders in ((gyro, BG, WG), (accel, BA, WA)):
            start[:, constant], start[:, wanders] = law.constant, law.wander
            driven[:, constant] = law.walk * h
            decay[wanders] = np.exp(-h / law.time)
            driven[:, wanders] = law.wander * (1 - decay[wanders] ** 2)
        # An even turn at an unknown lever arm is felt as a constant force in the body's axes.
        spin = np.abs(np.where(steps.even, 2 * steps.half / h, 0.0)).max(axis=1)
        for row in across(when.axis):
            start[:, BA.start + row] += (_LEVER_M * spin**2) ** 2
        driven[:, V] = accel.white * h
        warmth, turns = None, None
        if warms:
            by_kelvin_are = slice(_STATES, by_turn)
            start[:, by_kelvin_are] = by_kelvin
            middles = (np.arange(steps.angle.shape[1]) + 0.5) * h
            rise = imu.warming.rise_at(when.start_s[:, None] + middles)
            warmth = by_kelvin_are, rise
        if when.about_level:
            each = tuple(slice(at, at + 3) for at in range(by_turn, states, 3))
            for these, size in zip(each, reduced_order.turned_with_plate(imu, when), strict=True):
                start[:, these] = size
            turns = each, mean_turn(steps.angle, 2 * steps.half * steps.even)
        return cls(gyro, accel, earth, vertical, gravity, start, decay, driven, when.axis, warmth,
                   turns)  # fmt: skip
