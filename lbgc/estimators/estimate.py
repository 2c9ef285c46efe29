"""The interface of all estimators of north: how one is called, and what it answers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from lbgc.data.windows import Windows
from lbgc.errors import InputError
from lbgc.sensor.imu import ImuModel


@dataclass(frozen=True)
class Estimate:
    """An estimator's answer to W windows: the headings and their standard deviations."""

    heading: np.ndarray
    """(W,), rad in (-pi, pi], when the encoder reads zero"""
    sigma: np.ndarray
    """(W,), rad, the heading's standard deviation as the estimator itself states it; NaN where it
    cannot say"""
    at_least: bool = False
    """Whether sigma is a lower bound: the estimator knew the scatter within each window and no more
    of the sensor, and no window shows a bias."""


Estimator: TypeAlias = Callable[[Windows, ImuModel | None], Estimate]
"""A function of windows and of their sensor's model, None where that is not known. It answers each
window from its own row alone, and raises InputError at windows that it cannot answer."""


def refusal(name: str, value: object, unit: str, why: str) -> InputError:
    """The InputError that an estimator raises at windows that it cannot answer."""
    return InputError(f"estimator '{name}'", value, unit, why)
