"""The shorter corner of a bias instability's floor, where the data tell it."""

from collections.abc import Sequence

import numpy as np

from lbgc.sensor.fitting.likelihood import Likelihood
from lbgc.sensor.fitting.ordinates import Ordinates
from lbgc.sensor.fitting.shapes import GAUSS_MARKOV, Shape, flicker

USUAL = 1.0
"""s: the corner where the data do not tell it, which is most often: white noise covers it."""
_OFFERED = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
_EVIDENCE = 12.0


def profile(
    data: Ordinates, shapes: Sequence[Shape], values: dict[str, float], corners: tuple[float, float]
) -> dict[float, float]:
    """Twice the log-likelihood by the shorter corner (s), the other parameters maximised, over
    that of the corner that the shapes have. A Gauss-Markov process may have come in to mend a wrong
    corner, so it is left out."""
    shapes = [s for s in shapes if s.names != GAUSS_MARKOV.names]
    usable = [s for s in _OFFERED if 4 * data.dt <= s <= min(corners[1], data.n * data.dt) / 20]
    out = {}
    for short in {*usable, corners[0]}:
        changed = [flicker((short, corners[1])) if s.names == ("B",) else s for s in shapes]
        likelihood = Likelihood(data, changed, values)
        least = 1e-3 * max(values["N"], 1e-300)  # a size that was pushed to zero starts afresh
        start = [max(values[n], least if n in ("B", "K") else 1e-300) for n in likelihood.names]
        out[short] = -2 * likelihood.minimise(np.log(start), None, 15, 1e-2)[1]
    return {short: gain - out[corners[0]] for short, gain in out.items()}


def chosen(profiles: Sequence[dict[float, float]]) -> float:
    """The corner that several axes together ask for, or the usual one: others must be as much
    better as chance does not make them."""
    common = set.intersection(*(set(p) for p in profiles))
    best = max(common, key=lambda short: sum(p[short] for p in profiles))
    gain = sum(p[best] for p in profiles) - sum(p[USUAL] for p in profiles)
    return best if gain > _EVIDENCE else USUAL
