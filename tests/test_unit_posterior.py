"""What labelled recordings tell of a unit, against one dense Gaussian of all of them."""

from dataclasses import replace

import numpy as np
import pytest
from floor_cases import STATIC, Case
from unit_floor import simplex

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.estimators.block_means import Course
from lbgc.estimators.error_patterns import _GRAVITY, _LATITUDE, ANY_TILT, factors
from lbgc.estimators.unit_posterior import (
    Evidence,
    Posterior,
    Reference,
    evidence,
    posterior,
    undivided,
)
from lbgc.frames import rotation_z
from lbgc.sensor import errors, unit
from lbgc.sensor.errors import Surroundings
from lbgc.sensor.known import Known
from lbgc.units import DEG

LATITUDE = 50 * DEG
NORTH, DOWN = EARTH_RATE * np.cos(LATITUDE), -EARTH_RATE * np.sin(LATITUDE)
G = normal_gravity(float(LATITUDE))
SIZES = {
    "bias_unit_deg_per_h": 0.8,
    "bias_session_deg_per_h": 0.4,
    "bias_run_deg_per_h": 0.3,
    "scale_unit_ppm": 9000,
    "misalignment_unit_mrad": 12,
    "g_sensitivity_deg_per_h_per_g": 0.5,
}
# Accelerometers that tell the level well, about which the posterior is linear.
LEVEL = {"bias_unit_mg": 0.02, "bias_session_mg": 0.01, "bias_run_mg": 0.01,
         "misalignment_unit_mrad": 0.01}  # fmt: skip
IMU = Case("", "sdc500", STATIC, 0.0, overrides=(
    *(f"imu.gyro.{k}={v}" for k, v in SIZES.items()),
    *(f"imu.accel.{k}={v}" for k, v in LEVEL.items()),
)).model()  # fmt: skip
BLOCKS, INTERVAL = 6, 20.0
HEADINGS = np.deg2rad([10.0, 95.0, 200.0, 300.0, 40.0, 250.0])
SESSIONS = np.array(["a", "a", "b", "b", "b", "c"])
REFERENCE = Reference(np.full(6, 0.3 * DEG), 0.2 * DEG)


def truth(heading: float) -> tuple[np.ndarray, np.ndarray]:
    """Earth's rate and the specific force of a level body at rest, (3,) each."""
    rate = np.array([NORTH, 0.0, DOWN]) @ rotation_z(heading)
    return rate, np.array([0.0, 0.0, -G])


def unknowns(heading: float) -> dict[str, np.ndarray]:
    """What 1 of each unknown adds to the six channels, by its name: (how many, 6)."""
    rate, force = truth(heading)

    def on_gyro(rows: np.ndarray) -> np.ndarray:
        return np.hstack([rows, 0 * rows])

    def on_accel(rows: np.ndarray) -> np.ndarray:
        return np.hstack([0 * rows, rows])

    rows = np.eye(3)
    nine = {name: np.kron(rows, x[:, None]) for name, x in (("rate", rate), ("force", force))}
    step = 1e-6
    turned = (truth(heading + step)[0] - truth(heading - step)[0]) / (2 * step)
    tilts = [np.concatenate([-np.cross(e, np.array([0, 0, DOWN])), -np.cross(e, force)])
             for e in np.eye(3)[:2]]  # fmt: skip
    return {
        "gyro bias": on_gyro(rows),
        "gyro matrix": on_gyro(nine["rate"]),
        "gyro g": on_gyro(nine["force"]),
        "accel bias": on_accel(rows),
        "accel matrix": on_accel(nine["force"]),
        "tilt": np.array(tilts),
        "gravity": np.array([[0, 0, 0, 0, 0, -G]]),
        "latitude": np.array([[0, 0, -NORTH, 0, 0, 0]]),
        "turn": np.array([[*turned, 0, 0, 0]]),
    }


