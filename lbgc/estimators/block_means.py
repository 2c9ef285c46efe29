"""The parts into which a window on a turntable is cut, and the sensors' means over them.

An estimator for the bench sees a window as up to 240 block means at rest or in steady motion, in
the body's axes, which turn with the plate; each slew from rest to rest is one further mean.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import compress, pairwise
from typing import Any, TypeAlias

import numpy as np

from lbgc.data.record import mean_along
from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.estimators.plate import mean_angle, mean_turn, tilt_of, travel_within, usable
from lbgc.frames import DOWN, turned, unrepeated

MOST_BLOCKS = 240
"""Largest number of blocks into which a window is cut."""
ENCODER = np.deg2rad(0.01)
"""Standard deviation of the plate's angle as the encoder reads it, rad."""
_PARTS = ("blocks", "lengths", "angle", "rate", "turned", "squared", "unsure")
_Part: TypeAlias = tuple[int, int, float, float, complex, float, float]
_MOVES = 0.02  # a sample of a slew counts as moving above this share of the largest travel
_MANY = 4  # moving samples, from which on they show how a slew proceeds in time
_TOLD = np.deg2rad(50.0)
"""Largest travel of the plate from sample to sample, rad, at which the mean cosine over a slew
still follows from its samples."""


@dataclass(frozen=True)
class Site:
    """The place where a window was taken: its latitude and its normal gravity."""

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
    """The n parts of one window: single blocks, and slews, each of which takes several blocks.

    It is hashable, so that what follows from it is computed once for all windows that share it.
    """

    interval: float
    """s, duration of a block"""
    start: int
    """Number of blocks between the recording's start and the window's"""
    blocks: tuple[int, ...]
    """(n,), number within the window of the first block of each part"""
    lengths: tuple[int, ...]
    """(n,), number of blocks in each part: one, but for slews"""
    angle: tuple[float, ...]
    """(n,), rad, mean angle of the plate over each part"""
    rate: tuple[float, ...]
    """(n,), rad/s, mean rate of the plate over each part; zero at rest"""
    turned: tuple[complex, ...]
    """(n,), mean of exp(i plate's angle) over each part"""
    squared: tuple[float, ...]
    """(n,), (rad/s)^2, mean square of the plate's rate over each part"""
    unsure: tuple[float, ...]
    """(n,), 1 sigma of `turned`: of slews, of which only samples are known; zero elsewhere"""
    axis: int = DOWN
    """The body's axis about which the plate turns"""

    @property
    def c(self) -> np.ndarray:
        """Mean of cos(plate angle) over each part, (n,)."""
        return np.array(self.turned, complex).real

    @property
    def s(self) -> np.ndarray:
        """Mean of sin(plate angle) over each part, (n,)."""
        return np.array(self.turned, complex).imag

    @property
    def slewing(self) -> np.ndarray:
        """Which parts are slews, bool (n,)."""
        return np.array(self.unsure) > 0

    @property
    def resting(self) -> np.ndarray:
        """In which parts the plate rests, bool (n,)."""
        return np.asarray((np.array(self.rate) == 0.0) & ~self.slewing)

    @property
    def count(self) -> int:
        """Number of blocks from the window's start to the last part's end."""
        return self.blocks[-1] + self.lengths[-1]

    def averaged(self) -> np.ndarray:
        """Matrix (n, count) that averages the blocks' means to the parts' means."""
        matrix = np.zeros((len(self.blocks), self.count))
        for row, first, length in zip(matrix, self.blocks, self.lengths, strict=True):
            row[first : first + length] = 1 / length
        return matrix

    def encoder_errors(self) -> np.ndarray:
        """Matrix (n, count + 2), 1/s, from errors of the plate's angle in each block, one more
        block at either end included, to errors of the parts' rates. Its rows are zero at rest,
        where the rate is known."""
        matrix = np.zeros((len(self.blocks), self.count + 2))
        resting = self.resting
        for k, (first, length) in enumerate(zip(self.blocks, self.lengths, strict=True)):
            if not resting[k]:
                over = (length if length > 1 else 2) * self.interval
                matrix[k, first + length + 1], matrix[k, first] = 1 / over, -1 / over
        return matrix

    def only(self, which: np.ndarray) -> "Course":
        """The course made of those parts alone where `which`, bool (n,), is true."""
        every = zip(*(getattr(self, name) for name in _PARTS), strict=True)
        return replace(self, **_columns(compress(every, which)))

    @classmethod
    def planned(
        cls,
        angle: np.ndarray,
        interval: float,
        start_s: float = 0.0,
        size: int = 1,
        settling: np.ndarray | None = None,
        unrecorded: np.ndarray | None = None,
        axis: int = DOWN,
    ) -> "Course":
        """The course that follows from the plate's mean angle over each sample.

        angle : (n size,), rad, unwrapped; interval : s, of a block of `size` samples; start_s : s,
        the window's start in its recording; settling : bool (n,), blocks in which the plate is not
        at rest yet although its angle does not show it; unrecorded : bool (n,), blocks of which
        samples are missing; axis : about which the plate turns.

        Blocks in which the plate speeds up or slows down are left out, unless they lie between two
        rests. Those together are one slew, in which the plate travels the angle between the rests.
        A slew is left out too if its samples are too long to show how it proceeds.
        """
        of_blocks = angle.reshape(-1, size).mean(axis=1)
        used, resting = usable(of_blocks)
        used = used | resting  # rests before and after a long slew tell most of a bias
        rate = travel_within(of_blocks) / interval
        if settling is not None:
            used = used & ~settling
        none = np.zeros(len(used), bool) if unrecorded is None else unrecorded
        used = used & ~none
        turned = mean_turn(of_blocks, rate * interval)
        single = ((int(k), 1, of_blocks[k], rate[k], turned[k]) for k in np.flatnonzero(used))
        parts = [
            (k, n, float(at), float(w), complex(mean), float(w**2), 0.0)
            for k, n, at, w, mean in single
        ]
        edges = np.flatnonzero(np.diff(used.astype(int)))
        for before, last in pairwise(edges):
            seen = not none[before : last + 2].any()
            if seen and used[before] and resting[before] and resting[last + 1]:
                parts += _slew(angle, of_blocks, size, interval, int(before), int(last))
        parts.sort(key=lambda part: part[0])
        return cls(interval, round(start_s / interval), axis=axis, **_columns(parts))


