"""Headings from what Gaussian data tell of them: the mode, and the mean of the posterior.

Whatever data tell of q = (cos psi, sin psi) is a 2-vector h and a 2 x 2 matrix J, the information
(see lbgc.estimators.information), and the posterior is that of lbgc.estimators.circle.
"""

import numpy as np

from lbgc.estimators import circle
from lbgc.estimators.estimate import Estimate
from lbgc.frames import wrap

AS_LENGTHS = float(np.deg2rad(6.0))
"""Below it angles behave like lengths."""


def along(heading: np.ndarray) -> np.ndarray:
    """q, (*S, 2)."""
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def across(heading: np.ndarray) -> np.ndarray:
    """dq/dpsi, (*S, 2)."""
    return np.stack([-np.sin(heading), np.cos(heading)], axis=-1)


def likeliest(h: np.ndarray, J: np.ndarray) -> Estimate:
    """The most likely headings, and the posterior's RMS angle about them.
    h : (V, 2); J : (2, 2), or (V or 1, 2, 2)."""
    heading = circle.mode(h, J)
    return Estimate(heading, circle.posterior(h, J, heading).sigma)


def bayes(h: np.ndarray, J: np.ndarray) -> Estimate:
    """The Bayes-optimal estimate: with a flat prior on the circle the posterior's circular mean,
    which minimises the mean of 1 - cos(error); and the posterior's RMS error about it."""
    found = circle.posterior(h, J)
    return Estimate(wrap(found.heading), found.sigma)
