"""Twenty situations in which no estimator may have less loss than the floor: what draws their
recordings, and what scores every estimator on them. A test runs few recordings of each, a study
many. Nothing here uses the floor's own covariance: each recording draws its own unit, session, run
and direction of lean, by the sensor's own face that draws."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from helpers import composed

from lbgc.bound import BoundConfig
from lbgc.data.windows import Labelled, Windows
from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.estimators import CLASSICAL
from lbgc.estimators.estimate import Estimate, Estimator
from lbgc.estimators.floor import floor
from lbgc.frames import AXES, across, euler_to_matrix, rotation, wrap
from lbgc.protocol import ProtocolConfig, plan
from lbgc.sensor.errors import Surroundings
from lbgc.sensor.imu import ImuModel, Triad

LATITUDE = np.deg2rad(32.76)
ARM_M = 0.27
_FINE = 20
_AS_LENGTHS_DEG = 20.0
EVERY: dict[str, Estimator] = {**CLASSICAL, "floor": floor}


@dataclass(frozen=True)
class Case:
    name: str
    imu: str
    protocol: ProtocolConfig
    duration_s: float
    interval_s: float = 1.0
    """Of the means."""
    lean_deg: float = 0.0
    """Of the base, in a direction that each recording draws."""
    overrides: tuple[str, ...] = ()

    def model(self) -> ImuModel:
        """Its sensor, of ten samples a second, whose counts would be coarse: without."""
        config = composed(BoundConfig, "bound", f"imu={self.imu}", *self.overrides)
        imu, none = config.imu.model(10.0), {"counts": None, "low_pass": None}
        return replace(imu, gyro=replace(imu.gyro, **none), accel=replace(imu.accel, **none))


def _indexed(name: str, *angles_deg: float, axis: str = "down") -> ProtocolConfig:
    return ProtocolConfig(name, "indexed", angles_deg=angles_deg, axis=axis)


STATIC = ProtocolConfig("static", "static")
CAROUSEL = ProtocolConfig("carousel", "carousel")
TWO = _indexed("two_position", 0.0, 180.0)
FOUR = _indexed("four_position", 0.0, 90.0, 180.0, 270.0)
EIGHT = _indexed("eight_position", *range(0, 360, 45))
OVER = _indexed("over_right", 0.0, 180.0, axis="right")
ROLL = _indexed("over_forward", 0.0, 180.0, axis="forward")
FOUR_ROLL = _indexed("four_over_forward", 0.0, 90.0, 180.0, 270.0, axis="forward")
WHEEL = ProtocolConfig("wheel", "carousel", axis="right")
WARM = ("imu.temperature.rise_k=15", "imu.temperature.time_s=300",
        "imu.gyro.bias_per_k_deg_per_h_per_k=2")  # fmt: skip


def cases() -> dict[str, Case]:
    every = [
        Case(f"{imu}_two_position_{lean}deg", imu, TWO, 240.0, lean_deg=lean)
        for imu in ("sdc500", "stim300")
        for lean in (0, 1, 5, 9)
    ]
    every += [Case(f"stim300_carousel_{lean}deg", "stim300", CAROUSEL, 240.0, lean_deg=lean)
              for lean in (0, 5)]  # fmt: skip
    every += [
        Case("sdc500_four_position", "sdc500", FOUR, 240.0),
        Case("sdc500_eight_position_120s", "sdc500", EIGHT, 120.0, 0.5),
        *(Case(f"sdc500_static_{t}s", "sdc500", STATIC, t, h)
          for t, h in ((10, 0.1), (60, 0.5), (240, 1.0))),
        Case("sdc500_two_position_warming_up", "sdc500", TWO, 240.0, overrides=WARM),
        Case("sdc500_over_right_5deg", "sdc500", OVER, 240.0, lean_deg=5),
        Case("mti630_over_forward", "mti630", ROLL, 240.0),
        Case("sdc500_four_over_forward", "sdc500", FOUR_ROLL, 240.0, lean_deg=1),
        Case("stim300_wheel_about_right", "stim300", WHEEL, 240.0),
    ]  # fmt: skip
    return {case.name: case for case in every}


def draw(case: Case, imu: ImuModel, count: int, seed: int) -> Labelled:
    """So many recordings of a case, as means."""
    rng = np.random.default_rng(seed)
    h, n = case.interval_s, round(case.duration_s / case.interval_s)
    fine = (np.arange(n * _FINE) + 0.5) * h / _FINE
    angle, rate = plan(case.protocol, 0, case.duration_s).command(fine)
    change = np.gradient(rate, h / _FINE)

    def mean(values: np.ndarray) -> np.ndarray:
        return values.reshape(n, _FINE, *values.shape[1:]).mean(axis=1)

    psi, toward = rng.uniform(-np.pi, np.pi, (2, count))
    lean = np.deg2rad(case.lean_deg)
    base = euler_to_matrix(lean * np.cos(toward), lean * np.sin(toward), psi)
    axis = AXES.index(case.protocol.axis)
    plate, (i, j) = mean(rotation(angle, axis)), across(axis)
    c_nb = np.einsum("wij,njk->wnik", base, plate)
    omega = np.einsum("wnij,i->wjn", c_nb, earth_rate_ned(LATITUDE))
    omega[:, axis] += mean(rate)
    force = np.einsum("wnij,i->wjn", c_nb, [0.0, 0.0, -normal_gravity(LATITUDE)])
    force[:, i] -= ARM_M * mean(rate**2)
    force[:, j] += ARM_M * mean(change)
    field = np.einsum("wnij,i->wjn", c_nb, imu.field_ned)
    felt = replace(imu.warming, force=force, field=field)
    late = 0.5 * imu.dt * mean(rate)  # an encoder is read at a sample's end
    windows = Windows(
        gyro=_measured(imu, imu.gyro, rng, omega, h, felt),
        accel=_measured(imu, imu.accel, rng, force, h, imu.warming),
        plate_angle=np.tile(mean(angle) + late, (count, 1)),
        rate_hz=1 / h,
        latitude=np.full(count, LATITUDE),
        start_s=np.zeros(count),
        axis=axis,
    )
    return Labelled(windows=windows, heading=psi, heading_reference=psi)


def _measured(
    imu: ImuModel,
    triad: Triad,
    rng: np.random.Generator,
    truth: np.ndarray,
    interval: float,
    around: Surroundings,
) -> np.ndarray:
    """Means, (W, n, 3), each window of its own unit, session and run."""
    own = rng.spawn(len(truth))
    units = [triad.draw_unit(each) for each in own]
    lasting = [unit | triad.draw_session(each) for unit, each in zip(units, own, strict=True)]
    stacked = {name: np.stack([one[name] for one in lasting]) for name in lasting[0]}
    drawn = triad.draw_run(own, stacked)
    n, block = truth.shape[-1], round(interval / imu.dt)
    means = triad.measure_means(own, truth, drawn, n, imu.dt, block, around)
    return np.moveaxis(means, 1, 2).astype(float)


@dataclass(frozen=True)
class Score:
    """An estimator's on a case."""

    rmse_deg: float
    nees: float
    """Mean of (error/sigma)^2"""
    over_floor: float
    """RMSE over the floor's"""
    above: float
    """Its loss less the floor's, in standard errors of that mean: squared error; 1 - cos where the
    floor's RMSE is above 20 degrees"""


