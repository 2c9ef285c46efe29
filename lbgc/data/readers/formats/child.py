"""The reading of a file in a process of its own, whose memory and time are bounded: libraries for
these formats are written in C, or build whatever a file describes. `apart` starts it.

What is said both ways are messages: their length in eight bytes, then JSON. The values of columns
follow their message as they lie in memory.
"""

import importlib
import json
import os
import resource
import struct
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

import numpy as np

from lbgc import outputs
from lbgc.data.readers.formats.table import AT_ONCE, Table, plain
from lbgc.errors import InputError, reading

READERS = ("hdf5", "matlab", "feather", "bags", "ulog", "dataflash", "r_data")
"""Modules of this room whose `read(path)` is called here."""
_MOST_MESSAGE = 2**26
"""Bytes of a message."""


def send(stream: IO[bytes], content: Any) -> None:
    """Write a message."""
    text = outputs.as_json(content, indent=None).encode()
    stream.write(struct.pack("<Q", len(text)) + text)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Read a message; None where there is no more. Raises ValueError where it is no message of this
    kind."""
    head = stream.read(8)
    if not head:
        return None
    if len(head) < 8:
        raise ValueError("a message that is cut short")
    (size,) = struct.unpack("<Q", head)
    if size > _MOST_MESSAGE:
        raise ValueError(f"a message of {size} bytes")
    return json.loads(stream.read(size))


def main(arguments: Sequence[str]) -> None:
    """Read a file: say what tables it has, hear which columns are wanted, and send them.

    arguments : the module, the file, and the most bytes of memory, seconds of processor, and bytes
    of a file that may be written.
    """
    name, path, memory, seconds, size = arguments
    answer = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):  # libraries print what they think of a file
        os.dup2(nothing, number)
    _bound(int(memory), int(seconds), int(size))
    try:
        with reading("log.path", path):
            _read(name, Path(path), answer)
    except InputError as error:
        choices = error.choices if isinstance(error.choices, str) else ", ".join(error.choices)
        said = [error.name, outputs.shown(error.value, 300), error.unit, choices]
        send(answer, {"error": said})
    answer.flush()
    os._exit(0)  # a library that is damaged may not end


def _read(name: str, path: Path, answer: IO[bytes]) -> None:
    """Say what tables a file has, and send the columns that are wanted, a piece for each message
    that asks: {"table": .., "columns": ..} for the first, an empty one for the next."""
    if name not in READERS:
        raise ValueError(f"no reader {name}")
    try:
        found = importlib.import_module(f"lbgc.data.readers.formats.{name}").read(path)
        send(answer, {"tables": [_described(own) for own in found]})
        pieces: Iterator[list[np.ndarray]] = iter(())
        while (wanted := receive(sys.stdin.buffer)) is not None:
            if wanted:
                pieces = _columns(found[wanted["table"]], wanted["columns"])
            _send(answer, next(pieces, None))
    except MemoryError:
        raise ValueError("takes more memory than a file of its size may") from None


def _bound(memory: int, seconds: int, size: int) -> None:
    """Bound this process's memory, bytes, time of processor, s, and the files that it writes."""
    for kind, limit in ((resource.RLIMIT_DATA, memory), (resource.RLIMIT_CPU, seconds),
                        (resource.RLIMIT_FSIZE, size), (resource.RLIMIT_CORE, 0)):  # fmt: skip
        hard = resource.getrlimit(kind)[1]
        least = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (least, hard))


def _described(own: Table) -> dict[str, Any]:
    """A table as it is told of."""
    return {
        "name": own.name, "names": own.names, "units": own.units, "rows": own.rows,
        "notes": own.notes, "frame": None if own.frame is None else asdict(own.frame),
    }  # fmt: skip


def _columns(table: Table, which: Sequence[int]) -> Iterator[list[np.ndarray]]:
    """Columns of a table, in pieces of a bounded number of rows."""
    for piece in table.read(which):
        for first in range(0, len(piece[0]), AT_ONCE):
            yield [_sendable(plain(own[first : first + AT_ONCE])) for own in piece]


def _send(answer: IO[bytes], values: Sequence[np.ndarray] | None) -> None:
    """Send a piece of columns, its types and number of rows before its values, or that there is no
    more."""
    if values is None:
        send(answer, {"end": True})
        return
    send(answer, {"rows": len(values[0]), "types": [own.dtype.str for own in values]})
    for own in values:
        answer.write(own.data.cast("B") if own.dtype.kind in "fi" else own.tobytes())
    answer.flush()


def _sendable(values: np.ndarray) -> np.ndarray:
    """Values without objects: text as UTF-8."""
    if values.dtype.kind == "O":
        texts = [own.encode() for own in values]
        return np.array(texts, f"S{max(1, max(map(len, texts), default=1))}")
    return values


if __name__ == "__main__":
    main(sys.argv[1:])
