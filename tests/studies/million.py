"""One million recordings as means through a dask cluster, to a local directory and to an object
store, a worker and the scheduler killed on the way.

    make study-million

The scheduler, its workers and the store are processes of their own that listen on 127.0.0.1. The
store is JuiceFS's gateway, which speaks S3 and keeps its objects on this disk; it and s3fs are
installed below outputs/studies/million, and not into the project's environment. Half an hour.
"""

import os
import re
import secrets
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from common import Report, cases
from dask_cluster import WORKER, running

from lbgc.data.place import Place
from lbgc.data.store import Dataset

CASES = cases("million")
ROOT = Path(__file__).parents[2]
HERE = Path("outputs/studies/million").resolve()
_INSTALL = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary=:all:")


def installed() -> Path:
    """The program that serves S3; s3fs is where this process and those that it starts find it."""
    server, client = HERE / "server", HERE / "client"
    if not (server / "bin/juicefs").exists():
        subprocess.run([sys.executable, "-m", "venv", server], check=True)
        subprocess.run([server / "bin/python", *_INSTALL, CASES["server"]], check=True)
    if not (client / "s3fs").exists():
        command = [sys.executable, *_INSTALL, "--target", client, *CASES["client"]]
        subprocess.run(command, check=True)
    sys.path.insert(0, str(client))
    os.environ["PYTHONPATH"] = os.pathsep.join([str(client), *sys.path[1:]])
    return server / "bin/juicefs"


