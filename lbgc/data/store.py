"""The dataset: one Zarr v3 store, and the only file that touches Zarr.

Every array has its dimensions' names, units and a long name. What a shard holds is written by one
task; the manifest (`manifest/digest`, a SHA-256 a shard) is written last, so that what it names is
whole. A dataset is finished when every shard is in the manifest; completeness never comes from
files being there, since a missing shard would read silently as zeros.
"""

import hashlib
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec, TransposeCodec

from lbgc.data.record import Record
from lbgc.data.schema import AXES, RECORDED, SCHEMA, SPLITS, VARIABLES, Variable
from lbgc.errors import InputError, require
from lbgc.outputs import fingerprint

_SHARD_BYTES = 64e6
_SHARD_RECORDINGS = 16
_CHUNK_BYTES = 4e6


@dataclass(frozen=True)
class Layout:
    """A dataset's shape: recordings, samples each, their rate, and the counts' scale (or None)."""

    recordings: int
    samples: int
    rate_hz: float
    scales: Mapping[str, float | None]
    """gyro, accel: SI per count, or None where floats are stored."""

    @property
    def shard(self) -> int:
        """Recordings a shard: as much as one task holds in memory. Never depends on how many
        recordings there are, so that a longer dataset begins with the same shards."""
        one = self.samples * 6 * 4
        return int(np.clip(_SHARD_BYTES // one, 1, _SHARD_RECORDINGS if one > 1e5 else 512))

    @property
    def shards(self) -> int:
        return -(-self.recordings // self.shard)

    def rows(self, shard: int) -> range:
        """The recordings of a shard."""
        return range(shard * self.shard, min((shard + 1) * self.shard, self.recordings))


def create(path: Path, layout: Layout, configuration: Mapping, recipe: Mapping) -> "Dataset":
    """Start a dataset, or go on with the same one that was started here before.

    configuration : what decides the dataset's content, JSON-able; recipe : what else a reader
    may want (package versions). Raises InputError where `path` holds anything else.
    """
    identity = fingerprint({"schema": SCHEMA, **configuration})
    if path.exists() and any(path.iterdir()):
        found = Dataset.open(path)
        if found.identity != identity:
            raise InputError(
                "out", path, "", "holds a dataset of another configuration; choose another path"
            )
        return found
    attributes = {
        "Conventions": "CF-1.11",
        "title": "lbgc dataset",
        "schema": SCHEMA,
        "identity": identity,
        "configuration": dict(configuration),
        "rate_hz": layout.rate_hz,
        **recipe,
    }
    # Made beside and renamed, so that a path holds either a whole (empty) dataset or nothing.
    building = path.with_name(path.name + ".creating")
    shutil.rmtree(building, ignore_errors=True)
    root = zarr.create_group(building, attributes=attributes)
    manifest = root.create_group("manifest")
    manifest.create_array(
        "digest",
        shape=(layout.shards, 32),
        chunks=(1, 32),
        dtype="uint8",
        fill_value=0,
        compressors=[Crc32cCodec()],
        dimension_names=("shard", "byte"),
        attributes={"long_name": "SHA-256 of a finished shard's decoded arrays"},
    )
    sizes = {"recording": layout.recordings, "time": layout.samples, "axis": 3, "axis_in": 3}
    for name, variable in VARIABLES.items():
        _create_array(root, name, variable, layout, sizes)
    _create_coordinates(root, layout)
    if path.exists():
        path.rmdir()  # it is empty
    building.rename(path)
    return Dataset.open(path)


def _create_array(
    root: zarr.Group, name: str, variable: Variable, layout: Layout, sizes: Mapping[str, int]
) -> None:
    scale = layout.scales.get(name)
    dtype = variable.dtype or ("float32" if scale is None else "int32")
    attributes: dict[str, Any] = {"units": variable.units, "long_name": variable.long_name}
    if scale is not None:
        attributes["scale_factor"] = scale
    if variable.flags:
        attributes["flag_values"] = list(range(len(variable.flags)))
        attributes["flag_meanings"] = " ".join(variable.flags)
    shape = tuple(sizes[d] for d in variable.dims)
    shard = (layout.shard, *shape[1:])
    chunk, filters = shard, []
    if variable.dims == RECORDED:
        bytes_each = 12 * layout.samples
        per_chunk = max(1, int(_CHUNK_BYTES // bytes_each)) if layout.shard > 16 else 1
        while layout.shard % per_chunk:
            per_chunk -= 1
        chunk, filters = (per_chunk, *shape[1:]), [TransposeCodec(order=(0, 2, 1))]
    root.create_array(
        name=name,
        shape=shape,
        dtype=dtype,
        chunks=chunk,
        shards=shard if chunk != shard else None,
        filters=filters,
        # crc32c last: the checksum is of the bytes on disk. The other order is accepted silently.
        compressors=[BloscCodec(cname="zstd", clevel=1, shuffle="bitshuffle"), Crc32cCodec()],
        fill_value=0,
        dimension_names=variable.dims,
        attributes=attributes,
        config={"write_empty_chunks": True},
    )


def _create_coordinates(root: zarr.Group, layout: Layout) -> None:
    time = (np.arange(layout.samples) + 1) / layout.rate_hz
    coordinates: tuple[tuple[str, np.ndarray, dict], ...] = (
        ("time", time, {"units": "s", "long_name": "end of the sample's interval"}),
        ("axis", np.arange(3, dtype="int8"), {"units": "1", "long_name": "body axis"}),
    )
    for name, values, attributes in coordinates:
        if name == "axis":
            attributes |= {"flag_values": [0, 1, 2], "flag_meanings": " ".join(AXES)}
        root.create_array(
            name=name,
            data=values,
            chunks=values.shape,
            compressors=[BloscCodec(cname="zstd", clevel=1, shuffle="shuffle"), Crc32cCodec()],
            dimension_names=(name,),
            attributes=attributes,
        )


class Dataset:
    """A dataset opened for reading, and for writing the shards it still lacks."""

    def __init__(self, path: Path, group: zarr.Group):
        self.path, self._group = path, group

    @classmethod
    def open(cls, path: str | Path) -> "Dataset":
        """Open a dataset, finished or not. A directory holding `dataset.zarr` will do.

        Raises InputError where there is none, or one of another schema.
        """
        path = Path(path)
        if not (path / "zarr.json").exists() and (path / "dataset.zarr").exists():
            path = path / "dataset.zarr"
        what = "is no dataset; make one with `python sim/generate.py`"
        require((path / "zarr.json").is_file(), "data", path, what)
        try:
            group = zarr.open_group(path, mode="r")
        except (ValueError, KeyError, OSError) as error:
            raise InputError("data", path, "", f"{what} ({error})") from error
        schema = group.attrs.get("schema")
        require("identity" in group.attrs, "data", path, what)
        require(
            schema == SCHEMA,
            "data",
            path,
            f"has schema {schema}, this version reads {SCHEMA}; generate it again",
        )
        return cls(path, group)

    @classmethod
    def open_finished(cls, path: str | Path) -> "Dataset":
        """Open a dataset that must be whole. Raises InputError where its generation did not end."""
        dataset = cls.open(path)
        missing = dataset.missing_shards()
        require(
            not missing,
            "data",
            path,
            f"is not finished: {len(missing)} of {len(dataset._manifest())} shards are missing; "
            "run the command that generated it again",
        )
        return dataset

    @property
    def identity(self) -> str:
        return str(self._group.attrs["identity"])

    @property
    def configuration(self) -> dict:
        return dict(self._group.attrs["configuration"])  # type: ignore[arg-type]

    @property
    def rate_hz(self) -> float:
        return float(self._group.attrs["rate_hz"])  # type: ignore[arg-type]

    def _array(self, name: str) -> zarr.Array:
        array = self._group[name]
        assert isinstance(array, zarr.Array)
        return array

    @cached_property
    def layout(self) -> Layout:
        recordings, samples, _ = self._array("gyro").shape
        scales = {n: self._array(n).attrs.get("scale_factor") for n in ("gyro", "accel")}
        return Layout(recordings, samples, self.rate_hz, scales)  # type: ignore[arg-type]

    def __len__(self) -> int:
        return self.layout.recordings

    def label(self, name: str) -> np.ndarray:
        """A variable with one value (or vector, or matrix) a recording, whole."""
        return np.asarray(self._array(name)[:])

    def _manifest(self) -> np.ndarray:
        return np.asarray(self._array("manifest/digest")[:])

    def missing_shards(self) -> list[int]:
        return np.flatnonzero(~self._manifest().any(axis=1)).tolist()

    def write_shard(self, shard: int, batch: Mapping[str, np.ndarray]) -> None:
        """Write all variables of a shard's recordings, then its digest.

        batch : name -> array whose first axis is the shard's recordings, for every variable.
        """
        missing = set(VARIABLES) ^ set(batch)
        assert not missing, f"a shard holds every variable and no other: {missing}"
        group = zarr.open_group(self.path, mode="r+")
        rows = self.layout.rows(shard)
        with zarr.config.set({"array.write_empty_chunks": True}):
            for name, values in batch.items():
                group[name][rows.start : rows.stop] = values  # type: ignore[index]
        digest = np.frombuffer(self._shard_digest(shard), np.uint8)
        group["manifest/digest"][shard] = digest  # type: ignore[index]

    def _shard_digest(self, shard: int) -> bytes:
        """SHA-256 over the shard's decoded arrays, read back from the store."""
        rows = self.layout.rows(shard)
        digest = hashlib.sha256()
        for name in sorted(VARIABLES):
            values = np.ascontiguousarray(self._array(name)[rows.start : rows.stop])
            digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
            digest.update(values.data)
        return digest.digest()

    def digest(self) -> str:
        """The dataset's digest, computed anew from every decoded array."""
        whole = hashlib.sha256()
        for shard in range(self.layout.shards):
            whole.update(self._shard_digest(shard))
        return whole.hexdigest()

    def in_split(self, split: str) -> np.ndarray:
        """Indices of a split's recordings."""
        return np.flatnonzero(self.label("split") == SPLITS.index(split))

    def records(self, indices: np.ndarray) -> Iterator[Record]:
        """The recordings at these indices, ascending; whole shards are read once."""
        labels = {n: self.label(n) for n in ("heading", "heading_reference", "latitude")}
        for shard in np.unique(np.asarray(indices) // self.layout.shard):
            rows = self.layout.rows(int(shard))
            inside = np.asarray([i for i in np.sort(indices) if i in rows])
            span = slice(int(inside[0]), int(inside[-1]) + 1)
            data = {n: self._decoded(n, span) for n in ("gyro", "accel", "plate_angle")}
            for i in inside:
                at = int(i) - span.start
                yield Record(
                    name=f"{self.path.name}[{i}]",
                    gyro=data["gyro"][at],
                    accel=data["accel"][at],
                    plate_angle=data["plate_angle"][at],
                    rate_hz=self.rate_hz,
                    latitude=float(labels["latitude"][i]),
                    heading=float(labels["heading"][i]),
                    heading_reference=float(labels["heading_reference"][i]),
                )

    def _decoded(self, name: str, span: slice) -> np.ndarray:
        array = self._array(name)
        scale = array.attrs.get("scale_factor")
        values = np.asarray(array[span])
        return values if scale is None else values * float(scale)  # type: ignore[arg-type]
