"""Blosc, given only what is whole: C-Blosc believes a frame's own word for its length, and reads
beyond its end where that is wrong."""

import math
from typing import Any

import zarr
from zarr.codecs import BloscCodec
from zarr.registry import register_codec

_HEADER = 16
"""Bytes: four of versions, flags and the size of a value; then content's, block's and own size."""


class WholeBlosc(BloscCodec):
    """Blosc that decodes nothing but whole frames, for reading and writing; `zarr` uses it in this
    process once it is taken."""

    def _decode_sync(self, chunk_bytes: Any, chunk_spec: Any) -> Any:
        frame = chunk_bytes.to_bytes()
        expected = math.prod(chunk_spec.shape) * chunk_spec.dtype.item_size
        content, own = (int.from_bytes(frame[i : i + 4], "little") for i in (4, 12))
        if len(frame) < _HEADER or own != len(frame) or content != expected:
            raise ValueError(f"a compressed chunk of {len(frame)} bytes is not whole")
        return super()._decode_sync(chunk_bytes, chunk_spec)


def take() -> None:
    """Let Zarr decode Blosc with `WholeBlosc`."""
    name = f"{WholeBlosc.__module__}.{WholeBlosc.__qualname__}"
    register_codec("blosc", WholeBlosc, qualname=name)
    zarr.config.set({"codecs.blosc": name})
