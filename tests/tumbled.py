"""Poses at rest for tests: drawn by the sensor's own faces, and their posterior by brute force."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from helpers import composed

from lbgc.bound import BoundConfig
from lbgc.data.poses import Poses
from lbgc.earth import EARTH_RATE, earth_rate_ned, normal_gravity
from lbgc.estimators.error_patterns import ANY_TILT
from lbgc.estimators.held import Held, shortest
from lbgc.frames import rotation_matrix, rotation_z
from lbgc.sensor import errors
from lbgc.sensor.errors import Surroundings
from lbgc.sensor.imu import ImuModel, Triad

LATITUDE = float(np.deg2rad(32.76))
RATE_HZ = 10.0
HANDLING_S = 10.0
_FINE = 20


def sensor(name: str, *overrides: str) -> ImuModel:
    """A sensor of ten samples a second, whose counts would be coarse: without."""
    imu = composed(BoundConfig, "bound", f"imu={name}", *overrides).imu.model(RATE_HZ)
    none = {"counts": None, "low_pass": None}
    return replace(imu, gyro=replace(imu.gyro, **none), accel=replace(imu.accel, **none))


def poses(
    rng: np.random.Generator,
    imu: ImuModel,
    attitudes: np.ndarray,
    dwell_s: float,
    integrated: bool = False,
    latitude: float = LATITUDE,
    known: bool = True,
) -> Poses:
    """A log of attitudes, (P, 3, 3), C_nb, each reached from the last by an even turn."""
    g, earth = normal_gravity(latitude), earth_rate_ned(latitude)
    rest, gap = round(dwell_s * RATE_HZ), round(HANDLING_S * RATE_HZ)
    force, rate = np.array([0.0, 0.0, -g]), []
    felt, rests, at = [], [], 0
    for p, own in enumerate(attitudes):
        rate.append(np.tile(earth @ own, (rest, 1)))
        felt.append(np.tile(force @ own, (rest, 1)))
        rests.append((at, at + rest))
        at += rest + gap
        if p + 1 < len(attitudes):
            turn = shortest(own.T @ attitudes[p + 1]) / HANDLING_S
            fine = (np.arange(gap * _FINE) + 0.5) / RATE_HZ / _FINE
            on = own @ rotation_matrix(turn * fine[:, None])
            rate.append(turn + (earth @ on).reshape(gap, _FINE, 3).mean(axis=1))
            felt.append((force @ on).reshape(gap, _FINE, 3).mean(axis=1))
    omega, f = np.concatenate(rate).T, np.concatenate(felt).T
    gyro = _printed(rng, imu.gyro, omega, replace(imu.warming, force=f))
    accel = _printed(rng, imu.accel, f, imu.warming)
    here = latitude if known else None
    return Poses(gyro, accel, RATE_HZ, here, tuple(rests), integrated)


def _printed(
    rng: np.random.Generator, triad: Triad, truth: np.ndarray, around: Surroundings
) -> np.ndarray:
    drawn = triad.draw_run(rng, triad.draw_unit(rng) | triad.draw_session(rng))
    found, _ = triad.measure(rng, truth, drawn, truth.shape[1], 1 / RATE_HZ, around)
    return np.asarray(found.T, float)


class Dense:
    """log p of the headings of poses by one dense Gaussian of the means over their parts, made from
    what the sensor's errors print and from its terms' covariance alone."""

    def __init__(self, imu: ImuModel, of: Held):
        assert of.latitude is not None
        self.imu, self.of = imu, of
        self.latitude, self.g = of.latitude, normal_gravity(of.latitude)
        A = of.layout.averaged()
        self.pose = of.layout.pose()
        n, count = len(A), of.layout.count
        self.noise = np.zeros((6 * n, 6 * n))
        for channel in range(6):
            triad = imu.gyro if channel < 3 else imu.accel
            whole = sum(
                t.covariance_of_means(count, of.layout.interval, 1, 0)
                for t in triad.in_run(channel % 3, imu.dt)
            )
            own = slice(channel * n, channel * n + n)
            self.noise[own, own] = A @ whole @ A.T

    def _felt(
        self, heading: np.ndarray, tilt: np.ndarray, north: float, down: float, g: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rates and specific forces of each part, (3, n) both."""
        C = rotation_z(heading) @ (rotation_matrix(tilt) @ self.of.base)
        both = (np.einsum("pij,i->jp", C, u) for u in ((north, 0, down), (0, 0, -g)))
        rate, force = (own[:, self.pose] for own in both)
        return rate, force

    def mean(self, heading: np.ndarray, **other: float | np.ndarray) -> np.ndarray:
        """Means, (6 n,), without errors."""
        at = {
            "tilt": np.zeros((len(heading), 3)),
            "north": EARTH_RATE * np.cos(self.latitude),
            "down": -EARTH_RATE * np.sin(self.latitude),
            "g": self.g,
        } | other
        return np.concatenate(self._felt(heading, **at)).ravel()

    def _columns(self, heading: np.ndarray) -> Iterator[np.ndarray]:
        """What each of what is not known adds by its 1 sigma, at these headings."""
        mean = self.mean(heading)
        for p in range(len(heading)):
            for axis in (0, 1):
                tilt = np.zeros((len(heading), 3))
                tilt[p, axis] = 1e-6
                yield ANY_TILT * (self.mean(heading, tilt=tilt) - mean) / 1e-6
        yield (self.mean(heading, g=self.g * (1 + 1e-3)) - mean)
        north = EARTH_RATE * np.cos(self.latitude)
        yield np.deg2rad(0.01) * (self.mean(heading, down=-north) - self.mean(heading, down=0.0))
        n = len(self.pose)
        rate, force = mean[: 3 * n].reshape(3, n), mean[3 * n :].reshape(3, n)
        for row, triad, felt in ((0, self.imu.gyro, rate), (1, self.imu.accel, force)):
            around = Surroundings(force=force if row == 0 else None)
            for error in triad.drawn:
                for i, j, sigma in error.sizes:
                    c = error.none()
                    c[i if c.ndim == 1 else (i, j)] = sigma
                    drawn = {e.name: e.none() for e in triad.drawn} | {error.name: c}
                    own = errors.printed(triad.drawn, drawn, felt, around, None) - felt
                    both = [np.zeros((3, n)), np.zeros((3, n))]
                    both[row] = own + np.zeros((3, n))
                    yield np.concatenate(both).ravel()

    def log_p(self, headings: np.ndarray) -> np.ndarray:
        """log p, (K,), of headings, (K, P), rad."""
        found = np.empty(len(headings))
        y = self.of.body.ravel()
        for k, heading in enumerate(headings):
            U = np.array(list(self._columns(heading)))
            lower = np.linalg.cholesky(self.noise + U.T @ U)
            left = np.linalg.solve(lower, y - self.mean(heading))
            found[k] = -left @ left / 2 - np.log(np.diag(lower)).sum()
        return found

    def form(self, heading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """h and J of (cos psi_p, sin psi_p), (2 P,), errors that follow the truth being those at
        these headings, (P,)."""
        U = np.array(list(self._columns(heading)))
        P = len(heading)
        S, none = [], self.mean(heading, north=0.0)
        for turn in (0.0, np.pi / 2):
            every = self.mean(np.full(P, turn)) - none
            for p in range(P):
                S.append(every * np.tile(self.pose == p, 6))
        V = np.array(S)
        C = np.linalg.inv(self.noise + U.T @ U)
        return V @ C @ (self.of.body.ravel() - none), V @ C @ V.T
