"""A shard's file of one variable, byte for byte as Zarr would write it.

Zarr takes a millisecond an array, and a shard has sixty: as long as all the rest of a shard of
means. What it writes is simple: each chunk compressed, a checksum behind it; where a file holds
several chunks, an index of them at its end.
"""

from functools import lru_cache

import google_crc32c
import numpy as np
from numcodecs import Blosc

CHECKSUM_BYTES = 4
_ABSENT = np.uint64(2**64 - 1)


def with_checksum(content: bytes) -> bytes:
    """Zarr's crc32c codec."""
    checksum: int = google_crc32c.value(content)
    return content + checksum.to_bytes(CHECKSUM_BYTES, "little")


def _compressed(values: np.ndarray) -> bytes:
    """A chunk. Much of a dataset stays as it is in time, and mostly at zero: it is found again."""
    if _is_still(values):
        return _compressed_still(values[..., :1].tobytes(), values.shape, values.dtype)
    return _with_blosc(np.ascontiguousarray(values))


def _is_still(values: np.ndarray) -> bool:
    """Whether nothing changes along the last axis, to the bit: minus zero is not zero."""
    if values.strides[-1] == 0:
        return True
    bits = values.view(f"u{values.itemsize}")
    first = bits[..., :1]
    return bool((bits[..., -1:] == first).all() and (bits == first).all())


@lru_cache(maxsize=16)
def _compressed_still(first: bytes, shape: tuple[int, ...], dtype: np.dtype) -> bytes:
    """A chunk of which these are the values at the start of its last axis, and throughout."""
    start = np.frombuffer(first, dtype).reshape(*shape[:-1], 1)
    return _with_blosc(np.ascontiguousarray(np.broadcast_to(start, shape)))


def _with_blosc(values: np.ndarray) -> bytes:
    blosc = Blosc("zstd", 1, Blosc.BITSHUFFLE, typesize=values.itemsize)
    return with_checksum(blosc.encode(values))


def encoded(values: np.ndarray, chunk: int, whole: int) -> bytes:
    """The file of a shard of `whole` recordings, in chunks of so many.

    values : (recordings, ...), of the stored dtype, fewer than `whole` in the last shard; in the
    order of axes that is stored. What is missing of a chunk is filled with zeros.
    """
    chunks = []
    for first in range(0, len(values), chunk):
        part = values[first : first + chunk]
        if len(part) < chunk:
            part = np.concatenate(
                [part, np.zeros((chunk - len(part), *part.shape[1:]), part.dtype)]
            )
        chunks.append(_compressed(part))
    if chunk == whole:
        (only,) = chunks
        return only
    index = np.full((whole // chunk, 2), _ABSENT)
    sizes = np.array([len(c) for c in chunks], np.uint64)
    index[: len(chunks), 0] = np.cumsum(sizes) - sizes
    index[: len(chunks), 1] = sizes
    return b"".join([*chunks, with_checksum(index.astype("<u8").tobytes())])
