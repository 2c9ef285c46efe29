"""Every file of a dataset that has no recordings yet: the metadata of its arrays, and coordinates.

With `store.py` the only file that touches Zarr.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec, TransposeCodec
from zarr.core.buffer import default_buffer_prototype
from zarr.core.chunk_key_encodings import ChunkKeyEncodingLike
from zarr.storage import MemoryStore

from lbgc.data.files import names_of, row_arrays, separator, shard_files
from lbgc.data.schema import ALWAYS, AXES, RECORDED, SCHEMA, VARIABLES
from lbgc.outputs import as_json

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
    variables: tuple[str, ...] = ALWAYS
    """Those that it has, in the order of VARIABLES."""
    schema: int = SCHEMA
    """The number of the schema by which its files are named."""

    @property
    def documents(self) -> tuple[str, ...]:
        """Its files before it has recordings: see `names_of`."""
        return names_of(self.variables, self.schema)

    def files(self, shard: int) -> list[str]:
        """The files that a shard may have, one a variable, by name."""
        return shard_files(shard, self.variables, self.schema)

    @cached_property
    def shard(self) -> int:
        """Recordings a shard: as much as one task holds in memory. Never depends on how many
        recordings there are, so that a longer dataset begins with the same shards."""
        one = self.samples * 6 * 4
        return int(np.clip(_SHARD_BYTES // one, 1, _SHARD_RECORDINGS if one > 1e5 else 512))

    @property
    def shards(self) -> int:
        """How many shards there are."""
        return -(-self.recordings // self.shard)

    def chunk(self, name: str) -> int:
        """Recordings a chunk of this variable: one, where it is large; else as many as make a few
        megabytes; what is small has one chunk a shard."""
        if VARIABLES[name].dims != RECORDED:
            return self.shard
        most = max(1, int(_CHUNK_BYTES // (12 * self.samples))) if self.shard > 16 else 1
        return next(size for size in range(most, 0, -1) if self.shard % size == 0)

    def compression(self, name: str) -> Literal["lz4", "zstd"]:
        """Blosc's compressor for a variable. What a sensor gives as floats is mostly noise, which
        none makes smaller: the fastest gives up soonest, at a quarter of the time."""
        noise = name in self.scales and self.scales[name] is None and self.schema > 4
        return "lz4" if noise else "zstd"

    def dtype(self, name: str) -> np.dtype:
        """The type in which a variable is stored."""
        scale = self.scales.get(name)
        return np.dtype(VARIABLES[name].dtype or ("float32" if scale is None else "int32"))

    def room(self, name: str, recordings: int, samples: int) -> np.ndarray:
        """An empty array for this variable of so many recordings and samples of each, in memory as
        it is stored: axis by axis, where it is (recording, time, axis)."""
        dims = VARIABLES[name].dims
        sizes = {"recording": recordings, "time": samples, "axis": 3, "axis_in": 3}
        if dims == RECORDED:
            return np.empty((recordings, 3, samples), self.dtype(name)).swapaxes(1, 2)
        return np.empty(tuple(sizes[d] for d in dims), self.dtype(name))

    def zeros(self, name: str, recordings: int) -> np.ndarray:
        """The values of a variable that is zero in so many recordings."""
        sizes = {"recording": recordings, "time": self.samples, "axis": 3, "axis_in": 3}
        shape = [sizes[d] for d in VARIABLES[name].dims]
        return np.broadcast_to(np.zeros((), self.dtype(name)), shape)

    def rows(self, shard: int) -> range:
        """The recordings of a shard."""
        return range(shard * self.shard, min((shard + 1) * self.shard, self.recordings))


def documents(layout: Layout, attributes: Mapping[str, Any]) -> dict[str, bytes]:
    """The files of a dataset of this layout that has no recordings yet, with these attributes of
    its root."""
    files: dict[str, Any] = {}
    root = zarr.create_group(MemoryStore(files), attributes=dict(attributes))
    root.create_group("manifest")
    for name, (size, long_name) in row_arrays(layout.schema).items():
        root.create_array(
            name,
            shape=(layout.shards, size),
            chunks=(1, size),
            dtype="uint8",
            fill_value=0,
            compressors=[Crc32cCodec()],
            dimension_names=("shard", "byte"),
            chunk_key_encoding=_keys(layout),
            attributes={"long_name": long_name},
        )
    alike: dict[tuple[Any, ...], zarr.Array[Any]] = {}
    for name in layout.variables:
        kind = (VARIABLES[name].dims, layout.dtype(name), layout.compression(name))
        if kind not in alike:  # Zarr takes most of a millisecond
            alike[kind] = _create_array(root, name, layout)
        own = alike[kind].metadata.update_attributes(_attributes(name, layout))
        files[f"{name}/zarr.json"] = own.to_buffer_dict(default_buffer_prototype())["zarr.json"]
    _create_coordinates(root, layout)
    made = {name: content.to_bytes() for name, content in files.items()}
    made["zarr.json"] = _consolidated(made)
    return {name: made[name] for name in layout.documents}


def _keys(layout: Layout) -> ChunkKeyEncodingLike:
    """How Zarr names an array's files."""
    return {"name": "default", "separator": separator(layout.schema)}


def _consolidated(made: Mapping[str, bytes]) -> bytes:
    """The root's document with what all others say in it, as Zarr-Python and xarray look for it
    first. Here nothing is read from it: the documents themselves have checksums."""
    own = "/zarr.json"
    inner = {n.removesuffix(own): json.loads(made[n]) for n in sorted(made) if n.endswith(own)}
    told = {"kind": "inline", "must_understand": False, "metadata": inner}
    return as_json({**json.loads(made["zarr.json"]), "consolidated_metadata": told}).encode()


def _attributes(name: str, layout: Layout) -> dict[str, Any]:
    """What a variable's document says of it beside how it is stored."""
    variable, scale = VARIABLES[name], layout.scales.get(name)
    attributes: dict[str, Any] = {"units": variable.units, "long_name": variable.long_name}
    if scale is not None:
        attributes["scale_factor"] = scale
    if variable.flags:
        attributes["flag_values"] = list(range(len(variable.flags)))
        attributes["flag_meanings"] = " ".join(variable.flags)
    return attributes


def _create_array(root: zarr.Group, name: str, layout: Layout) -> zarr.Array[Any]:
    """An array that is stored as this variable is."""
    sizes = {"recording": layout.recordings, "time": layout.samples, "axis": 3, "axis_in": 3}
    variable = VARIABLES[name]
    shape = tuple(sizes[d] for d in variable.dims)
    shard = (layout.shard, *shape[1:])
    chunk = (layout.chunk(name), *shape[1:])
    filters = [TransposeCodec(order=(0, 2, 1))] if variable.dims == RECORDED else []
    return root.create_array(
        name=name,
        shape=shape,
        dtype=layout.dtype(name),
        chunks=chunk,
        shards=shard if chunk != shard else None,
        filters=filters,
        # crc32c last: the checksum is of the bytes on disk. The other order is accepted silently.
        compressors=[
            BloscCodec(cname=layout.compression(name), clevel=1, shuffle="bitshuffle"),
            Crc32cCodec(),
        ],
        fill_value=0,
        dimension_names=variable.dims,
        chunk_key_encoding=_keys(layout),
    )


def _create_coordinates(root: zarr.Group, layout: Layout) -> None:
    time = (np.arange(layout.samples) + 1) / layout.rate_hz
    coordinates: tuple[tuple[str, np.ndarray, dict[str, Any]], ...] = (
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
            chunk_key_encoding=_keys(layout),
            attributes=attributes,
        )
