"""Gyros and accelerometers that were recorded apart, in files or tables of their own: row by row
where they have one clock, and put on the slower one's samples where they have two.

The faster triad's angle (or velocity) is its cumulative sum, taken as linear within a sample. Its
mean over an interval of the slower one is the difference of that sum, which keeps the integral
exact. With r samples of the faster to one of the slower, at any phase, the white noise of such
means has the variance N^2/tau (1 - 1/(3 r)) and the covariance N^2/tau/(6 r) with its neighbour's,
where means over whole samples have N^2/tau and none; over m of them the Allan variance is
N^2/tau (1 - 1/(2 r m)). So N is the same over long times only, and a fit takes each triad's own
samples.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lbgc.data.readers.blocks import ROWS, blocks
from lbgc.data.readers.clock import since_first
from lbgc.data.readers.raw import Raw
from lbgc.data.readers.timing import EvenPieces
from lbgc.data.record import Record, TriadRecord
from lbgc.errors import InputError, require

_ONE_RATE = 0.02
"""The relative difference of rates up to which the gyros' samples are kept, which see north."""
_TOGETHER = 0.5
"""The share of a sample up to which the stamps of two rows may differ that are taken as one."""
_BESIDE = ("plate_angle", "temperature")
"""Fields that have a value for each of the gyros' samples."""
_HEAD = 1000
"""Rows in which empty cells are looked for."""
_OFTEN = 0.1
"""The share of rows without one triad from which on its cells are empty on purpose."""
_ON_TIME = 2.0
"""Samples of the slower triad by which an even clock may be off its stamps on a turning plate."""


def in_rows(gyro: Raw, accel: Raw) -> Raw | None:
    """The two triads as one recording, row by row, where their rows are of the same instants; None
    where these differ. Raises InputError where a clock is missing by which they could be told."""
    rows, others = len(gyro.gyro), len(accel.accel)
    note = None
    if gyro.stamps is None or accel.stamps is None:
        if rows != others:
            key = "time_column" if gyro.stamps is None else "accel_time_column"
            about = f"must be given: the gyros have {rows} rows, the accelerometers {others}, and "
            about += "rows of the same instants are told by the time"
            raise InputError(f"log.{key}", getattr(gyro.config, key), "", about)
        note = f"one clock: rows of {gyro.name} and {accel.name} were taken as of the same instants"
    else:
        off = _apart(gyro, accel)
        if off is None or gyro.config.accel_late_s:
            return None
        if off > 0:
            note = (
                f"one clock: stamps of {gyro.name} and {accel.name} differ by up to {off:.2g} of "
            )
            note += "a sample, and were taken as one, row by row"
    config = replace(gyro.config, accel_unit=accel.config.accel_unit)
    notes = dict.fromkeys((*gyro.notes, *accel.notes, *([note] if note else [])))
    return replace(gyro, accel=accel.accel, config=config, notes=tuple(notes))


def _apart(gyro: Raw, accel: Raw) -> float | None:
    """The largest difference of the stamps of two triads' rows, in samples; None where these are
    not one for one of the same instants."""
    one, other = gyro.stamps, accel.stamps
    assert one is not None
    assert other is not None
    if len(one) != len(other) or (gyro.said.unit, gyro.said.column) != (
        accel.said.unit, accel.said.column,
    ):  # fmt: skip
        return None
    step = abs(float(one[-1] - one[0])) / max(1, len(one) - 1)
    off = max(float(np.abs(one[own] - other[own]).max()) for own in blocks(len(one)))
    return off / step if step > 0 and off < _TOGETHER * step else 0.0 if off == 0 else None


