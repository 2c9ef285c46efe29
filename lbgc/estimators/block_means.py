"""How a window's parts lie in time and on the plate, and its sensors' means over them.

Whatever asks a window of a bench for its heading sees it so: some hundred block means at rest or in
steady motion, in the body's axes, which turn with the plate; and each slew from rest to rest as
one mean more.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import compress, pairwise
from typing import Any, TypeAlias

import numpy as np

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.estimators.plate import mean_angle, mean_turn, tilt_of, travel_within, usable
from lbgc.frames import turned, unrepeated

MOST_BLOCKS = 240
ENCODER = np.deg2rad(0.01)
"""rad, 1 sigma, of a plate's angle as an encoder tells it."""
_PARTS = ("blocks", "lengths", "angle", "rate", "turned", "squared", "unsure")
_Part: TypeAlias = tuple[int, int, float, float, complex, float, float]
_MOVES = 0.02  # of the fastest
_MANY = 4  # samples of a slew that show its course
_TOLD = np.deg2rad(50.0)
"""Travel of the plate from sample to sample, rad: above it a slew's mean cosine does not follow
from them."""


@dataclass(frozen=True)
class Site:
    """Where a window was taken."""

    latitude: float
    """rad"""
    gravity: float
    """m/s^2"""

    @property
    def north(self) -> float:
        """Earth's horizontal rate, rad/s."""
        return EARTH_RATE * float(np.cos(self.latitude))

    @classmethod
    def at(cls, latitude: float) -> "Site":
        """The site on the ellipsoid at this latitude, rad."""
        return cls(latitude, normal_gravity(latitude))

    @property
    def down(self) -> float:
        """Earth's rate about the down axis, rad/s."""
        return -EARTH_RATE * float(np.sin(self.latitude))


@dataclass(frozen=True)
class Course:
    """Where n parts of one window lie: blocks, and slews that take several. Hashable, so that what
    follows from it is worked out once for all windows that are alike."""

    interval: float
    """s, of a block"""
    start: int
    """blocks between the recording's start and the window's"""
    blocks: tuple[int, ...]
    """which of the window's blocks each part begins with, (n,)"""
    lengths: tuple[int, ...]
    """how many blocks each takes, (n,): one, but for slews"""
    angle: tuple[float, ...]
    """(n,), rad, the plate's, mean over the part"""
    rate: tuple[float, ...]
    """(n,), rad/s, the plate's, likewise; zero at rest"""
    turned: tuple[complex, ...]
    """(n,), mean of exp(i plate's angle) over the part"""
    squared: tuple[float, ...]
    """(n,), (rad/s)^2, mean of the rate's square"""
    unsure: tuple[float, ...]
    """(n,), 1 sigma of `turned`: of slews, which are told by so many samples; zero else"""

    @property
    def c(self) -> np.ndarray:
        """Mean of cos(plate angle) over each part, (n,)."""
        return np.array(self.turned, complex).real

    @property
    def s(self) -> np.ndarray:
        return np.array(self.turned, complex).imag

    @property
    def slewing(self) -> np.ndarray:
        """Which parts are slews, bool (n,)."""
        return np.array(self.unsure) > 0

    @property
    def resting(self) -> np.ndarray:
        return np.asarray((np.array(self.rate) == 0.0) & ~self.slewing)

    @property
    def count(self) -> int:
        """Blocks from the window's start to the last part's end."""
        return self.blocks[-1] + self.lengths[-1]

    def averaged(self) -> np.ndarray:
        """What makes the parts' means of the blocks', (n, count)."""
        matrix = np.zeros((len(self.blocks), self.count))
        for row, first, length in zip(matrix, self.blocks, self.lengths, strict=True):
            row[first : first + length] = 1 / length
        return matrix

    def encoder_errors(self) -> np.ndarray:
        """What an error of the plate's angle in each block makes of the parts' rates, (n, count
        + 2), 1/s, with a block more at either end; nothing at rest, where the rate is known."""
        matrix = np.zeros((len(self.blocks), self.count + 2))
        resting = self.resting
        for k, (first, length) in enumerate(zip(self.blocks, self.lengths, strict=True)):
            if not resting[k]:
                over = (length if length > 1 else 2) * self.interval
                matrix[k, first + length + 1], matrix[k, first] = 1 / over, -1 / over
        return matrix

    def only(self, which: np.ndarray) -> "Course":
        """The part of it where `which`, bool (n,), is true."""
        every = zip(*(getattr(self, name) for name in _PARTS), strict=True)
        return Course(self.interval, self.start, *_columns(compress(every, which)))

    @classmethod
    def planned(
        cls,
        angle: np.ndarray,
        interval: float,
        start_s: float = 0.0,
        size: int = 1,
        settling: np.ndarray | None = None,
    ) -> "Course":
        """The course by means of the plate's angle over samples, (n size,), rad, unwrapped.

        interval : s, of a block of `size` samples; settling : bool (n,), blocks in which the plate
        is not at rest yet although its angle does not show it.

        Left out are blocks in which the plate speeds up or slows down, if they are not between two
        rests: those together are a slew, in which the plate has travelled what lies between the
        rests. Where samples are so long that its course does not show, a slew is left out, too.
        """
        of_blocks = angle.reshape(-1, size).mean(axis=1)
        used, resting = usable(of_blocks)
        used = used | resting  # those before and after a long slew tell most of a bias
        rate = travel_within(of_blocks) / interval
        if settling is not None:
            used = used & ~settling
        turned = mean_turn(of_blocks, rate * interval)
        single = ((int(k), 1, of_blocks[k], rate[k], turned[k]) for k in np.flatnonzero(used))
        parts = [
            (k, n, float(at), float(w), complex(mean), float(w**2), 0.0)
            for k, n, at, w, mean in single
        ]
        edges = np.flatnonzero(np.diff(used.astype(int)))
        for before, last in pairwise(edges):
            if used[before] and resting[before] and resting[last + 1]:
                parts += _slew(angle, of_blocks, size, interval, int(before), int(last))
        parts.sort(key=lambda part: part[0])
        return cls(interval, round(start_s / interval), *_columns(parts))


