"""Ways in which a dataset's files get damaged. Each does one and says what it did."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lbgc.data.files import names_of, shard_files
from lbgc.data.schema import ALWAYS

SHARDED = ("gyro", "accel", "attitude")
"""Variables whose files hold several chunks and end in an index of them: 16 bytes each, and 4."""


def one_of(rng: np.random.Generator, names: list[str]) -> str:
    return names[int(rng.integers(len(names)))]


def flip(path: Path, rng: np.random.Generator, first: int = 0) -> str:
    """Flip one bit of a file, from byte `first` on."""
    content = bytearray(path.read_bytes())
    at, bit = first + int(rng.integers(len(content) - first)), int(rng.integers(8))
    content[at] ^= 1 << bit
    path.write_bytes(content)
    return f"bit {bit} of byte {at} of {len(content)} flipped in {path}"


def truncate(path: Path, rng: np.random.Generator) -> str:
    """Cut a file short, by a byte at least."""
    content = path.read_bytes()
    size = int(rng.integers(len(content)))
    path.write_bytes(content[:size])
    return f"{path} cut to {size} of {len(content)} bytes"


def delete(path: Path, rng: np.random.Generator) -> str:
    path.unlink()
    return f"{path} deleted"


def payload(store: Path, rng: np.random.Generator, shards: int, foreign: Path) -> str:
    """Damage the recorded data, in the chunks themselves where there is an index too."""
    every = shard_files(int(rng.integers(shards)), ALWAYS)
    there = [name for name in every if (store / name).exists()]
    name = one_of(rng, there)
    path = store / name
    way = int(rng.integers(6))
    if way == 0:
        whole = path.with_suffix(".0123456789abcdef.partial")
        whole.write_bytes(path.read_bytes()[: int(rng.integers(path.stat().st_size))])
        return f"{whole} left"
    if way == 1:
        shard = name.split(".")[1]
        for each in shard_files(int(shard), ALWAYS):
            (store / each).unlink(missing_ok=True)
        return f"shard {shard} deleted"
    if way == 2:
        return truncate(path, rng)
    if way == 3 and len(there) < len(every):
        planted = one_of(rng, sorted({*every} - {*there}))
        shutil.copy(path, store / planted)
        return f"{planted} is there, which is zero and has no file"
    return flip(path, rng)


def index(store: Path, rng: np.random.Generator, shards: int, foreign: Path) -> str:
    """Damage the index at the end of a file of several chunks."""
    names = [f"{name}/c.{int(rng.integers(shards))}.0.0" for name in SHARDED]
    path = store / one_of(rng, [name for name in names if (store / name).exists()])
    return flip(path, rng, first=path.stat().st_size - (16 * 16 + 4))


def metadata(store: Path, rng: np.random.Generator, shards: int, foreign: Path) -> str:
    """Damage a document: of the group, of an array, or a coordinate's values."""
    path = store / ("zarr.json" if rng.random() < 0.2 else one_of(rng, list(names_of(ALWAYS))))
    return (flip, flip, flip, truncate, delete)[int(rng.integers(5))](path, rng)


def manifest(store: Path, rng: np.random.Generator, shards: int, foreign: Path) -> str:
    """Damage the manifest, or put another dataset's in its place."""
    way = int(rng.integers(6))
    if way == 0:
        shutil.rmtree(store / "manifest")
        shutil.copytree(foreign / "manifest", store / "manifest")
        return "another dataset's manifest"
    rows = [f"shards/c.{shard}.0" for shard in range(shards)]
    path = store / "manifest" / one_of(rng, ["zarr.json", *rows])
    return (flip, flip, flip, truncate, delete)[way - 1](path, rng)


KINDS: dict[str, Callable[[Path, np.random.Generator, int, Path], str]] = {
    "payload": payload,
    "shard index": index,
    "metadata": metadata,
    "manifest": manifest,
}
