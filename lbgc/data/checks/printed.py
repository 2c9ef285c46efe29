"""Checks of a channel's values as they were printed: counts, rails, and repeated values."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.logconfig import LogConfig
from lbgc.data.readers.blocks import blocks, some
from lbgc.data.record import Record, TriadRecord
from lbgc.frames import axis_names
from lbgc.sensor.imu import ImuModel
from lbgc.units import DEG

_COARSE = 0.5
"""Share of samples that repeat the one before, above which counts are coarse. It is 0.56 where the
noise is half a count."""
_PILE, _PILE_ONE_SIDED = 4.0, 1.5
"""Least ratio of the samples at a rail to those expected, at both ends and at one end only."""
_NAMED_SHARE, _REFUSED_SHARE, _ONE_SIDED_SHARE = 1e-3, 5e-3, 2e-3
"""Shares of the samples at a rail above which it is named, is refused, and is looked for at one end
only."""
_FEWEST = 200
"""Samples below which a distribution is not judged."""
_PLACES = ("smallest", "largest")
_ENDS = 4
"""Values at an end of a channel's range that are looked at."""


@dataclass(frozen=True)
class Channel:
    """One channel of a recording, that is one axis of one triad."""

    name: str
    """Its name in messages, by the file's own axis: gyro x, accelerometer z"""
    column: np.ndarray
    """(T,), SI, but for the sign"""
    sign: float
    """That sign"""
    unit: str
    """The unit that messages use"""
    scale: float
    """The value of that unit in SI"""
    carried: bool
    """Whether its counts are known to carry their remainder over, so that their mean is exact"""

    def at(self, rows: Any) -> Any:
        """The values in these rows, or in one, SI."""
        return self.sign * self.column[rows]

    @property
    def samples(self) -> int:
        """The number of samples T."""
        return len(self.column)

    @cached_property
    def levels(self) -> "Levels":
        """The channel's different values."""
        return _levels(self.at(slice(None)))

    @property
    def same(self) -> np.ndarray:
        """(T - 1,), whether each sample after the first repeats the one before."""
        return np.asarray(self.column[1:] == self.column[:-1])

    @cached_property
    def repeats(self) -> float:
        """The share of samples that repeat the one before."""
        return float(self.same.mean())

    @property
    def is_counted(self) -> bool:
        """Whether the values are counts: two levels or more, but fewer than a quarter of the
        samples."""
        return 1 < self.levels.number < self.samples / 4

    @property
    def is_coarse(self) -> bool:
        """Whether the noise moves it by less than about half a count from sample to sample."""
        return self.is_counted and self.repeats > _COARSE

    @property
    def count(self) -> float:
        """The smallest step between the values that are printed, SI."""
        return self.levels.step

    @cached_property
    def noise(self) -> float:
        """1 sigma of the noise from sample to sample, SI, by a median that a few bad samples do not
        change."""
        if self.samples < 2:
            return 0.0
        step = np.abs(some(self.column[1:]) - some(self.column[:-1]))
        return float(np.median(step) / 0.6745 / np.sqrt(2))

    def shown(self, value: float) -> str:
        """A value, SI, as text in the unit that messages use."""
        return f"{value / self.scale:.6g} {self.unit}"


@dataclass(frozen=True)
class Levels:
    """The different values of a channel."""

    number: int
    """How many there are"""
    step: float
    """The smallest step between two of them, SI; 0 where there is one"""
    lowest: tuple[np.ndarray, np.ndarray]
    """The four smallest in order, SI, and how often each is printed"""
    highest: tuple[np.ndarray, np.ndarray]
    """The four largest, from the largest on, likewise"""


def _levels(values: np.ndarray) -> Levels:
    """The different values among these, (T,), which are put in order where they stand."""
    values.sort()
    number, step = 1, np.inf
    for own in blocks(len(values) - 1):
        steps = np.diff(values[own.start : own.stop + 1])
        steps = steps[steps > 0]
        number += len(steps)
        step = min(step, float(steps.min(initial=np.inf)))
    ends: list[tuple[np.ndarray, np.ndarray]] = []
    for end in (0, 1):
        first, last = 0, len(values)
        found: list[tuple[float, int]] = []
        while first < last and len(found) < _ENDS:
            value = values[first if end == 0 else last - 1]
            edge = int(np.searchsorted(values, value, side="left" if end else "right"))
            found.append((float(value), edge - first if end == 0 else last - edge))
            first, last = (edge, last) if end == 0 else (first, edge)
        ends.append((np.array([v for v, _ in found]), np.array([c for _, c in found])))
    return Levels(number, step if number > 1 else 0.0, ends[0], ends[1])


def channels(
    record: Record | TriadRecord, config: LogConfig, imu: ImuModel | None
) -> list[Channel]:
    """The channels of a recording, gyros first, in the order of the file's axes."""
    found = []
    for part, name, axes, unit, scale in (
        ("gyro", "gyro", config.axes, "deg/s", DEG),
        ("accel", "accelerometer", config.axes_of_accel, "m/s2", 1.0),
    ):
        values = record.triads.get(part)
        if values is None:
            continue
        triad = None if imu is None else (imu.gyro if name == "gyro" else imu.accel)
        counts = None if triad is None else triad.counts
        carried = counts is not None and counts.is_carried
        few = values.shape[1] < len(axes)
        own = axis_names(values.shape[1]) if few else axes
        for column, axis in sorted(enumerate(own), key=lambda pair: pair[1][-1]):
            sign = -1.0 if axis.startswith("-") else 1.0
            one = values[:, column]
            called = f"{name} {axis if few else axis[-1]}"
            found.append(Channel(called, one, sign, unit, scale, carried))
    return found


