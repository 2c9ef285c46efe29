"""Nothing lost: whatever happens to a dataset's files is noticed, named, refused and mended."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from corruption import KINDS, flip
from helpers import ROOT, generate

from lbgc.commands import run_main
from lbgc.data import manifest, place, store
from lbgc.data.documents import Layout, documents
from lbgc.data.schema import ALWAYS, SCHEMA, VARIABLES
from lbgc.data.store import Dataset
from lbgc.errors import InputError
from lbgc.info import InfoConfig, as_override
from lbgc.outputs import fingerprint
from lbgc.processes import uninterrupted
from sim.cluster import ClusterConfig, finished

LAYOUT = Layout(20, 4200, 50.0, {"gyro": 1e-6, "accel": 1e-5})
"""Two shards of several chunks each."""


def finish(path: Path | str, configuration: dict) -> Dataset:
    """What generation does: start or go on, and write what is missing or damaged."""
    dataset = store.create(path, LAYOUT, configuration, {})
    sizes = {"time": LAYOUT.samples, "axis": 3, "axis_in": 3}
    for shard in dataset.state().unfinished:
        sizes["recording"] = len(LAYOUT.rows(shard))
        values = np.arange(sizes["recording"]) + shard
        dataset.write_shard(
            shard,
            {
                name: np.broadcast_to(
                    values.reshape(-1, *[1] * (len(v.dims) - 1)) % 3, [sizes[d] for d in v.dims]
                )
                for name, v in ((name, VARIABLES[name]) for name in LAYOUT.variables)
            },
        )
    return Dataset.open_finished(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return finish(tmp_path_factory.mktemp("whole") / "d.zarr", {"a": 1}).path


@pytest.fixture(scope="module")
def foreign(tmp_path_factory) -> Path:
    return finish(tmp_path_factory.mktemp("foreign") / "d.zarr", {"a": 2}).path


@pytest.fixture
def copy(whole, tmp_path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "d.zarr"))


def contents(path: Path) -> dict[str, bytes]:
    return {str(f.relative_to(path)): f.read_bytes() for f in path.rglob("*") if f.is_file()}


def refused_and_mended(path: Path, whole: Path, match: str) -> None:
    """Refused by name; run again, every byte is as it was."""
    with pytest.raises(InputError, match=match):
        Dataset.open_finished(path)
    finish(path, {"a": 1})
    assert contents(path) == contents(whole)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(2))
def test_random_damage_is_refused_and_mended(kind, seed, copy, whole, foreign):
    said = KINDS[kind](copy, np.random.default_rng([seed, len(kind)]), LAYOUT.shards, foreign)
    assert said
    refused_and_mended(copy, whole, "damaged|missing|interrupted")


@pytest.mark.parametrize("name", [*LAYOUT.documents, manifest.MANIFEST])
def test_a_flipped_bit_in_any_document_is_named(name, copy):
    flip(copy / name, np.random.default_rng(len(name)))
    with pytest.raises(InputError, match=rf"is damaged \({name}"):
        Dataset.open(copy)


def test_every_bit_of_the_root_and_the_manifest_counts(copy):
    """Also those whose change would mean the same to a JSON reader."""
    for name in ("zarr.json", manifest.MANIFEST):
        good = (copy / name).read_bytes()
        for at in range(len(good) // 2, len(good), 97):
            bad = bytearray(good)
            bad[at] ^= 0x20
            (copy / name).write_bytes(bad)
            with pytest.raises(InputError, match="is damaged"):
                Dataset.open(copy)
        (copy / name).write_bytes(good)
    Dataset.open(copy)


def test_what_is_damaged_is_named(whole, foreign, tmp_path):
    def refuses(said: str, *commands: str) -> None:
        path = tmp_path / "d.zarr"
        shutil.rmtree(path, ignore_errors=True)
        shutil.copytree(whole, path)
        for command in commands:
            subprocess.run(command.format(foreign=foreign), shell=True, check=True, cwd=path)
        with pytest.raises(InputError, match=said):
            Dataset.open_finished(path)

    refuses("shards 0, 1 are not as they were written", "rm heading/c.*")
    refuses("shards 1 are not as they were written", "truncate -s -1 accel/c.1.0.0")
    refuses("left .gyro/c.0.0.0.0123.partial", "echo half > gyro/c.0.0.0.0123.partial")
    refuses("is damaged .manifest/zarr.json", "rm -r manifest; cp -r {foreign}/manifest .")
    rows = "rm -r manifest/{{0}}; cp -r {foreign}/manifest/{{0}} manifest"
    copied = rows.format(foreign=foreign).format("shards")
    refuses("shards 0, 1 are not as they were written", copied)
    refuses("1 of 2 shards are missing", "rm manifest/shards/c.0.0")


def test_a_shard_of_another_dataset_is_not_taken_for_ours(copy, whole, foreign):
    """The same layout and the same values: only whose they are differs."""
    for name in ("zarr.json", manifest.MANIFEST):
        (copy / name).write_bytes((foreign / name).read_bytes())
    assert Dataset.open(copy).state().damaged == [0, 1]


def test_a_link_out_of_the_dataset_is_refused(copy, whole, tmp_path):
    shutil.move(copy / "gyro/c.0.0.0", tmp_path / "elsewhere")
    (copy / "gyro/c.0.0.0").symlink_to(tmp_path / "elsewhere")
    refused_and_mended(copy, whole, r"an interrupted run left \(gyro/c.0.0.0\)")
    assert (tmp_path / "elsewhere").exists()


def test_damage_to_both_that_say_whose_it_is_destroys_nothing(copy):
    for name in ("zarr.json", manifest.MANIFEST):
        flip(copy / name, np.random.default_rng(1))
    before = contents(copy)
    for call in (lambda: Dataset.open(copy), lambda: store.create(copy, LAYOUT, {"a": 1}, {})):
        with pytest.raises(InputError, match="is damaged beyond repair"):
            call()
    assert contents(copy) == before


def test_killed_while_it_starts_it_starts_again(copy, whole):
    """The root is written first; what follows is missing, and one file half-written."""
    root = (copy / "zarr.json").read_bytes()
    for left in ({}, {"zarr.json": root}, {"zarr.json": root, "gyro/zarr.json": b"{"}):
        shutil.rmtree(copy)
        copy.mkdir()
        (copy / ".zarr.json.partial-77").write_text("half")
        for name, content in left.items():
            (copy / name).parent.mkdir(exist_ok=True)
            (copy / name).write_bytes(content)
        assert store.create(copy, LAYOUT, {"a": 1}, {}).state().missing == [0, 1]
        names = {*LAYOUT.documents, manifest.MANIFEST}
        assert contents(copy) == {n: (whole / n).read_bytes() for n in names}


def test_a_schema_has_one_content():
    """Another content is another schema: give it the next number, and say so in the CHANGELOG."""
    content = {name: dict(vars(VARIABLES[name])) for name in ALWAYS}
    assert not any(own.pop("optional") for own in content.values())
    assert (SCHEMA, fingerprint(content)) == (5, "c4f91051c2cd89f3")


def test_a_schema_has_one_way_of_storing():
    """Every array's type, chunks, codecs and attributes, at full rate and as means; likewise."""
    stored = {}
    for layout in (LAYOUT, Layout(600, 48, 0.2, {"gyro": None, "accel": None})):
        for name, content in documents(layout, {}).items():
            if name.endswith("zarr.json"):
                said = json.loads(content)
                keys = ("shape", "data_type", "chunk_grid", "chunk_key_encoding", "codecs",
                        "fill_value", "dimension_names", "attributes")  # fmt: skip
                stored[f"{layout.shard} {name}"] = {key: said.get(key) for key in keys}
    assert (SCHEMA, fingerprint(stored)) == (5, "38b9f8cc6fec3357")