def run(case: Case, recordings: int, seed: int, names: tuple[str, ...] = ()) -> dict[str, Score]:
    """Every estimator (or those named) that can answer the case, the floor among them."""
    imu = case.model()
    drawn = draw(case, imu, recordings, seed)
    found: dict[str, Estimate] = {}
    for name, estimate in EVERY.items():
        if names and name not in (*names, "floor"):
            continue
        try:
            found[name] = estimate(drawn.windows, imu)
        except InputError:
            continue
    return _scored(found, drawn.heading)


def _scored(found: Mapping[str, Estimate], heading: np.ndarray) -> dict[str, Score]:
    errors = {name: wrap(own.heading - heading) for name, own in found.items()}
    rmse = {name: float(np.sqrt(np.mean(e**2))) for name, e in errors.items()}
    wide = np.rad2deg(rmse["floor"]) > _AS_LENGTHS_DEG
    losses = {name: 1 - np.cos(e) if wide else e**2 for name, e in errors.items()}
    scores = {}
    for name, own in found.items():
        off = losses[name] - losses["floor"]
        spread = float(np.std(off)) / np.sqrt(len(off))
        scores[name] = Score(
            float(np.rad2deg(rmse[name])),
            float(np.mean((errors[name] / own.sigma) ** 2)),
            rmse[name] / rmse["floor"],
            float(np.mean(off)) / spread if spread > 0 else 0.0,
        )
    return scores
