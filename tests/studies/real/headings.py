"""Headings: the floor, on bases that lean and else, and what cannot be seen."""

from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import floor_cases
import leaning_sets
import numpy as np
from common import Report, interval95
from floor_cases import Case
from helpers import default_config
from scoring import Scores, named, scored
from tqdm import tqdm

from lbgc.data.windows import Labelled
from lbgc.sensor.imu import ImuModel

PROTOCOLS = {
    "static": floor_cases.STATIC,
    "two_position": floor_cases.TWO,
    "carousel": floor_cases.CAROUSEL,
}
_BATCH = 500
_STANDARD_ERRORS = 4.0


def drawn(case: Case, imu: ImuModel, count: int, seed: int) -> Iterator[Labelled]:
    """Windows of so many units, by the batch."""
    for k in range(0, count, _BATCH):
        yield floor_cases.draw(case, imu, min(_BATCH, count - k), seed + k)


def _scores_of(task: tuple[str, int, int]) -> dict[str, floor_cases.Score]:
    name, recordings, seed = task
    return floor_cases.run(floor_cases.cases()[name], recordings, seed)


def floor(report: Report, config: Mapping, seed: int) -> None:
    """No estimator's paired loss is below the floor's by more than four standard errors."""
    tasks = [(name, config["recordings"], seed) for name in floor_cases.cases()]
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        found = list(tqdm(pool.map(_scores_of, tasks), "floor", len(tasks), leave=False))
    beaten, least, nees = [], 0.0, []
    for (name, *_), scores in zip(tasks, found, strict=True):
        closest = min((n for n in scores if n != "floor"), key=lambda n: scores[n].above)
        least = min(least, scores[closest].above)
        nees.append(scores["floor"].nees)
        if scores[closest].above < -_STANDARD_ERRORS:
            beaten.append(name)
        report.line(
            f"{name:32s} floor {scores['floor'].rmse_deg:7.3f} deg, NEES {nees[-1]:.3f}; closest "
            f"{closest} at {scores[closest].over_floor:.4f} ({scores[closest].above:+.2f} s.e.); "
            f"ekf {scores['ekf'].rmse_deg:.3f}, NEES {scores['ekf'].nees:.3f}; {len(scores)} answer"
        )
    report.summary |= {
        "floor_cases": len(tasks),
        "floor_beaten_cases": len(beaten),
        "floor_comparisons": sum(len(scores) - 1 for scores in found),
        "floor_least_loss_standard_errors": least,
        "floor_nees_min": min(nees),
        "floor_nees_max": max(nees),
    }


def _leaning(task: tuple[str, str, float, int, int]) -> dict[str, Scores]:
    sensor, protocol, lean, units, seed = task
    case = Case("leaning", sensor, PROTOCOLS[protocol], 240.0, lean_deg=lean)
    imu = case.model()
    return scored(drawn(case, imu, units, seed), named("floor", "ekf"), imu)


def leaning(report: Report, config: Mapping, seed: int) -> None:
    """RMSE of the floor over the Kalman filter's, paired, and whether its sigma is true."""
    every = [
        (sensor, protocol, float(lean))
        for sensor in config["sensors"]
        for protocol in config["protocols"]
        for lean in config["leans_deg"]
    ]
    tasks = [(*own, config["units"], seed + 10_000 * k) for k, own in enumerate(every)]
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        found = list(tqdm(pool.map(_leaning, tasks), "leaning", len(tasks), leave=False))
    ratios, nees = {}, {}
    for (sensor, protocol, lean), scores in zip(every, found, strict=True):
        own, ekf = scores["floor"], scores["ekf"]
        ratio = own.over(ekf)
        name = f"{sensor}, {protocol}, {lean:g} deg"
        ratios[name], nees[name] = ratio.high, own.nse
        report.line(
            f"{name:34s} floor {own.rmse_deg:.3f} ekf {ekf.rmse_deg:.3f} ratio {ratio.value:.4f} "
            f"[{ratio.low:.4f}, {ratio.high:.4f}] NEES {own.nse:.3f} +- {own.nse_error:.3f}, "
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
    arw = config["arw_deg_per_sqrt_h"]
    imu = default_config("imu=ideal", f"imu.gyro.arw_deg_per_sqrt_h={arw}").imu.model(10.0)
    worst = []
    for window in config["windows_s"]:
        case = Case("low signal", "ideal", PROTOCOLS["static"], float(window), window / 10)
        windows = drawn(case, imu, config["recordings"], seed + round(window))
        for name, own in scored(windows, named("mean", "triad", "gls"), imu).items():
            low, high = interval95((own.errors / own.sigma) ** 2)
            report.line(
                f"white {arw:g} deg/sqrt(h), {window:g} s, {name}: RMSE {own.rmse_deg:.1f} deg, "
                f"NEES {own.nse:.3f} [{low:.3f}, {high:.3f}]"
            )
            report.summary[f"{name}_nees_{window:g}s"] = own.nse
            if name in ("mean", "triad"):
                worst.append(own.nse)
    report.summary["mean_nees_low_signal"] = max(worst, key=lambda nees: abs(np.log(nees)))


def calibrate(report: Report, config: Mapping) -> None:
    """Simulated sets on a leaning base whose scale and misalignment are zero."""
    sets = config["sets"]
    percent, refused = leaning_sets.leaning_coverage_percent(
        sets, config["roll_deg"], config["pitch_deg"]
    )
    report.line(f"calibrate: 95% intervals hold {percent:.1f}%; {refused} of {sets} sets refused")
    report.summary |= {
        "calibrate_leaning_scale_coverage_percent": percent,
        "calibrate_sets": sets,
        "calibrate_sets_refused": refused,
    }


def presets(report: Report, config: Mapping) -> None:
    """Each preset's simulated Allan minimum against its sheet's."""
    worst = {}
    for preset in config["clean"]["presets"]:
        off = leaning_sets.preset_minima(preset, **config["presets_size"])
        for key, percents in off.items():
            worst[f"{preset} {key}"] = float(np.abs(percents).max())
            report.line(f"{preset:18s} {key:26s} {np.round(percents, 2)} % off its sheet")
    report.summary |= {
        "preset_allan_minima": len(worst),
        "preset_allan_minimum_worst_percent": max(worst.values()),
    }
