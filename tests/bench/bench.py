"""Speed against the machine's own limits.

    make bench

The floor is drawing as many float32 normals from numpy's Philox. Both sides of a ratio are
measured in turn within this run; what is printed are medians. The last column holds each figure
against its own limit, which no program that does the same work could pass: drawing its normals from
the generator in use; with them compressing, hashing and writing what is stored; that and the
physics; or the network alone.
"""

import hashlib
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import opening
import peers
import processes
from common import Report
from helpers import default_config
from numcodecs import Blosc
from table import Row, Table
from timing import CASES, Work, against, floor, normals

import sim.generate
import sim.recordings
from lbgc import cores
from lbgc.data import store
from lbgc.data.store import Dataset
from lbgc.earth import normal_gravity
from lbgc.estimators.static import mean
from lbgc.protocol import plan
from lbgc.sensor import streams
from lbgc.sensor.imu import ALONE
from lbgc.sensor.streams import Purpose
from sim import physics, turntable
from sim.generate import GenerateConfig
from sim.poses import Bench


def dataset(*options: str) -> GenerateConfig:
    """The default experiment, at the size of the day."""
    return default_config(*CASES["options"], *options)


ONE = dataset().samples * 6
"""Channel samples of a recording."""


def error_model(count: int) -> Work:
    """Both triads of the default sensor, in memory, every sample."""
    config = dataset()
    triads = config.imu.gyro.triad(), config.imu.accel.triad()
    truths = np.full((3, 1), 5e-5), np.array([[0.1], [0.1], [-9.8]])

    def work() -> None:
        for i in range(count):
            for triad, truth, purpose in zip(
                triads, truths, (Purpose.GYRO, Purpose.ACCEL), strict=True
            ):
                rng = streams.recording(1, i, purpose)
                lasting = triad.draw_unit(streams.unit(1, 0))
                lasting |= triad.draw_session(streams.session(1, 0, 0))
                errors = triad.draw_run(rng, lasting)
                triad.measure(rng, truth, errors, config.samples, 1 / config.rate_hz)

    return work


def means(count: int) -> Work:
    """4 Hz means of both triads, in memory."""
    config = dataset("output=means", "mean_s=0.25")
    sensor = sim.recordings.Sensor.of(config)
    truths = np.full((3, 1), 5e-5), np.array([[0.1], [0.1], [-9.8]])

    def work() -> None:
        lasting = sensor.lasting(range(64))
        for first in range(0, count, 64):
            rows = range(first, first + 64)
            for (_, triad, purpose), truth in zip(sensor.triads(), truths, strict=True):
                rngs, errors = sensor.drawn(triad, purpose, rows, lasting[purpose])
                sensor.measure(triad, rngs, np.broadcast_to(truth, (64, 3, 1)), errors, ALONE)

    return work


def end_to_end(home: Path, *options: str) -> Work:
    """Into a finished dataset: motion, errors, counts, compression, checksums."""
    config = dataset(*options)

    def work() -> None:
        out = Path(tempfile.mkdtemp(dir=home)) / "d.zarr"
        sim.generate.main(replace(config, out=str(out)))
        shutil.rmtree(out.parent)

    return work


