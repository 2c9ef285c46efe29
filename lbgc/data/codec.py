"""A Blosc codec that decodes complete frames only. C-Blosc trusts the length that a frame states,
and reads beyond the frame's end where that is wrong."""

import math
from typing import Any

import zarr
from zarr.codecs import BloscCodec
from zarr.registry import register_codec

_HEADER = 16
"""Bytes of a frame's header: four with versions, flags and the size of a value, then four each with
the size of the content, of a block, and of the frame."""


class WholeBlosc(BloscCodec):
    """The Blosc codec, which raises ValueError for a frame that is not complete. Zarr uses it in
    this process, for reading and writing, after `take` was called."""

    def _decode_sync(self, chunk_bytes: Any, chunk_spec: Any) -> Any:
        frame = chunk_bytes.to_bytes()
        expected = math.prod(chunk_spec.shape) * chunk_spec.dtype.item_size
        content, own = (int.from_bytes(frame[i : i + 4], "little") for i in (4, 12))
        if len(frame) < _HEADER or own != len(frame) or content != expected:
            raise ValueError(f"a compressed chunk of {len(frame)} bytes is not whole")
        return super()._decode_sync(chunk_bytes, chunk_spec)


def take() -> None:
    """Make Zarr use `WholeBlosc` as its Blosc codec."""
    name = f"{WholeBlosc.__module__}.{WholeBlosc.__qualname__}"
    register_codec("blosc", WholeBlosc, qualname=name)
    zarr.config.set({"codecs.blosc": name})
