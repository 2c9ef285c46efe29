"""Is anything ever lost? Generation killed and gone on with, datasets damaged and mended.

    make study-faults

1. Digests of the same dataset made by this process and by 1, 2 and 4 others.
2. Generation killed (SIGKILL, its workers left to notice) at moments uniform between the first
   shard and the finish; gone on with, the digest against an uninterrupted run's.
3. Random damage, spread evenly over payload, shard index, metadata and manifest: whether reading
   refuses, and whether generating again gives back every byte.
"""

import shutil
import tempfile
import time
from dataclasses import replace
from multiprocessing import get_context, set_forkserver_preload
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import yaml
from common import Report
from corruption import KINDS
from helpers import default_config
from tqdm import tqdm

import sim.generate
from lbgc.data.store import Dataset
from lbgc.errors import InputError

CASES = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())


def first_shard(out: Path) -> bool:
    return any((out / "manifest/stored/c").glob("*/0"))


def digests(report: Report, home: Path) -> None:
    ways = {"serial": []} | {
        f"{n} workers": ["cluster=local", f"cluster.workers={n}"] for n in CASES["workers"]
    }
    found = set()
    for name, by in ways.items():
        started = time.monotonic()
        config = default_config(*CASES["killed"], *by)
        made = sim.generate.main(replace(config, out=str(home / f"{name}.zarr")))
        digest = Dataset.open_finished(made).digest()
        report.line(f"{name:12s}{time.monotonic() - started:6.1f} s   {digest}")
        found.add(digest)
    report.summary["digests_equal"] = len(found) == 1


def begin(config: sim.generate.GenerateConfig) -> BaseProcess:
    """Generation in a process of its own, its first shard finished."""
    process = get_context("forkserver").Process(target=sim.generate.main, args=(config,))
    process.start()
    while not first_shard(Path(str(config.out))) and process.is_alive():
        time.sleep(0.005)
    return process


def kills(report: Report, home: Path) -> None:
    rng = np.random.default_rng(CASES["seed"])
    ways = {name: default_config(*CASES["killed"], *by) for name, by in CASES["by"].items()}
    digest, spans = "", {}
    for name, config in ways.items():
        process = begin(replace(config, out=str(home / f"timed {name}.zarr")))
        started = time.monotonic()
        process.join()
        spans[name] = time.monotonic() - started
        digest = Dataset.open_finished(home / f"timed {name}.zarr").digest()
        report.line(f"{name}: first shard to finish {spans[name]:.1f} s")
    done, different, left = 0, 0, []
    out = home / "killed.zarr"
    with tqdm(total=CASES["kills"], desc="killing", leave=False) as bar:
        while done < CASES["kills"]:
            name = list(ways)[(done + 1) % CASES["with_workers_every"] == 0]
            shutil.rmtree(out, ignore_errors=True)
            process = begin(replace(ways[name], out=str(out)))
            time.sleep(rng.uniform() * spans[name])
            in_time = process.is_alive()
            process.kill()
            process.join()
            if not in_time:
                continue  # it had finished already
            dataset = Dataset.open(out)
            left.append(len(dataset.missing_shards()) / dataset.layout.shards)
            sim.generate.main(replace(ways["serial"], out=str(out)))
            different += Dataset.open_finished(out).digest() != digest
            done += 1
            bar.set_postfix_str(f"{different} differ")
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


# A picture is no data, and here would only cost time; in the processes too.
sim.generate.try_picture = lambda *_: None

if __name__ == "__main__":
    set_forkserver_preload(["sim.generate", "helpers", "common", "corruption"])
    with Report("studies/faults") as study, tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        kills(study, place)
        digests(study, place)
        corruptions(study, place)
