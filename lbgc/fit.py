"""Fit a sensor's noise to its own static log, to a dataset, or to a published Allan curve.

python lbgc/fit.py log.path=mine.csv log.latitude=48.1 name=mine
python lbgc/fit.py curve.gyro=curve.csv curve.gyro_unit=deg/h name=theirs
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from lbgc.commands import CONF, run_main
from lbgc.data import curves, finished_fits, logs
from lbgc.data.looking.auto import NoiseLog
from lbgc.data.record import require_on_plate, require_one_rate
from lbgc.data.static import AXES, PARTS, Static, require_steady
from lbgc.data.store import Dataset
from lbgc.errors import InputError, build, require, require_not_negative, require_positive
from lbgc.estimators.level import tilts_of
from lbgc.exports import require_formats, written
from lbgc.exports.subject import Subject
from lbgc.outputs import (
    as_json,
    fingerprint,
    mark_latest,
    shown,
    task_directory,
    write_atomically,
)
from lbgc.report import allan_page, calibration_table, fitted_curve, population
from lbgc.report.allan_page import AllanData
from lbgc.report.figures import png
from lbgc.report.fitted import of_axes, of_axis, report
from lbgc.report.fitted_beside import Warmth, bias_sizes
from lbgc.report.fitted_yaml import curve_yaml, intervals, sensor_yaml
from lbgc.report.remarks import of_outliers, of_temperature
from lbgc.sensor.calibration import FEWEST, Calibration, calibrate
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.fitting import allan_fit, axes, corner, warmup
from lbgc.sensor.fitting.noise_fit import Fit
from lbgc.sensor.fitting.outliers import without_outliers
from lbgc.sensor.fitting.population import FEWEST as FEWEST_UNITS
from lbgc.sensor.fitting.temperature import sensitivity
from lbgc.user_yaml import parse

SHORTEST_S = 60.0
MOST_OUTLIERS = 0.02
"""Share of an axis's samples that may be spikes and knocks."""


@dataclass(frozen=True)
class FitConfig:
    """The keys of `conf/fit.yaml`."""

    log: NoiseLog | None = None
    """A static log."""
    data: str | None = None
    """Or a dataset of resting recordings, whose noise is pooled."""
    curve: curves.CurveConfig = field(default_factory=curves.CurveConfig)
    """Or a published Allan curve."""
    units: list[str] | None = None
    """Or directories of finished fits, of units of one make, for the spread between these."""
    name: str = "mine"
    """Name of the fitted sensor: `imu=NAME`."""
    flicker_short_s: float | None = None
    """Shorter corner of the bias instability's flat floor. null: 1, or the one that all axes of a
    sensor together fit best with."""
    flicker_long_s: float = 3600.0
    """Longer corner of the bias instability's flat floor."""
    skip_s: float = 0.0
    """Seconds to leave out at the start of each recording, while the sensor warms up."""
    robust: bool = False
    """Whether spikes and short knocks are found and replaced by noise like that beside them."""
    processes: int | None = None
    """Number of axes fitted at the same time; null: one a core, or one after the other where the
    log is short. No result depends on it."""
    export: list[str] = field(default_factory=list)
    """Other tools to write the result for, as `lbgc/export_imu.py` does, at the log's rate."""

    def __post_init__(self) -> None:
        said = {"log": self.log is not None, "data": self.data is not None}
        said |= {"curve": self.curve.is_given, "units": self.units is not None}
        given = " and ".join(name for name, one in said.items() if one) or "nothing"
        about = "give one: log=NAME, data=PATH, curve.gyro=FILE, or units=[DIRECTORIES]"
        require(sum(said.values()) == 1, "log, data, curve or units", given, about)
        few = len({str(Path(one).resolve()) for one in self.units or ()}) < FEWEST_UNITS
        about = f"must be {FEWEST_UNITS} directories of fits or more, each of another unit"
        require(self.units is None or not few, "units", self.units, about)
        require(self.name.isidentifier(), "name", self.name, "must be a plain word")
        shipped = (Path(CONF) / "imu" / f"{self.name}.yaml").exists()
        require(not shipped, "name", self.name, "is a sensor's that lbgc has; call yours otherwise")
        require_positive("flicker_short_s", self.flicker_short_s)
        require_not_negative(self, "skip_s")
        require_positive("processes", self.processes)
        require_formats("export", self.export)
        sampled = self.log is not None or self.data is not None or not self.export
        about = "is for a log or a dataset, which has a rate: python lbgc/export_imu.py takes any "
        require(sampled, "export", self.export, f"{about}sensor, and rate_hz")
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
    if config.curve.is_given:
        return _of_curves(config)
    if config.units is not None:
        return _of_units(config.units)
    static = _read(config)
    if config.robust:
        static = _without_outliers(static)
    static, warmth = _without_temperature(static, config.corners)
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
    yaml = sensor_yaml(config.name, static, fits, calibration, sizes, warmth)
    write_atomically(directory / "imu" / f"{config.name}.yaml", yaml)
    content = of_axes(fits)
    for part, own in warmth.items():
        for axis, one in zip(content[part], own, strict=True):
            axis["bias_per_k"] = None if one is None else asdict(one)
    write_atomically(directory / "fit.json", as_json(content) + "\n")
    _export(yaml, 1 / static.dt, config.export, directory / "export")
    for part in PARTS:
        data = AllanData(part, getattr(static, part), static.dt, static.latitude)
        for name, figure in allan_page.draw(data, fits[part]).items():
            write_atomically(directory / f"{name}.png", png(figure))
    return _finished(directory, config.name)


