"""From when to when a log rests: its longest stretch in which nothing moves."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lbgc.data.readers.blocks import ROWS, blocks

_BLOCK_S = 1.0
"""Length of the blocks that are judged, s."""
_FEWEST = 16
"""Blocks below which nothing is judged."""
_LOUD = 4.0
"""The noise of a block over the usual one from which on it moves."""
_FAR = 8.0
"""Distance of a block's mean from the stretch's, in standard deviations of quiet blocks, from which
on it moves."""
_BLIP = 3
"""Blocks that a knock takes, at most, without ending a stretch."""
_TURNS = 0.03
"""Share of the fastest motion's rate by which the rates of two rests differ at most."""
_SHAKES = 0.5
"""The turn that a knock leaves, over the noise within it, at most."""
_ANOTHER = float(np.cos(np.deg2rad(10.0)))
"""Cosine of the angle between the forces of two rests from which on they are two attitudes."""
_MOST = 0.02
"""The share of the log that the rest must lack for it to be cut."""


@dataclass(frozen=True)
class Stretch:
    """Where a log rests."""

    first: int
    """The first row"""
    last: int
    """The row after the last one"""
    moving_s: float
    """How long it moves in the whole log, s"""
    rests: tuple[tuple[int, int], ...] = ()
    """Every stretch of rest, as its first row and the row after its last, where there are more"""


def rest(gyro: np.ndarray, accel: np.ndarray, rate_hz: float) -> Stretch:
    """The longest stretch of rest. gyro, accel : (T, 3), in any unit, or (T, 0) where one was not
    recorded; rate_hz : Hz."""
    gyro, accel = gyro if gyro.shape[1] else accel, accel if accel.shape[1] else gyro
    size = max(1, round(_BLOCK_S * rate_hz))
    count = len(gyro) // size
    whole = Stretch(0, len(gyro), 0.0)
    if count < _FEWEST:
        return whole
    rate, noise = _means(gyro, size, count)
    still = _quiet(rate, noise) & _quiet(*_means(accel, size, count))
    moves = ~still
    if not moves.any():
        return whole
    runs = _joined(_at_rest(_runs(still), rate), rate, noise)
    first, last = max(runs, key=lambda run: run[1] - run[0], default=(0, count))
    if last - first > (1 - _MOST) * count:
        return Stretch(0, len(gyro), float(moves.sum()) * size / rate_hz)
    end = len(gyro) if last == count else last * size
    rests = tuple((a * size, len(gyro) if b == count else b * size) for a, b in runs)
    return Stretch(first * size, end, float(moves.sum()) * size / rate_hz, rests)


def attitudes(accel: np.ndarray, still: Stretch) -> int:
    """In how many different attitudes it rests one after the other: stretches whose mean force
    points another way than in the one before, and one. accel : (T, 3), in any unit."""
    means = [accel[first:last].mean(axis=0) for first, last in still.rests]
    ways = [mean / max(float(np.linalg.norm(mean)), 1e-300) for mean in means]
    return 1 + sum(float(one @ other) < _ANOTHER for one, other in pairwise(ways))


def _means(values: np.ndarray, size: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The means of blocks of so many of the values (T, 3), and the standard deviations within them,
    (count, 3) each; of single values, that from the one before."""
    mean, noise = (np.empty((count, values.shape[1])) for _ in range(2))
    for own in blocks(count, max(1, ROWS // size)):
        part = values[own.start * size : own.stop * size].reshape(-1, size, values.shape[1])
        mean[own], noise[own] = part.mean(axis=1), part.std(axis=1)
    return mean, noise if size > 1 else np.abs(np.diff(mean, axis=0, prepend=0))


def _quiet(mean: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Whether blocks are as quiet as most, and their means (K, 3) where most are: (K,). noise :
    (K, 3), within them.

    The usual noise is the lower quartile's, so that a log which moves half of the time is judged by
    its rest. Slow noise lets means wander; blocks close in time are compared, not all with one.
    """
    usual = np.quantile(noise, 0.25, axis=0)
    usual = np.where(usual > 0, usual, noise.mean(axis=0))
    loud = np.any(noise > _LOUD * usual + 1e-300, axis=1)
    steps = np.linalg.norm(np.diff(mean, axis=0), axis=1)
    quiet = np.median(steps[~loud[1:]]) if (~loud[1:]).any() else np.median(steps)
    jumps = np.concatenate([[False], steps > _FAR * quiet + 1e-300])
    return np.asarray(~(loud | jumps))


def _at_rest(runs: list[tuple[int, int]], rate: np.ndarray) -> list[tuple[int, int]]:
    """The stretches without those of an even turn: their mean rates differ from that of the stretch
    which turns least, by a share of the fastest motion. rate : (K, 3), means of blocks."""
    means = [rate[first:last].mean(axis=0) for first, last in runs]
    if len(means) < 2:
        return runs
    rest = min(means, key=lambda mean: float(np.linalg.norm(mean)))
    most = _TURNS * float(np.linalg.norm(rate - rest, axis=1).max())
    near = (float(np.linalg.norm(mean - rest)) < most for mean in means)
    return [run for run, is_near in zip(runs, near, strict=True) if is_near]


def _runs(still: np.ndarray) -> list[tuple[int, int]]:
    """Stretches of still blocks, (first, after the last)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _joined(
    runs: list[tuple[int, int]], rate: np.ndarray, noise: np.ndarray
) -> list[tuple[int, int]]:
    """The stretches with those joined that single knocks part: a knock shakes, and leaves no turn
    behind it. rate, noise : (K, 3), means of blocks and standard deviations within them."""
    joined: list[tuple[int, int]] = []
    for first, last in runs:
        if joined and first - joined[-1][1] <= _BLIP:
            begin, end = joined[-1]
            turn = (rate[end:first] - rate[begin:end].mean(axis=0)).sum(axis=0)
            if np.linalg.norm(turn) < _SHAKES * np.linalg.norm(noise[end:first]):
                joined[-1] = (begin, last)
                continue
        joined.append((first, last))
    return joined
