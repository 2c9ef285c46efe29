"""Windows of recordings, which are what an estimator is given, and windows with labels, for
training and scoring."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbgc.data.record import (
    SAMPLED,
    Record,
    block_edges,
    block_means,
    means_between,
    nearest_samples,
    require_on_plate,
    true_rate,
    whole_multiple,
)
from lbgc.errors import InputError, require, require_choice
from lbgc.frames import AXES, DOWN

_MOST = 0.98
"""The least share of a window's samples that whole blocks must cover."""


@dataclass(frozen=True, kw_only=True)
class Windows:
    """W windows of equal length. An estimator answers each from its own row alone."""

    gyro: np.ndarray
    """(W, T, 3), rad/s, angular rates; NaN, as the forces, where nothing was recorded"""
    accel: np.ndarray
    """(W, T, 3), m/s^2, specific forces"""
    plate_angle: np.ndarray
    """(W, T), rad, angle of the plate since the recording's start"""
    rate_hz: float
    """Samples a second"""
    latitude: np.ndarray
    """(W,), rad, latitude"""
    start_s: np.ndarray
    """(W,), s, when each window begins, since the recording's start"""
    axis: int = DOWN
    """The body's axis about which the plate turns, in all windows: its number in `lbgc.frames.AXES`
    """

    def __len__(self) -> int:
        return len(self.gyro)

    @property
    def duration_s(self) -> float:
        """The length of each window, s."""
        return float(self.gyro.shape[1] / self.rate_hz)

    @property
    def unrecorded(self) -> np.ndarray:
        """The samples at which nothing was recorded, all six channels NaN: bool (W, T)."""
        none = np.asarray(np.isnan(self.gyro[..., 0]))
        if none.any():
            none &= np.isnan(self.gyro).all(axis=-1) & np.isnan(self.accel).all(axis=-1)
        return none

    def rows(self, which: slice | np.ndarray) -> "Windows":
        """The windows that `which` selects."""
        alike = ("rate_hz", "axis")
        return replace(self, **{k: v[which] for k, v in vars(self).items() if k not in alike})


@dataclass(frozen=True, kw_only=True)
class Labelled:
    """Windows with their headings as labels. An estimator is given the windows alone."""

    windows: Windows
    """The W windows"""
    heading: np.ndarray
    """(W,), rad, true heading when the encoder reads zero; NaN where unknown"""
    heading_reference: np.ndarray
    """(W,), rad, the same heading by the reference instrument; NaN where unknown"""

    @classmethod
    def joined(cls, several: Sequence["Labelled"]) -> "Labelled":
        """Several sets of labelled windows, of one length and rate, as one set."""
        return cls(
            windows=joined([own.windows for own in several]),
            heading=np.concatenate([own.heading for own in several]),
            heading_reference=np.concatenate([own.heading_reference for own in several]),
        )

    def __len__(self) -> int:
        return len(self.windows)

    def rows(self, which: slice | np.ndarray) -> "Labelled":
        """The labelled windows that `which` selects."""
        return Labelled(
            windows=self.windows.rows(which),
            heading=self.heading[which],
            heading_reference=self.heading_reference[which],
        )


def window_of(
    gyro: np.ndarray,
    accel: np.ndarray,
    rate_hz: float,
    latitude_deg: float,
    plate_angle: np.ndarray | None = None,
    axis: str = AXES[DOWN],
) -> Windows:
    """The arrays of a user's own recording as one window.

    gyro : (T, 3), rad/s, and accel : (T, 3), m/s^2, forward-right-down, each sample the mean over
    its interval; plate_angle : (T,), rad, None where nothing turns; axis : about which the plate
    turns, forward, right or down. Raises InputError where the shapes do not agree.
    """
    require_choice("axis", axis, AXES)
    n = len(gyro)
    plate = np.zeros(n) if plate_angle is None else np.asarray(plate_angle, float)
    record = Record(
        "window",
        np.asarray(gyro, float),
        np.asarray(accel, float),
        plate,
        rate_hz,
        float(np.deg2rad(latitude_deg)),
        axis=AXES.index(axis),
    )
    return cut(record, n / rate_hz)


