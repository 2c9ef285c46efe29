"""The error model of a filter of few states: each axis's errors as a constant that walks, one
first-order Gauss-Markov process, and white noise.

Flicker is a sum of Gauss-Markov processes (lbgc.sensor.noise.Flicker). In a window of length T, a
process whose correlation time T_i is below T/10 counts as white noise, one above 2 T as a constant
that walks (both by their limits: density 2 s T_i, walk 2 s/T_i, s the variance); those between
become one process. For two rests by turns, or one, the variance that follows is within 5% of the
exact law's up to a quarter of an hour, for sdc500's flicker and walk.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, normal_gravities
from lbgc.frames import DOWN, across
from lbgc.sensor.errors import FIELD, FORCE, ONE, TRUTH
from lbgc.sensor.imu import ImuModel, Triad

_SHORT, _LONG = 0.1, 2.0
_LEAST = (1e-8, 1e-6)
"""rad/sqrt(s) and m/s/sqrt(s), white noise far below any sensor's: without any noise, rounding
errors spoil the filter's covariance."""


@dataclass(frozen=True)
class Drift:
    """Reduced model of a triad's errors in W windows, in SI units; (3,) each but where stated."""

    white: np.ndarray
    """Density N^2 of the white noise"""
    angle: np.ndarray
    """Variance of an error of the integral (angle or velocity) that does not accumulate"""
    constant: np.ndarray
    """Variance of the constant at each window's start, (W, 3)"""
    walk: np.ndarray
    """K^2 of its random walk, (W, 3)"""
    wander: np.ndarray
    """Variance of the Gauss-Markov process"""
    time: np.ndarray
    """s, correlation time of the Gauss-Markov process"""


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
    axis: int = DOWN
    """The body's axis about which the plate turns"""

    @property
    def about_level(self) -> bool:
        """Whether the plate turns about a level axis."""
        return self.axis != DOWN

    @classmethod
    def of(cls, windows: Windows) -> "When":
        """The times and places of these windows, gravity being the normal one there."""
        gravity = normal_gravities(windows.latitude)
        return cls(windows.duration_s, windows.start_s, windows.latitude, gravity, windows.axis)


def of_gyro(
    imu: ImuModel,
    when: When,
    processes: bool = True,
    warming_bias: bool = True,
    at_rest: bool = True,
) -> Drift:
    """The gyros' reduced model. It leaves out each gyro's error by the plate's rate, which is a
    state of its own (see `turning`), and about a level axis what turns with the plate (see
    `turned_with_plate`).

    processes, warming_bias : whether first-order processes, and biases that grow with the
    temperature, are part of it. Callers that model these exactly leave them out. at_rest : whether
    the errors that follow a horizontal vector which stands still, Earth's rate or the magnetic
    field, are part of it as a constant; on a plate that turns they are none, see `like_north`.
    """
    share = float(at_rest)
    felt = {
        kind: share * _horizontal(size) + _mean_square_down(vertical)
        for kind, (size, vertical) in _standing(imu, when).items()
    }
    felt[FORCE] = _mean_square_down(when.gravity)
    if when.about_level:
        felt = _along_axis(imu, when)
    return _drift(imu, imu.gyro, when, felt, _LEAST[0], processes, warming_bias)


def like_north(imu: ImuModel, when: When, angle: np.ndarray) -> np.ndarray:
    """Variance of the error that looks like Earth's horizontal rate, since it stands still in level
    axes while the plate turns: of each component, (W,), (rad/s)^2. angle : (W, n), rad, the
    plate's.

    An error c v follows a horizontal vector v that stands still on Earth. Its parts
    (c_xx + c_yy)/2 and (c_yx - c_xy)/2 scale and turn v, and so mimic north under every schedule
    about the vertical axis. The other two turn by twice the plate's angle in level axes, and mimic
    north in so far as the mean of exp(2i angle) is not zero: wholly at rest and by half turns.
    """
    again = np.abs(np.exp(2j * angle).mean(axis=1)) ** 2
    middle = imu.warming.rise_at(when.start_s + when.duration_s / 2) ** 2
    standing = _standing(imu, when)
    total = np.zeros(len(angle))
    for error in imu.gyro.drawn:
        if error.follows in standing:
            size = np.square(error.sigma[:2, :2]).sum() / 8 * (middle if error.warms else 1.0)
            total += size * (1 + again) * standing[error.follows][0] ** 2
    return total


