"""What `transactional.py` does to both stores: kills, races of two processes, and damage."""

import os
import shutil
import signal
import time
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import zarr
from common import Report
from corruption import flip, truncate
from tqdm import tqdm
from transactional_stores import Icechunk, Made, Ours, digest, kept, made, put_documents, put_values

Side = Ours | Icechunk


def mark(file: Path) -> None:
    """One byte more in a file: another shard's writing has begun."""
    descriptor = os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(descriptor, b".")
    os.close(descriptor)


def written(side: Side, path: Path, data: Made, two: bool, marks: Path, ready: Any) -> None:
    """Write a dataset that is in memory, as a process that heads a group of its own."""
    os.setpgid(0, 0)
    ready.send(None)
    if two:
        side.write_with_two(path, data, partial(mark, marks), os.getpid())
    else:
        side.write(path, data, partial(mark, marks))


class Writing:
    """Such a process, from the moment at which it begins to write: where two others write for it,
    at which one of them begins."""

    def __init__(self, side: Side, path: Path, data: Made, two: bool):
        shutil.rmtree(path, ignore_errors=True)
        self._marks = path.with_suffix(".begun")
        self._marks.unlink(missing_ok=True)
        context = get_context("forkserver")
        ready, told = context.Pipe(duplex=False)
        arguments = (side, path, data, two, self._marks, told)
        self.process = context.Process(target=written, args=arguments)
        self.process.start()
        ready.recv()
        while two and not self._marks.exists() and self.process.is_alive():
            time.sleep(0.0005)
        self.started = time.monotonic()

    def whole(self) -> float:
        """Its time in seconds, when it has ended."""
        self.process.join()
        assert self.process.exitcode == 0
        return time.monotonic() - self.started

    def killed(self) -> int | None:
        """How many shards it had begun, after it and all who work for it were killed; None where it
        had finished before."""
        in_time = self.process.is_alive()
        if in_time:
            os.killpg(self.process.pid or 0, signal.SIGKILL)
        self.process.join()
        assert self.process.exitcode in (0, -signal.SIGKILL), "it failed before it was killed"
        time.sleep(0.02)  # those who worked for it are not this process's to wait for
        begun = self._marks.stat().st_size if self._marks.exists() else 0
        return begun if self.process.exitcode != 0 else None


def size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def collect(path: Path) -> float:
    """Let Icechunk delete what no commit needs; the seconds that it takes."""
    repository, started = Icechunk().repository(path), time.perf_counter()
    repository.garbage_collect(datetime.now(UTC))
    return time.perf_counter() - started


def kills(report: Report, home: Path, case: dict, sides: dict[str, Side]) -> None:
    data, path = made(tuple(case["options"])), home / "killed"
    shards = data.layout.shards
    report.line(f"killed at a random moment of writing {shards} shards, and run again:")
    for name, side in sides.items():
        for how, count in case["kills"].items():
            two, rng = how == "two", np.random.default_rng([case["seed"], len(name), len(how)])
            span = median(Writing(side, path, data, two).whole() for _ in range(case["timed"]))
            unused = size(path)
            if isinstance(side, Icechunk):
                collect(path)
            report.summary[f"{name}_{how}_garbage_mb_without_kill"] = (unused - size(path)) / 1e6
            whole = digest(side.open(path)), kept(path)
            found: dict[str, list[float]] = {}
            with tqdm(total=count, desc=f"{name}, {how}", leave=False, disable=None) as bar:
                while len(found.get("differs", [])) < count:
                    run = Writing(side, path, data, two)
                    time.sleep(rng.uniform() * span)
                    begun = run.killed()
                    if begun is None:
                        continue
                    for key, value in after(side, path, data, begun, whole).items():
                        found.setdefault(key, []).append(value)
                    bar.update()
            told(report, name, how, span, found)


