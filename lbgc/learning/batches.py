"""Where training windows come from: stored recordings, augmented, or recordings drawn afresh."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from lbgc.data.windows import Windows
from lbgc.learning.augment import MIXED, AugmentConfig, augment, mix
from lbgc.sensor.imu import Triad


class Source(Protocol):
    """What training asks for batches."""

    @property
    def fresh(self) -> "Source | None":
        """A source of windows that are never trained on, of the law that is evaluated on."""

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Windows:
        """So many windows of so many samples, each from its own recording and offset."""


@dataclass(frozen=True)
class Stored:
    """Windows of recordings in memory, each copy varied by `augment` and `mix`."""

    recordings: Windows
    units: np.ndarray
    """(R,), whose sensor each is of: mixed are recordings of one."""
    config: AugmentConfig
    gyro: Triad
    fresh: None = None

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Windows:
        rows = rng.integers(len(self.recordings), size=count)
        latest = self.recordings.gyro.shape[1] - steps
        starts = rng.integers(latest + 1, size=len(rows))
        windows = crop(self.recordings, rows, starts, steps)
        if self.config.mix:
            others = [crop(self.recordings, r, starts, steps) for r in self._mates(rng, rows)]
            alone = np.bincount(self.units)[self.units[rows]] < MIXED
            mixed = mix([windows, *others], rng)
            windows = replace(
                windows,
                gyro=np.where(alone[:, None, None], windows.gyro, mixed.gyro),
                accel=np.where(alone[:, None, None], windows.accel, mixed.accel),
            )
        return augment(self.config, windows, self.gyro, rng)

    def _mates(self, rng: np.random.Generator, rows: np.ndarray) -> list[np.ndarray]:
        """For each row two others of its unit; the row itself where it has no two."""
        order, place = self._order
        sizes = np.bincount(self.units)
        first, size = np.cumsum(sizes) - sizes, sizes[self.units[rows]]
        steps = rng.integers(1, np.maximum(size, 2), size=len(rows))
        more = rng.integers(1, np.maximum(size - 1, 2), size=len(rows))
        found = []
        for step in (steps, more + (more >= steps)):
            at = (place[rows] + step) % np.maximum(size, 1)
            found.append(order[first[self.units[rows]] + at])
        return found

    @cached_property
    def _order(self) -> tuple[np.ndarray, np.ndarray]:
        """Recordings unit by unit, and each one's place within its own."""
        order = np.argsort(self.units, kind="stable")
        sizes = np.bincount(self.units)
        place = np.empty(len(order), int)
        place[order] = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        return order, place


def crop(windows: Windows, rows: np.ndarray, starts: np.ndarray, steps: int) -> Windows:
    """One window of `steps` samples from each of these rows, from these starts on."""
    at = starts[:, None] + np.arange(steps)
    pick = rows[:, None], at
    return Windows(
        windows.gyro[pick],
        windows.accel[pick],
        windows.plate_angle[pick],
        windows.rate_hz,
        windows.latitude[rows],
        windows.heading[rows],
        windows.heading_reference[rows],
        starts / windows.rate_hz,
    )


def every(windows: Windows, steps: int) -> Windows:
    """All consecutive windows of this many samples of all rows."""
    count = windows.gyro.shape[1] // steps
    rows = np.repeat(np.arange(len(windows)), count)
    return crop(windows, rows, np.tile(np.arange(count) * steps, len(windows)), steps)