def interleaved(raw: Raw) -> tuple[Raw, Raw] | None:
    """The two triads of a table each of whose rows has one of them, and empty cells for the other;
    None where it is no such table."""
    head = np.isnan(raw.gyro[:_HEAD]).any() or np.isnan(raw.accel[:_HEAD]).any()
    if raw.stamps is None or not head:
        return None
    lacks = {part: np.isnan(getattr(raw, part)) for part in ("gyro", "accel")}
    whole = {part: ~own.any(axis=1) for part, own in lacks.items()}
    apart = all((own.all(axis=1) | whole[part]).all() for part, own in lacks.items())
    often = min(own.mean() for own in whole.values()) < 1 - _OFTEN
    if not apart or not often or not (whole["gyro"] | whole["accel"]).all():
        return None
    gyros, accels = whole["gyro"], whole["accel"]
    one = replace(
        _rows_beside(raw, gyros),
        stamps=raw.stamps[gyros],
        gyro=raw.gyro[gyros],
        accel=np.empty((int(gyros.sum()), 0)),
    )
    other = replace(
        raw,
        stamps=raw.stamps[accels],
        gyro=np.empty((int(accels.sum()), 0)),
        accel=raw.accel[accels],
        plate=None,
        heading=None,
        temperature=None,
    )
    return one, other


def _rows_beside(raw: Raw, kept: np.ndarray) -> Raw:
    """A file with these rows, (T,) bool, of the columns that stand beside the sensors'."""
    plate, heading, warmth = (
        None if column is None else column[kept]
        for column in (raw.plate, raw.heading, raw.temperature)
    )
    return replace(raw, plate=plate, heading=heading, temperature=warmth)


