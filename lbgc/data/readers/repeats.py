"""Treatment of rows that a log prints more than once."""

from dataclasses import replace

import numpy as np

from lbgc.data.readers.held import FEWEST_CHANGES, Holds, dropped, holds, taken
from lbgc.data.readers.raw import Raw
from lbgc.errors import InputError

_MOST_ROWS = 200
"""Rows that are averaged, at most, where columns are held for different numbers of rows."""
_ALWAYS = 0.99
"""The share of repeated stamps whose rows must repeat, too, for these rows to be no samples."""


def without_printed_twice(raw: Raw) -> Raw:
    """The log without rows that equal the row before them, time stamp included, and with a note of
    how many were left out."""
    if raw.stamps is None or raw.config.repeats == "keep":
        return raw
    again = raw.stamps[1:] == raw.stamps[:-1]
    if not again.any():
        return raw
    same = again & (raw.gyro[1:] == raw.gyro[:-1]).all(1) & (raw.accel[1:] == raw.accel[:-1]).all(1)
    if not same.any() or same.sum() < _ALWAYS * again.sum():
        return raw
    kept = np.concatenate([[True], ~same])
    if kept.sum() < FEWEST_CHANGES:
        return raw
    note = f"printed twice: {same.sum()} rows of {raw.name}, time and all, were left out"
    warmth = None if raw.temperature is None else raw.temperature[kept]
    return replace(
        raw, gyro=raw.gyro[kept], accel=raw.accel[kept], stamps=raw.stamps[kept],
        plate=None if raw.plate is None else raw.plate[kept],
        heading=None if raw.heading is None else raw.heading[kept],
        temperature=warmth, notes=(*raw.notes, note),
    )  # fmt: skip


def sampled(
    name: str, gyro: np.ndarray, accel: np.ndarray, rate_hz: float, repeats: str
) -> tuple[np.ndarray, np.ndarray, float, list[str]]:
    """The sensors' own samples behind the rows of two triads, (T, 3) each, or (T, 0) for one that
    was not recorded, their rate, Hz, and notes of what was done.

    rate_hz : of the rows; repeats : auto, drop or keep. Raises InputError where rows are held
    irregularly and `repeats` is auto, or where they cannot be dropped.
    """
    if repeats == "keep":
        return gyro, accel, rate_hz, []
    found = holds(gyro, accel)
    if found.times > _MOST_ROWS and len(set(found.columns)) > 1:
        about = f"of {name}: {_held(found)}; log each at its own rate, or log.repeats=keep"
        raise InputError("log.repeats", "columns", "", about)
    if found.times > 1 and not found.irregular:
        values = taken(np.hstack([gyro, accel]), found)
        rate = rate_hz * _samples_a_row(len(values), len(gyro), found.times)
        note = (
            f"held samples: {name}, where {_held(found)}, was read at {rate:.6g} Hz, the rate "
            f"of its samples, not at the log's {rate_hz:.6g} Hz"
        )
        width = gyro.shape[1]
        return values[:, :width], values[:, width:], rate, [note]
    if found.irregular and (repeats == "auto" or not found.can_drop):
        _refuse(name, found)
    if repeats == "auto" or not found.can_drop:
        return gyro, accel, rate_hz, []
    kept = dropped(np.hstack([gyro, accel]))
    rate = rate_hz * kept.sum() / len(kept)
    note = (
        f"held samples: {len(kept) - kept.sum()} rows of {name} like the one before were left out "
        f"(log.repeats=drop), and its {kept.sum()} samples taken as even, at {rate:.6g} Hz"
    )
    return gyro[kept], accel[kept], rate, [note]


def _samples_a_row(samples: int, rows: int, times: int) -> float:
    """The number of samples in a row: 1/times, or less where some samples are held for a row more.
    It does not become more where rows are lost."""
    fewer = samples * times < rows - 2 * times
    return samples / rows if fewer else 1 / times


def _held(found: Holds) -> str:
    """The clause of a message that says for how many rows samples are held."""
    own = sorted(set(found.columns))
    if len(own) == 1:
        return f"each row is printed {own[0]} times"
    first, *others = (
        (name, " and ".join(map(str, sorted(set(found.columns[3 * k : 3 * k + 3])))))
        for k, name in enumerate(found.shares)
    )
    more = "".join(f", the {name}' for {rows}" for name, rows in others)
    return f"the {first[0]}' values hold for {first[1]} rows{more}"


def _refuse(name: str, found: Holds) -> None:
    """Raise the InputError for rows that are held irregularly."""
    shares = ", ".join(f"{triad} {share:.0%}" for triad, share in found.shares.items())
    about = (
        f"of {name} repeat the values of the row before ({shares}), more than chance makes them "
        "and not regularly: the logger is faster than the sensor, and the noise would look "
        "stronger than it is"
    )
    advice = (
        "log.repeats=drop leaves them out"
        if found.can_drop
        else "gyros and accelerometers have rates of their own, or counts too coarse to tell a "
        "repeat from a sample: log each sample once"
    )
    raise InputError(
        "log.repeats", f"{max(found.shares.values()):.0%} of the rows", "",
        f"{about}; {advice}, log.repeats=keep reads each row as a sample",
    )  # fmt: skip
