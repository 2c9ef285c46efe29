"""The interface of all estimators of north: how one is called, and what it answers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from lbgc.data.poses import Poses
from lbgc.data.windows import Windows
from lbgc.errors import InputError
from lbgc.frames import AXES, DOWN
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


_AT_ZERO = np.deg2rad(0.01)
"""Angle of a plate, rad, up to which it counts as zero."""
Estimator: TypeAlias = Callable[[Windows, ImuModel | None], Estimate]
"""A function of windows and of their sensor's model, None where that is not known. It answers each
window from its own row alone, and raises InputError at windows that it cannot answer."""


def require_down(name: str, windows: Windows) -> None:
    """Raise InputError for the estimator `name` where a plate is turned about a level axis."""
    if windows.axis != DOWN and np.abs(windows.plate_angle).max(initial=0.0) > _AT_ZERO:
        about = f"that is turned about {AXES[windows.axis]} is none of its: it takes one about "
        raise refusal(name, "a plate", "", f"{about}down; two_position, gls, ekf and floor take it")


class Mode(Protocol):
    """One way to hold the headings of P poses."""

    @property
    def heading(self) -> np.ndarray:
        """(P,), rad"""

    @property
    def weight(self) -> float:
        """Its share of the probability."""


class FromPoses(Protocol):
    """An answer to P poses of one IMU, which has errors in common to all."""

    @property
    def heading(self) -> np.ndarray:
        """(P,), rad in (-pi, pi]"""

    @property
    def sigma(self) -> np.ndarray:
        """(P,), rad, standard deviation of each attitude's turn about the vertical."""

    @property
    def attitude(self) -> np.ndarray:
        """(P, 3, 3), C_nb, with these headings"""

    @property
    def modes(self) -> Sequence[Mode]:
        """Ways to hold the headings, the likeliest first."""

    @property
    def latitude(self) -> float | None:
        """rad; None where it was told"""

    @property
    def latitude_interval(self) -> tuple[float, float] | None:
        """rad, 95%"""

    @property
    def notes(self) -> Sequence[str]:
        """Sentences on what cannot be told."""


class TellsPoses(Protocol):
    """An estimator of the headings of poses. It raises InputError where they tell none."""

    def __call__(self, poses: Poses, imu: ImuModel, hemisphere: str = ...) -> FromPoses:
        """hemisphere : either, north or south: where an unknown latitude is."""


def refusal(name: str, value: object, unit: str, why: str) -> InputError:
    """The InputError that an estimator raises at windows that it cannot answer."""
    return InputError(f"estimator '{name}'", value, unit, why)