def _slew(
    angle: np.ndarray, of_blocks: np.ndarray, size: int, interval: float, before: int, last: int
) -> list[_Part]:
    """The slew between the rests that end in block `before` and begin in block `last` + 1, as a
    list of one part; an empty list where its samples are too few to show how it proceeds."""
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
    # The effect on `turned` of an even rate within each sample; or of a jump there, where the
    # samples are too few to tell one from the other.
    unsure = np.mean(travel**2) / (24 if moving >= _MANY else 2)
    return [(before + 1, length, float(samples.mean()), float(rate), complex(turned),
             float(squared), float(unsure))]  # fmt: skip


def _columns(parts: Iterable[_Part]) -> dict[str, Any]:
    """A tuple for each field in _PARTS, from rows of parts; empty ones where there is no part."""
    columns = tuple(zip(*parts, strict=True)) or ((),) * len(_PARTS)
    return dict(zip(_PARTS, columns, strict=True))


@dataclass(frozen=True)
class Levelled:
    """Means over the parts of V windows that share a course and a latitude."""

    course: Course
    site: Site
    rows: np.ndarray
    """(V,), numbers of these windows among all windows"""
    body: np.ndarray
    """(V, 6, n): rate, rad/s, and specific force, m/s^2, forward, right and down in the body's
    axes; the plate's own rate is subtracted"""
    base: np.ndarray
    """(V, 3, 3), rotation from the base's axes to level ones, by the accelerometers"""

    @property
    def tilt(self) -> np.ndarray:
        """Angle between the base's down axis and the vertical, (V,), rad."""
        return np.asarray(np.arccos(np.clip(self.base[:, 2, 2], -1, 1)))

    @property
    def data(self) -> np.ndarray:
        """Means in level axes that turn with a plate about down, (V, 4, n): forward and right rate,
        rad/s, forward and right specific force, m/s^2."""
        at = np.array(self.course.angle)[None]
        both = (np.moveaxis(self.body[:, rows], 1, -1) for rows in (slice(3), slice(3, 6)))
        return np.concatenate([_turned_level(v, at, self.base) for v in both], axis=1)

    def only(self, which: np.ndarray) -> "Levelled":
        """The same windows with those parts alone where `which`, bool (n,), is true."""
        return replace(self, course=self.course.only(which), body=self.body[:, :, which])

    def some(self, which: np.ndarray) -> "Levelled":
        """Those windows alone where `which`, bool (V,), is true."""
        return replace(self, rows=self.rows[which], body=self.body[which], base=self.base[which])


