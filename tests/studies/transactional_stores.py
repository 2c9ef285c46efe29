"""The same recordings kept in two ways, for `transactional.py`: our files with our manifest, and an
Icechunk repository of the same chunks, byte for byte, in its transactions.

Icechunk is imported only when it is used: it lies in a directory of the study's own.
"""

import asyncio
import hashlib
import json
import os
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import suppress
from copy import copy
from dataclasses import replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from helpers import default_config
from zarr.core.buffer import default_buffer_prototype
from zarr.core.sync import sync

import sim.generate
from lbgc.data import store
from lbgc.data.documents import Layout, documents
from lbgc.data.encoding import CHECKSUM_BYTES, encoded, is_zero
from lbgc.data.schema import RECORDED, VARIABLES
from lbgc.data.shard import Shard
from sim.recordings import Sensor, batches

Tick = Callable[[], object]
"""Is called when the writing of a shard begins."""


class Made:
    """A dataset in memory before it is written: its layout, and every variable of each shard."""

    def __init__(self, options: tuple[str, ...]):
        config = default_config(*options)
        sensor = Sensor.of(config)
        self.content = config.content()
        self.layout: Layout = sim.generate._layout(config, sensor)
        self._held = []
        for shard in range(self.layout.shards):
            rows = self.layout.rows(shard)
            held = Shard(self.layout, len(rows))
            for part in batches(config, sensor, rows):
                held.append(part)
            self._held.append(held)

    def repeated(self, shards: int) -> "Made":
        """A dataset of the first shard so many times over."""
        many = copy(self)
        many.layout = replace(self.layout, recordings=shards * self.layout.shard)
        many._held = self._held[:1] * shards
        return many

    def variables(self, shard: int) -> dict[str, np.ndarray]:
        """Every variable of a shard's recordings."""
        return self._held[shard].variables()

    def files(self, shard: int) -> dict[str, bytes]:
        """The shard's chunks as our own encoding has them, by the only names that Icechunk takes:
        with a slash between indices."""
        files = {}
        for name, values in self.variables(shard).items():
            dims, stored = VARIABLES[name].dims, values.astype(self.layout.dtype(name), copy=False)
            stored = stored.swapaxes(1, 2) if dims == RECORDED else stored
            if not is_zero(stored):
                key = "/".join([name, "c", str(shard), *("0" for _ in dims[1:])])
                how = self.layout.compression(name)
                files[key] = encoded(stored, self.layout.chunk(name), self.layout.shard, how)
        return files

    def documents(self, crc32c: bool = True) -> dict[str, bytes]:
        """The documents and coordinates without what is of our manifest, for Icechunk. crc32c :
        whether chunks end in a checksum."""
        files = {}
        for name, content in documents(self.layout, {"configuration": self.content}).items():
            if name.startswith("manifest"):
                continue
            if name.endswith("zarr.json"):
                said = json.loads(content)
                said.pop("consolidated_metadata", None)
                content = json.dumps(_slashed(said, crc32c)).encode()
            elif not crc32c:
                content = content[:-CHECKSUM_BYTES]
            files[name.replace("/c.", "/c/")] = content
        return files


def _slashed(said: Any, crc32c: bool) -> Any:
    """A Zarr document in which a slash is the separator of chunks' names."""
    if isinstance(said, list):
        return [_slashed(s, crc32c) for s in said if crc32c or s != {"name": "crc32c"}]
    if isinstance(said, dict):
        return {k: "/" if k == "separator" else _slashed(v, crc32c) for k, v in said.items()}
    return said


@lru_cache(maxsize=1)
def made(options: tuple[str, ...]) -> Made:
    """The dataset of these options of `sim/generate.py`, made once."""
    return Made(options)


