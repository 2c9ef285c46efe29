"""What a filter of few states makes of a sensor: each axis's errors as a constant that walks, one
first-order Gauss-Markov process, and white noise.

Flicker is a sum of Gauss-Markov processes (lbgc.sensor.noise.Flicker). Against a window of length
T, one whose correlation time is below T/10 is white, one above 2 T a constant that walks (both by
their limits: density 2 s T_i, walk 2 s/T_i, s the variance); what lies between becomes one process.
For two rests by turns, or one, the variance that follows is within 5% of the exact law's up to a
quarter of an hour, sdc500's flicker and walk.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, normal_gravities
from lbgc.sensor.errors import FIELD, FORCE, ONE, TRUTH
from lbgc.sensor.imu import ImuModel, Triad

_SHORT, _LONG = 0.1, 2.0
_LEAST = (1e-8, 1e-6)
"""rad/sqrt(s) and m/s/sqrt(s): a sensor without any noise has a covariance that rounding breaks;
far below all others."""


@dataclass(frozen=True)
class Drift:
    """Model of a triad's errors in W windows, in SI units; each (3,) but where it says so."""

    white: np.ndarray
    """Density N^2"""
    angle: np.ndarray
    """Variance of what errs in the integral (angle, velocity) and does not add up"""
    constant: np.ndarray
    """Variance at each window's start, (W, 3)"""
    walk: np.ndarray
    """K^2, (W, 3)"""
    wander: np.ndarray
    """Variance of the Gauss-Markov process"""
    time: np.ndarray
    """s, its correlation time"""


@dataclass(frozen=True)
class When:
    """Where W windows lie in time and on Earth."""

    duration_s: float
    start_s: np.ndarray
    """(W,), s since the recording's start"""
    latitude: np.ndarray
    """(W,), rad"""
    gravity: np.ndarray
    """(W,), m/s^2"""

    @classmethod
    def of(cls, windows: Windows) -> "When":
        gravity = normal_gravities(windows.latitude)
        return cls(windows.duration_s, windows.start_s, windows.latitude, gravity)


def of_gyro(
    imu: ImuModel,
    when: When,
    processes: bool = True,
    warming_bias: bool = True,
    turning_with_plate: bool = True,
) -> Drift:
    """The gyros' drift. What a rate about z makes in each of them is no part of it: that turns with
    the plate's rate, and is a state of its own (see `turning`).

    processes, warming_bias : whether first-order processes, and biases that grow with the
    temperature, are part of it: those who have them exactly leave them out. turning_with_plate :
    whether what follows a horizontal vector that stands still, Earth's rate or the field, is part
    of it as a constant; on a plate that turns it is none, see `like_north`.
    """
    share = float(turning_with_plate)
    felt = {
        kind: share * _horizontal(size) + _down(vertical)
        for kind, (size, vertical) in _standing(imu, when).items()
    }
    felt[FORCE] = _down(when.gravity)
    return _drift(imu, imu.gyro, when, felt, _LEAST[0], processes, warming_bias)


def like_north(imu: ImuModel, when: When, angle: np.ndarray) -> np.ndarray:
    """Variance of what gyros' errors add to Earth's horizontal rate in level axes that stand still,
    each component, (W,), (rad/s)^2. angle : (W, n), rad, the plate's.

    Of c v, v a horizontal vector of size v in the body, (c_xx + c_yy)/2 and (c_yx - c_xy)/2 scale
    and turn v, and so mimic north under every schedule about the vertical axis; what else there
    is, of the same size, turns by twice the plate's angle, and is as north where that has no
    effect, at a half turn.
    """
    again = np.abs(np.exp(2j * angle).mean(axis=1)) ** 2  # whether twice the angle comes to naught
    middle = imu.warming.rise_at(when.start_s + when.duration_s / 2) ** 2
    standing = _standing(imu, when)
    total = np.zeros(len(angle))
    for error in imu.gyro.drawn:
        if error.follows in standing:
            size = np.square(error.sigma[:2, :2]).sum() / 8 * (middle if error.warms else 1.0)
            total += size * (1 + again) * standing[error.follows][0] ** 2
    return total


