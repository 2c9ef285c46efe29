"""Calibrate one unit by recordings with known headings, and test what that does to the heading.

python lbgc/calibrate.py means=FILE latitude=32.76
python lbgc/calibrate.py data=PATH
python lbgc/calibrate.py log=csv 'log.path=[FILE, ...]' imu=NAME

Where the sensor is known, what is known of the unit is written as a file, which `evaluate` and
`bound` take (calibration=FILE).
"""

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lbgc import own_unit
from lbgc.commands import run_main
from lbgc.data import logs, unit_file
from lbgc.data.checks import rest
from lbgc.data.looking.auto import NoiseLog
from lbgc.data.record import Record
from lbgc.data.static import AXES
from lbgc.data.store import Dataset
from lbgc.earth import EARTH_RATE, heading_exists, normal_gravity
from lbgc.errors import (
    InputError,
    build,
    require,
    require_choice,
    require_not_negative,
    require_positive,
)
from lbgc.estimators.level import tilts_of
from lbgc.outputs import (
    as_json,
    fingerprint,
    mark_latest,
    shown,
    task_directory,
    write_atomically,
)
from lbgc.own_unit import SPLITS, Labels, learned
from lbgc.report.calibration_table import report
from lbgc.sensor.calibration import FEWEST, calibrate, odd_one_out
from lbgc.sensor.datasheet import ImuConfig
from lbgc.units import DEG, HOUR

COLUMNS = ("heading_deg", "gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s")
FORCES = ("accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2")
_RATE_HZ = 100.0
"""Samples a second behind a table's means, which says nothing of them: what depends on it, such as
rounding, is lost in the mean of thousands."""
_ONE_SIDED = 0.4
"""Length of the mean of exp(i heading), 1 where all headings are equal, above which a note says
that they are on one side."""
_LEANT = 1e-3
"""Apparent scale factor error for 1 deg/h/g of g-sensitivity, above which a note mentions it."""


@dataclass(frozen=True)
class CalibrateConfig:
    """The keys of `conf/calibrate.yaml`."""

    means: str | None = None
    """A table of recording means, in any format of logs: heading_deg, gyro_x_deg_s, gyro_y_deg_s,
    gyro_z_deg_s; where known session (which power-up), and accel_x_m_s2, accel_y_m_s2,
    accel_z_m_s2, which level it."""
    latitude: float | None = None
    """degrees, of those means"""
    data: str | None = None
    """Or a dataset of resting recordings of one unit; its references are the headings."""
    log: NoiseLog | None = None
    """Or recordings with known headings, such as log=sdc500."""
    imu: ImuConfig | None = None
    """The sensor, whose law is the prior of what a unit keeps; a dataset's own, if null."""
    split: str = "estimated"
    """How a gyro's bias splits into what a unit keeps, a power-up adds and a recording adds:
    estimated, from these recordings, its sum being the sensor's; or stated, as the sensor has
    it."""
    reference_error_deg: float | None = None
    """1 sigma of the headings' error that is new in each recording; null: as the log states it."""
    reference_offset_deg: float = 0.0
    """1 sigma of a constant offset of the headings, which stays in every later heading."""
    mean_s: float | None = None
    """Length of the recordings behind `means`."""
    calibration: str | None = None
    """The unit's file as it was before these recordings, which it does not hold yet."""
    now: Any = None
    """The name or number of the power-up that is still on: what it adds is known likewise, until it
    is switched off."""

    def __post_init__(self) -> None:
        require_choice("split", self.split, SPLITS)
        told = self.now is None or isinstance(self.now, str) or type(self.now) is int
        require(told, "now", self.now, "must be a power-up's name or number")
        if self.reference_error_deg is not None:
            require_not_negative(self, "reference_error_deg")
        require_not_negative(self, "reference_offset_deg")
        require_positive("mean_s", self.mean_s)
        given = [name for name in ("means", "data", "log") if getattr(self, name) is not None]
        require(len(given) == 1, "means, data or log", given or "nothing", "give one of them")
        if self.means is not None:
            require(self.latitude is not None, "latitude", None, "must be given with means=FILE")


