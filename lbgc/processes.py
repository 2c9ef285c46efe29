"""Processes that work for this one: they leave interruptions to it, and end when it does."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, connection, get_context, parent_process
from typing import Any

_DELAYED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_NOT_FOR_WORKERS = {signal.SIGINT, signal.SIGHUP}
"""What a terminal sends to all processes that were started from it."""
_LOOK_S = 1.0
"""Seconds between looks at whether the parent is still there."""


@contextmanager
def pool(
    workers: int, prepare: Callable[..., object] | None = None, *arguments: Any
) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes, each of which calls `prepare(*arguments)` first. An error inside the
    `with` block ends them at once: nobody waits for what was begun."""
    with uninterrupted():
        context = get_context("spawn")
        made = ProcessPoolExecutor(workers, context, _start, (prepare, arguments))
    try:
        yield made
    except BrokenProcessPool:
        raise
    except BaseException:
        with uninterrupted():
            for child in active_children():
                child.terminate()
        raise
    finally:
        with uninterrupted():
            made.shutdown(wait=True, cancel_futures=True)


def _start(prepare: Callable[..., object] | None, arguments: tuple[Any, ...]) -> None:
    """Prepare a worker of a pool."""
    serve()
    if prepare is not None:
        prepare(*arguments)


def serve() -> None:
    """Make this process a worker: it ignores interruptions, which its parent handles, and ends when
    its parent does, however that ends."""
    for number in _NOT_FOR_WORKERS:
        signal.signal(number, signal.SIG_IGN)
    end_with_parent()


def end_with_parent() -> None:
    """End this process a second after its parent, at the latest."""
    parent = parent_process()
    sentinels = [] if parent is None else [parent.sentinel]
    threading.Thread(target=_watch, args=(os.getppid(), sentinels), daemon=True).start()


def _watch(parent: int, sentinels: list[int]) -> None:
    """Wait until the parent has ended, then end this process. The sentinel tells at once, and of a
    parent that had ended before; but a forked process that came later may hold its other end."""
    while os.getppid() == parent and not connection.wait(sentinels, _LOOK_S):
        pass
    os._exit(1)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """A context that delays an interruption (SIGINT, SIGTERM, SIGHUP) to its end; processes that
    are started in it never get those that a terminal sends, because they inherit the signal mask.

    An interruption half-way through would make a pool lose a worker, or remove a semaphore without
    the knowledge of Python's resource tracker, which complains of each at the end.
    """
    before = {n: h for n in _DELAYED if callable(h := signal.getsignal(n))}
    if threading.current_thread() is not threading.main_thread() or not before:
        yield  # interruptions reach the main thread only, or are ignored, or end the process
        return
    came: list[int] = []
    for number in before:
        signal.signal(number, lambda number, _: came.append(number))
    masked = signal.pthread_sigmask(signal.SIG_BLOCK, _NOT_FOR_WORKERS & before.keys())
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
