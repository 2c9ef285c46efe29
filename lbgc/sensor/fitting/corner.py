"""The estimate of the shorter corner of a bias instability's floor, where the data tell it."""

from collections.abc import Sequence

import numpy as np

from lbgc.sensor.fitting.likelihood import Likelihood
from lbgc.sensor.fitting.ordinates import Ordinates
from lbgc.sensor.fitting.shapes import GAUSS_MARKOV, Shape, flicker

USUAL = 1.0
"""The corner that is taken where the data do not tell it, s. That is most often so, because white
noise covers it."""
OFFERED = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""The corners that are tried, s."""
_EVIDENCE = 12.0
"""Gain in twice the log-likelihood from which on another corner than the usual one is taken."""


def profile(
    data: Ordinates, shapes: Sequence[Shape], values: dict[str, float], corners: tuple[float, float]
) -> dict[float, float]:
    """The profile of twice the log-likelihood over the shorter corner (s): with the other
    parameters at their best, less that of the corner that the shapes have. A Gauss-Markov process
    is left out of the model, since it may have been added to make up for a wrong corner."""
    shapes = [s for s in shapes if s.names != GAUSS_MARKOV.names]
    usable = [s for s in OFFERED if 4 * data.dt <= s <= min(corners[1], data.n * data.dt) / 20]
    out = {}
    for short in {*usable, corners[0]}:
        changed = [flicker((short, corners[1])) if s.names == ("B",) else s for s in shapes]
        likelihood = Likelihood(data, changed, values)
        least = 1e-3 * max(values["N"], 1e-300)  # start of a coefficient that was pushed to zero
        start = [max(values[n], least if n in ("B", "K") else 1e-300) for n in likelihood.names]
        out[short] = -2 * likelihood.minimise(np.log(start), None, 15, 1e-2)[1]
    return {short: gain - out[corners[0]] for short, gain in out.items()}


def chosen(profiles: Sequence[dict[float, float]]) -> float:
    """The corner, s, that several axes together have the highest likelihood for, or the usual one
    where the gain over it may be chance. profiles : of each axis, as `profile` gives them."""
    common = set.intersection(*(set(p) for p in profiles))
    best = max(common, key=lambda short: sum(p[short] for p in profiles))
    gain = sum(p[best] for p in profiles) - sum(p[USUAL] for p in profiles)
    return best if gain > _EVIDENCE else USUAL
