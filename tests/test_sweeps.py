"""Sweeps: what is finished is skipped, a failing job is named and the others go on, one table in
the end; the same with launchers whose jobs run elsewhere, and with a sweeper that optimises."""

import subprocess
import sys

import pytest
from helpers import ROOT, default_config, generate

SIZE = ("steps=2", "validate_every=1", "windows_s=[10]", "batch=4", "model=bilstm_8")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweeps") / "d.zarr"
    return generate(path, protocol=default_config("protocol=static").protocol, recordings=10,
                    duration_s=20.0, output="means", split=[1, 1, 0]).path  # fmt: skip


def check(code: int, out: str, err: str) -> None:
    assert code == 2
    assert "job 1 (" in err
    assert "seed=-2" in err
    assert "seed = -2: must not be negative" in err
    assert "1 of 2 jobs failed" in err
    assert "bilstm_8               1188     1" in out


def test_a_failing_job_is_named_and_the_others_go_on(cli, data, tmp_path):
    asked = ("--multirun", f"data={data}", *SIZE)
    done = cli("lbgc.train", *asked, "seed=1,-2")
    check(done.code, done.out, done.err)
    again = cli("lbgc.train", *asked, "seed=1,3")
    assert again.code == 0
    assert again.out.count("this run is already finished") == 1
    assert "bilstm_8               1188     2" in again.out
    assert len([d for d in (tmp_path / "outputs/train").iterdir() if not d.is_symlink()]) == 2
    assert not list((tmp_path / "outputs").glob("multirun/sweep_*"))


def swept(home, data, *options: str) -> subprocess.CompletedProcess:
    script = str(ROOT / "lbgc/train.py")
    return subprocess.run(
        [sys.executable, script, "--multirun", f"data={data}", *SIZE, *options],
        cwd=home, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("launcher", "plugin"),
    [("joblib", "hydra_joblib_launcher"), ("submitit_local", "hydra_submitit_launcher")],
)
def test_jobs_in_other_processes_say_the_same(data, tmp_path, launcher, plugin):
    pytest.importorskip(f"hydra_plugins.{plugin}")
    done = swept(tmp_path, data, f"hydra/launcher={launcher}", "seed=1,-2")
    check(done.returncode, done.stdout, done.stderr)


def test_a_sweeper_makes_the_validation_error_small(data, tmp_path):
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")
    options = ("hydra/sweeper=optuna", "learning_rate=interval(0.001,0.1)")
    done = swept(tmp_path, data, *options, "hydra.sweeper.n_trials=2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("learning_rate=0.") == 2
    best = (tmp_path / "outputs/multirun/optimization_results.yaml").read_text()
    assert "best_value" in best


def test_tensorboard_has_what_the_table_of_metrics_has(cli, data, tmp_path):
    pytest.importorskip("tensorboard")
    done = cli("lbgc.train", f"data={data}", *SIZE, "tensorboard=true")
    assert done.code == 0, done.err
    (run,) = (d for d in (tmp_path / "outputs/train").iterdir() if not d.is_symlink())
    events = b"".join(f.read_bytes() for f in (run / "tensorboard").iterdir())
    header = (run / "history.csv").read_text().splitlines()[0].split(",")
    assert all(name.encode() in events for name in header if name != "step")


def test_what_tensorboard_needs_is_said(cli, data, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    done = cli("lbgc.train", f"data={data}", *SIZE, "tensorboard=true")
    assert done.code == 2
    assert "pip install 'lbgc[tensorboard]'" in done.err
