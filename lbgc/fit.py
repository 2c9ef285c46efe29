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
from lbgc.data.static import PARTS, Static, at_rest, require_steady
from lbgc.data.store import Dataset
from lbgc.errors import InputError, build, require, require_not_negative, require_positive
from lbgc.estimators.level import tilts_of
from lbgc.exports import require_formats, written
from lbgc.exports.subject import Subject
from lbgc.frames import AXES, axis_names
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
from lbgc.report.fitted_beside import Warmth, bias_sizes, unmeasured
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
    read = _read(config)
    if config.robust:
        read = [_without_outliers(static) for static in read]
    told = [_without_temperature(static, config.corners) for static in read]
    statics = [static for static, _ in told]
    warmth = {part: own for _, found in told for part, own in found.items()}
    del read, told
    for static in statics:
        _require_steady(static, config.corners)
    directory = task_directory("fit", fingerprint({**asdict(config), "of": statics[0].name}))
    fits: dict[str, list[Fit]] = {}
    for static in statics:
        fits |= _fitted(static, config, directory / "axes")
    (directory / "imu").mkdir(exist_ok=True)
    for static in statics:
        print(report(static, fits))
    calibration = _calibrated(statics)
    sizes = bias_sizes(statics, fits)
    if not np.isfinite(statics[0].latitude):
        print("bias: not told, since log.latitude is not given: neither is Earth's rate")
    if calibration is not None or any(static.turned for static in statics):
        sizes.pop("gyro", None)
    yaml = sensor_yaml(config.name, statics, fits, calibration, sizes, warmth)
    write_atomically(directory / "imu" / f"{config.name}.yaml", yaml)
    content = of_axes(fits)
    for part, own in warmth.items():
        for axis, one in zip(content[part], own, strict=True):
            axis["bias_per_k"] = None if one is None else asdict(one)
    write_atomically(directory / "fit.json", as_json(content) + "\n")
    _export(yaml, 1 / statics[0].dt, config.export, directory / "export")
    for static in statics:
        for part, values in static.triads.items():
            data = AllanData(part, values, static.dt, static.latitude)
            for name, figure in allan_page.draw(data, fits[part]).items():
                write_atomically(directory / f"{name}.png", png(figure))
    for part in PARTS:
        if part not in fits:
            what = "gyros" if part == "gyro" else "accelerometers"
            print(f"no {what} were recorded: {config.name} has none of their errors, and says so")
        elif len(fits[part]) < len(AXES):
            print(f"{unmeasured(part, fits[part])}; {config.name} says so")
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
    require(bool(told), "units", directories, "have no triad in common")
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
    values: dict[str, np.ndarray] = {
        part: np.empty(own.shape) for part, own in static.triads.items()
    }
    for part in values:
        which = PARTS.index(part)
        for axis, name in enumerate(axis_names(values[part].shape[2])):
            series = static.triads[part][:, :, axis]
            values[part][:, :, axis], found = without_outliers(series, static.dt)
            print(of_outliers(f"{part} {name}", found, which))
            share = 0.0 if found is None else found.share
            about = (
                f"of {part} {name} are far from its noise: that is no exception but what it does"
            )
            require(share <= MOST_OUTLIERS, "robust", f"{100 * share:.2g}% of the samples", about)
    return static.with_triads(values)


def _without_temperature(static: Static, corners: tuple[float, float]) -> tuple[Static, Warmth]:
    """The recordings without what follows their temperature, as far as that is told from zero, and
    each axis's bias against it, which is printed; nothing where none was recorded."""
    if static.temperature is None:
        return static, {}
    off = static.temperature - static.temperature.mean()
    values = {part: np.array(own) for part, own in static.triads.items()}
    found: Warmth = {part: [] for part in values}
    for part in values:
        which = PARTS.index(part)
        for axis, name in enumerate(axis_names(values[part].shape[2])):
            series = values[part][:, :, axis]
            one = sensitivity(series, static.temperature, static.dt, corners)
            print(of_temperature(f"{part} {name}", one, which))
            if one is not None and one.is_told:
                series -= one.value * off
            found[part].append(one)
    return static.with_triads(values), found


