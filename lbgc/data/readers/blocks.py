"""Long columns block by block, so that what is made of them on the way takes little memory."""

from collections.abc import Iterator

import numpy as np

ROWS = 2**20
"""Rows in a block."""
_PARTS = 16
"""Stretches by which a long column is judged."""


def blocks(rows: int, size: int = ROWS) -> Iterator[slice]:
    """The rows in blocks of this size, the last one shorter."""
    for first in range(0, rows, size):
        yield slice(first, min(first + size, rows))


def some(values: np.ndarray) -> np.ndarray:
    """Values (T, ...) by which a median is told: all, or of more than a million rows sixteen
    stretches from the first to the last, in the order of time."""
    if len(values) <= ROWS:
        return values
    length = ROWS // _PARTS
    starts = np.linspace(0, len(values) - length, _PARTS).astype(int)
    return np.concatenate([values[first : first + length] for first in starts])
