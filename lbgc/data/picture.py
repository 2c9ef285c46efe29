"""The picture of the bench that lies beside a dataset: where it is, and whether it is whole."""

import os
import zlib
from pathlib import Path

from lbgc.data.place import Place
from lbgc.outputs import read_file

_MOST_BYTES, _MOST_PIXELS = 32_000_000, 8192
_MAGIC, _END = b"\x89PNG\r\n\x1a\n", b"IEND"
_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Numbers a pixel by PNG's type of colour."""


def beside(place: Place) -> Path | None:
    """The path of a dataset's picture, whether there is one or not; None where the dataset is not
    on this machine."""
    if place.local is None:
        return None
    own = Path(os.path.abspath(place.local))
    return own.with_suffix(".png") if own.name else None


def read(path: Path) -> bytes | None:
    """A picture; None where there is no plain file, or none that holds a whole PNG and no more. A
    link is not followed: it could lead to any file of the reader's."""
    try:
        content = read_file(path, _MOST_BYTES, links=False)
    except (OSError, ValueError):
        return None
    return content if _is_whole(content) else None


def _is_whole(content: bytes) -> bool:
    """Whether this is one PNG, every checksum right and every row of pixels there."""
    if not content.startswith(_MAGIC):
        return False
    at, header, pixels, kind = len(_MAGIC), b"", [], b""
    while kind != _END:
        size = int.from_bytes(content[at : at + 4], "big")
        kind, data = content[at + 4 : at + 8], content[at + 8 : at + 8 + size]
        checksum = content[at + 8 + size : at + 12 + size]
        if zlib.crc32(kind + data).to_bytes(4, "big") != checksum or not (
            header or kind == b"IHDR"
        ):
            return False
        header = data if kind == b"IHDR" else header
        pixels += [data] if kind == b"IDAT" else []
        at += 12 + size
    return at == len(content) and _has_rows(header, b"".join(pixels))


def _has_rows(header: bytes, packed: bytes) -> bool:
    """Whether packed pixels unfold to the rows that a PNG's header states, and to no more."""
    if len(header) != 13:
        return False
    width, height = (int.from_bytes(header[i : i + 4], "big") for i in (0, 4))
    depth, colour, *ways, interlaced = header[8:]
    if not (0 < width <= _MOST_PIXELS and 0 < height <= _MOST_PIXELS) or any(ways):
        return False
    size = height * (1 + -(-width * depth * _SAMPLES.get(colour, 0) // 8))
    most = 2 * size + 64 if interlaced else size  # in seven passes, of which each has rows
    unfolding = zlib.decompressobj()
    try:
        return size <= len(unfolding.decompress(packed, most + 1)) <= most and unfolding.eof
    except zlib.error:
        return False
