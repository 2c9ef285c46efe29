"""Nothing lost: whatever happens to a dataset's files is noticed, named, refused and mended."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from corruption import KINDS, flip

from lbgc.data import manifest, store
from lbgc.data.documents import DOCUMENTS, Layout
from lbgc.data.schema import SCHEMA, VARIABLES
from lbgc.data.store import Dataset
from lbgc.errors import InputError
from lbgc.outputs import fingerprint

LAYOUT = Layout(20, 4200, 50.0, {"gyro": 1e-6, "accel": 1e-5})
"""Two shards of several chunks each."""


def finish(path: Path | str, configuration: dict) -> Dataset:
    """What generation does: start or go on, and write what is missing or damaged."""
    dataset = store.create(path, LAYOUT, configuration, {})
    sizes = {"time": LAYOUT.samples, "axis": 3, "axis_in": 3}
    for shard in dataset.unfinished_shards():
        sizes["recording"] = len(LAYOUT.rows(shard))
        values = np.arange(sizes["recording"]) + shard
        dataset.write_shard(
            shard,
            {
                name: np.broadcast_to(
                    values.reshape(-1, *[1] * (len(v.dims) - 1)) % 3, [sizes[d] for d in v.dims]
                )
                for name, v in VARIABLES.items()
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


@pytest.mark.parametrize("name", [*DOCUMENTS, manifest.MANIFEST])
def test_a_flipped_bit_in_any_document_is_named(name, copy):
    flip(copy / name, np.random.default_rng(len(name)))
    with pytest.raises(InputError, match=rf"is damaged \({name}"):
        Dataset.open(copy)


def test_every_bit_of_the_root_and_the_manifest_counts(copy):
    """Also those whose change would mean the same to a JSON reader."""
    for name in (manifest.ROOT, manifest.MANIFEST):
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

    refuses("shards 0, 1 are not as they were written", "rm -r heading/c")
    refuses("shards 1 are not as they were written", "truncate -s -1 accel/c/1/0/0")
    refuses("left .gyro/c/0/0/0.0123.partial", "echo half > gyro/c/0/0/0.0123.partial")
    refuses("is damaged .manifest/zarr.json", "rm -r manifest; cp -r {foreign}/manifest .")
    rows = "rm -r manifest/{{0}}; cp -r {foreign}/manifest/{{0}} manifest"
    copied = [rows.format(foreign=foreign).format(n) for n in ("digest", "stored")]
    refuses("shards 0, 1 are not as they were written", *copied)
    refuses("1 of 2 shards are missing", "rm -r manifest/stored/c/0")


def test_a_shard_of_another_dataset_is_not_taken_for_ours(copy, whole, foreign):
    """The same layout and the same values: only whose they are differs."""
    for name in (manifest.ROOT, manifest.MANIFEST):
        (copy / name).write_bytes((foreign / name).read_bytes())
    assert Dataset.open(copy).damaged_shards() == [0, 1]


def test_a_link_out_of_the_dataset_is_refused(copy, whole, tmp_path):
    shutil.move(copy / "gyro/c", tmp_path / "elsewhere")
    (copy / "gyro/c").symlink_to(tmp_path / "elsewhere")
    refused_and_mended(copy, whole, r"an interrupted run left \(gyro/c\)")
    assert (tmp_path / "elsewhere").exists()


def test_damage_to_both_that_say_whose_it_is_destroys_nothing(copy):
    for name in (manifest.ROOT, manifest.MANIFEST):
        flip(copy / name, np.random.default_rng(1))
    before = contents(copy)
    for call in (lambda: Dataset.open(copy), lambda: store.create(copy, LAYOUT, {"a": 1}, {})):
        with pytest.raises(InputError, match="is damaged beyond repair"):
            call()
    assert contents(copy) == before


def test_killed_while_it_starts_it_starts_again(copy, whole):
    """The root is written first; what follows is missing, and one file half-written."""
    root = (copy / manifest.ROOT).read_bytes()
    for left in ({}, {manifest.ROOT: root}, {manifest.ROOT: root, "gyro/zarr.json": b"{"}):
        shutil.rmtree(copy)
        copy.mkdir()
        (copy / ".zarr.json.partial-77").write_text("half")
        for name, content in left.items():
            (copy / name).parent.mkdir(exist_ok=True)
            (copy / name).write_bytes(content)
        assert store.create(copy, LAYOUT, {"a": 1}, {}).missing_shards() == [0, 1]
        names = {*DOCUMENTS, manifest.MANIFEST}
        assert contents(copy) == {n: (whole / n).read_bytes() for n in names}


def test_a_schema_has_one_content():
    """Another content is another schema: give it the next number, and say so in the CHANGELOG."""
    content = {name: vars(variable) for name, variable in VARIABLES.items()}
    assert (SCHEMA, fingerprint(content)) == (3, "c4f91051c2cd89f3")
