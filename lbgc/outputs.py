"""Writing results: to outputs/<task>/<fingerprint of the configuration>/, with a `latest` link."""

import csv
import fcntl
import hashlib
import io
import json
import math
import os
import re
import secrets
import stat
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any
from unicodedata import category

LONGEST = 200
"""Largest number of characters that are shown of one text from a file."""
_UNSEEN = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0\U000e0100-\U000e01ef]"
)
"""Characters that are printable by Unicode and not seen: fillers, selectors of variants, blanks."""
_MOST_MARKS = 3
"""Largest number of marks above, below and through one character that are shown as such: as many as
nearly any script writes. A pile of them covers the lines around it."""
_TEMPORARY = re.compile(r"\.lbgc-[0-9a-f]{32}\.partial")
_OLD_LINK_S = 60.0
"""Age, s, from which a temporary link is nobody's: its writer renames it at once."""


def fingerprint(configuration: Mapping[str, Any]) -> str:
    """A short name for a configuration: equal for equal content, whatever the order of its keys."""
    content = json.dumps(configuration, sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def as_json(content: Any, indent: int | None = 2, sort_keys: bool = False) -> str:
    """Content as standard JSON, in which numbers that are not finite are null.

    NumPy's numbers and arrays are written as Python's.
    """
    return json.dumps(_standard(content), indent=indent, sort_keys=sort_keys, allow_nan=False)


def listed(directory: Path, pattern: str) -> list[Path]:
    """What a directory holds by a pattern, in order of name; nothing where there is no directory.
    Raises OSError where it cannot be read, in which glob finds nothing."""
    if directory.is_dir():
        os.listdir(directory)
    return sorted(directory.glob(pattern))


def printable(text: str) -> str:
    """Text from outside made safe for a terminal: control characters, which could change its
    colours, cursor or title, marks that turn the direction of writing, characters that nobody
    sees, and marks piled upon one character are spelled out; tabs and ends of lines stay."""
    if text.isascii() and text.isprintable():
        return text
    written, marks = [], 0
    for c in text:
        marks = marks + 1 if category(c) in ("Mn", "Me") else 0
        seen = (c.isprintable() and not _UNSEEN.match(c)) or c in "\t\n"
        written.append(c if seen and marks <= _MOST_MARKS else _spelled_out(c))
    return "".join(written)


def shown(text: object, longest: int = LONGEST) -> str:
    """A text from a file in the form in which people get it, wherever they do: on one line, without
    characters that could control what shows it, and not longer than `longest`."""
    said = str(text)
    plain = printable(said[: longest + 1]).replace("\n", "\\n").replace("\t", "\\t")
    return plain if len(plain) <= longest else plain[: longest - 3] + "..."


def _spelled_out(character: str) -> str:
    return character.encode("unicode_escape").decode()


def as_csv(rows: Iterable[Sequence[object]]) -> str:
    """Rows as CSV. A text is written as `shown`, and with an apostrophe before what a spreadsheet
    would take for a formula; numbers are written as they are."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerows([_cell(v) if isinstance(v, str) else v for v in row] for row in rows)
    return out.getvalue()


@lru_cache(maxsize=4096)
def _cell(text: str) -> str:
    """A text as a cell of a table that a spreadsheet may open."""
    plain = shown(text)
    if plain[:1] in ("=", "+", "-", "@"):
        try:
            float(plain)
        except ValueError:
            return f"'{plain}"
    return plain


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
    """The directory outputs/<task>/<identity>, which is created if it is missing. What a writer
    that was killed has left half-written there is removed."""
    directory = Path("outputs") / task / identity
    directory.mkdir(parents=True, exist_ok=True)
    for place in (directory.parent, directory, *filter(Path.is_dir, directory.iterdir())):
        remove_temporary(place)
    return directory


def mark_latest(directory: Path) -> None:
    """Let the link `latest` beside a task's directory point to it, once its content is finished.
    What is no link has another owner, and stays. Where no link can be made, as on a file system
    without links, it is said: the content is as good."""
    latest = directory.with_name("latest")
    if latest.exists() and not latest.is_symlink():
        return
    new = _temporary(directory.parent)
    try:
        new.symlink_to(directory.name)
        new.replace(latest)
    except OSError as error:
        with suppress(OSError):
            new.unlink(missing_ok=True)
        print(f"no link {printable(str(latest))} was made ({error.strerror})", file=sys.stderr)


def read_file(path: Path, most: int | None = None, links: bool = True) -> bytes:
    """A file's content. most : bytes that it may have; links : whether it may be a link to a file.
    Raises OSError where there is no regular file, since a pipe or a device may have no end, and
    ValueError where it has more bytes."""
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if links else os.O_NOFOLLOW)
    with open(os.open(path, flags), "rb") as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise FileNotFoundError(f"{path} is no file")
        if most is not None and found.st_size > most:
            raise ValueError(f"{path.name} has {found.st_size} bytes, and {most} are the most")
        return file.read(-1 if most is None else most)


def is_temporary(name: str) -> bool:
    """Whether a name is one that this program gives to what it has not finished writing."""
    return _TEMPORARY.fullmatch(name) is not None


def _temporary(directory: Path) -> Path:
    """A path in a directory that nobody can have foreseen."""
    return directory / f".lbgc-{secrets.token_hex(16)}.partial"


def write_atomically(path: Path, content: str | bytes, promised: bool = True) -> None:
    """Write a file whole or not at all. promised : whether it is on the disk when this returns, so
    that not even a power cut takes it away. Raises OSError, with the file's name.

    The content goes to a new file of a name that nobody can foresee, so that no link that was laid
    in its way is followed, and that is locked while it is written, so that `remove_temporary` knows
    it. A link in the place of `path` is replaced, and not followed either.
    """
    while True:
        new = _temporary(path.parent)
        try:
            made = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except OSError as error:
            error.filename = str(path)
            raise
        with suppress(OSError):  # a network's file system may have no locks
            fcntl.flock(made, fcntl.LOCK_EX)
        if os.fstat(made).st_nlink:
            break
        os.close(made)  # it was removed before it was locked
    try:
        with open(made, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            if promised:
                os.fsync(file.fileno())
            new.replace(path)
    except BaseException as error:
        with suppress(OSError):  # what is half-written only takes room
            new.unlink(missing_ok=True)
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


def remove_temporary(directory: Path) -> None:
    """Remove what writers that were killed have left of `write_atomically` and `mark_latest` in a
    directory. What is being written, and what this program did not name, stays."""
    names: list[str] = []
    with suppress(OSError):  # it may not be ours to read
        names += filter(is_temporary, os.listdir(directory))
    for path in (directory / name for name in names):
        with suppress(OSError):  # another process may have removed it
            if path.is_symlink():
                if time.time() - path.lstat().st_mtime > _OLD_LINK_S:
                    path.unlink()
                continue
            left = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                fcntl.flock(left, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
            finally:
                os.close(left)
