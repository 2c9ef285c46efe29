"""A dataset's recordings with what was drawn of their sensor's errors taken out."""

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from lbgc.data.record import Record
from lbgc.data.store import Dataset
from lbgc.sensor.imu import Disturbance, TriadErrors


def drawn_errors(
    dataset: Dataset, indices: np.ndarray
) -> Iterator[tuple[TriadErrors, TriadErrors]]:
    """Gyros' and accelerometers' of the recordings at these indices, ascending."""
    names = [f.name for f in fields(TriadErrors)]
    labels = {
        triad: {name: dataset.label(f"{triad}_{name}") for name in names}
        for triad in ("gyro", "accel")
    }
    for i in np.sort(indices):
        gyro, accel = (TriadErrors(**{n: v[i] for n, v in own.items()}) for own in labels.values())
        yield gyro, accel


def calibrated(
    record: Record,
    gyro: TriadErrors,
    accel: TriadErrors,
    lifetimes: tuple[str, ...],
    warming: Disturbance,
) -> Record:
    """The record, had its sensor none of the errors of these lifetimes: unit, session, run.

    A unit's are bias, scale, misalignment, g-sensitivity, and how they move with temperature.
    """
    warmth = warming.rise(len(record.gyro), 1 / record.rate_hz)[:, None]
    force = _mended(record.accel, accel, lifetimes, warmth)
    rate = record.gyro
    if "unit" in lifetimes:
        rate = rate - force @ gyro.g_sensitivity.T
    return replace(record, gyro=_mended(rate, gyro, lifetimes, warmth), accel=force)


def _mended(
    measured: np.ndarray, drawn: TriadErrors, lifetimes: tuple[str, ...], warmth: np.ndarray
) -> np.ndarray:
    """(I + M + diag(s) warmth)^-1 (measured - biases), (T, 3); warmth : (T, 1), K."""
    left = measured - sum(getattr(drawn, f"bias_{lifetime}") for lifetime in lifetimes)
    if "unit" not in lifetimes:
        return np.asarray(left)
    left = left - drawn.bias_per_k * warmth
    matrix = np.eye(3) + drawn.matrix
    if not warmth.any() or not drawn.scale_per_k.any():
        return np.linalg.solve(matrix, left.T).T
    warm = matrix + warmth[..., None] * np.diag(drawn.scale_per_k)
    return np.linalg.solve(warm, left[..., None])[..., 0]
