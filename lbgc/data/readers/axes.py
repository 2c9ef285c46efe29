"""The notation for which of a file's axes point forward, right and down, such as [y, x, -z]."""

from collections.abc import Sequence

import numpy as np

from lbgc.errors import require


def require_axes(name: str, axes: Sequence[str]) -> None:
    """Raise InputError unless axes are x, y and z in some order, each with or without a minus."""
    letters = sorted(axis.removeprefix("-") for axis in axes)
    require(
        letters == ["x", "y", "z"],
        name,
        axes,
        "must be x, y, z, in the order forward, right, down, each with a minus if it points the "
        "other way",
    )


def matrix_of(axes: Sequence[str]) -> np.ndarray:
    """The matrix, (3, 3), from the file's (x, y, z) to (forward, right, down)."""
    matrix = np.zeros((3, 3))
    for row, axis in enumerate(axes):
        matrix[row, "xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return matrix


def is_right_handed(axes: Sequence[str]) -> bool:
    """Whether these axes of a right-handed frame make a right-handed body frame."""
    return bool(np.linalg.det(matrix_of(axes)) > 0)


def spelled(matrix: np.ndarray) -> str:
    """A signed permutation matrix (3, 3) in the notation that a user types: [y,x,-z]."""
    letters = ("xyz"[int(np.abs(row).argmax())] for row in matrix)
    signs = ("-" if row.sum() < 0 else "" for row in matrix)
    return "[" + ",".join(sign + letter for sign, letter in zip(signs, letters, strict=True)) + "]"
