"""The noise fit of all axes of a recording, side by side in processes of their own."""

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from queue import Empty
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np

from lbgc import cores
from lbgc.processes import pool, uninterrupted
from lbgc.sensor.fitting import resting_axis
from lbgc.sensor.fitting.noise_fit import Fit

Name: TypeAlias = tuple[str, int]
"""An axis: gyro or accel, and the axis's number"""
Say: TypeAlias = Callable[[Name, str], None]
"""Is told, for an axis, what is being tried"""
SMALL = 2_000_000
"""Number of samples, of all axes, below which starting processes costs more than it saves."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_messages: Any = None
"""In a worker, the queue to which it writes what is being tried."""


def fitted(
    series: Mapping[Name, np.ndarray],
    dt: float,
    corners: tuple[float, float],
    processes: int | None = None,
    say: Say = lambda name, what: None,
) -> Iterator[tuple[Name, Fit]]:
    """Fit each axis's series; yields each fit when it is done, in any order.

    series : (R, n) each, unit; dt : s; corners : s, of the bias instability's floor; processes :
    how many work side by side, None for one a core (and for this process alone where the series are
    short); say(name, what) is told what is being tried. No result depends on the number of
    processes.
    """
    small = sum(one.size for one in series.values()) < SMALL
    workers = processes or (1 if small else cores.count())
    workers = min(workers, len(series))
    if workers == 1 and small:  # a process of its own keeps apart what a long one takes
        for name, one in series.items():
            alone = np.ascontiguousarray(one)
            yield name, _fit(alone, dt, corners, lambda what, name=name: say(name, what))  # type: ignore[misc]
        return
    said = get_context("spawn").Queue()
    with (
        TemporaryDirectory(prefix="lbgc_") as home,
        _one_thread_each(),
        pool(workers, _start, said) as own,
    ):
        begun: dict[Future[Fit], Name] = {}
        for name, one in series.items():  # through files: a queue would hold them twice
            file = Path(home) / f"{len(begun)}.npy"
            np.save(file, one)
            with uninterrupted():
                begun[own.submit(_task, name, file, dt, corners)] = name
        yield from _finished(begun, said, say)


def _finished(begun: dict[Future[Fit], Name], said: Any, say: Say) -> Iterator[tuple[Name, Fit]]:
    """The fits as they are done, with the workers' messages passed on to `say` meanwhile."""
    left = set(begun)
    while left:
        done, left = wait(left, timeout=0.5, return_when=FIRST_COMPLETED)
        try:
            while True:
                say(*said.get_nowait())
        except Empty:
            pass
        for future in done:
            yield begun[future], future.result()


def _fit(
    series: np.ndarray, dt: float, corners: tuple[float, float], say: Callable[[str], None]
) -> Fit:
    """Fit one axis in this process."""
    return resting_axis.fitted(series, dt, corners, say)


def _task(name: Name, file: Path, dt: float, corners: tuple[float, float]) -> Fit:
    """Fit one axis, whose series is in a file, in a worker."""
    series = np.ascontiguousarray(np.load(file))
    file.unlink()
    return _fit(series, dt, corners, lambda what: _messages.put((name, what)))


def _start(said: Any) -> None:
    """Give a new worker the queue of messages."""
    global _messages
    _messages = said


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """A context in which processes that are started do their linear algebra with one thread each:
    side by side, threads that wait for each other by spinning take the cores from those that
    work."""
    before = {key: os.environ.get(key) for key in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                del os.environ[key]
            else:
                os.environ[key] = value