def after(
    side: Side, path: Path, data: Made, begun: int, whole: tuple[str, dict[str, bytes]]
) -> dict[str, float]:
    """What is found after a kill, and when the same command has run again. whole : digest and files
    of a dataset whose writing nobody disturbed."""
    found = {"refused": 0.0, "differs": 1.0, "again": float(begun)}
    try:
        found["again"] -= data.layout.shards - len(side.unfinished(path, data))
        side.write(path, data)
    except Exception:
        return found | {"refused": 1.0}
    found["differs"] = float(digest(side.open(path)) != whole[0])
    found["left"] = float(size(path))
    if isinstance(side, Ours):
        side.verify(path)
        found["left"] -= sum(map(len, whole[1].values()))
        found["left_files"] = float(kept(path) != whole[1])
        return found
    found["collecting"] = collect(path)
    found["left"] -= size(path)
    found["left_files"] = float(len(kept(path)) - len(whole[1]))
    found["differs"] = max(found["differs"], float(digest(side.open(path)) != whole[0]))
    return found


def told(report: Report, name: str, how: str, span: float, found: dict[str, list[float]]) -> None:
    def largest(key: str) -> float:
        return max(found.get(key, [0.0]))

    left = np.array(found.get("left", [0.0])) / 1e6
    done, share = len(found["differs"]), 100 * np.mean(left > 0)
    differ, refused = (int(sum(found[key])) for key in ("differs", "refused"))
    report.line(
        f"  {name:22s}{how:6s}{done:4d} kills in {span:.2f} s; differ {differ}, refused {refused}; "
        f"shards made twice {np.mean(found['again']):.1f} (at most {largest('again'):.0f}); "
        f"garbage after {share:.0f}%, {left.mean():.3f} MB (at most {left.max():.3f}); "
        f"files left in the end {largest('left_files'):.0f}"
    )
    key = f"{name}_{how}"
    report.summary |= {
        f"{key}_kills": done,
        f"{key}_differ_after_kill": differ,
        f"{key}_refused_after_kill": refused,
        f"{key}_shards_twice_mean": float(np.mean(found["again"])),
        f"{key}_shards_twice_most": int(largest("again")),
        f"{key}_garbage_after_pct": float(share),
        f"{key}_garbage_mb_mean": float(left.mean()),
        f"{key}_garbage_mb_most": float(left.max()),
        f"{key}_files_left_most": int(largest("left_files")),
    }
    if "collecting" in found:
        report.summary[f"{key}_collecting_ms"] = 1e3 * median(found["collecting"])


def races(report: Report, home: Path, case: dict) -> None:
    """Two processes that each commit by themselves, into one local directory."""
    data, path, side = made(tuple(case["options"])), home / "raced", Icechunk()
    lost, failed = [], 0
    for _ in tqdm(range(case["races"]), "racing", leave=False, disable=None):
        shutil.rmtree(path, ignore_errors=True)
        try:
            side.race(path, data)
        except Exception:
            failed += 1
            continue
        lost.append(len(side.unfinished(path, data)))
    report.line(
        f"two processes that commit by themselves: {len(lost)} runs without an error, {failed} "
        f"with one; shards committed and gone {sum(lost)} of {len(lost) * data.layout.shards}"
    )
    report.summary |= {
        "icechunk_races": case["races"],
        "icechunk_races_with_an_error": failed,
        "icechunk_races_that_lost_shards": sum(map(bool, lost)),
        "icechunk_race_shards_lost_pct": 100 * sum(lost) / max(1, len(lost) * data.layout.shards),
    }


def kinds(side: Side, names: list[str]) -> dict[str, list[str]]:
    """A store's files by what they are."""
    if isinstance(side, Icechunk):
        found: dict[str, list[str]] = {}
        for name in names:
            found.setdefault(name.split("/")[0], []).append(name)
        return found
    documents = [n for n in names if n.endswith("zarr.json") and not n.startswith("manifest")]
    manifest = [n for n in names if n.startswith("manifest")]
    coordinates = [n for n in names if n.startswith(("time/c", "axis/c"))]
    chunks = [n for n in names if n not in {*documents, *manifest, *coordinates}]
    return {
        "chunks": chunks,
        "documents": documents,
        "coordinates": coordinates,
        "manifest": manifest,
    }


