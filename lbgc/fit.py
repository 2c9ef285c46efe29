"""Fit a sensor's noise to its own static log, or to a dataset.

python lbgc/fit.py log.path=mine.csv log.latitude=48.1 name=mine
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from lbgc.commands import CONF, run_main
from lbgc.data import logs
from lbgc.data.looking.auto import NoiseLog
from lbgc.data.record import require_one_rate
from lbgc.data.static import AXES, PARTS, Static, require_steady
from lbgc.data.store import Dataset
from lbgc.errors import InputError, require, require_not_negative, require_positive
from lbgc.estimators.level import tilts_of
from lbgc.outputs import (
    as_json,
    fingerprint,
    mark_latest,
    shown,
    task_directory,
    write_atomically,
)
from lbgc.report import calibration_table
from lbgc.report.allan_page import AllanData, draw
from lbgc.report.figures import png
from lbgc.report.fitted import of_axes, of_axis, report
from lbgc.report.fitted_beside import bias_sizes
from lbgc.report.fitted_yaml import sensor_yaml
from lbgc.sensor.calibration import FEWEST, Calibration, calibrate
from lbgc.sensor.fitting import axes, corner, warmup
from lbgc.sensor.fitting.noise_fit import Fit

SHORTEST_S = 60.0


@dataclass(frozen=True)
class FitConfig:
    """The keys of `conf/fit.yaml`."""

    log: NoiseLog | None = None
    """A static log."""
    data: str | None = None
    """Or a dataset of resting recordings, whose noise is pooled."""
    name: str = "mine"
    """Name of the fitted sensor: `imu=NAME`."""
    flicker_short_s: float | None = None
    """Shorter corner of the bias instability's flat floor. null: 1, or the one that all axes of a
    sensor together fit best with."""
    flicker_long_s: float = 3600.0
    """Longer corner of the bias instability's flat floor."""
    skip_s: float = 0.0
    """Seconds to leave out at the start of each recording, while the sensor warms up."""
    processes: int | None = None
    """Number of axes fitted at the same time; null: one a core, or one after the other where the
    log is short. No result depends on it."""

    def __post_init__(self) -> None:
        one = (self.data is None) != (self.log is None)
        given = "both" if self.log is not None else "nothing"
        require(one, "data or log", given, "give one: log=NAME, or data=PATH")
        require(self.name.isidentifier(), "name", self.name, "must be a plain word")
        shipped = (Path(CONF) / "imu" / f"{self.name}.yaml").exists()
        require(not shipped, "name", self.name, "is a sensor's that lbgc has; call yours otherwise")
        require_positive("flicker_short_s", self.flicker_short_s)
        require_not_negative(self, "skip_s")
        require_positive("processes", self.processes)
        require(
            self.flicker_long_s > self.corners[0],
            "flicker_long_s",
            self.flicker_long_s,
            f"must be above flicker_short_s = {self.corners[0]:g}",
        )

    @property
    def corners(self) -> tuple[float, float]:
        """Corners of the bias instability's flat floor that the fit begins with, s."""
        return self.flicker_short_s or corner.USUAL, self.flicker_long_s


def main(config: FitConfig) -> Path:
    """Fit every axis, print the results, write the sensor and its plots, and return their
    directory."""
    static = _read(config)
    _require_steady(static, config.corners)
    directory = task_directory("fit", fingerprint({**asdict(config), "of": static.name}))
    fits = _fitted(static, config, directory / "axes")
    (directory / "imu").mkdir(exist_ok=True)
    print(report(static, fits))
    calibration = None
    if static.heading is not None and len(static.heading) >= FEWEST:
        calibration = _calibrated(static)
    sizes = bias_sizes(static, fits)
    if calibration is not None:
        del sizes["gyro"]
    yaml = sensor_yaml(config.name, static, fits, calibration, sizes)
    write_atomically(directory / "imu" / f"{config.name}.yaml", yaml)
    write_atomically(directory / "fit.json", as_json(of_axes(fits)) + "\n")
    for part in PARTS:
        data = AllanData(part, getattr(static, part), static.dt, static.latitude)
        for name, figure in draw(data, fits[part]).items():
            write_atomically(directory / f"{name}.png", png(figure))
    mark_latest(directory)
    print("use it:")
    print(f"python sim/generate.py --config-dir {directory} imu={config.name}")
    return directory


