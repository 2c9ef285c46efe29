"""The dataset's promises: readable elsewhere, checked, and never whole when it is not."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
import zarr

from lbgc.data import manifest, store
from lbgc.data.documents import documents
from lbgc.data.place import Place
from lbgc.data.schema import ALWAYS, VARIABLES
from lbgc.data.shard import Shard
from lbgc.data.store import Dataset, Layout
from lbgc.errors import InputError
from lbgc.outputs import fingerprint

LAYOUT = Layout(600, 40, 2.0, {"gyro": 1e-6, "accel": None})


def batch(layout: Layout, shard: int) -> dict[str, np.ndarray]:
    """Made-up values of every variable for a shard's recordings."""
    rng = np.random.default_rng(shard)
    sizes = {"recording": len(layout.rows(shard)), "time": layout.samples, "axis": 3, "axis_in": 3}
    return {
        name: rng.integers(0, 2, tuple(sizes[d] for d in VARIABLES[name].dims))
        for name in layout.variables
    }


def make(path: Path, shards: int | None = None) -> Dataset:
    dataset = store.create(path, LAYOUT, {"a": 1}, {})
    for shard in range(LAYOUT.shards if shards is None else shards):
        dataset.write_shard(shard, batch(LAYOUT, shard))
    return dataset


@pytest.fixture
def dataset(tmp_path) -> Dataset:
    return make(tmp_path / "d.zarr")


def test_xarray_opens_it_with_units_and_names_on_every_variable(dataset):
    opened = xarray.open_zarr(dataset.path)
    assert set(ALWAYS) <= set(opened.variables)
    for name, variable in opened.variables.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name
    assert opened["gyro"].dims == ("recording", "time", "axis")
    assert opened["split"].attrs["flag_meanings"] == "train validation test"
    np.testing.assert_allclose(opened["time"], np.arange(1, 41) / 2)


def test_counts_are_decoded_and_zeros_are_not_missing(dataset):
    opened = xarray.open_zarr(dataset.path)
    assert opened["gyro"].dtype == np.float64
    first = batch(LAYOUT, 0)
    np.testing.assert_allclose(opened["gyro"][:512].values, first["gyro"] * 1e-6)
    assert np.isfinite(opened["accel"].values).all()
    record = next(iter(dataset.records(np.array([3]))))
    np.testing.assert_allclose(record.gyro, first["gyro"][3] * 1e-6)
    assert record.heading == first["heading"][3]


def test_records_come_in_order_across_shards(dataset):
    names = [r.name for r in dataset.records(np.array([599, 5, 511, 512]))]
    assert names == [f"d.zarr[{i}]" for i in (5, 511, 512, 599)]


def test_the_checksum_is_the_last_codec_of_every_array(dataset):
    """The wrong order is accepted silently by Zarr, and then guards nothing on disk."""
    for file in dataset.path.rglob("zarr.json"):
        metadata = json.loads(file.read_text())
        if metadata["node_type"] == "array":
            codecs = metadata["codecs"]
            if codecs[0]["name"] == "sharding_indexed":
                codecs = codecs[0]["configuration"]["codecs"]
            assert codecs[-1]["name"] == "crc32c", file
    gyro = json.loads((dataset.path / "gyro" / "zarr.json").read_text())["codecs"]
    inner = gyro[0]["configuration"]["codecs"] if gyro[0]["name"] == "sharding_indexed" else gyro
    assert [c["name"] for c in inner] == ["transpose", "bytes", "blosc", "crc32c"]