def _slew(
    angle: np.ndarray, of_blocks: np.ndarray, size: int, interval: float, before: int, last: int
) -> list[_Part]:
    """The slew between the rests of blocks `before` and `last` + 1, as one part, or none where its
    samples are too few to tell it."""
    length = last - before
    samples = angle[(before + 1) * size : (last + 1) * size]
    around = angle[(before + 1) * size - 1 : (last + 1) * size + 1]
    travel = (around[2:] - around[:-2]) / 2
    moving = int(np.sum(np.abs(travel) > _MOVES * np.abs(travel).max()))
    if moving < 2 or np.abs(np.diff(around)).max() > _TOLD:
        return []
    turned = np.mean(mean_turn(samples, travel))
    rate = (of_blocks[last + 1] - of_blocks[before]) / (length * interval)
    squared = np.mean((travel * size / interval) ** 2)
    # what a steady rate within each sample does to it; or a jump, where few samples tell them apart
    unsure = np.mean(travel**2) / (24 if moving >= _MANY else 2)
    return [(before + 1, length, float(samples.mean()), float(rate), complex(turned),
             float(squared), float(unsure))]  # fmt: skip


def _columns(parts: Iterable[_Part]) -> tuple[tuple[Any, ...], ...]:
    return tuple(zip(*parts, strict=True)) or ((),) * len(_PARTS)


