"""Headings from Gaussian information on q = (cos psi, sin psi): the posterior's mode and its mean.

The information is a 2-vector h and a 2 x 2 matrix J (see lbgc.estimators.information), and the
posterior is that of lbgc.estimators.circle.
"""

import numpy as np

from lbgc.estimators import circle
from lbgc.estimators.estimate import Estimate
from lbgc.frames import wrap

AS_LENGTHS = float(np.deg2rad(6.0))
"""Standard deviation of a heading, rad, below which angles behave like lengths."""


def along(heading: np.ndarray) -> np.ndarray:
    """q = (cos psi, sin psi), (*S, 2), of headings psi, *S, rad."""
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def across(heading: np.ndarray) -> np.ndarray:
    """dq/dpsi = (-sin psi, cos psi), (*S, 2), of headings psi, *S, rad."""
    return np.stack([-np.sin(heading), np.cos(heading)], axis=-1)


def likeliest(h: np.ndarray, J: np.ndarray) -> Estimate:
    """The most likely headings under a flat prior, and the posterior's RMS angle about them.
    h : (V, 2); J : (2, 2), or (V or 1, 2, 2)."""
    heading = circle.mode(h, J)
    return Estimate(heading, circle.posterior(h, J, heading).sigma)


def bayes(h: np.ndarray, J: np.ndarray) -> Estimate:
    """The Bayes-optimal estimate: with a flat prior on the circle the posterior's circular mean,
    which minimises the mean of 1 - cos(error), and the posterior's RMS angle about it.
    h : (V, 2); J : (2, 2), or (V or 1, 2, 2)."""
    found = circle.posterior(h, J)
    return Estimate(wrap(found.heading), found.sigma)
