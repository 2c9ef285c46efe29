"""The tables of a file that a process of its own reads (`child`), so that a library that crashes,
takes all memory or never ends is a refusal in one line."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from lbgc import machine
from lbgc.data.readers import tables
from lbgc.data.readers.axes import require_axes
from lbgc.data.readers.formats import child
from lbgc.data.readers.formats.table import AT_ONCE, LONGEST_TEXT, Frame, Pieces, Table
from lbgc.errors import InputError, reading
from lbgc.outputs import shown

_MEMORY, _MEMORY_A_BYTE = 1.5 * 2**30, 4.0
"""Bytes of memory that a reader may take, and those for each byte of its file besides."""
_SECONDS, _SECONDS_A_BYTE = 6.0, 5e-7
"""Time of processor that a reader may take, s, and that for each byte of its file besides."""
_PATIENCE = 10.0
"""Seconds of waiting for each second of processor."""
_TO_END = 5.0
"""Seconds that a process which has closed its answers may take to end."""
_MOST_TABLES, _MOST_COLUMNS = 100_000, 100_000
_ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1",
    "HDF5_PLUGIN_PRELOAD": "::",  # no filter that a file names is looked for
    "HDF5_USE_FILE_LOCKING": "FALSE",
    "ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "1",
}  # fmt: skip


@contextmanager
def read_apart(reader: str, path: Path, size: int) -> Iterator[list[Table]]:
    """The tables of a file, whose columns can be read within the `with` block, one after another.

    reader : the module of this room that knows the format; size : the file's size, bytes. Raises
    InputError where it cannot be read, where its reader crashes, or takes more than its time or
    memory.
    """
    seconds = _SECONDS + _SECONDS_A_BYTE * size
    limits = (min(_MEMORY + _MEMORY_A_BYTE * size, machine.memory()), seconds, tables.LARGEST)
    process = _started(reader, path, [str(int(own)) for own in limits])
    clock = threading.Timer(_PATIENCE * seconds, process.kill)
    clock.daemon = True
    clock.start()
    try:
        yield _Conversation(process, path, seconds).tables()
    finally:
        clock.cancel()
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout, process.stderr):
            assert pipe is not None
            with suppress(OSError):  # of what it was asked and never heard
                pipe.close()


def _started(reader: str, path: Path, limits: Sequence[str]) -> "subprocess.Popen[bytes]":
    """The process that reads. It imports what this one would, and nothing from the directory where
    it happens to be."""
    places = os.pathsep.join(place for place in sys.path if place)
    command = [sys.executable, "-P", "-m", child.__name__, reader, str(path.absolute()), *limits]
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": places} | _ENVIRONMENT,
    )  # fmt: skip


def _frame(told: dict[str, Any] | None) -> Frame | None:
    """The frame of which the process told. Raises InputError where its axes are none."""
    if told is None:
        return None
    axes = [str(own) for own in told["axes"]]
    require_axes("log.axes", axes)
    return Frame(tuple(axes), str(told["why"]), str(told["doubt"]))


class _Conversation:
    """What is asked of a reading process, and what it answers."""

    def __init__(self, process: "subprocess.Popen[bytes]", path: Path, seconds: float):
        self.process, self.path, self.seconds = process, path, seconds
        assert process.stdin is not None
        assert process.stdout is not None
        self.asks: IO[bytes] = process.stdin
        self.hears: IO[bytes] = process.stdout

    def tables(self) -> list[Table]:
        """The tables that the process tells of."""
        told = self._heard()["tables"]
        with reading("log.path", self.path):
            if len(told) > _MOST_TABLES:
                raise ValueError(f"holds {len(told)} tables")
            return [self._table(at, own) for at, own in enumerate(told)]

    def _table(self, at: int, told: dict[str, Any]) -> Table:
        """A table of which the process told."""
        names, units, notes = (tuple(map(str, told[k])) for k in ("names", "units", "notes"))
        if len(names) > _MOST_COLUMNS:
            raise ValueError(f"a table of {len(names)} columns")
        frame = _frame(told["frame"])
        return Table(str(told["name"]), names, units, int(told["rows"]),
                     lambda which: self._pieces(at, which), notes, frame)  # fmt: skip

    def _heard(self) -> dict[str, Any]:
        """The next message. Raises InputError where the process could not read the file."""
        try:
            said = child.receive(self.hears)
        except (ValueError, OSError):
            said = None
        if said is None:
            raise InputError("log.path", self.path, "", self._ended())
        if "error" in said:
            name, value, unit, choices = map(str, said["error"])
            raise InputError(name, value, unit, choices)
        return dict(said)

    def _ended(self) -> str:
        """The clause of a message that says how the process ended before it had answered."""
        try:
            code = self.process.wait(_TO_END)
        except subprocess.TimeoutExpired:
            return "cannot be read (its reader answers nothing)"
        if code == -signal.SIGXCPU:
            return f"cannot be read (it took more than {self.seconds:.3g} s of processor)"
        if code == -signal.SIGKILL:
            return "cannot be read (its reader was killed: it took too long, or too much memory)"
        if code < 0:
            return f"cannot be read (its reader crashed: {signal.Signals(-code).name})"
        assert self.process.stderr is not None
        why = self.process.stderr.read(2000).decode(errors="replace").strip().split("\n")[-1]
        return f"cannot be read (its reader ended: {shown(why) or code})"

    def _answer(self, asked: dict[str, Any]) -> dict[str, Any]:
        """What the process answers to a message."""
        try:
            child.send(self.asks, asked)
        except OSError:
            raise InputError("log.path", self.path, "", self._ended()) from None
        return self._heard()

    def _pieces(self, at: int, which: Sequence[int]) -> Pieces:
        """Columns of a table as the process sends them."""
        asked: dict[str, Any] = {"table": at, "columns": list(which)}
        while "end" not in (said := self._answer(asked)):
            asked = {}
            rows, types = int(said["rows"]), [np.dtype(str(own)) for own in said["types"]]
            longest = max((own.itemsize for own in types), default=0)
            good = 0 < rows <= AT_ONCE and len(types) == len(which) and longest <= LONGEST_TEXT
            if not good or any(own.kind not in "fiMS" for own in types):
                raise ValueError("its reader sent what is no column")
            yield [self._column(own, rows) for own in types]

    def _column(self, kind: np.dtype, rows: int) -> np.ndarray:
        """The values of a column in a piece."""
        content = self.hears.read(rows * kind.itemsize)
        if len(content) < rows * kind.itemsize:
            raise InputError("log.path", self.path, "", self._ended())
        return np.frombuffer(content, kind)
