"""The likelihood of a noise model: Whittle's, on the cosine transform.

Each coefficient (see `lbgc.sensor.fitting.ordinates`) is normal with the variance that the model
gives it, exactly (`lbgc.sensor.fitting.cosine_variance`). What taking the coefficients as
independent gives away against the exact likelihood is below 3% of a standard error (`make
study-noise`).
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from lbgc.sensor.fitting.cosine_variance import Grid, density
from lbgc.sensor.fitting.ordinates import Ordinates
from lbgc.sensor.fitting.shapes import Shape, is_line
from lbgc.sensor.gaussian import GaussianTerm

_ENOUGH = 1e-5  # of the likelihood's logarithm, whose steps by 2 are what an interval is made of
WIDEST = 0.3
"""Width of a line over the frequency where it is looked for, at most: what is wider is no line, and
hides those that are."""
_STEP = 1e-4  # of a log-parameter, for derivatives
_unit = lru_cache(maxsize=2048)(density)


def _range(name: str, data: Ordinates) -> tuple[float, float]:
    """Least and largest value of a parameter. A filter with a damping above one has two poles
    apart: `FIRST_ORDER` is that. A line narrower than 3/duration is one that the log does not
    resolve."""
    if name.startswith("line_width"):
        return 3 / (data.n * data.dt), np.inf
    if name.startswith("line_f0"):
        return 1 / (data.n * data.dt), 0.5 / data.dt
    return (0.3, 1.0) if name == "damping" else (0.0, np.inf)


class Likelihood:
    """Minus the log-likelihood of log-parameters, with gradient and Fisher information."""

    def __init__(
        self, data: Ordinates, shapes: Sequence[Shape], near: Mapping[str, float] | None = None
    ):
        """near : values of the parameters about which lines are looked for, SI."""
        self.data, self.shapes = data, list(shapes)
        self.names = [name for shape in shapes for name in shape.names]
        with np.errstate(divide="ignore"):
            ends = np.log([_range(name, data) for name in self.names]).reshape(-1, 2)
        self.least, self.most = ends.T
        for shape in shapes:
            if is_line(shape) and near is not None:
                width = self.names.index(shape.names[2])
                self.most[width] = np.log(WIDEST * near[shape.names[1]])
        self.count, self.power = data.count, data.power
        self.grid: Grid = data.grid

    def unit_variance(self, shape: Shape, parameters: Sequence[float]) -> np.ndarray:
        """Variance of a term with coefficient one, at every ordinate: unit^2 s."""
        term: GaussianTerm = shape.unit_term(parameters)
        return _unit(term, self.grid)

    def variance(
        self, p: np.ndarray, loose: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """v (M,) and its derivative by the log-parameters, or by the loose ones of them, (M, P)."""
        asked = np.ones(len(p), bool) if loose is None else loose
        values, columns, at = np.full(len(self.count), self.data.rounding), [], 0
        for shape in self.shapes:
            own = p[at : at + len(shape.names)]
            scale = np.exp(2 * own[0])
            unit = self.unit_variance(shape, tuple(np.exp(own[1:])))
            values += scale * unit
            if asked[at]:
                columns.append(2 * scale * unit)
            for j in range(1, len(own)):
                if not asked[at + j]:
                    continue
                up = own.copy()
                up[j] += _STEP
                moved = self.unit_variance(shape, tuple(np.exp(up[1:])))
                columns.append(scale * (moved - unit) / _STEP)
            at += len(own)
        return values, np.stack(columns, axis=1)

    def bic(self, value: float) -> float:
        """Bayesian information criterion at the minimum's value."""
        return 2 * value + len(self.names) * float(np.log(self.count.sum()))

    def information(self, p: np.ndarray) -> np.ndarray:
        """Fisher information of the log-parameters, (P, P)."""
        v, J = self.variance(p)
        A = J / v[:, None]
        return np.asarray(0.5 * (A * self.count[:, None]).T @ A)

    def covariance(self, p: np.ndarray, keep: Sequence[int] = ()) -> np.ndarray:
        """Covariance of the log-parameters' errors, (P, P); infinite for those that the data do not
        feel, except that those to `keep` are taken as felt."""
        information = self.information(p)
        felt = np.diag(information) > 1e-9
        felt[list(keep)] = True
        out = np.diag(np.where(felt, 0.0, np.inf))
        size = np.sqrt(np.maximum(np.diag(information)[felt], 1e-300))
        scaled = information[np.ix_(felt, felt)] / np.outer(size, size)
        out[np.ix_(felt, felt)] = np.linalg.pinv(scaled, hermitian=True) / np.outer(size, size)
        return out

    def value(self, p: np.ndarray) -> float:
        v, at = np.full(len(self.count), self.data.rounding), 0
        for shape in self.shapes:
            own = np.exp(p[at : at + len(shape.names)])
            v += own[0] ** 2 * self.unit_variance(shape, tuple(own[1:]))
            at += len(own)
        return 0.5 * float(np.sum(self.count * np.log(v) + self.power / v))

    def minimise(
        self,
        start: np.ndarray,
        fixed: dict[int, float] | None = None,
        steps: int = 60,
        enough: float = _ENOUGH,
    ) -> tuple[np.ndarray, float]:
        """Fisher scoring with halved steps; `fixed` holds parameters at values. A coefficient that
        the data push to zero ends far below what they could show.

        steps : at most; enough : ends where less of the logarithm is left to gain.
        """
        p = np.clip(start, self.least, self.most)
        for i, x in (fixed or {}).items():
            p[i] = x
        loose = np.array([i not in (fixed or {}) for i in range(len(p))])
        best = self.value(p)
        for _ in range(steps):
            v, J = self.variance(p, loose)
            A = J / v[:, None]
            gradient = 0.5 * A.T @ (self.count - self.power / v)
            above, below = (p >= self.most - 1e-9)[loose], (p <= self.least + 1e-9)[loose]
            moves = ~(above & (gradient < 0)) & ~(below & (gradient > 0))
            free = loose.copy()
            free[loose] = moves
            A = A[:, moves]
            information = 0.5 * (A * self.count[:, None]).T @ A
            ridge = 1e-12 * np.trace(information) + 1e-12
            step = np.linalg.solve(information + ridge * np.eye(free.sum()), gradient[moves])
            step *= min(1.0, 1.0 / np.abs(step).max(initial=1e-300))
            if gradient[moves] @ step < enough:  # all that is left to gain
                break
            room = np.where(step < 0, self.most[free] - p[free], p[free] - self.least[free])
            short = min(
                1.0, float(np.min(room / np.maximum(np.abs(step), 1e-300), initial=1.0))
            )  # of an end
            step *= short
            for _ in range(10):
                trial = p.copy()
                trial[free] -= step
                value = self.value(trial)
                if value <= best:
                    break
                step = step / 2
            else:
                break
            gained, best, p = best - value, value, trial
            if gained < enough and short == 1.0:
                break
        return p, best
