"""How a window's blocks lie in time and on the plate, and its sensors' means over them, levelled.

Whatever asks a window of a level or nearly level bench for its heading sees it so: some hundred
block means, in axes that are level and turn with the plate.
"""

from dataclasses import dataclass, replace

import numpy as np

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.estimators.level import level
from lbgc.frames import euler_to_matrix, turned, unrepeated

MOST_BLOCKS = 240
_RESTS = np.deg2rad(1e-4)
"""Of travel from block to block."""
_STEADY = np.deg2rad(0.003)
"""Of change in it; an encoder has steps."""
_ALONE = np.deg2rad(1e-6)
"""Of either, where one neighbour alone tells: a slew that begins in a block's last hundredth moves
its mean angle by little more than that, and its mean rate by much."""


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
        """On the ellipsoid."""
        return cls(latitude, normal_gravity(latitude))

    @property
    def down(self) -> float:
        """Its vertical rate about the down axis, rad/s."""
        return -EARTH_RATE * float(np.sin(self.latitude))


@dataclass(frozen=True)
class Course:
    """Where n blocks of one window lie. Hashable, so that what follows from it is worked out once
    for all windows that are alike."""

    interval: float
    """s, of a block"""
    start: int
    """blocks between the recording's start and the window's"""
    blocks: tuple[int, ...]
    """which of the window's blocks these are, (n,)"""
    angle: tuple[float, ...]
    """(n,), rad, the plate's, mean over the block"""
    rate: tuple[float, ...]
    """(n,), rad/s, the plate's; zero at rest"""

    @property
    def c(self) -> np.ndarray:
        """Mean of cos(plate angle) over each block, (n,): it turns evenly within one."""
        return np.cos(self.angle) * self._shortened

    @property
    def s(self) -> np.ndarray:
        return np.sin(self.angle) * self._shortened

    @property
    def _shortened(self) -> np.ndarray:
        return np.sinc(np.array(self.rate) * self.interval / (2 * np.pi))

    @property
    def resting(self) -> np.ndarray:
        return np.array(self.rate) == 0.0

    def only(self, which: np.ndarray) -> "Course":
        """The part of it where `which`, bool (n,), is true."""
        kept = [np.array(part)[which].tolist() for part in (self.blocks, self.angle, self.rate)]
        return Course(self.interval, self.start, *(tuple(part) for part in kept))

    @classmethod
    def planned(cls, angle: np.ndarray, interval: float, start_s: float = 0.0) -> "Course":
        """Of block means of the plate's angle, (n,), rad, unwrapped.

        Left out are blocks in which the plate speeds up or slows down, and slews between rests: a
        gyro's misalignment, or the base's lean, times a slew's rate is far above what they could
        tell of north. The rests next to them stay in: where the noise wanders, those tell most.
        """
        used, _ = usable(angle)
        rate = travel_within(angle) / interval
        start = round(start_s / interval)
        every = cls(interval, start, tuple(range(len(angle))), tuple(angle), tuple(rate))
        return every.only(used)