def _standing(imu: ImuModel, when: When) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What stands still on Earth and gyros' errors follow, by kind: size of its horizontal part,
    and its vertical part where that makes a constant; (W,) each."""
    north, east, down = imu.field_ned
    one = np.ones(len(when.latitude))
    rate = EARTH_RATE * np.cos(when.latitude)
    return {TRUTH: (rate, 0 * one), FIELD: (np.hypot(north, east) * one, down * one)}


def _horizontal(size: np.ndarray) -> np.ndarray:
    """Mean square of a horizontal vector of this size along each axis of a level body that may look
    anywhere, (W, 3)."""
    return np.stack([size**2 / 2, size**2 / 2, 0 * size], axis=1)


def of_accel(imu: ImuModel, when: When, processes: bool = True) -> Drift:
    """The accelerometers' drift; processes : as of the gyros."""
    down = _down(when.gravity)
    return _drift(imu, imu.accel, when, {TRUTH: down, FORCE: down}, _LEAST[1], processes, True)


def _down(gravity: np.ndarray) -> np.ndarray:
    """Mean square of the specific force along each axis of a level body, (W, 3)."""
    none = np.zeros_like(gravity)
    return np.stack([none, none, gravity**2], axis=1)


def turning(imu: ImuModel, when: When) -> tuple[np.ndarray, np.ndarray]:
    """What each gyro makes of a rate about z, by that rate: misalignment, and z's scale factor.
    Their variance at each window's start, (W, 3), and what each second adds to it as they warm."""
    steady, by_kelvin = (imu.gyro.variance(TRUTH, warms)[:, 2] for warms in (False, True))
    warm, warmer = (imu.warming.rise_at(when.start_s + t) for t in (0.0, when.duration_s))
    walk = np.outer((warmer - warm) ** 2 / when.duration_s, by_kelvin)
    return steady + np.outer(warm**2, by_kelvin), walk


def _drift(
    imu: ImuModel,
    triad: Triad,
    when: When,
    felt: dict[str, np.ndarray],
    least: float,
    processes: bool,
    warming_bias: bool,
) -> Drift:
    """felt : mean square of what errors that are drawn once follow, (W, 3)."""
    white, angle, wander, time = (np.zeros(3) for _ in range(4))
    start, end = when.start_s, when.start_s + when.duration_s
    none = np.zeros((len(start), 3))
    felt = {ONE: none + 1, FIELD: none, **felt}
    constant, walk = np.zeros((len(start), 3)), np.zeros((len(start), 3))
    warm, warmer = (imu.warming.rise_at(at) for at in (start, end))
    for error in triad.drawn:
        own = felt[error.follows] @ np.square(error.sigma).T
        if not error.warms:
            constant += own
        elif warming_bias or error.follows != ONE:
            constant += warm[:, None] ** 2 * own
            walk += (warmer - warm)[:, None] ** 2 / when.duration_s * own
    for axis in range(3):
        between: list[tuple[float, float]] = []
        for term in triad.in_run(axis, imu.dt):
            own = term.reduced(start, when.duration_s)
            white[axis] += own.white
            angle[axis] += own.angle
            constant[:, axis] += own.constant
            walk[:, axis] += own.walk
            for s, T in term.processes if processes else ():
                if when.duration_s * _SHORT > T:
                    white[axis] += 2 * s * T
                elif when.duration_s * _LONG < T:
                    constant[:, axis] += s
                    walk[:, axis] += 2 * s / T
                else:
                    between.append((s, T))
        if between:
            s, T = np.transpose(between)
            wander[axis], time[axis] = s.sum(), np.exp(s @ np.log(T) / s.sum())
    return Drift(white + least**2, angle, constant, walk, wander, np.where(time > 0, time, 1.0))
