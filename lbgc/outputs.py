"""Writing results: to outputs/<task>/<fingerprint of the configuration>/, with a `latest` link."""

import hashlib
import json
import math
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any


def fingerprint(configuration: Mapping[str, Any]) -> str:
    """A short name for a configuration: equal for equal content, whatever the order of its keys."""
    content = json.dumps(configuration, sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def as_json(content: Any, indent: int | None = 2, sort_keys: bool = False) -> str:
    """Content as standard JSON, in which numbers that are not finite are null.

    NumPy's numbers and arrays are written as Python's.
    """
    return json.dumps(_standard(content), indent=indent, sort_keys=sort_keys, allow_nan=False)


def printable(text: str) -> str:
    """Text from outside made safe for a terminal: control characters, which could change its
    colours, cursor or title, are spelled out; tabs and ends of lines stay."""
    return "".join(
        c if c.isprintable() or c in "\t\n" else c.encode("unicode_escape").decode() for c in text
    )


def _standard(content: Any) -> Any:
    """Content with Python's own types, and None for numbers that are not finite."""
    if isinstance(content, Mapping):
        return {key: _standard(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_standard(value) for value in content]
    if hasattr(content, "tolist"):  # NumPy's
        return _standard(content.tolist())
    if isinstance(content, float) and not math.isfinite(content):
        return None
    return content


UNSEALED = "0" * 64
"""The placeholder that `seal` replaces by a checksum."""


def seal(content: bytes) -> bytes:
    """The content with its own SHA-256, taken before, in place of its first UNSEALED."""
    own = hashlib.sha256(content).hexdigest()
    return content.replace(UNSEALED.encode(), own.encode(), 1)


def is_sealed(content: bytes, own: str) -> bool:
    """Whether the content is still as `seal` made it. own : the checksum found in it."""
    if len(own) != len(UNSEALED):
        return False
    opened = content.replace(own.encode(), UNSEALED.encode(), 1)
    return hashlib.sha256(opened).hexdigest() == own


def task_directory(task: str, identity: str) -> Path:
    """The directory outputs/<task>/<identity>, which is created if it is missing."""
    directory = Path("outputs") / task / identity
    directory.mkdir(parents=True, exist_ok=True)
    return directory


def mark_latest(directory: Path) -> None:
    """Let the link `latest` beside a task's directory point to it, once its content is finished.
    Where that cannot be, as on a file system without links, it is said: the content is as good."""
    new, link = directory.with_name(f".latest-{os.getpid()}"), directory.with_name("latest")
    try:
        new.unlink(missing_ok=True)
        new.symlink_to(directory.name)
        new.replace(link)
    except OSError as error:
        with suppress(OSError):
            new.unlink(missing_ok=True)
        print(f"no link {printable(str(link))} was made ({error.strerror})", file=sys.stderr)


def read_file(path: Path) -> bytes:
    """A file's content. Raises OSError where there is no regular file: a pipe or a device may have
    no end."""
    if not path.is_file():
        raise FileNotFoundError(f"{path} is no file")
    return path.read_bytes()


def write_atomically(path: Path, content: str | bytes, promised: bool = True) -> None:
    """Write a file whole or not at all. promised : whether it is on the disk when this returns, so
    that not even a power cut takes it away. Raises OSError, with the file's name."""
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    try:
        with partial.open("wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            if promised:
                file.flush()
                os.fsync(file.fileno())
        partial.replace(path)
    except BaseException as error:
        with suppress(OSError):  # what is half-written only takes room
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = str(path)
        raise
    if promised:
        sync_names(path.parent)


def sync_names(directory: Path) -> None:
    """Bring a directory's names to the disk, where its file system can be asked to."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
