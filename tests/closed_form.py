"""What a module on a turntable feels, written down from scratch: rotation matrices as a function of
the plate's own angle, rate and acceleration. Nothing of the project is imported, so that agreement
means something."""

import numpy as np

OMEGA = 7.292115e-5
HEIGHT = 0.282  # of the modules above the foot of the base, m


def about_x(a: float) -> np.ndarray:
    c, s = np.cos(a), np.sin(a)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def about_y(a: float) -> np.ndarray:
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def about_z(a: np.ndarray) -> np.ndarray:
    c, s, none = np.cos(a), np.sin(a), np.zeros_like(a)
    rows = ((c, -s, none), (s, c, none), (none, none, none + 1))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def felt(
    angle: np.ndarray,
    rate: np.ndarray,
    acceleration: np.ndarray,
    *,
    latitude: float,
    gravity: float,
    azimuth: float,
    roll: float,
    pitch: float,
    axis_tilt: float,
    arm: float,
) -> tuple[np.ndarray, np.ndarray]:
    """omega_ib_b and f_ib_b at instants (m,) -> (m, 3) each, of the module that looks backwards.

    North-East-Down; the base stands at z-y-x angles, its hinge axis tilted about its forward axis.
    """
    stand = about_z(np.array(azimuth)) @ about_y(pitch) @ about_x(roll) @ about_x(axis_tilt)
    turned = about_z(angle)
    c_nb = stand @ turned @ about_z(np.array(np.pi))
    site = turned @ np.array([-arm, 0.0, -HEIGHT])
    down = np.array([0.0, 0.0, 1.0])
    swept = np.cross(down, site)
    velocity = (rate[:, None] * swept) @ stand.T
    moved = acceleration[:, None] * swept + rate[:, None] ** 2 * np.cross(down, swept)
    earth = OMEGA * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
    specific = moved @ stand.T + 2 * np.cross(earth, velocity) - gravity * down
    to_body = np.swapaxes(c_nb, -1, -2)
    omega = to_body @ earth + rate[:, None] * down
    return omega, np.einsum("mij,mj->mi", to_body, specific)


def sample_means(angle: np.ndarray, h: float, steps: int, **bench: float) -> tuple:
    """Means of both over samples of so many steps h, from the plate's angle at t_-1..t_(m+1).

    The rate in a step is the angle's increment over h, and the acceleration at an instant is the
    change of that rate over h: the ones that moved the plate.
    """
    during = np.diff(angle) / h
    acceleration = np.diff(during) / h
    middle = (angle[1:-2] + angle[2:-1]) / 2
    omega, _ = felt(middle, during[1:-1], np.zeros_like(middle), **bench)
    _, force = felt(angle[1:-1], (during[1:] + during[:-1]) / 2, acceleration, **bench)
    force = (force[:-1] + force[1:]) / 2
    return tuple(v.reshape(-1, steps, 3).mean(axis=1) for v in (omega, force))


def heading_from_turning(angle: np.ndarray, x: np.ndarray, y: np.ndarray) -> float:
    """Heading at angle zero from both horizontal rates at the plate's angles, all (m,), by least
    squares with a constant: x = w cos(psi + angle) + ., y = -w sin(psi + angle) + ."""
    design = np.stack([np.cos(angle), np.sin(angle), np.ones(len(angle))], axis=1)
    (a, b, _), (c, d, _) = (np.linalg.lstsq(design, v, rcond=None)[0] for v in (x, y))
    return float(np.arctan2(-b - c, a - d))
