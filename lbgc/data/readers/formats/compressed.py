"""Compressed files: .gz, .bz2, .xz, and .zip of one member, unfolded within bounds."""

import bz2
import gzip
import lzma
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

from lbgc import machine
from lbgc.data.readers import tables
from lbgc.errors import reading, require

_AT_ONCE = 2**22
"""Bytes that are unfolded at once."""
_GROWN = 2.0
"""Bytes of memory for each that is unfolded, while it grows."""
_STREAMS: dict[bytes, Callable[[IO[bytes]], IO[bytes]]] = {
    b"\x1f\x8b": lambda file: gzip.GzipFile(fileobj=file),  # type: ignore[dict-item,return-value]
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\x00": lzma.LZMAFile,
}
ZIP = b"PK\x03\x04"


def is_compressed(head: bytes) -> bool:
    """Whether a file that begins so is compressed."""
    return head.startswith((*_STREAMS, ZIP))


def unfolded(path: Path, key: str = "log.path", most: int | None = None) -> bytes:
    """A compressed file's content, or its first `most` bytes. Raises InputError, naming the file by
    `key`, where it is damaged or unfolds to more than is read."""
    made = bytearray()
    with reading(key, path), stream(path) as file:
        while most is None or len(made) < most:
            part = file.read(_AT_ONCE if most is None else most - len(made))
            if not part:
                break
            made += part
            limit = tables.LARGEST
            require(len(made) <= limit, key, path, f"unfolds to more than {limit} bytes, which "
                    "are the most")  # fmt: skip
            machine.require_memory(key, path, _GROWN * len(made), "what it unfolds to")
    return bytes(made)


@contextmanager
def stream(path: Path) -> Iterator[IO[bytes]]:
    """A compressed file's content as a stream."""
    with path.open("rb") as file:
        head = file.read(6)
        file.seek(0)
        if head.startswith(ZIP):
            with zipfile.ZipFile(file) as archive, archive.open(_only_member(archive)) as member:
                yield member
            return
        kind = next((own for magic, own in _STREAMS.items() if head.startswith(magic)), None)
        if kind is None:
            raise ValueError("is not compressed by gzip, bzip2 or xz, and no .zip file")
        with kind(file) as stream:
            yield stream


def members(path: Path) -> list[str]:
    """The names of what a .zip file holds, directories left out. Raises ValueError where a name
    leads out of the archive."""
    with zipfile.ZipFile(path) as archive:
        return _members(archive)


def _members(archive: zipfile.ZipFile) -> list[str]:
    """The names of what an open archive holds, as `members` gives them."""
    names = [name for name in archive.namelist() if not name.endswith("/")]
    for name in names:
        place = PurePosixPath(name.replace("\\", "/"))
        if place.is_absolute() or ".." in place.parts or ":" in place.parts[0]:
            raise ValueError(f"a member's name leads out of it: {name}")
    return names


def _only_member(archive: zipfile.ZipFile) -> str:
    """The name of an archive's only member. Raises ValueError where it has none or several."""
    names = _members(archive)
    if len(names) != 1:
        raise ValueError(f"holds {len(names)} files, and of a .zip file one is read: take it out")
    return names[0]