def _require_steady(static: Static, corners: tuple[float, float]) -> None:
    """Raise InputError unless the noise is the same throughout the log, as recorded or after
    changes of the mean that are not noise are taken out."""
    try:
        require_steady(static)
    except InputError:
        gyro, accel = (
            np.stack(
                [[warmup.taken_out(x, static.dt, corners, len(part))[0] for x in r.T] for r in part]
            )
            for part in (static.gyro, static.accel)
        )
        require_steady(replace(static, gyro=gyro.swapaxes(1, 2), accel=accel.swapaxes(1, 2)))


def _calibrated(static: Static) -> Calibration | None:
    """The calibration of bias by lifetime, which is printed. Where the recordings do not tell it,
    the reason is printed, and it is None."""
    assert static.heading is not None
    names = [f"{static.name}, recording {i}" for i in range(len(static.heading))]
    rates = static.gyro.mean(axis=1)
    try:
        tilt = tilts_of(static.accel.mean(axis=1), names)
    except InputError as error:
        print(f"no bias by lifetime: {error}")
        return None
    found = calibrate(rates, static.heading, static.latitude, static.session, tilt)
    print(calibration_table.report(found, static.name))
    return found


def _fitted(static: Static, config: FitConfig, directory: Path) -> dict[str, list[Fit]]:
    """The fits of all axes, with the shorter flicker corner that the data prefer unless one is
    given. Each is written to the directory at once, so that a later failure loses nothing."""
    directory.mkdir(exist_ok=True)
    fits = _each_axis(static, config, directory, PARTS, config.corners)
    for part in PARTS if config.flicker_short_s is None else ():
        short = corner.chosen([fit.short_corners for fit in fits[part]])
        if short != corner.USUAL:
            corners = (short, config.flicker_long_s)
            again = _each_axis(static, config, directory, (part,), corners)
            if sum(f.bic for f in again[part]) < sum(f.bic for f in fits[part]):
                print(f"{part}: the bias instability's shorter corner is {short:g} s, by the data")
                fits |= again
    return fits


def _each_axis(
    static: Static,
    config: FitConfig,
    directory: Path,
    parts: Sequence[str],
    corners: tuple[float, float],
) -> dict[str, list[Fit]]:
    """The fits of all axes of these triads with these flicker corners, s."""
    series = {
        (part, axis): np.ascontiguousarray(getattr(static, part)[:, :, axis])
        for part in parts
        for axis in range(3)
    }
    done: dict[axes.Name, Fit] = {}
    with tqdm(total=len(series), desc="fitting", leave=False) as bar:

        def say(name: axes.Name, what: str) -> None:
            """Show what is being tried on an axis."""
            bar.set_postfix_str(f"{name[0]} {AXES[name[1]]}: {what}")

        for name, fit in axes.fitted(series, static.dt, corners, config.processes, say):
            done[name] = fit
            text = as_json(of_axis(fit)) + "\n"
            write_atomically(directory / f"{name[0]}_{AXES[name[1]]}.json", text)
            bar.update()
    return {part: [done[part, axis] for axis in range(3)] for part in parts}


def _read(config: FitConfig) -> Static:
    """The resting recordings that the configuration names. Raises InputError where the plate turns
    or they are shorter than a minute."""
    session = None
    if config.log is not None:
        records = list(logs.read(config.log, north=False))
        require_one_rate(records)
        for note in dict.fromkeys(note for record in records for note in record.notes):
            print(note)
        name, key = config.log.name, "log"
        if config.log.session is not None:
            session = np.zeros(len(records), int)
    else:
        assert config.data is not None
        dataset = Dataset.open_finished(config.data)
        records = list(dataset.records(np.arange(min(len(dataset), 64))))
        session = dataset.label("session")[: len(records)]
        name, key = shown(dataset.path), "data"
    still = all(np.ptp(r.plate_angle) < 1e-4 for r in records)
    require(still, key, name, "has a plate that turns; noise is fitted to resting recordings")
    headings = [r.heading_reference for r in records]
    first = round(config.skip_s * records[0].rate_hz)
    n = min(len(r.gyro) for r in records)
    seconds = max(0, n - first) / records[0].rate_hz
    if seconds < SHORTEST_S:
        raise InputError(
            name, f"{seconds:g}", "s", f"is too short to tell noise from bias; {SHORTEST_S:g} s "
            "at the least, and an hour to see a bias instability"
        )  # fmt: skip
    return Static(
        name,
        np.stack([r.gyro[first:n] for r in records]),
        np.stack([r.accel[first:n] for r in records]),
        1 / records[0].rate_hz,
        records[0].latitude,
        None if any(h is None for h in headings) else np.array(headings, dtype=float),
        session,
    )


if __name__ == "__main__":
    run_main(main, FitConfig, "fit")
