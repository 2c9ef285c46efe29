"""The file of a unit that was calibrated: what is known of its errors, with a checksum."""

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lbgc.errors import InputError, reading, require
from lbgc.outputs import as_json, fingerprint, read_file, shown, write_atomically
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.errors import LIFETIMES, Triple
from lbgc.sensor.imu import ImuModel, Triad
from lbgc.sensor.known import Coefficient, Known
from lbgc.sensor.unit import coefficients, told

_FORMAT = "lbgc: one unit, format 1"
_MOST_BYTES = 4 * 2**20
_MOST_SIGMAS = 100.0
"""How many of the law's sigmas a coefficient may be away from zero: more is another sensor's."""


@dataclass(frozen=True, eq=False)
class CalibratedUnit:
    """What is known of one unit of a sensor."""

    sensor: str
    """The sensor's name"""
    law: str
    """The fingerprint of its description, whose law was the prior"""
    bias: tuple[Triple, Triple, Triple]
    """(3, 3), rad/s: 1 sigma of what a unit keeps of each gyro's bias, of what a power-up adds and
    of what a recording adds, as the unit was found"""
    known: Known
    """The law of its coefficients"""
    recordings: int
    """Number of labelled recordings behind it"""
    sessions: tuple[str, ...]
    """The power-ups that they are from"""
    now: str | None = None
    """The power-up whose own errors are known likewise"""

    def told(self, imu: ImuModel) -> ImuModel:
        """The sensor's model when this is known, and its means are taken off."""
        return told(replace(imu, gyro=self.with_bias(imu.gyro)), self.known)

    def with_bias(self, gyro: Triad) -> Triad:
        """The gyros with biases of the sizes that the unit was found to have."""
        return gyro.with_bias(**dict(zip(LIFETIMES, self.bias, strict=True)))

    @property
    def checksum(self) -> str:
        """The SHA-256 of all that its file says, by which datasets and models name it."""
        return _checksum(self._said())

    @property
    def content(self) -> dict[str, Any]:
        """All that its file says."""
        return {**self._said(), "sha256": self.checksum}

    def save(self, path: Path) -> None:
        """Write the file."""
        write_atomically(path, as_json(self.content, indent=1) + "\n")

    def _said(self) -> dict[str, Any]:
        """What its file says, but for the checksum."""
        said = {"format": _FORMAT, **asdict(replace(self, known=None))}  # type: ignore[arg-type]
        said |= {
            "coefficients": [[c.triad, c.error, c.i, c.j] for c in self.known.coefficients],
            "mean": self.known.mean,
            "covariance": self.known.covariance,
        }
        del said["known"]
        said = json.loads(as_json(said))
        return dict(said)


def load(path: str, imu: ImuConfig) -> CalibratedUnit:
    """The unit that a file describes. Raises InputError where the file is damaged, or is of another
    sensor than this."""
    with reading("calibration", path):
        said = json.loads(read_file(Path(path).expanduser(), _MOST_BYTES))
    return parse(said, imu, path)


def parse(said: Any, imu: ImuConfig, where: object) -> CalibratedUnit:
    """The unit of which this is the file's content; where : the file as an error names it. Raises
    InputError as `load` does."""
    with reading("calibration", where):
        said = dict(said)
        checksum = said.pop("sha256")
        whole = said["format"] == _FORMAT and checksum == _checksum(said)
    require(whole, "calibration", where, "is damaged, or no file of a unit (calibrate writes one)")
    with reading("calibration", where):
        own = _unit(said)
    alike = own.law == fingerprint(asdict(imu))
    about = f"is of {shown(own.sensor)} as it was described; {imu.name} is another, or has changed"
    require(alike, "calibration", where, about)
    usual, widest = coefficients(imu.model(1.0), *LIFETIMES), float(np.max(own.bias))
    fits = all(
        c in usual and abs(mean) <= _MOST_SIGMAS * max(usual[c], widest)
        for c, mean in zip(own.known.coefficients, own.known.mean.tolist(), strict=True)
    )
    require(fits, "calibration", where, "does not fit its sensor")
    return own


def _unit(said: dict[str, Any]) -> CalibratedUnit:
    """The unit that a whole file describes. Raises an error where it is none."""
    which = tuple(
        Coefficient(str(t), str(e), int(i), int(j)) for t, e, i, j in said["coefficients"]
    )
    r = len(which)
    mean, covariance = np.array(said["mean"], float), np.array(said["covariance"], float)
    bias = np.array(said["bias"], float)
    good = mean.shape == (r,) and covariance.shape == (r, r) and bias.shape == (3, 3)
    good = good and r > 0 and len(set(which)) == r and bool((bias >= 0).all())
    for values in (mean, covariance, bias):
        good = good and bool(np.isfinite(values).all())
    if not good or not _is_covariance(covariance):
        raise InputError("calibration", "its numbers", "", "are no law of a unit's errors")
    sessions = tuple(map(str, said["sessions"]))
    now = None if said["now"] is None else str(said["now"])
    unit, power, run = ((float(x), float(y), float(z)) for x, y, z in bias)
    known = Known(which, mean, covariance)
    return CalibratedUnit(
        str(said["sensor"]),
        str(said["law"]),
        (unit, power, run),
        known,
        int(said["recordings"]),
        sessions,
        now,
    )


def _is_covariance(values: np.ndarray) -> bool:
    """Whether a matrix is symmetric and positive semidefinite, to rounding."""
    size = np.sqrt(np.maximum(np.diag(values), 0.0))
    scaled = values / np.where(size > 0, size, 1.0) / np.where(size > 0, size, 1.0)[:, None]
    even = bool(np.allclose(scaled, scaled.T, atol=1e-9))
    return even and bool(np.linalg.eigvalsh(scaled).min() > -1e-9)


def _checksum(said: dict[str, Any]) -> str:
    """The SHA-256 of all that a file says but for itself."""
    return hashlib.sha256(as_json(said, indent=None, sort_keys=True).encode()).hexdigest()
