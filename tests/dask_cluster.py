"""A dask scheduler and its workers as processes of their own, as on a real cluster."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

WORKER = ("-m", "dask", "worker", "--nthreads", "1", "--no-nanny", "--no-dashboard",
          "--death-timeout", "30")  # fmt: skip


@contextmanager
def running(home: Path, workers: int) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """The scheduler's address, and the processes of the workers and, last, its own; all ended
    afterwards.

    home : of what they say and of the scheduler's file, which holds its address.
    """
    told = home / "scheduler.json"
    started: list[subprocess.Popen] = []

    def start(*arguments: str) -> subprocess.Popen:
        with (home / f"dask-{len(started)}.log").open("w") as log:
            command = [sys.executable, *arguments, "--scheduler-file", str(told)]
            environment = os.environ | {"DASK_DISTRIBUTED__WORKER__DAEMON": "False"}
            process = subprocess.Popen(command, stdout=log, stderr=log, cwd=home, env=environment)
        started.append(process)
        return process

    try:
        listening = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        scheduler = start("-m", "dask", "scheduler", *listening)
        while not told.exists() or not told.read_text().rstrip().endswith("}"):
            assert scheduler.poll() is None, (home / "dask-0.log").read_text()
            time.sleep(0.05)
        for _ in range(workers):
            start(*WORKER)
        address = next(p for p in told.read_text().split('"') if p.startswith("tcp://"))
        yield address, [*started[1:], scheduler]
    finally:
        for process in reversed(started):
            process.send_signal(signal.SIGKILL)
            process.wait()