@pytest.mark.parametrize("url", ["memory://test_faults/d.zarr", "file://{}/d.zarr"])
def test_a_url_holds_the_same_dataset(url, whole, tmp_path):
    made = finish(url.format(tmp_path), {"a": 1})
    assert made.digest() == Dataset.open_finished(whole).digest()
    names = made.place.names()
    assert {name: made.place.read(name) for name in names} == contents(whole)
    made.place.remove("gyro/c.1.0.0")
    with pytest.raises(InputError, match="shards 1 are not as they were written"):
        Dataset.open_finished(url.format(tmp_path))


SIZE = ("recordings=40", "rate_hz=25", "duration_s=200", "out=d.zarr")
"""Three shards."""


def started(path: Path, *options: str, when: str = "manifest/shards/c.*.0") -> subprocess.Popen:
    """Generation in a process group of its own, as far as that this file is there."""
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "sim/generate.py"), *SIZE, *options],
        cwd=path,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"MUJOCO_GL": "disable"},
        # a shell's background job ignores interruptions, and so would what it starts
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        start_new_session=True,
    )
    while not list((path / "d.zarr").glob(when)):
        assert process.poll() is None
        time.sleep(0.01)
    return process


@pytest.fixture(scope="module")
def digest(tmp_path_factory) -> str:
    changes = {"recordings": 40, "rate_hz": 25.0, "duration_s": 200.0}
    return generate(tmp_path_factory.mktemp("whole") / "d.zarr", **changes).digest()