def usable(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which blocks tell of north, and in which the plate rests, bool (*S, n) both.

    angle : (*S, n), rad, unwrapped, the plate's mean over each block. A plate that turns for most
    of a window is on a carousel: what tells is where its rate is steady. Else it is the rests.
    """
    n = angle.shape[-1]
    travel = np.diff(angle, axis=-1) if n > 1 else np.zeros_like(angle)
    before = np.concatenate([travel[..., :1], travel], axis=-1)[..., :n]
    after = np.concatenate([travel, travel[..., -1:]], axis=-1)[..., :n]
    moves = np.abs(before), np.abs(after)
    resting = (np.maximum(*moves) < _RESTS) | (np.minimum(*moves) < _ALONE)
    change = np.abs(after - before)
    steady = change < _STEADY
    steady[..., 0] = steady[..., -1] = False
    if n > 2:  # an end has but one neighbour to tell by
        steady[..., 0], steady[..., -1] = change[..., 1] < _ALONE, change[..., -2] < _ALONE
    steady &= ~resting
    carousel = steady.mean(axis=-1, keepdims=True) > 0.5
    return np.where(carousel, steady, resting), resting


def travel_within(angle: np.ndarray) -> np.ndarray:
    """What the plate travels within each block, rad, (*S, n), by their mean angles; none at rest.
    Of a block in which it speeds up or slows down, this is not what it travels."""
    if angle.shape[-1] == 1:
        return np.zeros_like(angle)
    return np.where(usable(angle)[1], 0.0, np.gradient(angle, axis=-1))


@dataclass(frozen=True)
class Levelled:
    """Windows that share a course and a latitude."""

    course: Course
    site: Site
    rows: np.ndarray
    """which windows these are, (V,)"""
    data: np.ndarray
    """(V, 4, n): forward and right rate, rad/s, forward and right specific force, m/s^2, in level
    axes that turn with the plate; the plate's own rate taken off"""
    tilt: np.ndarray
    """(V,), rad, of the base"""

    def only(self, which: np.ndarray) -> "Levelled":
        """The blocks where `which`, bool (n,), is true."""
        return replace(self, course=self.course.only(which), data=self.data[:, :, which])


def levelled(windows: Windows, sample_s: float | None = None) -> list[Levelled]:
    """The windows by course and latitude. sample_s : the sensor's own interval, where the windows
    hold means.

    The base's tilt is levelled out exactly, by its mean specific force in the base's axes; what it
    leaves is small, and linear models (lbgc.estimators.information) may have it.
    """
    size = _block(windows.gyro.shape[1], MOST_BLOCKS)
    w, n = len(windows), windows.gyro.shape[1] // size

    def mean(values: np.ndarray) -> np.ndarray:
        blocks = values.reshape(w, n, size, *values.shape[2:])
        return blocks[:, :, 0].astype(float) if size == 1 else blocks.mean(axis=2, dtype=float)

    angle = mean(mean_angle(windows.plate_angle, windows.rate_hz, sample_s))
    gyro, accel = mean(windows.gyro), mean(windows.accel)
    interval = size / windows.rate_hz
    gyro[..., 2] -= travel_within(angle) / interval
    at = unrepeated(angle)
    tilt = tilt_of(at, accel)
    data = np.concatenate([_turned_level(v, at, tilt) for v in (gyro, accel)], axis=1)
    lean = np.arccos(np.clip(tilt[:, 2, 2], -1, 1))
    alike = np.column_stack([windows.start_s, windows.latitude, angle.round(9)]) + 0.0  # no -0.0
    own: dict[bytes, list[int]] = {}
    for number, row in enumerate(alike):
        own.setdefault(row.tobytes(), []).append(number)
    groups: dict[tuple[Course, float], list[int]] = {}
    for rows in own.values():
        start_s, latitude, *turns = alike[rows[0]]
        course = Course.planned(np.array(turns), interval, float(start_s))
        groups.setdefault((course, float(latitude)), []).extend(rows)
    return [
        Levelled(c, Site.at(latitude), np.array(rows), data[rows][:, :, list(c.blocks)], lean[rows])
        for (c, latitude), rows in groups.items()
    ]


def _block(samples: int, most: int) -> int:
    """Samples of a block: the fewest that divide the window into at most `most`."""
    return next(k for k in range(-(-samples // most), samples + 1) if samples % k == 0)


def mean_angle(reading: np.ndarray, rate_hz: float, sample_s: float | None) -> np.ndarray:
    """The plate's mean angle over each sample (or mean of samples), (W, T), rad: an encoder is read
    at a sample's end, and turns on for half of it. sample_s : the sensor's own interval; None where
    the reading is of samples."""
    if sample_s is None or sample_s * rate_hz > 0.999:
        steps = np.diff(reading, axis=1, prepend=reading[:, :1])
        if reading.shape[1] > 1:
            steps[:, 0] = steps[:, 1]
        return np.asarray(reading - steps / 2)
    return np.asarray(reading - sample_s * rate_hz / 2 * travel_within(reading))


def tilt_of(angle: np.ndarray, accel: np.ndarray) -> np.ndarray:
    """From the base's axes to level ones, (W, 3, 3).

    angle : (W, n or 1), rad, the plate's; accel : (W, n, 3), specific force in the body's axes."""
    return euler_to_matrix(*level(turned(accel, angle).mean(axis=1)), 0.0)


def _turned_level(values: np.ndarray, angle: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """The horizontal part in level axes that turn with the plate: (W, n, 3) -> (W, 2, n)."""
    level_axes = turned(values, angle) @ np.swapaxes(tilt, 1, 2)
    return np.moveaxis(turned(level_axes[..., :2], -angle), -1, 1)
