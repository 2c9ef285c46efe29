"""An even clock behind a log's time stamps: its step, lost samples, long holes, and how far the
stamps scatter. Stamps may be rounded, repeated, written in bursts, late; samples are even."""

from dataclasses import dataclass

import numpy as np

_WIDE = 64
"""Samples over which a step is averaged, so that rounding and bursts average out."""
_NEAR = 0.3
"""How far stamps of an exact clock may be from whole numbers of steps, as a share of a step."""
_BACK = 2.5
"""Samples by which time must go back for it to be more than a late stamp before it."""
_VALUES_AT_ONCE = 1_000_000


@dataclass(frozen=True)
class Hole:
    """Samples that are missing between two rows."""

    row: int
    """The last row before it, counted from zero."""
    missing: int
    """How many samples are missing; negative where time goes back."""


@dataclass(frozen=True)
class Instants:
    """What stamps say of the samples, in the stamps' own unit of time."""

    step: float
    """Time between two samples of the even clock."""
    holes: tuple[Hole, ...]
    repeated: int
    """How many stamps repeat the one before."""
    scatter: float
    """Scatter of the stamps about the even clock, in steps, as a standard deviation (by their
    median)."""


def instants(stamps: np.ndarray) -> Instants:
    """The even clock that finite stamps (T,), T > 1, are of. A step of zero or less: none is.

    Where almost all steps are whole multiples of their median, a hole is told by its step. Else
    (rounded stamps, bursts, jitter) it is told by stamps that stay late after a long step: a burst
    is late and catches up.
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
    """The step to a percent or so, and over how many samples bursts or coarse stamps repeat."""
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
    """ratio : (T - 1,), steps over their median. None where the steps are no whole multiples."""
    whole = np.round(ratio)
    exact = (np.abs(ratio - whole) < _NEAR) & (whole >= 1)
    if np.mean(exact) < 0.99:
        return None
    # Rounded stamps of an even clock a little slower than they show: they skip one regularly.
    rows = np.flatnonzero(whole > 1)
    apart = np.diff(rows)
    if len(apart) > 2 and whole.max() == 2 and np.ptp(apart) <= max(2.0, 0.05 * apart.mean()):
        return ()
    # Where a step is no whole number, it is a late stamp or a hole: the next stamps tell.
    if not exact.all():
        return None
    return tuple(Hole(int(row), int(whole[row]) - 1) for row in rows)


def _holes_of_a_rough_clock(
    stamps: np.ndarray, steps: np.ndarray, step: float, period: int
) -> tuple[Hole, ...]:
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
    """Mean of the middle half of so many values, beginning at each of the rows, and the half's
    width: single stamps do not matter to it, and rounded ones average out."""
    start = np.clip(first, 0, len(late) - size)
    ordered = np.sort(late[start[:, None] + np.arange(size)], axis=1)
    middle = ordered[:, size // 4 : max(size // 4 + 1, size - size // 4)]
    return middle.mean(axis=1), middle[:, -1] - middle[:, 0]


def _end_of_run(compressed: np.ndarray) -> np.ndarray:
    """For each row (T - 1,) the first one from it on whose step is not compressed."""
    index = np.where(compressed, len(compressed), np.arange(len(compressed)))
    return np.asarray(np.minimum.accumulate(index[::-1])[::-1])


def _once(found: list[Hole], size: int) -> tuple[Hole, ...]:
    """Long steps close by one another see the same hole: the largest keeps it."""
    kept: list[Hole] = []
    for hole in found:
        if kept and hole.row - kept[-1].row <= size:
            if abs(hole.missing) > abs(kept[-1].missing):
                kept[-1] = hole
        else:
            kept.append(hole)
    return tuple(kept)


def _line(stamps: np.ndarray, holes: tuple[Hole, ...]) -> tuple[float, float]:
    """The step by least squares over every stretch between long holes, each with its own start,
    single stamps that are far off left out; and the scatter that is left, in steps."""
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
    square = float(x @ x)
    return float(x @ y) / square if square else 0.0
