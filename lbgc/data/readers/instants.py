"""The even clock behind a log's time stamps: its step, lost samples, long holes, and the scatter of
the stamps about it. Samples are taken as evenly spaced, while their stamps may be rounded,
repeated, late, or written in bursts."""

from dataclasses import dataclass

import numpy as np

_WIDE = 64
"""Samples over which a step is averaged, so that rounding and bursts average out."""
_NEAR = 0.3
"""The share of a step by which steps of an exact clock may differ from whole multiples of it."""
_BACK = 2.5
"""Samples by which time must go back before that is taken as more than a late stamp before it."""
_VALUES_AT_ONCE = 1_000_000
"""Values that are sorted in one go, which bounds the memory."""


@dataclass(frozen=True)
class Hole:
    """A hole in a log: samples that are missing between two rows."""

    row: int
    """The last row before the hole, counted from zero"""
    missing: int
    """Number of missing samples; negative where time goes back"""


@dataclass(frozen=True)
class Instants:
    """The even clock of a log, in the stamps' own unit of time."""

    step: float
    """Time between two samples of the even clock"""
    holes: tuple[Hole, ...]
    """Where samples are missing"""
    repeated: int
    """Number of stamps that repeat the one before"""
    scatter: float
    """Standard deviation of the stamps about the even clock, in steps (from their median)"""


def instants(stamps: np.ndarray) -> Instants:
    """Find the even clock behind finite stamps (T,), T > 1. A step of zero or less means that there
    is none.

    Where almost all steps are whole multiples of their median, a hole shows in its step. Otherwise
    (rounded stamps, bursts, jitter) it shows in stamps that stay late after a long step; after a
    burst they catch up.
    """
    steps = np.diff(stamps)
    rough, period = _rough_step(stamps)
    if not rough > 0:
        return Instants(float(rough), (), int(np.sum(steps == 0)), 0.0)
    median = float(np.median(steps))
    holes = None
    if median > 0 and abs(median / rough - 1) < 0.1:
        holes = _holes_of_an_exact_clock(steps / median)
    if holes is None:
        holes = _holes_of_a_rough_clock(stamps, steps, rough, period)
    step, scatter = _line(stamps, holes)
    return Instants(step, holes, int(np.sum(steps == 0)), scatter)


