"""The dataset: one Zarr v3 store. Only this file and `documents.py` touch Zarr.

Every array has its dimensions' names, units and a long name. What a shard holds is written by one
task; its row of the manifest (`lbgc/data/manifest.py`) is written last, so that what it names is
whole. A dataset is finished when every shard is in the manifest; completeness never comes from
files being there, since a missing shard would read silently as zeros.
"""

import hashlib
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import zarr
from tqdm import tqdm
from zarr.core.buffer import Buffer
from zarr.storage import LocalStore

from lbgc import machine
from lbgc.data import codec, configuration, manifest
from lbgc.data.documents import Layout, documents
from lbgc.data.encoding import encoded, is_zero, with_checksum
from lbgc.data.files import ROOT, names_of, row_files, shard_of
from lbgc.data.place import Place, writing
from lbgc.data.record import Held, Record
from lbgc.data.remembered import Remembered
from lbgc.data.schema import READ, RECORDED, SCHEMA, SPLITS, VARIABLES
from lbgc.data.verification import State, remember, state
from lbgc.data.vetting import check_values, layout_of
from lbgc.errors import InputError, reading, require
from lbgc.frames import AXES, DOWN
from lbgc.outputs import fingerprint, shown

codec.take()
_A_SAMPLE = 300.0
"""Bytes of memory for each sample of a recording while it is read and answered."""
_COPIED_BYTES = 200_000
"""Bytes of recordings copied at once: they stay in the processor's cache."""


def create(
    path: str | Path, layout: Layout, content: Mapping[str, Any], recipe: Mapping[str, Any]
) -> "Dataset":
    """Start a dataset, or go on with the same one that was started here before, its documents
    mended where they are damaged.

    content : the configuration that decides what the dataset holds, JSON-able; recipe : what else a
    reader may want (package versions). Raises InputError where `path` holds anything else, or
    cannot be written.
    """
    place = Place(path)
    identity = fingerprint({"schema": SCHEMA, **content})
    owner = manifest.owner(place)
    older = owner in [fingerprint({"schema": schema, **content}) for schema in READ[:-1]]
    what = "holds this dataset as an earlier version wrote it, which is read and not gone on with"
    require(not older, "out", path, f"{what}; choose another path")
    what = "holds a dataset of another configuration; choose another path"
    require(owner in (None, identity), "out", path, what)
    with writing(place):
        remove_strays(place)
        damaged = manifest.damaged_documents(place, layout.documents)
        if damaged:
            attributes = {
                "Conventions": "CF-1.11",
                "title": "lbgc dataset",
                "schema": SCHEMA,
                "identity": identity,
                "configuration": dict(content),
                "rate_hz": layout.rate_hz,
                **recipe,
            }
            made = documents(layout, attributes)
            for name in layout.documents:
                if name in damaged:
                    place.write(name, made[name])
            found = {name: place.read(name) or b"" for name in layout.documents}
            place.write(manifest.MANIFEST, manifest.compose(identity, found))
    return Dataset.open(path)


def remove_strays(place: Place) -> None:
    """Take away what a run (or a worker of it) that was killed has left half-written."""
    for name in manifest.strays(place.entries()):
        place.remove(name)


def find(path: str | Path) -> Place:
    """Where the dataset is: here, or in `dataset.zarr` below. Raises InputError where none is."""
    place = Place(path)
    for candidate in (place, place.inside("dataset.zarr")):
        if candidate.read(ROOT) is not None or candidate.read(manifest.MANIFEST):
            require(manifest.owner(candidate) is not None, "data", path, manifest.NONE)
            return candidate
    raise InputError("data", path, "", manifest.NONE)


class _Own(LocalStore):
    """A local directory of which only its own files are read: no link out of it is followed."""

    async def get(self, key: str, *args: Any, **kwargs: Any) -> Buffer | None:
        return await super().get(key, *args, **kwargs) if self._is_own(key) else None

    def get_sync(self, key: str, **kwargs: Any) -> Buffer | None:
        return super().get_sync(key, **kwargs) if self._is_own(key) else None

    def _is_own(self, key: str) -> bool:
        return Place(self.root).is_own(key)


