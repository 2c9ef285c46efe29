"""Headings: the floor on a base that leans, plain means under noise, and what cannot be seen."""

from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import simulated
from common import Report, interval95
from helpers import default_config
from scoring import Scores, named, scored
from tqdm import tqdm

from lbgc.data.windows import Windows
from lbgc.sensor.imu import ImuModel

LATITUDE_DEG = 32.76
_BATCH = 500


def drawn(
    imu: ImuModel,
    protocol: str,
    seconds: float,
    count: int,
    seed: int,
    tilt_deg: tuple[float, float],
) -> Iterator[Windows]:
    """Windows of so many units on an ideal bench, by the batch."""
    for k in range(0, count, _BATCH):
        size = min(_BATCH, count - k)
        own = (imu, protocol, LATITUDE_DEG, seconds, size, seed + k)
        yield simulated.windows(*own, tilt_deg=tilt_deg)


def _leaning(task: tuple[str, str, float, int, int]) -> dict[str, Scores]:
    """Two thirds of the lean in roll, the rest in pitch."""
    sensor, protocol, lean, units, seed = task
    imu = default_config(f"imu={sensor}").imu.model(1.0)
    tilt = (lean * np.sqrt(2 / 3), lean * np.sqrt(1 / 3))
    windows = drawn(imu, protocol, 240.0, units, seed, tilt)
    return scored(windows, named("floor", "ekf"), imu)


def leaning(report: Report, config: Mapping, seed: int) -> None:
    """RMSE of the floor over the Kalman filter's, paired, and whether its sigma is true."""
    tasks = [
        (sensor, protocol, float(lean), config["units"], seed + 10_000 * k)
        for k, (sensor, protocol, lean) in enumerate(
            (s, p, d)
            for s in config["sensors"]
            for p in config["protocols"]
            for d in config["leans_deg"]
        )
    ]
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        found = list(tqdm(pool.map(_leaning, tasks), "leaning", len(tasks), leave=False))
    ratios, nees = {}, {}
    for (sensor, protocol, lean, *_), scores in zip(tasks, found, strict=True):
        floor, ekf = scores["floor"], scores["ekf"]
        ratio = floor.over(ekf)
        name = f"{sensor}, {protocol}, {lean:g} deg"
        ratios[name], nees[name] = ratio.high, floor.nse
        report.line(
            f"{name:34s} floor {floor.rmse_deg:.3f} ekf {ekf.rmse_deg:.3f} ratio {ratio.value:.4f} "
            f"[{ratio.low:.4f}, {ratio.high:.4f}] NEES {floor.nse:.3f} +- {floor.nse_error:.3f}, "
            f"ekf's {ekf.nse:.3f}"
        )
    report.summary |= {
        "leaning_floor_over_ekf_max": max(ratios.values()),
        "leaning_floor_over_ekf_upper": ratios,
        "leaning_nees_min": min(nees.values()),
        "leaning_nees_max": max(nees.values()),
        "leaning_nees": nees,
    }


def low_signal(report: Report, config: Mapping, seed: int) -> None:
    """Whether the plain mean's sigma is true where the noise is above Earth's rate."""
    imu = default_config(
        "imu=ideal", f"imu.gyro.arw_deg_per_sqrt_h={config['arw_deg_per_sqrt_h']}"
    ).imu.model(1.0)
    worst = []
    for window in config["windows_s"]:
        windows = drawn(imu, "static", float(window), config["recordings"], seed, (0.0, 0.0))
        for name, own in scored(windows, named("mean", "triad", "gls"), imu).items():
            low, high = interval95((own.errors / own.sigma) ** 2)
            report.line(
                f"white {config['arw_deg_per_sqrt_h']:g} deg/sqrt(h), {window:g} s, {name}: RMSE "
                f"{own.rmse_deg:.1f} deg, NEES {own.nse:.3f} [{low:.3f}, {high:.3f}]"
            )
            report.summary[f"{name}_nees_{window:g}s"] = own.nse
            if name in ("mean", "triad"):
                worst.append(own.nse)
    report.summary["mean_nees_low_signal"] = max(worst, key=lambda nees: abs(np.log(nees)))
