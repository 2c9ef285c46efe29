"""Generate a labelled dataset: protocol -> motion -> IMU errors -> Zarr.

python sim/generate.py latitude=32.76
"""

__package__ = __package__ or "sim"  # it has none where it runs as a script (PEP 366)

import sys
from collections.abc import Callable
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
import zarr
from threadpoolctl import threadpool_limits
from tqdm import tqdm

import lbgc
from lbgc.commands import run_main
from lbgc.data import picture, store
from lbgc.data.place import Place, writing
from lbgc.data.schema import SCHEMA, VARIABLES
from lbgc.data.shard import Shard
from lbgc.earth import EARTH_RATE, heading_exists, normal_gravity
from lbgc.errors import require
from lbgc.outputs import fingerprint, mark_latest, remove_temporary, task_directory
from lbgc.protocol import plan
from lbgc.sensor.dither import check_means

from . import cluster, demand, held
from .configuration import GenerateConfig
from .physics import check_servo
from .picture import try_picture
from .recordings import Sensor, batches


def main(config: GenerateConfig) -> Path | str:
    """Generate a dataset, or the shards of it that are missing or damaged, and return its path."""
    sensor = Sensor.of(config)
    latitude = float(np.deg2rad(config.latitude))
    planned = plan(config.protocol, 0, config.duration_s)
    check_servo(config.scene, planned, config.bench.axis)
    held.check(config.scene, planned)
    if config.output == "means":
        fastest = EARTH_RATE + planned.fastest
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
    layout, place = _layout(config, sensor), Place(_out(config))
    demand.check(config, layout, place, planned)
    with place.alone():
        _generate(config, place, layout)
    if place.local is None:
        return str(place)
    _draw_beside(place, config)
    if config.out is None:
        mark_latest(place.local.parent)
    return place.local


def _draw_beside(place: Place, config: GenerateConfig) -> None:
    """Put the scene's picture beside a local dataset, unless a whole one is there."""
    beside = picture.beside(place)
    if beside is None:
        return
    remove_temporary(beside.parent)
    why_not = (
        None
        if picture.read(beside) is not None
        else try_picture(beside, config.scene, config.protocol)
    )
    if why_not is not None:
        print(f"no picture of the scene: {why_not}", file=sys.stderr)


def _generate(config: GenerateConfig, place: Place, layout: store.Layout) -> None:
    """Make all shards that are missing or damaged in the dataset at this place."""
    where = str(place.local.resolve() if place.local else place)
    dataset = store.create(where, layout, config.content(), _recipe())
    shards = dataset.unfinished_shards()
    total = sum(len(dataset.layout.rows(shard)) for shard in shards)
    with tqdm(total=total, unit="rec", desc="generating", disable=not shards) as bar:
        if config.cluster.kind == "serial":
            for shard in shards:
                _make(config, dataset, shard, bar.update)
        else:
            alone = "is this process's alone: use cluster=serial"
            require(not place.in_memory, "out", place, alone)
            task = partial(make_shard, config, where)
            for shard in cluster.finished(config.cluster, task, shards):
                bar.update(len(dataset.layout.rows(shard)))
    store.remove_strays(place)  # partial files of workers that were lost
    if shards:
        with writing(place):
            place.settle()
        dataset.remember()


def make_shard(config: GenerateConfig, path: str, shard: int) -> None:
    """Make one shard of a dataset that was begun at this path, as a worker's task."""
    _make(config, _opened(path, _identity(config)), shard, int)


@lru_cache(maxsize=4)
def _opened(path: str, identity: str) -> store.Dataset:
    """The dataset of this identity at this path. A worker opens it once and not for each shard: it
    has sixty documents, each a request where it lies behind a URL."""
    dataset = store.Dataset.open(path)
    require(dataset.identity == identity, "out", path, "holds a dataset of another configuration")
    return dataset


def _identity(config: GenerateConfig) -> str:
    """The identity of a configuration's dataset."""
    return fingerprint({"schema": SCHEMA, **config.content()})


@threadpool_limits.wrap(limits=1, user_api="blas")
def _make(
    config: GenerateConfig, dataset: store.Dataset, shard: int, tick: Callable[[], object]
) -> None:
    """Make one shard of an open dataset. tick : is called for each recording.

    Linear algebra uses one thread: those of several workers would wait for each other's cores,
    which took twice the time, and the last bits of a product could depend on their number.
    """
    rows = dataset.layout.rows(shard)
    made = Shard(dataset.layout, len(rows))
    for part in batches(config, Sensor.of(config), rows):
        made.append(part)
        for _ in part["heading"]:
            tick()
    dataset.write_shard(shard, made.variables())


def _out(config: GenerateConfig) -> Path | str:
    """The dataset's path or URL: the configured one, or one in the task's output directory. Raises
    InputError where that is a file."""
    if config.out is None:
        return task_directory("generate", _identity(config)) / "dataset.zarr"
    path = Place(config.out).local
    if path is not None:
        require(not path.is_file(), "out", path, "is a file; a dataset is a directory")
    return config.out


def _layout(config: GenerateConfig, sensor: Sensor) -> store.Layout:
    """The dataset's layout, with the sensors' counts as scale factors where samples are stored."""
    as_counts = config.output == "samples"
    drawn = {f"{name}_{error.name}" for name, triad, _ in sensor.triads() for error in triad.drawn}
    return store.Layout(
        recordings=config.recordings,
        samples=config.samples // config.block,
        rate_hz=config.rate_hz / config.block,
        scales={
            "gyro": sensor.gyro.output_scale(1 / config.rate_hz) if as_counts else None,
            "accel": sensor.accel.output_scale(1 / config.rate_hz) if as_counts else None,
        },
        variables=tuple(n for n, v in VARIABLES.items() if not v.optional or n in drawn),
    )


def _recipe() -> dict:
    """The packages' versions, which are stored with the dataset."""
    return {
        "versions": {
            "lbgc": lbgc.__version__,
            "mujoco": version("mujoco"),
            "numpy": np.__version__,
            "zarr": zarr.__version__,
        }
    }


if __name__ == "__main__":
    from . import generate  # under this name, not as __main__, other processes can import the tasks

    run_main(generate.main, generate.GenerateConfig, "generate")
