"""The configuration of a dataset to be generated, which `conf/generate.yaml` holds."""

from dataclasses import asdict, dataclass, field

from lbgc.data.record import whole_multiple
from lbgc.errors import require, require_choice, require_not_negative, require_positive
from lbgc.protocol import ProtocolConfig, plan
from lbgc.sensor.datasheet import ImuConfig

from .cluster import ClusterConfig
from .poses import Bench
from .turntable import SceneConfig


@dataclass(frozen=True)
class GenerateConfig:
    """The configuration of a dataset to be generated, which `conf/generate.yaml` holds."""

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
    out: str | None = None
    """The dataset's path, or an fsspec URL; null: outputs/generate/<hash>/dataset.zarr."""
    cluster: ClusterConfig = field(default_factory=ClusterConfig)
    """The workers that make the shards. The dataset does not depend on them."""
    imu: ImuConfig = field(default_factory=ImuConfig)
    """The sensor."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    """The bench."""
    protocol: ProtocolConfig = field(default_factory=ProtocolConfig)
    """What the plate is commanded to do."""

    def __post_init__(self) -> None:
        require(abs(self.latitude) <= 90, "latitude", self.latitude, "must be from -90 to 90")
        low, high = -12_000.0, 100_000.0
        where = f"must be from {low:g} to {high:g}"
        require(low <= self.height_m <= high, "height_m", self.height_m, where)
        for name in ("rate_hz", "duration_s", "mean_s", "recordings", "units", "sessions"):
            require_positive(name, getattr(self, name))
        require_not_negative(self, "seed", "unit_seed")
        require_choice("output", self.output, ("samples", "means"))
        require_choice("split_by", self.split_by, ("recording", "session", "unit"))
        good = len(self.split) == 3 and min(self.split) >= 0 and sum(self.split) > 0
        require(good, "split", self.split, "must be three shares, like [70, 10, 20]")
        self._check_rates()
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

    def _check_rates(self) -> None:
        """Raise InputError unless samples are whole physics steps, recordings whole samples, and
        means whole samples that divide a recording."""
        physics = self.scene.physics_hz
        require(
            whole_multiple(physics, self.rate_hz) is not None,
            "rate_hz",
            self.rate_hz,
            f"each sample must be a whole number of physics steps (scene.physics_hz = {physics:g})",
        )
        require(
            whole_multiple(self.rate_hz, 1 / self.duration_s) is not None,
            "duration_s",
            self.duration_s,
            f"must be a whole number of samples at {self.rate_hz:g} Hz",
        )
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

    @property
    def bench(self) -> Bench:
        """The scene with the rate and the number of samples of a recording."""
        return Bench(self.scene, self.rate_hz, self.samples)

    def content(self) -> dict:
        """The part of the configuration on which the dataset's content depends: all but its path
        and the workers."""
        content = asdict(self)
        del content["out"], content["cluster"]
        return content
