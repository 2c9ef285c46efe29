"""A training's history, `history.csv`: the figures of each look at the validation split."""

import csv
import hashlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from lbgc.errors import reading
from lbgc.outputs import read_file

FILE = "history.csv"
AGAIN = "the command that trained it makes it anew"
_MOST_BYTES = 64_000_000
_ALWAYS = {"step", "all", "score"}


def compose(history: Sequence[Mapping[str, float]]) -> bytes:
    """The content of the file, a row for each look."""
    lines = [",".join(history[0]), *(",".join(f"{v:.9g}" for v in row.values()) for row in history)]
    return ("\n".join(lines) + "\n").encode()


def checksum(content: bytes) -> str:
    """The SHA-256 by which a run's description knows its history."""
    return hashlib.sha256(content).hexdigest()


def read(file: Path, own: str | None) -> list[dict[str, float]]:
    """The rows of a run's history. own : its checksum by the run's description; None where that
    says none. Raises InputError where it is no file of the run's own, or damaged."""
    with reading("run", file, f"is damaged; {AGAIN}"):
        content = read_file(file, _MOST_BYTES, links=False)
        if own not in (None, checksum(content)):
            raise ValueError("it is not as it was written")
        table = csv.DictReader(content.decode().splitlines(), strict=True)
        rows = [{key: float(value) for key, value in row.items()} for row in table]
        steps = [row["step"] for row in rows]
        finite = all(math.isfinite(row[key]) for row in rows for key in _ALWAYS)
        if not rows or not finite or steps != sorted(set(steps)):
            raise ValueError("it has no rows of finite numbers, one a step")
        return rows
