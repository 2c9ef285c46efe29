"""Is anything ever lost? Generation killed and gone on with, datasets damaged and mended.

    make study-faults

1. Generation killed (SIGKILL, its workers left to notice) at moments uniform between the first
   shard and the finish; gone on with, the digest against an uninterrupted run's.
2. Training killed likewise between its first checkpoint and the finish; the finished weights, byte
   by byte, against an uninterrupted run's.
3. Digests of the same dataset made by this process, by 1, 2 and 4 others, by others of which one is
   killed midway, and by two workers of a dask scheduler, of which one is killed midway too.
4. Every command where what it runs in fails it (`tests/environment.py`): full disks, permissions,
   links, names, pipes, signals, places elsewhere; whether it says one line and ends with the right
   exit code, and succeeds when run again.
5. Generation, training and the fit killed while processes work for them: whether one is left after
   five seconds.
6. Random damage, spread evenly over payload, shard index, metadata and manifest: whether reading
   refuses, and whether generating again gives back every byte.
"""

import os
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib.util import find_spec
from multiprocessing import active_children, get_context, set_forkserver_preload
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import torch
from common import Report, cases
from corruption import KINDS
from dask_cluster import running
from environment import COMMANDS, Faults, Server, left_of, prepare
from helpers import composed, default_config
from tqdm import tqdm

import lbgc.train
import sim.generate
from lbgc.data.store import Dataset
from lbgc.errors import InputError
from lbgc.learning import checkpoint
from lbgc.train import TrainConfig
from sim.cluster import ClusterConfig

CASES = cases("faults")


def first_shard(out: Path) -> bool:
    return any((out / "manifest/shards").glob("c.*"))


def digests(report: Report, home: Path) -> None:
    """Every way to make one dataset."""
    config = default_config(*CASES["killed"])
    ways = {"serial": ClusterConfig()}
    ways |= {f"{n} workers": ClusterConfig("local", n) for n in CASES["workers"]}
    found = {}
    for name, by in ways.items():
        found[name] = made(report, replace(config, cluster=by, out=str(home / f"{name}.zarr")))
    lost = replace(config, cluster=ClusterConfig("local", 2), out=str(home / "one killed.zarr"))
    with killing_one(lost, lambda: [c.pid for c in active_children() if "Spawn" in c.name]):
        found["one killed"] = made(report, lost)
    if find_spec("distributed") is None:
        report.line("dask is left out: the extra dask is not installed")
    else:
        with running(home, 2) as (address, workers):
            by = ClusterConfig("dask", address=address)
            asked = replace(config, cluster=by, out=str(home / "dask, one killed.zarr"))
            with killing_one(asked, lambda: [workers[0].pid]):
                found["dask"] = made(report, asked)
    report.summary["digests_of"] = len(found)
    report.summary["digests_equal"] = len(set(found.values())) == 1


def made(report: Report, config: sim.generate.GenerateConfig) -> str:
    """The digest of a dataset that is made now."""
    started = time.monotonic()
    path = sim.generate.main(config)
    seconds, digest = time.monotonic() - started, Dataset.open_finished(path).digest()
    report.line(f"{Path(path).stem:18s}{seconds:6.1f} s   {digest}")
    return digest


@contextmanager
def killing_one(
    config: sim.generate.GenerateConfig, pids: Callable[[], list[int | None]]
) -> Iterator[None]:
    """One of these processes is killed once the first shard is finished."""
    killed: list[int] = []

    def kill() -> None:
        while not first_shard(Path(str(config.out))):
            time.sleep(0.005)
        (first, *_) = [pid for pid in pids() if pid is not None]
        os.kill(first, signal.SIGKILL)
        killed.append(first)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    yield
    thread.join(timeout=10)
    assert killed, "everything was over before anybody could be killed"


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
            left.append(len(dataset.state().missing) / dataset.layout.shards)
            sim.generate.main(replace(ways["serial"], out=str(out)))
            different += Dataset.open_finished(out).digest() != digest
            done += 1
            bar.set_postfix_str(f"{different} differ")
            bar.update()
    missing = f"shards missing {min(left):.0%} to {max(left):.0%}"
    report.line(f"{done} kills, {missing}; {different} differ")
    report.summary |= {"generation_kills": done, "differences_after_kill": different}


def train_in(home: Path, config: TrainConfig) -> None:
    """A training whose outputs lie below `home`."""
    torch.set_num_threads(1)
    home.mkdir(exist_ok=True)
    os.chdir(home)
    lbgc.train.main(config)


