"""Detection of sensors that are slower than their logger, which prints a sample again until the
next one comes.

Values repeat by chance as well, where counts are coarse. The two are told apart by how often all
axes repeat together: by chance that is the product of how often each one does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FEWEST_CHANGES = 20
"""Changes of a column below which its pattern tells nothing."""
_MOST = 1000
"""Rows for which a sample is held, at most."""
_ALIKE = 0.98
"""The share of runs of equal values that must be whole multiples of one number of rows."""
_BLOCK = 256
"""Rows in a block in which repeats are counted."""
_SIGMAS = 5.0
"""Standard errors by which joint repeats must exceed those by chance."""
LEAST_SHARE = 0.05
"""The share of rows that must be held irregularly for a refusal. A smaller share is harmless (a
share h makes white noise look stronger by 1 + h at low frequency)."""
_SHORTER = 0.3
"""The least excess of repeats one row apart over repeats two rows apart, as a share of what random
holds would make."""
_CHANCE = 0.01
"""The share of samples that may repeat by chance where repeats are to be dropped."""


@dataclass(frozen=True)
class Holds:
    """How the rows of a log's triads, gyros, accelerometers or both, repeat."""

    columns: tuple[int, ...]
    """The number of rows for which each column regularly holds a sample; 1 where it does not hold
    it"""
    shares: dict[str, float]
    """Share of rows at which each triad holds its sample irregularly, by its name in messages"""
    chance: float
    """Share of samples at which all columns repeat by chance"""

    @property
    def times(self) -> int:
        """The least number of rows that holds whole samples of every column."""
        return int(np.lcm.reduce(self.columns))

    @property
    def irregular(self) -> bool:
        """Whether so many rows are held irregularly that it matters."""
        return max(self.shares.values()) > LEAST_SHARE

    @property
    def can_drop(self) -> bool:
        """Whether dropping rows that repeat leaves the sensor's own samples."""
        together = max(self.shares.values()) - min(self.shares.values()) < 0.02
        return together and self.chance < _CHANCE and min(self.columns) == max(self.columns)


def holds(gyro: np.ndarray, accel: np.ndarray) -> Holds:
    """Find how the rows of two triads, (T, 3) each, or (T, 0) for one that was not recorded,
    repeat."""
    triads = {
        name: own for name, own in (("gyros", gyro), ("accelerometers", accel)) if own.shape[1]
    }
    columns = _regular([own[1:] == own[:-1] for own in triads.values()])
    shares = {
        name: _share(own) if set(columns[3 * k : 3 * k + 3]) == {1} else (0.0, 0.0)
        for k, (name, own) in enumerate(triads.items())
    }
    chance = float(np.prod([chance for _, chance in shares.values()]))
    return Holds(columns, {name: share for name, (share, _) in shares.items()}, chance)


def _regular(same: Sequence[np.ndarray]) -> tuple[int, ...]:
    """The number of rows for which each column holds a sample, from whether its values repeat, for
    each triad (T - 1, 3). A column that hardly changes is taken like the others."""
    found = [_times(~own[:, column]) for own in same for column in range(own.shape[1])]
    known = [times for times in found if times is not None]
    others = max(set(known), key=known.count) if known else 1
    return tuple(others if times is None else times for times in found)


def _times(changes: np.ndarray) -> int | None:
    """The number of rows for which a column holds a sample, from whether it changes at each row but
    the first, (T - 1,); None where changes are too few.

    The lengths of runs of equal values are whole multiples of that number, since samples may be
    equal by chance, except for a few where rows were lost.
    """
    count = int(np.count_nonzero(changes))
    if count < FEWEST_CHANGES:
        return None
    if np.count_nonzero(changes[1:] & changes[:-1]) > (1 - _ALIKE) * (count - 1):
        return 1  # too many change from one row to the next
    runs = np.diff(np.flatnonzero(changes))
    lengths, counts = np.unique(runs, return_counts=True)
    candidates = [int(n) for n in lengths if 1 < n <= _MOST]
    candidates += [d for n in candidates for d in range(2, n) if n % d == 0 and n <= 64]
    for times in sorted(set(candidates), reverse=True):
        if counts[lengths % times == 0].sum() >= _ALIKE * len(runs):
            return times
    return 1


