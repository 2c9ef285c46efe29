"""Errors of estimators over a dataset's recordings, as studies want them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from helpers import labelled

from lbgc.data.record import Record
from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled
from lbgc.estimators import CLASSICAL
from lbgc.estimators.estimate import Estimator
from lbgc.estimators.floor import floor
from lbgc.frames import wrap
from lbgc.metrics import Ratio, rmse_ratio
from lbgc.sensor.imu import ImuModel

ESTIMATORS: dict[str, Estimator] = {**CLASSICAL, "floor": floor}


@dataclass(frozen=True)
class Scores:
    """Of one estimator, one window a recording."""

    errors: np.ndarray
    """(R,), rad"""
    sigma: np.ndarray

    @property
    def rmse_deg(self) -> float:
        return float(np.rad2deg(np.sqrt(np.mean(self.errors**2))))

    @property
    def nse(self) -> float:
        """Mean normalised squared error."""
        return float(np.mean((self.errors / self.sigma) ** 2))

    @property
    def nse_error(self) -> float:
        """Standard error of it."""
        return float(np.std((self.errors / self.sigma) ** 2) / np.sqrt(len(self.errors)))

    def over(self, other: "Scores") -> Ratio:
        return rmse_ratio(self.errors, other.errors, np.arange(len(self.errors)))


def start(record: Record, window_s: float) -> Record:
    """Its first seconds."""
    n = round(window_s * record.rate_hz)
    return replace(
        record,
        gyro=record.gyro[:n],
        accel=record.accel[:n],
        plate_angle=record.plate_angle[:n],
    )


def first(records: Sequence[Record], window_s: float) -> Labelled:
    """The first window of each."""
    return Labelled.joined([labelled(start(record, window_s), window_s) for record in records])


def first_windows(data: Dataset, window_s: float, batch: int = 500) -> Iterator[Labelled]:
    """The first window of each recording, in batches."""
    several: list[Record] = []
    for record in data.records(np.arange(len(data))):
        several.append(record)
        if len(several) == batch:
            yield first(several, window_s)
            several = []
    if several:
        yield first(several, window_s)


def scored(
    windows: Iterator[Labelled],
    estimators: Mapping[str, Estimator],
    imu: ImuModel | None,
    against: str = "truth",
) -> dict[str, Scores]:
    """against : truth or reference; a real log has the latter alone."""
    parts: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {name: [] for name in estimators}
    for own in windows:
        known = own.heading if against == "truth" else own.heading_reference
        truth = np.where(np.isnan(known), own.heading_reference, known)
        for name, estimate in estimators.items():
            found = estimate(own.windows, imu)
            parts[name].append((wrap(found.heading - truth), found.sigma))
    joint = {n: [np.concatenate(p) for p in zip(*own, strict=True)] for n, own in parts.items()}
    return {name: Scores(*own) for name, own in joint.items()}


def named(*names: str) -> dict[str, Estimator]:
    return {name: ESTIMATORS[name] for name in names}
