"""What this machine has of memory and of room for files, and what of it is asked for."""

import os
import resource
import shutil
import sys
from pathlib import Path
from typing import Any

from lbgc.errors import InputError
from lbgc.units import unit_of

VERIFY = "LBGC_VERIFY"
"""The environment variable that `--verify` sets: what was found whole on this machine before is not
taken for whole, in this process and those that it starts."""
_GROUPS = Path("/sys/fs/cgroup")
_SAID_BYTES, _SAID_S = 2e9, 600.0
"""Memory or files, and time, from which on they are told before the start."""


def memory() -> float:
    """Bytes of memory that this process may have: the machine's, or the limit of its control group
    or of the process itself, whichever is least."""
    found = [float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")]
    for limit in _limits():
        try:
            text = limit.read_text().strip()
        except OSError:
            continue
        found += [float(text)] if text.isdecimal() else []
    for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA):
        soft = resource.getrlimit(kind)[0]
        found += [float(soft)] if soft != resource.RLIM_INFINITY else []
    return min(found)


def _limits() -> list[Path]:
    """Files that may hold the limit of this process's control group, or of one above it."""
    try:
        groups = Path("/proc/self/cgroup").read_text().splitlines()
    except OSError:
        return []
    found = []
    for _, kinds, name in (line.split(":", 2) for line in groups if line.count(":") >= 2):
        old = "memory" in kinds.split(",")
        if kinds and not old:
            continue
        root = _GROUPS / "memory" if old else _GROUPS
        own = root / name.lstrip("/")
        file = "memory.limit_in_bytes" if old else "memory.max"
        found += [p / file for p in (own, *own.parents) if p.is_relative_to(root)]
    return found


def free(path: Path) -> float:
    """Bytes that are free where a file of this path would be."""
    there = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
    return float(shutil.disk_usage(there).free)


def require_memory(name: str, value: Any, needed: float, what: str) -> None:
    """Raise InputError on this parameter where more memory is needed, bytes, than there is.
    what : what takes it."""
    there = memory()
    if needed > there:
        about = f"{what} takes {size(needed)} of memory, and this machine has {size(there)}"
        raise InputError(name, value, unit_of(name), about)


def require_room(name: str, value: Any, needed: float, path: Path) -> None:
    """Raise InputError on this parameter where files take more bytes than are free there."""
    there = free(path)
    if needed > there:
        about = f"takes at least {size(needed)} of files, and {size(there)} are free at {path}"
        raise InputError(name, value, unit_of(name), about)


def told(memory_bytes: float, seconds: float, file_bytes: float = 0.0) -> None:
    """Say what is asked for, where it is much."""
    parts = [(size(memory_bytes) + " of memory", memory_bytes >= _SAID_BYTES),
             (size(file_bytes) + " of files", file_bytes >= _SAID_BYTES),
             (span(seconds), seconds >= _SAID_S)]  # fmt: skip
    said = [text for text, much in parts if much]
    if said:
        print(f"this takes about {', '.join(said)}", file=sys.stderr)


def size(count: float) -> str:
    """Bytes in words."""
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} PB"


def span(seconds: float) -> str:
    """A time in words."""
    for least, unit in ((86400 * 365, "years"), (86400, "days"), (3600, "hours"), (60, "minutes")):
        if seconds >= 2 * least:
            return f"{seconds / least:.3g} {unit}"
    return f"{seconds:.3g} s"
