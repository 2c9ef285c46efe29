"""Logs as people have them, made at random: any separator, header, unit, frame, rate and clock; and
whether the log doctor describes them right."""

import io
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lbgc.data.logconfig import LogConfig
from lbgc.data.logs import read
from lbgc.data.looking.doctor import Look, looked
from lbgc.data.readers.axes import matrix_of
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.units import DEG, FORCE_UNITS, HOUR, RATE_UNITS

FRAMES = {
    "forward-right-down": ["x", "y", "z"],
    "forward-left-up": ["x", "-y", "-z"],
    "right-forward-up": ["y", "x", "-z"],
    "x up": ["z", "y", "-x"],
    "y down": ["x", "-z", "y"],
}
"""Which of the file's axes point forward, right and down."""
STYLES = {
    "(unit)": ("g{axis} ({unit})", "a{axis} ({unit})"),
    "[unit]": ("Gyro_{AXIS} [{unit}]", "Acc_{AXIS} [{unit}]"),
    "ros": ("angular_velocity.{axis}", "linear_acceleration.{axis}"),
    "plain": ("gyro_{axis}", "accel_{axis}"),
    "short": ("w{axis}", "f{axis}"),
    "none": ("", ""),
}
TIMES = {
    "s": ("t", 1.0), "time (s)": ("Time (s)", 1.0), "ms": ("timestamp_ms", 1e3),
    "us": ("Timestamp [us]", 1e6), "ns": ("timestamp", 1e9), "epoch": ("time", 1.0),
    "none": (None, 1.0), "comment": (None, 1.0),
}  # fmt: skip