def _group(place: Place, mode: Literal["r", "r+"]) -> zarr.Group:
    where = str(place) if place.local is None else _Own(place.local, read_only=mode == "r")
    return zarr.open_group(where, mode=mode, zarr_format=3, use_consolidated=False)


def damaged_documents(place: Place) -> list[str]:
    """The documents of a dataset that are not what its manifest says."""
    return manifest.damaged_documents(place, manifest.documents_of(place))


def _digest(arrays: Iterable[tuple[str, np.ndarray]]) -> bytes:
    """SHA-256 over decoded arrays, by name."""
    digest = hashlib.sha256()
    for name, values in sorted(arrays, key=lambda item: item[0]):
        digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
        for part in _contiguous(values):
            digest.update(part.data)
    return digest.digest()


def _contiguous(values: np.ndarray) -> Iterator[np.ndarray]:
    """An array in the order of its axes, some recordings at a time where it lies otherwise; what
    lies axis by axis, (recording, time, axis), is copied that way, at twice numpy's speed."""
    if values.flags.c_contiguous:
        yield values
        return
    size = max(1, _COPIED_BYTES // values[0].nbytes)
    for first in range(0, len(values), size):
        part = values[first : first + size]
        copied = np.empty(part.shape, part.dtype)
        axes = [(..., axis) for axis in range(part.shape[2])] if part.ndim == 3 else [...]
        for own in axes:
            copied[own] = part[own]
        yield copied


def some(names: Sequence[Any]) -> str:
    """The first few, and how many more."""
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(map(str, names[:4])) + more


class Dataset:
    """A dataset opened for reading, and for writing the shards it still lacks."""

    def __init__(self, place: Place, group: zarr.Group, layout: Layout):
        self.place, self._group, self.layout = place, group, layout
        self._checked = False
        self._arrays: dict[str, zarr.Array[Any]] = {}

    @classmethod
    def open(cls, path: str | Path) -> "Dataset":
        """Open a dataset, finished or not. A directory holding `dataset.zarr` will do.

        Raises InputError where there is none, one of another schema, or one whose documents are
        not what its manifest says.
        """
        place = find(path)
        damaged = damaged_documents(place)
        require(not damaged, "data", place, f"is damaged ({some(damaged)}); {manifest.AGAIN}")
        with reading("data", place, "is no dataset of this version"):
            named, schema = manifest.contents(place)
            found = place.read_all(names_of(named, schema))
            layout = layout_of(found, named, schema)
            require(manifest.is_named(place), ROOT, place, "has no configuration")
            return cls(place, _group(place, "r"), layout)

    @classmethod
    def open_finished(cls, path: str | Path) -> "Dataset":
        """Open a dataset that must be whole, every file as it was written.

        Raises InputError where its generation did not end, and where anything is damaged, missing
        or left over.
        """
        dataset = cls.open(path)
        one = _A_SAMPLE * dataset.layout.samples
        machine.require_memory("data", path, one, "a recording as long as it says")
        state, wrong = dataset.state(), []
        if state.missing:
            what = f"{len(state.missing)} of {dataset.layout.shards} shards are missing"
            wrong.append(f"is not finished: {what}")
        if state.damaged:
            wrong.append(f"is damaged: shards {some(state.damaged)} are not as they were written")
        if state.strays:
            wrong.append(f"holds what an interrupted run left ({some(state.strays)})")
        require(not wrong, "data", path, f"{', and '.join(wrong)}; {manifest.AGAIN}")
        return dataset

    @property
    def path(self) -> Path:
        """Where the dataset lies; of one elsewhere, its URL."""
        return Path(str(self.place))

    @property
    def identity(self) -> str:
        """The fingerprint of its configuration and schema."""
        return str(self._group.attrs["identity"])

    @property
    def configuration(self) -> dict[str, Any]:
        """What decided its content, as `create` was given it. Raises InputError where that is
        nothing that a generation takes: a checksum does not tell who wrote it."""
        said = dict(self._group.attrs["configuration"])  # type: ignore[arg-type]
        if not self._checked:
            with reading("data", self.place, "has a configuration that no generation takes"):
                try:
                    configuration.check(said, self.layout)
                except InputError as error:  # named by the dataset: nobody set this parameter
                    raise ValueError(str(error)) from error
            self._checked = True
        return said

    @property
    def _axis(self) -> int:
        """The axis of the body about which its plate turns; down, if nothing says another."""
        axis = self._protocol.get("axis")
        require(axis is None or axis in AXES, "data", self.place, "has a plate about no axis")
        return DOWN if axis is None else AXES.index(axis)

    @property
    def _tumbles(self) -> bool:
        """Whether a hand held the IMU, as far as its configuration says."""
        return self._protocol.get("kind") == "tumble"

    @property
    def _protocol(self) -> Mapping[str, Any]:
        """What its configuration says of the protocol; nothing where it is of another shape."""
        said: Any = self._group.attrs["configuration"]
        protocol = said.get("protocol") if isinstance(said, Mapping) else None
        return protocol if isinstance(protocol, Mapping) else {}

    @property
    def rate_hz(self) -> float:
        """Stored values a second: samples, or means."""
        return self.layout.rate_hz

    def _array(self, name: str) -> zarr.Array[Any]:
        if name not in self._arrays:  # Zarr takes two milliseconds
            with reading("data", self.place, f"is damaged: {name}"):
                array = self._group[name]
                assert isinstance(array, zarr.Array)
                self._arrays[name] = array
        return self._arrays[name]

    def _read(self, name: str, first: int, end: int) -> np.ndarray:
        """Rows of a variable. Raises InputError where they cannot be decoded."""
        try:
            with reading("data", self.place, f"is damaged: {name}"):
                return np.asarray(self._array(name)[first:end])
        except InputError:
            Remembered(self.place, self.identity).forget()
            raise

    def __len__(self) -> int:
        return self.layout.recordings

    def label(self, name: str, rows: range | None = None) -> np.ndarray:
        """A variable with one value (or vector, or matrix) a recording, of all or of these."""
        rows = range(len(self)) if rows is None else rows
        values = self._read(name, rows.start, rows.stop)
        self._check(name, values)
        return values

    def _check(self, name: str, values: np.ndarray) -> None:
        """Raise InputError unless a variable's values, in its unit, can be what it says."""
        with reading("data", self.place, "holds what no generation writes"):
            check_values(name, values, self.layout.recordings)

    def state(self) -> State:
        """Which shards are missing or damaged; reads those that were not found whole before, on
        this machine and as they are now."""
        return state(self.place, self.identity, self.layout)

    def unfinished_shards(self) -> list[int]:
        """What generation has to do, or to do again: shards that are missing or damaged. What files
        they have are removed, since one of a variable that is zero would not be written over."""
        unfinished = self.state().unfinished
        left = set(unfinished)
        with writing(self.place):
            for name in self.place.entries():
                if shard_of(name, self.layout.variables) in left:
                    self.place.remove(name)
        return unfinished

    def remember(self) -> None:
        """Take for whole what has just been written here, by this program and in its own place."""
        remember(self.place, self.identity, self.layout)

    def write_shard(self, shard: int, batch: Mapping[str, np.ndarray]) -> None:
        """Write all variables of a shard's recordings, then its checksums.

        batch : name -> array whose first axis is the shard's recordings, for every variable;
        fastest where (recording, time, axis) lies axis by axis in memory, as it is stored, and
        what stands still is `np.broadcast_to`: see `lbgc.data.shard`.
        Raises InputError where it cannot be written.
        """
        layout, files = self.layout, {}
        missing = set(layout.variables) ^ set(batch)
        assert not missing, f"a shard holds every variable and no other: {missing}"
        assert layout.schema == SCHEMA, "an earlier version's datasets are only read"
        names = layout.files(shard)
        values = {n: v.astype(layout.dtype(n), copy=False) for n, v in batch.items()}
        for name, file in zip(sorted(layout.variables), names, strict=True):
            by_axis = VARIABLES[name].dims == RECORDED
            stored = values[name].swapaxes(1, 2) if by_axis else values[name]
            if not is_zero(stored):
                how = layout.compression(name)
                files[file] = encoded(stored, layout.chunk(name), layout.shard, how)
        stored_is = manifest.stored_checksum(self.identity, shard, names, files.get)
        sizes = manifest.sizes_checksum({name: len(content) for name, content in files.items()})
        (row,) = row_files(shard)
        with writing(self.place):
            self.place.write_all(files)
            self.place.write(row, with_checksum(stored_is + sizes))

    def _shard_digest(self, shard: int, there: Container[str]) -> bytes:
        """SHA-256 over the shard's decoded arrays, read from the store. there : the files that it
        has; a variable without one is zero, and Zarr is not asked."""
        rows, layout = self.layout.rows(shard), self.layout
        arrays = (
            (name, self._read(name, rows.start, rows.stop))
            if file in there
            else (name, layout.zeros(name, len(rows)))
            for name, file in zip(sorted(layout.variables), layout.files(shard), strict=True)
        )
        return _digest(arrays)

    def digest(self) -> str:
        """The dataset's digest, computed anew from every decoded array."""
        whole, there = hashlib.sha256(), self.place.entries()
        shards = tqdm(range(self.layout.shards), "digest", unit="shard", leave=False, delay=1)
        for shard in shards:
            whole.update(self._shard_digest(shard, there))
        return whole.hexdigest()

    def in_split(self, split: str) -> np.ndarray:
        """Indices of a split's recordings."""
        return np.flatnonzero(self.label("split") == SPLITS.index(split))

    def records(self, indices: np.ndarray) -> Iterator[Record]:
        """The recordings at these indices, ascending; a chunk is read once, and then let go."""
        labels = {n: self.label(n) for n in ("heading", "heading_reference", "latitude")}
        axis, held = self._axis, self._tumbles
        names = ("gyro", "accel", "plate_angle", *(("attitude",) if held else ()))
        ascending = np.sort(indices)
        ends = np.flatnonzero(np.diff(ascending // self.layout.chunk("gyro"))) + 1
        for inside in np.split(ascending, ends) if len(ascending) else ():
            span = slice(int(inside[0]), int(inside[-1]) + 1)
            data = {n: self._decoded(n, span) for n in names}
            for i in inside:
                at = int(i) - span.start
                yield Record(
                    name=f"{shown(self.place.name)}[{i}]",
                    gyro=data["gyro"][at],
                    accel=data["accel"][at],
                    plate_angle=data["plate_angle"][at],
                    rate_hz=self.rate_hz,
                    latitude=float(labels["latitude"][i]),
                    heading=float(labels["heading"][i]),
                    heading_reference=float(labels["heading_reference"][i]),
                    axis=axis,
                    held=self._held(data["attitude"][at], labels["heading"][i]) if held else None,
                )

    def _held(self, attitude: np.ndarray, heading: float) -> Held:
        """What is known of a tumble. attitude : (T, 3), as it is stored; heading : its label."""
        true = attitude.astype(float)
        true[:, 2] += heading
        return Held(attitude=true)

    def _decoded(self, name: str, span: slice) -> np.ndarray:
        scale = self.layout.scales.get(name)
        values = self._read(name, span.start, span.stop)
        values = values if scale is None else values * scale
        self._check(name, values)
        return values
