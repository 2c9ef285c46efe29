"""Two processes against one, and the memory of a process."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, wait
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from helpers import default_config
from table import Row, Table
from timing import CASES, normals
from tqdm import tqdm

import sim.generate
import sim.recordings
from lbgc.data import store

ROOT = Path(__file__).parents[2]
_MOST_MB = 600.0


def rows(table: Table, home: Path) -> None:
    _speedup(table, home)
    _memory(table)


def _speedup(table: Table, home: Path) -> None:
    """Shards done by two workers that are up and running, against one of them; of all cases the
    one in which two help least."""
    case, found = CASES["two_processes"], []
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for number, (name, options) in enumerate(case["cases"].items()):
            ratios, limits = _of_two(pool, str(home / f"two{number}.zarr"), options)
            low, middle, high = (float(q) for q in np.quantile(ratios, (0.25, 0.5, 0.75)))
            found.append((middle, float(np.median(limits)), (high - low) / 2 / middle, name))
            table.note(f"two_process_speedup_{name.replace(' ', '_')}", middle)
    middle, limit, spread, name = min(found)
    table.add(
        Row("two_process_speedup", f"two processes over one, {name}", middle, "1.8",
            middle >= 1.8, middle / limit, f"drawing alone on two ({limit:.2f})", spread)
    )  # fmt: skip


def _of_two(
    pool: ProcessPoolExecutor, path: str, options: list[str]
) -> tuple[list[float], list[float]]:
    """The speed-ups, of generation and of drawing normals alone, one after the other."""
    case = CASES["two_processes"]
    config = default_config(*CASES["options"], *options)
    sensor = sim.recordings.Sensor.of(config)
    made = store.create(path, sim.generate._layout(config, sensor), config.content(), {})
    shards = list(range(made.layout.shards))

    def both(task: Callable[..., object], *arguments: list) -> float:
        started = time.perf_counter()
        wait([pool.submit(task, *given) for given in zip(*arguments, strict=True)])
        return time.perf_counter() - started

    def one(task: Callable[..., object], *arguments: list) -> float:
        started = time.perf_counter()
        for given in zip(*arguments, strict=True):
            pool.submit(task, *given).result()
        return time.perf_counter() - started

    given = [config] * len(shards), [path] * len(shards), shards
    count = [case["normals"]] * len(shards)
    both(sim.generate.make_shard, *given)  # once, to import everything
    ratios, limits = [], []
    for _ in tqdm(range(case["repeats"]), "two processes", leave=False):
        ratios.append(one(sim.generate.make_shard, *given) / both(sim.generate.make_shard, *given))
        limits.append(one(_draw, count) / both(_draw, count))
    return ratios, limits


def _draw(count: int) -> None:
    normals(count, np.random.Philox)()


def _memory(table: Table) -> None:
    """Highest resident memory of generation and of evaluation, as typed: each a program of its own,
    whose imports alone are the limit."""
    bare = _peak(ROOT, "-c", "import lbgc.evaluate, sim.generate")
    for count in CASES["memory"]["recordings"]:
        options = (*CASES["options"], f"recordings={count}", "out=d.zarr")
        with tempfile.TemporaryDirectory() as home:
            own = Path(home)  # results go there too
            made = _peak(own, f"{ROOT}/sim/generate.py", *options)
            read = _peak(own, f"{ROOT}/lbgc/evaluate.py", "data=d.zarr")
        most = max(made, read)
        table.add(
            Row(f"memory_{count}_mb", f"memory of a process, {count} recordings, MB", most,
                f"<={_MOST_MB:.0f}", most <= _MOST_MB, most / bare, f"imports alone ({bare:.0f})")
        )  # fmt: skip
        table.note(f"memory_{count}_generation_mb", made)
        table.note(f"memory_{count}_evaluation_mb", read)


_LAUNCHER = """import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"""


def _peak(home: Path, *arguments: str) -> float:
    """MB, of a program that did this there, started by a small one: on Linux a program's highest
    memory begins with that of who started it. Raises CalledProcessError where it failed."""
    command = [sys.executable, "-c", _LAUNCHER, sys.executable, *arguments]
    said = subprocess.run(command, cwd=home, check=True, stdout=subprocess.PIPE, text=True)
    return int(said.stdout) / 1024
