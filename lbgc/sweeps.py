"""What became of a sweep's jobs, told by each to the process that started them, wherever it runs.

A launcher may run jobs in other processes, which have nothing but files in common with the first;
of failures Hydra passes on one. A directory of the sweep's own, named in the environment, holds a
file for each job that has ended.
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from lbgc.outputs import as_json, write_atomically

_VARIABLE = "LBGC_SWEEP"


@dataclass(frozen=True)
class Ended:
    """A job that has ended."""

    number: int
    overrides: str
    """What it was asked, as key=value."""
    path: str | None
    """The job's result; None: it has none."""
    error: str | None
    """What went wrong; None: nothing."""


@contextmanager
def sweep() -> Iterator[Path]:
    """A directory for jobs to report to, in whatever process; gone in the end."""
    directory = Path("outputs/multirun").resolve() / f"sweep_{os.getpid()}"
    os.environ[_VARIABLE] = str(directory)
    try:
        yield directory
    finally:
        os.environ.pop(_VARIABLE, None)
        shutil.rmtree(directory, ignore_errors=True)


def report(job: Ended) -> None:
    """Written whole or not at all. Does nothing where no sweep is under way."""
    if _VARIABLE not in os.environ:
        return
    directory = Path(os.environ[_VARIABLE])
    directory.mkdir(parents=True, exist_ok=True)
    write_atomically(directory / f"{job.number}.json", as_json(vars(job)))


def ended(directory: Path) -> list[Ended]:
    """Jobs that have ended, by number."""
    found = [Ended(**json.loads(file.read_text())) for file in directory.glob("[0-9]*.json")]
    return sorted(found, key=lambda job: job.number)
