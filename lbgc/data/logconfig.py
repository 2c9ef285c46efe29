"""The configuration of a log: where its file is, how that is laid out, its units and axes."""

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lbgc.data.checks.findings import CHECKS
from lbgc.data.readers.axes import is_right_handed, require_axes
from lbgc.data.readers.clock import TIME_UNITS
from lbgc.errors import (
    require,
    require_choice,
    require_name,
    require_not_negative,
    require_positive,
)
from lbgc.units import ANGLE_UNITS, DEG, FORCE_UNITS, HOUR, RATE_UNITS, VELOCITY_UNITS

GYRO_UNITS = RATE_UNITS | ANGLE_UNITS
"""Units of gyro columns, of rates and of increments, and their values in SI."""
ACCEL_UNITS = FORCE_UNITS | VELOCITY_UNITS
"""Units of accelerometer columns, of forces and of increments, and their values in SI."""
READERS = ("table", "recordings", "psins")
GAPS = ("refuse", "join", "longest", "split")
REPEATS = ("auto", "drop", "keep")
PLATE_UNITS = ("auto", "deg", "rad")
_LONGEST_GAP_S = 86400.0
"""Time between two files of one recording, s, at most."""
DEFAULT_GYRO, DEFAULT_ACCEL = ("w_x", "w_y", "w_z"), ("f_x", "f_y", "f_z")
"""Columns' names where the user gives none: those of the published layout."""
_ROW_TYPES = ("f4", "f8", *(f"{kind}{size}" for kind in "iu" for size in (1, 2, 4, 8)))
_PASSED_OVER = re.compile(r"V[1-9]\d{0,4}")


