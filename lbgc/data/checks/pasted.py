"""Detection of stretches of a recording that occur in it twice, equal to the last digit."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lbgc.data.readers.blocks import ROWS, blocks

_ODD = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9,
     0xD6E8FEB86659FD93, 0xA0761D6478BD642F, 0xE7037ED1A0B428DB], dtype=np.uint64
)  # fmt: skip
"""Odd factors, one for each channel, by which a row is hashed."""
_RADIX = np.uint64(0x2545F4914F6CDD1D)
"""Radix of the hash of consecutive rows."""
_FEWEST_ROWS = 10
"""Rows of a stretch, at least."""
_LONGEST_ROWS = 2000
"""Rows up to which chance is still excluded; where more are needed nothing is looked for."""
_SEED_ROWS = 5
"""Rows that must be equal for a stretch to be looked for, to begin with."""
_SOME = 50_000
"""Rows, about, from which the frequencies of a channel's values are taken."""
_BY_CHANCE = 20
"""Stretches of a length that chance may leave. Chance never reaches four times that length."""
_GROUPS, _AT_ONCE = 32, 2**16
"""Groups of windows that are put in order by themselves in a long recording; and rows that are
hashed at once."""
_TIMES_CHANCE = 4
"""That factor of length."""


@dataclass(frozen=True)
class Pasted:
    """A stretch of rows that occurs twice."""

    first: int
    """Row at which it begins"""
    again: int
    """Row at which it begins the second time"""
    rows: int
    """Number of rows"""


def pasted(*parts: np.ndarray) -> list[Pasted]:
    """The stretches of a recording that repeat an earlier one, longest first.

    parts : (T, C) each, its columns side by side. A stretch must be so long that it is not repeated
    by chance: rows of coarse counts are equal more often than others, and counts that carry their
    remainder over nearly repeat themselves. A stretch that does not change, or repeats itself row
    by row, does not count.
    """
    n = len(parts[0])
    enough = _enough(parts)
    if enough is None or n < 2 * enough:
        return []
    hashes, seed, before = _row_hashes(parts), _SEED_ROWS, n
    found = _repeated(hashes, seed, enough)
    # Longer seeds are tried until few stretches are left, or longer seeds leave no fewer.
    while len(found) > _BY_CHANCE and not (seed >= enough and len(found) > before / 2):
        seed, before = 2 * seed, len(found)
        if seed > _LONGEST_ROWS or n < 2 * seed:
            return []
        found = _repeated(hashes, seed, enough)
    return [one for one in found if one.rows >= max(enough, _TIMES_CHANCE * seed)]


def _repeated(hashes: np.ndarray, seed: int, enough: int) -> list[Pasted]:
    """The stretches of at least `seed` rows that occur twice, `enough` rows or more apart."""
    first, again = _pairs(hashes, seed, max(seed, enough))
    return _stretches(first, again, seed)


def _pairs(hashes: np.ndarray, seed: int, apart: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of rows at which the same `seed` rows begin, at least `apart` rows apart."""
    sums = _sums(hashes, seed)
    groups = 1 if len(sums) <= ROWS else _GROUPS
    byte = sums.view(np.uint8).reshape(-1, 8)[:, 0] % groups
    firsts, agains = [], []
    for group in range(groups):  # equal sums are in one group, which is put in order by itself
        own = np.flatnonzero(byte == group)
        order = own[np.argsort(sums[own], kind="stable")]
        alike = sums[order[1:]] == sums[order[:-1]]
        first, again = order[:-1][alike], order[1:][alike]
        far = again - first >= apart
        firsts.append(first[far])
        agains.append(again[far])
    return np.concatenate(firsts), np.concatenate(agains)


def _enough(parts: Sequence[np.ndarray]) -> int | None:
    """The number of consecutive rows that are not repeated by chance; None where rows hardly
    differ, or where that is more than the longest."""
    n = len(parts[0])
    alike = 1.0
    some = np.hstack([values[:: max(1, n // _SOME)] for values in parts])
    for column in some.T:
        counts = np.unique(column, return_counts=True)[1]
        alike *= max(float(np.sum((counts / len(some)) ** 2)), 1 / len(some))
    own = np.ones(n - 1, bool)
    for values in parts:
        own &= (values[1:] == values[:-1]).all(axis=1)
    alike = max(
        alike, float(own.mean())
    )  # neighbouring rows may be equal more often than rows far apart
    if alike > 0.9:
        return None
    chance = 2 * np.log(n) + np.log(1e7)
    rows = max(_FEWEST_ROWS, int(np.ceil(2 * chance / -np.log(alike))))
    return rows if rows <= _LONGEST_ROWS else None


def _row_hashes(parts: Sequence[np.ndarray]) -> np.ndarray:
    """A hash of each row, (T,), uint64."""
    made = np.empty(len(parts[0]), np.uint64)
    for rows in blocks(len(made), _AT_ONCE):
        values = np.hstack([own[rows] for own in parts])
        bits = (np.ascontiguousarray(values, dtype=np.float64) + 0.0).view(np.uint64)
        mixed = (bits ^ (bits >> np.uint64(29))) * _ODD[: values.shape[1]]
        mixed ^= mixed >> np.uint64(32)
        made[rows] = (mixed * _ODD[0]).sum(axis=1, dtype=np.uint64)
    return made


def _sums(rows: np.ndarray, length: int) -> np.ndarray:
    """A hash of each `length` consecutive rows, (T - length + 1,): the sum of h[k + j] radix^j
    modulo 2^64."""
    inverse = np.uint64(pow(int(_RADIX), -1, 1 << 64))
    most = min(len(rows), _AT_ONCE + length) - 1
    power = np.cumprod(np.r_[np.uint64(1), np.full(most, _RADIX)], dtype=np.uint64)
    back = np.cumprod(np.r_[np.uint64(1), np.full(most, inverse)], dtype=np.uint64)
    made = np.empty(len(rows) - length + 1, np.uint64)
    for at in blocks(len(made), _AT_ONCE):
        own = rows[at.start : at.stop + length - 1]
        total = np.r_[np.uint64(0), np.cumsum(own * power[: len(own)], dtype=np.uint64)]
        made[at] = (total[length:] - total[:-length]) * back[: at.stop - at.start]
    return made


def _stretches(first: np.ndarray, again: np.ndarray, length: int) -> list[Pasted]:
    """Stretches, longest first, from pairs of equal windows of `length` rows: windows that follow
    each other at one distance are joined."""
    if len(first) == 0:
        return []
    order = np.lexsort((first, again - first))
    first, lag = first[order], (again - first)[order]
    cut = np.flatnonzero((np.diff(first) > 1) | (np.diff(lag) != 0)) + 1
    starts, ends = np.r_[0, cut], np.r_[cut, len(first)]
    found = [
        Pasted(int(first[a]), int(first[a] + lag[a]), int(first[b - 1] - first[a]) + length)
        for a, b in zip(starts, ends, strict=True)
    ]
    return sorted(found, key=lambda stretch: -stretch.rows)