def training_kills(report: Report, home: Path) -> None:
    rng = np.random.default_rng([CASES["seed"], 2])
    data = default_config(*CASES["trained_on"])
    sim.generate.main(replace(data, out=str(home / "trained on.zarr")))
    config = composed(TrainConfig, "train", *CASES["trained"], f"data='{home / 'trained on.zarr'}'")

    def begun(where: Path) -> BaseProcess:
        """Its first checkpoint written."""
        process = get_context("forkserver").Process(target=train_in, args=(where, config))
        process.start()
        while not list(where.glob("outputs/train/*/checkpoint*")) and process.is_alive():
            time.sleep(0.002)
        return process

    def weights(where: Path) -> bytes:
        (file,) = where.glob("outputs/train/latest/model.safetensors")
        return file.read_bytes()

    process = begun(home / "whole")
    started = time.monotonic()
    process.join()
    span, expected = time.monotonic() - started, weights(home / "whole")
    report.line(f"training: first checkpoint to finish {span:.1f} s")
    done, different, steps = 0, 0, []
    with tqdm(total=CASES["training_kills"], desc="killing", leave=False) as bar:
        while done < CASES["training_kills"]:
            where = home / f"training {len(steps)}"
            shutil.rmtree(where, ignore_errors=True)
            process = begun(where)
            time.sleep(rng.uniform() * span)
            in_time = process.is_alive()
            process.kill()
            process.join()
            if not in_time or list(where.glob("outputs/train/latest/*")):
                continue  # it had finished already
            (left,) = where.glob("outputs/train/*/checkpoint.safetensors")
            steps.append(checkpoint.read(left)[1]["step"])
            again = get_context("forkserver").Process(target=train_in, args=(where, config))
            again.start()
            again.join()
            different += weights(where) != expected
            done += 1
            bar.update()
    kept = f"checkpoints of steps {min(steps)} to {max(steps)} of {config.steps}"
    report.line(f"{done} trainings killed, {kept}; {different} differ")
    report.summary["training_kills"] = done
    before = report.summary["differences_after_kill"]
    assert isinstance(before, int)
    report.summary["differences_after_kill"] = before + different


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


def environment(report: Report, home: Path) -> None:
    server = Server()
    prepare(server, home / "given")
    faults = Faults(server, home, np.random.default_rng([CASES["seed"], 3]))
    every = [(name, module) for name in faults.names() for module in COMMANDS]
    done, wrong, spans = 0, [], dict.fromkeys(faults.names(), 0)
    for name, module in tqdm(every[:: CASES["environment_every"]], "failing", leave=False):
        said = getattr(faults, name)(module)
        if said is not None:  # a command that can meet this fault
            done, spans[name] = done + 1, spans[name] + 1
            wrong += [f"{name}, {module}: {said}"] if said else []
    report.line("commands failed from outside: " + ", ".join(f"{n} {c}" for n, c in spans.items()))
    for said in wrong:
        report.line(f"  {said}")
    report.summary |= {"environment_faults": done, "environment_tracebacks": len(wrong)}
    left = 0
    for module, *options in CASES["orphans"] * CASES["orphans_repeats"]:
        left += orphans(report, server, home, faults.rng, module, *options)
    report.summary["orphans_after_kill"] = left
    server.close()


def orphans(
    report: Report, server: Server, home: Path, rng: np.random.Generator, module: str, *options: str
) -> int:
    """How many processes are left of a command that is killed while others work for it."""
    for _ in range(9):  # a short command may be over before it is looked at
        cwd = home / f"killed {rng.integers(1 << 30)}"
        cwd.mkdir()
        process = server.begun(cwd, module, *(o.format(given=home / "given") for o in options))
        while process in (working := left_of(process)) and len(working) < 2:
            time.sleep(0.01)
        time.sleep(rng.uniform())
        if process in (working := left_of(process)) and len(working) > 1:
            break
        with suppress(ProcessLookupError):  # it was over
            os.kill(process, signal.SIGKILL)
        done = server.ended()
    else:
        raise AssertionError(f"{module} was never killed with others at work: {done.err}")
    os.kill(process, signal.SIGKILL)
    assert server.ended().code == -signal.SIGKILL
    until = time.monotonic() + 5
    while (left := left_of(process)) and time.monotonic() < until:
        time.sleep(0.1)
    report.line(f"{module} killed with {len(working) - 1} at work: {len(left)} left")
    return len(left)


if __name__ == "__main__":
    set_forkserver_preload(["sim.generate", "lbgc.train", "helpers", "common", "corruption"])
    with Report("studies/faults") as study, tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        kills(study, place)
        training_kills(study, place)
        digests(study, place)
        (place / "environment").mkdir(mode=0o755)
        place.chmod(0o755)  # others than root read there
        environment(study, place / "environment")
        corruptions(study, place)
