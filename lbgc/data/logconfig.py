"""What a user says of a log: where it is, how it is laid out, its units and axes."""

from dataclasses import dataclass, field

import numpy as np

from lbgc.data.axes import is_right_handed, require_axes
from lbgc.data.findings import CHECKS
from lbgc.errors import require, require_choice, require_positive
from lbgc.units import ANGLE_UNITS, FORCE_UNITS, RATE_UNITS, VELOCITY_UNITS

GYRO_UNITS = RATE_UNITS | ANGLE_UNITS
ACCEL_UNITS = FORCE_UNITS | VELOCITY_UNITS
READERS = ("table", "recordings", "psins")


@dataclass(frozen=True)
class LogConfig:
    """A log, what `conf/log/*.yaml` holds."""

    name: str = "log"
    """How reports call it."""
    reader: str = "table"
    """table: CSV or Parquet with named columns. recordings: a directory of CSV files
    `x_<heading>.csv`, or one of them. psins: a PSINS .imu file, whose header says the rest."""
    path: str = ""
    """The file; if it is not there, it is looked for under $LBGC_REAL_LOGS."""
    gyro_columns: list[str] = field(default_factory=lambda: ["w_x", "w_y", "w_z"])
    """The file's x, y and z."""
    accel_columns: list[str] = field(default_factory=lambda: ["f_x", "f_y", "f_z"])
    """The file's x, y and z."""
    time_column: str | None = None
    """Seconds; null where the file has none."""
    gyro_unit: str = "rad/s"
    """Of a rate, or of an increment a sample (rad, deg, arcsec)."""
    accel_unit: str = "m/s2"
    """Of a specific force, or of an increment a sample (m/s, g*s, ug*s); auto: m/s2 or g,
    whichever makes the log rest at 1 g."""
    gyro_scale: float = 1.0
    """Units a count."""
    accel_scale: float = 1.0
    """Units a count."""
    axes: list[str] = field(default_factory=lambda: ["x", "y", "z"])
    """Which of the file's axes point forward, right and down: [y, x, -z] for right-forward-up."""
    accel_axes: list[str] | None = None
    """The same of accelerometers whose axes or sign are not the gyros'; null: they are the gyros'.
    Accelerometers that print +g down beside gyros [x, y, z] are [-x, -y, -z]."""
    rate_hz: float | None = None
    """Samples a second; null: from the time column or the header."""
    latitude: float | None = None
    """degrees; null: from the header"""
    heading_deg: float | None = None
    """Reference heading of the forward axis; null: from the header or the file's name, if there."""
    bias_limit_deg_per_h: float = 14.0
    """Largest gyro bias this sensor can have: a mean rate further from Earth's is refused. Below
    15 a unit that makes the rates too small is seen as well."""
    accept: list[str] = field(default_factory=list)
    """Checks, by the names that their messages give, whose refusals become notes."""

    def __post_init__(self) -> None:
        require_choice("reader", self.reader, READERS)
        require(bool(self.path), "path", self.path, "must name a file")
        for name in ("gyro_columns", "accel_columns"):
            columns = getattr(self, name)
            require(len(set(columns)) == 3, name, columns, "must be three column names")
        require_choice("gyro_unit", self.gyro_unit, list(GYRO_UNITS))
        require_choice("accel_unit", self.accel_unit, ["auto", *ACCEL_UNITS])
        require_axes("axes", self.axes)
        if self.accel_axes is None:
            right = is_right_handed(self.axes)
            require(right, "axes", self.axes, "is a mirrored frame: check the signs, or give "
                    "accel_axes as well where the gyros' signs are mirrored")  # fmt: skip
        else:
            require_axes("accel_axes", self.accel_axes)
        for name in self.accept:
            require_choice("accept", name, CHECKS)
        for name in ("gyro_scale", "accel_scale", "bias_limit_deg_per_h"):
            require_positive(name, getattr(self, name))
        if self.rate_hz is not None:
            good = 0 < self.rate_hz < np.inf
            require(good, "rate_hz", self.rate_hz, "must be greater than zero, and finite")
        if self.heading_deg is not None:
            good = abs(self.heading_deg) <= 360
            require(good, "heading_deg", self.heading_deg, "must be from -360 to 360")
        if self.latitude is not None:
            require(abs(self.latitude) <= 90, "latitude", self.latitude, "must be from -90 to 90")
