"""How long a dataset of 100 GB takes to open, that was found whole before."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from helpers import default_config
from table import Row, Table
from timing import CASES

import sim.generate
import sim.recordings
from lbgc.data import manifest, remembered, store
from lbgc.data.encoding import with_checksum
from lbgc.data.files import row_files
from lbgc.data.store import Dataset

_GOAL_S = 10.0
_PROGRAM = """import sys, time
from lbgc.data.store import Dataset
started = time.perf_counter()
Dataset.open_finished(sys.argv[1])
print(time.perf_counter() - started)"""


def rows(table: Table, home: Path) -> None:
    """One shard of the default sensor's samples, linked as often as makes 100 GB, and remembered as
    its writer remembers it; a new process opens it."""
    case = CASES["opening"]
    os.environ["XDG_CACHE_HOME"] = str(home / "cache")
    config = replace(default_config(*case["options"]), out=str(home / "one.zarr"))
    one = Dataset.open(sim.generate.main(config))
    own = {n: e.size for n, e in one.place.entries().items() if n in one.layout.files(0)}
    shards = int(case["bytes"] / sum(own.values()))
    config = replace(config, recordings=shards * one.layout.shard, out=str(home / "many.zarr"))
    layout = sim.generate._layout(config, sim.recordings.Sensor.of(config))
    many = store.create(str(config.out), layout, config.content(), {})
    for shard in range(shards):
        sizes = {}
        for name, file in zip(one.layout.files(0), layout.files(shard), strict=True):
            if name in own:
                (many.path / file).hardlink_to(one.path / name)
                sizes[file] = own[name]
        row = np.random.default_rng(shard).bytes(32) + manifest.sizes_checksum(sizes)
        many.place.write(row_files(shard)[0], with_checksum(row))
    time.sleep(remembered._SETTLED_NS * 1.1e-9)
    many.remember()
    command = [sys.executable, "-c", _PROGRAM, str(many.path)]
    seconds = [
        float(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
        for _ in range(case["repeats"])
    ]
    middle = float(np.median(seconds))
    size = shards * sum(own.values()) / 1e9
    what = f"to open {size:.0f} GB of {shards} shards, s"
    table.add(Row("open_100gb_s", what, middle, f"<={_GOAL_S:g}", middle <= _GOAL_S))
