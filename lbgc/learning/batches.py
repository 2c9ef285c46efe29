"""Where training examples come from: stored recordings, augmented, or recordings drawn afresh."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from tqdm import tqdm

from lbgc.data.windows import Labelled, Windows
from lbgc.frames import wrap
from lbgc.learning.augment import MIXED, AugmentConfig, augment, mix
from lbgc.learning.model import ModelConfig
from lbgc.learning.residual import inputs
from lbgc.sensor.imu import ImuModel, Triad

_AT_ONCE = 5
"""Recordings whose windows are prepared together"""


class Examples(Protocol):
    """What training asks for batches."""

    @property
    def fresh(self) -> "Examples | None":
        """Examples of what is never trained on, of the law that is evaluated on."""

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> tuple[np.ndarray, ...]:
        """So many windows of so many steps of the network: features, (W, T, C) float32, and what is
        to be found, (W,), rad."""


@dataclass(frozen=True)
class Sensed:
    """Through which eyes a network sees windows."""

    model: ModelConfig
    rate_hz: float
    """Hz, of the network's steps"""
    imu: ImuModel
    """The sensor by which the network's base weighs"""

    def examples(self, labelled: Labelled) -> tuple[np.ndarray, np.ndarray]:
        """Features, and the reference, all that training may know, less the base's heading."""
        x, base = inputs(self.model, labelled.windows, self.rate_hz, self.imu)
        off = labelled.heading_reference - base
        return x, off if self.model.base is None else wrap(off)


@dataclass(frozen=True)
class Drawn:
    """Features of windows that are drawn anew each time."""

    source: "Source"
    sensed: Sensed

    @property
    def fresh(self) -> "Drawn | None":
        return None if self.source.fresh is None else Drawn(self.source.fresh, self.sensed)

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> tuple[np.ndarray, ...]:
        return self.sensed.examples(self.source.draw(rng, count, steps))


@dataclass(frozen=True)
class Prepared:
    """Windows of recordings whose features take too long to be made more than once."""

    examples: dict[int, tuple[np.ndarray, ...]]
    """Features, and what is to be found, of all windows, by their number of steps."""
    fresh: None = None

    @classmethod
    def of(cls, sensed: Sensed, recordings: Labelled, lengths: Iterable[int]) -> "Prepared":
        """Windows that overlap by half."""
        block = round(recordings.windows.rate_hz / sensed.rate_hz)
        parts: dict[int, list] = {steps: [] for steps in lengths}
        with tqdm(total=len(recordings), desc="integrating", leave=False, unit="rec") as bar:
            for first in range(0, len(recordings), _AT_ONCE):
                own = recordings.rows(slice(first, first + _AT_ONCE))
                for steps, found in parts.items():
                    found.append(sensed.examples(every(own, steps * block, overlap=2)))
                bar.update(len(own))
        return cls({n: tuple(map(np.concatenate, zip(*p, strict=True))) for n, p in parts.items()})

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> tuple[np.ndarray, ...]:
        x, off = self.examples[steps]
        pick = rng.integers(len(x), size=count)
        return x[pick], off[pick]


class Source(Protocol):
    """Where windows come from."""

    @property
    def fresh(self) -> "Source | None":
        """A source of windows that are never trained on, of the law that is evaluated on."""

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Labelled:
        """So many windows of so many samples, each from its own recording and offset."""


@dataclass(frozen=True)
class Stored:
    """Windows of recordings in memory, each copy varied by `augment` and `mix`."""

    recordings: Labelled
    units: np.ndarray
    """(R,), whose sensor each is of: mixed are recordings of one."""
    config: AugmentConfig
    gyro: Triad
    fresh: None = None

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Labelled:
        rows = rng.integers(len(self.recordings), size=count)
        latest = self.recordings.windows.gyro.shape[1] - steps
        starts = rng.integers(latest + 1, size=len(rows))
        drawn = crop(self.recordings, rows, starts, steps)
        if self.config.mix:
            others = [crop(self.recordings, r, starts, steps) for r in self._mates(rng, rows)]
            alone = np.bincount(self.units)[self.units[rows]] < MIXED
            mixed, own = mix([drawn, *others], rng), drawn.windows
            windows = replace(
                own,
                gyro=np.where(alone[:, None, None], own.gyro, mixed.gyro),
                accel=np.where(alone[:, None, None], own.accel, mixed.accel),
            )
            drawn = replace(drawn, windows=windows)
        return augment(self.config, drawn, self.gyro, rng)

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


def crop(recordings: Labelled, rows: np.ndarray, starts: np.ndarray, steps: int) -> Labelled:
    """One window of `steps` samples from each of these rows, from these starts on."""
    whole = recordings.windows
    pick = rows[:, None], starts[:, None] + np.arange(steps)
    windows = Windows(
        gyro=whole.gyro[pick],
        accel=whole.accel[pick],
        plate_angle=whole.plate_angle[pick],
        rate_hz=whole.rate_hz,
        latitude=whole.latitude[rows],
        start_s=starts / whole.rate_hz,
    )
    return Labelled(
        windows=windows,
        heading=recordings.heading[rows],
        heading_reference=recordings.heading_reference[rows],
    )


def every(recordings: Labelled, steps: int, overlap: int = 1) -> Labelled:
    """All consecutive windows of this many samples of all rows, so many times each sample."""
    n, hop = recordings.windows.gyro.shape[1], max(1, steps // overlap)
    starts = np.arange(0, n - steps + 1, hop)
    rows = np.repeat(np.arange(len(recordings)), len(starts))
    return crop(recordings, rows, np.tile(starts, len(recordings)), steps)