@dataclass(frozen=True)
class Given:
    """The input of a calibration: the means of R resting recordings, levelled where possible."""

    name: str
    means: rest.Means
    session: np.ndarray | None
    """(R,), number of each recording's session; None where it is not known"""
    tilt: tuple[np.ndarray, np.ndarray] | None
    """Roll and pitch, (R,) each, rad; None without accelerometers"""
    rate_hz: float = 1.0
    """Samples a second of the sensor"""
    mean_s: float | None = None
    """What each recording is a mean over, of a table of means"""


def main(config: CalibrateConfig) -> Path:
    """Calibrate, print the results, write them, and return the path of the results' file."""
    labels = Labels(
        None if config.reference_error_deg is None else config.reference_error_deg * DEG
    )
    given, imu = _read(config, labels)
    require_sound(given)
    means = given.means
    found = calibrate(means.rates, means.heading, means.latitude, given.session, given.tilt)
    print(report(found, given.name, [*_notes(given), *_coarse_steps(means.rates, found.run_sigma)]))
    directory = task_directory("calibrate", fingerprint({**asdict(config), "name": given.name}))
    if imu is not None:
        before = None if config.calibration is None else unit_file.load(config.calibration, imu)
        own = learned(
            imu, given.rate_hz, labels, config.reference_offset_deg * DEG, config.split,
            None if config.now is None else str(config.now),
            before,
        )  # fmt: skip
        for line in own_unit.report(own):
            print(line)
        own.unit.save(directory / "unit.json")
        print(f"for evaluate and bound: calibration={directory / 'unit.json'}")
    else:
        print("whose sensor is not known: imu=NAME, and what is known of this unit is written too")
    write_atomically(directory / "calibration.json", as_json(asdict(found)) + "\n")
    mark_latest(directory)
    return directory / "calibration.json"


def _read(config: CalibrateConfig, labels: Labels) -> tuple[Given, ImuConfig | None]:
    """The input that the configuration names (a table of means, a dataset, or a log), each of its
    recordings kept in `labels`; and the sensor."""
    if config.means is not None:
        assert config.latitude is not None
        given = _read_table(config.means, config.latitude * DEG)
        if config.imu is not None:
            require(
                config.mean_s is not None, "mean_s", None, "must be given with means=FILE and imu"
            )
            assert config.mean_s is not None
            given = replace(given, rate_hz=_RATE_HZ, mean_s=config.mean_s)
            for record in _of_means(given):
                labels.add(record)
        return given, config.imu
    session = None
    if config.data is not None:
        dataset = Dataset.open_finished(config.data)
        units = len(np.unique(dataset.label("unit")))
        require(units == 1, "data", config.data, f"has {units} units; a calibration is of one")
        records, name = dataset.records(np.arange(len(dataset))), shown(dataset.path)
        session = dataset.label("session")
        sensor = config.imu or build(ImuConfig, dataset.configuration["imu"])
        if labels.new is None:
            labels.new = dataset.configuration["scene"]["reference_error_deg"] * DEG
        given = given_of(labels.passing(records), name, session)
        labels.sessions = [str(own) for own in session]
        return replace(given, rate_hz=float(dataset.configuration["rate_hz"])), sensor
    log, rates = config.log, list[float]()
    assert log is not None

    def seen() -> Iterator[Record]:
        for record in logs.read(log, north=False):
            rates.append(record.rate_hz)
            yield record

    given = given_of(labels.passing(seen()), log.name, session)
    if any(labels.sessions):
        given = replace(given, session=np.unique(labels.session, return_inverse=True)[1])
    return replace(given, rate_hz=rates[0]), config.imu


def _of_means(given: Given) -> Iterator[Record]:
    """Recordings that are one sample each, of a table of means; level where it has no forces."""
    means, session = given.means, given.session
    assert given.mean_s is not None
    for k, name in enumerate(means.names):
        latitude = float(means.latitude[k])
        force = means.force[k]
        if not force.any():
            force = np.array([0.0, 0.0, -normal_gravity(latitude)])
        yield Record(
            name,
            means.rates[k : k + 1],
            force[None],
            np.zeros(1),
            1 / given.mean_s,
            latitude,
            heading_reference=float(means.heading[k]),
            session=None if session is None else f"{session[k]:g}",
        )


def given_of(records: Iterable[Record], name: str, session: np.ndarray | None) -> Given:
    """The means of recordings, levelled by their accelerometers. Raises InputError where one does
    not rest."""
    means = rest.means(records)
    return Given(name, means, session, tilts_of(means.force, means.names))