def cut(record: Record, window_s: float) -> Windows:
    """Cut a record into consecutive windows of `window_s`, or of the whole number of samples
    nearest to that; no window (W = 0) where the record is shorter, and none in which nothing was
    recorded.

    Raises InputError where no whole number of samples is within 2% of the length.
    """
    require_on_plate(record)
    size = nearest_samples(window_s, record.rate_hz)
    if size is None:
        raise InputError(
            "windows_s", window_s, "s", f"must be whole samples of {1 / record.rate_hz:g} s"
        )
    whole = whole_multiple(window_s, 1 / record.rate_hz) is not None
    length_s = window_s if whole else size / record.rate_hz
    count = len(record.gyro) // size

    def rows(values: np.ndarray) -> np.ndarray:
        return values[: count * size].reshape(count, size, *values.shape[1:])

    windows = Windows(
        gyro=rows(record.gyro),
        accel=rows(record.accel),
        plate_angle=rows(record.plate_angle),
        rate_hz=record.rate_hz,
        latitude=np.full(count, record.latitude),
        start_s=np.arange(count) * length_s,
        axis=record.axis,
    )
    if not np.isnan(windows.gyro[:, 0, 0]).any():
        return windows
    return windows.rows(np.asarray(~windows.unrecorded.all(axis=1)))


def joined(several: Sequence[Windows]) -> Windows:
    """Several sets of windows, of one length, rate and axis of the plate, as one set."""
    _one_axis([own.axis for own in several])
    names = (*SAMPLED, "latitude", "start_s")
    values: dict[str, Any] = {n: np.concatenate([getattr(w, n) for w in several]) for n in names}
    return replace(several[0], **values)


def _one_axis(several: Sequence[int]) -> int:
    """The axis about which the plates turn. Raises InputError where there are several."""
    found = sorted(set(several))
    names = " and ".join(AXES[axis] for axis in found)
    require(len(found) < 2, "the plate's axis", names, "must be one in all recordings")
    return found[0] if found else DOWN


def length_note(record: Record, window_s: float) -> str | None:
    """A sentence that says how long the record's windows are where they cannot be exactly as long
    as `window_s`; None where they can."""
    size = nearest_samples(window_s, record.rate_hz)
    if size is None or whole_multiple(window_s, 1 / record.rate_hz) is not None:
        return None
    return (
        f"windows of {window_s:g} s are {size} samples, {size / record.rate_hz:.6g} s, "
        f"at {record.rate_hz:.6g} Hz"
    )


def at_rate(windows: Windows, rate_hz: float) -> Windows:
    """The windows at a lower rate, by means over blocks of equal length, or of lengths that differ
    by one sample.

    Raises InputError where the windows' rate is not a whole multiple of `rate_hz`, nor near to one,
    and blocks have so few samples that a difference of one matters; or where whole blocks leave
    more than 2% of a window.
    """
    samples = windows.gyro.shape[1]
    edges = block_edges(samples, windows.rate_hz, rate_hz)
    if edges is None or not len(edges) > 1 or edges[-1] < _MOST * samples:
        raise InputError(
            "the data's rate",
            f"{windows.rate_hz:g}",
            "Hz",
            f"must be a whole multiple of {rate_hz:g} Hz, and each window of "
            f"{windows.duration_s:g} s whole blocks of {1 / rate_hz:g} s",
        )
    if edges[-1] == len(edges) - 1:
        return windows
    values: dict[str, Any] = {n: means_between(getattr(windows, n), edges, axis=1) for n in SAMPLED}
    return replace(windows, **values, rate_hz=true_rate(edges, windows.rate_hz, rate_hz))


def stack(records: Iterable[Record], rate_hz: float) -> Labelled:
    """A training set in memory: whole recordings of one length, averaged to one rate, each as one
    window."""
    rows: list[Record] = []
    for record in records:
        require_on_plate(record)
        rows.append(block_means(record, rate_hz))
    windows = Windows(
        gyro=np.stack([r.gyro for r in rows]),
        accel=np.stack([r.accel for r in rows]),
        plate_angle=np.stack([r.plate_angle for r in rows]),
        rate_hz=rate_hz,
        latitude=np.array([r.latitude for r in rows]),
        start_s=np.zeros(len(rows)),
        axis=_one_axis([r.axis for r in rows]),
    )
    return Labelled(
        windows=windows,
        heading=np.array([r.heading for r in rows], float),  # None becomes NaN
        heading_reference=np.array([r.heading_reference for r in rows], float),
    )