def bare(home: Path, *options: str) -> Work:
    """What a dataset cannot do without: its normals from SFC64, compressing and hashing the
    sensors' values once, and a file for each of those that it has, written and nothing more."""
    made = Dataset.open_finished(sim.generate.main(
        replace(dataset(*options), out=str(home / "bare.zarr"))))  # fmt: skip
    shard = min(made.layout.shard, len(made))
    values = [np.asarray(made._array(n)[:shard]).swapaxes(1, 2).copy() for n in ("gyro", "accel")]
    how = [made.layout.compression(n) for n in ("gyro", "accel")]
    count, rows = len(made), -(-len(made) // shard)
    sizes = [entry.size for entry in made.place.entries().values()]
    shutil.rmtree(home / "bare.zarr")
    draw = normals(count * values[0][0].size * 2, np.random.SFC64)
    bloscs = [Blosc(name, 1, Blosc.BITSHUFFLE) for name in how]
    content = bytes(max(sizes))

    def work() -> None:
        draw()
        for _ in range(rows):
            for value, blosc in zip(values, bloscs, strict=True):
                for first in range(0, len(value), 64):
                    hashlib.sha256(blosc.encode(value[first : first + 64]))
        with tempfile.TemporaryDirectory(dir=home) as name:
            for number, size in enumerate(sizes):
                (Path(name) / str(number)).write_bytes(content[:size])

    return work


def in_vehicle(*options: str) -> GenerateConfig:
    return dataset("scene=vehicle", *CASES["vehicle"]["options"], *options)


def vehicle(home: Path, count: int) -> Work:
    """So many recordings in a vehicle, as a worker with one core makes them."""
    workers = ("cluster=local", f"cluster.workers={cores.count()}")
    config = in_vehicle(f"recordings={count}", *workers)
    path, sensor = str(home / "vehicle.zarr"), sim.recordings.Sensor.of(config)
    store.create(path, sim.generate._layout(config, sensor), config.content(), {})
    return lambda: sim.generate.make_shard(config, path, 0)


def rollout(count: int) -> Work:
    """The physics of so many recordings in a vehicle alone: mujoco.rollout on one thread."""
    config = in_vehicle()
    bench = Bench(config.scene, config.rate_hz, config.samples)
    model = turntable.load(config.scene, normal_gravity(float(np.deg2rad(config.latitude))))
    steps = physics.lead_steps(bench) + bench.samples * bench.steps + 2
    state = physics._state(model, 0.0)
    block = round(physics._BLOCK_S * config.scene.physics_hz)
    planned = plan(config.protocol, 0, config.duration_s)
    control = physics._servo(model, bench, planned, 0, block)[None]
    pool = physics.data_for(model, 1)

    def work() -> None:
        for _ in range(count):
            own = [state]
            for first in range(0, steps, block):
                part = control[:, : min(block, steps - first)]
                after, _ = physics.roll([model], own, part, pool)
                own = [after[0, -1]]

    return work


def rates(table: Table, home: Path) -> None:
    alone = "SFC64's normals alone"
    few, many = CASES["error_model"], CASES["means"]
    own = ONE // round(0.25 * dataset().rate_hz)
    memory = (
        ("error_model", "error model, 6 axes, in memory", 0.6, error_model(few), few, ONE),
        ("means", "4 Hz means, in memory, as 600 Hz samples", 50, means(many), many, own),
    )
    for key, what, goal, work, count, drawn in memory:
        limits = floor(count * ONE), (normals(count * drawn, np.random.SFC64), 1.0)
        table.ratio(f"{key}_over_floor", what, goal, *against(work, limits, what), alone)
    stored = "SFC64's normals, compressing, hashing, writing"
    for key, case in CASES["end_to_end"].items():
        what, goal, count = case["what"], case["goal"], case["recordings"]
        options = (f"recordings={count}", *case["options"])
        limits = floor(count * ONE), (bare(home, *options), 1.0)
        found = against(end_to_end(home, *options), limits, what, CASES["end_to_end_repeats"])
        table.ratio(f"{key}_over_floor", what, goal, *found, stored)
    what = "end to end, vehicle, over mujoco.rollout"
    count, repeats = CASES["vehicle"]["recordings"], CASES["vehicle"]["repeats"]
    options = ("scene=vehicle", *CASES["vehicle"]["options"], f"recordings={count}")
    physics_alone, else_ = rollout(count), bare(home, *options)

    def both() -> None:
        physics_alone()
        else_()

    found = against(vehicle(home, count), [(physics_alone, 1.0), (both, 1.0)], what, repeats)
    beside = f"mujoco.rollout, {stored}"
    table.ratio("end_to_end_vehicle_over_rollout", what, 0.75, *found, beside)


def reading(table: Table, home: Path) -> None:
    """Reading a full-rate dataset and the plain mean on it."""
    from lbgc.data.windows import cut

    count, window_s = CASES["reading"]["recordings"], CASES["reading"]["window_s"]
    config = replace(dataset(f"recordings={count}"), out=str(home / "read.zarr"))
    data = Dataset.open_finished(sim.generate.main(config))

    def work() -> None:
        for record in data.records(np.arange(count)):
            mean(cut(record, window_s))

    (found,) = against(work, [floor(count * ONE)], "reading", CASES["reading"]["repeats"])
    table.add(
        Row("read_and_estimate_over_floor", f"read and estimate (plain mean, {window_s:g} s)",
            found.ratio, "-", True, spread=found.spread, cpu=found.cpu)
    )  # fmt: skip


def public_tools(table: Table) -> None:
    for key, models, work, count in peers.available():
        what = f"peer: {key.replace('_', '-')} ({models})"
        if work is None:
            table.absent(what, "not installed (pip install -e '.[bench]')")
            continue
        (found,) = against(work, [floor(count)], what, CASES["peers_repeats"])
        table.add(
            Row(f"peer_{key}_over_floor", what, found.ratio, "-", True, spread=found.spread,
                cpu=found.cpu)
        )  # fmt: skip


def training(table: Table, home: Path) -> None:
    import learning  # PyTorch, which the workers of `processes` import with this file otherwise

    learning.rows(table, home)


def main() -> None:
    sim.generate.try_picture = lambda *_: None  # a picture is no data
    with Report("bench") as report, tempfile.TemporaryDirectory() as name:
        home, table = Path(name), Table(report)
        parts: tuple[Callable[[], None], ...] = (
            lambda: rates(table, home),
            lambda: processes.rows(table, home),
            lambda: opening.rows(table, home),
            lambda: training(table, home),
            lambda: reading(table, home),
            lambda: public_tools(table),
        )
        for part in parts:
            part()
        report.line("! misses its goal. +-: half the middle half of the repetitions. By cpu: the")
        report.line("same ratio by processor time, which a busy machine changes less.")
        table.write()


if __name__ == "__main__":
    main()
