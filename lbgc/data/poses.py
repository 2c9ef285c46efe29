"""Poses: an IMU held at rest in several attitudes, which is what a tumble's estimator is given; and
what is known of its headings there."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from lbgc.data.record import Record
from lbgc.data.rests import rests
from lbgc.errors import require
from lbgc.frames import about_vertical, euler_to_matrix, level

SIDES = ("forward", "right", "down", "backward", "left", "up")
"""The body's six directions, by which attitudes are described."""


@dataclass(frozen=True, eq=False)
class Poses:
    """A recording of an IMU that is held at rest in P attitudes, and handled between them."""

    gyro: np.ndarray
    """(T, 3), rad/s, means over the samples' intervals, body axes forward-right-down"""
    accel: np.ndarray
    """(T, 3), m/s^2, specific forces likewise"""
    rate_hz: float
    """Samples a second"""
    latitude: float | None
    """rad; None where it is to be found"""
    rests: tuple[tuple[int, int], ...]
    """First sample of each pose, and the one behind its last"""
    integrated: bool
    """Whether the gyros may tell the turns between poses, from a log that goes on between them"""

    def __len__(self) -> int:
        return len(self.rests)

    @property
    def start_s(self) -> np.ndarray:
        """(P,), s, when each pose begins, since the recording's start."""
        return np.array([first for first, _ in self.rests]) / self.rate_hz

    @property
    def lasts_s(self) -> np.ndarray:
        """(P,), s, how long each pose lasts."""
        return np.array([last - first for first, last in self.rests]) / self.rate_hz

    @property
    def levels(self) -> np.ndarray:
        """The attitude C_nb of each pose at heading zero, by its mean specific force: (P, 3, 3)."""
        force = np.array([self.accel[first:last].mean(axis=0) for first, last in self.rests])
        roll, pitch = level(force)
        return euler_to_matrix(roll, pitch, 0.0)


def poses_of(record: Record, integrated: bool = False, latitude_known: bool = True) -> Poses:
    """The poses of a recording, as they are listed or as they are found.

    integrated : whether the gyros are to tell the turns between poses; latitude_known : whether
    the recording's latitude is told. Raises InputError where there are fewer than two poses.
    """
    about = "was not held in several attitudes: estimator=tumble is for protocol=tumble, and for "
    about += "logs of an IMU that was laid in one after the other"
    require(record.held is not None, "recording", record.name, about)
    found = [(own.samples.start, own.samples.stop) for own in rests(record)]
    about = f"has {len(found)} rests of 3 s or more, and a tumble takes two; log.poses=[[from_s, "
    about += "to_s], ...] lists those of a log"
    require(len(found) > 1, "recording", record.name, about)
    latitude = record.latitude if latitude_known else None
    gyro, accel = record.gyro.astype(float), record.accel.astype(float)
    return Poses(gyro, accel, record.rate_hz, latitude, tuple(found), integrated)


def headings_of(poses: Poses, record: Record, levels: np.ndarray) -> np.ndarray:
    """The heading that is right for each pose, (P,), rad, NaN where it is not known: the reference
    that the user gave, or the truth.

    levels : (P, 3, 3), C_nb at heading zero as an estimator found it. A heading turns what is held
    for level about its own vertical, so the true one is the angle by which the level comes nearest
    to the true attitude. Where the forward axis is near the vertical, that axis's own heading
    differs from it by many times the level's error.
    """
    assert record.held is not None
    if record.held.attitude is None:
        return np.array(record.held.headings or [np.nan] * len(poses))
    each = [euler_to_matrix(*record.held.attitude[slice(*own)].T) for own in poses.rests]
    return about_vertical(np.array([own.mean(axis=0) for own in each]) @ levels.swapaxes(1, 2))


def described(poses: Poses, name: str) -> str:
    """A sentence on the poses: how many, how long, and which directions of the body were down."""
    down = poses.levels[:, 2]
    signed = np.concatenate([down, -down], axis=1)
    sides = Counter(SIDES[int(own)] for own in signed.argmax(axis=1))
    which = ", ".join(f"{side} {sides[side]}" for side in SIDES if sides[side])
    low, high = poses.lasts_s.min(), poses.lasts_s.max()
    lasts = f"{low:.4g}" if high - low < 0.05 else f"{low:.4g} to {high:.4g}"
    return f"{name}: {len(poses)} poses of {lasts} s; what was nearest to down: {which}"
