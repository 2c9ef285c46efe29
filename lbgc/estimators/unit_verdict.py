"""Whether labelled recordings show a constant of their unit, or of their one power-up."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lbgc.estimators import bias_split
from lbgc.estimators.unit_posterior import Evidence, Posterior, of_others, posterior
from lbgc.sensor.imu import ImuModel

_LEAST = 1e-7
"""Posterior probability of a split below which it is left out"""


@dataclass(frozen=True, eq=False)
class Way:
    """What recordings tell where the bias splits in one of some ways, or whatever one is true."""

    shares: np.ndarray
    """(S, 3)"""
    mass: np.ndarray
    """(S,), the prior's mass of each"""
    log_evidence: float
    """By all recordings: see `Posterior`"""
    others: Sequence[Posterior]
    """By all but one part, for each part"""


def ways(imu: ImuModel, told: Evidence, session: np.ndarray) -> tuple[np.ndarray, tuple[Way, Way]]:
    """The part, (R,), that each recording belongs to, a power-up, or a recording where all are of
    one; and what recordings tell with a constant that lasts through all of them, and without: then
    a unit keeps none, and where they are of one power-up it adds none either, which looks the same.
    imu : undivided, as `told` was made with it; session : (R,), the power-up of each."""

    def log_evidence(shares: np.ndarray) -> np.ndarray:
        return posterior(imu, told, session, None, shares).logs

    one = len(np.unique(session)) == 1
    now = session[0] if one else None
    without = (np.array([[0.0, 0.0, 1.0]]), np.ones(1)) if one else bias_split.constantless()
    found = []
    for shares, mass in (bias_split.weighed(log_evidence), without):
        whole = posterior(imu, told, session, None, shares, mass)
        kept = whole.weight > _LEAST
        own = shares[kept], mass[kept]
        part, others = of_others(imu, told, session, now, *own)
        found.append(Way(*own, whole.log_evidence, others))
    return part, (found[0], found[1])


@dataclass(frozen=True)
class UnitVerdict:
    """Whether recordings show a constant of their unit: a part of the gyros' bias that it keeps, or
    that their power-up adds where they are of one."""

    log_bayes_factor: float
    """Of a constant against none, natural logarithm; the shares of what is left uniform"""
    gains: tuple[float, ...]
    """Of each power-up, or recording where they are of one: the logarithm of the probability of its
    data given the others' with a constant, less that without"""

    @property
    def gain(self) -> float:
        """The mean of the gains."""
        return float(np.mean(self.gains))

    @property
    def gain_sigma(self) -> float:
        """Its standard error; infinite of one."""
        n = len(self.gains)
        return float(np.std(self.gains, ddof=1) / np.sqrt(n)) if n > 1 else float("inf")


def verdict(both: Sequence[Way]) -> UnitVerdict:
    """The verdict by what recordings tell with a constant, and without."""
    with_it, without = both
    factor = with_it.log_evidence - without.log_evidence
    rest = [
        a.log_evidence - b.log_evidence for a, b in zip(with_it.others, without.others, strict=True)
    ]
    return UnitVerdict(factor, tuple(factor - own for own in rest))