class Dense:
    """The joint Gaussian of the recordings' means and the unit's coefficients."""

    def __init__(self, imu, shares=None, tilt=ANY_TILT):
        whole = imu.gyro.bias("unit")
        life = [imu.gyro.bias(name) for name in ("unit", "session", "run")]
        if shares is not None:
            life = [np.sqrt(own) * whole for own in shares]
        gyro = {e.name: e.sigma for e in imu.gyro.drawn}
        accel = {e.name: e.sigma for e in imu.accel.drawn}
        course = Course.planned(np.zeros(BLOCKS), INTERVAL)
        noise = factors(imu, course)
        dim = 6 * BLOCKS
        spread = np.zeros((6 * dim,) * 2)
        found = [unknowns(heading) for heading in HEADINGS]
        each = {"gyro bias": life[0], "gyro matrix": gyro["matrix"].ravel(),
                "gyro g": gyro["g_sensitivity"].ravel(), "accel bias": np.diag(accel["bias_unit"]),
                "accel matrix": accel["matrix"].ravel()}  # fmt: skip
        unit = [np.concatenate([s[:, None] * own[name] for name, s in each.items()])
                for own in found]  # fmt: skip
        for a, one in enumerate(found):
            rows = slice(a * dim, (a + 1) * dim)
            for channel in range(6):
                at = slice(a * dim + channel * BLOCKS, a * dim + (channel + 1) * BLOCKS)
                spread[at, at] += noise[channel] @ noise[channel].T
            own = [life[2][:, None] * one["gyro bias"],
                   np.diag(accel["bias_run"])[:, None] * one["accel bias"],
                   tilt * one["tilt"], _GRAVITY * one["gravity"], _LATITUDE * one["latitude"],
                   REFERENCE.new[a] * one["turn"]]  # fmt: skip
            spread[rows, rows] += self.constant(np.concatenate(own), np.concatenate(own))
            for b, other in enumerate(found):
                columns = slice(b * dim, (b + 1) * dim)
                shared = [(unit[a], unit[b])]
                shared.append([REFERENCE.offset * own["turn"] for own in (one, other)])
                if SESSIONS[a] == SESSIONS[b]:
                    s, t = life[1][:, None], np.diag(accel["bias_session"])[:, None]
                    shared += [(s * one["gyro bias"], s * other["gyro bias"]),
                               (t * one["accel bias"], t * other["accel bias"])]  # fmt: skip
                for left, right in shared:
                    spread[rows, columns] += self.constant(left, right)
        self.spread = spread
        self.of_unit = np.concatenate([np.repeat(own, BLOCKS, axis=1) for own in unit], axis=1)

    @staticmethod
    def constant(left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Covariance of constants, (r, 6) each, over two recordings' parts."""
        return np.kron(left.T @ right, np.ones((BLOCKS, BLOCKS)))

    def given(self, data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of the unit's errors by their prior sigmas."""
        gain = np.linalg.solve(self.spread, self.of_unit.T).T
        return gain @ data, np.eye(len(gain)) - gain @ self.of_unit.T


@pytest.fixture(scope="module")
def data():
    """Means less the truth of six recordings, (36 BLOCKS,), drawn by the dense Gaussian."""
    rng = np.random.default_rng(1)
    return np.linalg.cholesky(Dense(IMU, tilt=1e-5).spread) @ rng.standard_normal(36 * BLOCKS)


def windows(data: np.ndarray) -> list[Windows]:
    means = np.moveaxis(data.reshape(6, 6, BLOCKS), 1, 2)
    means = means + np.stack([np.concatenate(truth(heading)) for heading in HEADINGS])[:, None]
    return [
        Windows(
            gyro=means[..., :3],
            accel=means[..., 3:],
            plate_angle=np.zeros((6, BLOCKS)),
            rate_hz=1 / INTERVAL,
            latitude=np.full(6, LATITUDE),
            start_s=np.zeros(6),
        )
    ]


def by_prior(told: Evidence, found: Posterior) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of what is known, by the prior's sigmas."""
    own = [told.coefficients.index(c) for c in found.known.coefficients]
    sigma = told.sigma[own]
    return found.known.mean / sigma, found.known.covariance / sigma / sigma[:, None]


def test_it_is_what_the_joint_covariance_of_all_recordings_gives(data):
    mean, covariance = Dense(IMU).given(data)
    told = evidence(IMU, windows(data), HEADINGS, REFERENCE)
    of_mean, of_covariance = by_prior(told, posterior(IMU, told, SESSIONS))
    assert np.allclose(of_mean, mean, atol=5e-3)  # linear about another level, 0.02 mg off
    assert np.allclose(of_covariance, covariance, atol=3e-4)
    assert np.diag(covariance)[:3].max() < 0.5 < np.diag(covariance).max()


def log_density(data: np.ndarray, spread: np.ndarray) -> float:
    """Of a normal with this covariance, up to a constant."""
    factor = np.linalg.cholesky(spread)
    white = np.linalg.solve(factor, data)
    return float(-white @ white / 2 - np.log(np.diag(factor)).sum())


def test_shares_are_weighed_by_their_evidence(data):
    base = undivided(IMU)
    told = evidence(base, windows(data), HEADINGS, REFERENCE)
    every = np.array([[0.7, 0.2, 0.1], [0.1, 0.2, 0.7], [0.2, 0.7, 0.1]])
    apart = [posterior(base, told, SESSIONS, shares=own[None]) for own in every]
    dense = [Dense(base, own) for own in every]
    right = np.array([log_density(data, own.spread) for own in dense])
    found = np.array([own.log_evidence for own in apart])
    assert np.ptp(right) > 1
    assert np.allclose(found - found[0], right - right[0], atol=0.05)
    both = posterior(base, told, SESSIONS, shares=every)
    assert np.allclose(both.weight, np.exp(found) / np.exp(found).sum())
    means, covariances = zip(
        *((own.known.mean, own.known.covariance) for own in apart), strict=True
    )
    assert np.allclose(both.known.mean, both.weight @ np.array(means))
    spread = both.known.covariance - np.einsum("s,sij->ij", both.weight, np.array(covariances))
    assert np.linalg.eigvalsh(spread / both.known.sigma / both.known.sigma[:, None]).min() > -1e-9
    left = both.weight @ every
    assert np.allclose(both.imu.gyro.bias("run"), np.sqrt(left[2]) * IMU.gyro.bias())


def test_the_simplex_is_cut_into_equal_cells():
    assert simplex().shape == (64, 3)
    assert np.allclose(simplex().mean(axis=0), 1 / 3)
    assert (simplex() > 0).all()


def test_yesterdays_posterior_is_todays_prior(data):
    """Without an offset of the reference, which the file of a unit does not keep."""
    reference = Reference(REFERENCE.new)
    every, old, new = (windows(data)[0].rows(k) for k in (slice(None), slice(5), slice(5, None)))
    whole = posterior(IMU, evidence(IMU, [every], HEADINGS, reference), SESSIONS)
    first = posterior(
        IMU, evidence(IMU, [old], HEADINGS[:5], Reference(reference.new[:5])), SESSIONS[:5]
    )
    later = taken_off(new, first.known)
    told = evidence(first.imu, [later], HEADINGS[5:], Reference(reference.new[5:]))
    second = posterior(first.imu, told, SESSIONS[5:])
    order = [second.known.coefficients.index(c) for c in whole.known.coefficients]
    sigma = np.sqrt(np.diag(whole.known.covariance))
    assert np.allclose(second.known.mean[order] / sigma, whole.known.mean / sigma, atol=0.02)
    found = second.known.covariance[np.ix_(order, order)]
    assert np.allclose(
        found / sigma / sigma[:, None], whole.known.covariance / sigma / sigma[:, None], atol=2e-3
    )


def taken_off(own: Windows, known: Known) -> Windows:
    gyro, accel = unit.drawn(IMU, known, known.mean)
    force = errors.undone(IMU.accel.lasting("unit"), accel, own.accel[0].T, Surroundings(), None)
    around = Surroundings(force=force)
    rate = errors.undone(IMU.gyro.lasting("unit"), gyro, own.gyro[0].T, around, None)
    return replace(own, gyro=rate.T[None], accel=force.T[None])


def test_a_power_up_that_is_still_on_is_known_likewise(data):
    told = evidence(IMU, windows(data), HEADINGS, REFERENCE)
    off, on = (posterior(IMU, told, SESSIONS, now) for now in (None, "b"))
    names = {c.error for c in on.known.coefficients}
    assert names - {c.error for c in off.known.coefficients} == {"bias_session"}
    every = [(c.triad, c.error, c.i) for c in on.known.coefficients]
    of = [every.index(("gyro", "bias_session", axis)) for axis in range(3)]
    assert (on.known.sigma[of] < 0.9 * IMU.gyro.bias("session")).all()
    both = dict(zip(on.known.coefficients, on.known.sigma, strict=True))
    assert np.allclose([both[c] for c in off.known.coefficients], off.known.sigma)
    assert on.known.covariance[of[0], every.index(("gyro", "bias_unit", 0))] < 0
