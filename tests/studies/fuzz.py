"""Does any reader of outside data crash, hang, overrun, or do what a file tells it to?

    make study-fuzz

Valid examples of every kind (logs, configurations, checkpoints, models, stores, manifests) are
spoiled in many ways, checksums made to fit in a share of them, and read in worker processes that
have 1 GB of memory and 10 s of a core a file (a minute, where it sleeps). A reading must end in
InputError or in a possible answer (the right one, where checksums are kept), and must not, as an
audit hook sees it, import a module, start a process, reach for the network, or open what lies
outside its directory.

Then whole command lines with directories that are brought along (`--config-dir`), made to have
something run, read, written or told (tests/escapes.py): whether any gets out.
Beside, whole datasets and models are forged, one value each under right checksums, and given to
every command that reads them (`tests/forging.py`): none may end in anything but InputError or
numbers.
"""

import codecs
import json
import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing.process import BaseProcess
from multiprocessing.sharedctypes import SynchronizedArray
from pathlib import Path
from typing import Any

import numpy as np
from common import Report, cases
from forging import Forger, tried
from fuzzing import EDITS, PLANTS, Bench, Reader, Step, exported, onnx_reader, readers
from tqdm import tqdm

from lbgc.data.readers.formats import child
from lbgc.errors import InputError

CASES = cases("fuzz")
FORBIDDEN = ("subprocess.", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork",
             "pty.", "socket.", "urllib.", "ftplib.", "smtplib.", "pickle.", "marshal.",
             "ctypes.")  # fmt: skip
READING = (sys.executable, "-P", "-m", child.__name__)
"""The process in which some formats are read."""
ONNX = "example.onnx"


class Watch:
    """What the audit hook saw while a file was read."""

    def __init__(self) -> None:
        self.home: str | None = None
        self.seen: list[str] = []
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.home is None:
            return
        is_ours = event == "subprocess.Popen" and tuple(arguments[1][:4]) == READING
        if event == "import" or (event.startswith(FORBIDDEN) and not is_ours):
            self.seen.append(f"{event} {arguments[:1]}")
        elif event == "open" and isinstance(arguments[0], str | bytes):
            path = os.path.abspath(os.fsdecode(arguments[0]))
            cache = os.environ["XDG_CACHE_HOME"]  # where it remembers what was whole
            if not path.startswith((self.home, cache, "/proc/self/", "/sys/")):
                self.seen.append(f"open {path}")


def case(kind: str, reader: Reader, seed: int, number: int) -> tuple[str, list[Step], bool]:
    """Which file of the example is spoiled, how, and whether its checksums are made to fit."""
    rng = np.random.default_rng([seed, number, *kind.encode()])
    targets = list(reader.targets or reader.files)
    names = list(EDITS)
    count = int(rng.geometric(0.6))
    steps = [
        (names[rng.integers(len(names))], float(rng.uniform()), int(rng.integers(2**31)))
        for _ in range(count)
    ]
    if rng.uniform() < CASES["planted"]:
        steps = [(PLANTS[rng.integers(len(PLANTS))], 0.0, int(rng.integers(2**31)))]
    return targets[rng.integers(len(targets))], steps, bool(rng.uniform() < CASES["forged"])


