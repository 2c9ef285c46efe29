"""How a command ends where what it runs in fails it: it is told to end, nobody reads what it
prints, or files cannot be read or written."""

import errno
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from lbgc.errors import InputError

_SIGNALS = (signal.SIGTERM, signal.SIGHUP)
AGAIN = "what is finished stays good: run the same command again to go on"


class Ended(KeyboardInterrupt):
    """The process was told to end by a signal other than SIGINT."""


class Signals:
    """Raises Ended in a `with` block where the process is told to end; `number` is the signal's.

    A second signal ends the process as the operating system does. A signal that is ignored, as by
    nohup, stays ignored. After the block the work is done, and the process about to end: signals
    that came between would only hide its exit code, so they are ignored.
    """

    def __init__(self) -> None:
        self.number: int = signal.SIGINT
        self._taken: list[signal.Signals] = []

    def __enter__(self) -> "Signals":
        if threading.current_thread() is threading.main_thread():
            self._taken = [n for n in _SIGNALS if signal.getsignal(n) is signal.SIG_DFL]
            for number in self._taken:
                signal.signal(number, self._end)
        return self

    def __exit__(self, *_: object) -> None:
        for number in self._taken:
            signal.signal(number, signal.SIG_IGN)

    def _end(self, number: int, _: Any) -> None:
        for other in self._taken:
            signal.signal(other, signal.SIG_DFL)
        self.number = number
        raise Ended


class Stream:
    """A text stream that may be lost: its reader is gone, or its disk is full. What is written from
    then on is dropped, and the work goes on. lost : the error by which it was lost; within_line :
    whether a line was begun, as by a progress bar, and not ended."""

    def __init__(self, stream: Any):
        self._stream = open(os.devnull, "w") if stream is None else stream  # noqa: SIM115
        self.lost: OSError | None = None
        self.within_line = False

    def write(self, text: str) -> int:
        """Write the text, or drop it."""
        self.within_line = text[-1] not in "\r\n" if text else self.within_line
        try:
            self._stream.write(text)
        except OSError as error:
            self._lose(error)
        return len(text)

    def flush(self) -> None:
        """Hand on what was written, or drop it."""
        try:
            self._stream.flush()
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> None:
        """Lead what is still to come, and what waits in the buffer, to nowhere."""
        self.lost = self.lost or error
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def streams() -> Iterator[Stream]:
    """A context in which standard output and standard error may be lost or closed; yields standard
    output."""
    for number in range(3):  # else a file of ours takes a number to which libraries print
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = out, err = Stream(sys.stdout), Stream(sys.stderr)
    try:
        yield out
    finally:
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = before


def say(line: str) -> None:
    """Print a line on standard error, below a progress bar that stands there."""
    print("\n" * getattr(sys.stderr, "within_line", False) + line, file=sys.stderr)


def unprinted(lost: OSError) -> int:
    """Say that standard output was lost, and give the command's exit code: that of a program which
    a closed pipe ends, or that of a wrong input."""
    why = "the work is done, but not all was printed"
    say(f"error: standard output = {lost.strerror}: {why}")
    return 128 + signal.SIGPIPE if lost.errno == errno.EPIPE else 2


def said(error: OSError) -> InputError:
    """An error of the operating system as one of the user's surroundings."""
    why = error.strerror or str(error) or type(error).__name__
    if error.filename is None:
        return InputError("system", why, "", AGAIN)
    where = os.fsdecode(error.filename) if not isinstance(error.filename, int) else error.filename
    return InputError("path", where, "", f"cannot be used ({why}); {AGAIN}")