@contextmanager
def bucket(server: Path, home: Path) -> Iterator[str]:
    """The URL of an empty bucket of a server that is ended afterwards.

    home : of its objects and of what it says. It reports to nobody, and its metrics are this
    machine's alone.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    key, secret = secrets.token_hex(8), secrets.token_hex(16)
    os.environ |= {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}", "AWS_ACCESS_KEY_ID": key,
                   "AWS_SECRET_ACCESS_KEY": secret, "AWS_DEFAULT_REGION": "us-east-1",
                   "MINIO_ROOT_USER": key, "MINIO_ROOT_PASSWORD": secret}  # fmt: skip
    documents = f"badger://{home}/documents"
    volume = ("--storage", "file", "--bucket", f"{home}/objects/", "--trash-days", "0")
    serve = ("--no-usage-report", "--metrics", "127.0.0.1:0", "--multi-buckets", "--keep-etag",
             "--cache-size", "0", "--log", f"{home}/gateway.log")  # fmt: skip
    with (HERE / "server.log").open("w") as log:
        said = {"stdout": log, "stderr": log}
        subprocess.run([server, "format", *volume, documents, "study"], check=True, **said)
        command = [server, "gateway", *serve, documents, f"127.0.0.1:{port}"]
        process = subprocess.Popen(command, **said)
    try:
        import s3fs

        for _ in range(100):
            try:
                s3fs.S3FileSystem(skip_instance_cache=True).mkdir("study")
                break
            except OSError:
                time.sleep(0.2)
        yield "s3://study"
    finally:
        process.kill()
        process.wait()


class Command:
    """The command as it is typed, in a process of its own, and the most memory that it held."""

    def __init__(self, out: str, address: str):
        options = [*CASES["options"], f"recordings={CASES['recordings']}", f"out={out}"]
        cluster = ("cluster=dask", f"cluster.address={address}")
        command = [sys.executable, ROOT / "sim/generate.py", *options, *cluster]
        self.log, self.most_mb = HERE / "generate.log", 0.0
        with self.log.open("w") as log:
            self.process = subprocess.Popen(command, stderr=log, stdout=log, cwd=HERE)

    def ends(self, until: Callable[[], bool] = lambda: False, limit_s: float = 1e9) -> int | None:
        """Wait for its end, or until something else is so; its exit code, or None. Raises
        TimeoutError where that takes longer."""
        started = time.monotonic()
        while (code := self.process.poll()) is None and not until():
            # Its own peak: what waiting for it would tell includes this process's, before exec.
            told = Path(f"/proc/{self.process.pid}/status").read_text()
            if (peak := re.search(r"VmHWM:\s+(\d+)", told)) is not None:  # none while it ends
                self.most_mb = max(self.most_mb, int(peak[1]) / 1024)
            if time.monotonic() - started > limit_s:
                raise TimeoutError(self.log.read_text()[-2000:])
            time.sleep(CASES["look_every_s"])
        return code

    def reaches(self, out: str, shards: int) -> None:
        """Wait until so many shards are finished. Raises RuntimeError where it ended before."""
        if self.ends(lambda: finished(out) >= shards) is not None:
            raise RuntimeError(self.log.read_text()[-2000:])


def finished(out: str) -> int:
    """How many shards of the dataset are finished."""
    names = Place(out).entries("manifest/shards")
    return sum(name.startswith("manifest/shards/c.") for name in names)


def made(out: str, home: Path, shards: int) -> dict[str, float]:
    """Generate with a worker killed at a quarter and the scheduler at six tenths; once more to go
    on; what it took."""
    started = time.perf_counter()
    with running(home, CASES["workers"]) as (address, processes):
        first = Command(out, address)
        first.reaches(out, shards // 4)
        processes[0].kill()
        another = subprocess.Popen([sys.executable, *WORKER, address], stderr=subprocess.DEVNULL)
        first.reaches(out, shards * 6 // 10)
        processes[-1].kill()
        killed = time.perf_counter()
        code = first.ends(limit_s=120)
        said = time.perf_counter() - killed
        another.kill()
        another.wait()
    assert code == 2, code
    last = first.log.read_text().splitlines()[-1]
    assert "its scheduler is gone; what is finished stays good" in last, last
    done = finished(out)
    (home / "scheduler.json").unlink()
    with running(home, CASES["workers"]) as (address, _):
        second = Command(out, address)
        assert second.ends() == 0, second.log.read_text()[-2000:]
    return {
        "minutes": (time.perf_counter() - started) / 60,
        "workers_lost": 1.0,
        "scheduler_said_s": said,
        "finished_before": done / shards,
        "most_memory_mb": max(first.most_mb, second.most_mb),
    }


def looked_at(out: str, shards: int) -> tuple[dict[str, float], str]:
    """What is there, how long it takes to open, and its digest."""
    started = time.perf_counter()
    dataset = Dataset.open_finished(out)
    opened = time.perf_counter() - started
    entries = dataset.place.entries()
    count = len(dataset)
    started = time.perf_counter()
    again = Dataset.open_finished(out).state().read
    reopened = time.perf_counter() - started
    assert shards == dataset.layout.shards
    found = {
        "first_check_s": opened,
        "checked_again_s": reopened,
        "shards_read_again": float(again),
        "files_per_recording": len(entries) / count,
        "bytes_per_recording": sum(entry.size for entry in entries.values()) / count,
    }
    started = time.perf_counter()
    digest = dataset.digest()
    return found | {"digest_s": time.perf_counter() - started}, digest


def tried(study: Report, name: str, out: str) -> str:
    """Generate there and tell of it; its digest."""
    shards, home = -(-CASES["recordings"] // 512), HERE / name
    home.mkdir(exist_ok=True)
    (home / "scheduler.json").unlink(missing_ok=True)
    found = made(out, home, shards)
    more, digest = looked_at(out, shards)
    where = "a local directory" if name == "million" else "an object store"
    study.line(f"{where}: {CASES['recordings']} recordings, {shards} shards")
    for key, value in (found | more).items():
        study.line(f"    {key:24s}{value:12.4g}")
        full = f"{name}_recordings_{key}" if key == "minutes" else f"{name}_{key}"
        study.summary[full] = value
    return digest


def main() -> None:
    with Report("studies/million") as study, tempfile.TemporaryDirectory(dir=HERE) as local:
        os.environ["XDG_CACHE_HOME"] = f"{local}/cache"
        digests = []
        if CASES["server"] is None:
            study.line("the object store is left out")
        else:  # first, since what it needs may be missing
            with bucket(installed(), Path(local)) as url:
                digests.append(tried(study, "million_s3", f"{url}/million.zarr"))
        digests.append(tried(study, "million", f"{local}/million.zarr"))
        study.line(f"digests {' and '.join(digests)}")
        if len(digests) == 2:
            study.summary["million_digest_equal"] = float(len(set(digests)) == 1)


if __name__ == "__main__":
    main()
