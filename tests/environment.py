"""What fails a command from outside: the disk, permissions, names, pipes, signals, the network; and
what is left of a command that is killed.

Commands run in processes that a server forks, with everything imported, and that end as any other:
`python environment.py` is that server.
"""

import ctypes
import errno
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import programs
from programs import lead, serve

NOBODY = 65534
LONG = "n" * 300
COMMANDS = {
    "sim.generate": ("recordings=18", "rate_hz=25", "duration_s=200", "out=d.zarr"),
    "sim.scene": ("out=scene.png", "width=64", "height=64"),
    "lbgc.bound": ("windows_s=[10]", "imu=stim300"),
    "lbgc.fit": ("data={given}/rest.zarr",),
    "lbgc.calibrate": ("means={given}/means.csv", "latitude=48"),
    "lbgc.info": ("data={given}/means.zarr",),
    "lbgc.look": ("files=[{given}/log.csv]", "log.latitude=48.1"),
    "lbgc.train": ("data={given}/means.zarr", "steps=40", "experiment=residual",
                   "windows_s=[10,30]", "checkpoint_every=5"),
    "lbgc.evaluate": ("data={given}/means.zarr", "run={given}/outputs/train/latest",
                      "windows_s=[10,30]"),
    "lbgc.export_imu": ("imu=stim300",),
    "lbgc.export": ("run={given}/outputs/train/latest", "out=model.onnx"),
    "lbgc.compare": ("runs={given}/outputs/train",),
}  # fmt: skip
"""Every command as it succeeds; what it reads lies in the directory `given`."""
READS = ("data", "run", "runs", "means", "files")
_PROGRESS = re.compile(r"%\||\d+(rec|step|shard|it)? \[|it/s\]|/s\]")


@dataclass(frozen=True)
class Ended:
    """How a command ended. code : its exit code, or minus the signal that ended it."""

    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        """What it said on standard error beside progress."""
        every = self.err.replace("\r", "\n").splitlines()
        return [line for line in every if line.strip() and not _PROGRESS.search(line)]


class Server(programs.Server):
    """Forks a process for each command."""

    def __init__(self) -> None:
        super().__init__(__file__)

    def begun(self, cwd: Path, module: str, *arguments: str, **how: Any) -> int:
        """Start a command in a directory; its process. how : see `_become`."""
        self._said = cwd.parent / f"{cwd.name} said"
        self._said.mkdir(exist_ok=True)
        return self.begin({"cwd": str(cwd), "said": str(self._said), "argv": [module, *arguments],
                           **how})  # fmt: skip

    def ended(self) -> Ended:
        """How the command ended that was begun."""
        code = self.end()
        out, err = (self._said / name for name in ("out", "err"))
        return Ended(code, out.read_text() if out.exists() else "", err.read_text())

    def run(self, cwd: Path, module: str, *arguments: str, **how: Any) -> Ended:
        self.begun(cwd, module, *arguments, **how)
        return self.ended()


def _become(cwd: str, said: str, argv: list[str], **how: Any) -> None:
    """Make this process the command's. how : out, where standard output leads: a path, "closed
    pipe" or "closed"; largest, bytes of a file; unprivileged, whether it has no more rights than
    any user; links, False where the file system has none."""
    os.setsid()
    os.chdir(cwd)
    lead(1, how.get("out", f"{said}/out"))
    lead(2, f"{said}/err")
    sys.stdout = None if how.get("out") == "closed" else open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", closefd=False, buffering=1)  # noqa: SIM115
    if "largest" in how:
        _relayed(2)  # so that what is said is not cut off at that length
        resource.setrlimit(resource.RLIMIT_FSIZE, (how["largest"],) * 2)
    if not how.get("links", True):
        os.symlink = _no_link
    if how.get("unprivileged") and os.geteuid() == 0:
        _drop_rights()
    sys.argv = argv


def _drop_rights() -> None:
    """Become nobody; where nobody else can read this Python, root without its capabilities, for
    whom permissions are what they are for any owner."""
    try:
        for own in Path(os.__file__).resolve().parents:
            if not own.stat().st_mode & 0o001:
                raise PermissionError(own)
    except PermissionError:
        header = (ctypes.c_uint32 * 2)(0x20080522, 0)  # version 3, of this process
        if ctypes.CDLL(None).capset(header, (ctypes.c_uint32 * 6)()) != 0:
            raise
        return
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)


