"""Where shards are made: in this process, in other processes on this machine, or on a dask cluster.

A task is a whole shard, which depends on the configuration and its own number alone: whichever
worker makes it, and however often, the bytes are the same. Shards of a lost worker are made again.
"""

import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from multiprocessing import set_start_method
from typing import Any

from lbgc import cores, processes
from lbgc.errors import InputError, require, require_choice

_AHEAD = 4
"""Tasks that are handed out for each worker: as many as it takes for none to wait."""
_LOSSES = 3
"""Losses of workers in a row, with no shard finished in between, after which it is an error."""


@dataclass(frozen=True)
class ClusterConfig:
    """The choice of workers, which `conf/cluster/*.yaml` hold."""

    kind: str = "serial"
    """serial: this process; local: processes on this machine; dask: a scheduler that is running
    already."""
    workers: int | None = None
    """Number of processes of cluster=local; null: one a core."""
    address: str | None = None
    """Address of the dask scheduler."""

    def __post_init__(self) -> None:
        require_choice("kind", self.kind, ("serial", "local", "dask"))
        if self.workers is not None:
            good = self.kind == "local"
            require(good, "workers", self.workers, "is for cluster=local")
            require(self.workers > 0, "workers", self.workers, "must be greater than zero")
        if self.kind == "dask":
            where = "must be the scheduler's, like tcp://192.168.0.7:8786"
            require(self.address is not None, "address", self.address, where)
        else:
            require(self.address is None, "address", self.address, "is for cluster=dask")

    @property
    def processes(self) -> int:
        """The number of processes on this machine."""
        return (self.workers or cores.count()) if self.kind == "local" else 1

    @property
    def threads(self) -> int:
        """The number of threads for one task, on which no result depends. On a dask cluster it is
        one, since a task is one of many there."""
        return 1 if self.kind == "dask" else max(1, cores.count() // self.processes)


def finished(
    config: ClusterConfig, task: Callable[[int], object], shards: Sequence[int]
) -> Iterator[int]:
    """Run `task(shard)` for all shards; yields each shard when it is done.

    task : must be importable, its arguments too, since it is sent to other processes. Raises what a
    task raises, and InputError where there are no workers, or where workers keep being lost.
    """
    if config.kind == "dask":
        assert config.address is not None
        return _by_dask(config.address, task, shards)
    return _by_processes(config.processes, task, shards)


def _by_processes(
    workers: int, task: Callable[[int], object], shards: Sequence[int]
) -> Iterator[int]:
    """Run the tasks in processes on this machine, with a new pool after workers were lost."""
    waiting, begun, losses = iter(shards), dict[Future[object], int](), 0
    workers = max(1, min(workers, len(shards)))
    while True:
        try:
            with processes.pool(workers, _start_worker) as pool:
                # Uninterrupted, since Python lifts the mask to start its resource tracker.
                with processes.uninterrupted():
                    again = (*begun.values(), *islice(waiting, _AHEAD * workers - len(begun)))
                    begun = {pool.submit(task, shard): shard for shard in again}
                while begun:
                    for future in wait(begun, return_when=FIRST_COMPLETED).done:
                        future.result()
                        losses, shard = 0, begun.pop(future)
                        with processes.uninterrupted():
                            begun |= {pool.submit(task, own): own for own in islice(waiting, 1)}
                        yield shard
                return
        except BrokenProcessPool:
            losses += 1
            what = "workers keep being killed: is there memory enough for so many?"
            require(losses < _LOSSES, "cluster.workers", workers, what)


def _start_worker() -> None:
    """Prepare a worker: it may be told to end (SIGTERM) at any time, perhaps twice, and does so at
    once. So it must own nothing that outlives it. A lock, such as the compressor's, has no name
    from the start under the start method "fork" (no process is forked here), and a name to be
    removed under others.
    """
    set_start_method("fork", force=True)


def _by_dask(address: str, task: Callable[[int], object], shards: Sequence[int]) -> Iterator[int]:
    """Run the tasks on the dask cluster of the scheduler at this address."""
    try:
        from distributed import Client, KilledWorker
        from distributed.comm import CommClosedError
    except ImportError as error:
        what = "needs dask: pip install 'lbgc[dask]'"
        raise InputError("cluster", "dask", "", what) from error
    for name in list(logging.root.manager.loggerDict):  # each has a level of its own
        if name.startswith("distributed"):  # what is lost is said below, in one line
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        what = f"no dask scheduler answers ({error})"
        raise InputError("cluster.address", address, "", what) from error
    again = "what is finished stays good: run the same command again to go on"
    try:
        with client:
            yield from _handed_out(client, address, task, shards)
    except KilledWorker as error:
        what = f"its workers keep being killed: is there memory enough? {again}"
        raise InputError("cluster.address", address, "", what) from error
    except (CancelledError, CommClosedError) as error:
        raise InputError(
            "cluster.address", address, "", f"its scheduler is gone; {again}"
        ) from error


def _handed_out(
    client: Any, address: str, task: Callable[[int], object], shards: Sequence[int]
) -> Iterator[int]:
    """Run the tasks on dask, some ahead for each thread of the workers that there are by then. A
    scheduler keeps half a kilobyte and more of each task that it knows."""
    from distributed import as_completed
    from distributed.comm import CommClosedError

    waiting, begun, done = iter(shards), dict[Any, int](), as_completed()
    while True:
        try:
            threads = sum(client.nthreads().values())
        except OSError as error:  # a task's own errors of files stay what they are
            raise CommClosedError from error
        if not threads:
            print(f"the scheduler at {address} has no workers yet: waiting", file=sys.stderr)
        ahead = _AHEAD * max(1, threads)
        for shard in islice(waiting, ahead - len(begun)):
            future = client.submit(task, shard, pure=False, retries=_LOSSES - 1)
            begun[future] = shard
            done.add(future)
        if not begun:
            return
        for _ in range(max(1, len(begun) - ahead // 2)):
            future = next(done)
            future.result()
            yield begun.pop(future)
