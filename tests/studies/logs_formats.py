"""Part of `make study-logs`: one recording in every format and dialect is read the same, and its
fit is the same."""

import contextlib
import io
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cases
import dialect_files
import numpy as np
import written
from common import Report
from helpers import composed
from matplotlib.figure import Figure
from tqdm import tqdm

from lbgc.data.logs import LogConfig, read
from lbgc.data.record import Record
from lbgc.fit import FitConfig
from lbgc.fit import main as fit

RATE_HZ = 100.0
PRINTED = 1e-9
"""Relative rounding of the dialects' numbers, which have 12 digits, after they are converted"""
NOISE, BOUND = 5e-4, 5e-3
"""What the white noise of two fits, and any end of an interval, may differ by, of the upper end:
half of the last of the four and three digits that are printed of them"""
TERMS = ("N", "B", "K", "ramp")
SAID = {"latitude": 48.1, "bias_limit_deg_per_h": 5.0}


@dataclass(frozen=True)
class Tried:
    """One file of the recording, and what came of it."""

    name: str
    size: int
    seconds: float
    """Time of reading it"""
    error: float
    """The largest difference from what was written, of the largest value of its triad"""
    rounding: float
    """What that may be"""
    figures: dict[str, Any] | None
    """The fit's, where one was asked for"""
    refused: str = ""

    @property
    def is_equal(self) -> bool:
        """Whether the recording is the one that was written, to rounding."""
        return not self.refused and self.error <= self.rounding


def formats(report: Report, home: Path, wanted: dict[str, Any]) -> None:
    """Write, read and fit the recording in all formats and dialects. wanted : seconds of the
    recording, the seed, which formats (null: all), and of which the fit is asked for (likewise)."""
    t, w, f = cases.static(RATE_HZ, wanted["seconds"], arw=0.1, seed=wanted["seed"])
    table = np.column_stack([t, w, f])
    tried = []
    dialects = dialect_files.files(t, w, f)
    chosen = [own for own in written.EVERY if written.is_installed(own)] + list(dialects)
    if wanted["formats"] is not None:
        chosen = [own for own in chosen if own in wanted["formats"]]
    for name in tqdm(chosen, "formats", leave=False):
        path, said, rounding = _written(name, home, table, dialects)
        fitted = wanted["fits"] is None or name in wanted["fits"]
        tried.append(_tried(name, path, said, rounding, table, fitted))
    first = next(own.figures for own in tried if own.figures is not None)
    same = [own for own in tried if own.figures is not None and _differ(own.figures, first) <= 1]
    report.line(f"{'file':22s}{'bytes':>10s}{'read, s':>9s}{'differs by':>12s}{'may by':>9s}  fit")
    for own in tried:
        told = "not asked" if own.figures is None else "same" if own in same else "other"
        report.line(
            f"{own.name:22s}{own.size:10d}{own.seconds:9.2f}{own.error:12.1e}{own.rounding:9.1e}"
            f"  {own.refused or told}"
        )
    report.line(
        f"{sum(own.is_equal for own in tried)} of {len(tried)} files read equal; {len(same)} of "
        f"{sum(own.figures is not None for own in tried)} fits the same, within half of the last "
        "digit printed: of four of the white noise, of three of an interval's ends"
    )
    report.summary |= {
        "formats": len(tried),
        "formats_equal": sum(own.is_equal for own in tried),
        "dialects": sum(own.name in dialects for own in tried),
        "dialects_equal": sum(own.is_equal for own in tried if own.name in dialects),
        "formats_fitted": sum(own.figures is not None for own in tried),
        "formats_fit_same": len(same),
        "formats_fit_noise_tolerance_percent": 100 * NOISE,
        "formats_fit_interval_tolerance_percent": 100 * BOUND,
    }
    _draw(tried).savefig(report.directory / "formats.png", dpi=110)


def _written(
    name: str,
    home: Path,
    table: np.ndarray,
    dialects: dict[str, tuple[str | bytes, dialect_files.Said]],
) -> tuple[Path, dict[str, Any], float]:
    """A file of the recording: its place, what must be said of it, and its rounding."""
    if name in dialects:
        content, said = dialects[name]
        path = home / f"{name}.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path, {"gyro_unit": "auto", "accel_unit": "auto", **said}, PRINTED
    own = written.EVERY[name]
    path = home / name.replace(" ", "_") / own.name
    path.parent.mkdir()
    own.write(path, table)
    return path, written.keys_of(name), own.rounding


