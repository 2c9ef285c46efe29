"""Who makes the shards: this process, others on this machine, or a dask cluster.

A task is a whole shard, which depends on the configuration and its own number alone: whoever makes
it, and however often, the bytes are the same. What a lost worker had begun is done again.
"""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import (
    active_children,
    connection,
    get_context,
    parent_process,
    set_start_method,
)

from lbgc import cores
from lbgc.errors import InputError, require, require_choice

_LOSSES = 3
"""Workers lost in a row, no shard finished in between, until it is no accident."""


@dataclass(frozen=True)
class ClusterConfig:
    """What `conf/cluster/*.yaml` hold."""

    kind: str = "serial"
    """serial; local: processes on this machine; dask: a scheduler that is running already."""
    workers: int | None = None
    """Processes of cluster=local; null: one a core."""
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
        return (self.workers or cores.count()) if self.kind == "local" else 1

    @property
    def threads(self) -> int:
        """Threads for one task; no number depends on it. On another's cluster a task is one of
        many."""
        return 1 if self.kind == "dask" else max(1, cores.count() // self.processes)


def finished(
    config: ClusterConfig, task: Callable[[int], object], shards: Sequence[int]
) -> Iterator[int]:
    """Have `task(shard)` done for all shards; yields each as it is done.

    task : importable, its arguments too, since it is sent to other processes. Raises what a task
    raises, and InputError where there are no workers, or where they keep getting lost.
    """
    if config.kind == "dask":
        assert config.address is not None
        return _by_dask(config.address, task, shards)
    return _by_processes(config.processes, task, shards)


def _by_processes(
    workers: int, task: Callable[[int], object], shards: Sequence[int]
) -> Iterator[int]:
    left, losses = list(shards), 0
    while left:
        with _uninterrupted():
            pool = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_start_worker)
        with _uninterrupted():  # anew: Python has lifted the mask to start its resource tracker
            futures = {pool.submit(task, shard): shard for shard in left}
        try:
            for future in as_completed(futures):
                future.result()
                left.remove(futures[future])
                losses = 0
                yield futures[future]
        except BrokenProcessPool:
            losses += 1
            what = "workers keep being killed: is there memory enough for so many?"
            require(losses < _LOSSES, "cluster.workers", workers, what)
        except BaseException:
            # Whatever else: nobody waits for the shards that were begun.
            with _uninterrupted():
                for child in active_children():
                    child.terminate()
            raise
        finally:
            with _uninterrupted():
                pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """An interruption comes when the block is over; processes started in it never get one.

    Half-way through, the pool would lose a worker, or remove a semaphore and not say so: at the
    end Python's resource tracker complains of each. The mask is what a started process inherits.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield  # interruptions reach the main thread alone, or nobody, or end the process
        return
    came: list[bool] = []
    signal.signal(signal.SIGINT, lambda *_: came.append(True))
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


def _start_worker() -> None:
    """An interruption is the parent's to handle; with a parent that is killed a worker ends too.

    A worker is told to end (SIGTERM) at any time, perhaps twice, and does so at once. So it must
    own nothing that outlives it: a lock (the compressor's) has no name from its first moment on
    where processes are forked, of which there are none, and a name to be removed otherwise.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    set_start_method("fork", force=True)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)


def _by_dask(address: str, task: Callable[[int], object], shards: Sequence[int]) -> Iterator[int]:
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        what = "needs dask: pip install 'lbgc[dask]'"
        raise InputError("cluster", "dask", "", what) from error
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        what = f"no dask scheduler answers ({error})"
        raise InputError("cluster.address", address, "", what) from error
    with client:
        futures = dict(zip(client.map(task, shards, pure=False, retries=2), shards, strict=True))
        for future in as_completed(futures):
            future.result()
            yield futures[future]
