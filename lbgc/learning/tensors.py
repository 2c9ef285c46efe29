"""Tensors as files: safetensors, whose header is bounded before anything is read by it."""

from collections.abc import Mapping

from safetensors.torch import load, save
from torch import Tensor

MOST_HEADER = 2**20
"""Largest size, bytes, of the part of a file of weights that says what is in the rest."""


def header(content: bytes, most: int = MOST_HEADER) -> bytes:
    """The part that says what is in the rest, JSON. Raises ValueError where it is longer than the
    file, or than `most`."""
    size = int.from_bytes(content[:8], "little")
    if not 0 < size <= min(most, len(content) - 8):
        raise ValueError(f"its header of {size} bytes is too long")
    return content[8 : 8 + size]


def parse(content: bytes, most: int = MOST_HEADER) -> dict[str, Tensor]:
    """The tensors in a file's content, by name. most : bytes of its header. Raises an exception
    where it is damaged."""
    header(content, most)
    return load(content)


def composed(tensors: Mapping[str, Tensor]) -> bytes:
    """The content of a file of these tensors."""
    return save({name: value.detach().cpu().contiguous() for name, value in tensors.items()})