def interrupted(process: subprocess.Popen) -> None:
    """As a terminal does it, which tells all of the group; it says progress and one line."""
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    *progress, last = said.replace("\r", "\n").strip().splitlines()
    assert last == "interrupted; run the same command again to go on", said
    assert all(line.startswith("generating:") for line in progress if line.strip()), said


@pytest.mark.parametrize("options", [(), ("cluster=local", "cluster.workers=2")])
def test_interrupted_it_says_one_line_and_goes_on(options, cli, tmp_path, digest):
    process = started(tmp_path, *options)
    process.send_signal(signal.SIGSTOP)  # it is there, and does nothing
    second = cli("sim.generate", *SIZE)
    assert second.code == 2
    assert "is being written by another process" in second.err
    process.send_signal(signal.SIGCONT)
    interrupted(process)
    if not options:  # workers were not stopped, and may have finished meanwhile
        with pytest.raises(InputError, match="is not finished"):
            Dataset.open_finished(tmp_path / "d.zarr")
    assert cli("sim.generate", *SIZE).code == 0
    assert Dataset.open_finished(tmp_path / "d.zarr").digest() == digest


@pytest.mark.parametrize("later_s", [0.0, 0.4])
def test_interrupted_while_its_workers_start_it_says_one_line(later_s, tmp_path):
    process = started(tmp_path, "cluster=local", "cluster.workers=2", when="zarr.json")
    time.sleep(later_s)
    interrupted(process)


