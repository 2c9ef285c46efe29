"""Generate a labelled dataset: protocol -> motion -> IMU errors -> Zarr.

python sim/generate.py latitude=32.76
"""

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
import zarr
from threadpoolctl import threadpool_limits
from tqdm import tqdm

import lbgc
from lbgc.commands import run_main
from lbgc.data import store
from lbgc.data.place import Place
from lbgc.data.record import whole_multiple
from lbgc.data.schema import SCHEMA
from lbgc.data.shard import Shard
from lbgc.earth import EARTH_RATE, heading_exists, normal_gravity
from lbgc.errors import require, require_choice, require_positive
from lbgc.outputs import fingerprint, mark_latest, task_directory
from lbgc.protocol import ProtocolConfig, plan
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.dither import check_means
from sim import cluster
from sim.cluster import ClusterConfig
from sim.physics import check_servo
from sim.picture import try_picture
from sim.poses import Bench
from sim.recordings import Sensor, batches
from sim.scene import SceneConfig


@dataclass(frozen=True)
class GenerateConfig:
    """What `conf/generate.yaml` holds."""

    latitude: float = 32.76
    """degrees, north positive"""
    height_m: float = 0.0
    """Height above the ellipsoid: gravity is less up there."""
    rate_hz: float = 600.0
    """Samples a second of the IMU."""
    duration_s: float = 240.0
    """Duration of each recording."""
    recordings: int = 80
    """How many recordings the dataset has."""
    seed: int = 1
    """Seed of the recordings: which are drawn."""
    unit_seed: int = 4
    """Seed of the units: whose sensors the recordings are of."""
    units: int = 1
    """Serial numbers; recordings go round them in turn."""
    sessions: int = 1
    """Power-ups of each unit; its recordings go round them in turn."""
    split: list[int] = field(default_factory=lambda: [70, 10, 20])
    """Shares of training, validation and test."""
    split_by: str = "recording"
    """recording, session or unit: what is never in two parts."""
    output: str = "samples"
    """samples: every sample; means: block means over mean_s."""
    mean_s: float = 5.0
    """Length of the blocks for output=means."""
    out: str | None = None
    """The dataset's path, or an fsspec URL; null: outputs/generate/<hash>/dataset.zarr."""
    cluster: ClusterConfig = field(default_factory=ClusterConfig)
    """Who does the work. It decides nothing of the dataset."""
    imu: ImuConfig = field(default_factory=ImuConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)
    protocol: ProtocolConfig = field(default_factory=ProtocolConfig)

    def __post_init__(self) -> None:
        require(abs(self.latitude) <= 90, "latitude", self.latitude, "must be from -90 to 90")
        low, high = -12_000.0, 100_000.0
        where = f"must be from {low:g} to {high:g}"
        require(low <= self.height_m <= high, "height_m", self.height_m, where)
        require_positive("rate_hz", self.rate_hz)
        require_positive("duration_s", self.duration_s)
        require_positive("mean_s", self.mean_s)
        for name in ("recordings", "units", "sessions"):
            require_positive(name, getattr(self, name))
        for name in ("seed", "unit_seed"):
            require(getattr(self, name) >= 0, name, getattr(self, name), "must not be negative")
        require_choice("output", self.output, ("samples", "means"))
        require_choice("split_by", self.split_by, ("recording", "session", "unit"))
        good = len(self.split) == 3 and min(self.split) >= 0 and sum(self.split) > 0
        require(good, "split", self.split, "must be three shares, like [70, 10, 20]")
        self._check_rates()
        self._check_means()
        plan(self.protocol, 0, self.duration_s)

    def _check_means(self) -> None:
        """Means are of samples that all came."""
        timing = self.imu.timing
        for name, value in vars(timing).items():
            require(
                self.output == "samples" or value == 0,
                f"imu.timing.{name}",
                value,
                "is of samples; use output=samples, or 0 here",
            )

    def _check_rates(self) -> None:
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
        """Samples of the sensor in a recording."""
        return round(self.duration_s * self.rate_hz)

    @property
    def block(self) -> int:
        """Samples per stored value."""
        return round(self.mean_s * self.rate_hz) if self.output == "means" else 1

    @property
    def bench(self) -> Bench:
        return Bench(self.scene, self.rate_hz, self.samples)

    def content(self) -> dict:
        """What decides the dataset's content: everything but where it goes and who makes it."""
        content = asdict(self)
        del content["out"], content["cluster"]
        return content


