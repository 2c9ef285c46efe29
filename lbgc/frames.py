"""Rotations and angles. Everything broadcasts over leading axes.

SciPy's Rotation agrees to 1e-15, but the last bits of datasets are of these functions. On 6000
rotations it takes 4 times as long for Euler angles, 11 to 12 for their matrices and for rotation
vectors, and a fifth for `rotation_matrix`; recordings in a vehicle take 4% longer with it.
"""

import numpy as np

AXES = ("forward", "right", "down")
"""The body's axes, by their numbers."""
DOWN = 2
_OF_FEWER = {1: ("measured",), 2: ("first", "second")}
NED_FROM_NWU = np.diag([1.0, -1.0, -1.0])
"""Matrix that takes components in MuJoCo's world, North-West-Up, to n."""


def axis_names(count: int) -> tuple[str, ...]:
    """What the axes of a triad are called: those of the body where there are three. One or two that
    were measured alone are of no frame."""
    return _OF_FEWER.get(count, AXES)


def wrap(angle: np.ndarray | float) -> np.ndarray:
    """An angle wrapped to (-pi, pi]. angle : rad, any shape."""
    return np.pi - np.mod(np.pi - np.asarray(angle, dtype=float), 2 * np.pi)


def rotation_z(angle: np.ndarray | float) -> np.ndarray:
    """C_nb of a level body at this heading: angle (*S) in rad -> (*S, 3, 3)."""
    return euler_to_matrix(0.0, 0.0, angle)


def rotation(angle: np.ndarray | float, axis: int) -> np.ndarray:
    """The rotation by an angle about one of the axes, by the right-hand rule: (*S) in rad ->
    (*S, 3, 3)."""
    return euler_to_matrix(*(angle if axis == own else 0.0 for own in range(3)))


def across(axis: int) -> tuple[int, int]:
    """The two axes across one, in the order in which they are right-handed with it."""
    return (axis + 1) % 3, (axis + 2) % 3


def turned(values: np.ndarray, angle: np.ndarray, axis: int = DOWN) -> np.ndarray:
    """Vectors turned by an angle about one of the axes, C(angle) v; the component along it stays.

    values : (*S, 3), or (*S, 2) without the down component; angle : rad, broadcasts with S, so that
    one angle can turn a whole row.
    """
    c, s = np.cos(angle), np.sin(angle)
    i, j = across(axis)
    x, y = values[..., i], values[..., j]
    out = np.empty((*np.broadcast_shapes(x.shape, c.shape), values.shape[-1]))
    out[..., i] = c * x - s * y
    out[..., j] = s * x + c * y
    if values.shape[-1] == len(AXES):
        out[..., axis] = values[..., axis]
    return out


def unrepeated(angle: np.ndarray) -> np.ndarray:
    """Angles of the plate, (W, T), or their first column, (W, 1), where no row changes: what
    broadcasts over it is then computed once."""
    return angle[:, :1] if (angle == angle[:, :1]).all() else angle


def euler_to_matrix(
    roll: np.ndarray | float, pitch: np.ndarray | float, yaw: np.ndarray | float
) -> np.ndarray:
    """C_nb from z-y-x Euler angles (the paper's eq. 8).

    roll, pitch, yaw : rad, broadcast to a common shape S. Returns (*S, 3, 3).
    """
    phi, theta, psi = np.broadcast_arrays(roll, pitch, yaw)
    sf, cf = np.sin(phi), np.cos(phi)
    st, ct = np.sin(theta), np.cos(theta)
    sp, cp = np.sin(psi), np.cos(psi)
    return np.stack(
        [
            np.stack([ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp], axis=-1),
            np.stack([ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp], axis=-1),
            np.stack([-st, sf * ct, cf * ct], axis=-1),
        ],
        axis=-2,
    )


def level(f_ib_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch from specific force at rest (the paper's eqs. 10-11; Groves 2013, eq. 5.101).

    f_ib_b : (W, 3), m/s^2. Returns rad, (W,) each. They do not depend on g.
    """
    x, y, z = f_ib_b[:, 0], f_ib_b[:, 1], f_ib_b[:, 2]
    return np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z))


def matrix_to_euler(c_nb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Roll, pitch, yaw in rad, each (*S), of C_nb (*S, 3, 3); pitch in [-pi/2, pi/2].

    At pitch +-90 degrees only yaw -+ roll is defined; roll is then what the arithmetic leaves.
    """
    roll = np.arctan2(c_nb[..., 2, 1], c_nb[..., 2, 2])
    pitch = np.arctan2(-c_nb[..., 2, 0], np.hypot(c_nb[..., 2, 1], c_nb[..., 2, 2]))
    yaw = np.arctan2(c_nb[..., 1, 0], c_nb[..., 0, 0])
    return roll, pitch, yaw


def about_vertical(matrix: np.ndarray) -> np.ndarray:
    """The angle about the vertical of the turn about it that comes nearest to a rotation, or to a
    mean of some: (*S, 3, 3) -> (*S), rad."""
    sine = matrix[..., 1, 0] - matrix[..., 0, 1]
    return np.asarray(np.arctan2(sine, matrix[..., 0, 0] + matrix[..., 1, 1]))


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """The rotation vector (axis times angle) of rotations by less than pi: (*S, 3, 3) -> (*S, 3).

    Its sine part is half the vector of M - M'; angle/sin(angle) follows from its length and the
    trace (Groves 2013, eq. 2.23), so that small rotations keep all their digits.
    """
    x = matrix[..., 2, 1] - matrix[..., 1, 2]  # by component: NumPy is slow over an axis of three
    y = matrix[..., 0, 2] - matrix[..., 2, 0]
    z = matrix[..., 1, 0] - matrix[..., 0, 1]
    sine = np.sqrt(x * x + y * y + z * z) / 2
    trace = matrix[..., 0, 0] + matrix[..., 1, 1] + matrix[..., 2, 2]
    angle = np.arctan2(sine, (trace - 1) / 2)
    small = sine < 1e-4
    half = np.where(small, 1 + sine**2 / 6, angle / np.where(small, 1.0, sine)) / 2
    return np.stack([x * half, y * half, z * half], axis=-1)


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """The rotation matrix of a rotation vector: (*S, 3), rad -> (*S, 3, 3) (Rodrigues' formula;
    Groves 2013, eq. 2.17)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = skew(vector)
    half = np.sinc(angle / (2 * np.pi))  # sin(a/2)/(a/2)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + half**2 / 2 * (cross @ cross))


def one_after_the_other(vectors: np.ndarray) -> np.ndarray:
    """The rotation that turns make one after the other, each about the axes that the last has
    turned, from the axes behind them to those before: (m, 3), rad, rotation vectors -> (3, 3)."""
    found = rotation_matrix(vectors)
    while len(found) > 1:
        if len(found) % 2:
            found = np.concatenate([found, np.eye(3)[None]])
        found = found[::2] @ found[1::2]
    return np.asarray(found[0] if len(found) else np.eye(3))


def skew(vector: np.ndarray) -> np.ndarray:
    """The matrix whose product with w is the cross product vector x w: (*S, 3) -> (*S, 3, 3)."""
    x, y, z = np.moveaxis(np.asarray(vector, dtype=float), -1, 0)
    none = np.zeros_like(x)
    rows = ((none, -z, y), (z, none, -x), (-y, x, none))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