def _standing(imu: ImuModel, when: When) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The vectors that stand still on Earth and that gyros' errors follow, by kind: the size of the
    horizontal part, and the vertical part where it makes a constant; (W,) each."""
    north, east, down = imu.field_ned
    one = np.ones(len(when.latitude))
    rate = EARTH_RATE * np.cos(when.latitude)
    return {TRUTH: (rate, 0 * one), FIELD: (np.hypot(north, east) * one, down * one)}


def _horizontal(size: np.ndarray) -> np.ndarray:
    """Mean square of a horizontal vector of this size along each axis of a level body that may look
    anywhere, (W, 3)."""
    return np.stack([size**2 / 2, size**2 / 2, 0 * size], axis=1)


def of_accel(imu: ImuModel, when: When, processes: bool = True) -> Drift:
    """The accelerometers' reduced model; processes : as for `of_gyro`."""
    down = _mean_square_down(when.gravity) * (not when.about_level)
    return _drift(imu, imu.accel, when, {TRUTH: down, FORCE: down}, _LEAST[1], processes, True)


def _along_axis(imu: ImuModel, when: When) -> dict[str, np.ndarray]:
    """Mean squares, (W, 3), of the vectors that gyros' errors follow, along a level axis of the
    plate, where they make a constant: by kind."""
    along = np.eye(3)[when.axis]
    found = {k: size[:, None] ** 2 / 2 * along for k, (size, _) in _standing(imu, when).items()}
    return found | {FORCE: np.zeros((len(when.gravity), 3))}


def turned_with_plate(imu: ImuModel, when: When) -> np.ndarray:
    """Variances, (4, W, 3), of the gyros' errors that follow the cosine and the sine of the angle
    of a plate about a level axis, and of the accelerometers': what follows a vector that stands
    still on Earth turns with the plate there."""
    gravity = _mean_square_down(when.gravity)
    down = {TRUTH: EARTH_RATE * np.sin(when.latitude), FIELD: imu.field_ned[2]}
    standing = {
        kind: _horizontal(size) + _mean_square_down(down[kind] + 0 * size)
        for kind, (size, _) in _standing(imu, when).items()
    }
    middle = imu.warming.rise_at(when.start_s + when.duration_s / 2)[:, None] ** 2
    found, (i, j) = np.zeros((4, len(when.gravity), 3)), across(when.axis)
    for first, triad, felt in (
        (0, imu.gyro, standing | {FORCE: gravity}),
        (2, imu.accel, {TRUTH: gravity, FORCE: gravity}),
    ):
        for error in (e for e in triad.drawn if e.follows in felt):
            v, share = felt[error.follows], middle if error.warms else 1.0
            one, other = np.square(error.sigma[:, [i, j]]).T
            # What is felt along i and j is v_i cos + v_j sin, and v_j cos - v_i sin.
            found[first] += share * (np.outer(v[:, i], one) + np.outer(v[:, j], other))
            found[first + 1] += share * (np.outer(v[:, j], one) + np.outer(v[:, i], other))
    return found


def _mean_square_down(size: np.ndarray) -> np.ndarray:
    """Mean square of a vertical vector of this size along each axis of a level body, (W, 3)."""
    return np.stack([0 * size, 0 * size, size**2], axis=1)


def turning(imu: ImuModel, when: When) -> tuple[np.ndarray, np.ndarray]:
    """Variance of each gyro's error by the plate's rate, that is of misalignment towards its axis
    and of that axis' scale factor: at each window's start, (W, 3), and its increase a second as
    they warm, (W, 3), 1/s."""
    axis = when.axis
    steady, by_kelvin = (imu.gyro.variance(TRUTH, warms)[:, axis] for warms in (False, True))
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
    """The reduced model of one triad.

    felt : (W, 3), mean squares of the rate or force that errors drawn once follow, by its name;
    least : least white noise, the root of a density. Other arguments as for `of_gyro`.
    """
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
