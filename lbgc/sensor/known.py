"""The law of what is known of one unit's lasting errors: see lbgc.sensor.unit."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Coefficient:
    """One number of a sensor that is drawn once: c_ij of an error of lbgc.sensor.errors."""

    triad: str
    """gyro or accel"""
    error: str
    """The error's name, such as bias_unit"""
    i: int
    """The axis that prints it"""
    j: int
    """The axis of what it follows"""


@dataclass(frozen=True, eq=False)
class Known:
    """The law of one unit's coefficients after its labelled recordings, Normal(mean, covariance)
    in SI units."""

    coefficients: tuple[Coefficient, ...]
    """The r coefficients"""
    mean: np.ndarray
    """(r,)"""
    covariance: np.ndarray
    """(r, r)"""

    @cached_property
    def sigma(self) -> np.ndarray:
        """1 sigma of each coefficient, (r,)."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def correlated(self) -> np.ndarray:
        """Matrix (r, r) that makes correlated normals, of variance one each, of independent ones:
        coefficients less their means are sigma times these."""
        sigma = np.where(self.sigma > 0, self.sigma, 1.0)
        values, vectors = np.linalg.eigh(self.covariance / sigma / sigma[:, None])
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