def test_what_must_not_be_interrupted_is_not():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job has none
    done = []

    def work() -> None:
        with uninterrupted():
            signal.raise_signal(signal.SIGINT)
            done.append(True)

    try:
        with pytest.raises(KeyboardInterrupt):
            work()
    finally:
        signal.signal(signal.SIGINT, before)
    assert done
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_interruption_inside_a_callback_is_not_lost(monkeypatch, capsys):
    """Python prints what a weak reference's callback raises, and forgets it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job has none

    def main(config: InfoConfig) -> None:
        gone = {1}  # sets can be referred to weakly
        _ = weakref.ref(gone, lambda _: signal.raise_signal(signal.SIGINT))
        del gone
        for _ in range(400):  # it is told between two of them
            time.sleep(0.05)
        raise AssertionError("never interrupted")

    monkeypatch.setattr(sys, "argv", ["info", "data=x"])
    try:
        with pytest.raises(SystemExit) as end:
            run_main(main, InfoConfig, "info")
    finally:
        signal.signal(signal.SIGINT, before)
    assert end.value.code == 130
    said = capsys.readouterr().err
    assert said.strip() == "interrupted; run the same command again to go on"


def test_a_full_disk_is_named_and_what_is_finished_stays(cli, tmp_path, monkeypatch, digest):
    put = place.write_atomically

    def full(path, content, promised):
        if path.name.startswith("c.1."):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        put(path, content, promised)

    monkeypatch.setattr(place, "write_atomically", full)
    done = cli("sim.generate", *SIZE)
    assert done.code == 2
    assert "cannot be written (No space left on device); what is finished stays good" in done.err
    assert "Traceback" not in done.err
    unfinished = Dataset.open(tmp_path / "d.zarr")
    assert (unfinished.state().missing, unfinished.state().damaged) == ([1, 2], [])
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    assert cli("sim.generate", *SIZE).code == 0
    assert Dataset.open_finished(tmp_path / "d.zarr").digest() == digest


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """A file system in memory with room for about a shard, where mounting one is allowed."""
    where = tmp_path / "small"
    where.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=900k", "none", where],
                          capture_output=True, text=True)  # fmt: skip
    if done.returncode:
        pytest.skip(f"needs leave to mount a tmpfs: {done.stderr.strip()}")
    yield where
    subprocess.run(["umount", where], check=True)


def test_a_disk_that_is_full_loses_nothing(cli, small_disk, digest):
    asked = (*SIZE[:3], f"out={small_disk}/d.zarr")
    done = cli("sim.generate", *asked)
    assert done.code == 2
    assert "cannot be written (No space left on device); what is finished stays good" in done.err
    unfinished = Dataset.open(small_disk / "d.zarr")
    assert 0 < len(unfinished.state().missing) < unfinished.layout.shards
    assert unfinished.state().damaged == []
    larger = ["mount", "-o", "remount,size=50m", str(small_disk)]
    subprocess.run(larger, check=True)
    assert cli("sim.generate", *asked).code == 0
    assert Dataset.open_finished(small_disk / "d.zarr").digest() == digest


def killing(path: str, shard: int) -> None:
    """A task whose worker is lost at the first attempt."""
    mark = Path(path) / str(shard)
    if shard == 1 and not mark.exists():
        mark.touch()
        os._exit(9)
    mark.touch()


def hopeless(shard: int) -> None:
    os._exit(9)


def test_a_lost_workers_shard_is_done_again_but_not_for_ever(tmp_path):
    local = ClusterConfig("local", workers=1)
    assert sorted(finished(local, partial(killing, str(tmp_path)), range(3))) == [0, 1, 2]
    with pytest.raises(InputError, match=r"cluster\.workers = 1: workers keep being killed"):
        list(finished(local, hopeless, range(2)))


def test_what_a_lost_worker_had_begun_to_write_is_taken_away(cli, tmp_path, monkeypatch, digest):
    """The worker dies in a write, another does its shard again: the half-written file is nobody's,
    and the dataset is whole."""

    def made_here(_, task, shards):
        for shard in shards:
            task(shard)
            (tmp_path / f"d.zarr/gyro/.{shard}.partial-1").write_bytes(b"half")
            yield shard

    monkeypatch.setattr("sim.generate.cluster.finished", made_here)
    assert cli("sim.generate", *SIZE, "cluster=local").code == 0
    assert Dataset.open_finished(tmp_path / "d.zarr").digest() == digest


def test_a_cluster_says_what_it_needs(cli, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    asked = ("cluster=dask", "cluster.address=tcp://localhost:1")
    assert "pip install 'lbgc[dask]'" in cli("sim.generate", *SIZE, *asked).err
    assert "is for cluster=local" in cli("sim.generate", *SIZE, "cluster.workers=2").err
    in_memory = cli("sim.generate", *SIZE[:3], "out=memory://d.zarr", "cluster=local")
    assert "is this process's alone" in in_memory.err


def test_info_says_what_is_there(cli, tmp_path):
    """Of a dataset that was generated, since info reads what it says of itself."""
    copy = tmp_path / "d.zarr"
    generate(copy, recordings=20, duration_s=84.0, rate_hz=50.0)
    said = cli("lbgc.info", f"data={copy}")
    assert (said.code, Path(said.last_line).suffix) == (0, ".png")
    assert "finished, every file as it was written" in said.out
    assert "recordings   20 of 84 s" in said.out
    (copy / "gyro/c.0.0.0").unlink()
    (copy / "manifest/shards/c.1.0").unlink()
    said = cli("lbgc.info", f"data={copy}")
    assert said.code == 0
    assert "damaged      0;" in said.out
    assert "missing      1;" in said.out
    flip(copy / "lost/zarr.json", np.random.default_rng(1))
    assert "damaged metadata: lost/zarr.json" in cli("lbgc.info", f"data={copy}").out
    assert cli("lbgc.info", "data=nowhere").code == 2


def test_info_takes_a_path_as_typed(tmp_path):
    odd = tmp_path / "a=b"
    odd.mkdir()
    assert as_override(["some/d.zarr", "lines=3"]) == ["data='some/d.zarr'", "lines=3"]
    assert as_override([str(odd)]) == [f"data='{odd}'"]
    for untouched in ([], ["--help"], ["data=x"]):
        assert as_override(untouched) == untouched