def test_a_flipped_bit_is_not_read_as_data(dataset):
    payload = next((dataset.path / "gyro").glob("c.*"))
    content = bytearray(payload.read_bytes())
    content[len(content) // 2] ^= 4
    payload.write_bytes(content)
    with pytest.raises(ValueError, match="checksum"):
        dataset.digest()


def test_the_digest_is_of_the_content(tmp_path):
    one, two = make(tmp_path / "one.zarr"), make(tmp_path / "two.zarr")
    assert one.digest() == two.digest()
    changed = batch(LAYOUT, 1)
    changed["gyro"][0, 0, 0] += 1
    two.write_shard(1, changed)
    assert one.digest() != two.digest()


def test_no_wall_clock_in_the_bytes(tmp_path):
    one, two = make(tmp_path / "one.zarr").path, make(tmp_path / "two.zarr").path
    files = sorted(p.relative_to(one) for p in one.rglob("*") if p.is_file())
    assert files == sorted(p.relative_to(two) for p in two.rglob("*") if p.is_file())
    for file in files:
        assert (one / file).read_bytes() == (two / file).read_bytes(), file


def test_an_unfinished_dataset_is_refused_and_can_be_gone_on_with(tmp_path):
    path = tmp_path / "d.zarr"
    make(path, shards=1)
    with pytest.raises(InputError, match="is not finished: 1 of 2 shards are missing"):
        Dataset.open_finished(path)
    again = store.create(path, LAYOUT, {"a": 1}, {})
    assert again.state().missing == [1]
    again.write_shard(1, batch(LAYOUT, 1))
    assert Dataset.open_finished(path).digest() == make(tmp_path / "whole.zarr").digest()


def test_another_configuration_is_refused(dataset):
    with pytest.raises(InputError, match="of another configuration"):
        store.create(dataset.path, LAYOUT, {"a": 2}, {})


@pytest.mark.parametrize("content", [None, "file", "directory", "zarr"])
def test_what_is_no_dataset_is_refused_and_left_alone(tmp_path, content):
    path = tmp_path / "x"
    if content == "file":
        path.write_text("hello")
    elif content == "directory":
        path.mkdir()
        (path / "precious").write_text("hello")
    elif content == "zarr":
        zarr.create_group(path)
    with pytest.raises(InputError, match="is no dataset"):
        Dataset.open(path)
    if content in ("directory", "zarr"):
        with pytest.raises(InputError, match="is no dataset"):
            store.create(path, LAYOUT, {"a": 1}, {})
        assert any(path.iterdir())


@pytest.mark.parametrize("call", [Dataset.open, lambda p: store.create(p, LAYOUT, {"a": 1}, {})])
def test_another_schema_is_refused_by_number(dataset, call):
    attributes = zarr.open_group(dataset.path, mode="r+").attrs
    attributes["schema"] = 2
    attributes["identity"] = fingerprint({"schema": 2, "a": 1})
    with pytest.raises(
        InputError, match="has schema 2, this version reads 4 and 5; generate it again"
    ):
        call(dataset.path)


def older(path: Path) -> Dataset:
    """A dataset as versions of schema 4 wrote it, by Zarr: files in directories of directories, one
    of every variable, and two of each row of the manifest."""
    layout = replace(LAYOUT, schema=4)
    identity = fingerprint({"schema": 4, "a": 1})
    said = {"schema": 4, "identity": identity, "configuration": {"a": 1}, "rate_hz": layout.rate_hz}
    made, place = documents(layout, said), Place(path)
    place.write_all({**made, manifest.MANIFEST: manifest.compose(identity, made)})
    group = zarr.open_group(path, mode="r+")
    for shard in range(layout.shards):
        rows = layout.rows(shard)
        with zarr.config.set({"array.write_empty_chunks": True}):
            for name, value in batch(layout, shard).items():
                group[name][rows.start : rows.stop] = value
        digest = Dataset.open(path)._shard_digest(shard, place.entries())
        names = layout.files(shard)
        stored = manifest.stored_checksum(identity, shard, names, place.read, digest)
        group["manifest/digest"][shard] = np.frombuffer(digest, np.uint8)
        group["manifest/stored"][shard] = np.frombuffer(stored, np.uint8)
    return Dataset.open(path)


def test_a_dataset_of_an_earlier_schema_is_read_and_not_written(tmp_path, dataset):
    before = older(tmp_path / "old.zarr")
    assert (before.path / "gyro/c/1/0/0").exists()
    assert (before.path / "manifest/stored/c/1/0").exists()
    read = Dataset.open_finished(before.path)
    assert read.digest() == dataset.digest()
    opened = xarray.open_zarr(before.path)
    assert opened.equals(xarray.open_zarr(dataset.path))
    with pytest.raises(InputError, match="as an earlier version wrote it, which is read and not"):
        store.create(before.path, LAYOUT, {"a": 1}, {})
    (before.path / "heading/c/1").unlink()
    assert before.state().damaged == [1]
    (before.path / "manifest/digest/c/0/0").unlink()
    assert before.state().missing == [0]
    (before.path / "gyro/zarr.json").unlink()
    with pytest.raises(InputError, match=r"is damaged \(gyro/zarr.json\)"):
        Dataset.open(before.path)


def test_a_directory_around_the_dataset_will_do(tmp_path, dataset):
    shutil.move(dataset.path, tmp_path / "dataset.zarr")
    assert Dataset.open(tmp_path).identity == dataset.identity


def test_shards_do_not_depend_on_how_many_recordings_there_are():
    """Full rate: 8 to 16 recordings a shard; means: hundreds."""
    full = [Layout(n, 144_000, 600.0, {}).shard for n in (1, 80, 5000)]
    means = [Layout(n, 48, 0.2, {}).shard for n in (1, 80, 5000)]
    assert full == [16] * 3
    assert means == [512] * 3
    assert Layout(80, 144_000, 600.0, {}).shards == 5
    assert list(Layout(80, 144_000, 600.0, {}).rows(4)) == list(range(64, 80))


@pytest.mark.parametrize(("samples", "recordings"), [(40, 600), (2000, 600), (30_000, 17)])
def test_a_shards_files_are_zarrs_own(tmp_path, samples, recordings):
    """To the byte: chunks in shards or alone, the last shard with fewer recordings and chunks."""
    layout = Layout(recordings, samples, 2.0, {"gyro": 1e-6, "accel": None})
    assert layout.shards == 2
    ours, theirs = (store.create(tmp_path / n, layout, {"a": 1}, {}) for n in ("a", "b"))
    group = zarr.open_group(theirs.path, mode="r+")
    for shard in range(2):
        values, rows = batch(layout, shard), layout.rows(shard)
        values["gyro_matrix"][:] = 0
        values["time_error"] = np.copysign(0 * values["time_error"], -1)
        ours.write_shard(shard, values)
        for name, value in values.items():
            with zarr.config.set({"array.write_empty_chunks": name == "time_error"}):
                group[name][rows.start : rows.stop] = value
    for name in ALWAYS:
        for file in (theirs.path / name).glob("c.*"):
            same = ours.path / file.relative_to(theirs.path)
            assert same.read_bytes() == file.read_bytes(), file
    assert not list((ours.path / "gyro_matrix").glob("c.*"))
    assert list((ours.path / "time_error").glob("c.*"))
    assert ours.digest() == theirs.digest()
    assert ours.state().unfinished == []


def test_what_stands_still_is_held_once_and_stored_as_if_it_were_in_full(tmp_path):
    """Recordings in parts of two, of which the first parts stand still, or all; minus zero too."""
    layout = Layout(9, 40, 2.0, {"gyro": 1e-6, "accel": None})
    made, whole = Shard(layout, 9), batch(layout, 0)
    for name in ALWAYS:
        if "time" in VARIABLES[name].dims:
            until = 9 if name in ("attitude", "plate_angle", "lost") else 4
            whole[name][:until] = whole[name][:until, :1]
    whole["plate_angle"] = whole["plate_angle"] * -0.0
    for first in range(0, 9, 2):
        part = {name: values[first : first + 2] for name, values in whole.items()}
        for name, values in part.items():
            if "time" in VARIABLES[name].dims and (values == values[:, :1]).all():
                part[name] = np.broadcast_to(values[:, :1], values.shape)
        made.append(part)
    held = made.variables()
    assert held["plate_angle"].strides[1] == 0 != held["gyro"].strides[1]
    ours, theirs = (store.create(tmp_path / n, layout, {"a": 1}, {}) for n in ("a", "b"))
    ours.write_shard(0, held)
    theirs.write_shard(0, whole)
    for file in theirs.path.rglob("*"):
        if file.is_file():
            assert (ours.path / file.relative_to(theirs.path)).read_bytes() == file.read_bytes()
    assert ours.digest() == theirs.digest()
    np.testing.assert_array_equal(ours.label("gyro"), whole["gyro"])
