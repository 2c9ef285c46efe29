"""How commands end where what they run in fails them; and what ends with them. All commands and all
faults are in `make study-faults`."""

import errno
import multiprocessing.context
import os
import signal
import subprocess
import sys
import time
from multiprocessing.context import ForkContext
from pathlib import Path

import numpy as np
import pytest
from helpers import ROOT

from lbgc import ending, outputs
from lbgc.commands import run_main
from lbgc.data.place import Place
from lbgc.errors import InputError
from lbgc.info import InfoConfig
from lbgc.learning import ahead
from lbgc.outputs import mark_latest, write_atomically
from lbgc.sensor.fitting import resting_axis
from lbgc.sensor.fitting.likelihood import Likelihood
from lbgc.sensor.fitting.ordinates import ordinates
from lbgc.sensor.fitting.shapes import GAUSS_MARKOV, core


@pytest.fixture
def ended(monkeypatch, capsys, tmp_path):
    """ended(act) runs a command that does this; its exit code, and what it says of errors."""

    def call(act):
        def main(config: InfoConfig) -> None:
            act()

        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["info", "data=x"])
        before = {n: signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGHUP)}
        try:
            run_main(main, InfoConfig, "info")
            code = 0
        except SystemExit as exit_:
            code = exit_.code
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        return code, capsys.readouterr().err

    return call


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_told_to_end_it_says_one_line(number, code, ended):
    said = "interrupted; run the same command again to go on\n"
    signal.signal(number, signal.SIG_DFL)  # a command of another test leaves it ignored
    assert ended(lambda: signal.raise_signal(number)) == (code, said)


def test_what_is_said_stands_below_a_progress_bar(ended):
    def interrupted() -> None:
        print("reading:  10%", end="", file=sys.stderr)
        raise KeyboardInterrupt

    assert ended(interrupted)[1].startswith("reading:  10%\ninterrupted; ")


def test_what_is_ignored_stays_ignored(ended):
    """As under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert ended(lambda: signal.raise_signal(signal.SIGHUP)) == (0, "")
    finally:
        signal.signal(signal.SIGHUP, before)


def test_an_error_of_the_operating_system_is_one_line(ended):
    def full() -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "results.json")

    code, said = ended(full)
    assert code == 2
    assert said == (
        "error: path = results.json: cannot be used (No space left on device); what is finished "
        "stays good: run the same command again to go on\n"
    )


@pytest.mark.parametrize(("where", "code"), [("closed pipe", 141), ("/dev/full", 2)])
def test_the_work_goes_on_where_nobody_reads(where, code, capsys):
    if where == "closed pipe":
        reader, opened = os.pipe()
        os.close(reader)
    else:
        opened = os.open(where, os.O_WRONLY)
    with open(opened, "w") as lost:
        stream = ending.Stream(lost)
        for _ in range(2):
            print("read by nobody", file=stream, flush=True)
    assert stream.lost is not None
    assert ending.unprinted(stream.lost) == code
    assert capsys.readouterr().err.endswith("the work is done, but not all was printed\n")


def test_a_file_that_cannot_be_written_leaves_nothing_and_is_named(tmp_path, monkeypatch):
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write_atomically(tmp_path / "a", "before")
    monkeypatch.setattr(outputs.os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as error:
        write_atomically(tmp_path / "a", "after")
    assert error.value.filename == str(tmp_path / "a")
    assert {f.name: f.read_text() for f in tmp_path.iterdir()} == {"a": "before"}


def test_without_links_results_are_as_good(tmp_path, monkeypatch, capsys):
    def no_link(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "symlink", no_link)
    (tmp_path / "run").mkdir()
    mark_latest(tmp_path / "run")
    assert capsys.readouterr().err.endswith("latest was made (Operation not permitted)\n")


def test_what_cannot_be_read_is_not_taken_for_missing(tmp_path, monkeypatch):
    def closed(self: Path) -> os.stat_result:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self))

    monkeypatch.setattr(Path, "lstat", closed)
    with pytest.raises(PermissionError):
        Place(tmp_path).read("zarr.json")


@pytest.mark.parametrize("url", ["nowhere://x/d.zarr", "ftp://127.0.0.1:9/d.zarr"])
def test_a_place_elsewhere_that_is_not_there_is_one_line(url):
    with pytest.raises(InputError, match=r"Protocol not known: nowhere|Connection refused"):
        Place(url).read("zarr.json")


WORKING = """
import time
from lbgc.processes import pool
if __name__ == "__main__":
    with pool(2) as own:
        for _ in own.map(time.sleep, [0, 0, 60, 60]):
            print(*(p for p in own._processes), flush=True)
"""


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    (tmp_path / "working.py").write_text(WORKING)
    command = [sys.executable, tmp_path / "working.py"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as parent:
        assert parent.stdout is not None
        workers = [Path("/proc", pid) for pid in parent.stdout.readline().split()]
        assert workers
        assert all(worker.exists() for worker in workers)
        parent.kill()
    until = time.monotonic() + 10
    while any(worker.exists() for worker in workers):
        assert time.monotonic() < until, "workers outlive their parent"
        time.sleep(0.05)


class Numbers:
    """Batches that are their own numbers."""

    batch = 1

    def __getitem__(self, step: int) -> int:
        return step


def test_training_starts_its_processes_whatever_a_launcher_has_set(monkeypatch):
    class Launcher(ForkContext):
        class Process(ForkContext.Process):
            @staticmethod
            def _Popen(process: object) -> None:
                raise AttributeError("'Process' object has no attribute 'env'")

    default = multiprocessing.context._default_context  # type: ignore[attr-defined]
    monkeypatch.setattr(default, "_actual_context", Launcher())
    drawn = ahead._by_processes(1, Numbers(), range(1, 4))
    assert list(drawn) == [1, 2, 3]


def noise(rate_hz: float, samples: int, kind: str, seed: int) -> np.ndarray:
    rng = np.random.Generator(np.random.SFC64(seed))
    x = rng.standard_normal((1, samples))
    if kind == "tone":
        x += 10 * np.sin(2 * np.pi * 0.21 * np.arange(samples))
    if kind == "coarse":
        step = 10 ** rng.uniform(-1, 1)
        x = np.round(x / step) * step
    return x


@pytest.mark.parametrize(
    ("rate_hz", "samples", "kind", "seed"),
    [(0.1, 10, "white", 1), (0.1, 40, "tone", 1), (1.0, 61, "coarse", 1), (1.0, 61, "coarse", 3),
     (0.5, 100, "coarse", 5), (1000.0, 200, "tone", 2)],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_fit_of_a_short_log_is_answered_or_refused(rate_hz, samples, kind, seed):
    series = noise(rate_hz, samples, kind, seed)
    try:
        fit = resting_axis.fitted(series, 1 / rate_hz, (1.0, 3600.0))
    except InputError:
        return  # it shows no noise beside its tones or its rounding
    assert fit.estimates["N"].high > 0


@pytest.mark.parametrize("log_T", [-1e4, 1e4])
def test_times_that_no_log_shows_are_kept_where_powers_are_numbers(log_T):
    data = ordinates(noise(1.0, 1000, "white", 1)[0], 1.0)
    likelihood = Likelihood(data, [*core((1.0, 3600.0)), GAUSS_MARKOV])
    start = np.zeros(len(likelihood.names))
    start[likelihood.names.index("GM_T")] = log_T
    assert np.isfinite(likelihood.minimise(start)[1])
