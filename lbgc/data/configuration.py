"""The configuration of a dataset: what a generation is told, and what a finished dataset says of
itself, held by one and the same checks."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from lbgc.data.documents import Layout
from lbgc.data.record import whole_multiple
from lbgc.data.vetting import MOST_RECORDINGS, MOST_SAMPLES
from lbgc.errors import build, require, require_choice, require_not_negative, require_positive
from lbgc.protocol import ProtocolConfig, plan
from lbgc.sensor.datasheet import ImuConfig


@dataclass(frozen=True)
class DatasetConfig:
    """The configuration of a dataset, but for the bench."""

    latitude: float = 32.76
    """Latitude, degrees, north positive"""
    height_m: float = 0.0
    """Height above the ellipsoid, with which gravity decreases."""
    rate_hz: float = 600.0
    """Samples a second of the IMU."""
    duration_s: float = 240.0
    """Duration of each recording."""
    recordings: int = 80
    """Number of recordings in the dataset."""
    seed: int = 1
    """Seed from which the recordings are drawn."""
    unit_seed: int = 4
    """Seed from which the units' sensors are drawn."""
    units: int = 1
    """Number of units (serial numbers), to which recordings are assigned in turn."""
    sessions: int = 1
    """Number of sessions (power-ups) of each unit, to which its recordings are assigned in turn."""
    split: list[int] = field(default_factory=lambda: [70, 10, 20])
    """Shares of training, validation and test."""
    split_by: str = "recording"
    """recording, session or unit, of which none is in two parts of the split."""
    output: str = "samples"
    """samples: every sample; means: block means over mean_s."""
    mean_s: float = 5.0
    """Length of the blocks for output=means."""
    imu: ImuConfig = field(default_factory=ImuConfig)
    """The sensor."""
    protocol: ProtocolConfig = field(default_factory=ProtocolConfig)
    """What the plate is commanded to do."""

    def __post_init__(self) -> None:
        require(abs(self.latitude) <= 90, "latitude", self.latitude, "must be from -90 to 90")
        require_height(self.height_m)
        counts = ("recordings", "units", "sessions")
        for name in ("rate_hz", "duration_s", "mean_s", *counts):
            require_positive(name, getattr(self, name))
        for name in counts:
            number, most = getattr(self, name), f"must be {MOST_RECORDINGS} at most"
            require(number <= MOST_RECORDINGS, name, number, most)
        require_not_negative(self, "seed", "unit_seed")
        require_choice("output", self.output, ("samples", "means"))
        require_choice("split_by", self.split_by, ("recording", "session", "unit"))
        good = len(self.split) == 3 and min(self.split) >= 0 and 0 < sum(self.split) <= _SHARES
        what = f"must be three shares, like [70, 10, 20], {_SHARES} together at most"
        require(good, "split", self.split, what)
        self._check_lengths()
        self._check_means()
        plan(self.protocol, 0, self.duration_s)

    def _check_means(self) -> None:
        """Raise InputError where means are asked for and samples have timing errors, which means
        cannot represent."""
        timing = self.imu.timing
        for name, value in vars(timing).items():
            require(
                self.output == "samples" or value == 0,
                f"imu.timing.{name}",
                value,
                "is of samples; use output=samples, or 0 here",
            )

    def _check_lengths(self) -> None:
        """Raise InputError unless recordings are whole samples, not too many, and means whole
        samples that divide a recording."""
        require(
            whole_multiple(self.rate_hz, 1 / self.duration_s) is not None,
            "duration_s",
            self.duration_s,
            f"must be a whole number of samples at {self.rate_hz:g} Hz",
        )
        most = f"must be {MOST_SAMPLES / self.rate_hz:g} at most at {self.rate_hz:g} Hz"
        require(self.samples <= MOST_SAMPLES, "duration_s", self.duration_s,
                f"{most}, {MOST_SAMPLES} samples a recording")  # fmt: skip
        if self.output == "means":
            block = whole_multiple(self.rate_hz, 1 / self.mean_s)
            fits = block is not None and self.samples % block == 0
            require(
                fits,
                "mean_s",
                self.mean_s,
                f"must be whole samples at {self.rate_hz:g} Hz, and divide {self.duration_s:g} s",
            )

    @property
    def samples(self) -> int:
        """The number of the sensor's samples in a recording."""
        return round(self.duration_s * self.rate_hz)

    @property
    def block(self) -> int:
        """The number of samples in a stored value."""
        return round(self.mean_s * self.rate_hz) if self.output == "means" else 1


def require_height(height_m: float) -> None:
    """Raise InputError unless this is a height at which somebody may measure."""
    low, high = -12_000.0, 100_000.0
    where = f"must be from {low:g} to {high:g}"
    require(low <= height_m <= high, "height_m", height_m, where)


_SHARES = 1_000_000
"""Largest sum of the shares of the split, which is dealt in blocks of that many."""


@dataclass(frozen=True)
class _Sway:
    """What is read of a scene's vehicle."""

    level: float | list[float]
    """0 where there is none"""


@dataclass(frozen=True)
class _Bench:
    """What is read of a stored scene; its other keys are the bench's own (`sim/turntable.py`)."""

    arm_m: float
    axis_tilt_deg: float
    axis_wobble_arcsec: float
    reference_error_deg: float
    sway: _Sway

    @classmethod
    def adopted(cls, scene: Mapping[str, Any]) -> dict[str, Any]:
        """The keys that are read, of all that a scene has."""
        found = {own.name: scene[own.name] for own in fields(cls) if own.name in scene}
        sway = found.get("sway")
        if isinstance(sway, Mapping):
            found["sway"] = {k: v for k, v in sway.items() if k == "level"}
        return found

    def __post_init__(self) -> None:
        require_not_negative(self, "arm_m", "axis_wobble_arcsec", "reference_error_deg")


@dataclass(frozen=True)
class _Stored(DatasetConfig):
    """A configuration as a dataset has it."""

    scene: _Bench = field(kw_only=True)
    calibration: str | None = None
    """The checksum of the file from which its units were drawn; null: the sensor's law"""


def check(said: Mapping[str, Any], layout: Layout) -> None:
    """Hold a stored configuration against all that a command line is held against, and against the
    dataset's own shape. Raises InputError, naming what is not as it must be."""
    config = build(_Stored, said)
    values = layout.samples, layout.rate_hz
    require(config.recordings == layout.recordings, "recordings", config.recordings,
            f"but the dataset has {layout.recordings}")  # fmt: skip
    alike = (config.samples // config.block, config.rate_hz / config.block) == values
    require(alike, "rate_hz", config.rate_hz, "is not that of the dataset's values")
