"""How the bench takes time: two sides in turn, medians of their ratios."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import cases
from tqdm import tqdm

CASES = cases("bench", Path(__file__).parent)
_REPEATS, _LEAST, _ENOUGH = (CASES["timing"][key] for key in ("repeats", "least", "enough"))
Work = Callable[[], object]
Limit = tuple[Work, float]
"""What to hold the work against, and how much of it the work does."""


@dataclass(frozen=True)
class Against:
    """One side's rate over the other's."""

    ratio: float
    """By the clock on the wall, median over repetitions"""
    spread: float
    """Half the range of the middle half of the repetitions' ratios, relative"""
    cpu: float
    """The same ratio by the processor's time: what others on the machine do not change"""
    seconds: float
    """One run of the work, median"""


def seconds(work: Work) -> tuple[float, float]:
    """On the wall and of the processor, all threads of this process together."""
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - processor


def against(
    work: Work, limits: Sequence[Limit], name: str, repeats: int = _REPEATS
) -> list[Against]:
    """The work's rate over each limit's, all run in turn, and once before."""
    for side in (work, *(limit for limit, _ in limits)):
        side()
    own, theirs = [], []
    for _ in tqdm(range(repeats), name, leave=False, delay=1):
        before = [seconds(limit) for limit, _ in limits]
        own.append(seconds(work))
        after = [seconds(limit) for limit, _ in limits]
        theirs.append((np.array(before) + after) / 2)
    mine, found = np.array(own), []
    for (_, share), times in zip(limits, np.swapaxes(theirs, 0, 1), strict=True):
        ratios = share * times / mine
        low, middle, high = np.quantile(ratios[:, 0], (0.25, 0.5, 0.75))
        spread, cpu = (high - low) / 2 / middle, np.median(ratios[:, 1])
        found.append(
            Against(float(middle), float(spread), float(cpu), float(np.median(mine[:, 0])))
        )
    return found


def normals(count: int, generator: type[np.random.BitGenerator]) -> Work:
    """Drawing so many float32 normals, a recording's worth at a time."""
    rng = np.random.Generator(generator(1))  # type: ignore[abstract]
    buffer = np.empty(min(count, 864_000), np.float32)

    def work() -> None:
        for first in range(0, count, len(buffer)):
            part = buffer[: min(len(buffer), count - first)]
            rng.standard_normal(out=part, dtype=np.float32)

    return work


def floor(samples: int) -> Limit:
    """What every rate is held against: as many float32 normals from Philox; of many, some."""
    drawn = min(samples, _ENOUGH) if samples > _LEAST else _LEAST
    return normals(drawn, np.random.Philox), samples / drawn