def start(raw: Raw, clock: EvenPieces, piece: slice) -> float:
    """The time, s, on the stamps' clock, at which the first sample's interval of a piece begins: by
    the median of its stamps' distances from an even clock. Raises InputError where the plate turns
    and its samples are not where an even clock has them."""
    assert raw.stamps is not None
    assert clock.unit_s is not None
    unit = clock.unit_s
    relative = since_first(raw.stamps)[0][piece]
    every = max(1, len(relative) // ROWS)
    late = relative[::every] * unit - np.arange(0, len(relative), every) / clock.rate_hz
    middle = float(np.median(late))
    config = raw.config
    if any(own is not None for own in (config.plate_column, config.positions, config.angles_deg)):
        off = float(np.quantile(np.abs(late - middle), 0.99)) * clock.rate_hz
        about = f"of {raw.name} is up to {off:.3g} samples off an even clock: where a plate turns, "
        about += "two clocks are put on one another for logs without lost samples only"
        require(off < _ON_TIME, "log.accel_path", "time", about)
    return float(raw.stamps[0]) * unit + middle - 1 / clock.rate_hz


def temperature_of(
    samples: int,
    rate_hz: float,
    begun: float,
    gyros: Sequence[tuple[np.ndarray | None, float, float]],
) -> np.ndarray | None:
    """The temperature at the ends of samples of one clock, (samples,), on straight lines between
    those of the other: values, rate (Hz) and start (s) of each piece. None where it has none."""
    times, values = [], []
    for own, own_hz, start_s in gyros:
        if own is None:
            return None
        times.append(start_s + np.arange(1, len(own) + 1) / own_hz)
        values.append(own)
    ends = begun + np.arange(1, samples + 1) / rate_hz
    return np.asarray(np.interp(ends, np.concatenate(times), np.concatenate(values)))


def on_one_clock(
    gyro: TriadRecord,
    fields: Mapping[str, Any],
    gyro_start: float,
    accel: TriadRecord,
    accel_start: float,
) -> Record | None:
    """A recording on the samples of the slower triad, or of the gyros where the rates are alike;
    None where the two have less than two samples in common.

    fields : the gyros' record but for its samples; gyro_start, accel_start : s, of the first
    sample's interval.
    """
    grids = (gyro_start, gyro.rate_hz, len(gyro.values)), (
        accel_start, accel.rate_hz, len(accel.values),
    )  # fmt: skip
    keeps_gyro = accel.rate_hz > gyro.rate_hz * (1 - _ONE_RATE)
    slow, fast = grids if keeps_gyro else grids[::-1]
    first, last = _common(slow, fast)
    if last - first < 2:
        return None
    offset, ratio = (slow[0] - fast[0]) * fast[1], fast[1] / slow[1]  # in samples of the faster
    kept = slice(first, last)
    values = dict(fields)
    if keeps_gyro:
        means = _means(accel.values, offset, ratio, first, last)
        values |= {"gyro": gyro.values[kept], "accel": means}
        beside = {key: fields[key] for key in _BESIDE if fields[key] is not None}
        values |= {key: column[kept] for key, column in beside.items()}
    else:
        means = _means(gyro.values, offset, ratio, first, last)
        values |= {"gyro": means, "accel": accel.values[kept], "rate_hz": accel.rate_hz}
        ends = offset + ratio * np.arange(first + 1, last + 1) - 1  # the rows that end there
        rows = np.arange(len(gyro.values))
        beside = {key: fields[key] for key in _BESIDE if fields[key] is not None}
        values |= {key: np.interp(ends, rows, column) for key, column in beside.items()}
    begin, end = (slow[0] + at / slow[1] for at in (first, last))
    cut = max(begin - start for start, _, _ in grids)
    cut += max(start + count / rate - end for start, rate, count in grids)
    more = f"; {cut:.4g} s that one of them alone has were left out" if cut > 2 / slow[1] else ""
    note = _note(gyro, accel, keeps_gyro, ratio) + more
    return Record(
        **values | {"notes": tuple(dict.fromkeys((*fields["notes"], *accel.notes, note)))}
    )


def _note(gyro: TriadRecord, accel: TriadRecord, keeps_gyro: bool, ratio: float) -> str:
    """The note of what was averaged over what, and what that does to white noise. ratio : of the
    faster rate to the slower."""
    fast, slow = ("accelerometers", "gyros") if keeps_gyro else ("gyros", "accelerometers")
    lower = 1 - np.sqrt(1 - 1 / (3 * max(ratio, 1.0)))
    return (
        f"two clocks: the gyros of {gyro.name} have {gyro.rate_hz:.6g} Hz, the accelerometers of "
        f"{accel.name} {accel.rate_hz:.6g} Hz; the {fast} were averaged over the {slow}' intervals "
        f"by their stamps, where their white noise is up to {lower:.0%} lower from sample to "
        "sample and the same over longer times (a fit takes each triad's own samples)"
    )


def _common(slow: tuple[float, float, int], fast: tuple[float, float, int]) -> tuple[int, int]:
    """The first sample of the slower triad that lies within the faster's, and the one behind the
    last. slow, fast : start (s), rate (Hz) and number of samples."""
    begin, end = fast[0], fast[0] + fast[2] / fast[1]
    first = int(np.ceil((begin - slow[0]) * slow[1] - 1e-6))
    last = int(np.floor((end - slow[0]) * slow[1] + 1e-6))
    return max(0, first), min(slow[2], last)


def _means(values: np.ndarray, offset: float, ratio: float, first: int, last: int) -> np.ndarray:
    """Means, (last - first, 3), of values (T, 3) over intervals number `first` to `last`, the k-th
    from offset + k ratio to offset + (k + 1) ratio, in samples from the values' start."""
    found = np.empty((last - first, values.shape[1]))
    for own in blocks(last - first, max(1, int(ROWS / max(ratio, 1.0)))):
        at = offset + ratio * np.arange(first + own.start, first + own.stop + 1)
        at = np.clip(at, 0, len(values))
        low, high = int(at[0]), min(len(values), int(at[-1]) + 1)
        part = values[low:high]
        total = np.vstack([np.zeros(values.shape[1]), np.cumsum(part - part[0], axis=0)])
        whole = np.minimum(np.floor(at).astype(int) - low, len(part) - 1)
        sums = total[whole] + (at - low - whole)[:, None] * (part - part[0])[whole]
        found[own] = np.diff(sums, axis=0) / np.diff(at)[:, None] + part[0]
    return found
