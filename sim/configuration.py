"""The configuration of a dataset to be generated, which `conf/generate.yaml` holds."""

from dataclasses import asdict, dataclass, field
from functools import cached_property

from lbgc.data import unit_file
from lbgc.data.configuration import DatasetConfig
from lbgc.data.record import whole_multiple
from lbgc.data.unit_file import CalibratedUnit
from lbgc.errors import require, require_positive
from lbgc.frames import AXES, DOWN
from lbgc.protocol import OF_A_TUMBLE

from .cluster import ClusterConfig
from .poses import Bench
from .turntable import SceneConfig


@dataclass(frozen=True)
class GenerateConfig(DatasetConfig):
    """The configuration of a dataset to be generated, which `conf/generate.yaml` holds."""

    out: str | None = None
    """The dataset's path, or an fsspec URL; null: outputs/generate/<hash>/dataset.zarr."""
    cluster: ClusterConfig = field(default_factory=ClusterConfig)
    """The workers that make the shards. The dataset does not depend on them."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    """The bench."""
    calibration: str | None = None
    """What is known of one unit, a file that `calibrate` wrote: units are drawn from it, each as
    yours may be, and not from the sensor's law."""

    def __post_init__(self) -> None:
        physics = self.scene.physics_hz
        require_positive("rate_hz", self.rate_hz)
        require(
            whole_multiple(physics, self.rate_hz) is not None,
            "rate_hz",
            self.rate_hz,
            f"each sample must be a whole number of physics steps (scene.physics_hz = {physics:g})",
        )
        super().__post_init__()
        unit = self.calibrated
        one = unit is None or unit.now is None or self.sessions == 1
        about = "must be 1: the calibration knows the errors of one power-up, not of others"
        require(one, "sessions", self.sessions, about)

    @cached_property
    def calibrated(self) -> CalibratedUnit | None:
        """What is known of the unit, read once: workers are sent it."""
        return None if self.calibration is None else unit_file.load(self.calibration, self.imu)

    @property
    def bench(self) -> Bench:
        """The scene with the rate and the number of samples of a recording."""
        axis = AXES.index(self.protocol.axis)
        return Bench(self.scene, self.rate_hz, self.samples, axis)

    def content(self) -> dict:
        """The part of the configuration on which the dataset's content depends: all but its path
        and the workers. A plate about down, a unit of the sensor's law and the hand that there is
        not are not said, so that datasets from before there was a choice are what they were."""
        content = asdict(self)
        del content["out"], content["cluster"], content["calibration"]
        if self.calibrated is not None:
            content["calibration"] = self.calibrated.checksum
        if self.protocol.axis == AXES[DOWN]:
            del content["protocol"]["axis"]
        if self.protocol.kind != "tumble":
            del content["scene"]["hand"]
            for key in OF_A_TUMBLE:
                del content["protocol"][key]
        return content