def listed(names: Sequence[str]) -> str:
    """The names of channels in words, such as: gyro x, y and accelerometer z."""
    triads: dict[str, list[str]] = {}
    for name in names:
        triad, axis = name.split()
        triads.setdefault(triad, []).append(axis)
    return " and ".join(f"{triad} {', '.join(axes)}" for triad, axes in triads.items())


def rail_finding(name: str, every: Sequence[Channel]) -> Finding | None:
    """The finding that samples pile up at the smallest or largest value of a channel, because its
    range cuts them off; None where none do."""
    said, most = [], 0.0
    for channel in every:
        for share, end in _piles(channel):
            value = _from_end(channel, end)[0][0]
            said.append(f"{100 * share:.3g}% of {channel.name} at its {_PLACES[end]} value, "
                        f"{channel.shown(value)}")  # fmt: skip
            most = max(most, share)
    if not said:
        return None
    says = f"of the samples stand {'; '.join(said)}: a range that cuts off what is beyond it, so "
    says += "neither mean nor noise is right"
    refuses = most > _REFUSED_SHARE
    return Finding("rail", f"{name}: the share at a rail", f"{most:.3g}", "", says, refuses)


def _piles(channel: Channel) -> list[tuple[float, int]]:
    """The share of the samples at each end (0 smallest, 1 largest) that is a rail.

    The density of noise falls off towards its ends, so that its last value is rarer than those
    before it. The value at a rail holds all samples that would be beyond it: several times as many
    as each of the next three or, at one end only, more than these extrapolate to.
    """
    n = channel.samples
    if n < _FEWEST or channel.levels.number < 6 or channel.is_coarse:
        return []
    found = []
    for end in (0, 1):
        v, c = _from_end(channel, end)
        share = c[0] / n
        alone = abs(v[1] - v[0]) > 20 * max(channel.noise, channel.count)
        if alone or c[0] <= max(20, _NAMED_SHARE * n):
            continue
        expected, error, factor = max(c[1:].max(), 1.0), 0.0, _PILE
        other = _from_end(channel, 1 - end)[1]
        if share > _ONE_SIDED_SHARE and other[0] <= other[1:].max():
            factor = _PILE_ONE_SIDED
            # The density of Gaussian noise is log-concave, so the next value has at most this.
            if c[1] < c[2] < c[3]:
                expected = c[1] ** 2 / c[2]
                error = expected**2 * (4 / c[1] + 1 / c[2])
        chance = 5 * np.sqrt(c[0] + factor**2 * (expected + error))
        if c[0] - factor * expected > chance:
            found.append((float(share), end))
    return found


def _from_end(channel: Channel, end: int) -> tuple[np.ndarray, np.ndarray]:
    """The four values nearest to an end, inwards, and how often each is printed."""
    values, counts = channel.levels.highest if end else channel.levels.lowest
    return values, counts.astype(float)


def counts_finding(every: Sequence[Channel]) -> Finding | None:
    """The note that counts are coarser than the noise, so that there is a dead band and means may
    be wrong; None where there are no such counts."""
    parts = []
    for triad in dict.fromkeys(c.name.split()[0] for c in every):
        own = [c for c in every if c.name.startswith(triad)]
        count = max((c.count for c in own if c.is_coarse), default=0.0)
        if own[0].carried or own[0].samples < _FEWEST:
            continue
        if all(c.levels.number == 1 for c in own) and any(c.count > 0 for c in every):
            parts.append(f"{listed([c.name for c in own])}, which never change, in counts")
        if count == 0:
            continue
        own = [c for c in own if c.is_coarse or c.levels.number == 1]
        parts.append(f"{listed([c.name for c in own])} in counts of {own[0].shown(count)}")
    if not parts:
        return None
    says = f"{'; '.join(parts)}, coarser than the noise: unless the sensor carries the rest over, "
    says += "means are wrong by up to half a count and the noise is not seen"
    return Finding("counts", "log", "counts", "", says, refuses=False)


def held_finding(record: Record) -> Finding | None:
    """The note that one triad repeats its values while the other does not, as a slower sensor does;
    None where neither is so."""
    if len(record.gyro) < _FEWEST:
        return None
    shares = {}
    for name, values in (("gyros", record.gyro), ("accelerometers", record.accel)):
        equal = values[1:] == values[:-1]
        same, moves = equal.all(axis=1), ~equal.any(axis=1)
        # Coarse counts would repeat on single axes; a held sample repeats on all of them.
        shares[name] = float(same.mean()) if (same | moves).mean() > 0.98 else 0.0
    for name, other in (("gyros", "accelerometers"), ("accelerometers", "gyros")):
        if 0.3 < shares[name] < 0.98 and shares[other] < 0.1 * shares[name]:
            rate = record.rate_hz * (1 - shares[name])
            says = f"the {name} print each value {1 / (1 - shares[name]):.3g} times on average, so "
            says += f"their noise is one of {rate:.4g} Hz"
            return Finding("held", "log", name, "", says, refuses=False)
    return None
