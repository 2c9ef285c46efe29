"""What poses at rest cannot tell, whatever their number, and which poses would tell it."""

import numpy as np

from lbgc.estimators.held import Held
from lbgc.sensor.errors import FORCE
from lbgc.sensor.imu import ImuModel

_NEAR = 0.1
"""Root mean square part of what would tell, below which poses count as telling nothing of it."""
_ALIKE = float(np.deg2rad(15.0))
"""rad: attitudes that differ less count as one."""


def directions(downs: np.ndarray, free: bool) -> np.ndarray:
    """Unit combinations, (k, 3 or 4), of the bias by axes (and of sin(lat), where it is free) that
    the vertical rates in poses do not tell. downs : (P, 3), down in the body's axes."""
    rows = np.column_stack([downs, np.ones(len(downs))]) if free else downs
    _, values, vectors = np.linalg.svd(rows)
    size = np.zeros(rows.shape[1])
    size[: len(values)] = values / np.sqrt(len(rows))
    return np.asarray(vectors[size < _NEAR])


def untold(of: Held, imu: ImuModel, sigma: np.ndarray) -> list[str]:
    """What poses do not tell, in sentences. sigma : (P,), rad, of their headings."""
    free = of.latitude is None
    missing = directions(of.downs, free)
    rank = (4 if free else 3) - len(missing)
    lines = []
    together = _different(of.downs, _ALIKE)
    if len(missing):
        what = "the gyros' bias and sin(lat)" if free else "the gyros' bias"
        lines.append(
            f"rank {rank} of {4 if free else 3}: the vertical rates of {of.count} "
            f"pose{'s' * (of.count != 1)} do not tell all of {what}; {_remedy(missing, free)}"
        )
    if free and together == 1:
        lines.append(
            "all poses lie on one side: the bias along it and sin(lat) cannot be told apart, and "
            "the sign of the latitude rests on the prior (hemisphere, and how large a bias can be)"
        )
    if not free and together == 1 and of.count < 3:
        lines.append(
            "poses on one side need three different headings: two leave a mirror image, one leaves "
            "the whole circle, but for what is known of the bias beforehand"
        )
    if free and imu.gyro.variance(FORCE).any():
        lines.append(
            "a g-sensitivity that is the same multiple of each axis's own force cannot be told "
            "from sin(lat) by any poses; it rests on the sensor's model"
        )
    return lines


def _different(downs: np.ndarray, angle: float) -> int:
    """How many sides the poses lie on: directions that differ by more than an angle, rad."""
    kept: list[np.ndarray] = []
    for down in downs:
        if all(down @ other < np.cos(angle) for other in kept):
            kept.append(down)
    return len(kept)


def _remedy(missing: np.ndarray, free: bool) -> str:
    """Which pose would tell most of what is missing, in words."""
    best, size = "", -1.0
    for axis, name in enumerate(("forward", "right", "down")):
        for sign, way in ((1.0, "down"), (-1.0, "up")):
            row = np.zeros(4 if free else 3)
            row[axis] = sign
            if free:
                row[3] = 1.0
            told = float(np.linalg.norm(missing @ row))
            if told > size + 1e-6:
                best, size = f"a pose with the body's {name} axis pointing {way}", told
    return f"{best} would tell more"
