"""Would transactions (Icechunk) keep our datasets better than our own manifest does?

    make study-transactional

The same recordings, in the same shards and chunks, are written to a directory as the product writes
it, and to an Icechunk repository in a directory (`transactional_stores.py`). Compared are bytes,
files and time; what kills, two processes at once and damage do (`transactional_harm.py`); what many
shards cost; what a reader without Icechunk is left with; and the lines of our code that would go.
Icechunk is installed below the outputs, for this study alone; where it cannot be, the study says so
and has our own figures only.
"""

import ast
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from multiprocessing import set_forkserver_preload
from pathlib import Path
from statistics import median

import xarray
import zarr
from common import Report, cases
from helpers import ROOT
from transactional_harm import Side, collect, damages, kills, races, size, without_crc32c
from transactional_stores import Icechunk, Ours, digest, kept, made

from lbgc import machine

CASES = cases("transactional")


def install(report: Report, where: Path) -> bool:
    """Whether Icechunk can be imported, here and in the processes that are started from now on."""
    version = CASES["icechunk"]
    if version is None:
        report.line("Icechunk is left out")
        return False
    if not (where / f"icechunk-{version}.dist-info").exists():
        shutil.rmtree(where, ignore_errors=True)
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        options = ["--retries", "0", "--no-deps", "--target", str(where), f"icechunk=={version}"]
        done = subprocess.run([*pip, *options], capture_output=True, text=True)
        if done.returncode != 0:
            why = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            report.line(f"Icechunk is left out, it cannot be installed: {why}")
            return False
    sys.path.append(str(where.resolve()))
    before = [p for p in [os.environ.get("PYTHONPATH")] if p]
    os.environ["PYTHONPATH"] = os.pathsep.join([*before, str(where.resolve())])
    report.line(f"icechunk {version}, zarr {zarr.__version__}, xarray {xarray.__version__}")
    report.summary["icechunk_package_mb"] = size(where) / 1e6
    return True


def cpu(call: Callable[[], object]) -> float:
    """Processor seconds of this process, all threads together."""
    started = time.process_time()
    call()
    return time.process_time() - started


def wall_ms(call: Callable[[], object]) -> float:
    """Median milliseconds of opening."""
    spans = []
    for _ in range(CASES["openings"]):
        started = time.perf_counter()
        call()
        spans.append(time.perf_counter() - started)
    return 1e3 * median(spans)


def costs(report: Report, home: Path, sides: dict[str, Side]) -> None:
    """Bytes, files and time, of a dataset of each kind."""
    for kind, options in CASES["kinds"].items():
        data, spans = made(tuple(options)), {}
        ways = {name: side.write for name, side in sides.items()}
        if "icechunk" in sides:
            ways["icechunk_through_zarr"] = partial(Icechunk().write, through_zarr=True)
        paths = {name: home / f"{kind} {name}" for name in ways}
        for _ in range(CASES["repeats"]):
            for name, write in ways.items():
                shutil.rmtree(paths[name], ignore_errors=True)
                spans.setdefault((name, "write"), []).append(cpu(lambda: write(paths[name], data)))  # noqa: B023
        report.line(f"{kind}: {data.layout.recordings} recordings, {data.layout.shards} shards")
        expected = None
        for name, side in sides.items():
            path = paths[name]
            for _ in range(CASES["repeats"]):
                spans.setdefault((name, "read"), []).append(cpu(lambda: digest(side.open(path))))  # noqa: B023
                check = side.verify if isinstance(side, Ours) else lambda p: digest(side.open(p))  # noqa: B023
                spans.setdefault((name, "verify"), []).append(cpu(lambda: check(path)))  # noqa: B023
            expected = expected or digest(side.open(path))
            assert digest(side.open(path)) == expected, "both hold the same"
            spans[name, "open"] = [wall_ms(lambda: side.open(path)) / 1e3]  # noqa: B023
        say_costs(report, kind, {k: median(v) for k, v in spans.items()}, paths)


def say_costs(
    report: Report, kind: str, spans: dict[tuple[str, str], float], paths: dict[str, Path]
) -> None:
    for name, path in paths.items():
        own = {"mb": size(path) / 1e6, "files": len(kept(path))}
        own |= {
            f"{what}_cpu_s": spans[n, what] for n, what in spans if n == name and what != "open"
        }
        if (name, "open") in spans:
            own["open_ms"] = 1e3 * spans[name, "open"]
        report.line(f"  {name:24s}" + ", ".join(f"{k} {v:.4g}" for k, v in own.items()))
        report.summary |= {f"{kind}_{name}_{k}": v for k, v in own.items()}
        for key, value in own.items() if name != "ours" else ():
            before = report.summary[f"{kind}_ours_{key}"]
            assert isinstance(before, int | float)
            report.summary[f"{kind}_{name}_{key}_over_ours"] = value / before