class Ours:
    """A directory of files and our manifest, as the product writes and reads it."""

    def begin(self, path: Path, data: Made) -> store.Dataset:
        """The dataset here, begun now or before."""
        return store.create(path, data.layout, data.content, {})

    def unfinished(self, path: Path, data: Made) -> list[int]:
        """The shards that are still to be made, damaged ones among them."""
        return self.begin(path, data).state().unfinished

    def write(self, path: Path, data: Made, tick: Tick = int) -> None:
        """Begin, or go on with, a dataset; every line of it is one of `sim/generate.py`'s."""
        dataset = self.begin(path, data)
        for shard in dataset.state().unfinished:
            tick()
            dataset.write_shard(shard, data.variables(shard))
        self.finish(dataset)

    def write_with_two(self, path: Path, data: Made, tick: Tick, join: int) -> None:
        """The same by two processes. join : the process group that they are in."""
        dataset = self.begin(path, data)
        shards = dataset.state().unfinished
        with _two(data, join) as pool:
            for done in [pool.submit(_ours, path, s, tick) for s in shards]:
                done.result()
        self.finish(dataset)

    def finish(self, dataset: store.Dataset) -> None:
        store.remove_strays(dataset.place)
        dataset.place.settle()
        dataset.remember()

    def open(self, path: Path) -> zarr.Group:
        """The dataset opened by the product, its documents checked."""
        return store.Dataset.open(path)._group

    def verify(self, path: Path) -> None:
        """Every file against its SHA-256, as each command does before it reads."""
        store.Dataset.open_finished(path)


class Icechunk:
    """An Icechunk repository in a local directory, a commit a shard or one for all.

    each : whether every shard is a commit. What is finished is read from the commits' metadata.
    """

    def __init__(self, each: bool = True):
        self.each = each

    def repository(self, path: Path) -> Any:
        import icechunk

        icechunk.set_logs_filter(
            "error"
        )  # or it warns, each time, that a local directory is unsafe
        return icechunk.Repository.open_or_create(icechunk.local_filesystem_storage(str(path)))

    def begin(self, path: Path, data: Made) -> Any:
        repository = self.repository(path)
        if not any(commit.message == "begun" for commit in repository.ancestry(branch="main")):
            session = repository.writable_session("main")
            put_documents(session.store, data.documents())
            session.commit("begun")
        return repository

    def unfinished(self, path: Path, data: Made) -> list[int]:
        return self._lacking(self.begin(path, data), data)

    def _lacking(self, repository: Any, data: Made) -> list[int]:
        commits = repository.ancestry(branch="main")
        told = {shard for commit in commits for shard in commit.metadata.get("shards", [])}
        return [shard for shard in range(data.layout.shards) if shard not in told]

    def write(self, path: Path, data: Made, tick: Tick = int, through_zarr: bool = False) -> None:
        """Begin, or go on with, a repository. through_zarr : whether Zarr encodes the values, as it
        does for ordinary users, or our own encoding, which gives the same bytes in less time."""
        repository = self.begin(path, data)
        shards = self._lacking(repository, data)
        session = repository.writable_session("main")
        for shard in shards:
            tick()
            if through_zarr:
                put_values(session.store, data, shard)
            else:
                put(session.store, data.files(shard))
            if self.each:
                session.commit(f"shard {shard}", {"shards": [shard]})
                session = repository.writable_session("main")
        if shards and not self.each:
            session.commit("all shards", {"shards": shards})

    def write_with_two(self, path: Path, data: Made, tick: Tick, join: int) -> None:
        """The same by two processes: each shard is written in a fork of a session by one of them,
        and merged and committed by this one, which is the safe way in a local directory."""
        import icechunk

        repository = self.begin(path, data)
        shards = self._lacking(repository, data)
        whole, waiting = repository.writable_session("main"), {}
        with _two(data, join) as pool:
            for shard in shards:
                own = repository.writable_session("main") if self.each else whole
                task = pool.submit(_forked, own.fork(), shard, tick)
                waiting[task] = (own, shard)
            while waiting:
                for task in wait(waiting, return_when=FIRST_COMPLETED).done:
                    own, shard = waiting.pop(task)
                    own.merge(task.result())
                    if self.each:
                        rebase = icechunk.ConflictDetector()
                        own.commit(f"shard {shard}", {"shards": [shard]}, rebase_with=rebase)
        if shards and not self.each:
            whole.commit("all shards", {"shards": shards})

    def race(self, path: Path, data: Made) -> None:
        """Two processes that each write and commit shards by themselves, as ours do."""
        self.begin(path, data)
        with _two(data, 0) as pool:
            for task in [pool.submit(_alone, path, first) for first in (0, 1)]:
                task.result()

    def open(self, path: Path) -> zarr.Group:
        """The last commit, opened."""
        session = self.repository(path).readonly_session("main")
        return zarr.open_group(session.store, mode="r", zarr_format=3)