@dataclass(frozen=True)
class LogConfig:
    """The description of a log, which `conf/log/*.yaml` holds."""

    name: str = "log"
    """The log's name in reports."""
    reader: str = "table"
    """table: a file of columns: text, Parquet, Feather, NumPy, MATLAB, HDF5, R, a ROS bag, ULog, a
    dataflash log, rows of numbers as `dtype` says. recordings: a directory of CSV files
    `x_<heading>.csv`, or one of them. psins: a PSINS .imu file, whose header says the rest."""
    path: str | list[str] = ""
    """The file; if it is not there, it is looked for under $LBGC_REAL_LOGS. Or several files of one
    sensor and one layout: the positions of one recording where `angles_deg` says where the plate
    stood in each, a recording each otherwise."""
    table: str | None = None
    """The table of a file that holds several: a topic, variable, group or kind of message. null:
    the only one whose columns can be an IMU's."""
    dtype: list[str] | None = None
    """The fields of a row, where the file holds nothing but rows of numbers: each name:type in
    order, [t:f8, w_x:f4, ...]. Types are f4, f8, or i and u of 1, 2, 4 or 8 bytes, little-endian,
    or big-endian with > before; V8: eight bytes that are passed over."""
    skip_bytes: int = 0
    """Bytes before the first such row."""
    gyro_columns: list[str] = field(default_factory=lambda: list(DEFAULT_GYRO))
    """The file's gyro columns, x, y and z. Where it has none of the default ones, names such as gx
    (deg/s), gyro_x or angular_velocity.x are found."""
    accel_columns: list[str] = field(default_factory=lambda: list(DEFAULT_ACCEL))
    """The file's accelerometer columns, x, y and z."""
    columns: list[Any] | None = None
    """All six columns instead: names, or positions counted from one."""
    time_column: Any = None
    """The time column's name or position, or [seconds, nanoseconds] of two; null: found by its
    name, if there; none: not used."""
    temperature_column: Any = None
    """Name or position of a column of the sensor's temperature, degrees Celsius or kelvin, which
    may be empty in rows between; null: none is used."""
    time_unit: str = "auto"
    """Unit of the time column, one of TIME_UNITS; auto: as the column's name says, or the one that
    makes sense."""
    gaps: str = "refuse"
    """What is done with a log with holes: refuse it, read its longest piece, split it into pieces,
    or join these as if nothing were missing. Holes of up to ten samples, one percent of all in
    total, are ignored."""
    repeats: str = "auto"
    """What is done with rows that are printed again until the sensor's next sample. auto: they are
    read at the sensor's own rate where they repeat regularly, and refused otherwise; drop: rows
    equal to the one before are left out; keep: each row is a sample."""
    from_s: float = 0.0
    """Seconds at the log's start that are left out, counted by its samples."""
    to_s: float | None = None
    """Seconds after the start from which on the rest is left out, likewise; null: none is."""
    gyro_unit: str = "rad/s"
    """Unit of the gyro columns: of a rate, or of an increment a sample (rad, deg, arcsec); auto: as
    the columns' names say, deg/s where they say nothing."""
    accel_unit: str = "m/s2"
    """Unit of the accelerometer columns: of a specific force, or of an increment a sample (m/s,
    g*s, ug*s); auto: m/s2 or g, whichever makes the log rest at 1 g."""
    gyro_scale: float = 1.0
    """Gyro units in one count of the file."""
    accel_scale: float = 1.0
    """Accelerometer units in one count of the file."""
    axes: list[str] = field(default_factory=lambda: ["x", "y", "z"])
    """Which of the file's axes point forward, right and down: [y, x, -z] for right-forward-up."""
    accel_axes: list[str] | None = None
    """The same for accelerometers whose axes or signs differ from the gyros'; null: they are the
    gyros'. Accelerometers that print +g down beside gyros [x, y, z] are [-x, -y, -z]."""
    rate_hz: float | None = None
    """Samples a second; null: from the time column or the header."""
    latitude: float | None = None
    """Latitude, degrees; null: from the header."""
    heading_deg: float | None = None
    """Reference heading of the forward axis, degrees, where the plate's angle is zero; null: from
    the header or the file's name, if there."""
    heading_column: Any = None
    """The column, by name or position, of a reference instrument's heading of the forward axis,
    degrees, which turns with the plate."""
    heading_sigma_deg: float | None = None
    """1 sigma of that reference, degrees; null: it is not known."""
    plate_column: Any = None
    """The column, by name or position, of the plate's angle at each sample's end, clockwise seen
    from above."""
    plate_unit: str = "auto"
    """Its unit, deg or rad; auto: as the column's name says, deg where it says nothing."""
    plate_scale: float = 1.0
    """Units of the plate's angle in one count of its column; negative where it counts
    counter-clockwise."""
    positions: list[list[float]] | None = None
    """Or the plate's positions, [[from_s, to_s, angle_deg], ...] in order of time, in seconds since
    the first sample; between them it turns."""
    poses: list[list[float]] | None = None
    """Or, of an IMU that was held at rest in several attitudes (estimator=tumble), when:
    [[from_s, to_s], ...] in order of time, in seconds since the first sample, each with the forward
    axis's reference heading, degrees, as a third figure where it is known; null: they are found."""
    angles_deg: list[float] | None = None
    """Or, where `path` names several files, the plate's angle in each, degrees."""
    gap_s: float | None = None
    """Time from the end of each of several files to the start of the next, s; null: by their time
    stamps, where these are of one clock that runs on."""
    unit: str | None = None
    """The name of this sensor, such as its serial number."""
    session: str | None = None
    """The name of the power-up that the log is of."""
    bias_limit_deg_per_h: float | None = None
    """The largest gyro bias that this sensor is known to have: a mean rate further from Earth's is
    refused, and estimators without a sensor model take every bias within it as equally probable.
    null: nothing is known of it."""
    most_bias_deg_per_h: float = 14.0
    """The bias above which a mean rate is refused where `bias_limit_deg_per_h` is null, since a
    wrong unit would look like one. Below 15 a unit that makes the rates too small is noticed as
    well."""
    accept: list[str] = field(default_factory=list)
    """Checks, by the names in their messages, whose refusals become notes."""

    def __post_init__(self) -> None:
        require_name("name", self.name)
        require_choice("reader", self.reader, READERS)
        _require_paths(self.files, self.angles_deg)
        self._require_plate()
        for name in ("gyro_columns", "accel_columns"):
            columns = getattr(self, name)
            require(len(set(columns)) == 3, name, columns, "must be three column names")
        require_choice("gyro_unit", self.gyro_unit, ["auto", *GYRO_UNITS])
        require_choice("accel_unit", self.accel_unit, ["auto", *ACCEL_UNITS])
        _require_columns(self.columns, self.time_column)
        require(self.skip_bytes >= 0, "skip_bytes", self.skip_bytes, "must be 0 or more")
        if self.dtype is not None:
            row_type(self.dtype, "dtype")
        _require_column("temperature_column", self.temperature_column)
        require_choice("time_unit", self.time_unit, ["auto", *TIME_UNITS])
        require_choice("gaps", self.gaps, GAPS)
        require_choice("repeats", self.repeats, REPEATS)
        require_axes("axes", self.axes)
        if self.accel_axes is None:
            right = is_right_handed(self.axes)
            require(right, "axes", self.axes, "is a mirrored frame: check the signs, or give "
                    "accel_axes as well where the gyros' signs are mirrored")  # fmt: skip
        else:
            require_axes("accel_axes", self.accel_axes)
        for name in self.accept:
            require_choice("accept", name, CHECKS)
        for name in ("gyro_scale", "accel_scale", "most_bias_deg_per_h", "bias_limit_deg_per_h"):
            require_positive(name, getattr(self, name))
        require(
            0 <= self.from_s < np.inf, "from_s", self.from_s, "must be zero or more, and finite"
        )
        if self.to_s is not None:
            good = self.from_s < self.to_s < np.inf
            require(good, "to_s", self.to_s, f"must be above from_s = {self.from_s:g}, and finite")
        if self.rate_hz is not None:
            good = 0 < self.rate_hz < np.inf
            require(good, "rate_hz", self.rate_hz, "must be greater than zero, and finite")
        if self.heading_deg is not None:
            good = abs(self.heading_deg) <= 360
            require(good, "heading_deg", self.heading_deg, "must be from -360 to 360")
        if self.latitude is not None:
            require(abs(self.latitude) <= 90, "latitude", self.latitude, "must be from -90 to 90")
        require_positive("heading_sigma_deg", self.heading_sigma_deg)
        for key in ("unit", "session"):
            if getattr(self, key) is not None:
                require_name(key, getattr(self, key))

    def _require_plate(self) -> None:
        """Raise InputError unless the plate's angles are stated in one way, or not at all."""
        keys = ("plate_column", "positions", "poses", "angles_deg")
        ways = [key for key in keys if getattr(self, key) is not None]
        about = f"and {ways[-1]} both state the plate's angles: give one" if ways else ""
        require(len(ways) < 2, ways[0] if ways else "", "given", about)
        require_choice("plate_unit", self.plate_unit, PLATE_UNITS)
        require(self.plate_scale != 0, "plate_scale", self.plate_scale, "must not be zero")
        for key in ("plate_column", "heading_column"):
            _require_column(key, getattr(self, key))
        last = 0.0
        require(self.positions != [], "positions", self.positions, "must name one, or be null")
        for own in self.positions or []:
            good = len(own) == 3 and last <= own[0] < own[1]
            about = "must be [from_s, to_s, angle_deg] each, in order of time, without overlap"
            require(good, "positions", own, about)
            last = own[1]
        last, listed = 0.0, self.poses
        about = "must name two or more, or be null"
        require(listed is None or len(listed) > 1, "poses", listed, about)
        for own in listed or []:
            good = len(own) in (2, 3) and last <= own[0] < own[1]
            good &= len(own) == len((listed or [own])[0])
            about = "must be [from_s, to_s] each, in order of time, without overlap, or all of "
            about += "them [from_s, to_s, heading_deg]"
            require(good, "poses", own, about)
            last = own[1]
        about = "is one heading, and poses have one each: poses=[[from_s, to_s, heading_deg], ...]"
        require(listed is None or self.heading_deg is None, "heading_deg", self.heading_deg, about)
        if self.gap_s is not None:
            require_not_negative(self, "gap_s")
            most = f"must be up to {_LONGEST_GAP_S:g}"
            require(self.gap_s <= _LONGEST_GAP_S, "gap_s", self.gap_s, most)
            several = self.angles_deg is not None
            require(several, "gap_s", self.gap_s, "is for several files: path=[...], angles_deg")

    @property
    def files(self) -> list[str]:
        """The log's files: several, or the one."""
        return self.path if isinstance(self.path, list) else [self.path]

    @property
    def axes_of_accel(self) -> list[str]:
        """The axes of the accelerometers: their own, or those of the gyros where none are given."""
        return self.axes if self.accel_axes is None else self.accel_axes

    @property
    def bias_limit(self) -> float | None:
        """The largest gyro bias that is known, rad/s; None where nothing is known."""
        limit = self.bias_limit_deg_per_h
        return None if limit is None else limit * DEG / HOUR

    @property
    def refuses_above(self) -> tuple[str, float]:
        """The bias, deg/h, above which a mean rate is refused, after the key that states it."""
        if self.bias_limit_deg_per_h is not None:
            return "log.bias_limit_deg_per_h", self.bias_limit_deg_per_h
        return "log.most_bias_deg_per_h", self.most_bias_deg_per_h


