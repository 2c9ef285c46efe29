"""Whoever makes the shards, and whoever is lost meanwhile: the same dataset."""

import subprocess
import sys
import threading
import time
from itertools import islice
from pathlib import Path

import pytest
from dask_cluster import running
from helpers import ROOT, generate

from lbgc.data.store import Dataset
from sim import cluster

SIZE = {"rate_hz": 25.0, "duration_s": 200.0}
ASKED = ("rate_hz=25", "duration_s=200", "recordings=18", "out=d.zarr")


@pytest.fixture(scope="module")
def serial(tmp_path_factory) -> str:
    """Two shards."""
    return generate(tmp_path_factory.mktemp("serial") / "d.zarr", recordings=18, **SIZE).digest()


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_the_digest_does_not_depend_on_how_many_work(workers, cli, serial, tmp_path):
    made = cli("sim.generate", *ASKED, "cluster=local", f"cluster.workers={workers}")
    assert made.code == 0, made.err
    assert Dataset.open_finished(tmp_path / "d.zarr").digest() == serial


@pytest.mark.filterwarnings("ignore")  # dask's own
def test_dask_with_a_worker_killed_midway_gives_the_same_digest(cli, serial, tmp_path):
    pytest.importorskip("distributed", reason="needs the extra dask")
    with running(tmp_path, workers=2) as (address, workers):

        def kill_one() -> None:
            first = tmp_path / "d.zarr/manifest/shards"
            while not list(first.glob("c.*")):
                time.sleep(0.01)
            workers[0].kill()

        killer = threading.Thread(target=kill_one, daemon=True)
        killer.start()
        made = cli("sim.generate", *ASKED, "cluster=dask",
                   f"cluster.address={address}")  # fmt: skip
        killer.join(timeout=10)
        assert made.code == 0, made.err
        assert workers[0].wait(timeout=10) != 0
        assert workers[1].poll() is None
    assert Dataset.open_finished(tmp_path / "d.zarr").digest() == serial


@pytest.mark.filterwarnings("ignore")  # dask's own
def test_a_scheduler_killed_midway_is_said_in_one_line_and_gone_on_with(cli, serial, tmp_path):
    pytest.importorskip("distributed", reason="needs the extra dask")
    first = tmp_path / "d.zarr/manifest/shards"
    with running(tmp_path, workers=1) as (address, processes):
        command = [sys.executable, str(ROOT / "sim/generate.py"), *ASKED, "recordings=4800",
                   "cluster=dask", f"cluster.address={address}"]  # fmt: skip
        made = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
        while not list(first.glob("c.*")):
            assert made.poll() is None
            time.sleep(0.01)
        processes[-1].kill()
        said = made.communicate(timeout=30)[1].splitlines()
    assert made.returncode == 2
    assert [line for line in said if line and "rec/s" not in line] == [
        f"error: cluster.address = {address}: its scheduler is gone; what is finished stays good: "
        "run the same command again to go on"
    ]
    assert Dataset.open(tmp_path / "d.zarr").state().damaged == []


class Everywhere:
    """A client of a cluster with so many threads, whose tasks are done when they are asked for."""

    def __init__(self, threads: int):
        self.threads, self.most, self.out = threads, 0, 0

    def nthreads(self) -> dict[str, int]:
        return {"one": self.threads}

    def submit(self, task, shard, **_):
        self.out += 1
        self.most = max(self.most, self.out)
        return type("Done", (), {"result": lambda _: self._done(), "__hash__": lambda _: shard})()

    def _done(self) -> None:
        self.out -= 1


@pytest.mark.parametrize("threads", [0, 1, 16])
def test_dask_is_handed_some_tasks_at_a_time(threads, monkeypatch, capsys):
    distributed = pytest.importorskip("distributed", reason="needs the extra dask")

    class Completed(list):
        add = list.append

        def __next__(self):
            return self.pop(0)

    monkeypatch.setattr(distributed, "as_completed", Completed)
    client, shards = Everywhere(threads), range(10**6)
    found = islice(cluster._handed_out(client, "tcp://x:1", print, shards), 1000)
    assert list(found) == list(range(1000))
    assert client.most <= 4 * max(1, threads)
    assert ("has no workers yet: waiting" in capsys.readouterr().err) == (threads == 0)
    few = cluster._handed_out(Everywhere(threads), "tcp://x:1", print, range(5))
    assert sorted(few) == list(range(5))


def test_a_sweep_through_submitit_makes_what_it_makes_here(tmp_path):
    """Hydra's launcher for SLURM, by its kin that needs no SLURM."""
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher", reason="needs the extra slurm")
    sweep = ("--multirun", "hydra/launcher=submitit_local", "seed=1,-1", "recordings=2",
             "duration_s=10", "rate_hz=25", f"out={tmp_path}/seed${{seed}}.zarr")  # fmt: skip
    command = [sys.executable, str(ROOT / "sim/generate.py"), *sweep]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    assert "seed = -1: must not be negative" in done.stderr
    made = Dataset.open_finished(tmp_path / "seed1.zarr")
    config = {"recordings": 2, "duration_s": 10.0, "rate_hz": 25.0, "seed": 1}
    assert made.digest() == generate(Path(tmp_path / "here.zarr"), **config).digest()