def growth(report: Report, home: Path, sides: dict[str, Side]) -> None:
    """What one more shard costs when there are many."""
    data, path = made(tuple(CASES["growth"]["options"])), home / "grown"
    report.line("many shards of means:")
    for shards in CASES["growth"]["shards"]:
        for name, side in sides.items():
            many = data.repeated(shards)
            shutil.rmtree(path, ignore_errors=True)
            own = {"write_ms_a_shard": 1e3 * cpu(partial(side.write, path, many)) / shards}
            own |= {"kb_a_shard": size(path) / shards / 1e3, "files": len(kept(path))}
            own["open_ms"] = wall_ms(partial(side.open, path))
            own["going_on_ms"] = 1e3 * cpu(partial(side.unfinished, path, many))
            if isinstance(side, Icechunk) and side.each:
                Icechunk().repository(path).expire_snapshots(datetime.now(UTC))
                own["collecting_ms"] = 1e3 * collect(path)
                own["kb_a_shard_when_collected"] = size(path) / shards / 1e3
            report.line(
                f"  {shards:4d} {name:22s}" + ", ".join(f"{k} {v:.4g}" for k, v in own.items())
            )
            report.summary |= {f"{shards}_shards_{name}_{k}": v for k, v in own.items()}


def equal_runs(report: Report, home: Path, sides: dict[str, Side]) -> None:
    """Whether two equal runs give equal bytes."""
    data = made(tuple(CASES["damage"]["damaged"]))
    for name, side in sides.items():
        first, second = home / f"first {name}", home / f"second {name}"
        side.write(first, data)
        side.write(second, data)
        one, two = kept(first).items(), kept(second).items()
        share = 100 * len(set(one) & set(two)) / len(one)
        report.line(f"two equal runs, {name}: {share:.0f}% of the files equal in name and bytes")
        report.summary[f"{name}_equal_files_pct"] = share
        report.summary[f"{name}_equal_digests"] = digest(side.open(first)) == digest(
            side.open(second)
        )


def plain(report: Report, home: Path, sides: dict[str, Side]) -> None:
    """What somebody is given who has xarray and a path."""
    data = made(tuple(CASES["damage"]["damaged"]))
    for name, side in sides.items():
        path = home / f"plain {name}"
        side.write(path, data)
        try:
            variables = len(xarray.open_zarr(path).variables)
            said = f"{variables} variables"
        except Exception as error:
            variables, said = 0, f"{type(error).__name__}: {error}".replace(str(path), "d.zarr")
        report.line(f"xarray.open_zarr(path), {name}: {said}")
        report.summary |= {f"{name}_plain_xarray_variables": variables}
        if isinstance(side, Icechunk):
            found = xarray.open_zarr(side.open(path).store, consolidated=False)
            report.summary[f"{name}_xarray_with_icechunk_variables"] = len(found.variables)


def code_lines(file: Path) -> dict[str, int]:
    """Lines of code of each function, method and class of a file; without docstrings, comments and
    empty lines."""
    text = file.read_text()
    filled = {
        i
        for i, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    }
    found: dict[str, int] = {}

    def walk(node: ast.AST, above: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                first = min([child.lineno, *(d.lineno for d in child.decorator_list)])
                own = filled & set(range(first, (child.end_lineno or first) + 1))
                found[above + child.name] = len(own - documented(child))
                walk(child, f"{above}{child.name}.")

    walk(ast.parse(text), "")
    return found


def documented(node: ast.AST) -> set[int]:
    """Lines of all strings that stand by themselves below a node."""
    strings = (
        n
        for n in ast.walk(node)
        if isinstance(n, ast.Expr)
        and isinstance(n.value, ast.Constant)
        and isinstance(n.value.value, str)
    )
    return {i for s in strings for i in range(s.lineno, (s.end_lineno or s.lineno) + 1)}


def lines(report: Report) -> None:
    """Lines of our code that Icechunk would save, and those that it would cost."""
    for what in ("goes", "checking", "comes"):
        total, gone = 0, []
        for file, names in CASES[what].items():
            counted = code_lines(ROOT / file)
            gone += [f"{file}: {name}" for name in names if name not in counted]
            own = sum(counted.get(name, 0) for name in names)
            report.line(f"lines, {what}: {own:4d} of {file}: {', '.join(names)}")
            total += own
        for name in gone:
            report.line(f"  not found, so not counted: {name}")
        report.summary |= {f"code_lines_{what}": total, f"code_{what}_names_not_found": len(gone)}
    every = (ROOT / "lbgc/data").glob("*.py")
    whole = sum(sum(n for name, n in code_lines(f).items() if "." not in name) for f in every)
    report.line(f"lines, all functions of lbgc/data/*.py: {whole}")
    report.summary["code_lines_data"] = whole


def main(report: Report, home: Path) -> None:
    sides: dict[str, Side] = {"ours": Ours()}
    installed = install(report, report.directory / "packages")
    report.summary["icechunk_installed"] = installed
    if installed:
        sides |= {"icechunk": Icechunk(), "icechunk_one_commit": Icechunk(each=False)}
    lines(report)
    costs(report, home, sides)
    growth(report, home, sides)
    equal_runs(report, home, sides)
    plain(report, home, sides)
    kills(report, home, CASES["killed"] | {"seed": CASES["seed"]}, sides)
    harmed = {name: side for name, side in sides.items() if name != "icechunk_one_commit"}
    damages(report, home, CASES["damage"] | {"seed": CASES["seed"]}, harmed)
    if installed:
        races(report, home, CASES["killed"])
        without_crc32c(report, home, CASES["damage"] | {"seed": CASES["seed"]})


if __name__ == "__main__":
    set_forkserver_preload(["transactional_stores", "transactional_harm", "xarray"])
    os.environ[machine.VERIFY] = "1"  # what was found whole before is read again
    with Report("studies/transactional") as study, tempfile.TemporaryDirectory() as temporary:
        os.environ["XDG_CACHE_HOME"] = temporary
        main(study, Path(temporary))
