"""Is anything ever lost? Generation killed and gone on with, datasets damaged and mended.

    make study-faults

1. Digests made by this process and by 1, 2 and 4 others.
2. Generation killed (SIGKILL, workers included or left to notice) at moments uniform between the
   first shard and the finish; gone on with, the digest against an uninterrupted run's.
3. Random damage, spread evenly over payload, shard index, metadata and manifest: whether reading
   refuses, and whether generating again gives back every byte.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from common import Report
from corruption import KINDS
from helpers import ROOT, default_config
from tqdm import tqdm

import sim.generate
from lbgc.data.store import Dataset
from lbgc.errors import InputError

CASES = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())


def command(out: Path, *options: str) -> list[str]:
    script = str(ROOT / "sim/generate.py")
    return [sys.executable, script, f"out={out}", *CASES["killed"], *options]


def run(out: Path, *options: str) -> float:
    """Generate in a process of its own; the seconds it took."""
    started = time.monotonic()
    subprocess.run(command(out, *options), check=True, capture_output=True)
    return time.monotonic() - started


def first_shard(out: Path) -> bool:
    return any((out / "manifest/stored/c").glob("*/0"))


def digests(report: Report, home: Path) -> str:
    found = {"serial": run(home / "serial.zarr")}
    for workers in CASES["workers"]:
        options = ("cluster=local", f"cluster.workers={workers}")
        found[f"{workers} workers"] = run(home / f"{workers} workers.zarr", *options)
    by = {name: Dataset.open_finished(home / f"{name}.zarr").digest() for name in found}
    for name, digest in by.items():
        report.line(f"{name:12s}{found[name]:6.1f} s   {digest}")
    report.summary["digests_equal"] = len(set(by.values())) == 1
    return by["serial"]


def killed_once(out: Path, share: float, whole_s: float, options: tuple[str, ...]) -> bool:
    """Start, kill at this share of the time from first shard to finish; whether it was in time."""
    process = subprocess.Popen(
        command(out, *options), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True,
    )  # fmt: skip
    while not first_shard(out) and process.poll() is None:
        time.sleep(0.005)
    time.sleep(share * whole_s)
    in_time = process.poll() is None
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    return in_time


def kills(report: Report, home: Path, digest: str) -> None:
    rng = np.random.default_rng(CASES["seed"])
    spans = {}
    for name, options in CASES["by"].items():
        out = home / f"timed {name}.zarr"
        process = subprocess.Popen(
            command(out, *options), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        while not first_shard(out):
            time.sleep(0.005)
        started = time.monotonic()
        process.wait()
        spans[name] = time.monotonic() - started
        report.line(f"{name}: first shard to finish {spans[name]:.1f} s")
    done, different, left = 0, 0, []
    with tqdm(total=CASES["kills"], desc="killing", leave=False) as bar:
        while done < CASES["kills"]:
            name, options = list(CASES["by"].items())[done % len(CASES["by"])]
            out = home / "killed.zarr"
            shutil.rmtree(out, ignore_errors=True)
            if not killed_once(out, rng.uniform(), spans[name], tuple(options)):
                continue  # it had finished already
            dataset = Dataset.open(out)
            left.append(len(dataset.missing_shards()) / dataset.layout.shards)
            run(out, *options)
            different += Dataset.open_finished(out).digest() != digest
            done += 1
            bar.update()
    missing = f"shards missing {min(left):.0%} to {max(left):.0%}"
    report.line(f"{done} kills, {missing}; {different} differ")
    report.summary |= {"generation_kills": done, "differences_after_kill": different}


def corruptions(report: Report, home: Path) -> None:
    config = default_config(*CASES["damaged"])
    whole, foreign, out = (home / f"{n}.zarr" for n in ("whole", "foreign", "damaged"))
    for path, seed in ((whole, 1), (foreign, 2)):
        sim.generate.main(replace(config, out=str(path), seed=seed))
    shards = Dataset.open(whole).layout.shards
    intact = {f.relative_to(whole): f.read_bytes() for f in whole.rglob("*") if f.is_file()}
    each = CASES["corruptions"] // len(KINDS)
    unnoticed, unmended = [], []
    for kind, damage in KINDS.items():
        for i in tqdm(range(each), kind, leave=False):
            shutil.rmtree(out, ignore_errors=True)
            shutil.copytree(whole, out)
            rng = np.random.default_rng([CASES["seed"], i, len(kind)])
            said = damage(out, rng, shards, foreign)
            try:
                Dataset.open_finished(out)
                unnoticed.append(said)
            except InputError:
                pass
            sim.generate.main(replace(config, out=str(out)))
            now = {f.relative_to(out): f.read_bytes() for f in out.rglob("*") if f.is_file()}
            if now != intact:
                unmended.append(said)
        report.line(f"{kind:12s}{each} damaged; so far unnoticed: {len(unnoticed)}")
    for said in unnoticed + unmended:
        report.line(f"  {said}")
    total = each * len(KINDS)
    report.line(f"{total} damaged, {len(unnoticed)} unnoticed, {len(unmended)} not mended")
    report.summary |= {
        "corruptions": total,
        "corruptions_unnoticed": len(unnoticed),
        "corruptions_not_mended": len(unmended),
    }


if __name__ == "__main__":
    # A picture is no data, and here would only cost time.
    os.environ["MUJOCO_GL"] = "disable"
    sim.generate.try_picture = lambda *_: None
    with Report("studies/faults") as study, tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        corruptions(study, place)
        kills(study, place, digests(study, place))
