"""The configuration of a dataset to be generated, which `conf/generate.yaml` holds."""

from dataclasses import asdict, dataclass, field

from lbgc.data.configuration import DatasetConfig
from lbgc.data.record import whole_multiple
from lbgc.errors import require, require_positive
from lbgc.frames import AXES, DOWN

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

    @property
    def bench(self) -> Bench:
        """The scene with the rate and the number of samples of a recording."""
        axis = AXES.index(self.protocol.axis)
        return Bench(self.scene, self.rate_hz, self.samples, axis)

    def content(self) -> dict:
        """The part of the configuration on which the dataset's content depends: all but its path
        and the workers. A plate about down is not said, so that datasets from before the plate's
        axis was a choice are what they were."""
        content = asdict(self)
        del content["out"], content["cluster"]
        if self.protocol.axis == AXES[DOWN]:
            del content["protocol"]["axis"]
        return content