def _finished(directory: Path, name: str) -> Path:
    """The directory, marked as the latest, once the command that uses the sensor is printed."""
    mark_latest(directory)
    print("use it:")
    print(f"python sim/generate.py --config-dir {directory} imu={name}")
    return directory


def _export(yaml: str, rate_hz: float, formats: Sequence[str], directory: Path) -> None:
    """Write the sensor of a YAML file, at this rate (Hz), in the terms of other tools, with the
    intervals that stand in its comments."""
    if not formats:
        return
    directory.mkdir(exist_ok=True)
    sensor = build(ImuConfig, parse(yaml.encode()))
    subject = Subject(sensor, rate_hz, doubts=tuple(intervals(yaml)))
    for name, text in written(subject, formats).items():
        write_atomically(directory / name, text)


def _of_curves(config: FitConfig) -> Path:
    """Fit the published Allan curves, as `main` fits a log."""
    given = {part: getattr(config.curve, part) for part in PARTS}
    files = {part: _file_names(file) for part, file in given.items() if file is not None}
    read = {part: curves.read(config.curve, part) for part in files}
    choose = config.flicker_short_s is None
    found = {
        part: allan_fit.fitted_together(own, config.corners, choose) for part, own in read.items()
    }
    directory = task_directory("fit", fingerprint(asdict(config)))
    (directory / "imu").mkdir(exist_ok=True)
    for part, own in found.items():
        print(fitted_curve.report(part, files[part], own))
        figure = allan_page.draw_curve(part, own)
        write_atomically(directory / f"allan_{part}.png", png(figure))
    three = {part: own * (3 // len(own)) for part, own in found.items()}
    fits = {part: [one.fit for one in own] for part, own in three.items()}
    of = " and ".join(f"the {part}'s Allan curve {files[part]}" for part in files)
    yaml = curve_yaml(config.name, of, fits)
    write_atomically(directory / "imu" / f"{config.name}.yaml", yaml)
    content = {part: [fitted_curve.of_curve(one) for one in own] for part, own in three.items()}
    write_atomically(directory / "fit.json", as_json(content) + "\n")
    return _finished(directory, config.name)


def _of_units(directories: list[str]) -> Path:
    """Tell the spread between units from their finished fits, print it, write `population.json`,
    and return its directory. Raises InputError where two are one and the same fit."""
    units = [finished_fits.estimates(one) for one in directories]
    for k, one in enumerate(units):
        require(one not in units[:k], "units", directories[k], "has the same fit as another unit")
    told = population.populations(units)
    print(population.report(told, len(units)))
    directory = task_directory("fit", fingerprint({"units": directories}))
    content = {"units": directories, **population.as_content(told)}
    write_atomically(directory / "population.json", as_json(content) + "\n")
    mark_latest(directory)
    return directory


def _file_names(given: str | list[str]) -> str:
    """The names of one file or of three, without their directories."""
    return ", ".join(
        shown(Path(one).name) for one in ([given] if isinstance(given, str) else given)
    )


def _without_outliers(static: Static) -> Static:
    """The recordings without spikes and short knocks; what was found is printed. Raises InputError
    where so much is that it is no exception."""
    values = {part: np.empty(getattr(static, part).shape) for part in PARTS}
    for which, part in enumerate(PARTS):
        for axis, name in enumerate(AXES):
            series = getattr(static, part)[:, :, axis]
            values[part][:, :, axis], found = without_outliers(series, static.dt)
            print(of_outliers(f"{part} {name}", found, which))
            share = 0.0 if found is None else found.share
            about = (
                f"of {part} {name} are far from its noise: that is no exception but what it does"
            )
            require(share <= MOST_OUTLIERS, "robust", f"{100 * share:.2g}% of the samples", about)
    return replace(static, gyro=values["gyro"], accel=values["accel"])


def _without_temperature(static: Static, corners: tuple[float, float]) -> tuple[Static, Warmth]:
    """The recordings without what follows their temperature, as far as that is told from zero, and
    each axis's bias against it, which is printed; nothing where none was recorded."""
    if static.temperature is None:
        return static, {}
    off = static.temperature - static.temperature.mean()
    values = {part: np.array(getattr(static, part)) for part in PARTS}
    found: Warmth = {part: [] for part in PARTS}
    for which, part in enumerate(PARTS):
        for axis, name in enumerate(AXES):
            series = values[part][:, :, axis]
            one = sensitivity(series, static.temperature, static.dt, corners)
            print(of_temperature(f"{part} {name}", one, which))
            if one is not None and one.is_told:
                series -= one.value * off
            found[part].append(one)
    return replace(static, gyro=values["gyro"], accel=values["accel"]), found


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
        accept = [*config.log.accept, *(["outliers"] if config.robust else [])]
        records = list(logs.read(replace(config.log, accept=accept), north=False))
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
    for record in records:
        require_on_plate(record)
    still = all(np.ptp(r.plate_angle) < 1e-4 for r in records)
    require(still, key, name, "has a plate that turns; noise is fitted to resting recordings")
    headings = [r.heading_reference for r in records]
    first = round(config.skip_s * records[0].rate_hz)
    n, longest = (f(len(r.gyro) for r in records) for f in (min, max))
    if n < longest:
        print(
            f"lengths: recordings have {n / records[0].rate_hz:g} to "
            f"{longest / records[0].rate_hz:g} s, and the first {n / records[0].rate_hz:g} s of "
            "each are used; their biases are free"
        )
    seconds = max(0, n - first) / records[0].rate_hz
    if seconds < SHORTEST_S:
        raise InputError(
            name, f"{seconds:g}", "s", f"is too short to tell noise from bias; {SHORTEST_S:g} s "
            "at the least, and an hour to see a bias instability"
        )  # fmt: skip
    warmth = [r.temperature[first:n] for r in records if r.temperature is not None]
    return Static(
        name,
        np.stack([r.gyro[first:n] for r in records]),
        np.stack([r.accel[first:n] for r in records]),
        1 / records[0].rate_hz,
        records[0].latitude,
        None if any(h is None for h in headings) else np.array(headings, dtype=float),
        session,
        np.stack(warmth) if len(warmth) == len(records) else None,
    )


if __name__ == "__main__":
    run_main(main, FitConfig, "fit")
