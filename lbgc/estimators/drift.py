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

from lbgc.earth import EARTH_RATE
from lbgc.sensor import noise
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


def of_gyro(
    imu: ImuModel, duration_s: float, start_s: np.ndarray, latitude: np.ndarray, gravity: np.ndarray
) -> Drift:
    """start_s, latitude (rad), gravity (m/s^2) : (W,). What z's rate makes in x and y, and its own
    scale error, are no part of it: they turn with the plate's rate, and are states of their own."""
    of_scale = np.square(imu.gyro.scale_unit) + np.square(imu.gyro.misalignment_unit)
    of_north = np.outer(np.square(EARTH_RATE * np.cos(latitude)) / 2, of_scale)
    of_force = np.outer(gravity**2, np.square(imu.gyro.g_sensitivity))
    return _drift(imu, imu.gyro, duration_s, start_s, of_north + of_force, _LEAST[0])


def of_accel(
    imu: ImuModel, duration_s: float, start_s: np.ndarray, gravity: np.ndarray
) -> Drift:  # fmt: skip
    x, y, _ = np.square(imu.accel.misalignment_unit)
    of_gravity = np.outer(gravity**2, (x, y, np.square(imu.accel.scale_unit[2])))
    return _drift(imu, imu.accel, duration_s, start_s, of_gravity, _LEAST[1])


def _drift(
    imu: ImuModel,
    triad: Triad,
    duration_s: float,
    start_s: np.ndarray,
    other: np.ndarray,
    least: float,
) -> Drift:
    white, wander, time = (np.zeros(3) for _ in range(3))
    constant = other + sum(
        np.square(b) for b in (triad.bias_unit, triad.bias_session, triad.bias_run)
    )
    warm, warmer = (rise(imu, start_s + shift) for shift in (0.0, duration_s))
    constant = constant + np.outer(warm**2, np.square(triad.bias_per_k))
    walk = np.outer((warmer - warm) ** 2 / duration_s, np.square(triad.bias_per_k))
    for axis in range(3):
        between: list[tuple[float, float]] = []
        for s, T in _processes(triad, axis):
            if duration_s * _SHORT > T:
                white[axis] += 2 * s * T
            elif duration_s * _LONG < T:
                constant[:, axis] += s
                walk[:, axis] += 2 * s / T
            else:
                between.append((s, T))
        if between:
            s, T = np.transpose(between)
            wander[axis], time[axis] = s.sum(), np.exp(s @ np.log(T) / s.sum())
    K, R = np.square(triad.K), np.square(triad.R)
    constant = constant + np.outer(start_s, K) + np.outer((start_s + duration_s / 2) ** 2, R)
    white += np.square(triad.N) + least**2
    if triad.lsb is not None:
        white += triad.lsb**2 * imu.dt / 12
    angle = of_integral(triad)
    return Drift(
        white, angle, constant, walk + K + R * duration_s, wander, np.where(time > 0, time, 1.0)
    )


def rise(imu: ImuModel, time_s: np.ndarray) -> np.ndarray:
    """Rise of temperature since power-up, K, at times (W,) since the recording's start."""
    since = (imu.warming.since_power_up_s + time_s) / imu.warming.time_s
    return np.asarray(imu.warming.rise_k * -np.expm1(-since))


def _processes(triad: Triad, axis: int) -> list[tuple[float, float]]:
    """Variance and correlation time of every first-order process in an axis."""
    found: list[tuple[float, float]] = []
    for term in triad.terms[axis]:
        if isinstance(term, noise.Flicker):
            found += zip(term.variances().tolist(), term.correlation_times().tolist(), strict=True)
        elif isinstance(term, noise.GaussMarkov):
            found.append((term.sigma**2, term.T))
    return found


def of_integral(triad: Triad) -> np.ndarray:
    """Variance, (3,), of what errs in the integral and does not add up: counting, tones, lines."""
    carried = 0.0 if triad.carried_lsb is None else triad.carried_lsb**2 / 12
    total = np.square(triad.Q) + carried
    for size, hz in (
        (np.array(triad.tone) / np.sqrt(2), triad.tone_hz),
        *((s, f) for s, f, *_ in triad.lines),
    ):
        there = np.array(size) > 0
        total = total + np.square(
            np.where(there, size, 0.0) / np.where(there, 2 * np.pi * np.array(hz), 1.0)
        )
    return total
