"""Where a dataset's files lie: a local directory, or whatever fsspec finds behind a URL."""

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import fsspec
from fsspec.implementations.local import LocalFileSystem

from lbgc.errors import InputError
from lbgc.outputs import write_atomically


def is_partial(name: str) -> bool:
    """Whether a file is half of one, as Zarr and `write_atomically` name what they have begun."""
    return ".partial" in name.rsplit("/", 1)[-1]


class Place:
    """A directory of files. Names are relative to it and have forward slashes.

    where : a path, or a URL like file:///data/d.zarr or s3://bucket/d.zarr. Raises InputError
    where the URL is of no kind that is known here.
    """

    def __init__(self, where: "str | Path | Place"):
        self._where = str(where)
        self.local: Path | None = None
        if "://" not in self._where:
            self.local = Path(self._where)
            return
        try:
            self._files, self._root = fsspec.url_to_fs(self._where)
        except (ValueError, ImportError) as error:
            raise InputError("path", where, "", f"cannot be opened ({error})") from error
        if isinstance(self._files, LocalFileSystem):
            self.local = Path(self._root)

    def __str__(self) -> str:
        return str(self.local or self._where)

    @property
    def name(self) -> str:
        """The last part of the path."""
        return str(self).rstrip("/").rsplit("/", 1)[-1]

    @property
    def in_memory(self) -> bool:
        """Whether only this process sees it."""
        return self._where.startswith("memory:")

    def inside(self, name: str) -> "Place":
        return Place(f"{str(self).rstrip('/')}/{name}")

    def names(self) -> list[str]:
        """Every file here and below, and every link, which is not followed."""
        if self.local is None:
            prefix = self._root.rstrip("/") + "/"
            return sorted(path.removeprefix(prefix) for path in self._files.find(self._root))
        found = []
        for directory, inside, files in os.walk(self.local):
            own = Path(directory)
            links = [d for d in inside if (own / d).is_symlink()]
            found += [(own / f).relative_to(self.local).as_posix() for f in (*files, *links)]
        return sorted(found)

    def is_link(self, name: str) -> bool:
        return self.local is not None and (self.local / name).is_symlink()

    def is_own(self, name: str) -> bool:
        """Whether a name is of a local file that lies here: no link is on the way to it, and no
        device or pipe is at its end."""
        assert self.local is not None
        *above, last = Path(name).parts
        if ".." in above or Path(name).is_absolute():
            return False
        place = self.local
        for part in above:
            place = place / part
            if place.is_symlink():
                return False
        try:
            return stat.S_ISREG((place / last).lstat().st_mode)
        except OSError:
            return False

    def read(self, name: str) -> bytes | None:
        """A file's content; None where there is no such file, or a link in its place."""
        try:
            if self.local is not None:
                return (self.local / name).read_bytes() if self.is_own(name) else None
            return bytes(self._files.cat_file(f"{self._root}/{name}"))
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            return None

    def write(self, name: str, content: bytes) -> None:
        """Write a file whole or not at all."""
        if self.local is not None:
            path = self.local / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, content)
        else:
            self._files.pipe_file(f"{self._root}/{name}", content)

    def remove(self, name: str) -> None:
        """Remove a file (or a link, not what it points to), if it is there."""
        if self.local is not None:
            (self.local / name).unlink(missing_ok=True)
        elif self._files.exists(f"{self._root}/{name}"):
            self._files.rm_file(f"{self._root}/{name}")

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Nobody else may write here meanwhile; the directory is made if need be.

        The lock is the operating system's, on the directory itself: it ends with its process,
        however that ends, and leaves nothing behind. A URL has none. Raises InputError where
        somebody else writes here.
        """
        if self.local is None:
            yield
            return
        with writing(self):
            self.local.mkdir(parents=True, exist_ok=True)
        directory = os.open(self.local, os.O_RDONLY)
        try:
            try:
                fcntl.flock(directory, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                what = "is being written by another process; wait for it, or choose another path"
                raise InputError("out", self, "", what) from None
            except OSError:
                pass  # a network's file system may have no locks
            yield
        finally:
            os.close(directory)


@contextmanager
def writing(place: Place) -> Iterator[None]:
    """What cannot be written is the user's to mend: said as such, as InputError."""
    try:
        yield
    except OSError as error:
        why = error.strerror or str(error)
        what = f"cannot be written ({why}); what is finished stays good: run it again to go on"
        raise InputError("out", place, "", what) from error
