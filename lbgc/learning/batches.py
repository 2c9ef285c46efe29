"""Where training windows come from: stored recordings, augmented, or recordings drawn afresh."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lbgc.data.windows import Windows
from lbgc.learning.augment import AugmentConfig, augment
from lbgc.sensor.imu import Triad


class Source(Protocol):
    """What training asks for batches."""

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Windows:
        """So many windows of so many samples, each from its own recording and offset."""


@dataclass(frozen=True)
class Stored:
    """Windows of recordings in memory, each copy varied by `augment`."""

    recordings: Windows
    config: AugmentConfig
    gyro: Triad

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Windows:
        rows = rng.integers(len(self.recordings), size=count)
        latest = self.recordings.gyro.shape[1] - steps
        windows = crop(self.recordings, rows, rng.integers(latest + 1, size=len(rows)), steps)
        return augment(self.config, windows, self.gyro, rng)


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