def _relayed(number: int) -> None:
    """Let another process do the command's work, and write here what that one writes to a file's
    number; this one then ends as that one does."""
    reader, writer = os.pipe()
    at_work = os.fork()
    if at_work == 0:
        os.close(reader)
        os.dup2(writer, number)
        os.close(writer)
        return
    os.close(writer)
    while said := os.read(reader, 65536):
        os.write(number, said)
    os._exit(os.waitstatus_to_exitcode(os.waitpid(at_work, 0)[1]))


def _no_link(*_: object, **__: object) -> None:
    raise OSError(errno.EPERM, os.strerror(errno.EPERM))


def prepare(server: Server, given: Path) -> None:
    """Make what the commands read."""
    given.mkdir()
    still = ("protocol=static", "out={0}.zarr")
    for name, *options in (
        ("means", "recordings=100", "output=means", "duration_s=60", "split=[60, 20, 20]"),
        ("rest", "recordings=6", "rate_hz=10", "duration_s=100"),
    ):
        _made(server.run(given, "sim.generate", *options, *(o.format(name) for o in still)))
    train = ("data=means.zarr", "steps=4", "windows_s=[10,30]", "model=bilstm_8")
    _made(server.run(given, "lbgc.train", *train))
    rng, heading = np.random.Generator(np.random.SFC64(1)), np.arange(0, 360, 30.0)
    rates = 0.0028 * np.cos(np.deg2rad(heading)), -0.0028 * np.sin(np.deg2rad(heading))
    rows = np.stack([heading, *rates, np.full(12, -0.0031)], 1)
    rows[:, 1:] += 1e-5 * rng.standard_normal((12, 3))
    head = "heading_deg,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"
    log = np.array([0, -0.0028, -0.0031, 0, 0, -1]) + 1e-4 * rng.standard_normal((3000, 6))
    stamped = np.column_stack([np.arange(3000) / 100, log])
    names = "time (s),gx (deg/s),gy (deg/s),gz (deg/s),ax (g),ay (g),az (g)"
    np.savetxt(given / "log.csv", stamped, delimiter=",", header=names, comments="", fmt="%.7g")
    np.savetxt(given / "means.csv", rows, delimiter=",", header=head, comments="")


def _made(done: Ended) -> None:
    assert done.code == 0, done.err


