"""Encoding of a shard's file of one variable, byte for byte as Zarr would write it.

Zarr takes a millisecond an array, and a shard has sixty arrays. Through Zarr, `generate` takes 1.2
to 1.3 times the processor time for 3072 recordings of means, 1.24 times for 2048 on two positions,
and 1.34 times for 16 recordings of every sample. The format is simple: each chunk is compressed and
followed by a checksum; a file of several chunks ends with an index of them.
"""

from functools import lru_cache

import google_crc32c
import numpy as np
from numcodecs import Blosc

CHECKSUM_BYTES = 4
_ABSENT = np.uint64(2**64 - 1)
"""Entry of the index for a chunk that is not in the file."""


def with_checksum(content: bytes) -> bytes:
    """The content with its CRC-32C behind it, as Zarr's crc32c codec writes it."""
    checksum: int = google_crc32c.value(content)
    return content + checksum.to_bytes(CHECKSUM_BYTES, "little")


def _compressed(values: np.ndarray) -> bytes:
    """A chunk as it is stored, compressed and with its checksum. Much of a dataset is constant in
    time, and mostly zero; such chunks are kept and not compressed again."""
    if _is_still(values):
        return _compressed_still(values[..., :1].tobytes(), values.shape, values.dtype)
    return _with_blosc(np.ascontiguousarray(values))


def _is_still(values: np.ndarray) -> bool:
    """Whether all values along the last axis are equal to the bit (minus zero is not zero)."""
    if values.strides[-1] == 0:
        return True
    bits = values.view(f"u{values.itemsize}")
    first = bits[..., :1]
    return bool((bits[..., -1:] == first).all() and (bits == first).all())


@lru_cache(maxsize=16)
def _compressed_still(first: bytes, shape: tuple[int, ...], dtype: np.dtype) -> bytes:
    """A stored chunk whose values are constant along its last axis; first : their bytes at the
    start of that axis."""
    start = np.frombuffer(first, dtype).reshape(*shape[:-1], 1)
    return _with_blosc(np.ascontiguousarray(np.broadcast_to(start, shape)))


def _with_blosc(values: np.ndarray) -> bytes:
    """A chunk compressed by Blosc, with its checksum."""
    blosc = Blosc("zstd", 1, Blosc.BITSHUFFLE, typesize=values.itemsize)
    return with_checksum(blosc.encode(values))


def encoded(values: np.ndarray, chunk: int, whole: int) -> bytes:
    """The content of a file that stores one variable for a shard of `whole` recordings, in chunks
    of `chunk` recordings.

    values : (recordings, ...), of the stored dtype and in the stored order of axes; in the last
    shard there may be fewer than `whole`. A chunk that is not full is filled with zeros.
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
