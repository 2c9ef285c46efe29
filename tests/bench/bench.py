"""Speed against the machine's own limit: drawing as many float32 normals from numpy's Philox.

    make bench

Both sides of every ratio are measured in turn within one run; medians of the repetitions.
"""

import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import Report
from helpers import default_config

import sim.generate
from lbgc.data.store import Dataset
from lbgc.estimators.static import mean
from lbgc.sensor import streams
from lbgc.sensor.streams import Purpose

REPEATS = 7


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def over_floor(work: Callable[[], object], samples: int) -> tuple[float, float]:
    """(rate over the floor's, seconds), medians over repetitions of both sides in turn.

    samples : how many 600 Hz channel samples `work` stands for."""
    rng = np.random.Generator(np.random.Philox(1))
    buffer = np.empty(min(samples, 2_000_000), np.float32)

    def floor() -> None:
        for _ in range(max(1, round(samples / len(buffer)))):
            rng.standard_normal(out=buffer, dtype=np.float32)

    drawn = max(1, round(samples / len(buffer))) * len(buffer)
    pairs = [(seconds(floor) * samples / drawn, seconds(work)) for _ in range(REPEATS)]
    return float(np.median([f / w for f, w in pairs])), float(np.median([w for _, w in pairs]))


def error_model(count: int, means: bool) -> Callable[[], None]:
    """Both triads of the default sensor, in memory."""
    config = default_config()
    block = 150 if means else 1  # 4 Hz
    triads = config.imu.gyro.triad(), config.imu.accel.triad()
    truths = np.full((3, 1), 5e-5), np.array([[0.1], [0.1], [-9.8]])

    def work() -> None:
        for i in range(count):
            for triad, truth, purpose in zip(
                triads, truths, (Purpose.GYRO, Purpose.ACCEL), strict=True
            ):
                rng = streams.recording(1, i, purpose)
                unit = triad.draw_unit(streams.unit(1, 0))
                errors = triad.draw_run(rng, unit, triad.draw_session(streams.session(1, 0, 0)))
                n, dt = config.samples // block, 1 / config.rate_hz
                if means:
                    triad.measure_means(rng, truth, errors, n, dt, block)
                else:
                    triad.measure(rng, truth, errors, n, dt)

    return work


def end_to_end(home: Path, **changes: object) -> Callable[[], None]:
    """Into a finished dataset: motion, errors, counts, compression, checksums, digest."""
    config = replace(default_config(), **changes)

    def work() -> None:
        out = Path(tempfile.mkdtemp(dir=home)) / "d.zarr"
        sim.generate.main(replace(config, out=str(out)))
        shutil.rmtree(out.parent)

    return work


def main() -> None:
    sim.generate.try_picture = lambda *_: None  # a picture is no data
    one = 144_000 * 6
    with Report("bench") as bench, tempfile.TemporaryDirectory() as home:
        rows = {
            "error_model": (error_model(4, means=False), 4 * one),
            "means": (error_model(100, means=True), 100 * one),
            "end_to_end_static": (end_to_end(Path(home), recordings=32), 32 * one),
            "means_stored": (
                end_to_end(Path(home), recordings=512, output="means", mean_s=0.25),
                512 * one,
            ),
        }
        bench.line("what, counted in 600 Hz channel samples       over the floor   samples/s")
        for name, (work, samples) in rows.items():
            work()  # once to fill caches
            ratio, took = over_floor(work, samples)
            bench.line(f"{name:45s} {ratio:14.3f}   {samples / took:.3g}")
            bench.summary[f"{name}_over_floor"] = round(ratio, 4)
        baseline(bench, Path(home))


def baseline(bench: Report, home: Path) -> None:
    """Reading a full-rate dataset and the plain mean on it."""
    from lbgc.data.windows import cut

    config = replace(default_config(), recordings=16, out=str(home / "read.zarr"))
    data = Dataset.open_finished(sim.generate.main(config))

    def work() -> None:
        for record in data.records(np.arange(16)):
            mean(cut(record, 240.0))

    ratio, took = over_floor(work, 16 * 144_000 * 6)
    bench.line(
        f"{'read and estimate (plain mean, 240 s)':45s} {ratio:14.3f}   {16 * 864e3 / took:.3g}"
    )
    bench.summary["read_and_estimate_over_floor"] = round(ratio, 4)


if __name__ == "__main__":
    main()
