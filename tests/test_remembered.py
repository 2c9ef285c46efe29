"""What was found whole is not read again, and what has changed is, whoever changed it."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from test_store import LAYOUT, make

from lbgc.data import place, remembered, store
from lbgc.data.place import Entry, Place
from lbgc.data.store import Dataset
from lbgc.errors import InputError


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch) -> Path:
    """A memory of its own, in which files are old enough from the start."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(remembered, "_SETTLED_NS", -(10**12))
    return tmp_path / "cache/lbgc/verified"


@pytest.fixture
def dataset(tmp_path) -> Dataset:
    return make(tmp_path / "d.zarr")


def flip(file: Path) -> None:
    """Another byte in place, of the same size."""
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 4
    file.write_bytes(content)


def test_what_was_found_whole_is_not_read_again(dataset, monkeypatch):
    assert dataset.state().read == LAYOUT.shards
    assert dataset.state().read == 0
    monkeypatch.setenv("LBGC_VERIFY", "1")
    assert dataset.state().read == LAYOUT.shards
    monkeypatch.delenv("LBGC_VERIFY")
    assert dataset.state().read == 0
    assert Dataset.open_finished(dataset.path).state().read == 0


def test_what_was_just_written_is_remembered_by_its_writer(dataset):
    dataset.remember()
    assert dataset.state().read == 0


@pytest.mark.parametrize(
    "damage",
    [
        lambda d: flip(d / "gyro/c.1.0.0"),
        lambda d: flip(d / "heading/c.1"),
        lambda d: (d / "heading/c.1").unlink(),
        lambda d: shutil.copy(d / "unit/c.1", d / "session/c.1"),
        lambda d: shutil.copy2(d / "accel_matrix/c.0.0.0", d / "accel_matrix/c.1.0.0"),
        lambda d: os.replace(d / "gyro_bias_run/c.1.0", d / "gyro_bias_unit/c.1.0"),
    ],
)
def test_a_damage_after_that_is_seen(dataset, damage):
    """Its times may be set back: the inode, and the time of that setting, tell."""
    dataset.state()
    before = {f: f.stat() for f in dataset.path.rglob("c.1*")}
    damage(dataset.path)
    for file, was in before.items():
        if file.exists():
            os.utime(file, ns=(was.st_atime_ns, was.st_mtime_ns))
    assert dataset.state().damaged == [1]
    assert dataset.state().damaged == [1]


def test_a_row_of_the_manifest_that_was_changed_is_seen(dataset):
    dataset.state()
    row = dataset.path / "manifest/shards/c.1.0"
    flip(row)
    assert dataset.state().missing == [1]
    shutil.copy(dataset.path / "manifest/shards/c.0.0", row)
    assert dataset.state().damaged == [1]


def test_rot_under_unchanged_times_is_seen_when_it_is_read_and_then_all_is_checked(
    dataset, monkeypatch
):
    """A disk that rots changes no time: the marks are held still here while a byte changes."""
    dataset.state()
    found = dataset.place.entries()
    flip(dataset.path / "heading/c.1")
    monkeypatch.setattr(place.Place, "entries", lambda self, below="": found)
    assert dataset.state() == store.State([], [], [], 0)
    with pytest.raises(InputError, match="is damaged: heading"):
        dataset.label("heading")
    assert dataset.state().damaged == [1]


def test_files_that_are_new_are_read_again(dataset, monkeypatch):
    """Two writings within a tick of the file system's clock have the same times."""
    monkeypatch.setattr(remembered, "_SETTLED_NS", 10**12)
    assert dataset.state().read == dataset.state().read == LAYOUT.shards


def test_another_dataset_in_its_place_is_read(dataset, tmp_path):
    dataset.state()
    moved = tmp_path / "moved.zarr"
    dataset.path.rename(moved)
    assert Dataset.open(moved).state().read == LAYOUT.shards
    shutil.copytree(moved, dataset.path)
    assert Dataset.open(dataset.path).state().read == LAYOUT.shards


@pytest.mark.parametrize("content", ["", "{", "[]", '{"marks": 3}', "[" * 10**5, '"x"'])
def test_a_memory_that_is_damaged_knows_nothing(dataset, home, content):
    dataset.state()
    (file,) = home.iterdir()
    file.write_text(content)
    assert dataset.state().read == LAYOUT.shards
    assert dataset.state().read == 0


def test_where_nothing_can_be_kept_all_is_read(dataset, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert dataset.state().read == dataset.state().read == LAYOUT.shards


def test_the_memory_is_bounded(dataset, home, monkeypatch):
    monkeypatch.setattr(remembered, "_DATASETS", 3)
    home.mkdir(parents=True)
    for i in range(5):
        (home / f"{i}.json").write_text("{}")
        os.utime(home / f"{i}.json", (i, i))
    dataset.state()
    assert {f.name for f in home.iterdir()} >= {"2.json", "3.json", "4.json"}
    assert len(list(home.iterdir())) == 4


def test_a_place_that_tells_no_times_is_read_each_time():
    made = make("memory://test_remembered/d.zarr")  # type: ignore[arg-type]
    assert made.state().read == made.state().read == LAYOUT.shards


def test_a_place_that_marks_contents_is_not(monkeypatch):
    """As object stores do, by an ETag."""
    made = make("memory://test_remembered/e.zarr")  # type: ignore[arg-type]
    plain = Place.entries

    def tagged(self: Place, below: str = "") -> dict[str, Entry]:
        content = {name: self.read(name) or b"" for name in plain(self, below)}
        return {n: Entry(len(c), str(hash(c))) for n, c in content.items()}

    monkeypatch.setattr(Place, "entries", tagged)
    assert (made.state().read, made.state().read) == (LAYOUT.shards, 0)
    made.place.write("heading/c.1", b"x" * len(made.place.read("heading/c.1") or b""))
    assert made.state().damaged == [1]


def test_info_says_what_it_has_not_read(cli, dataset, tmp_path):
    cli("sim.generate", "recordings=2", "duration_s=10", "rate_hz=25", "out=g.zarr")
    told = cli("lbgc.info", "data=g.zarr").out
    assert "1 of 1 shards were found whole before, and are unchanged (--verify reads" in told
    assert (
        "finished, every file as it was written" in cli("lbgc.info", "data=g.zarr", "--verify").out
    )
    assert json.loads(next((tmp_path / "cache/lbgc/verified").iterdir()).read_text())["marks"]
    assert np.isfinite(Dataset.open(tmp_path / "g.zarr").label("heading")).all()
