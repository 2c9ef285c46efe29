"""The even clock behind a log's time stamps: its step, lost samples, long holes, and the scatter of
the stamps about it. Samples are taken as evenly spaced, while their stamps may be rounded,
repeated, late, or written in bursts."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from lbgc.data.readers.blocks import ROWS, blocks, some

_WIDE = 64
"""Samples over which a step is averaged, so that rounding and bursts average out."""
_NEAR = 0.3
"""The share of a step by which steps of an exact clock may differ from whole multiples of it."""
_BACK = 2.5
"""Samples by which time must go back before that is taken as more than a late stamp before it."""
_ENDLESS = 2.0**53
"""Samples that may be missing, at most."""
_THIN = 2**16
"""Rows of a block of a long log by which the scatter is told."""
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
    rough, period = _rough_step(stamps)
    repeated = int(np.count_nonzero(stamps[1:] == stamps[:-1]))
    if not rough > 0:
        return Instants(float(rough), (), repeated, 0.0)
    median = float(np.median(some(stamps[1:]) - some(stamps[:-1])))
    holes = None
    if median > 0 and abs(median / rough - 1) < 0.1:
        holes = _holes_of_an_exact_clock(stamps, median)
    if holes is None:
        holes = _holes_of_a_rough_clock(stamps, rough, period)
    step, scatter = _line(stamps, holes)
    return Instants(step, holes, repeated, scatter)


def _steps(stamps: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """The steps from stamp to stamp block by block, each with the number of those before it."""
    for own in blocks(len(stamps) - 1):
        yield own.start, np.diff(stamps[own.start : own.stop + 1])


def _rows(stamps: np.ndarray, which: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """The rows whose step to the next stamp is such as `which` says."""
    found = [first + np.flatnonzero(which(steps)) for first, steps in _steps(stamps)]
    return np.concatenate(found)


def _rough_step(stamps: np.ndarray) -> tuple[float, int]:
    """The step to about a percent, and the number of samples after which bursts or coarse stamps
    repeat their pattern (1 where there is none)."""
    wide, most = min(_WIDE, max(1, (len(stamps) - 1) // 4)), (len(stamps) - 1) // 2
    while True:
        step = float(np.median(some(stamps[wide:]) - some(stamps[:-wide]))) / wide
        if step != 0 or 2 * wide > most:
            break
        wide *= 2
    jumps = _rows(stamps, lambda steps: steps > 1.5 * step)
    apart = np.diff(jumps)
    period = int(np.median(apart)) if len(apart) > 1 else 1
    regular = len(apart) > 1 and np.mean(np.abs(apart - period) <= 1 + period // 20) > 0.8
    if not step > 0 or not regular or not 1 < period <= most:
        return step, 1
    wide = period * max(1, round(wide / period))
    return float(np.median(some(stamps[wide:]) - some(stamps[:-wide]))) / wide, period


def _holes_of_an_exact_clock(stamps: np.ndarray, median: float) -> tuple[Hole, ...] | None:
    """The holes of a clock whose steps are whole multiples of their median; None where they are
    not."""
    exact, rows, missing = 0, [], []
    for first, steps in _steps(stamps):
        ratio = steps / median
        whole = np.round(ratio)
        exact += int(np.count_nonzero((np.abs(ratio - whole) < _NEAR) & (whole >= 1)))
        long = np.flatnonzero(whole > 1)
        rows.append(first + long)
        missing.append(whole[long] - 1)
    row, gone = np.concatenate(rows), np.concatenate(missing)
    if exact < 0.99 * (len(stamps) - 1):
        return None
    # Rounded stamps of a clock that is a little slower than their median step skip one regularly,
    # which is no hole.
    apart = np.diff(row)
    if len(apart) > 2 and gone.max() == 1 and np.ptp(apart) <= max(2.0, 0.05 * apart.mean()):
        return ()
    # A step that is no whole multiple is a late stamp or a hole, which only later stamps can tell.
    if exact < len(stamps) - 1:
        return None
    return tuple(Hole(int(at), int(lost)) for at, lost in zip(row, gone, strict=True))


def _holes_of_a_rough_clock(stamps: np.ndarray, step: float, period: int) -> tuple[Hole, ...]:
    """The holes of a clock with rounded stamps, bursts or jitter: places where the stamps after a
    long step stay late compared with those before it. step, period : as `_rough_step` gives."""
    size = period * max(1, round(_WIDE / 2 / period))
    size = size if 2 * size < len(stamps) else len(stamps) // 2
    rows = _rows(stamps, lambda steps: (steps > 1.5 * step) | (steps < -0.5 * step))
    caught_up = _ends_of_runs(stamps, 0.5 * step)
    found = []
    at_once = max(1, _VALUES_AT_ONCE // size)
    for part in blocks(len(rows), at_once):
        before, one = _level(stamps, step, rows[part] - size + 1, size)
        start = caught_up(np.minimum(rows[part] + 1, len(stamps) - 2))
        after, other = _level(stamps, step, start, size)
        with np.errstate(over="ignore"):  # of stamps that no clock has
            shift = np.clip((after - before) / step, -_ENDLESS, _ENDLESS)
        certain = np.abs(shift) > 0.5 + 0.5 * np.maximum(one, other) / step
        certain &= (shift > 0) | (shift < -_BACK)
        missing = np.where(certain, np.round(shift), 0).astype(int)
        found += [Hole(int(r), int(m)) for r, m in zip(rows[part], missing, strict=True) if m]
    return _once(found, size)


def _level(
    stamps: np.ndarray, step: float, first: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """How late `size` stamps from each of the rows `first` on are against an even clock: the mean
    of the middle half, and that half's width. Single stamps do not affect it, and rounded ones
    average out."""
    start = np.clip(first, 0, len(stamps) - size)
    rows = start[:, None] + np.arange(size)
    ordered = np.sort(stamps[rows] - step * rows, axis=1)
    middle = ordered[:, size // 4 : max(size // 4 + 1, size - size // 4)]
    return middle.mean(axis=1), middle[:, -1] - middle[:, 0]


def _ends_of_runs(stamps: np.ndarray, short: float) -> Callable[[np.ndarray], np.ndarray]:
    """A function that gives, for rows (R,), the first row from each on whose step is not shorter
    than `short`."""
    rows = _rows(stamps, lambda steps: steps < short)
    begins = np.flatnonzero(np.diff(rows, prepend=-2) > 1)
    if not len(rows):
        return lambda which: which
    starts, ends = rows[begins], rows[np.append(begins[1:], len(rows)) - 1] + 1

    def of(which: np.ndarray) -> np.ndarray:
        run = np.searchsorted(starts, which, side="right") - 1
        within = (run >= 0) & (which < ends[run])
        return np.asarray(np.where(within, ends[run], which))

    return of


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
    long = [hole for hole in holes if hole.missing < 0 or hole.missing > 10]
    edges = np.array([hole.row + 1 for hole in long], int)
    rows = np.array([0, *(hole.row + 1 for hole in holes if hole not in long)])
    lost = np.cumsum([0, *(hole.missing for hole in holes if hole not in long)])
    size, of_x, of_y = (np.zeros(len(edges) + 1) for _ in range(3))

    def parts() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """The samples' numbers, their stamps and their stretches, block by block."""
        for own in blocks(len(stamps)):
            k = np.arange(own.start, own.stop)
            counted = k + lost[np.searchsorted(rows, k, side="right") - 1]
            stretch = np.searchsorted(edges, k, side="right")
            yield counted.astype(float), stamps[own], stretch

    for k, t, stretch in parts():
        size += np.bincount(stretch, minlength=len(size))
        of_x += np.bincount(stretch, k, len(size))
        of_y += np.bincount(stretch, t, len(size))
    x_mean, y_mean = of_x / size, of_y / size

    def slope(old: float = 0.0, most: float = np.inf) -> float:
        """The least-squares slope, with stamps further than `most` from the line of the old slope
        put onto it; 0 where there is none."""
        square = product = 0.0
        for k, t, stretch in parts():
            x, y = k - x_mean[stretch], t - y_mean[stretch]
            if most < np.inf:
                y = np.where(np.abs(y - old * x) > most, old * x, y)
            square, product = square + float(x @ x), product + float(x @ y)
        return product / square if square else 0.0

    def scatter(step: float) -> float:
        """The median distance of stamps from the line of this slope."""
        most = ROWS if len(stamps) <= ROWS else _THIN
        thin = ([own[:most].copy() for own in part] for part in parts())
        k, t, stretch = (np.concatenate(own) for own in zip(*thin, strict=True))
        return float(np.median(np.abs(t - y_mean[stretch] - step * (k - x_mean[stretch]))))

    step = slope()
    if not step > 0:
        return step, 0.0
    step = slope(step, max(step, 6 * scatter(step)))
    return step, scatter(step) / 0.6745 / step