def work(home: str, first: int, every: int, at: SynchronizedArray, report: Any) -> None:
    """A worker: the numbers first, first + every... of all cases, in order.

    at : [number, when it was begun (s, 0 between two), processor time until then]. report : a
    pipe's end that hears (kind, refused or answered or what went wrong, which).
    """
    import torch

    torch.set_num_threads(1)
    for encoding in ("utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"):  # which a table may have
        codecs.lookup(encoding)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # progress bars, and what libraries say of a file
    own = Path(tempfile.mkdtemp(dir=home))
    os.environ["XDG_CACHE_HOME"] = str(own / "cache")
    kinds = readers(own)
    if (onnx := Path(home) / ONNX).exists():
        kinds["onnx"] = onnx_reader(onnx.read_bytes())
    others = [next(iter(reader.files.values())) for reader in kinds.values()]
    benches = {n: Bench(own / "cases" / n.replace(" ", "_"), r, others) for n, r in kinds.items()}
    limit = int(CASES["memory_bytes"])
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    watch = Watch()
    for kind, bench in benches.items():
        for number in range(CASES["warming_up"]):
            attempt(watch, bench, *case(kind, kinds[kind], CASES["seed"] + 1, number))
    number = 0
    for kind, count in CASES["files"].items():
        for i in range(count):
            number += 1
            if kind not in benches or number < first or (number - first) % every:
                continue
            chosen = case(kind, kinds[kind], CASES["seed"], i)
            at[0], at[1], at[2] = number, time.monotonic(), spent(os.getpid())
            found = attempt(watch, benches[kind], *chosen)
            at[1] = 0.0
            report.send((kind, found, f"{kind} {i}: {chosen}"))
    report.send(None)


def attempt(
    watch: Watch, bench: Bench, target: str, steps: list[Step], forged: bool
) -> tuple[str, str]:
    """(refused, answered or wrong; what is wrong)."""
    bench.spoil(target, steps, forged)
    watch.seen.clear()
    watch.home = str(bench.place)
    try:
        wrong, how = bench.verdict(bench.reader.read(bench.place), steps, forged), "answered"
    except InputError:
        wrong, how = None, "refused"
    except BaseException as error:
        wrong, how = f"{type(error).__name__}: {error}"[:300], "wrong"
    watch.home = None
    if watch.seen:
        wrong = f"did what it must not: {watch.seen[:3]}"[:300]
    bench.mend()
    return ("wrong", wrong) if wrong else (how, "")


