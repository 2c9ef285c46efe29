"""floor(k): the Bayes-optimal heading of one more recording of a unit, given k with known headings.

One dense Gaussian of the reduced data of all k + 1 recordings, not made through lbgc.sensor.unit:
the covariance of the data is summed cause by cause and lifetime by lifetime, the last recording's
data are conditioned on the others', and the heading's posterior is taken on a grid, at each of
whose points the covariance is that of the heading there.
"""

from collections.abc import Iterator

import numpy as np
import scipy.linalg

from lbgc.estimators.block_means import Course, Site
from lbgc.estimators.error_patterns import (
    ANY_TILT,
    STEADY,
    bench_causes,
    drawn_columns,
    signal,
)
from lbgc.estimators.information import whitened
from lbgc.estimators.unit_posterior import _lifetime
from lbgc.frames import wrap
from lbgc.sensor.imu import ImuModel

GRID = np.deg2rad(np.arange(0.0, 360.0, 0.5))
LEVEL = np.eye(3)[None]


class UnitFloor:
    """floor(k) of a sensor on one course, on a level base. Data are the d figures of
    `Whitened.told` in which any pattern of this course is felt: `reduced` picks them."""

    def __init__(self, imu: ImuModel, course: Course, site: Site):
        self.white = whitened(imu, course)
        size = np.abs(self.white.R).max(axis=2)
        self.felt = (size > 1e-9 * size.max(axis=1, keepdims=True)).ravel()
        self.imu, self.site, self.signal = imu, site, signal(LEVEL, site)
        zero, quarter, half = (self._columns(a) for a in np.deg2rad([0.0, 90.0, 180.0]))
        self.parts = {}
        for life in zero:
            steady = (zero[life] + half[life]) / 2
            self.parts[life] = steady, zero[life] - steady, quarter[life] - steady
        bench = [ANY_TILT * np.stack(self.signal.tilt, 1), *bench_causes(LEVEL, site).values()]
        bench += [own[:, None] for life, own in self._every(0.0) if life == "lever"]
        rows = self._in_data(np.concatenate(bench, axis=1)[0])
        self.alone = rows.T @ rows + np.eye(int(self.felt.sum()))

    def reduced(self, body: np.ndarray) -> np.ndarray:
        """Data, (V, d), of means over the parts, (V, CHANNELS, n)."""
        return self.white.told(body)[:, self.felt]

    def _in_data(self, coefficients: np.ndarray) -> np.ndarray:
        return self.white.columns(coefficients)[..., self.felt]

    def _every(self, heading: float) -> Iterator[tuple[str, np.ndarray]]:
        for _, which, of, own in drawn_columns(
            self.imu, LEVEL, self.site, heading=np.array([heading])
        ):
            yield (_lifetime(self.imu, which) if of == STEADY else "lever"), own

    def _columns(self, heading: float) -> dict[str, np.ndarray]:
        """What 1 sigma of each coefficient of a lifetime adds to the data at a heading, (r, d)."""
        found: dict[str, list[np.ndarray]] = {"unit": [], "session": [], "run": []}
        for life, own in self._every(heading):
            if life in found:
                found[life].append(self._in_data(own[0]))
        none = np.zeros((0, int(self.felt.sum())))
        return {life: np.array(rows) if rows else none for life, rows in found.items()}

    def _at(self, life: str, heading: np.ndarray) -> np.ndarray:
        """The same at headings (V,): (V, r, d)."""
        steady, along, across = self.parts[life]
        cos, sin = (f(heading)[:, None, None] for f in (np.cos, np.sin))
        return np.asarray(steady + cos * along + sin * across)

    def _expected(self, heading: np.ndarray) -> np.ndarray:
        """What a sensor without errors gives at headings (V,): (V, d)."""
        q = (self._in_data(own[0]) for own in self.signal.q)
        cos, sin = (own * f(heading)[:, None] for own, f in zip(q, (np.cos, np.sin), strict=True))
        return np.asarray(self._in_data(self.signal.known[0]) + cos + sin)

    def _turned(self, heading: np.ndarray) -> np.ndarray:
        return self._expected(heading + np.pi / 2) - self._in_data(self.signal.known[0])

    def _own(self, heading: np.ndarray) -> np.ndarray:
        """Covariance of the data of one recording that no other has, at headings (V,): (V, d,
        d)."""
        run = self._at("run", heading)
        return np.asarray(self.alone + np.swapaxes(run, 1, 2) @ run)

    def log_posterior(
        self,
        y: np.ndarray,
        heading: np.ndarray,
        session: np.ndarray,
        now: object,
        new: float = 0.0,
        offset: float = 0.0,
    ) -> np.ndarray:
        """Logarithm of the joint density of all data, at each heading of GRID that the last
        recording may have; up to a constant that no law of the sensor's lasting errors changes.

        y : (k + 1, d); heading, session : (k,), rad, the labels, and the power-ups; now : that of
        the last; new, offset : rad, 1 sigma of the labels' error that is new in each recording, and
        of what is the same in all.
        """
        k, d = len(heading), y.shape[1]
        lasting = [self._at("unit", heading), self._at("session", heading)]
        turned = self._turned(heading)
        spread = np.einsum("ard,bre->adbe", lasting[0], lasting[0], optimize=True)
        together = (session[:, None] == session[None]).astype(float)
        of_power = np.einsum("ard,bre->adbe", lasting[1], lasting[1], optimize=True)
        spread += together[:, None, :, None] * of_power
        spread += offset**2 * np.einsum("ad,be->adbe", turned, turned)
        own = self._own(heading) + new**2 * turned[:, :, None] * turned[:, None]
        spread[np.arange(k), :, np.arange(k)] += own
        lasting[1] = lasting[1] * (session == now)[:, None, None]
        every = np.concatenate(lasting, axis=1)  # (k, r, d)
        shared = np.moveaxis(every, 1, 0).reshape(every.shape[1], k * d)
        mean, covariance, of_labels = np.zeros(len(shared)), np.eye(len(shared)), 0.0
        if k:
            factor = scipy.linalg.cho_factor(spread.reshape(k * d, k * d))
            gain = scipy.linalg.cho_solve(factor, shared.T).T
            left = (y[:-1] - self._expected(heading)).ravel()
            mean = gain @ left
            of_labels = -left @ scipy.linalg.cho_solve(factor, left) / 2
            of_labels -= np.log(np.diag(factor[0])).sum()
            covariance = covariance - gain @ shared.T
        columns = np.concatenate([self._at("unit", GRID), self._at("session", GRID)], axis=1)
        of_query = self._own(GRID) + np.swapaxes(columns, 1, 2) @ covariance @ columns
        off = y[-1] - self._expected(GRID) - np.einsum("grd,r->gd", columns, mean)
        lower = np.linalg.cholesky(of_query)
        half = np.linalg.solve(lower, off[..., None])[..., 0]
        log = -np.sum(half**2, axis=1) / 2 - np.log(np.diagonal(lower, 0, 1, 2)).sum(axis=1)
        return np.asarray(of_labels + log)


def estimate(log: np.ndarray) -> tuple[float, float]:
    """The circular mean of the posterior that these logarithms on GRID are, (L, G) of L laws that
    are equally probable beforehand or (G,) of one, and its RMS angle about it, rad."""
    weight = np.exp(log - log.max()).reshape(-1, len(GRID)).sum(axis=0)
    weight /= weight.sum()
    middle = float(np.angle(weight @ np.exp(1j * GRID)))
    return middle, float(np.sqrt(weight @ wrap(GRID - middle) ** 2))


def simplex(fineness: int = 8) -> np.ndarray:
    """Shares, (fineness^2, 3): the centres of the equal triangles into which the simplex is cut."""
    lower = [(i + 1 / 3, j + 1 / 3) for i in range(fineness) for j in range(fineness - i)]
    upper = [(i + 2 / 3, j + 2 / 3) for i in range(fineness) for j in range(fineness - i - 1)]
    two = np.array([*lower, *upper]) / fineness
    return np.column_stack([two, 1 - two.sum(axis=1)])
