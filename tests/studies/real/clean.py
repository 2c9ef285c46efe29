"""Simulated logs of every preset: are they answered, and do their intervals hold the truth?

And the same logs spoiled on purpose: what is caught of each kind and size.
"""

import contextlib
import io
import json
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cached_property
from multiprocessing import get_context
from pathlib import Path
from unittest import mock

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from common import Report
from helpers import composed, default_config
from tqdm import tqdm

import lbgc.evaluate
import lbgc.fit
from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.evaluate import EvaluateConfig
from lbgc.fit import FitConfig
from lbgc.frames import euler_to_matrix
from lbgc.sensor.errors import Surroundings
from lbgc.sensor.imu import ImuModel

COLUMNS = ("w_x", "w_y", "w_z", "f_x", "f_y", "f_z")
FRAMES = (
    ("x", "y", "z"),
    ("x", "-y", "-z"),
    ("y", "x", "-z"),
    ("-y", "x", "z"),
    ("-x", "-y", "z"),
    ("z", "x", "y"),
)
"""Which of a file's axes point forward, right and down."""


@dataclass(frozen=True)
class Log:
    """A clean log: who drew it, and how it is described."""

    number: int
    preset: str
    rate_hz: float
    seconds: float
    latitude_deg: float
    frame: tuple[str, ...]

    @property
    def options(self) -> list[str]:
        return [
            "log=csv",
            "log.gyro_unit=rad/s",
            "log.accel_unit=m/s2",
            f"log.axes=[{','.join(self.frame)}]",
            f"log.rate_hz={self.rate_hz:g}",
            f"log.latitude={self.latitude_deg:g}",
            "log.bias_limit_deg_per_h=20000",
        ]

    @cached_property
    def imu(self) -> ImuModel:
        return default_config(f"imu={self.preset}").imu.model(self.rate_hz)


def logs_of(config: Mapping, count: int, seed: int) -> list[Log]:
    """Presets in turn; everything else drawn."""
    rng = np.random.default_rng((seed, 1))
    return [
        Log(
            k,
            config["presets"][k % len(config["presets"])],
            float(rng.choice(config["rates_hz"])),
            float(rng.choice(config["durations_s"])),
            float(rng.choice(config["latitudes"])),
            FRAMES[rng.integers(len(FRAMES))],
        )
        for k in range(count)
    ]