def _share(rows: np.ndarray) -> tuple[float, float]:
    """The share of rows at which the three columns (T, 3) are held together, and the share of the
    other rows at which all three repeat by chance.

    With a share h of holds, column j repeats with the share h + (1 - h) p_j and all three repeat
    with h + (1 - h) p_1 p_2 p_3. That is taken block by block, since means wander among counts, and
    solved for h over all blocks. Slow motion of all axes makes them repeat together, too, but then
    rows two apart are equal as often as rows one apart.
    """
    same = rows[1:] == rows[:-1]
    moving = same[:, same.mean(axis=0) < 0.999]
    blocks = len(moving) // _BLOCK
    if moving.shape[1] < 2 or blocks < 2:
        return 0.0, 1.0 if moving.shape[1] < 2 else float(same.all(axis=1).mean())
    cut = moving[: blocks * _BLOCK].reshape(blocks, _BLOCK, -1)
    each, together = cut.mean(axis=1), cut.all(axis=2).mean(axis=1)
    excess = together - each.prod(axis=1)
    sigma = excess.std(ddof=1) / np.sqrt(blocks)
    if not excess.mean() > _SIGMAS * sigma + 1e-9:
        return 0.0, float(together.mean())
    two_apart = float((rows[2:] == rows[:-2]).all(axis=1).mean())
    low, high = 0.0, float(together.mean())
    for _ in range(40):
        h = (low + high) / 2
        by_chance = np.clip((each - h) / (1 - h), 0, 1).prod(axis=1)
        if np.mean(together - h - (1 - h) * by_chance) > 0:
            low = h
        else:
            high = h
    if same.all(axis=1).mean() - two_apart < _SHORTER * low * (1 - two_apart):
        return 0.0, float(together.mean())
    return low, float(np.mean(np.clip((each - low) / (1 - low), 0, 1).prod(axis=1)))


def taken(rows: np.ndarray, found: Holds) -> np.ndarray:
    """The samples (about T // times, 6) behind rows (T, 6) that are held regularly.

    Where all columns are held for the same number of rows, they are the sensor's samples, each
    once. Otherwise they are means over as many rows as hold whole samples of every column, so that
    all columns are of the same time.
    """
    times = found.times
    if set(found.columns) == {times}:
        parts = _parts(rows, times)
        kept = [rows[_once_each(rows[:, part], times)][:, part] for part in parts]
        shortest = min(map(len, kept))
        values = np.empty((shortest, rows.shape[1]))
        for part, own in zip(parts, kept, strict=True):
            values[:, part] = own[:shortest]
        return values
    columns = []
    for column, own in enumerate(found.columns):
        values = rows[:, column]
        start = 0 if own == 1 else _phase(values, own)
        blocks = (len(values) - start) // times
        columns.append(values[start : start + blocks * times].reshape(blocks, times).mean(axis=1))
    shortest = min(map(len, columns))
    return np.stack([values[:shortest] for values in columns], axis=1)


def _parts(rows: np.ndarray, times: int) -> list[list[int]]:
    """The columns in groups that change at the same rows, of which there are several where the
    logger updates the axes in turn."""
    phases = [_phase(rows[:, c], times) for c in range(rows.shape[1])]
    return [[c for c in range(rows.shape[1]) if phases[c] == p] for p in dict.fromkeys(phases)]


def _phase(values: np.ndarray, times: int) -> int:
    """The row, modulo `times`, at which a column changes most often."""
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    return int(np.bincount(changes % times, minlength=times).argmax()) if len(changes) else 0


def _once_each(rows: np.ndarray, times: int) -> np.ndarray:
    """The rows at which samples begin in columns (T, C): at every change, and every `times` rows
    after it."""
    changes = np.flatnonzero((rows[1:] != rows[:-1]).any(axis=1)) + 1
    starts = np.concatenate([[0], changes])
    runs = np.diff(np.concatenate([starts, [len(rows)]]))
    count = np.maximum(1, np.round(runs / times).astype(int))
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.asarray(np.minimum(np.repeat(starts, count) + within * times, len(rows) - 1))


def dropped(rows: np.ndarray) -> np.ndarray:
    """Whether each of the rows (T, 6) differs from the one before, so that it is kept when repeats
    are dropped: (T,)."""
    return np.concatenate([[True], (rows[1:] != rows[:-1]).any(axis=1)])
