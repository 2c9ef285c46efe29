"""Shared: entry points called as users call them, and one trained run."""

import fcntl
import os
import signal
import sys
import tempfile

# Read when NumPy and PyTorch are first imported, so by the workers that xdist starts and by what
# tests start themselves. On two processes, threads that wait for each other's cores made small
# matrices three to fifteen times as slow.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"
# What tests find whole is not the user's to remember; Matplotlib's list of fonts stays.
os.environ.setdefault("MPLCONFIGDIR", os.path.join(
    os.environ.get("XDG_CACHE_HOME", os.path.expanduser("~/.cache")), "matplotlib"
))  # fmt: skip
os.environ["XDG_CACHE_HOME"] = os.path.join(tempfile.gettempdir(), f"lbgc-tests-{os.getuid()}")

import numpy as np
import pytest
from helpers import composed, default_config, generate
from hypothesis import settings

import lbgc.bound
import lbgc.calibrate
import lbgc.compare
import lbgc.evaluate
import lbgc.export
import lbgc.export_imu
import lbgc.fit
import lbgc.info
import lbgc.learning.comparison
import lbgc.look
import lbgc.train
import sim.generate
import sim.render
from lbgc.commands import run_main

ENTRY_POINTS = {
    "sim.generate": (sim.generate.main, sim.generate.GenerateConfig, "generate"),
    "sim.scene": (sim.render.view, sim.render.ViewConfig, "scene_view"),
    "lbgc.bound": (lbgc.bound.main, lbgc.bound.BoundConfig, "bound"),
    "lbgc.fit": (lbgc.fit.main, lbgc.fit.FitConfig, "fit"),
    "lbgc.calibrate": (lbgc.calibrate.main, lbgc.calibrate.CalibrateConfig, "calibrate"),
    "lbgc.info": (lbgc.info.main, lbgc.info.InfoConfig, "info"),
    "lbgc.look": (lbgc.look.main, lbgc.look.LookConfig, "look"),
    "lbgc.train": (
        *(lbgc.train.main, lbgc.train.TrainConfig, "train"),
        *(lbgc.train.validation_error, lbgc.learning.comparison.show),
    ),
    "lbgc.export": (lbgc.export.main, lbgc.export.ExportConfig, "export"),
    "lbgc.export_imu": (lbgc.export_imu.main, lbgc.export_imu.ExportImuConfig, "export_imu"),
    "lbgc.compare": (lbgc.compare.main, lbgc.compare.CompareConfig, "compare"),
    "lbgc.evaluate": (lbgc.evaluate.main, lbgc.evaluate.EvaluateConfig, "evaluate"),
}

settings.register_profile("lbgc", deadline=None)  # a busy machine takes its time
settings.load_profile("lbgc")

FIRST = (
    *("test_readme", "test_swaying", "test_studies", "test_studies_learning", "test_contributing"),
    *("test_cluster", "test_sweeps", "test_bench", "test_make", "test_faults", "test_lean"),
)
"""Files of few and slow tests: begun last, one of them would run on alone when all else is done."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.stem not in FIRST)


class Outcome:
    """What an entry point did: its exit code and what it printed."""

    def __init__(self, code: int, out: str, err: str):
        self.code, self.out, self.err = code, out, err

    @property
    def last_line(self) -> str:
        return self.out.strip().splitlines()[-1]


@pytest.fixture
def cli(monkeypatch, capsys, tmp_path):
    """cli("sim.generate", "latitude=91") runs it in this process, in an empty directory."""
    monkeypatch.chdir(tmp_path)
    # Rendering has tests of its own; elsewhere it would only cost time.
    monkeypatch.setattr(sim.generate, "try_picture", lambda *_: "not in tests")

    def call(module: str, *arguments: str) -> Outcome:
        monkeypatch.setattr(sys, "argv", [module, *arguments])
        capsys.readouterr()
        code, before = 0, {n: signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGHUP)}
        try:
            run_main(*ENTRY_POINTS[module])
        except SystemExit as exit_:
            code = int(exit_.code or 0)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        said = capsys.readouterr()
        return Outcome(code, said.out, said.err)

    return call


@pytest.fixture(scope="session")
def unit_bias_run(tmp_path_factory):
    """One unit whose whole bias is its own: (a dataset as means, a run trained on it).

    All workers share them: whoever comes second finds them finished.
    """
    home = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        home = home.parent
    home = home / "unit_bias"
    home.mkdir(exist_ok=True)
    before = os.getcwd()
    with (home / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        os.chdir(home)
        try:
            return _unit_bias_run(home)
        finally:
            os.chdir(before)


def _unit_bias_run(home):
    bias = ("imu.gyro.bias_run_deg_per_h=0", "imu.gyro.bias_unit_deg_per_h=1")
    dataset = generate(
        home / "d.zarr",
        imu=default_config(*bias).imu,
        recordings=1500,
        output="means",
        split=[60, 10, 30],
    )
    options = (f"data={dataset.path}", "steps=600", "validate_every=100")
    run = lbgc.train.main(composed(lbgc.train.TrainConfig, "train", *options)).resolve()
    return dataset, run


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(20261124))