def _read_table(path: str, latitude: float) -> Given:
    """The means in a table; latitude : rad."""
    table = logs.columns(path, COLUMNS, optional=("session", *FORCES))
    heading, *rates = (table[name] * DEG for name in COLUMNS)
    names = tuple(f"{shown(path)}, row {row}" for row in range(len(heading)))
    force, tilt = np.zeros((len(heading), 3)), None
    missing = [name for name in FORCES if name not in table]
    if len(missing) < len(FORCES):
        about = f"is no column of {shown(path)}: all three of {', '.join(FORCES)} level, or none"
        require(not missing, "columns", ", ".join(missing), about)
        force = np.stack([table[name] for name in FORCES], axis=1)
        tilt = tilts_of(force, names)
    latitudes = np.full(len(heading), latitude)
    means = rest.Means(np.stack(rates, axis=1), force, heading, latitudes, names, ())
    return Given(shown(path), means, table.get("session"), tilt)


def require_sound(given: Given) -> None:
    """Raise InputError where there are too few recordings, or one contradicts the others."""
    means = given.means
    count = len(means.rates)
    if count < FEWEST:
        raise InputError(given.name, count, "recordings", f"are too few: {FEWEST} at the least")
    good = heading_exists(means.latitude)
    require(bool(good.all()), "latitude", means.latitude.max() / DEG, "is a pole: no heading there")
    odd = odd_one_out(means.rates, means.heading, means.latitude, given.session, given.tilt)
    if odd is not None:
        at, axis, distance, spread = odd
        other = ""
        if given.session is None:
            other = ", or is of another power-up (means=FILE takes a column session)"
        raise InputError(
            means.names[at],
            f"{distance / DEG * HOUR:.4g}",
            "deg/h",
            f"is how far its {AXES[axis]} rate is from what the other recordings make of it, which "
            f"scatter by {spread / DEG * HOUR:.3g} deg/h: it was not at rest, or not at its "
            f"heading{other}; leave it out",
        )


def _coarse_steps(rates: np.ndarray, scatter: np.ndarray) -> list[str]:
    """Notes on axes whose rates, (R, 3), are printed in steps no finer than they scatter, (3,);
    both rad/s."""
    notes = []
    for axis, label in enumerate(AXES):
        values = np.unique(rates[:, axis])
        if len(values) == len(rates):
            continue  # values in coarse steps would repeat
        steps = np.diff(values)
        steps = steps[steps > 1e-9 * np.abs(rates[:, axis]).max()]
        step = float(steps.min(initial=np.inf))
        if 0.5 * step > scatter[axis] or not len(steps):
            size = f"in steps of {step / DEG * HOUR:.3g} deg/h" if len(steps) else "as one value"
            notes.append(
                f"{label} rates come {size}, no finer than they scatter: a constant rounding error "
                "of up to half a step is in no interval"
            )
    return notes


def _notes(given: Given) -> list[str]:
    """Notes on what the recordings cannot tell, or not well."""
    notes = list(given.means.notes)
    middle = np.mean(np.exp(1j * given.means.heading))
    if _ONE_SIDED < abs(middle) < 0.98:
        opposite = (np.angle(middle) / DEG + 180) % 360
        notes.append(
            f"headings are on one side: others near {opposite:.0f} deg would tell bias, scale and "
            "misalignment from each other better"
        )
    if given.tilt is None:
        lean = np.tan(np.abs(given.means.latitude).max()) * DEG
        notes.append(
            f"no accelerometer columns ({', '.join(FORCES)}): taken as level; a base that leans by "
            f"1 degree would look like {lean:.1%} of scale and {1e3 * lean:.0f} mrad of "
            "misalignment"
        )
    else:
        lean = np.rad2deg(np.abs(given.tilt)).max()
        notes.append(f"levelled by the accelerometers: roll and pitch are up to {lean:.2f} deg")
        turning = given.means.force[:, :2] / np.linalg.norm(given.means.force, axis=1)[:, None]
        earth = EARTH_RATE * np.cos(given.means.latitude).mean() / DEG * HOUR
        looks = np.linalg.norm(turning.std(axis=0)) / earth
        if looks > _LEANT:
            notes.append(
                "gravity turns with the headings on this lean: 1 deg/h/g of g-sensitivity would "
                f"look like {looks:.2%} of scale"
            )
    return notes


if __name__ == "__main__":
    run_main(main, CalibrateConfig, "calibrate")