def main(config: GenerateConfig) -> Path | str:
    """Generate the dataset (or what is missing or damaged of it) and return where it is."""
    sensor = Sensor.of(config)
    latitude = float(np.deg2rad(config.latitude))
    planned = plan(config.protocol, 0, config.duration_s)
    check_servo(config.scene, planned)
    if config.output == "means":
        fastest = EARTH_RATE + max((move.rate for move in planned.moves), default=0.0)
        gravity = normal_gravity(latitude, config.height_m)
        for name, largest in (("gyro", fastest), ("accel", gravity)):
            triad = getattr(sensor, name)
            check_means(triad, f"imu.{name}", 1 / config.rate_hz, config.mean_s, largest)
    if not heading_exists(latitude):
        print(
            f"warning: at latitude {config.latitude:g} heading does not exist; the labels say only "
            "how the plate stands, and evaluation will refuse them",
            file=sys.stderr,
        )
    place = Place(_out(config))
    with place.alone():
        _generate(config, place, sensor)
    if place.local is None:
        return str(place)
    picture = place.local.with_suffix(".png")
    why_not = None if picture.exists() else try_picture(picture, config.scene)
    if why_not is not None:
        print(f"no picture of the scene: {why_not}", file=sys.stderr)
    if config.out is None:
        mark_latest(place.local.parent)
    return place.local


def _generate(config: GenerateConfig, place: Place, sensor: Sensor) -> None:
    """Every shard that the dataset there lacks, and those that are damaged."""
    where = str(place.local.resolve() if place.local else place)
    dataset = store.create(where, _layout(config, sensor), config.content(), _recipe())
    shards = dataset.unfinished_shards()
    total = sum(len(dataset.layout.rows(shard)) for shard in shards)
    with tqdm(total=total, unit="rec", desc="generating", disable=not shards) as bar:
        if config.cluster.kind == "serial":
            for shard in shards:
                _make(config, dataset, shard, bar.update)
            return
        require(not place.in_memory, "out", place, "is this process's alone: use cluster=serial")
        for shard in cluster.finished(config.cluster, partial(make_shard, config, where), shards):
            bar.update(len(dataset.layout.rows(shard)))
    store.remove_strays(place)  # of workers that were lost


def make_shard(config: GenerateConfig, path: str, shard: int) -> None:
    """Make a shard of a dataset that was started: a worker's task."""
    _make(config, store.Dataset.open(path), shard, int)


@threadpool_limits.wrap(limits=1, user_api="blas")
def _make(
    config: GenerateConfig, dataset: store.Dataset, shard: int, tick: Callable[[], object]
) -> None:
    """Make a shard of an open dataset. `tick` hears each recording.

    By one thread: those of several workers would wait for each other's cores, which took twice the
    time, and a product's last bits could depend on how many there are.
    """
    rows = dataset.layout.rows(shard)
    made = Shard(dataset.layout, len(rows))
    for part in batches(config, Sensor.of(config), rows):
        made.append(part)
        for _ in part["heading"]:
            tick()
    dataset.write_shard(shard, made.variables())


def _out(config: GenerateConfig) -> Path | str:
    """Where the dataset goes."""
    if config.out is None:
        identity = fingerprint({"schema": SCHEMA, **config.content()})
        return task_directory("generate", identity) / "dataset.zarr"
    path = Place(config.out).local
    if path is not None:
        require(not path.is_file(), "out", path, "is a file; a dataset is a directory")
    return config.out


def _layout(config: GenerateConfig, sensor: Sensor) -> store.Layout:
    as_counts = config.output == "samples"
    return store.Layout(
        recordings=config.recordings,
        samples=config.samples // config.block,
        rate_hz=config.rate_hz / config.block,
        scales={
            "gyro": sensor.gyro.output_scale(1 / config.rate_hz) if as_counts else None,
            "accel": sensor.accel.output_scale(1 / config.rate_hz) if as_counts else None,
        },
    )


def _recipe() -> dict:
    return {
        "versions": {
            "lbgc": lbgc.__version__,
            "mujoco": version("mujoco"),
            "numpy": np.__version__,
            "zarr": zarr.__version__,
        }
    }


if __name__ == "__main__":
    import sim.generate  # as which, and not as __main__, workers elsewhere know what is here

    run_main(sim.generate.main, sim.generate.GenerateConfig, "generate")
