"""Clean logs spoiled on purpose: how many of each kind and size are caught.

Caught is what is refused, or said where the answer is printed, or answered rightly all the same.
"""

import json
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import scipy.signal
from common import Report
from tqdm import tqdm

from real.clean import Log, called, drawn, save

Arrays = tuple[np.ndarray, np.ndarray]
"""gyro and accel (n, 3), forward-right-down, SI"""

WORDS = {
    "lines": (),
    "time_unit": ("time_unit",),
    "accel_reversed": ("accel_axes", "axes"),
    "gyro_mirrored": ("axes",),
    "gyro_swapped": ("axes",),
    "upside_down": ("axes",),
    "forward_vertical": ("forward",),
    "rail": ("extreme", "rail"),
    "coarse": ("count",),
    "held": ("repeat", "held"),
    "stuck": ("stuck", "never changes", "stands still"),
    "duplicated": ("again", "duplicate", "repeat"),
    "warm_up": ("warm", "drift", "skip_s"),
    "step": ("step", "drift", "skip_s", "jump"),
}
"""By which a refusal or a note names the kind."""


def white_of(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square of a sample's white noise, (3,) of gyro and accelerometer."""
    return tuple(np.array(t.N) / np.sqrt(log.imu.dt) for t in (log.imu.gyro, log.imu.accel))


def of_means(values: np.ndarray, log: Log, seconds: float = 100.0) -> np.ndarray:
    """Standard deviation of means over some seconds, as the log itself shows it, (3,)."""
    size = round(seconds * log.rate_hz)
    n = len(values) // size
    means = values[: n * size].reshape(n, size, 3).mean(axis=1, dtype=float)
    return np.diff(means, axis=0).std(axis=0) / np.sqrt(2)


def lines(own: Arrays, log: Log, size: float, rng: np.random.Generator) -> Arrays:
    gyro = own[0].astype(float)
    for f in (0.13, 0.31):
        b, a = scipy.signal.iirpeak(f * log.rate_hz, 25, fs=log.rate_hz)
        x = scipy.signal.lfilter(b, a, rng.standard_normal(gyro.shape), axis=0)
        gyro += size * white_of(log)[0] * x / x.std(axis=0)
    return gyro, own[1]


def rail(own: Arrays, log: Log, share: float, rng: np.random.Generator) -> Arrays:
    gyro = own[0].copy()
    gyro[:, 0] = np.minimum(gyro[:, 0], np.quantile(gyro[:, 0], 1 - share))
    return gyro, own[1]


def coarse(own: Arrays, log: Log, size: float, rng: np.random.Generator) -> Arrays:
    lsb = size * np.std(np.diff(own[0], axis=0), axis=0).max() / np.sqrt(2)
    return np.rint(own[0] / lsb) * lsb, own[1]


def stuck(own: Arrays, log: Log, share: float, rng: np.random.Generator) -> Arrays:
    gyro = own[0].copy()
    n = round(share * len(gyro))
    start = int(rng.integers(len(gyro) - n + 1))
    gyro[start : start + n, 1] = gyro[start, 1]
    return gyro, own[1]


def duplicated(own: Arrays, log: Log, seconds: float, rng: np.random.Generator) -> Arrays:
    n = round(seconds * log.rate_hz)
    start = int(rng.integers(len(own[0]) - n))
    return tuple(np.insert(v, start + n, v[start : start + n], axis=0) for v in own)


def warm_up(own: Arrays, log: Log, size: float, rng: np.random.Generator) -> Arrays:
    gyro, t = own[0].astype(float), np.arange(len(own[0])) / log.rate_hz
    gyro[:, 0] += size * of_means(gyro, log)[0] * np.exp(-t / 300)
    return gyro, own[1]


def step(own: Arrays, log: Log, size: float, rng: np.random.Generator) -> Arrays:
    gyro = own[0].astype(float)
    at = int(len(gyro) * rng.uniform(0.3, 0.7))
    gyro[at:, 2] += size * of_means(gyro, log)[2]
    return gyro, own[1]


def held(own: Arrays, log: Log, times: float, rng: np.random.Generator) -> Arrays:
    return tuple(np.repeat(v, int(times), axis=0) for v in own)


def tilted(own: Arrays, log: Log, degrees: float, rng: np.random.Generator) -> Arrays:
    """The body's x at so many degrees from the vertical, down."""
    a = np.deg2rad(90 - degrees)
    pitch_down = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    return tuple(v @ pitch_down for v in own)


def reversed_accel(own: Arrays, log: Log, _: float, rng: np.random.Generator) -> Arrays:
    return own[0], -own[1]


def mirrored(own: Arrays, log: Log, _: float, rng: np.random.Generator) -> Arrays:
    return own[0] * [1, 1, -1], own[1]


def swapped(own: Arrays, log: Log, _: float, rng: np.random.Generator) -> Arrays:
    return own[0][:, [2, 1, 0]], own[1]


def upside_down(own: Arrays, log: Log, _: float, rng: np.random.Generator) -> Arrays:
    return tuple(v[:, [1, 0, 2]] * [1, 1, -1] for v in own)


SPOILT: Mapping[str, Callable[[Arrays, Log, float, np.random.Generator], Arrays]] = {
    "lines": lines,
    "accel_reversed": reversed_accel,
    "gyro_mirrored": mirrored,
    "gyro_swapped": swapped,
    "upside_down": upside_down,
    "forward_vertical": tilted,
    "rail": rail,
    "coarse": coarse,
    "held": held,
    "stuck": stuck,
    "duplicated": duplicated,
    "warm_up": warm_up,
    "step": step,
}
PER_S = {"ms": 1e3, "us": 1e6, "ns": 1e9}


def _is_right(kind: str, log: Log, result: dict) -> bool:
    """Whether what was fitted is what the sensor had, though nothing was said."""
    if kind not in ("lines", "coarse", "time_unit", "held"):
        return False
    for axis, fitted in enumerate(result["gyro"]):
        e, truth = fitted["estimates"].get("N"), log.imu.gyro.N[axis]
        if e is not None and e.get("low"):
            sigma = np.log(e["high"] / e["low"]) / 3.92
            if abs(np.log(e["value"] / truth)) > max(4 * sigma, 0.02):
                return False
        if kind == "lines":
            names = [n for n in fitted["estimates"] if n.startswith("line_f0")]
            found = [fitted["estimates"][n]["value"] for n in names]
            if not all(
                any(abs(f / (share * log.rate_hz) - 1) < 0.05 for f in found)
                for share in (0.13, 0.31)
            ):
                return False
    return True


def _caught(task: tuple[str, str, object, Log, int]) -> tuple[str, str]:
    """caught, missed or refused for another cause; and what was said."""
    kind, program, size, log, seed = task
    rng = np.random.default_rng((seed, 3, log.number))
    own, more = drawn(log, seed), {}
    options = [*log.options]
    if kind == "time_unit":
        more["t"] = np.round(np.arange(len(own[0])) / log.rate_hz * PER_S[str(size)])
        options = [o for o in options if not o.startswith("log.rate_hz")] + ["log.time_column=t"]
    else:
        own = SPOILT[kind](own, log, float(size), rng)
    if program == "evaluate":
        options += [f"imu={log.preset}", "windows_s=[300]", "log.heading_deg=0"]
        options = [o for o in options if "bias_limit" not in o]
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "log.parquet"
        save(path, log, *own, **more)
        refused, result, said = called(program, [*options, f"log.path='{path}'"])
    if refused is not None:
        named = any(word in refused for word in WORDS[kind]) or not WORDS[kind]
        return ("caught" if named else "other cause"), refused
    if any(word in said for word in WORDS[kind]):
        return "caught", said[:300]
    if program == "fit" and _is_right(kind, log, result):
        return "caught", "answered rightly"
    doubted = program == "fit" and any(
        (fitted.get("goodness") or {}).get("p", 1) is not None
        and (fitted.get("goodness") or {}).get("p", 1) < 0.001
        for part in ("gyro", "accel")
        for fitted in result[part]
    )
    return ("caught" if doubted else "missed"), said[:300]


def run(report: Report, config: Mapping, clean: Mapping, seed: int) -> None:
    tasks = []
    for kind, own in config["kinds"].items():
        by_frame = own["program"] == "evaluate"
        presets = config["frame_presets"] if by_frame else clean["presets"]
        for size in own["sizes"]:
            for k in range(config["logs"]):
                latitude = float(size) if by_frame and kind != "forward_vertical" else 48.1
                log = Log(
                    10_000 + k,
                    presets[k % len(presets)],
                    config["rate_hz"],
                    config["seconds"],
                    latitude,
                    ("x", "y", "z"),
                )
                tasks.append((kind, own["program"], size, log, seed))
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        done = pool.map(_caught, tasks)
        found = list(tqdm(done, "spoiled logs", len(tasks), leave=False))
    table: dict[str, list[float]] = {}
    other = 0
    for kind, own in config["kinds"].items():
        shares = []
        for size in own["sizes"]:
            here = [f for t, f in zip(tasks, found, strict=True) if t[0] == kind and t[2] == size]
            shares.append(100 * float(np.mean([verdict == "caught" for verdict, _ in here])))
            other += sum(verdict == "other cause" for verdict, _ in here)
        table[kind] = shares
        shown = ", ".join(f"{s}: {p:.0f}%" for s, p in zip(own["sizes"], shares, strict=True))
        report.line(f"{kind:18s} {shown:44s} ({own['what']})")
    missed = [
        {"kind": t[0], "size": t[2], "preset": t[3].preset, "verdict": v, "said": said}
        for t, (v, said) in zip(tasks, found, strict=True)
        if v != "caught"
    ]
    (report.directory / "missed.json").write_text(json.dumps(missed, indent=1))
    report.summary |= {
        "spoiled_logs": len(tasks),
        "spoiled_caught_percent": table,
        "spoiled_refused_for_another_cause": other,
    }