def _require_steady(static: Static, corners: tuple[float, float]) -> None:
    """Raise InputError unless the noise is the same throughout the log, as recorded or after
    changes of the mean that are not noise are taken out."""
    try:
        require_steady(static)
    except InputError:
        values = {
            part: np.stack(
                [[warmup.taken_out(x, static.dt, corners, len(own))[0] for x in r.T] for r in own]
            ).swapaxes(1, 2)
            for part, own in static.triads.items()
        }
        require_steady(static.with_triads(values))


def _calibrated(statics: Sequence[Static]) -> Calibration | None:
    """The calibration of bias by lifetime, which is printed; None where the headings of few
    recordings are known, or a triad is missing. Where the recordings do not tell it, the reason is
    printed, and it is None."""
    triads = {part: own for static in statics for part, own in static.triads.items()}
    first = statics[0]
    placed = first.heading is not None and np.isfinite(first.latitude)
    if not placed or first.heading is None or len(first.heading) < FEWEST:
        return None
    if len(triads) < len(PARTS) or len({len(own) for own in triads.values()}) > 1:
        print("no bias by lifetime: it takes both triads in each recording")
        return None
    names = [f"{first.name}, recording {i}" for i in range(len(first.heading))]
    try:
        tilt = tilts_of(triads["accel"].mean(axis=1), names)
    except InputError as error:
        print(f"no bias by lifetime: {error}")
        return None
    rates = triads["gyro"].mean(axis=1)
    found = calibrate(rates, first.heading, first.latitude, first.session, tilt)
    print(calibration_table.report(found, first.name))
    return found


def _fitted(static: Static, config: FitConfig, directory: Path) -> dict[str, list[Fit]]:
    """The fits of all axes, with the shorter flicker corner that the data prefer unless one is
    given. Each is written to the directory at once, so that a later failure loses nothing."""
    directory.mkdir(exist_ok=True)
    fits = _each_axis(static, config, directory, list(static.triads), config.corners)
    for part in static.triads if config.flicker_short_s is None else ():
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
    width = {part: static.triads[part].shape[2] for part in parts}
    series = {
        (part, axis): static.triads[part][:, :, axis]
        for part in parts
        for axis in range(width[part])
    }
    done: dict[axes.Name, Fit] = {}
    with tqdm(total=len(series), desc="fitting", leave=False) as bar:

        def say(name: axes.Name, what: str) -> None:
            """Show what is being tried on an axis."""
            bar.set_postfix_str(f"{name[0]} {axis_names(width[name[0]])[name[1]]}: {what}")

        for name, fit in axes.fitted(series, static.dt, corners, config.processes, say):
            done[name] = fit
            text = as_json(of_axis(fit)) + "\n"
            axis = axis_names(width[name[0]])[name[1]]
            write_atomically(directory / f"{name[0]}_{axis}.json", text)
            bar.update()
    return {part: [done[part, axis] for axis in range(width[part])] for part in parts}


def _read(config: FitConfig) -> list[Static]:
    """The resting recordings that the configuration names, those of plates that turn without their
    turns: all of them, or those of each triad where these have clocks of their own. What was noted
    of them is printed."""
    if config.log is not None:
        accept = [*config.log.accept, *(["outliers"] if config.robust else [])]
        groups = logs.read_noise(replace(config.log, accept=accept))
        name = config.log.name
        sessions = [None if config.log.session is None else np.zeros(len(own), int)
                    for own in groups]  # fmt: skip
    else:
        assert config.data is not None
        dataset = Dataset.open_finished(config.data)
        groups = [list(dataset.records(np.arange(min(len(dataset), 64))))]
        name, sessions = shown(dataset.path), [dataset.label("session")[: len(groups[0])]]
    found = [
        at_rest(name, own, session, config.skip_s)
        for own, session in zip(groups, sessions, strict=True)
    ]
    for note in dict.fromkeys(note for _, notes in found for note in notes):
        print(note)
    return [static for static, _ in found]


if __name__ == "__main__":
    run_main(main, FitConfig, "fit")