def drawn(log: Log, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """gyro (n, 3) rad/s and accel (n, 3) m/s^2, forward-right-down, of a base within 2 degrees of
    level."""
    rng = np.random.default_rng((seed, 2, log.number))
    n = round(log.rate_hz * log.seconds)
    latitude = np.deg2rad(log.latitude_deg)
    lean = np.deg2rad(rng.uniform(-2, 2, 2))
    c_nb = euler_to_matrix(*lean, rng.uniform(-np.pi, np.pi))
    omega = c_nb.T @ earth_rate_ned(latitude)
    force = c_nb.T @ np.array([0.0, 0.0, -normal_gravity(float(latitude))])
    out = []
    for triad, truth in ((log.imu.gyro, omega), (log.imu.accel, force)):
        errors = triad.draw_run(rng, triad.draw_unit(rng) | triad.draw_session(rng))
        felt = Surroundings(force=force[:, None]) if triad is log.imu.gyro else None
        printed, _ = triad.measure(rng, truth[:, None], errors, n, log.imu.dt, felt)
        count = triad.output_scale(log.imu.dt)
        out.append(printed.T * (1.0 if count is None else count))
    return out[0], out[1]


def in_frame(values: np.ndarray, frame: Sequence[str]) -> np.ndarray:
    """(n, 3) forward-right-down to the file's axes."""
    out = np.empty_like(values)
    for axis, name in enumerate(frame):
        sign = -1 if name.startswith("-") else 1
        out[:, "xyz".index(name.lstrip("-"))] = sign * values[:, axis]
    return out


def save(path: Path, log: Log, gyro: np.ndarray, accel: np.ndarray, **more: np.ndarray) -> None:
    values = np.hstack([in_frame(gyro, log.frame), in_frame(accel, log.frame)])
    table = {**more, **dict(zip(COLUMNS, values.T, strict=True))}
    pa.parquet.write_table(pa.table(table), path)


def called(program: str, options: Sequence[str]) -> tuple[str | None, dict, str]:
    """The refusal or None, the result and what was printed; run in a directory of its own. A fit's
    pictures are not drawn: for most logs they take longer than the fit."""
    said = io.StringIO()
    with (
        tempfile.TemporaryDirectory() as scratch,
        contextlib.chdir(scratch),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(io.StringIO()),
        mock.patch("lbgc.fit.allan_page.draw", return_value={}),
    ):
        try:
            if program == "fit":
                found = lbgc.fit.main(composed(FitConfig, "fit", *options))
                return None, json.loads((found / "fit.json").read_text()), said.getvalue()
            page = lbgc.evaluate.main(composed(EvaluateConfig, "evaluate", *options))
            return None, json.loads((page.parent / "results.json").read_text()), said.getvalue()
        except InputError as error:
            return str(error), {}, said.getvalue()


def _answered(task: tuple[Log, int]) -> dict:
    """One clean log fitted: the refusal, and each axis' N against the truth's."""
    log, seed = task
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "log.parquet"
        save(path, log, *drawn(log, seed))
        refused, result, said = called("fit", [*log.options, f"log.path='{path}'"])
    axes = []
    for part in ("gyro", "accel"):
        truth = getattr(log.imu, part).N
        for axis, fitted in enumerate(result.get(part, ())):
            e = fitted["estimates"].get("N")
            goodness = fitted.get("goodness") or {}
            interval = None
            if e is not None and e.get("low") and truth[axis] > 0:
                interval = [
                    e["low"] / truth[axis],
                    e["value"] / truth[axis],
                    e["high"] / truth[axis],
                ]
            axes.append({"part": part, "axis": axis, "N": interval, "p": goodness.get("p")})
    return {"log": asdict(log), "refused": refused, "axes": axes, "said": said}


def run(report: Report, config: Mapping, seed: int) -> None:
    own = logs_of(config, config["logs"], seed)
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        done = pool.map(_answered, [(log, seed) for log in own])
        found = list(tqdm(done, "clean logs", len(own), leave=False))
    (report.directory / "clean.json").write_text(json.dumps(found, indent=1))
    refused = [f for f in found if f["refused"] is not None]
    for f in refused:
        report.line(f"{f['log']['preset']} {f['log']['seconds']:g} s: {f['refused']}")
    covered: dict[str, list[bool]] = {}
    ps = []
    for f in found:
        for a in f["axes"]:
            if a["p"] is not None:
                ps.append(a["p"])
            if a["N"] is not None:
                covered.setdefault(f["log"]["preset"], []).append(a["N"][0] <= 1 <= a["N"][2])
    report.line(f"{'preset':18s} intervals of N  coverage")
    for preset, held in covered.items():
        report.line(f"{preset:18s} {len(held):14d}  {np.mean(held):.1%}")
    every = {p: 100 * float(np.mean(h)) for p, h in covered.items()}
    pooled = [h for each in covered.values() for h in each]
    report.summary |= {
        "clean_logs": len(found),
        "clean_logs_answered_percent": 100 * (1 - len(refused) / len(found)),
        "clean_interval_coverage_percent": 100 * float(np.mean(pooled)),
        "clean_interval_coverage_min": min(every.values()),
        "clean_interval_coverage_max": max(every.values()),
        "clean_interval_coverage_by_preset": every,
        "clean_intervals_by_preset": {p: len(h) for p, h in covered.items()},
        "goodness_tests": len(ps),
        "goodness_false_alarm_percent": 100 * float(np.mean(np.array(ps) < 0.05)) if ps else None,
    }
