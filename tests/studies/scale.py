"""What a recording costs, and with it a dataset of any size: the figures of docs/scale.md.

    make study-scale

CPU time and bytes a recording are differences between a dataset and one twice as long, so that what
any dataset costs once is not in them. They are of one core, whatever else the machine does.
"""

import os
import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from common import Report, cases
from helpers import default_config

import sim.generate
from lbgc import machine
from lbgc.data.store import Dataset
from lbgc.data.windows import stack

CASES = cases("scale")


def made(options: list[str], recordings: int, path: Path) -> tuple[float, Dataset]:
    """(CPU seconds, the dataset)."""
    shutil.rmtree(path, ignore_errors=True)
    config = replace(default_config(*options), recordings=recordings, out=str(path))
    started = time.process_time()
    sim.generate.main(config)
    return time.process_time() - started, Dataset.open(path)


def size(dataset: Dataset) -> tuple[int, int]:
    """(bytes, files)."""
    files = [dataset.path / name for name in dataset.place.names()]
    return sum(file.stat().st_size for file in files), len(files)


def costs(report: Report, home: Path) -> None:
    report.line(
        "what a recording of 240 s costs           CPU ms   stored kB   a shard: recordings"
    )
    for name, case in CASES["kinds"].items():
        few, many = case["recordings"], 2 * case["recordings"]
        short, first = made(case["options"], few, home / "few.zarr")
        long, second = made(case["options"], many, home / "many.zarr")
        cpu_s = (long - short) / few
        kb = (size(second)[0] - size(first)[0]) / few / 1e3
        files = (size(second)[1] - size(first)[1]) / (second.layout.shards - first.layout.shards)
        report.line(f"{name:40s}{1e3 * cpu_s:8.2f}{kb:12.2f}{second.layout.shard:12d}")
        for count in CASES["counts"]:
            shards = -(-count // second.layout.shard)
            report.line(
                f"    {count:10d}: {count * cpu_s / 3600:10.3f} core hours, "
                f"{count * kb / 1e6:10.3f} GB, {shards:7d} shards, {shards * files:10.0f} files"
            )
        key = name.replace(" ", "_").replace(",", "")
        report.summary |= {f"{key}_cpu_ms": 1e3 * cpu_s, f"{key}_stored_kb": kb}
        report.summary[f"{key}_files_a_shard"] = files


def reading(report: Report, home: Path) -> None:
    """Checking before use, and what training then holds in memory."""
    case = CASES["kinds"][CASES["read"]]
    _, dataset = made(case["options"], 2 * case["recordings"], home / "read.zarr")
    known, seconds = (_opened(dataset, verify) for verify in ("", "1"))
    rate = size(dataset)[0] / seconds / 1e6
    stored = stack(dataset.records(np.arange(len(dataset))), dataset.rate_hz)
    arrays = {**vars(stored), **vars(stored.windows)}.values()
    held = sum(v.nbytes for v in arrays if isinstance(v, np.ndarray))
    each = held / len(dataset) / 1e3
    report.line(f"{CASES['read']}: checked at {rate:.0f} MB/s, {1e3 * seconds / len(dataset):.3f} "
                f"ms a recording, {1e3 * known / len(dataset):.4f} where it is known to be whole; "
                f"in memory {each:.2f} kB a recording")  # fmt: skip
    report.summary |= {"checked_mb_per_s": rate, "in_memory_kb_a_recording": each}
    report.summary["checked_ms_a_recording"] = 1e3 * seconds / len(dataset)
    report.summary["known_ms_a_recording"] = 1e3 * known / len(dataset)


def _opened(dataset: Dataset, verify: str) -> float:
    """CPU seconds to open it, as a command with or without `--verify` does; of five, the median."""
    seconds = []
    with patch.dict(os.environ, {machine.VERIFY: verify}):
        for _ in range(5):
            started = time.process_time()
            Dataset.open_finished(dataset.path)
            seconds.append(time.process_time() - started)
    return float(np.median(seconds))


if __name__ == "__main__":
    with Report("studies/scale") as study, tempfile.TemporaryDirectory() as temporary:
        if hasattr(os, "sched_setaffinity"):  # two threads that share a core would each take longer
            os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        costs(study, Path(temporary))
        reading(study, Path(temporary))
