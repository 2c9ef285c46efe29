"""Whoever makes the shards, and whoever is lost meanwhile: the same dataset."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from dask_cluster import running
from helpers import ROOT, generate

from lbgc.data.store import Dataset

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
