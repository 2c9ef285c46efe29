"""The location of a dataset's files: a local directory, or whatever fsspec finds behind a URL."""

import ctypes
import fcntl
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import fsspec
from fsspec.implementations.local import LocalFileSystem

from lbgc.errors import InputError, reading
from lbgc.outputs import is_temporary, write_atomically

_PARTIAL = re.compile(
    r"(.+/)?\.(zarr\.json|\d+)\.partial-\d+"  # of versions before this one
    r"|.+/c[./](\d+[./])*(\d+\.)?[0-9a-f]+\.partial|(.+/)?zarr\.[0-9a-f]{16,32}\.partial"  # Zarr's
)


def is_partial(name: str) -> bool:
    """Whether a dataset's file is only partly written, by the name that `write_atomically` or Zarr
    gives to such files, and nobody else."""
    return is_temporary(name.rsplit("/", 1)[-1]) or _PARTIAL.fullmatch(name) is not None


class Entry(NamedTuple):
    """A file as a directory tells of it."""

    size: int
    """Bytes; 0 of what is no plain file"""
    mark: str = ""
    """Another one where the file is another, or is written again; empty where none is known"""
    changed_ns: int = 0
    """When it was last changed, by the clock of its file system; 0 where the mark alone will do"""
    is_link: bool = False
    """Whether it is a symbolic link"""

    @classmethod
    def of(cls, found: os.stat_result) -> "Entry":
        """What the operating system says of a file."""
        mark = f"{found.st_ino} {found.st_mtime_ns} {found.st_ctime_ns}"
        size = found.st_size if stat.S_ISREG(found.st_mode) else 0
        changed_ns = max(found.st_mtime_ns, found.st_ctime_ns)
        return cls(size, mark, changed_ns, stat.S_ISLNK(found.st_mode))


