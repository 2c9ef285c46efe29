"""What a generation asks of the machine, by its configuration alone and before it starts.

The figures are of a sensor with every error term, measured on one core of a server; they are meant
to be right within a factor of two or three.
"""

from lbgc import machine
from lbgc.data.documents import Layout
from lbgc.data.place import Place
from lbgc.data.vetting import MOST_SHARDS
from lbgc.errors import require
from lbgc.protocol import Plan

from .configuration import GenerateConfig

_PROCESS = 0.2e9
"""Bytes of a process that has made nothing yet."""
_A_SAMPLE, _A_STEP = 80.0, 450.0
"""Bytes of memory for each sample of a recording, and for each physics step of one that moves."""
_STORED_SAMPLE, _STORED_MEANS = 4.0, 20.0
"""Least bytes of files for each value of both triads: white noise in counts, and floats."""
_RESTING_S = 60.0
"""Longest physics of a recording in which nothing moves: until the plate has settled."""
_SAMPLES_PER_S, _STEPS_PER_S, _PARTS_PER_S = 2e6, 4e5, 2e3
"""Samples drawn, physics steps and recordings a second, a core."""


def check(config: GenerateConfig, layout: Layout, place: Place, planned: Plan) -> None:
    """Say what the generation takes, where it is much. Raises InputError, naming what is too large,
    where it takes more than this machine has. planned : the first recording's plan."""
    scene, count = config.scene, config.recordings
    moves = planned.moving or scene.sway.present or scene.floor.moves
    steps = scene.physics_hz * (config.duration_s if moves else _RESTING_S)
    together = min(layout.shard, count)
    held = min(60.0 * together * layout.samples, 2.5e8)
    drawn = _A_SAMPLE * (config.samples if config.output == "samples" else layout.samples)
    one = _PROCESS + _A_STEP * steps
    machine.require_memory("scene.physics_hz", scene.physics_hz,
                           _PROCESS + _A_STEP * scene.physics_hz * _RESTING_S,
                           "a minute of physics")  # fmt: skip
    one += drawn + held
    machine.require_memory("duration_s", config.duration_s, one, "one recording")
    require(layout.shards <= MOST_SHARDS, "recordings", count,
            f"must be {MOST_SHARDS * layout.shard} at most, of this length")  # fmt: skip
    processes = min(config.cluster.processes, layout.shards)
    machine.require_memory("cluster.workers", processes, processes * one, "so many workers")
    value = _STORED_SAMPLE if config.output == "samples" else _STORED_MEANS
    files = count * layout.samples * value
    if place.local is not None:
        left = files - sum(f.stat().st_size for f in place.local.rglob("*") if f.is_file())
        machine.require_room("recordings", count, left, place.local)
    own = count * config.samples if config.output == "samples" else count * layout.samples
    ran = count * steps if moves else 0.0
    seconds = own / _SAMPLES_PER_S + ran / _STEPS_PER_S + count / _PARTS_PER_S
    if config.cluster.kind != "dask":
        machine.told(processes * one, seconds / processes, files)
