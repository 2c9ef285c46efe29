"""The likelihood of a noise model: Whittle's, on the cosine transform.

Each coefficient (see `lbgc.sensor.fitting.ordinates`) is normal, with exactly the variance that the
model gives it (`lbgc.sensor.fitting.cosine_variance`). Taking the coefficients as independent costs
less than 3% of a standard error compared with the exact likelihood (`make study-noise`).
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from lbgc.sensor.fitting.cosine_variance import Grid, density
from lbgc.sensor.fitting.ordinates import Ordinates
from lbgc.sensor.fitting.shapes import Shape, is_line
from lbgc.sensor.gaussian import GaussianTerm

_ENOUGH = 1e-5
"""Gain in log-likelihood below which a minimisation ends; an interval's ends are at a fall of about
2."""
WIDEST = 0.3
"""The largest width of a line, over the frequency where it is looked for. A wider one is not a line
and would hide those that are."""
_FAR = 1e6
"""The factor by which a time may lie outside those that a log shows."""
_STEP = 1e-4
"""Step of a log-parameter in a numerical derivative."""
_unit = lru_cache(maxsize=2048)(density)


def _range(name: str, data: Ordinates) -> tuple[float, float]:
    """The least and the largest value of a parameter. Damping ends at 1, because a filter with a
    damping above one has two separate poles, which is what `FIRST_ORDER` is for. A line narrower
    than 3/duration is not resolved by the log. Times and bandwidths end where no log shows them:
    beyond, their powers are no numbers any more."""
    duration = data.n * data.dt
    if name.startswith("line_width"):
        return 3 / duration, _FAR / data.dt
    if name == "bandwidth":
        return 1 / (_FAR * duration), _FAR / data.dt
    if name == "GM_T":
        return data.dt / _FAR, _FAR * duration
    if name.startswith("line_f0"):
        return 1 / duration, 0.5 / data.dt
    return (0.3, 1.0) if name == "damping" else (0.0, np.inf)


class Likelihood:
    """Minus the log-likelihood of the logarithms of a model's parameters, with its gradient and
    Fisher information."""

    def __init__(
        self, data: Ordinates, shapes: Sequence[Shape], near: Mapping[str, float] | None = None
    ):
        """data : the ordinates; shapes : the terms of the model; near : values of the parameters
        near which lines are looked for, SI, which limit the lines' widths."""
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
        """The variance that a term with coefficient one gives to every ordinate, (M,), unit^2 s."""
        term: GaussianTerm = shape.unit_term(parameters)
        return _unit(term, self.grid)

    def variance(
        self, p: np.ndarray, loose: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The model's variance v of every ordinate, (M,), unit^2 s, and its derivative by the
        log-parameters p, (M, P), or only by those that the mask `loose` selects."""
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
        """The Bayesian information criterion, given minus the log-likelihood at its minimum."""
        return 2 * value + len(self.names) * float(np.log(self.count.sum()))

    def information(self, p: np.ndarray) -> np.ndarray:
        """The Fisher information of the log-parameters at p, (P, P)."""
        v, J = self.variance(p)
        A = J / v[:, None]
        return np.asarray(0.5 * (A * self.count[:, None]).T @ A)

    def covariance(self, p: np.ndarray, keep: Sequence[int] = ()) -> np.ndarray:
        """Covariance of the log-parameters' errors, (P, P). It is infinite for parameters of which
        the data have no information, except for those in `keep`."""
        information = self.information(p)
        felt = np.diag(information) > 1e-9
        felt[list(keep)] = True
        out = np.diag(np.where(felt, 0.0, np.inf))
        size = np.sqrt(np.maximum(np.diag(information)[felt], 1e-300))
        scaled = information[np.ix_(felt, felt)] / np.outer(size, size)
        out[np.ix_(felt, felt)] = np.linalg.pinv(scaled, hermitian=True) / np.outer(size, size)
        return out

    def value(self, p: np.ndarray) -> float:
        """Minus the log-likelihood at log-parameters p (P,): half the sum over the ordinates of
        count ln v + power/v."""
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
        """Minimise minus the log-likelihood by Fisher scoring with step halving, beginning at the
        log-parameters `start` (P,). A coefficient that the data push to zero ends far below what
        they could show. Returns the log-parameters (P,) and the minimum.

        fixed : log-parameters that are held, by index; steps : the most steps; enough : it ends
        where less of the log-likelihood is left to gain.
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
            gain = gradient[moves] @ step  # expected
            if not gain >= enough:  # little, or no number: the model's variance is zero somewhere
                break
            room = np.where(step < 0, self.most[free] - p[free], p[free] - self.least[free])
            # A step that would leave a parameter's range is cut short.
            short = min(1.0, float(np.min(room / np.maximum(np.abs(step), 1e-300), initial=1.0)))
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
