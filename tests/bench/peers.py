"""Public tools doing what they can of the same work: as many samples of six axes."""

from collections.abc import Iterator
from importlib.util import find_spec

import allantools
import numpy as np
from helpers import default_config
from timing import CASES, Work

_CONFIG = default_config(*CASES["options"])
SAMPLES, RATE_HZ = _CONFIG.samples, _CONFIG.rate_hz
_POWER = 2 ** (SAMPLES.bit_length() - 1)
"""The most that a peer makes which takes powers of two alone."""
SHORT = SAMPLES // 72
"""Samples of the peer that takes one at a time."""
_WHITE, _WALK, _FLICKER = 9e-6, 4e-8, 2.6e-7


def available() -> Iterator[tuple[str, str, Work | None, int]]:
    """(key, what it models, one run of it or None where it is not installed, channel samples)."""
    yield "allantools", "Kasdin: white, flicker, random walk", _kasdin, 6 * _POWER
    installed = find_spec("pyins") is not None
    every = 6 * SAMPLES
    yield (
        "python_ins",
        "scale, bias, white, random walk",
        _python_ins() if installed else None,
        every,
    )
    whole = _python_ins_whole() if installed else None
    yield "python_ins_end_to_end", "the same, with its motion", whole, every
    per_sample = _imu_error_model() if find_spec("imu_error_model") else None
    yield "imu_error_model", "white, flicker, random walk", per_sample, 6 * SHORT


def _kasdin() -> None:
    for axis in range(6):
        np.random.seed(axis)  # noqa: NPY002  (the peer draws from numpy's global state)
        rates = []
        for q, b in ((_WHITE, -2), (_FLICKER, -3), (_WALK, -4)):
            noise = allantools.Noise(nr=_POWER, qd=q**2, b=b)
            noise.generateNoise()
            rates.append(np.diff(noise.time_series))
        np.sum(rates, axis=0)


def _python_ins() -> Work:
    import pandas as pd
    from pyins.inertial_sensor import Parameters

    still = pd.DataFrame(
        np.zeros((SAMPLES, 3)), np.arange(SAMPLES) / RATE_HZ, ["gyro_x", "gyro_y", "gyro_z"]
    )

    def work() -> None:
        for seed in (0, 1):
            errors = Parameters(1.001 * np.eye(3), np.full(3, 1e-6), _WHITE, _WALK, rng=seed)
            errors.apply(still, "rate")

    return work


def _python_ins_whole() -> Work:
    from pyins.inertial_sensor import Parameters
    from pyins.sim import generate_imu

    time = np.arange(SAMPLES) / RATE_HZ
    angles = np.column_stack([np.zeros((SAMPLES, 2)), np.minimum(30 * time, 180.0)])
    rest = np.tile([32.76, 35.0, 0.0], (SAMPLES, 1))

    def work() -> None:
        _, imu = generate_imu(time, rest, angles, np.zeros((SAMPLES, 3)), "increment")
        for seed, columns in enumerate((imu.columns[:3], imu.columns[3:])):
            errors = Parameters(1.001 * np.eye(3), np.full(3, 1e-6), _WHITE, _WALK, rng=seed)
            errors.apply(imu[list(columns)], "increment")

    return work


def _imu_error_model() -> Work:
    from imu_error_model import AxisConfig, ImuConfig, ImuModel

    axis = AxisConfig(
        white_noise_density=_WHITE,
        flicker_bias_std=_FLICKER,
        flicker_min_correlation_time=1.0,
        flicker_max_correlation_time=3600.0,
        flicker_components=8,
    )

    def work() -> None:
        model = ImuModel(
            ImuConfig(gyroscope=axis, accelerometer=axis), rng=np.random.default_rng(1)
        )
        for k in range(SHORT + 1):
            model.measure(k / RATE_HZ, np.zeros(3), np.eye(3))

    return work
