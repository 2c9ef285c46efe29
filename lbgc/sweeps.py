"""The results and failures of a sweep's jobs, which each job reports to the process that started
the sweep.

A launcher may run jobs in other processes, which share nothing but files with the first one, and
Hydra passes on only one failure. So the sweep has a directory, named in the environment, with a
file for each job that has ended.
"""

import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from lbgc.outputs import as_json, write_atomically

_VARIABLE = "LBGC_SWEEP"


@dataclass(frozen=True)
class Ended:
    """How a job of a sweep has ended."""

    number: int
    overrides: str
    """The job's overrides, as key=value."""
    path: str | None
    """Path of the job's result; None: it has none."""
    error: str | None = None
    """The error that ended it; None: it succeeded."""
    fault: bool = False
    """Whether that was a fault of the program's own."""


@contextmanager
def sweep() -> Iterator[Path]:
    """The directory that jobs report to, in whatever process; it is removed after the `with`
    block. It is created by the first report, and its name is no other sweep's, nor to be foreseen:
    whatever was left of one that was killed is never taken for this one's."""
    directory = Path("outputs/multirun").resolve() / f"sweep_{secrets.token_hex(16)}"
    os.environ[_VARIABLE] = str(directory)
    try:
        yield directory
    finally:
        os.environ.pop(_VARIABLE, None)
        shutil.rmtree(directory, ignore_errors=True)


def report(job: Ended) -> None:
    """Report how a job has ended; the report is written whole or not at all. Does nothing where no
    sweep is under way."""
    if _VARIABLE not in os.environ:
        return
    directory = Path(os.environ[_VARIABLE])
    directory.mkdir(parents=True, exist_ok=True)
    write_atomically(directory / f"{job.number}.json", as_json(vars(job)))


def ended(directory: Path) -> list[Ended]:
    """The jobs that have ended, by number."""
    found = [Ended(**json.loads(file.read_text())) for file in directory.glob("[0-9]*.json")]
    return sorted(found, key=lambda job: job.number)
