"""From simulated vehicles to a real one: part of `make study-learning`.

Networks are trained on the simulated vehicle scene alone: several latitudes and sensors, every
azimuth. They are scored on the real log after its first 600 s, which the scene was fitted to (the
whole log beside it); the log has one heading, so every window is turned virtually about its z axis
through many angles.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import Report, cases
from helpers import composed, default_config, labelled
from scipy.stats import binom, norm
from scoring import Scores, scored
from tqdm import tqdm

import lbgc.train
import sim.generate
from lbgc.data.logs import read
from lbgc.data.record import Record
from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled
from lbgc.errors import InputError, build
from lbgc.estimators import CLASSICAL
from lbgc.estimators.estimate import Estimator
from lbgc.evaluate import EvaluateConfig
from lbgc.frames import rotation_z, wrap
from lbgc.learning.estimator import Learned
from lbgc.metrics import Ratio, rmse_ratio
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.imu import ImuModel
from lbgc.train import TrainConfig

CASES = cases("swaying")
FITTED_S = 600.0
MODELS = {"unaided": "sway", "correction": "sway_correction"}


def sim_to_real(report: Report, directory: Path, minutes: list[float]) -> None:
    models = trained(CASES, directory, minutes)
    simulated(report, CASES, directory, models)
    real(report, CASES, models)


def vehicle(c: Mapping, name: str, directory: Path, *options: str) -> Dataset:
    common = tuple(c["scene"])
    out = f"out={directory}/data/{name}.zarr"
    return Dataset.open_finished(sim.generate.main(default_config(*common, *options, out)))


def trained(c: Mapping, directory: Path, minutes: list[float]) -> dict[str, Learned]:
    sets = []
    for number, options in enumerate(tqdm(c["train"], "vehicles", leave=False)):
        split = ("split=[9,1,0]", f"recordings={c['recordings']}", f"units={c['recordings']}")
        seed = f"seed={c['seed'] + number}"
        sets.append(str(vehicle(c, f"vehicle_{number}", directory, *options, *split, seed).place))
    models = {}
    for name, model in MODELS.items():
        options = (f"data=[{','.join(sets)}]", "experiment=sway", f"model={model}",
                   f"steps={c['steps']}")  # fmt: skip
        started = time.perf_counter()
        models[name] = Learned.load(lbgc.train.main(composed(TrainConfig, "train", *options)))
        minutes.append((time.perf_counter() - started) / 60)
    return models


def rows(
    report: Report, what: str, scores: Mapping[str, Scores], ratio: Ratio, against: str
) -> None:
    cells = "  ".join(f"{name} {own.rmse_deg:8.4f}" for name, own in scores.items())
    report.line(f"{what:28s} {cells}   correction over {against} {ratio.value:.3f} "
                f"({ratio.low:.3f} to {ratio.high:.3f})")  # fmt: skip


def best(scores: Mapping[str, Scores], names: Sequence[str]) -> str:
    return min(names, key=lambda name: scores[name].rmse_deg)


def simulated(report: Report, c: Mapping, directory: Path, models: Mapping[str, Learned]) -> None:
    """On vehicles of another seed, and on a latitude and a sensor that no training had."""
    data = vehicle(c, "vehicle_test", directory, *c["test"], "split=[0,0,1]",
                   f"recordings={c['test_recordings']}", f"units={c['test_recordings']}",
                   f"seed={c['seed'] + 1000}")  # fmt: skip
    records = list(data.records(np.arange(len(data))))
    imu = sensor(data)
    report.line()
    report.line("a simulated vehicle, its latitude and sensor new: RMSE, degrees, all windows")
    for window in c["windows_s"]:
        windows = Labelled.joined([labelled(record, window) for record in records])
        found = scored(iter([windows]), dict(models) | classical(c), imu)
        recording = np.repeat(np.arange(len(records)), len(windows) // len(records))
        against = best(found, c["classical"])
        ratio = rmse_ratio(found["correction"].errors, found[against].errors, recording)
        rows(report, f"{window:g} s, {len(windows)} windows", found, ratio, against)
        report.summary[f"vehicle_correction_{window:g}s_ratio_upper"] = ratio.high


def classical(c: Mapping) -> dict[str, Estimator]:
    return {name: CLASSICAL[name] for name in c["classical"]}


def sensor(data: Dataset) -> ImuModel:
    config = data.configuration
    return build(ImuConfig, config["imu"]).model(float(config["rate_hz"]))


def real(report: Report, c: Mapping, models: Mapping[str, Learned]) -> None:
    """Classical estimators are told the preset that was measured on the log."""
    try:
        config = composed(EvaluateConfig, "evaluate", "log=lasergyro", "imu=lasergyro")
        record = next(read(config.log))
    except InputError as error:
        report.line(f"the real log is left out: {error}")
        return
    imu = config.imu.model(record.rate_hz)
    for after in (FITTED_S, 0.0):
        report.line()
        report.line(f"lasergyro after {after:g} s, turned through {len(angles(c))} angles: RMSE, "
                    "degrees, from its reference")  # fmt: skip
        for window in c["windows_s"]:
            _real_window(report, c, models, imu, record, window, after)


def _real_window(
    report: Report,
    c: Mapping,
    models: Mapping[str, Learned],
    imu: ImuModel,
    record: Record,
    window: float,
    after: float,
) -> None:
    whole = labelled(record, window)
    tested = whole.rows(np.flatnonzero(whole.windows.start_s >= after)[: c["real_windows"]])
    found = {}
    for name, estimate in (dict(models) | classical(c)).items():
        own = scored((turned(tested, a) for a in angles(c)), {name: estimate}, imu, "reference")
        found |= own
    window_of = np.tile(np.arange(len(tested)), len(angles(c)))
    against = best(found, c["classical"])
    ratio = rmse_ratio(found["correction"].errors, found[against].errors, window_of)
    rows(report, f"{window:g} s, {len(tested)} windows", found, ratio, against)
    key = f"lasergyro_{{}}_{window:g}s_{{}}"
    for name in models:
        z = np.abs(found[name].errors / found[name].sigma)[: len(tested)]
        held = _held(c, z)
        said = "   ".join(f"{a:.0%} {b:.0%} ({low:.0%} to {high:.0%})" for a, b, low, high in held)
        report.line(f"    {name}: its intervals hold   {said}")
        if after == FITTED_S:
            inside = all(low <= share <= high for _, share, low, high in held)
            report.summary[key.format(name, "calibrated")] = inside
    if after == FITTED_S:
        report.summary[key.format("unaided", "rmse_deg")] = found["unaided"].rmse_deg
        report.summary[key.format("correction", "rmse_deg")] = found["correction"].rmse_deg
        report.summary[key.format("correction", "ratio_upper")] = ratio.high
        report.summary[key.format("classical", "rmse_deg")] = found[against].rmse_deg


def _held(c: Mapping, z: np.ndarray) -> list[tuple[float, float, float, float]]:
    """Level, share of errors inside, and the binomial 95% range of that share."""
    n = len(z)
    return [
        (
            level,
            float(np.mean(z <= norm.ppf((1 + level) / 2))),
            *np.divide(binom.interval(0.95, n, level), n),
        )
        for level in c["calibration_levels"]
    ]


def angles(c: Mapping) -> np.ndarray:
    return np.deg2rad(np.arange(0, 360, c["angles_deg"]))


def turned(own: Labelled, angle: float) -> Labelled:
    """By an IMU whose axes stand turned so, clockwise about its z axis."""
    R = rotation_z(angle)
    return replace(
        own,
        windows=replace(own.windows, gyro=own.windows.gyro @ R, accel=own.windows.accel @ R),
        heading_reference=wrap(own.heading_reference + angle),
    )
