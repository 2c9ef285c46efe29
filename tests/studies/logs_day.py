"""Part of `make study-logs`: what a day's log costs, 24 hours at 200 Hz through `look` and `fit`,
in each of some formats."""

import json
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cases
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from common import Report
from helpers import ROOT
from tqdm import tqdm

NAMES = ["t (s)", *(f"gyro_{x} (deg/s)" for x in "xyz"), *(f"accel_{x} (m/s2)" for x in "xyz")]
DIGITS = (3, 7, 7, 7, 6, 6, 6)
WALK = 2e-10, 1e-7
"""Random walk of the gyros' and accelerometers' biases from sample to sample, rad/s and m/s^2"""

LAUNCHER = """import json, os, re, resource, subprocess, sys, time
def family(process):
    found = [process]
    for own in found:
        try:
            with open(f"/proc/{own}/task/{own}/children") as file:
                found += map(int, file.read().split())
        except OSError:
            pass
    return found
def held(process):
    try:
        with open(f"/proc/{process}/smaps_rollup") as file:
            return int(re.search(r"Pss:\\s+(\\d+)", file.read())[1])
    except (OSError, TypeError):
        return 0
started, most = time.monotonic(), 0
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
while child.poll() is None:
    most = max(most, sum(map(held, family(child.pid))))
    time.sleep(0.2)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps({"largest_mb": used.ru_maxrss / 1024, "together_mb": most / 1024,
                  "cpu_s": used.ru_utime + used.ru_stime, "wall_s": time.monotonic() - started,
                  "code": child.returncode, "says": child.stderr.read().decode()[-300:]}))"""
"""A small program that runs another: on Linux a program's highest memory begins with that of who
started it. Of memory that processes share each has its part (Pss)."""


def day(report: Report, home: Path, wanted: dict[str, Any]) -> None:
    """Write the log and measure both commands on it. wanted : hours, rate_hz and seed of the log,
    and the formats."""
    kinds = {kind: home / f"day.{kind}" for kind in wanted["formats"]}
    rows = write(kinds, wanted["hours"], wanted["rate_hz"], wanted["seed"])
    report.line(f"{wanted['hours']:g} h at {wanted['rate_hz']:g} Hz: {rows} rows")
    report.line(f"{'':16s}{'file, MB':>10s}{'largest, MB':>13s}{'together, MB':>14s}"
                f"{'CPU, s':>9s}{'wall, s':>9s}")  # fmt: skip
    found: dict[str, dict[str, Any]] = {}
    for kind, path in kinds.items():
        for name, *options in (
            ("look", str(path), "log.latitude=48.1"),
            ("fit", f"log.path={path}", "log.latitude=48.1", "name=day"),
        ):
            own = measured(home, str(ROOT / f"lbgc/{name}.py"), *options)
            found[f"{name} {kind}"] = own
            size = path.stat().st_size / 2**20
            report.line(
                f"{name + ' ' + kind:16s}{size:10.0f}{own['largest_mb']:13.0f}"
                f"{own['together_mb']:14.0f}{own['cpu_s']:9.0f}{own['wall_s']:9.0f}"
                + (f"  FAILED: {own['says'].strip()[-200:]}" if own["code"] else "")
            )
        path.unlink()
    report.summary |= {
        "day_log_hours": wanted["hours"],
        "day_log_memory_mb": round(max(own["largest_mb"] for own in found.values())),
        "day_log_memory_together_mb": round(max(own["together_mb"] for own in found.values())),
        "day_log_cpu_s": round(max(
            sum(found[f"{name} {kind}"]["cpu_s"] for name in ("look", "fit")) for kind in kinds
        ), 1),
        "day_log_failed": sum(own["code"] != 0 for own in found.values()),
    }  # fmt: skip
    for key, own in found.items():
        report.summary |= {
            f"day_log_{key.replace(' ', '_')}_memory_mb": round(own["largest_mb"]),
            f"day_log_{key.replace(' ', '_')}_cpu_s": round(own["cpu_s"], 1),
        }


def measured(home: Path, *arguments: str) -> dict[str, Any]:
    """What a program took that did this in a directory: memory of its largest process and of all
    together, MB, time of processor, s, and how it ended."""
    command = [sys.executable, "-c", LAUNCHER, sys.executable, *arguments]
    done = subprocess.run(command, cwd=home, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout))


def write(kinds: dict[str, Path], hours: float, rate_hz: float, seed: int) -> int:
    """Write the log in these formats, a part after the other, and return its rows."""
    rows = round(hours * 3600 * rate_hz)
    part = round(min(1800 * rate_hz, rows))
    table = pa.schema([(name, pa.float64()) for name in NAMES])
    with ExitStack() as stack:
        csv = parquet = fields = hdf5 = None
        if "csv" in kinds:
            csv = stack.enter_context(pa.csv.CSVWriter(kinds["csv"], table))
        if "parquet" in kinds:
            parquet = stack.enter_context(pa.parquet.ParquetWriter(kinds["parquet"], table))
        if "npy" in kinds:
            types = [(name, "<f8") for name in NAMES]
            fields = np.lib.format.open_memmap(kinds["npy"], "w+", types, (rows,))
        if "h5" in kinds:
            hdf5 = stack.enter_context(h5py.File(kinds["h5"], "w"))
            for name in NAMES:
                hdf5.create_dataset(_key(name), (rows,), "<f8", chunks=True, compression="gzip")
        off = np.zeros(6)
        for number, first in enumerate(tqdm(range(0, rows, part), "day", leave=False)):
            count = min(part, rows - first)
            columns = _part(count, first, rate_hz, [seed, number], off)
            batch = pa.record_batch(columns, schema=table)
            for writer in (csv, parquet):
                if writer is not None:
                    writer.write_batch(batch)
            if fields is not None:
                for name, values in zip(NAMES, columns, strict=True):
                    fields[name][first : first + count] = values
            if hdf5 is not None:
                for name, values in zip(NAMES, columns, strict=True):
                    hdf5[_key(name)][first : first + count] = values
    return rows


def _key(name: str) -> str:
    """A column's name as HDF5 can have it, in which / separates groups."""
    return name.replace("/s2", " s-2").replace("/s", " s-1")


def _part(
    count: int, first: int, rate_hz: float, seed: list[int], off: np.ndarray
) -> list[np.ndarray]:
    """Columns of a part of the log. off : (6,), the biases at its start, and, changed in place, at
    its end."""
    rng = np.random.default_rng(seed)
    _, gyro, accel = cases.static(rate_hz, count / rate_hz, arw=0.1, seed=int(rng.integers(2**31)))
    steps = rng.normal(size=(count, 6)) * np.repeat(WALK, 3)
    walk = off + np.cumsum(steps, axis=0)
    off[:] = walk[-1]
    gyro, accel = np.rad2deg(gyro + walk[:, :3]), accel + walk[:, 3:]
    every = [(first + np.arange(count)) / rate_hz, *gyro.T, *accel.T]
    return [np.round(own, digits) for own, digits in zip(every, DIGITS, strict=True)]