def forged(home: str, first: int, every: int) -> list[tuple[int, str, str | None]]:
    """A worker's forgeries, the numbers first, first + every...: which, the command, and what went
    wrong."""
    import torch

    torch.set_num_threads(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    forger = Forger.at(Path(tempfile.mkdtemp(dir=home)))
    limit = int(CASES["command_memory_bytes"])
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    found = []
    for number in range(first, CASES["commands"], every):
        started = time.monotonic()
        name, wrong = tried(forger, CASES["seed"], number)
        late = time.monotonic() - started > CASES["command_seconds"]
        found.append((number, name, "took more than its time" if late and not wrong else wrong))
    return found


LEAN = {"ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "1",
        "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # fmt: skip
"""Libraries reserve memory that they may never use, and the limit counts it."""


def spent(process: int | None) -> float:
    """Processor time of a process and its children, s: it does not pass while others have the
    cores."""
    found = 0.0
    try:
        own = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        found = sum(map(int, own[11:15])) / os.sysconf("SC_CLK_TCK")
        children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
        found += sum(spent(int(child)) for child in children)
    except OSError:  # it has ended
        pass
    return found


class Crew:
    """The workers, each begun again where one is lost."""

    def __init__(self, home: str, every: int):
        self.home, self.every = home, every
        os.environ.update(LEAN)
        self.context = multiprocessing.get_context("spawn")
        self.members = [self._begin(first + 1) for first in range(every)]

    def _begin(self, first: int) -> tuple[BaseProcess, SynchronizedArray, Any, int]:
        ours, theirs = self.context.Pipe(duplex=False)
        at = self.context.Array("d", [first - self.every, 0.0, 0.0])
        arguments = (self.home, first, self.every, at, theirs)
        process = self.context.Process(target=work, args=arguments, daemon=True)
        process.start()
        theirs.close()
        return process, at, ours, first

    def heard(self) -> Any:
        """Every message, until all workers have ended."""
        running = set(range(self.every))
        while running:
            time.sleep(0.1)
            for i in sorted(running):
                process, at, ours, first = self.members[i]
                begun = at[1]
                taken = time.monotonic() - begun if begun > 0 else 0.0
                late = taken > CASES["seconds"] and (
                    taken > CASES["asleep_seconds"] or spent(process.pid) - at[2] > CASES["seconds"]
                )
                alive = process.is_alive()
                if late:
                    process.kill()
                    process.join()
                ended = False
                try:
                    while ours.poll():
                        message = ours.recv()
                        ended = ended or message is None
                        if message is not None:
                            yield message
                except (EOFError, OSError):
                    pass
                if ended:
                    running.remove(i)
                    process.join()
                elif late or not alive:
                    process.join()
                    number = int(at[0])
                    if begun == 0 and not late and number < first:
                        raise RuntimeError(f"a worker could not begin: exit {process.exitcode}")
                    what = "took more than its time" if late else f"crashed ({process.exitcode})"
                    yield "lost", ("wrong", what), f"number {number}"
                    self.members[i] = self._begin(number + self.every)


def main() -> None:
    with Report("studies/fuzz") as study, tempfile.TemporaryDirectory(dir=_fast()) as home:
        onnx = exported(Path(home))
        if onnx is None:
            study.line("exported networks are left out: the extra onnx is not installed")
        else:
            (Path(home) / ONNX).write_bytes(onnx)
        counts: dict[str, Counter[str]] = {kind: Counter() for kind in (*CASES["files"], "lost")}
        total = sum(CASES["files"].values())
        bar = tqdm(total=total, unit="file", mininterval=5, disable=not sys.stderr.isatty())
        with bar:
            for kind, (how, why), which in Crew(home, CASES["workers"]).heard():
                counts[kind][how] += 1
                if how == "wrong":
                    study.line(f"{which}: {why}")
                bar.update()
        study.line(f"{'reader':18s}{'files':>8s}{'refused':>9s}{'answered':>9s}{'wrong':>7s}")
        for kind, count in counts.items():
            found = [count[how] for how in ("refused", "answered", "wrong")]
            study.line(f"{kind:18s}{sum(found):8d}{found[0]:9d}{found[1]:9d}{found[2]:7d}")
            study.summary[f"{kind.replace(' ', '_')}_files"] = sum(found)
        wrong = 0
        with ProcessPoolExecutor(CASES["workers"], multiprocessing.get_context("spawn")) as pool:
            every = CASES["workers"]
            tasks = [pool.submit(forged, home, first, every) for first in range(every)]
            done = [own for task in tasks for own in task.result()]
        for number, name, why in sorted(done, key=lambda own: own[0]):
            wrong += why is not None
            if why is not None:
                study.line(f"forgery {number}, {name}: {why}")
        study.line(f"{'commands':18s}{len(done):8d} forgeries, {wrong} wrong")
        study.summary |= {"forged_cases": len(done), "forged_tracebacks": wrong}
        study.summary |= {
            "mutated_files": sum(sum(count.values()) for count in counts.values()),
            "reader_crashes": sum(count["wrong"] for count in counts.values()),
        }
        audit(study)


def audit(study: Report) -> None:
    """Attempts to get out, in as many processes as workers."""
    program, total = str(Path(__file__).parents[1] / "escapes.py"), CASES["audit"]
    bounds = np.linspace(0, total, CASES["workers"] + 1).astype(int)
    processes = [
        subprocess.Popen(
            [sys.executable, program, *map(str, (CASES["seed"], first, after - first))],
            stdout=subprocess.PIPE, text=True,
        )
        for first, after in pairwise(bounds)
    ]  # fmt: skip
    found = [json.loads(process.communicate()[0]) for process in processes]
    escapes = [said for one in found for said in one["escapes"]]
    for said in escapes:
        study.line(said)
    study.line(f"{total} configurations and command lines tried, {len(escapes)} got out")
    study.summary |= {"audit_variants": total, "audit_escapes": len(escapes)}


def _fast() -> str | None:
    """A file system in memory, where there is one: files are written and read and never kept."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


if __name__ == "__main__":
    main()
