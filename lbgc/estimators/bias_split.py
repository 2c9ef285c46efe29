"""How a gyro's bias splits over what a unit keeps, a power-up adds and a recording adds, where
nobody knows: the shares of its variance are uniform on the simplex beforehand, Dirichlet(1, 1, 1),
and recordings weigh them.

A sensor may repeat a thousand times better than its data sheet says, so shares are cut on
logarithmic scales, t = 1 - (a unit's share) and v = (a recording's share) / t by their logits:
under the prior t has the density 2 t, and v is uniform. Cells that the recordings make probable,
and those that touch them, are cut into four, again and again; each counts by the prior's mass in it
and by the evidence at its middle.
"""

from collections.abc import Callable

import numpy as np
from scipy.special import expit

_EDGE = 16.0
"""Logit of the largest share that is told from one: 1 sigma of the rest is 1/3000 of the bias's."""
_WIDTH = 2.0
"""Of the first cells"""
_FINEST = 0.25
"""Of the last, a quarter of a variance; sums over cells halve and halve that again"""
_MATTERS = 0.01
"""Posterior probability of a cell that is worth cutting"""


def weighed(log_evidence: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Shares, (S, 3), at the middles of the cells, and the prior's mass in each, (S,).
    log_evidence : from shares, (n, 3), to the logarithm of the recordings' probability, (n,)."""
    middles = np.arange(-_EDGE + _WIDTH / 2, _EDGE, _WIDTH)
    cells = np.array([(x, y, _WIDTH) for x in middles for y in middles])
    logs = log_evidence(_shares(cells))
    while True:
        posterior = np.log(_masses(cells)) + logs
        weight = np.exp(posterior - posterior.max())
        weight /= weight.sum()
        cut = _touched(cells, weight > _MATTERS) & (cells[:, 2] > _FINEST)
        if not cut.any():
            return _shares(cells), _masses(cells)
        quarters = cells[cut][:, None] + cells[cut][:, None, 2:] * _QUARTERS
        fresh = quarters.reshape(-1, 3)
        logs = np.concatenate([logs[~cut], log_evidence(_shares(fresh))])
        cells = np.concatenate([cells[~cut], fresh])


_QUARTERS = np.array([(x, y, -0.5) for x in (-0.25, 0.25) for y in (-0.25, 0.25)])


def _touched(cells: np.ndarray, heavy: np.ndarray) -> np.ndarray:
    """Which cells are heavy, or touch one that is."""
    reach = (cells[:, None, 2] + cells[heavy][None, :, 2]) / 2 * (1 + 1e-9)
    apart = np.abs(cells[:, None, :2] - cells[heavy][None, :, :2])
    return np.asarray((apart <= reach[..., None]).all(axis=2).any(axis=1))


def _shares(cells: np.ndarray) -> np.ndarray:
    """Shares at the middles of cells, (C, 3)."""
    t, v = expit(cells[:, 0]), expit(cells[:, 1])
    return np.stack([expit(-cells[:, 0]), t * expit(-cells[:, 1]), t * v], axis=1)


def _masses(cells: np.ndarray) -> np.ndarray:
    """The prior's mass in each cell, (C,); those at the edges have all that is beyond."""
    half = cells[:, 2:] / 2
    low, high = cells[:, :2] - half, cells[:, :2] + half
    low[low <= -_EDGE + 1e-9] = -np.inf
    high[high >= _EDGE - 1e-9] = np.inf
    of_t = expit(high[:, 0]) ** 2 - expit(low[:, 0]) ** 2
    of_v = expit(high[:, 1]) - expit(low[:, 1])
    return np.asarray(of_t * of_v)


def constantless() -> tuple[np.ndarray, np.ndarray]:
    """Shares, (S, 3), of a bias of which a unit keeps nothing, and the prior's mass of each, (S,):
    what a recording adds is uniform."""
    edges = np.arange(-_EDGE, _EDGE + _FINEST / 2, _FINEST)
    middles = (edges[:-1] + edges[1:]) / 2
    beyond = np.concatenate([[-np.inf], edges[1:-1], [np.inf]])
    shares = np.stack([0 * middles, expit(-middles), expit(middles)], axis=1)
    return shares, np.diff(expit(beyond))
