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


def drawn(config: ProtocolConfig, rng: np.random.Generator) -> np.ndarray:
    """C_nb of the attitudes of one recording, their headings from the base's azimuth: (P, 3, 3).

    Down in the body's axes is (-sin pitch, cos pitch sin roll, cos pitch cos roll), so that it is
    uniform on the sphere where roll and the sine of the pitch are uniform.
    """
    count = config.places
    if config.attitudes_deg is not None:
        roll, pitch, heading = np.deg2rad(config.attitudes_deg).T
    else:
        heading = rng.uniform(-np.pi, np.pi, count)
        if config.downs == "sphere":
            roll, pitch = rng.uniform(-np.pi, np.pi, count), np.arcsin(rng.uniform(-1, 1, count))
            return euler_to_matrix(roll, pitch, heading)
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
