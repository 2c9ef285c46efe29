"""Batches of the steps to come, drawn while a network takes the step before."""

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch.utils.data import DataLoader, Dataset

from lbgc import cores
from lbgc.learning.batches import Examples
from lbgc.sensor import streams

Batch: TypeAlias = tuple[np.ndarray, ...]
"""Input, float32 (W, T, C), and what is to be found, (W,), rad."""
_MOST_PROCESSES = 4
"""A small network's step takes a third of the time that its batch takes to draw."""


@dataclass(frozen=True)
class Batches(Dataset[Batch]):
    """What each step is given. A step's numbers are its own, whoever draws them and when."""

    source: Examples
    seed: int
    batch: int
    windows_steps: dict[float, int]

    def __getitem__(self, step: int) -> Batch:
        rng = streams.training(self.seed, step)
        length = self.windows_steps[float(rng.choice(list(self.windows_steps)))]
        return self.source.draw(rng, self.batch, length)


@contextmanager
def ahead(batches: Batches, steps: range, long_steps: bool) -> Iterator[Iterator[Batch]]:
    """These steps' batches, one after the other.

    long_steps : of a recurrent network. They gain by every core, and hide what a thread draws
    beside them. Others take less time than their batches: processes draw, as many as there are
    cores left beside the one for the network's own arithmetic.
    """
    processes = 0 if long_steps else _processes()
    # Threads that wait for each other's cores make small matrices several times as slow.
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(1) as thread:
        yield (
            _by_processes(processes, batches, steps)
            if processes > 0
            else _by_thread(thread, batches, steps)
        )


def _processes() -> int:
    """None inside a process that may have none."""
    if multiprocessing.current_process().daemon:
        return 0
    return min(_MOST_PROCESSES, cores.count() - 1)


def _by_processes(count: int, batches: Batches, steps: range) -> Iterator[Batch]:
    """Batches that processes draw, which end when this iterator is let go, or when their parent is
    killed."""
    return iter(
        DataLoader(
            batches,
            batch_size=None,
            sampler=steps,
            num_workers=count,
            collate_fn=_as_it_is,  # small tensors take longer from one process to another
            worker_init_fn=_alone,
            generator=torch.Generator(),  # of seeds that nothing uses: the global one stays
        )
    )


def _as_it_is(batch: Any) -> Any:
    return batch


def _alone(_: int) -> None:
    threadpool_limits(1, "blas")


def _by_thread(thread: ThreadPoolExecutor, batches: Batches, steps: range) -> Iterator[Batch]:
    following = thread.submit(batches.__getitem__, steps[0]) if steps else None
    for step in steps:
        assert following is not None
        batch = following.result()
        if step + 1 in steps:
            following = thread.submit(batches.__getitem__, step + 1)
        yield batch