def _tried(
    name: str, path: Path, said: dict[str, Any], rounding: float, table: np.ndarray, fitted: bool
) -> Tried:
    """Read a file, hold it against what was written, and fit it."""
    files = path.iterdir() if path.is_dir() else [path]
    size = sum(own.stat().st_size for own in files)
    started = time.perf_counter()
    try:
        (record,) = read(LogConfig(path=str(path), **SAID, **said))
    except Exception as error:  # a line of the table, whatever it is
        return Tried(name, size, 0.0, np.inf, rounding, None, f"{type(error).__name__}: {error}")
    seconds = time.perf_counter() - started
    error = _error(record, table)
    return Tried(name, size, seconds, error, rounding, _fit(path, said) if fitted else None)


def _error(record: Record, table: np.ndarray) -> float:
    """The largest difference of a record from what was written, of the largest value of its
    triad; infinite where it has other samples, or another rate."""
    if len(record.gyro) != len(table) or abs(record.rate_hz / RATE_HZ - 1) > 1e-6:
        return np.inf
    pairs = (record.gyro, table[:, 1:4]), (record.accel, table[:, 4:])
    return float(max(np.abs(own - other).max() / np.abs(other).max() for own, other in pairs))


def _fit(path: Path, said: dict[str, Any]) -> dict[str, Any]:
    """The figures that `python lbgc/fit.py log=csv log.path=FILE` finds."""
    keys = {"log.path": path, "log.latitude": SAID["latitude"]}
    keys |= {f"log.{key}": value for key, value in said.items()}
    keys |= {"processes": 1}
    options = [f"{key}={_typed(value)}" for key, value in keys.items()]
    hidden = io.StringIO()
    with (
        contextlib.chdir(path.parent),
        contextlib.redirect_stdout(hidden),
        contextlib.redirect_stderr(hidden),
    ):
        done = fit(composed(FitConfig, "fit", "log=csv", *options))
        return dict(json.loads((done / "fit.json").read_text()))


def _typed(value: object) -> str:
    """A value as it is typed."""
    if isinstance(value, list):
        return "[" + ",".join(_typed(own) for own in value) + "]"
    return str(value) if isinstance(value, int | float) else f"'{value}'"


def _differ(own: dict[str, Any], other: dict[str, Any]) -> float:
    """How much the figures of two fits differ, of what they may."""
    most = 0.0
    for part in ("gyro", "accel"):
        for one, two in zip(own[part], other[part], strict=True):
            for term in TERMS:
                ends = one["estimates"][term], two["estimates"][term]
                for key, value in ends[1].items():
                    share = NOISE if (term, key) == ("N", "value") else BOUND
                    scale = share * max(ends[1]["high"], 1e-300)
                    most = max(most, abs(ends[0][key] - value) / scale)
    return most


def _draw(tried: list[Tried]) -> Figure:
    """How far each file's recording is from what was written, and the random walks of its fit."""
    figure = Figure(figsize=(11.0, 0.19 * len(tried) + 1.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(tried))
    errors = np.array([min(max(own.error, 1e-17), 1.0) for own in tried])
    left.semilogx(errors, places, "o", color="#2c5d9b", markersize=4, label="differs by")
    may = [own.rounding for own in tried]
    left.semilogx(may, places, "|", color="#c0392b", markersize=8, label="rounding of its numbers")
    left.set_yticks(places, [own.name for own in tried], fontsize=7)
    left.set(xlabel="of the largest value (1e-17: equal)", title="as read, from what was written")
    left.legend(loc="upper right", fontsize=7)
    for axis, colour in enumerate(("#c0392b", "#27895a", "#2c5d9b")):
        for at, own in zip(places, tried, strict=True):
            if own.figures is not None:
                found = own.figures["gyro"][axis]["estimates"]["N"]
                scale = np.rad2deg(1) * 60
                values = [scale * found[k] for k in ("low", "high")]
                right.plot(values, [at, at], color=colour, linewidth=1, alpha=0.7)
                right.plot(scale * found["value"], at, ".", color=colour, markersize=4)
    right.set(xlabel="deg/sqrt(h), 95% interval", title="angle random walk of its fit, three axes")
    for axes in (left, right):
        axes.grid(True, color="0.92", linewidth=0.5)
        axes.set_ylim(len(tried), -1)
    return figure