def _rough_step(stamps: np.ndarray) -> tuple[float, int]:
    """The step to about a percent, and the number of samples after which bursts or coarse stamps
    repeat their pattern (1 where there is none)."""
    wide, most = min(_WIDE, max(1, (len(stamps) - 1) // 4)), (len(stamps) - 1) // 2
    while True:
        step = float(np.median(stamps[wide:] - stamps[:-wide])) / wide
        if step != 0 or 2 * wide > most:
            break
        wide *= 2
    jumps = np.flatnonzero(np.diff(stamps) > 1.5 * step)
    apart = np.diff(jumps)
    period = int(np.median(apart)) if len(apart) > 1 else 1
    regular = len(apart) > 1 and np.mean(np.abs(apart - period) <= 1 + period // 20) > 0.8
    if not step > 0 or not regular or not 1 < period <= most:
        return step, 1
    wide = period * max(1, round(wide / period))
    return float(np.median(stamps[wide:] - stamps[:-wide])) / wide, period


def _holes_of_an_exact_clock(ratio: np.ndarray) -> tuple[Hole, ...] | None:
    """The holes of a clock whose steps are whole multiples of their median; None where they are
    not. ratio : (T - 1,), steps over their median."""
    whole = np.round(ratio)
    exact = (np.abs(ratio - whole) < _NEAR) & (whole >= 1)
    if np.mean(exact) < 0.99:
        return None
    # Rounded stamps of a clock that is a little slower than their median step skip one regularly,
    # which is no hole.
    rows = np.flatnonzero(whole > 1)
    apart = np.diff(rows)
    if len(apart) > 2 and whole.max() == 2 and np.ptp(apart) <= max(2.0, 0.05 * apart.mean()):
        return ()
    # A step that is no whole multiple is a late stamp or a hole, which only later stamps can tell.
    if not exact.all():
        return None
    return tuple(Hole(int(row), int(whole[row]) - 1) for row in rows)


def _holes_of_a_rough_clock(
    stamps: np.ndarray, steps: np.ndarray, step: float, period: int
) -> tuple[Hole, ...]:
    """The holes of a clock with rounded stamps, bursts or jitter: places where the stamps after a
    long step stay late compared with those before it. step, period : as `_rough_step` gives."""
    size = period * max(1, round(_WIDE / 2 / period))
    size = size if 2 * size < len(stamps) else len(stamps) // 2
    rows = np.flatnonzero((steps > 1.5 * step) | (steps < -0.5 * step))
    late = stamps - step * np.arange(len(stamps))
    caught_up = _end_of_run(steps < 0.5 * step)
    found = []
    at_once = max(1, _VALUES_AT_ONCE // size)
    for first in range(0, len(rows), at_once):
        some = rows[first : first + at_once]
        before, one = _level(late, some - size + 1, size)
        start = caught_up[np.minimum(some + 1, len(steps) - 1)]
        after, other = _level(late, start, size)
        shift = (after - before) / step
        certain = np.abs(shift) > 0.5 + 0.5 * np.maximum(one, other) / step
        certain &= (shift > 0) | (shift < -_BACK)
        missing = np.where(certain, np.round(shift), 0).astype(int)
        found += [Hole(int(r), int(m)) for r, m in zip(some, missing, strict=True) if m]
    return _once(found, size)


def _level(late: np.ndarray, first: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """For `size` values from each of the rows `first` on, the mean of their middle half and that
    half's width. Single stamps do not affect it, and rounded ones average out."""
    start = np.clip(first, 0, len(late) - size)
    ordered = np.sort(late[start[:, None] + np.arange(size)], axis=1)
    middle = ordered[:, size // 4 : max(size // 4 + 1, size - size // 4)]
    return middle.mean(axis=1), middle[:, -1] - middle[:, 0]


def _end_of_run(compressed: np.ndarray) -> np.ndarray:
    """For each row (T - 1,), the first row from it on whose step is not compressed."""
    index = np.where(compressed, len(compressed), np.arange(len(compressed)))
    return np.asarray(np.minimum.accumulate(index[::-1])[::-1])


def _once(found: list[Hole], size: int) -> tuple[Hole, ...]:
    """The holes with only the largest kept of those within `size` rows, since long steps close to
    each other show the same hole."""
    kept: list[Hole] = []
    for hole in found:
        if kept and hole.row - kept[-1].row <= size:
            if abs(hole.missing) > abs(kept[-1].missing):
                kept[-1] = hole
        else:
            kept.append(hole)
    return tuple(kept)


def _line(stamps: np.ndarray, holes: tuple[Hole, ...]) -> tuple[float, float]:
    """The step by least squares over all stretches between long holes, each with its own start and
    without single stamps that are far off; and the scatter of the stamps, in steps."""
    k = np.arange(len(stamps), dtype=float)
    counted = k.copy()
    long = [hole for hole in holes if hole.missing < 0 or hole.missing > 10]
    for hole in holes:
        counted[hole.row + 1 :] += hole.missing if hole not in long else 0
    stretch = np.zeros(len(stamps), dtype=int)
    for hole in long:
        stretch[hole.row + 1 :] += 1
    size = np.bincount(stretch)
    x = counted - (np.bincount(stretch, counted) / size)[stretch]
    y = stamps - (np.bincount(stretch, stamps) / size)[stretch]
    step = _slope(x, y)
    if not step > 0:
        return step, 0.0
    off = np.abs(y - step * x)
    step = _slope(x, np.where(off > max(step, 6 * float(np.median(off))), step * x, y))
    return step, float(np.median(np.abs(y - step * x))) / 0.6745 / step


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    """The least-squares slope of a line through the origin; 0 where x is all zero."""
    square = float(x @ x)
    return float(x @ y) / square if square else 0.0