@dataclass(frozen=True)
class Made:
    """A log that was made, and what is true of it."""

    path: Path
    rate_hz: float
    latitude: float
    """deg"""
    frame: str
    gyro: np.ndarray
    """(T, 3), rad/s, along the file's axes; as printed, so rounded"""
    accel: np.ndarray
    """(T, 3), m/s^2, specific force along the file's axes"""
    bias_deg_per_h: float
    named: bool
    """Whether the header states the gyros' unit"""
    gyro_unit: str
    timed: bool
    """Whether the file states its rate"""
    printed_down: bool
    """Whether accelerometers print +1 g down"""
    moved_s: float
    """Seconds at the start in which it is handled"""
    options: dict[str, str] = field(default_factory=dict)
    """What was drawn, for messages"""

    @property
    def is_decidable(self) -> bool:
        """Whether anybody could tell all of it from the file and the latitude: a rate is stated,
        the unit is stated or Earth's rate seen, and Earth's rate along the vertical as well."""
        seen = self.bias_deg_per_h < 2
        along = EARTH_RATE * abs(np.sin(self.latitude * DEG)) * HOUR / DEG
        return self.timed and (self.named or seen) and self.bias_deg_per_h < along / 2

    def truth(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean rate, rad/s, and mean force, m/s^2, (3,) each, forward-right-down, where the file's
        x is forward or, where that is vertical, its z; after the handling."""
        down = matrix_of(FRAMES[self.frame])[2]
        forward = np.eye(3)[0 if not down[0] else 2]
        matrix = np.array([forward, np.cross(down, forward), down])
        first = int((self.moved_s + 5) * self.rate_hz) if self.moved_s else 0
        return matrix @ self.gyro[first:].mean(0), matrix @ self.accel[first:].mean(0)


def make(directory: Path, number: int, seed: int = 1) -> Made:
    """Write log `number` of a seed into a directory."""
    rng = np.random.default_rng([seed, number])
    rate = float(rng.choice([20.0, 50.0, 100.0, 200.0, 99.983, 104.1667]))
    seconds = float(rng.uniform(100, 300))
    count = int(rate * seconds)
    latitude = float(rng.uniform(15, 65) * rng.choice([-1, 1]))
    small = rng.random() < 0.75
    bias = float(10 ** rng.uniform(-1, 0.3)) if small else float(10 ** rng.uniform(1.3, 3.3))
    walk = float(10 ** rng.uniform(-2, -0.7)) if small else float(10 ** rng.uniform(-0.7, -0.3))
    frame = str(rng.choice(list(FRAMES)))
    style = str(rng.choice(list(STYLES)))
    states = "unit" in style
    gyro_unit = str(rng.choice(["deg/s", "rad/s", "deg/h"] if states else ["deg/s", "rad/s"]))
    accel_unit = str(rng.choice(["m/s2", "g", "mg"]))
    gyro, accel = _felt(rng, count, rate, latitude, FRAMES[frame], bias, walk)
    moved = float(rng.uniform(5, 20)) if rng.random() < 0.2 else 0.0
    _handled(rng, gyro, accel, round(moved * rate), rate)
    sign = -1.0 if rng.random() < 0.15 else 1.0
    columns = [gyro / RATE_UNITS[gyro_unit], sign * accel / FORCE_UNITS[accel_unit]]
    printed = [np.array([f"{v:.8g}" for v in c.ravel()]).reshape(c.shape) for c in columns]
    own = [RATE_UNITS[gyro_unit] * printed[0].astype(float),
           sign * FORCE_UNITS[accel_unit] * printed[1].astype(float)]  # fmt: skip
    clock = str(rng.choice(list(TIMES)))
    text = _text(rng, printed, style, clock, rate, (gyro_unit, accel_unit))
    path = directory / f"log_{number}.{rng.choice(['csv', 'txt', 'dat'])}"
    path.write_bytes(text)
    return Made(
        path, rate, latitude, frame, own[0], own[1], bias, states, gyro_unit, clock != "none",
        sign < 0, moved, {"style": style, "clock": clock, "accel": accel_unit},
    )  # fmt: skip


def _felt(
    rng: np.random.Generator,
    count: int,
    rate: float,
    latitude: float,
    axes: list[str],
    bias: float,
    walk: float,
) -> tuple[np.ndarray, np.ndarray]:
    """What a resting IMU feels along the file's axes, rad/s and m/s^2."""
    heading, phi = rng.uniform(0, 2 * np.pi), latitude * DEG
    rate_ned = EARTH_RATE * np.array(
        [np.cos(phi) * np.cos(heading), -np.cos(phi) * np.sin(heading), -np.sin(phi)]
    )
    force_ned = np.array([0.0, 0.0, -normal_gravity(phi)])
    roll, pitch = rng.normal(0, 0.5 * DEG, 2)
    lean = np.array([[1, 0, -pitch], [0, 1, roll], [pitch, -roll, 1]])
    matrix = matrix_of(axes).T @ lean
    offset = rng.normal(size=3)
    offset *= bias * DEG / HOUR / np.linalg.norm(offset)
    gyro = (
        matrix @ rate_ned + offset + walk * DEG / 60 * np.sqrt(rate) * rng.normal(size=(count, 3))
    )
    accel = matrix @ force_ned + 1e-3 * rng.normal(size=3)
    return gyro, accel + 50e-6 * 9.8 * np.sqrt(rate) * rng.normal(size=(count, 3))


def _handled(
    rng: np.random.Generator, gyro: np.ndarray, accel: np.ndarray, count: int, rate: float
) -> None:
    """Let it be handled for so many samples at the start, in place."""
    t = np.arange(count)[:, None] / rate
    gyro[:count] += 0.3 * np.sin(2 * np.pi * rng.uniform(0.3, 1, 3) * t + rng.uniform(0, 6, 3))
    accel[:count] += 0.8 * np.sin(2 * np.pi * rng.uniform(0.3, 1, 3) * t + rng.uniform(0, 6, 3))


def _text(
    rng: np.random.Generator,
    printed: list[np.ndarray],
    style: str,
    clock: str,
    rate: float,
    units: tuple[str, str],
) -> bytes:
    """The file: rows with or without header, clock, other columns and comments."""
    count = len(printed[0])
    order = [0, 1] if rng.random() < 0.7 else [1, 0]
    names, columns = [], []
    name, scale = TIMES[clock]
    if name is not None:
        start = {"epoch": 1.7e9, "ns": 1.7e18}.get(clock, 0.0)
        seconds = np.arange(count) / rate
        if scale > 1:
            whole = int(start) + np.round(seconds * scale).astype(np.int64)
            columns.append(whole.astype(str))
        else:
            columns.append(np.array([f"{start + v:.6f}" for v in seconds]))
        names.append(name)
    for which in order:
        for at, axis in enumerate("xyz"):
            names.append(
                STYLES[style][which].format(axis=axis, AXIS=axis.upper(), unit=units[which])
            )
            columns.append(printed[which][:, at])
    if rng.random() < 0.3:
        names.append("Temperature (C)")
        warm = 31 + 0.2 * np.sin(np.arange(count) / count * 3) + 0.01 * rng.normal(size=count)
        columns.append(np.array([f"{v:.3f}" for v in warm]))
    if style != "none" and rng.random() < 0.2:
        names.insert(0, "counter")
        columns.insert(0, np.arange(count).astype(str))
    separator = str(rng.choice([",", ";", "\t", " ", ",", ";"]))
    comma = separator in ";\t" and rng.random() < 0.5
    out = io.StringIO()
    if clock == "comment":
        out.write(f"# recorded somewhere\n# Sample rate: {rate:g} Hz\n")
    elif rng.random() < 0.2:
        out.write("# exported by a logger\n")
    if style != "none":
        header = [n.replace(" ", "_") if separator == " " else n for n in names]
        out.write(separator.join(header) + "\n")
    for row in zip(*columns, strict=True):
        line = separator.join(row)
        out.write((line.replace(".", ",") if comma else line) + "\n")
    text = out.getvalue()
    if rng.random() < 0.1:
        return text.encode("utf-16")
    return (text.replace("\n", "\r\n") if rng.random() < 0.3 else text).encode()


def judged(made: Made) -> tuple[str, Look]:
    """Whether the doctor, told the latitude alone, is right, asks, or is wrong without asking."""
    look = looked(made.path, {"latitude": made.latitude})
    if look.refusal is not None:
        return "refused", look
    if look.asks:
        return "asked", look
    (record,) = read(LogConfig(**look.keys))
    rate, force = made.truth()
    near = 0.02 * np.linalg.norm(rate) + 6 * record.gyro.std() / np.sqrt(len(record.gyro))
    right = (
        abs(record.rate_hz / made.rate_hz - 1) < 1e-3
        and np.linalg.norm(record.gyro.mean(0) - rate) < near
        and np.linalg.norm(record.accel.mean(0) - force) < 0.02
    )
    return "right" if right else "wrong", look
