"""Training batches that are drawn ahead, while the network takes the step before."""

import multiprocessing
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch.utils.data import DataLoader, Dataset

from lbgc import cores, processes
from lbgc.errors import InputError
from lbgc.learning.batches import Examples
from lbgc.sensor import streams

Batch: TypeAlias = tuple[np.ndarray, ...]
"""Features, float32 (W, T, C), and the angles that the network is to find, (W,), rad."""
_MOST_PROCESSES = 4
"""Most processes that draw. A small network's step takes a third of the time that its batch takes
to draw."""
_HOW = "fork" if sys.platform == "linux" else "spawn"
"""How they are started, whatever a launcher has set for its own."""


@dataclass(frozen=True)
class Batches(Dataset[Batch]):
    """The batch of each training step, by the step's number. Its random numbers depend on the seed
    and the first step that it is for alone, whichever process draws them and when."""

    source: Examples
    seed: int
    batch: int
    windows_steps: dict[float, int]
    echo: int = 1
    """Number of steps in a row that a batch is for."""

    def first(self, step: int) -> int:
        """The first step, counted from 1, that this step's batch is for."""
        return step - (step - 1) % self.echo

    def __getitem__(self, step: int) -> Batch:
        rng = streams.training(self.seed, self.first(step))
        length = self.windows_steps[float(rng.choice(list(self.windows_steps)))]
        return self.source.draw(rng, self.batch, length)


@contextmanager
def ahead(batches: Batches, steps: range, long_steps: bool) -> Iterator[Iterator[Batch]]:
    """An iterator over these steps' batches, in order.

    long_steps : whether steps take longer than their batches take to draw, as a recurrent network's
    do. They gain by every core, so one thread draws beside them. Otherwise processes draw, as many
    as there are cores left beside the one for the network's own arithmetic.
    """
    draws = range(batches.first(steps.start), steps.stop, batches.echo)
    processes = 0 if long_steps else _processes()
    # Threads that wait for each other's cores make small matrices several times as slow.
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(1) as thread:
        drawn = (
            _by_processes(processes, batches, draws)
            if processes > 0
            else _by_thread(thread, batches, draws)
        )
        yield _echoed(drawn, batches, draws, steps)


def _echoed(
    drawn: Iterator[Batch], batches: Batches, draws: range, steps: range
) -> Iterator[Batch]:
    """Each of these batches as often as there are steps that it is for."""
    for first, batch in zip(draws, drawn, strict=True):
        for _ in range(max(first, steps.start), min(first + batches.echo, steps.stop)):
            yield batch


def _processes() -> int:
    """Number of processes that draw; 0 in a daemonic process, which may start none."""
    if multiprocessing.current_process().daemon:
        return 0
    return min(_MOST_PROCESSES, cores.count() - 1)


def _by_processes(count: int, batches: Batches, draws: range) -> Iterator[Batch]:
    """Batches drawn by `count` processes, which end when this iterator is deleted, or when their
    parent is killed. Raises InputError where one of them is lost."""
    loader = DataLoader(
        batches,
        batch_size=None,
        sampler=draws,
        num_workers=count,
        collate_fn=_unchanged,  # no tensors: small ones take longer between processes
        worker_init_fn=_start,
        generator=torch.Generator(),  # for seeds that nothing uses; spares the global one
        multiprocessing_context=multiprocessing.get_context(_HOW),
    )
    with processes.uninterrupted():
        drawn = iter(loader)
    try:
        yield from drawn
    except RuntimeError as error:
        if not str(error).startswith("DataLoader worker"):
            raise
        what = "the processes that draw were killed: is there memory enough? run it again to go on"
        raise InputError("batch", batches.batch, "windows", what) from error


def _unchanged(batch: Any) -> Any:
    """The batch unchanged."""
    return batch


def _start(_: int) -> None:
    """Prepare a process that draws; it has one BLAS thread."""
    processes.serve()
    threadpool_limits(1, "blas")


def _by_thread(thread: ThreadPoolExecutor, batches: Batches, draws: range) -> Iterator[Batch]:
    """Batches that one thread draws, each while its predecessor is in use."""
    following = thread.submit(batches.__getitem__, draws[0]) if draws else None
    for step in draws:
        assert following is not None
        batch = following.result()
        if step + draws.step in draws:
            following = thread.submit(batches.__getitem__, step + draws.step)
        yield batch
