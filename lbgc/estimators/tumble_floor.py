"""The best that poses at rest can tell, and what to expect of a number of them.

As in lbgc.estimators.floor there are two bounds, of the Gaussian model of
lbgc.estimators.pose_information: the van Trees bound in closed form, for errors that are small
against the circle, and the error of the posterior's circular mean itself, over drawn data. Both are
root mean squares over the poses of drawn attitudes, any attitude being as probable as any other.
"""

from dataclasses import dataclass, replace

import numpy as np

from lbgc.attitudes import uniform
from lbgc.earth import normal_gravity
from lbgc.estimators.held import Held, planned
from lbgc.estimators.pose_information import form
from lbgc.estimators.posterior import AS_LENGTHS
from lbgc.estimators.torus import Torus, mixture, particles
from lbgc.estimators.tumble import turned_by
from lbgc.frames import wrap
from lbgc.sensor import streams
from lbgc.sensor.imu import ImuModel

DRAWS = 24
"""Sets of attitudes, and of data, that are drawn."""
_COUNT = 400
"""Draws of the posterior of each: the error of its mean adds a quarter of a percent."""


@dataclass(frozen=True)
class Tumbling:
    """How poses are held."""

    poses: int
    dwell_s: float
    handling_s: float
    """Time between two rests"""
    integrated: bool
    """Whether the gyros tell the turns between them"""

    @property
    def seconds(self) -> float:
        """What it takes in all."""
        return self.poses * self.dwell_s + (self.poses - 1) * self.handling_s


def small_errors(
    of: Held, imu: ImuModel, heading: np.ndarray, latitude: float | None = None
) -> np.ndarray:
    """Covariance, (n, n), of the headings, rad, and of the latitude where the poses' is not known,
    in the limit of errors that are small against the circle: the inverse of the information at
    these headings, (P,), and this latitude, rad."""
    own = Torus(form(of, imu, heading, latitude))
    theta = np.append(heading, [latitude] if own.free else [])
    return np.asarray(np.linalg.inv(own.curved(theta[None])[2][0]))


def expected(
    imu: ImuModel, plan: Tumbling, latitude: float, gravity: float | None = None, draws: int = DRAWS
) -> tuple[float, float]:
    """The van Trees bound, rad, NaN above 6 degrees, and the expected error of the Bayes-optimal
    estimate, rad, of poses in drawn attitudes at a known latitude, rad. By seeded draws; the first
    to some percent, by the attitudes that were drawn, the second to some percent of the first."""
    rng = streams.figures()
    g = normal_gravity(latitude) if gravity is None else gravity
    closed, every = np.empty(draws), np.empty(draws)
    for k in range(draws):
        truth = uniform(rng, plan.poses)
        of = planned(truth, plan.dwell_s, plan.handling_s, latitude, g, imu, plan.integrated)
        heading = turned_by(truth, of.base)
        own = form(of, imu, heading)
        torus = Torus(own)
        v, D = torus.v(heading), torus.slopes(heading[None])[0]
        # What is known of t and e beforehand is in J; data are drawn by the law that they have.
        values, vectors = np.linalg.eigh(own.J)
        noise = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values)))
        covariance = np.linalg.inv(D.T @ own.J @ D)
        drawn = Torus(replace(own, h=own.J @ v + noise))
        starts = np.concatenate([drawn.starts(rng), heading[None]])
        found, _ = particles(mixture(drawn, starts), _COUNT).mean_and_spread(plan.poses)
        square = np.mean(wrap(found - heading) ** 2)
        closed[k] = np.trace(covariance) / plan.poses
        if closed[k] < AS_LENGTHS**2:
            linear = covariance @ D.T @ noise
            square += closed[k] - np.mean(linear**2)
        every[k] = square
    rms = float(np.sqrt(closed.mean()))
    return (rms if rms < AS_LENGTHS else float("nan")), float(np.sqrt(every.mean()))