def row_type(fields: list[str], key: str = "log.dtype") -> np.dtype:
    """The NumPy type of a row whose fields are name:type each. Raises InputError, naming `key`,
    where they are not."""
    found: list[tuple[str, str]] = []
    for own in fields:
        name, _, kind = own.rpartition(":")
        order, bare = ("<", kind) if kind[:1] not in ("<", ">") else (kind[0], kind[1:])
        good = bare in _ROW_TYPES or _PASSED_OVER.fullmatch(bare) is not None
        about = "is no name:type, such as w_x:f4; the types are f4, f8, i or u with 1, 2, 4 or 8, "
        about += "after > where they are big-endian, and V with bytes that are passed over"
        require(bool(name.strip()) and good, key, own, about)
        found.append((name.strip(), bare if bare[0] == "V" else order + bare))
    names = [name for name, _ in found]
    twice = len(set(names)) < len(names)
    require(bool(names) and not twice, key, fields, "must be fields of different names")
    return np.dtype(found)


def _require_columns(columns: list[Any] | None, time: Any) -> None:
    """Raise InputError unless columns are names, or positions counted from one."""
    if columns is not None:
        six = len(columns) == 6 and len(set(map(str, columns))) == 6
        require(six, "columns", columns, "must be six: gyro x, y, z, accelerometer x, y, z")
    times = time if isinstance(time, list) else [] if time is None else [time]
    good = isinstance(time, list) is (len(times) == 2)
    require(good, "time_column", time, "must be one column, or [seconds, nanoseconds]")
    for key, given in (("columns", columns or []), ("time_column", times)):
        for name in given:
            _require_column(key, name)


def _require_column(key: str, name: Any) -> None:
    """Raise InputError unless a column is a name, a position counted from one, or not given."""
    known = name is None or isinstance(name, str) or (type(name) is int and name > 0)
    require(known, key, name, "must be a name, or a position counted from one")


def _require_paths(files: list[str], angles: list[float] | None) -> None:
    """Raise InputError unless files are named, once each and with an angle each where there are
    any."""
    require(bool(files) and all(files), "path", files, "must name a file")
    require(len(set(files)) == len(files), "path", files, "names a file twice")
    about = f"must be {len(files)}, one for each file of path"
    require(angles is None or len(angles) == len(files), "angles_deg", angles, about)
