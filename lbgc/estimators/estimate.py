"""What every north-finder answers, and how it is called."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from lbgc.data.windows import Windows
from lbgc.errors import InputError
from lbgc.sensor.imu import ImuModel


@dataclass(frozen=True)
class Estimate:
    """What an estimator answers to W windows."""

    heading: np.ndarray
    """(W,), rad in (-pi, pi], when the encoder reads zero"""
    sigma: np.ndarray
    """(W,), rad, the heading's standard deviation as the estimator itself states it; NaN where it
    cannot say"""
    at_least: bool = False
    """Whether sigma is a lower bound: it knows what a window's own scatter shows, and no more of
    the sensor. A bias shows in no window."""


Estimator: TypeAlias = Callable[[Windows, ImuModel | None], Estimate]
"""Windows and, where it is known, what their sensor is like. Each window is answered from its own
row alone. Raises InputError where the windows are none that it can answer."""


def refusal(name: str, value: object, unit: str, why: str) -> InputError:
    """What an estimator raises at windows that it cannot answer."""
    return InputError(f"estimator '{name}'", value, unit, why)
