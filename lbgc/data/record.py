"""A recording of an IMU, the form that simulated data and real logs both take."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbgc.errors import InputError, require
from lbgc.frames import AXES, DOWN


@dataclass(frozen=True)
class Held:
    """What is known of a recording of an IMU that was held at rest in several attitudes: all of it
    may be unknown."""

    attitude: np.ndarray | None = None
    """(T, 3), rad, true roll, pitch and heading at each sample; None for a real log"""
    poses: tuple[tuple[int, int], ...] = ()
    """First sample of each stretch in which it was held, and the one behind its last, where the
    user listed them"""
    headings: tuple[float, ...] = ()
    """rad, reference heading of the forward axis in each of these, where they are known"""


@dataclass(frozen=True)
class Record:
    """One recording of one IMU, and what is known of it.

    A real recording lacks the true heading (`heading` is None), and may lack the reference.
    """

    name: str
    """The recording's name in messages and reports"""
    gyro: np.ndarray
    """(T, 3), rad/s, mean rates over (t_k - dt, t_k], body axes forward-right-down. NaN, as the
    forces, where nothing was recorded: between the files of a recording."""
    accel: np.ndarray
    """(T, 3), m/s^2, mean specific force over the same intervals and along the same axes."""
    plate_angle: np.ndarray
    """(T,), rad, as the encoder reads it. A dataset's is zero at the recording's start."""
    rate_hz: float
    """Samples a second"""
    latitude: float
    """Latitude, rad; NaN where it is not known, which a fit of noise does not need"""
    heading: float | None = None
    """rad, the true heading when the encoder reads zero."""
    heading_reference: float | None = None
    """rad, the same heading by the reference instrument."""
    temperature: np.ndarray | None = None
    """(T,), of the sensor, K or degrees Celsius; None where it was not recorded."""
    reference_sigma: float | None = None
    """rad, 1 sigma of that reference; None where it is not known."""
    unit: str | None = None
    """The sensor's name, where the log states it"""
    session: str | None = None
    """The power-up's name, likewise"""
    axis: int = DOWN
    """The body's axis about which the plate turns, by the right-hand rule: its number in
    `lbgc.frames.AXES`"""
    held: Held | None = None
    """Of an IMU that was held at rest in several attitudes; None where only a plate turned it"""
    notes: tuple[str, ...] = ()
    """Plain sentences that belong to the recording's results: how its clock was read, what of its
    frame could not be checked."""

    def __post_init__(self) -> None:
        n = len(self.gyro)
        for name, shape in (("gyro", (n, 3)), ("accel", (n, 3)), ("plate_angle", (n,))):
            got = getattr(self, name).shape
            require(got == shape, f"{self.name}: {name}'s shape", got, f"must be {shape}")
        require(self.axis in range(3), f"{self.name}: axis", self.axis, f"must be 0 to 2: {AXES}")
        if self.temperature is not None:
            got = self.temperature.shape
            require(got == (n,), f"{self.name}: temperature's shape", got, f"must be {(n,)}")

    @property
    def triads(self) -> Mapping[str, np.ndarray]:
        """The samples of gyro and accel, (T, 3), SI."""
        return {"gyro": self.gyro, "accel": self.accel}

    @property
    def has_reference(self) -> bool:
        """Whether a reference says where it looked."""
        headings = () if self.held is None else self.held.headings
        return self.heading_reference is not None or len(headings) > 0

    @property
    def duration_s(self) -> float:
        """The recording's duration, s."""
        return len(self.gyro) / self.rate_hz


@dataclass(frozen=True)
class TriadRecord:
    """One triad of a recording on its own clock, which is all that its noise is fitted to: of a
    sensor that has no other, or whose other one has another clock.

    No heading comes from it: what takes a `Record` has both triads.
    """

    part: str
    """gyro or accel"""
    values: np.ndarray
    """(T, 3), rad/s or m/s^2, means over the samples' intervals, body axes forward-right-down"""
    name: str
    """The recording's name in messages and reports"""
    plate_angle: np.ndarray
    """(T,), rad, as in a `Record`"""
    rate_hz: float
    """Samples a second"""
    latitude: float
    """Latitude, rad"""
    heading_reference: float | None = None
    """rad, as in a `Record`"""
    temperature: np.ndarray | None = None
    """(T,), of the sensor, as in a `Record`"""
    notes: tuple[str, ...] = ()
    """Plain sentences that belong to the results"""

    @property
    def triads(self) -> Mapping[str, np.ndarray]:
        """The samples of this triad, (T, 3), SI, by its name."""
        return {self.part: self.values}

    @property
    def duration_s(self) -> float:
        """The recording's duration, s."""
        return len(self.values) / self.rate_hz


def require_on_plate(record: Record) -> None:
    """Raise InputError where the recording is of an IMU that was held in several attitudes: whoever
    takes it for a plate's would answer wrongly."""
    about = "is one attitude after the other and not of a plate, and only estimator=tumble answers "
    about += "that: python lbgc/evaluate.py estimator=tumble"
    require(record.held is None, "recording", record.name, about)


SAMPLED = ("gyro", "accel", "plate_angle")
"""Fields of a recording, and of windows, that have a value for each sample."""


def whole_multiple(rate_hz: float, target_hz: float) -> int | None:
    """The ratio of two rates, the number of samples at rate_hz in one at target_hz; None where that
    is not a whole number."""
    ratio = rate_hz / target_hz
    whole = round(ratio)
    return whole if whole >= 1 and abs(ratio - whole) < 1e-6 * ratio else None