def put(into: Any, files: Mapping[str, bytes]) -> None:
    """Set all of these keys of an Icechunk store, at once."""
    buffer = default_buffer_prototype().buffer

    async def every() -> None:
        await asyncio.gather(*(into.set(n, buffer.from_bytes(c)) for n, c in files.items()))

    sync(every())


def put_documents(into: Any, files: Mapping[str, bytes]) -> None:
    """The same, arrays before their chunks."""
    put(into, {n: c for n, c in files.items() if n.endswith("zarr.json")})
    put(into, {n: c for n, c in files.items() if not n.endswith("zarr.json")})


def put_values(into: Any, data: Made, shard: int) -> None:
    """Write a shard through Zarr, as ordinary users do."""
    group, rows = zarr.open_group(into, mode="r+", zarr_format=3), data.layout.rows(shard)
    for name, values in data.variables(shard).items():
        group[name][rows.start : rows.stop] = values


_given: list[Any] = []
"""What a worker writes, and where it meets the other; as it was given them when it began."""


def _two(data: Made, join: int) -> ProcessPoolExecutor:
    """Two processes that hold the dataset and have begun: no kill is to meet only their start."""
    context = get_context("forkserver")
    both = context.Barrier(2)
    pool = ProcessPoolExecutor(2, context, _begun, (data, join, both))
    for started in [pool.submit(_meet) for _ in range(2)]:
        started.result()
    return pool


def _begun(data: Made, group: int, both: Any) -> None:
    _given[:] = [data, both]
    if group:
        os.setpgid(0, group)


def _meet() -> None:
    """Wait until both are here, with all that is done once a process behind them."""
    _given[0].files(0)
    with suppress(ImportError):
        import icechunk

        session = icechunk.Repository.create(icechunk.in_memory_storage()).writable_session("main")
        put_documents(session.store, _given[0].documents())
    _given[1].wait(120)


def _ours(path: Path, shard: int, tick: Tick) -> None:
    tick()
    store.Dataset.open(path).write_shard(shard, _given[0].variables(shard))


def _forked(fork: Any, shard: int, tick: Tick) -> Any:
    tick()
    put(fork.store, _given[0].files(shard))
    return fork


def _alone(path: Path, first: int) -> None:
    import icechunk

    data, repository = _given[0], Icechunk().repository(path)
    for shard in range(first, data.layout.shards, 2):
        session = repository.writable_session("main")
        put(session.store, data.files(shard))
        rebase = icechunk.ConflictDetector()
        session.commit(f"shard {shard}", {"shards": [shard]}, rebase_with=rebase)


def digest(group: zarr.Group) -> str:
    """SHA-256 over all that a reader is given: names, dimensions, attributes and decoded values."""
    whole = hashlib.sha256()
    for name, array in sorted(group.arrays()):
        said = json.dumps(dict(array.attrs), sort_keys=True)
        dims = array.metadata.dimension_names
        whole.update(f"{name} {dims} {array.dtype} {array.shape} {said} ".encode())
        size = (array.shards or array.chunks)[0]
        for first in range(0, array.shape[0], size):
            whole.update(np.ascontiguousarray(array[first : first + size]).data)
    return whole.hexdigest()


def kept(path: Path) -> dict[str, bytes]:
    """Every file below a directory, by name."""
    files = (file for file in path.rglob("*") if file.is_file())
    return {str(file.relative_to(path)): file.read_bytes() for file in files}
