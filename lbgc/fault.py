"""A fault of this program's own: an exception that no user's input should cause, and its report."""

import os
import platform
import shlex
import sys
import tempfile
import traceback
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import lbgc
from lbgc.outputs import printable

EXIT = 3
"""The exit code of a command that ended by a fault of its own."""
_DIRECTORY = Path("outputs/faults")
_PACKAGES = ("numpy", "scipy", "zarr", "mujoco", "torch", "pyarrow", "hydra-core", "omegaconf")
_LONGEST = 200
"""Largest number of characters of the exception's own text that is shown."""


class Fault(Exception):
    """A fault whose report has been written. Its text is the two lines that the user reads."""


def reported(error: BaseException) -> Fault:
    """The fault that an exception shows, after its report has been written: the command, versions
    and traceback, below outputs/faults/ or, where that cannot be written, in the directory for
    temporary files. Where neither can, the fault's text ends with the traceback itself."""
    if isinstance(error, Fault):
        return error
    said = " ".join(str(error).split())[:_LONGEST]
    what = f"{type(error).__name__}: {said}" if said else type(error).__name__
    content = _report(error)
    file = _kept(content)
    where = f"its report is {file}" if file else f"its report cannot be written: {content}"
    whose = f"a fault of lbgc's own, not of the input: {what}{_place(error)}"
    return Fault(printable(f"{whose}\n{where}; please send it to the maintainers"))


def _place(error: BaseException) -> str:
    """Where the exception was raised, by the last line of this program that it passed."""
    home = Path(__file__).resolve().parents[1]
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if Path(f.filename).is_relative_to(home) and "lib/" not in f.filename]
    return f" ({Path(own[-1].filename).relative_to(home)}, line {own[-1].lineno})" if own else ""


def _report(error: BaseException) -> str:
    versions = [f"lbgc {lbgc.__version__}", f"Python {sys.version.split()[0]}"]
    for name in _PACKAGES:
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    lines = [
        f"command   {shlex.join(sys.argv)}",
        f"versions  {', '.join(versions)}",
        f"machine   {platform.platform()}, {platform.machine()}",
        "",
        *(part.rstrip("\n") for part in traceback.format_exception(error)),
    ]
    return "\n".join(lines) + "\n"


def _kept(content: str) -> str | None:
    """The file that the report was written to; None where it cannot be written anywhere."""
    for directory in (_DIRECTORY, None):
        try:
            if directory is not None:
                directory.mkdir(parents=True, exist_ok=True)
            opened, name = tempfile.mkstemp(".log", "fault_", directory)
            with os.fdopen(opened, "w", encoding="utf-8", errors="backslashreplace") as file:
                file.write(content)
            return name
        except OSError:
            continue
    return None