def levelled(
    windows: Windows, sample_s: float | None = None, timeless: bool = False
) -> list[Levelled]:
    """Windows averaged over the parts of their courses, and grouped by course and latitude.

    sample_s : the sensor's own interval, where the windows hold means; timeless : whether it makes
    no difference when in its recording a window starts.

    The base's tilt follows from the mean specific force in the base's axes. The small error that
    this leaves is an unknown of the linear models (lbgc.estimators.information). Samples after the
    last whole block are dropped.
    """
    size = block_size(windows.gyro.shape[1])
    w, n = len(windows), windows.gyro.shape[1] // size

    def mean(values: np.ndarray) -> np.ndarray:
        blocks = values[:, : n * size].reshape(w, n, size, *values.shape[2:])
        return blocks[:, :, 0].astype(float) if size == 1 else mean_along(blocks, 2)

    samples = mean_angle(windows.plate_angle, windows.rate_hz, sample_s)[:, : n * size]
    angle = mean(samples)
    gyro, accel = mean(windows.gyro), mean(windows.accel)
    interval = size / windows.rate_hz
    still = accel
    if windows.axis != DOWN:  # there gravity itself turns, and a slew's angle is hardly known
        still = np.where(np.any(usable(angle), axis=0)[..., None], accel, np.nan)
    base = tilt_of(unrepeated(angle), still, windows.axis)
    body = np.concatenate([gyro, accel], axis=-1)
    none = np.isnan(body).all(axis=-1)
    start = windows.start_s * (not timeless)
    alike = np.column_stack([start, windows.latitude, angle.round(9)]) + 0.0  # no -0.0
    if none.any():
        alike = np.column_stack([alike, none])
    own: dict[bytes, list[int]] = {}
    for number, row in enumerate(alike):
        own.setdefault(row.tobytes(), []).append(number)
    groups: dict[tuple[Course, float], list[int]] = {}
    for rows in own.values():
        start_s, latitude = alike[rows[0], :2].tolist()
        own_samples = samples[rows[0]].round(9)
        missing = none[rows[0]] if none.any() else None
        course = Course.planned(
            own_samples, interval, start_s, size, unrecorded=missing, axis=windows.axis
        )
        groups.setdefault((course, latitude), []).extend(rows)
    return [
        Levelled(c, Site.at(latitude), np.array(rows), _parts(body[rows], c), base[rows])
        for (c, latitude), rows in groups.items()
    ]


def _parts(body: np.ndarray, course: Course) -> np.ndarray:
    """Means over the parts, (V, 6, n), without the plate's rate; body : (V, blocks, 6)."""
    found = body[:, list(course.blocks)]
    for k in np.flatnonzero(course.slewing):
        first = course.blocks[k]
        found[:, k] = body[:, first : first + course.lengths[k]].mean(axis=1)
    found[..., course.axis] -= course.rate
    return np.moveaxis(found, 1, 2)


def block_size(samples: int) -> int:
    """Number of samples in a block: the smallest that makes at most 240 blocks of the window, or
    up to a quarter more where that divides the window evenly."""
    least = -(-samples // MOST_BLOCKS)
    whole = (k for k in range(least, least + least // 4 + 1) if samples % k == 0)
    return next(whole, least)


def _turned_level(values: np.ndarray, angle: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """Horizontal components, in level axes that turn with a plate about down, of vectors in the
    body's axes: (W, n, 3) -> (W, 2, n). angle : rad, the plate's; tilt : (W, 3, 3), of the base."""
    level_axes = turned(values, angle) @ np.swapaxes(tilt, 1, 2)
    return np.moveaxis(turned(level_axes[..., :2], -angle), -1, 1)