class Faults:
    """Each method is a fault: it runs a command in it, and says what was wrong with how the command
    ended, or nothing; None where the command cannot meet it."""

    def __init__(self, server: Server, home: Path, rng: np.random.Generator):
        self.server, self.given, self.rng = server, home / "given", rng
        self.home, self._count = home, 0
        self._spans: dict[str, float] = {}

    def names(self) -> list[str]:
        return [name for name in vars(Faults) if name[0] != "_" and name != "names"]

    def full_disk(self, module: str) -> str | None:
        with self._place() as cwd, _small_disk(cwd) as enlarge:
            if enlarge is None:
                return None  # as where the largest file is limited
            little = module in ("sim.scene", "lbgc.calibrate", "lbgc.compare")
            pages = 0 if little else int(self.rng.integers(4))
            (cwd / "filling").write_bytes(b"x" * 4096 * (6 - pages))
            done = self._run(cwd, module)
            enlarge()
            return self._wrong(done, [2], again=(cwd, module))

    def largest_file(self, module: str) -> str | None:
        with self._place() as cwd:
            return self._wrong(self._run(cwd, module, largest=60), [2], again=(cwd, module))

    def read_only(self, module: str) -> str | None:
        with self._place(0o555) as cwd:
            return self._wrong(self._run(cwd, module, unprivileged=True), [2])

    def unreadable(self, module: str) -> str | None:
        own, value = COMMANDS[module][0].split("=", 1)
        if own not in READS:
            return None
        closed = Path(value.format(given=self.given)).resolve()
        before = closed.stat().st_mode
        try:
            closed.chmod(0)
            with self._place() as cwd:
                done = self._run(cwd, module, unprivileged=True)
        finally:
            closed.chmod(before)
        wrong = self._wrong(done, [2])
        return wrong or ("" if "ermission denied" in done.err else f"names no cause: {done.err}")

    def no_links(self, module: str) -> str | None:
        with self._place() as cwd:
            return self._wrong(self._run(cwd, module, links=False), [0])

    def long_name(self, module: str) -> str | None:
        options = dict(o.split("=", 1) for o in COMMANDS[module])
        for key in ("out", *READS):
            if key in options:
                end = ".png" if module == "sim.scene" else ""
                with self._place() as cwd:
                    return self._wrong(self._run(cwd, module, f"{key}={LONG}{end}"), [2])
        return None

    def closed_pipe(self, module: str) -> str | None:
        with self._place() as cwd:
            return self._wrong(self._run(cwd, module, out="closed pipe"), [141])

    def full_output(self, module: str) -> str | None:
        with self._place() as cwd:
            return self._wrong(self._run(cwd, module, out="/dev/full"), [2])

    def closed_output(self, module: str) -> str | None:
        with self._place() as cwd:
            return self._wrong(self._run(cwd, module, out="closed"), [0])

    def terminated(self, module: str) -> str | None:
        return self._told(module, signal.SIGTERM)

    def hung_up(self, module: str) -> str | None:
        return self._told(module, signal.SIGHUP)

    def remote(self, module: str) -> str | None:
        options = dict(o.split("=", 1) for o in COMMANDS[module])
        for key in ("data", "out"):
            if key in options and module not in ("sim.scene", "lbgc.export"):
                wrongs = []
                for url in ("s3://no/d.zarr", "gs://no/d.zarr", "nowhere://x/y",
                            "http://127.0.0.1:9/d.zarr", "ftp://127.0.0.1:9/d"):  # fmt: skip
                    with self._place() as cwd:
                        wrongs.append(self._wrong(self._run(cwd, module, f"{key}={url}"), [2]))
                return "".join(wrongs)
        return None

    @contextmanager
    def _place(self, mode: int = 0o777) -> Iterator[Path]:
        """A new directory to run in."""
        self._count += 1
        cwd = self.home / str(self._count)
        cwd.mkdir()
        cwd.chmod(mode)
        yield cwd

    def _arguments(self, module: str, changed: tuple[str, ...]) -> list[str]:
        keys = {option.split("=")[0] for option in changed}
        own = [o.format(given=self.given) for o in COMMANDS[module]]
        return [o for o in own if o.split("=")[0] not in keys] + list(changed)

    def _run(self, cwd: Path, module: str, *changed: str, **how: Any) -> Ended:
        return self.server.run(cwd, module, *self._arguments(module, changed), **how)

    def _told(self, module: str, number: int) -> str:
        """Told to end by a signal, at any moment."""
        if module not in self._spans:
            started = time.monotonic()
            with self._place() as cwd:
                self._run(cwd, module)
            self._spans[module] = time.monotonic() - started
        with self._place() as cwd:
            process = self.server.begun(cwd, module, *self._arguments(module, ()))
            time.sleep(0.2 + self.rng.uniform() * 0.8 * self._spans[module])
            with suppress(ProcessLookupError):  # it was over
                os.kill(process, number)
            return self._wrong(self.server.ended(), [128 + number, 0], again=(cwd, module))

    def _wrong(self, done: Ended, codes: list[int], again: tuple[Path, str] | None = None) -> str:
        """What is wrong with how a command ended, if these exit codes are right. again : where the
        same command must then succeed."""
        wrong = "" if done.code in codes else f"exit code {done.code}; "
        if "Traceback" in done.err or len(done.lines) > 1 or (done.code and not done.lines):
            wrong += f"said {done.err[-3000:]}"
        if again is not None and (later := self._run(*again)).code != 0:
            wrong += f"and again: {later.code} {later.err[-1000:]}"
        return wrong


@contextmanager
def _small_disk(where: Path) -> Iterator[Callable[[], object] | None]:
    """A file system in memory with room for next to nothing, and what makes it larger; None where
    mounting one is not allowed."""
    mount = ["mount", "-t", "tmpfs", "-o", "size=24k,mode=777", "none", str(where)]
    if subprocess.run(mount, capture_output=True).returncode != 0:
        yield None
        return
    try:
        larger = ["mount", "-o", "remount,size=50m", str(where)]
        yield lambda: subprocess.run(larger, check=True)
    finally:
        subprocess.run(["umount", str(where)], check=True)


def left_of(session: int) -> list[int]:
    """The processes of a session, those that have ended left out."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, own = stat.read_text().rsplit(")", 1)[1].split()[:4]
        except OSError:
            continue  # ended meanwhile
        if int(own) == session and state != "Z":
            found.append(int(stat.parent.name))
    return found


if __name__ == "__main__":
    from conftest import ENTRY_POINTS

    import sim.generate
    from lbgc.commands import run_main

    sim.generate.try_picture = lambda *_: None
    wanted = serve()
    _become(**wanted)
    run_main(*ENTRY_POINTS[wanted["argv"][0]])