_UNEVEN = 0.02
"""The relative amount by which a block or a window may be longer or shorter than asked for."""
_SAME = 0.01
"""The relative difference of rates below which they are taken as one."""
_FEWEST = 20
"""Samples in a block from which on blocks that differ by one sample are taken as equal."""


def nearest_samples(seconds: float, rate_hz: float) -> int | None:
    """The whole number of samples that is nearest to a length of time, s; None where it is more
    than 2% off."""
    asked = seconds * rate_hz
    size = round(asked)
    return size if size >= 1 and abs(size - asked) <= _UNEVEN * asked else None


def block_edges(samples: int, rate_hz: float, target_hz: float) -> np.ndarray | None:
    """The edges, in samples, of consecutive blocks of 1/target_hz, (blocks + 1,). Where the rates
    have a whole ratio the blocks are equal, and samples left over at the end are cut. Otherwise
    their lengths differ by one sample where blocks are long enough for that to be negligible, or
    the block nearest in length is taken. None where none of these is within 2%."""
    block = whole_multiple(rate_hz, target_hz)
    if block is not None:
        return np.arange(samples // block + 1) * block
    ratio = rate_hz / target_hz
    count = round(samples / ratio)
    if count >= 1 and ratio >= _FEWEST and abs(samples / count / ratio - 1) <= _UNEVEN:
        return np.round(np.arange(count + 1) * (samples / count)).astype(int)
    block = round(ratio)
    near = block >= 1 and abs(block / ratio - 1) <= _UNEVEN
    return np.arange(samples // block + 1) * block if near else None


def mean_along(values: np.ndarray, axis: int) -> np.ndarray:
    """Means along an axis, in float64. Along the axis before the last, as of vectors, one a sample,
    it is a product of matrices: numpy's own sum takes twenty times as long there."""
    if axis != values.ndim - 2:
        return np.asarray(values.mean(axis=axis, dtype=np.float64))
    return np.asarray(np.ones(values.shape[axis]) @ values / values.shape[axis])


def means_between(values: np.ndarray, edges: np.ndarray, axis: int = 0) -> np.ndarray:
    """Means of the values from each edge to the next along an axis, in float64."""
    sizes = np.diff(edges)
    cut = values[(slice(None),) * axis + (slice(0, int(edges[-1])),)]
    if np.ptp(sizes) == 0:
        shape = (*values.shape[:axis], len(sizes), sizes[0], *values.shape[axis + 1 :])
        return mean_along(cut.reshape(shape), axis + 1)
    sums = np.add.reduceat(cut, edges[:-1], axis=axis, dtype=np.float64)
    return np.asarray(sums / sizes.reshape(-1, *(1,) * (values.ndim - axis - 1)))


def block_means(record: Record, rate_hz: float) -> Record:
    """The record at a lower rate, by means over blocks of equal length, or of lengths that differ
    by one sample; samples left over at the end are cut.

    Raises InputError where the record's rate is not a whole multiple of `rate_hz`, nor near to one,
    and blocks have so few samples that a difference of one matters.
    """
    edges = block_edges(len(record.gyro), record.rate_hz, rate_hz)
    if edges is None:
        raise InputError(
            f"{record.name}: its rate",
            f"{record.rate_hz:g}",
            "Hz",
            f"must be a whole multiple of the {rate_hz:g} Hz asked for",
        )
    if edges[-1] == len(edges) - 1:
        return record
    sampled = (*SAMPLED, *(() if record.temperature is None else ("temperature",)))
    values: dict[str, Any] = {n: means_between(getattr(record, n), edges) for n in sampled}
    return replace(record, **values, rate_hz=true_rate(edges, record.rate_hz, rate_hz))


def true_rate(edges: np.ndarray, rate_hz: float, target_hz: float) -> float:
    """The rate, Hz, of blocks with these edges: target_hz where the rates have a whole ratio, and
    otherwise the mean rate that the edges make."""
    if len(edges) < 2 or whole_multiple(rate_hz, target_hz) is not None:
        return target_hz
    return rate_hz * (len(edges) - 1) / float(edges[-1])


def require_one_rate(records: Sequence[Record | TriadRecord]) -> None:
    """Raise InputError where the rates of recordings whose noise is to be pooled differ by more
    than 1%."""
    first = records[0]
    for record in records:
        if abs(record.rate_hz / first.rate_hz - 1) > _SAME:
            about = f"but {first.name} has {first.rate_hz:.6g} Hz: noise is fitted to one rate"
            raise InputError(f"{record.name}: its rate", f"{record.rate_hz:.6g}", "Hz", about)


def mock_record(**changes: object) -> Record:
    """A short record for tests, level and at rest at a heading of 40 degrees and 32.76 N, with the
    fields in `changes` replaced."""
    from lbgc.earth import earth_rate_ned, normal_gravity
    from lbgc.frames import rotation_z

    latitude, heading, n = np.deg2rad(32.76), np.deg2rad(40.0), 250
    values: dict[str, Any] = {
        "name": "mock",
        "gyro": np.tile(earth_rate_ned(latitude) @ rotation_z(heading), (n, 1)),
        "accel": np.tile([0.0, 0.0, -normal_gravity(float(latitude))], (n, 1)),
        "plate_angle": np.zeros(n),
        "rate_hz": 10.0,
        "latitude": float(latitude),
        "heading": float(heading),
        "heading_reference": float(heading) + np.deg2rad(0.1),
    }
    return Record(**(values | changes))
