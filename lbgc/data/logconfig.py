"""The configuration of a log: where its file is, how that is laid out, its units and axes."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lbgc.data.checks.findings import CHECKS
from lbgc.data.readers.axes import matrix_of, require_axes
from lbgc.data.readers.clock import TIME_UNITS
from lbgc.data.readers.said import (
    require_column,
    require_columns,
    require_paths,
    require_rows,
    require_spans,
    row_type,
)
from lbgc.errors import (
    require,
    require_choice,
    require_name,
    require_not_negative,
    require_positive,
)
from lbgc.frames import AXES, DOWN
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
NONE = "none"
"""The value of a key of columns with which none is read."""


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
    gyro_columns: str | list[Any] = field(default_factory=lambda: list(DEFAULT_GYRO))
    """The file's gyro columns, x, y and z, by name or position. Where it has none of the default
    ones, names such as gx (deg/s), gyro_x or angular_velocity.x are found. none: no gyros were
    recorded, and noise alone is fitted. Without accelerometers also one or two columns, of a gyro
    of so many axes: its noise is fitted along its own axes."""
    accel_columns: str | list[Any] = field(default_factory=lambda: list(DEFAULT_ACCEL))
    """The file's accelerometer columns, x, y and z; none: none were recorded, likewise."""
    columns: list[Any] | None = None
    """All six columns instead: names, or positions counted from one."""
    time_column: Any = None
    """The time column's name or position, or [seconds, nanoseconds] of two; null: found by its
    name, if there; none: not used."""
    gyro_rows: list[Any] | None = None
    """[column, value]: the gyros' rows are those in which this column has this value, where several
    sensors write to one table; so are the accelerometers' unless `accel_rows` is given."""
    accel_rows: list[Any] | None = None
    """The accelerometers' rows, likewise."""
    accel_path: str | list[str] | None = None
    """The file of the accelerometers, where it is another than the gyros'; or several, one for each
    of `path`. Clocks that differ are put on one another by their stamps: the faster triad is
    averaged over the slower one's intervals, and times count from where both have begun. A fit
    takes each triad's own samples."""
    accel_table: str | None = None
    """The table of the accelerometers, of that file or of the gyros' own; null: as `table`."""
    accel_time_column: Any = None
    """The time column of the accelerometers' table; null: as `time_column`."""
    accel_late_s: float = 0.0
    """Seconds by which the accelerometers' stamps are late against the gyros': they are subtracted,
    where the two clocks differ by a known time."""
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
    leave_out: list[list[float]] = field(default_factory=list)
    """Times to leave out, [[from_s, to_s], ...] in order, likewise: a knock, somebody at the bench.
    Of the pieces between them the longest is read, each where `gaps` is split, or all as one
    where it is join, except on two clocks."""
    rows: list[Any] | None = None
    """The first and the last row that are read, counted from one: [first, last], or [first, null];
    null: all are."""
    gyro_unit: str = "rad/s"
    """Unit of the gyro columns: of a rate, or of an increment a sample (rad, deg, arcsec); auto: as
    the columns' names say, deg/s where they say nothing."""
    accel_unit: str = "m/s2"
    """Unit of the accelerometer columns: of a specific force, or of an increment a sample (m/s,
    g*s, ug*s); auto: m/s2 or g, whichever makes the log rest at 1 g."""
    gyro_scale: float | list[float] = 1.0
    """Gyro units in one count of the file, or one for each of the file's axes x, y and z; negative
    where it counts the other way: value = scale (count - offset)."""
    accel_scale: float | list[float] = 1.0
    """Accelerometer units in one count of the file, likewise."""
    gyro_offset: float | list[float] = 0.0
    """What the gyro columns print where the rate is zero, in counts of the file, or one an axis."""
    accel_offset: float | list[float] = 0.0
    """What the accelerometer columns print where the force is zero, likewise."""
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
    degrees, which turns with the plate; about a level axis it counts where the angle is zero."""
    heading_sigma_deg: float | None = None
    """1 sigma of that reference, degrees; null: it is not known."""
    plate_column: Any = None
    """The column, by name or position, of the plate's angle at each sample's end, by the right-hand
    rule: about down, clockwise seen from above."""
    plate_unit: str = "auto"
    """Its unit, deg or rad; auto: as the column's name says, deg where it says nothing."""
    plate_scale: float = 1.0
    """Units of the plate's angle in one count of its column; negative where it counts
    counter-clockwise."""
    plate_axis: str = "down"
    """The body's axis about which the plate turns: forward, right or down. About a level one the
    body is level at angle zero."""
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
        require_paths(self.files, self.angles_deg)
        self._require_plate()
        self._require_triads()
        require_choice("gyro_unit", self.gyro_unit, ["auto", *GYRO_UNITS])
        require_choice("accel_unit", self.accel_unit, ["auto", *ACCEL_UNITS])
        require_columns(self.columns, self.time_column)
        require(self.skip_bytes >= 0, "skip_bytes", self.skip_bytes, "must be 0 or more")
        if self.dtype is not None:
            row_type(self.dtype, "dtype")
        require_column("temperature_column", self.temperature_column)
        require_choice("time_unit", self.time_unit, ["auto", *TIME_UNITS])
        require_choice("gaps", self.gaps, GAPS)
        require_choice("repeats", self.repeats, REPEATS)
        self._require_frame()
        for name in self.accept:
            require_choice("accept", name, CHECKS)
        for name in ("most_bias_deg_per_h", "bias_limit_deg_per_h"):
            require_positive(name, getattr(self, name))
        require(
            0 <= self.from_s < np.inf, "from_s", self.from_s, "must be zero or more, and finite"
        )
        if self.to_s is not None:
            good = self.from_s < self.to_s < np.inf
            require(good, "to_s", self.to_s, f"must be above from_s = {self.from_s:g}, and finite")
        require_spans("leave_out", self.leave_out, "[from_s, to_s]")
        require_rows(self.rows)
        require_positive("rate_hz", self.rate_hz)
        if self.heading_deg is not None:
            good = abs(self.heading_deg) <= 360
            require(good, "heading_deg", self.heading_deg, "must be from -360 to 360")
        if self.latitude is not None:
            require(abs(self.latitude) <= 90, "latitude", self.latitude, "must be from -90 to 90")
        require_positive("heading_sigma_deg", self.heading_sigma_deg)
        for key in ("unit", "session"):
            if getattr(self, key) is not None:
                require_name(key, getattr(self, key))

    def _require_triads(self) -> None:
        """Raise InputError unless the triads' columns, scales and files are stated so that they can
        be meant."""
        for name in ("gyro_columns", "accel_columns"):
            columns = getattr(self, name)
            alone = name == "gyro_columns" and self.recorded == ("gyro",)
            few = (1, 2, 3) if alone else (3,)
            each = columns if isinstance(columns, list) else []
            three = len(each) == len(set(map(str, each))) and len(each) in few
            about = f"must be three column names or positions, x, y and z, or {NONE}"
            about += "; one or two are for gyros alone, accel_columns=none" if len(each) < 3 else ""
            require(three or columns == NONE, name, columns, about)
            for column in columns if isinstance(columns, list) else []:
                require_column(name, column)
        about = "and gyro_columns are both none: nothing is left to read"
        require(bool(self.recorded), "accel_columns", NONE, about)
        for name in ("gyro_scale", "accel_scale", "gyro_offset", "accel_offset"):
            value = getattr(self, name)
            each = value if isinstance(value, list) else [value] * 3
            width = self._width(name)
            about = "must be one number, or "
            about += "three: x, y, z" if width == len(AXES) else f"{width}, one for each column"
            require(each != value or len(each) == width, name, value, about)
            good = name.endswith("offset") or all(own != 0 for own in each)
            require(good, name, value, "must not be zero")
        both = len(self.recorded) == 2
        about = "has both triads in each row: the key is for another reader"
        require(both or self.reader != "psins", "reader", self.reader, about)
        about = "leaves one triad: give the other by gyro_columns=[...] or accel_columns=[...]"
        require(both or self.columns is None, "columns", self.columns, about)
        for name in ("gyro_rows", "accel_rows"):
            value = getattr(self, name)
            plain = value is None or (len(value) == 2 and not isinstance(value[1], list | dict))
            require(plain, name, value, "must be [column, value]")
            require_column(name, None if value is None else value[0])
        about = "needs gyro_rows as well, where gyros are in other rows of the same table"
        own_table = self.accel_path is not None or self.accel_table is not None
        whose = self.accel_rows is None or not both or own_table or self.gyro_rows is not None
        require(whose, "accel_rows", self.accel_rows, about)
        if not self.accel_is_apart:
            about = "is for accelerometers of another file, table or row: accel_path, accel_table"
            for name in ("accel_time_column", "accel_late_s"):
                require(not getattr(self, name), name, getattr(self, name), about)
            return
        keys = ("accel_path", "accel_table", "accel_rows")
        key = next(own for own in keys if getattr(self, own) is not None)
        value = getattr(self, key)
        require(both, key, value, "is of a triad whose columns are none")
        require(self.reader == "table", key, value, "is for the reader table")
        about = "and columns: give gyro_columns and accel_columns, each of its own table"
        require(self.columns is None, key, value, about)
        if self.accel_path is not None:
            several = self.accel_path if isinstance(self.accel_path, list) else [self.accel_path]
            good = len(several) == len(self.files) and all(several)
            require(good, key, value, f"must name {len(self.files)}, one for each file of path")
        require_columns(None, self.accel_time_column, "accel_time_column")

    def _require_frame(self) -> None:
        """Raise InputError unless the axes, with the signs of the scales, make a right-handed frame
        where both triads are stated to have the same."""
        require_axes("axes", self.axes)
        if self.accel_axes is not None:
            require_axes("accel_axes", self.accel_axes)
        signs = [np.sign(self.each(own, "scale")) for own in ("gyro", "accel")]
        if len(signs[0]) < len(AXES):
            return
        if self.accel_axes is not None or np.any(signs[0] != signs[1]):
            return
        right = np.linalg.det(matrix_of(self.axes)) * signs[0].prod() > 0
        by = " with the signs of gyro_scale and accel_scale" if np.any(signs[0] < 0) else ""
        about = f"is a mirrored frame{by}: check the signs, or give accel_axes as well where the "
        require(bool(right), "axes", self.axes, about + "gyros' signs are mirrored")

    def _require_poses(self) -> None:
        """Raise InputError unless the poses are listed in one form, or not at all."""
        listed = self.poses
        about = "must name two or more, or be null"
        require(listed is None or len(listed) > 1, "poses", listed, about)
        if listed is None:
            return
        form = "[from_s, to_s, heading_deg]" if len(listed[0]) == 3 else "[from_s, to_s]"
        require_spans("poses", listed, form)
        about = "is one heading, and poses have one each: poses=[[from_s, to_s, heading_deg], ...]"
        require(self.heading_deg is None, "heading_deg", self.heading_deg, about)

    def _require_plate(self) -> None:
        """Raise InputError unless the plate's angles are stated in one way, or not at all."""
        keys = ("plate_column", "positions", "poses", "angles_deg")
        ways = [key for key in keys if getattr(self, key) is not None]
        about = f"and {ways[-1]} both state the plate's angles: give one" if ways else ""
        require(len(ways) < 2, ways[0] if ways else "", "given", about)
        require_choice("plate_unit", self.plate_unit, PLATE_UNITS)
        require_choice("plate_axis", self.plate_axis, AXES)
        meant = bool(ways) or self.plate_axis == AXES[DOWN]
        about = "needs the plate's angles: plate_column, positions, or angles_deg"
        require(meant, "plate_axis", self.plate_axis, about)
        require(self.plate_scale != 0, "plate_scale", self.plate_scale, "must not be zero")
        for key in ("plate_column", "heading_column"):
            require_column(key, getattr(self, key))
        require(self.positions != [], "positions", self.positions, "must name one, or be null")
        require_spans("positions", self.positions or [], "[from_s, to_s, angle_deg]")
        self._require_poses()
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
    def each_file(self) -> "list[LogConfig]":
        """The description of each of the log's files."""
        other = self.accel_path if isinstance(self.accel_path, list) else [self.accel_path]
        return [
            replace(self, path=own, accel_path=other[at % len(other)])
            for at, own in enumerate(self.files)
        ]

    @property
    def recorded(self) -> tuple[str, ...]:
        """The triads that were recorded: gyro, accel, or one of them."""
        return tuple(p for p in ("gyro", "accel") if getattr(self, f"{p}_columns") != NONE)

    @property
    def accel_is_apart(self) -> bool:
        """Whether the accelerometers are of a file or table of their own."""
        others = self.accel_path, self.accel_table
        rows = self.accel_rows if len(self.recorded) == 2 else None
        return any(own is not None for own in (*others, rows))

    def each(self, part: str, key: str) -> np.ndarray:
        """A triad's scale or offset for each of the file's axes, (3,), or those that there are."""
        value = np.asarray(getattr(self, f"{part}_{key}"), float)
        return np.broadcast_to(value, (self._width(part),))

    def _width(self, part: str) -> int:
        """The number of axes of a triad, by the beginning of a key's name."""
        columns = self.gyro_columns if part.startswith("gyro") else self.accel_columns
        return len(columns) if isinstance(columns, list) else 3

    def counted(self, part: str, values: np.ndarray) -> np.ndarray:
        """A triad's values (T, 3), or (T, 0), as printed, in their unit: in their own place."""
        if values.shape[1]:
            values -= self.each(part, "offset")
            values *= self.each(part, "scale")
        return values

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
