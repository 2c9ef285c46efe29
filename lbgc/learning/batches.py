"""Sources of training examples: stored recordings, augmented, or recordings drawn afresh."""

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
"""Number of recordings whose windows are prepared together."""


class Examples(Protocol):
    """What training draws its batches from."""

    @property
    def fresh(self) -> "Examples | None":
        """Examples that are never trained on, of the law of what is evaluated; None where there are
        none."""

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> tuple[np.ndarray, ...]:
        """`count` windows of `steps` steps of the network: features, (W, T, C) float32, and the
        angles that the network is to find, (W,), rad."""


@dataclass(frozen=True)
class Sensed:
    """How windows become a network's features: its model, its rate and its base's sensor."""

    model: ModelConfig
    rate_hz: float
    """Hz, of the network's steps"""
    imu: ImuModel
    """The sensor whose noise weights the network's base"""

    def examples(self, labelled: Labelled) -> tuple[np.ndarray, np.ndarray]:
        """Features, (W, T, C), and the angles to be found, (W,), rad: the reference, since training
        may not know the truth, less the base's heading."""
        x, base = inputs(self.model, labelled.windows, self.rate_hz, self.imu)
        off = labelled.heading_reference - base
        return x, off if self.model.base is None else wrap(off)


@dataclass(frozen=True)
class Drawn:
    """Examples whose windows are drawn from a source anew each time."""

    source: "Source"
    sensed: Sensed

    @property
    def fresh(self) -> "Drawn | None":
        """Examples from the source's fresh windows, or None where it has none."""
        return None if self.source.fresh is None else Drawn(self.source.fresh, self.sensed)

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> tuple[np.ndarray, ...]:
        """`count` windows of `steps` steps from the source: features and the angles to be found."""
        return self.sensed.examples(self.source.draw(rng, count, steps))


@dataclass(frozen=True)
class Prepared:
    """Examples that are computed once and kept, because their features take long to compute."""

    examples: dict[int, tuple[np.ndarray, ...]]
    """Features, and the angles to be found, of all windows, by their number of steps."""
    fresh: None = None
    """There are no fresh examples."""

    @classmethod
    def of(cls, sensed: Sensed, recordings: Labelled, lengths: Iterable[int]) -> "Prepared":
        """Examples of all windows of these lengths, in steps, that overlap by half."""
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
        """`count` windows of `steps` steps, picked at random with repetition."""
        x, off = self.examples[steps]
        pick = rng.integers(len(x), size=count)
        return x[pick], off[pick]


class Source(Protocol):
    """What labelled windows are drawn from."""

    @property
    def fresh(self) -> "Source | None":
        """A source of windows that are never trained on, of the law of what is evaluated; None
        where there is none."""

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Labelled:
        """`count` windows of `steps` samples, each from its own recording and offset."""


@dataclass(frozen=True)
class Stored:
    """Windows of recordings in memory, each copy varied by `augment` and `mix`."""

    recordings: Labelled
    units: np.ndarray
    """(R,), number of each recording's unit: only recordings of one unit are mixed."""
    config: AugmentConfig
    gyro: Triad
    fresh: None = None
    """There are no fresh windows."""

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Labelled:
        """`count` windows of `steps` samples from random recordings and offsets, augmented. A
        window is mixed where its unit has three recordings or more."""
        rows = rng.integers(len(self.recordings), size=count)
        latest = self.recordings.windows.gyro.shape[1] - steps
        starts = rng.integers(latest + 1, size=len(rows))
        drawn = crop(self.recordings, rows, starts, steps)
        if self.config.mix:
            others = [
                crop(self.recordings, r, starts, steps) for r in self._others_of_unit(rng, rows)
            ]
            alone = np.bincount(self.units)[self.units[rows]] < MIXED
            mixed, own = mix([drawn, *others], rng), drawn.windows
            windows = replace(
                own,
                gyro=np.where(alone[:, None, None], own.gyro, mixed.gyro),
                accel=np.where(alone[:, None, None], own.accel, mixed.accel),
            )
            drawn = replace(drawn, windows=windows)
        return augment(self.config, drawn, self.gyro, rng)

    def _others_of_unit(self, rng: np.random.Generator, rows: np.ndarray) -> list[np.ndarray]:
        """Two other recordings of each row's unit, (W,) twice; the row itself where its unit has no
        two others."""
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
        """The recordings ordered by unit, and each recording's place within its unit, (R,) each."""
        order = np.argsort(self.units, kind="stable")
        sizes = np.bincount(self.units)
        place = np.empty(len(order), int)
        place[order] = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        return order, place


def crop(recordings: Labelled, rows: np.ndarray, starts: np.ndarray, steps: int) -> Labelled:
    """One window of `steps` samples from each of these rows, beginning at these samples."""
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
    """All consecutive windows of `steps` samples of all recordings, each beginning 1/overlap of a
    window after the one before."""
    n, hop = recordings.windows.gyro.shape[1], max(1, steps // overlap)
    starts = np.arange(0, n - steps + 1, hop)
    rows = np.repeat(np.arange(len(recordings)), len(starts))
    return crop(recordings, rows, np.tile(starts, len(recordings)), steps)
