"""How a channel's values are distributed as they were printed: counts, rails, values that stay."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.logconfig import LogConfig
from lbgc.data.record import Record
from lbgc.sensor.imu import ImuModel
from lbgc.units import DEG

_COARSE = 0.5
"""Share of samples that repeat the one before: it is 0.56 where the noise is half a count."""
_PILE, _PILE_ONE_SIDED = 4.0, 1.5
_NAMED_SHARE, _REFUSED_SHARE, _ONE_SIDED_SHARE = 1e-3, 5e-3, 2e-3
_FEWEST = 200
"""Samples below which nothing is said of a distribution."""
_PLACES = ("smallest", "largest")


@dataclass(frozen=True)
class Channel:
    """One channel of a recording."""

    name: str
    """As a message calls it, by the file's own axis: gyro x, accelerometer z."""
    values: np.ndarray  # (T,), SI
    unit: str
    scale: float
    """SI in the unit that messages use."""
    carried: bool
    """Whether its counts are known to carry their rest over, so that their mean is exact."""

    @cached_property
    def distinct(self) -> tuple[np.ndarray, np.ndarray]:
        """Its values in order, (L,), and how often each is printed."""
        return np.unique(self.values, return_counts=True)

    @cached_property
    def same(self) -> np.ndarray:
        """(T - 1,), whether each sample but the first repeats the one before."""
        return np.asarray(np.diff(self.values) == 0)

    @property
    def is_counted(self) -> bool:
        return 1 < len(self.distinct[0]) < len(self.values) / 4

    @property
    def is_coarse(self) -> bool:
        """Whether its noise moves it by less than half a count or so from sample to sample."""
        return self.is_counted and float(self.same.mean()) > _COARSE

    @property
    def count(self) -> float:
        """The smallest step between values that it prints, SI."""
        steps = np.diff(self.distinct[0])
        return float(steps.min()) if len(steps) else 0.0

    @cached_property
    def noise(self) -> float:
        """1 sigma from sample to sample, whatever a few bad ones do, SI."""
        step = np.abs(np.diff(self.values))
        return float(np.median(step)) / 0.6745 / np.sqrt(2) if len(step) else 0.0

    def shown(self, value: float) -> str:
        return f"{value / self.scale:.6g} {self.unit}"


def channels(record: Record, config: LogConfig, imu: ImuModel | None) -> list[Channel]:
    """The six channels of a recording, gyros first, by the file's axes."""
    found = []
    for name, values, axes, unit, scale in (
        ("gyro", record.gyro, config.axes, "deg/s", DEG),
        ("accelerometer", record.accel, config.axes_of_accel, "m/s2", 1.0),
    ):
        triad = None if imu is None else (imu.gyro if name == "gyro" else imu.accel)
        carried = triad is not None and triad.carried_lsb is not None
        for column, axis in sorted(enumerate(axes), key=lambda pair: pair[1][-1]):
            sign = -1.0 if axis.startswith("-") else 1.0
            one = np.ascontiguousarray(sign * values[:, column])
            found.append(Channel(f"{name} {axis[-1]}", one, unit, scale, carried))
    return found


def listed(names: Sequence[str]) -> str:
    """Channels' names in words, such as: gyro x, y and accelerometer z."""
    triads: dict[str, list[str]] = {}
    for name in names:
        triad, axis = name.split()
        triads.setdefault(triad, []).append(axis)
    return " and ".join(f"{triad} {', '.join(axes)}" for triad, axes in triads.items())


def rail_finding(name: str, every: Sequence[Channel]) -> Finding | None:
    """Samples that pile up at a channel's smallest or largest value: its range cuts them off."""
    said, most = [], 0.0
    for channel in every:
        for share, end in _piles(channel):
            value = channel.distinct[0][0 if end == 0 else -1]
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
    """The share of the samples at either end (0 smallest, 1 largest) where it is a rail's.

    A noise's density falls off towards its ends, so its last value is rarer than those before it.
    A rail's holds all that would be beyond: several times the next three, or, on one side alone,
    more than goes on from them.
    """
    n = len(channel.values)
    if n < _FEWEST or len(channel.distinct[0]) < 6 or channel.is_coarse:
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
            if c[1] < c[2] < c[3]:  # a Gaussian's next, or less: its density is log-concave
                expected = c[1] ** 2 / c[2]
                error = expected**2 * (4 / c[1] + 1 / c[2])
        chance = 5 * np.sqrt(c[0] + factor**2 * (expected + error))
        if c[0] - factor * expected > chance:
            found.append((float(share), end))
    return found


def _from_end(channel: Channel, end: int) -> tuple[np.ndarray, np.ndarray]:
    """The first four values from an end inwards, and how often each is printed."""
    values, counts = channel.distinct
    inward = 1 - 2 * end
    return values[::inward][:4], counts[::inward][:4].astype(float)


def counts_finding(every: Sequence[Channel]) -> Finding | None:
    """Counts coarser than the noise: a dead band, in which a mean is not what it seems. A note."""
    parts = []
    for triad in dict.fromkeys(c.name.split()[0] for c in every):
        own = [c for c in every if c.name.startswith(triad)]
        count = max((c.count for c in own if c.is_coarse), default=0.0)
        if own[0].carried or len(own[0].values) < _FEWEST:
            continue
        if all(len(c.distinct[0]) == 1 for c in own) and any(c.count > 0 for c in every):
            parts.append(f"{listed([c.name for c in own])}, which never change, in counts")
        if count == 0:
            continue
        own = [c for c in own if c.is_coarse or len(c.distinct[0]) == 1]
        parts.append(f"{listed([c.name for c in own])} in counts of {own[0].shown(count)}")
    if not parts:
        return None
    says = f"{'; '.join(parts)}, coarser than the noise: unless the sensor carries the rest over, "
    says += "means are wrong by up to half a count and the noise is not seen"
    return Finding("counts", "log", "counts", "", says, refuses=False)


def held_finding(record: Record) -> Finding | None:
    """One triad that repeats its values while the other goes on: a slower sensor. A note."""
    if len(record.gyro) < _FEWEST:
        return None
    shares = {}
    for name, values in (("gyros", record.gyro), ("accelerometers", record.accel)):
        same = (np.diff(values, axis=0) == 0).all(axis=1)
        moves = (np.diff(values, axis=0) != 0).all(axis=1)
        # Where rows either repeat whole or change on every axis, it is no matter of coarse counts.
        shares[name] = float(same.mean()) if (same | moves).mean() > 0.98 else 0.0
    for name, other in (("gyros", "accelerometers"), ("accelerometers", "gyros")):
        if 0.3 < shares[name] < 0.98 and shares[other] < 0.1 * shares[name]:
            rate = record.rate_hz * (1 - shares[name])
            says = f"the {name} print each value {1 / (1 - shares[name]):.3g} times on average, so "
            says += f"their noise is one of {rate:.4g} Hz"
            return Finding("held", "log", name, "", says, refuses=False)
    return None
