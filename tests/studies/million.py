"""One million recordings as means through a dask cluster, to a local directory and to an object
store, a worker and the scheduler killed on the way.

    make study-million

The scheduler, its workers and the store are processes of their own that listen on 127.0.0.1. The
store speaks S3 (moto, which keeps all in memory); it and s3fs are installed below
outputs/studies/million, and not into the project's environment. Half an hour.
"""

import os
import resource
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
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
    if not (server / "bin/moto_server").exists():
        subprocess.run([sys.executable, "-m", "venv", server], check=True)
        subprocess.run([server / "bin/python", *_INSTALL, CASES["server"]], check=True)
    if not client.exists():
        command = [sys.executable, *_INSTALL, "--target", client, *CASES["client"]]
        subprocess.run(command, check=True)
    sys.path.insert(0, str(client))
    os.environ["PYTHONPATH"] = os.pathsep.join([str(client), *sys.path[1:]])
    return server / "bin/moto_server"


@contextmanager
def bucket(server: Path) -> Iterator[str]:
    """The URL of an empty bucket of a server that is ended afterwards."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    os.environ |= {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}", "AWS_ACCESS_KEY_ID": "study",
                   "AWS_SECRET_ACCESS_KEY": "study", "AWS_DEFAULT_REGION": "us-east-1"}  # fmt: skip
    with (HERE / "server.log").open("w") as log:
        process = subprocess.Popen([server, "-H", "127.0.0.1", "-p", port], stdout=log, stderr=log)
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


def begun(out: str, address: str) -> subprocess.Popen:
    """The command, as it is typed."""
    options = [*CASES["options"], f"recordings={CASES['recordings']}", f"out={out}"]
    cluster = ("cluster=dask", f"cluster.address={address}")
    command = [sys.executable, ROOT / "sim/generate.py", *options, *cluster]
    with (HERE / "generate.log").open("w") as log:
        return subprocess.Popen(command, stderr=log, stdout=log, cwd=HERE)


def reaches(process: subprocess.Popen, out: str, shards: int) -> None:
    """Wait until so many shards are finished. Raises RuntimeError where the command ended first."""
    while len(Place(out).entries("manifest/shards")) < shards:
        if process.poll() is not None:
            raise RuntimeError((HERE / "generate.log").read_text()[-2000:])
        time.sleep(1)


def made(out: str, home: Path, shards: int) -> dict[str, float]:
    """Generate with a worker killed at a quarter and the scheduler at six tenths; once more to go
    on; what it took."""
    started = time.perf_counter()
    with running(home, CASES["workers"]) as (address, processes):
        process = begun(out, address)
        reaches(process, out, shards // 4)
        processes[0].kill()
        another = subprocess.Popen([sys.executable, *WORKER, address], stderr=subprocess.DEVNULL)
        reaches(process, out, shards * 6 // 10)
        processes[-1].kill()
        killed = time.perf_counter()
        code = process.wait(timeout=120)
        said = time.perf_counter() - killed
        another.kill()
        another.wait()
    assert code == 2, code
    last = (HERE / "generate.log").read_text().splitlines()[-1]
    assert "its scheduler is gone; what is finished stays good" in last, last
    done = len(Place(out).entries("manifest/shards"))
    (home / "scheduler.json").unlink()
    with running(home, CASES["workers"]) as (address, _):
        assert begun(out, address).wait() == 0, (HERE / "generate.log").read_text()[-2000:]
    minutes = (time.perf_counter() - started) / 60
    return {"minutes": minutes, "scheduler_said_s": said, "finished_before": done / shards}


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
    return found, dataset.digest()


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
        digests = [tried(study, "million", f"{local}/million.zarr")]
        if CASES["server"] is None:
            study.line("the object store is left out")
        else:
            with bucket(installed()) as url:
                digests.append(tried(study, "million_s3", f"{url}/million.zarr"))
        most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        study.line(f"digests {' and '.join(digests)}; most memory of a process {most:.0f} MB")
        study.summary |= {"million_digest_equal": float(len(set(digests)) == 1),
                          "million_most_memory_mb": most}  # fmt: skip


if __name__ == "__main__":
    main()