@dataclass(frozen=True)
class Levelled:
    """Windows that share a course and a latitude."""

    course: Course
    site: Site
    rows: np.ndarray
    """which windows these are, (V,)"""
    body: np.ndarray
    """(V, 6, n): rate, rad/s, and specific force, m/s^2, forward, right and down in the body's
    axes; the plate's own rate taken off"""
    base: np.ndarray
    """(V, 3, 3), from the base's axes to level ones, as the accelerometers have it"""

    @property
    def tilt(self) -> np.ndarray:
        """(V,), rad, of the base"""
        return np.asarray(np.arccos(np.clip(self.base[:, 2, 2], -1, 1)))

    @property
    def data(self) -> np.ndarray:
        """(V, 4, n): forward and right rate, rad/s, forward and right specific force, m/s^2, in
        level axes that turn with the plate."""
        at = np.array(self.course.angle)[None]
        both = (np.moveaxis(self.body[:, rows], 1, -1) for rows in (slice(3), slice(3, 6)))
        return np.concatenate([_turned_level(v, at, self.base) for v in both], axis=1)

    def only(self, which: np.ndarray) -> "Levelled":
        """The parts where `which`, bool (n,), is true."""
        return replace(self, course=self.course.only(which), body=self.body[:, :, which])

    def some(self, which: np.ndarray) -> "Levelled":
        """Some of the windows, bool (V,)."""
        return replace(self, rows=self.rows[which], body=self.body[which], base=self.base[which])


def levelled(
    windows: Windows, sample_s: float | None = None, timeless: bool = False
) -> list[Levelled]:
    """The windows by course and latitude. sample_s : the sensor's own interval, where the windows
    hold means; timeless : whether it makes no difference when in its recording a window starts.

    The base's tilt is found by its mean specific force in the base's axes; what that leaves is
    small, and linear models (lbgc.estimators.information) have it. What is left over behind the
    last whole block is cut.
    """
    size = block_size(windows.gyro.shape[1])
    w, n = len(windows), windows.gyro.shape[1] // size

    def mean(values: np.ndarray) -> np.ndarray:
        blocks = values[:, : n * size].reshape(w, n, size, *values.shape[2:])
        return blocks[:, :, 0].astype(float) if size == 1 else blocks.mean(axis=2, dtype=float)

    samples = mean_angle(windows.plate_angle, windows.rate_hz, sample_s)[:, : n * size]
    angle = mean(samples)
    gyro, accel = mean(windows.gyro), mean(windows.accel)
    interval = size / windows.rate_hz
    base = tilt_of(unrepeated(angle), accel)
    body = np.concatenate([gyro, accel], axis=-1)
    start = windows.start_s * (not timeless)
    alike = np.column_stack([start, windows.latitude, angle.round(9)]) + 0.0  # no -0.0
    own: dict[bytes, list[int]] = {}
    for number, row in enumerate(alike):
        own.setdefault(row.tobytes(), []).append(number)
    groups: dict[tuple[Course, float], list[int]] = {}
    for rows in own.values():
        start_s, latitude = alike[rows[0], :2].tolist()
        course = Course.planned(samples[rows[0]].round(9), interval, start_s, size)
        groups.setdefault((course, latitude), []).extend(rows)
    return [
        Levelled(c, Site.at(latitude), np.array(rows), _parts(body[rows], c), base[rows])
        for (c, latitude), rows in groups.items()
    ]


def _parts(body: np.ndarray, course: Course) -> np.ndarray:
    """The parts' means, (V, 6, n), of the blocks' (V, blocks, 6)."""
    found = body[:, list(course.blocks)]
    for k in np.flatnonzero(course.slewing):
        first = course.blocks[k]
        found[:, k] = body[:, first : first + course.lengths[k]].mean(axis=1)
    found[..., 2] -= course.rate
    return np.moveaxis(found, 1, 2)


def block_size(samples: int) -> int:
    """Samples of a block: the fewest that make at most 240 blocks of the window; a few more where
    those divide it."""
    least = -(-samples // MOST_BLOCKS)
    whole = (k for k in range(least, least + least // 4 + 1) if samples % k == 0)
    return next(whole, least)


def _turned_level(values: np.ndarray, angle: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """The horizontal part in level axes that turn with the plate: (W, n, 3) -> (W, 2, n)."""
    level_axes = turned(values, angle) @ np.swapaxes(tilt, 1, 2)
    return np.moveaxis(turned(level_axes[..., :2], -angle), -1, 1)