def zero(path: Path, rng: np.random.Generator) -> None:
    """A stretch of a file, half of it at most, that reads as zeros, as after a lost block."""
    content = bytearray(path.read_bytes())
    first = int(rng.integers(max(1, len(content) // 2)))
    end = first + 1 + len(content) // 2
    content[first:end] = bytes(len(content[first:end]))
    path.write_bytes(content)


WAYS: dict[str, Callable[[Path, np.random.Generator], object]] = {
    "a bit flipped": flip,
    "cut short": truncate,
    "deleted": lambda path, _: path.unlink(),
    "zeroed": zero,
}
ANOTHERS = "another's"
"""What is done besides: a file in whose place another of its kind is."""


def noticed(opened: Callable[[], zarr.Group], whole: str) -> str:
    """When a reader is told of damage: on opening (with whatever is checked then), on reading, or
    never, where it is given the same (harmless) or something else (silent)."""
    try:
        group = opened()
    except BaseException as error:  # Rust's panics are no Exceptions
        return _unless_interrupted(error, "open")
    try:
        return "harmless" if digest(group) == whole else "silent"
    except BaseException as error:
        return _unless_interrupted(error, "read")


def _unless_interrupted(error: BaseException, what: str) -> str:
    if isinstance(error, KeyboardInterrupt | SystemExit):
        raise error
    return what


def damages(report: Report, home: Path, case: dict, sides: dict[str, Side]) -> None:
    """Every way of damage, equally often, to every kind of file."""
    data = made(tuple(case["damaged"]))
    for name, side in sides.items():
        whole, path = home / f"whole {name}", home / "damaged"
        side.write(whole, data)
        expected, files = digest(side.open(whole)), kept(whole)
        tried = Tried(side, data, expected, case["seconds"])
        counts: dict[tuple[str, str, str], Counter[str]] = {}
        for kind, names in kinds(side, sorted(files)).items():
            for way in (*WAYS, ANOTHERS):
                rng = np.random.default_rng([case["seed"], len(kind), len(way)])
                for _ in tqdm(
                    range(case["each"]), f"{name}, {kind}, {way}", leave=False, disable=None
                ):
                    shutil.rmtree(path, ignore_errors=True)
                    shutil.copytree(whole, path)
                    if not damage(path, files, names, way, rng):
                        continue
                    for reader in (*READERS[type(side)], "again"):
                        said = tried(reader, path)
                        counts.setdefault((reader, kind, way), Counter())[said] += 1
        tried.end()
        tables(report, name, counts)


class Tried:
    """What is tried on damage, in a process that is ended where it takes more than so many seconds:
    a repository whose history leads back to itself is read for ever."""

    def __init__(self, side: Side, data: Made, whole: str, seconds: float):
        self._given, self._seconds = (side, data, whole), seconds
        self._begin()

    def _begin(self) -> None:
        context = get_context("forkserver")
        self._asked, theirs = context.Pipe()
        self._process = context.Process(target=trying, args=(*self._given, theirs), daemon=True)
        self._process.start()
        self._asked.recv()

    def __call__(self, reader: str, path: Path) -> str:
        self._asked.send((reader, path))
        if self._asked.poll(self._seconds):
            return str(self._asked.recv())
        self.end()
        self._begin()
        return "never ended"

    def end(self) -> None:
        self._process.kill()
        self._process.join()


def trying(side: Side, data: Made, whole: str, asked: Any) -> None:
    """In that process: say what is found, and the same command again mends, as it is asked."""
    asked.send(None)
    while True:
        reader, path = asked.recv()
        if reader == "again":
            asked.send("mended" if mended(side, path, data, whole) else "not mended")
        else:
            asked.send(noticed(partial(READERS[type(side)][reader], side, path), whole))


def damage(
    path: Path, files: dict[str, bytes], names: list[str], way: str, rng: np.random.Generator
) -> bool:
    """Damage one of the files of these names; whether that changed it."""
    name = names[int(rng.integers(len(names)))]
    if way in WAYS:
        WAYS[way](path / name, rng)
    else:
        (path / name).write_bytes(files[names[int(rng.integers(len(names)))]])
    return not (path / name).exists() or (path / name).read_bytes() != files[name]


def checked(side: Side, path: Path) -> zarr.Group:
    """As our commands open a dataset."""
    side.verify(path)
    return side.open(path)


def plain(_: Side, path: Path) -> zarr.Group:
    """As Zarr opens it for anybody."""
    return zarr.open_group(path, mode="r", zarr_format=3)


READERS: dict[type, dict[str, Callable[[Any, Path], zarr.Group]]] = {
    Ours: {"product": checked, "plain": plain},
    Icechunk: {"reader": Icechunk.open},
}


def mended(side: Side, path: Path, data: Made, whole: str) -> bool:
    """Whether running the same command again gives a store that reads as it should."""
    try:
        side.write(path, data)
        return digest(side.open(path)) == whole
    except BaseException as error:
        return _unless_interrupted(error, "") != ""


def tables(report: Report, name: str, counts: dict[tuple[str, str, str], Counter[str]]) -> None:
    for reader in dict.fromkeys(reader for reader, _, _ in counts):
        own = {(kind, way): c for (r, kind, way), c in counts.items() if r == reader}
        total: Counter[str] = sum(own.values(), Counter())
        report.line(f"damaged, {name}, {reader}: {sum(total.values())}; {shown(total)}")
        for kind in dict.fromkeys(kind for kind, _ in own):
            for way, found in ((w, c) for (k, w), c in own.items() if k == kind):
                report.line(f"  {kind:14s}{way:16s}{shown(found)}")
        key = f"{name}_{reader}_damages"
        report.summary[key] = sum(total.values())
        for said, count in total.items():
            report.summary[f"{key}_{said.replace(' ', '_')}"] = count
        deleted = own.get(("chunks", "deleted"), Counter())
        report.summary[f"{name}_{reader}_deleted_chunks"] = sum(deleted.values())
        report.summary[f"{name}_{reader}_deleted_chunks_silent"] = deleted["silent"]


def shown(found: Counter[str]) -> str:
    return ", ".join(f"{said} {count}" for said, count in sorted(found.items()))


def without_crc32c(report: Report, home: Path, case: dict) -> None:
    """Whether Icechunk itself checks the chunks' bytes: bits flipped where no codec does."""
    data, side, path = made(tuple(case["damaged"])), Icechunk(), home / "unchecked"
    repository = side.repository(path)
    session = repository.writable_session("main")
    put_documents(session.store, data.documents(crc32c=False))
    for shard in range(data.layout.shards):
        put_values(session.store, data, shard)
    session.commit("all")
    whole, files = digest(side.open(path)), sorted((path / "chunks").iterdir())
    rng, found = np.random.default_rng(case["seed"]), Counter[str]()
    for _ in tqdm(range(case["unchecked"]), "without crc32c", leave=False, disable=None):
        file = files[int(rng.integers(len(files)))]
        intact = file.read_bytes()
        flip(file, rng)
        found[noticed(lambda: side.open(path), whole)] += 1
        file.write_bytes(intact)
    report.line(f"bits flipped in Icechunk's chunks without the crc32c codec: {shown(found)}")
    report.summary |= {
        "icechunk_without_crc32c_flips": case["unchecked"],
        "icechunk_without_crc32c_flips_silent": found["silent"],
    }