class Place:
    """A directory of files, local or behind a URL. Names of files are relative to it and have
    forward slashes.

    where : a path, or a URL like file:///data/d.zarr or s3://bucket/d.zarr. Raises InputError
    where the URL's kind is not known on this machine.
    """

    def __init__(self, where: "str | Path | Place"):
        self._where = str(where)
        self.local: Path | None = None
        if "://" not in self._where:
            self.local = Path(self._where)
            return
        with reading("path", where, "cannot be opened"):
            self._files, self._root = fsspec.url_to_fs(self._where)
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
        """Whether it is in this process's memory, which no other process sees."""
        return self._where.startswith("memory:")

    def inside(self, name: str) -> "Place":
        """The directory of this name inside this one."""
        return Place(f"{str(self).rstrip('/')}/{name}")

    def entries(self, below: str = "") -> dict[str, Entry]:
        """All files here, or in a directory here, and below, by name, and links, which are not
        followed."""
        if self.local is None:
            return self._listed(below)
        found: dict[str, Entry] = {}
        waiting = [below]
        while waiting:
            directory = waiting.pop()
            try:
                inside = list(os.scandir(self.local / directory))
            except (FileNotFoundError, NotADirectoryError):
                continue
            for own in inside:
                name = f"{directory}/{own.name}" if directory else own.name
                if own.is_dir(follow_symlinks=False):
                    waiting.append(name)
                    continue
                with suppress(FileNotFoundError):  # another process has just removed it
                    found[name] = Entry.of(own.stat(follow_symlinks=False))
        return found

    def _listed(self, below: str) -> dict[str, Entry]:
        """All files behind a URL, by name."""
        prefix = self._root.rstrip("/") + "/"
        with self._reached():
            self._files.invalidate_cache()  # other processes write here too
            try:
                found = self._files.find((prefix + below).rstrip("/"), detail=True)
            except FileNotFoundError:
                return {}
        return {
            path.removeprefix(prefix): Entry(int(said.get("size") or 0), str(said.get("ETag", "")))
            for path, said in found.items()
        }

    def names(self, below: str = "") -> list[str]:
        """The names of all files here, or in a directory here, and below, in order, and of links,
        which are not followed."""
        return sorted(self.entries(below))

    def is_link(self, name: str) -> bool:
        """Whether a name is that of a symbolic link in a local directory."""
        return self.local is not None and (self.local / name).is_symlink()

    def is_own(self, name: str) -> bool:
        """Whether a name is that of a plain local file inside this directory, reached without
        following a link, and neither a link nor a device or pipe itself."""
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
        except (FileNotFoundError, NotADirectoryError):
            return False

    def read(self, name: str) -> bytes | None:
        """A file's content; None where there is no such file, or where it is not the directory's
        own (see `is_own`)."""
        with self._reached():
            try:
                if self.local is not None:
                    return (self.local / name).read_bytes() if self.is_own(name) else None
                return bytes(self._files.cat_file(f"{self._root}/{name}"))
            except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
                return None

    def read_all(self, names: Iterable[str]) -> dict[str, bytes]:
        """The contents of those of these files that there are, by name; behind a URL, many at
        once."""
        if self.local is not None:
            contents = ((name, self.read(name)) for name in names)
            return {name: content for name, content in contents if content is not None}
        paths = {f"{self._root}/{name}": name for name in names}
        with self._reached():
            found = self._files.cat(list(paths), on_error="return") if paths else {}
        missing = FileNotFoundError | NotADirectoryError | IsADirectoryError
        for failed in (f for f in found.values() if isinstance(f, Exception)):
            if not isinstance(failed, missing):
                with self._reached():
                    raise failed
        return {paths[p]: bytes(c) for p, c in found.items() if not isinstance(c, Exception)}

    def write(self, name: str, content: bytes) -> None:
        """Write a file completely or, where that fails locally, not at all. No link inside this
        directory is followed; one in the file's place is replaced."""
        self.write_all({name: content})

    def write_all(self, files: Mapping[str, bytes]) -> None:
        """Write some files (name -> content), each as `write` does; behind a URL, many at once."""
        if self.local is None:
            with self._reached():
                self._files.pipe({f"{self._root}/{n}": content for n, content in files.items()})
            return
        for name, content in files.items():
            path = self.local / name
            for above in Path(name).parents:
                if self.is_link(above.as_posix()) and above.name:
                    raise OSError(f"{above} is a link, which leads elsewhere")
            try:
                write_atomically(path, content, promised=False)
            except FileNotFoundError:
                path.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(path, content, promised=False)

    def remove(self, name: str) -> None:
        """Remove a file, or a link but not its target, if it is there."""
        if self.local is not None:
            (self.local / name).unlink(missing_ok=True)
            return
        with self._reached():
            if self._files.exists(f"{self._root}/{name}"):
                self._files.rm_file(f"{self._root}/{name}")

    def settle(self) -> None:
        """Wait until all that was written here is on the disk, so that not even a power cut takes
        it away. It takes one call: a file at a time would take longer than to make them."""
        if self.local is None:
            return
        directory = os.open(self.local, os.O_RDONLY)
        try:
            system = ctypes.CDLL(None, use_errno=True)
            if not hasattr(system, "syncfs"):
                os.sync()
            elif system.syncfs(directory) != 0:
                code = ctypes.get_errno()
                raise OSError(code, os.strerror(code), str(self.local))
        finally:
            os.close(directory)

    @contextmanager
    def _reached(self) -> Iterator[None]:
        """A context in which whatever a URL's file system says becomes InputError: each has errors
        of its own for a place, a credential or a package that is missing. A local one's are the
        operating system's, and stay."""
        if self.local is not None:
            yield
            return
        try:
            with reading("path", self, "cannot be used"):
                yield
        except InputError as error:
            if isinstance(error.__cause__, NotImplementedError):
                what = "cannot be written: its protocol is for reading only"
                raise InputError("path", self, "", what) from error
            raise

    @contextmanager
    def alone(self) -> Iterator[None]:
        """A context in which no other process may write here; the directory is made if need be.

        The lock is the operating system's, on the directory itself. It ends with its process,
        however that ends, and leaves no file behind. A URL has no lock. Raises InputError where
        another process writes here.
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
    """A context in which a failure to write raises InputError, because the user must remove its
    cause."""
    try:
        yield
    except OSError as error:
        why = error.strerror or str(error)
        what = f"cannot be written ({why}); what is finished stays good: run it again to go on"
        raise InputError("out", place, "", what) from error
