"""Attitudes in which a hand holds an IMU: drawn, or listed and laid a little beside."""

from dataclasses import replace

import numpy as np

from lbgc.frames import euler_to_matrix, matrix_to_euler, rotation_matrix
from lbgc.protocol import Plan, ProtocolConfig
from lbgc.units import DEG

FACES = ((0.0, 0.0), (np.pi, 0.0), (np.pi / 2, 0.0), (-np.pi / 2, 0.0), (0.0, np.pi / 2),
         (0.0, -np.pi / 2))  # fmt: skip
"""Roll and pitch, rad, of a box on each of its faces: its down axis points down or up, its right
axis down or up, its forward axis up or down."""


def uniform(rng: np.random.Generator, count: int) -> np.ndarray:
    """Attitudes C_nb, (count, 3, 3), each as probable as any other: those of unit quaternions."""
    w, x, y, z = (own := rng.standard_normal((4, count))) / np.linalg.norm(own, axis=0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def drawn(config: ProtocolConfig, rng: np.random.Generator) -> np.ndarray:
    """C_nb of the attitudes of one recording, their headings from the base's azimuth: (P, 3, 3)."""
    count = config.places
    if config.attitudes_deg is not None:
        roll, pitch, heading = np.deg2rad(config.attitudes_deg).T
    elif config.downs == "sphere":
        return uniform(rng, count)
    else:
        heading = rng.uniform(-np.pi, np.pi, count)
        rounds = -(-count // len(FACES))
        order = np.concatenate([rng.permutation(len(FACES)) for _ in range(rounds)])[:count]
        roll, pitch = np.array(FACES)[order].T
    beside = np.zeros((count, 3))
    beside[:, :2] = config.placed_deg * DEG * rng.standard_normal((count, 2))
    return np.asarray(rotation_matrix(beside) @ euler_to_matrix(roll, pitch, heading))


def with_attitudes(plan: Plan, config: ProtocolConfig, rng: np.random.Generator) -> Plan:
    """The plan of a tumble with its recording's own attitudes."""
    assert plan.handling is not None
    angles = np.stack(matrix_to_euler(drawn(config, rng)), axis=1).tolist()
    attitudes = tuple((roll, pitch, heading) for roll, pitch, heading in angles)
    return replace(plan, handling=replace(plan.handling, attitudes=attitudes))
