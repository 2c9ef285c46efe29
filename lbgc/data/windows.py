"""Windows of records: what an estimator is given."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbgc.data.record import (
    Record,
    block_edges,
    block_means,
    means_between,
    nearest_samples,
    true_rate,
    whole_multiple,
)
from lbgc.errors import InputError

_MOST = 0.98
"""Share of a window's samples that blocks must hold, at the least."""
UNKNOWN = np.nan
"""A heading that nobody knows."""


@dataclass(frozen=True)
class Windows:
    """W equally long windows. An estimator answers each from its own row alone."""

    gyro: np.ndarray
    """(W, T, 3), rad/s"""
    accel: np.ndarray
    """(W, T, 3), m/s^2"""
    plate_angle: np.ndarray
    """(W, T), rad, since the recording's start"""
    rate_hz: float
    latitude: np.ndarray
    """(W,), rad"""
    heading: np.ndarray
    """(W,), rad, true, when the encoder reads zero; NaN where unknown"""
    heading_reference: np.ndarray
    """(W,), rad; NaN where unknown"""
    start_s: np.ndarray
    """(W,), s since the recording's start"""

    def __len__(self) -> int:
        return len(self.gyro)

    @property
    def duration_s(self) -> float:
        return self.gyro.shape[1] / self.rate_hz

    def rows(self, which: slice | np.ndarray) -> "Windows":
        """Some of the windows."""
        return replace(self, **{k: v[which] for k, v in vars(self).items() if k != "rate_hz"})


def window_of(
    gyro: np.ndarray,
    accel: np.ndarray,
    rate_hz: float,
    latitude_deg: float,
    plate_angle: np.ndarray | None = None,
) -> Windows:
    """One's own arrays as one window, its heading unknown.

    gyro : (T, 3), rad/s, and accel : (T, 3), m/s^2, forward-right-down, each sample the mean over
    its interval; plate_angle : (T,), rad, None where nothing turns. Raises InputError where the
    shapes do not agree.
    """
    n = len(gyro)
    plate = np.zeros(n) if plate_angle is None else np.asarray(plate_angle, float)
    record = Record(
        "window",
        np.asarray(gyro, float),
        np.asarray(accel, float),
        plate,
        rate_hz,
        float(np.deg2rad(latitude_deg)),
    )
    return cut(record, n / rate_hz)


def cut(record: Record, window_s: float) -> Windows:
    """The record's consecutive windows of this length, or of the whole number of samples nearest
    to it; none (W = 0) where it is shorter.

    Raises InputError where no whole number of samples is within 2% of the length.
    """
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

    def all_of(value: float | None) -> np.ndarray:
        return np.full(count, UNKNOWN if value is None else value)

    return Windows(
        rows(record.gyro),
        rows(record.accel),
        rows(record.plate_angle),
        record.rate_hz,
        all_of(record.latitude),
        all_of(record.heading),
        all_of(record.heading_reference),
        np.arange(count) * length_s,
    )


def joined(several: Sequence[Windows]) -> Windows:
    """Windows of one length and rate, as one set."""

    def all_of(name: str) -> np.ndarray:
        return np.concatenate([getattr(windows, name) for windows in several])

    return Windows(
        all_of("gyro"),
        all_of("accel"),
        all_of("plate_angle"),
        several[0].rate_hz,
        all_of("latitude"),
        all_of("heading"),
        all_of("heading_reference"),
        all_of("start_s"),
    )


def length_note(record: Record, window_s: float) -> str | None:
    """How long the record's windows are, where that is not as long as asked for."""
    size = nearest_samples(window_s, record.rate_hz)
    if size is None or whole_multiple(window_s, 1 / record.rate_hz) is not None:
        return None
    return (
        f"windows of {window_s:g} s are {size} samples, {size / record.rate_hz:.6g} s, "
        f"at {record.rate_hz:.6g} Hz"
    )


def at_rate(windows: Windows, rate_hz: float) -> Windows:
    """The windows at a lower rate, by block means: of equal blocks, or as equal as whole samples
    can be.

    Raises InputError where their rate is no whole multiple of `rate_hz`, nor near to one, and
    blocks have too few samples for one more or less to be little; or where more than 2% of a window
    is no whole block.
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
    return replace(
        windows,
        gyro=means_between(windows.gyro, edges, axis=1),
        accel=means_between(windows.accel, edges, axis=1),
        plate_angle=means_between(windows.plate_angle, edges, axis=1),
        rate_hz=true_rate(edges, windows.rate_hz, rate_hz),
    )


def stack(records: Iterable[Record], rate_hz: float) -> Windows:
    """Whole recordings of one length, at one rate, each as one window: a training set in memory."""
    rows: Sequence[Record] = [block_means(r, rate_hz) for r in records]
    return Windows(
        np.stack([r.gyro for r in rows]),
        np.stack([r.accel for r in rows]),
        np.stack([r.plate_angle for r in rows]),
        rate_hz,
        np.array([r.latitude for r in rows]),
        np.array([UNKNOWN if r.heading is None else r.heading for r in rows]),
        np.array([UNKNOWN if r.heading_reference is None else r.heading_reference for r in rows]),
        np.zeros(len(rows)),
    )
