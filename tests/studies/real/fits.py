"""What the fit makes of pure noise, how long it takes, and what it says of two real sensors."""

import json
import os
import tempfile
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import scipy.stats
from common import Report
from helpers import REAL_LOGS
from tqdm import tqdm

from lbgc.earth import normal_gravity
from lbgc.sensor.noise import Line
from lbgc.units import DEG, HOUR
from real.clean import Log, called, save

ARW = 0.1 * DEG / np.sqrt(HOUR)
VRW = 60e-6 * 9.80665


def _log(rate_hz: float, seconds: float) -> Log:
    return Log(0, "ideal", rate_hz, seconds, 48.1, ("x", "y", "z"))


def white(rng: np.random.Generator, log: Log) -> tuple[np.ndarray, np.ndarray]:
    n, root = round(log.rate_hz * log.seconds), np.sqrt(log.rate_hz)
    accel = VRW * root * rng.standard_normal((n, 3))
    accel[:, 2] -= normal_gravity(np.deg2rad(log.latitude_deg))
    return ARW * root * rng.standard_normal((n, 3)), accel


def _tones(task: tuple[int, int, float, int]) -> list[list[str]]:
    """What is found beside noise of no frequency on each axis of one log."""
    number, samples, rate_hz, seed = task
    log = _log(rate_hz, samples / rate_hz)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "log.parquet"
        save(path, log, *white(np.random.default_rng((seed, 4, number)), log))
        refused, result, _ = called("fit", [*log.options, f"log.path='{path}'"])
    if refused is not None:
        raise AssertionError(refused)
    return [
        [f"tone {t}" for t in fitted["tones"]]
        + [k for k in fitted["estimates"] if k.startswith("line_f0")]
        for part in ("gyro", "accel")
        for fitted in result[part]
    ]


def tones(report: Report, config: Mapping, seed: int) -> None:
    logs = int(np.ceil(config["axes"] / 6))
    tasks = [(k, config["samples"], float(config["rate_hz"]), seed) for k in range(logs)]
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        done = pool.map(_tones, tasks)
        axes = [axis for log in tqdm(done, "pure noise", logs, leave=False) for axis in log]
    false, n = sum(map(bool, axes)), len(axes)
    interval = scipy.stats.binomtest(false, n).proportion_ci(method="exact")
    report.line(f"pure noise: tones or lines on {false} of {n} axes, at most {interval.high:.2%}")
    report.summary |= {
        "false_tone_axes": n,
        "false_tone_percent": 100 * false / n,
        "false_tone_percent_upper": 100 * float(interval.high),
    }


def _cpu_s() -> float:
    """Of this process and those that it has waited for, s."""
    return sum(os.times()[:4])


def timed(options: list[str]) -> tuple[float, str | None, dict, str]:
    """CPU seconds of one fit, workers and all, and what it said."""
    before = _cpu_s()
    refused, result, said = called("fit", options)
    return _cpu_s() - before, refused, result, said


def speed(report: Report, config: Mapping, seed: int) -> None:
    log = _log(config["rate_hz"], 3600 * config["hours"])
    rng = np.random.default_rng((seed, 5))
    gyro, accel = white(rng, log)
    n, dt = len(gyro), 1 / log.rate_hz
    for hz, width, rms in config["lines"]:
        for values, one in ((gyro, DEG / HOUR), (accel, 1e-5)):
            values += Line(rms * one, hz, width).sample(rng, (3, n), dt).T
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "log.parquet"
        save(path, log, gyro, accel)
        cpu, refused, result, _ = timed([*log.options, f"log.path='{path}'"])
    if refused is not None:
        raise AssertionError(refused)
    axes = [*result["gyro"], *result["accel"]]
    found = [sum(k.startswith("line_f0") for k in a["estimates"]) for a in axes]
    report.line(
        f"{config['hours']:g} h at {log.rate_hz:g} Hz, six channels, {len(config['lines'])} lines "
        f"an axis: {cpu:.1f} CPU s; lines found {found}"
    )
    report.summary |= {"fit_cpu_s": cpu, "fit_lines_found": found}
    report.summary["fit_cpu_s_max"] = max(cpu, report.summary.get("fit_cpu_s_max", 0.0))


def real(report: Report, config: Mapping) -> None:
    """Both ADIS16405 whole: time, goodness of fit and N."""
    for name in config["logs"]:
        if not (REAL_LOGS / f"{name}.parquet").exists():
            report.line(f"{name} is left out: no recording under $LBGC_REAL_LOGS")
            continue
        cpu, refused, result, said = timed([f"log={name}"])
        report.line(f"{name}: {cpu:.1f} CPU s {refused or ''}")
        report.line(said)
        (report.directory / f"{name}.json").write_text(json.dumps(result, indent=1))
        report.summary[f"{name}_cpu_s"] = cpu
        for part in ("gyro", "accel"):
            for axis, fitted in zip("xyz", result.get(part, ()), strict=False):
                key = f"{name}_{part}_{axis}"
                goodness = fitted.get("goodness") or {}
                report.summary[f"{key}_goodness_p"] = goodness.get("p")
                e = fitted["estimates"].get("N")
                if part == "gyro" and e is not None:
                    unit = DEG / np.sqrt(HOUR)
                    report.summary[f"{key}_arw_deg_per_sqrt_h"] = [
                        None if e[k] is None else e[k] / unit for k in ("low", "value", "high")
                    ]
