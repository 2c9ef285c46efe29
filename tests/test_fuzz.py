"""Outside data of every kind, spoiled: a clear error or a possible answer. Many more of them, in
processes of their own: `make study-fuzz`."""

import os
from pathlib import Path

import numpy as np
import pytest
from fuzzing import EDITS, FORMATS, PLANTS, TOKENS, Bench, edited, readers, tiny_trainer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lbgc.data import logs
from lbgc.data.logs import LogConfig
from lbgc.errors import InputError
from lbgc.learning import checkpoint

CHEAP = {"csv": 60, "recordings": 40, "means": 40, "parquet": 60, "psins": 60, "imu yaml": 30,
         "log yaml": 30, "checkpoint": 30, "model": 40, "unit": 40, "store payload": 8,
         "store documents": 15, "manifest": 10,
         **dict.fromkeys(FORMATS, 4),
         **dict.fromkeys(("text gz", "npy", "npz", "rows"), 40), "npy 3.0": 20}  # fmt: skip

steps = st.lists(
    st.tuples(st.sampled_from(list(EDITS)), st.floats(0, 1), st.integers(0, 2**31)),
    min_size=1,
    max_size=3,
)


@pytest.fixture(scope="module")
def benches(tmp_path_factory) -> dict[str, Bench]:
    home = tmp_path_factory.mktemp("fuzz")
    every = readers(home)
    others = [next(iter(reader.files.values())) for reader in every.values()]
    return {n: Bench(home / n.replace(" ", "_"), r, others) for n, r in every.items()}


def tried(bench: Bench, target: str, changes: list, forged: bool = False) -> bool:
    """Whether it was refused; an answer must be a possible one."""
    bench.spoil(target, changes, forged)
    try:
        answer = bench.reader.read(bench.place)
    except InputError:
        return True
    finally:
        bench.mend()
    assert bench.verdict(answer, changes, forged) is None
    return False


@pytest.mark.filterwarnings("ignore")  # an overflow on the way to a refusal
@pytest.mark.parametrize("kind", CHEAP)
def test_whatever_was_done_to_a_file_it_is_refused_or_answered_rightly(kind, benches):
    if kind not in benches:
        pytest.skip(f"the package that reads {kind}, of the extra logs, is not installed")
    bench = benches[kind]
    targets = list(bench.reader.targets or bench.reader.files)

    @settings(max_examples=CHEAP[kind], derandomize=True, deadline=None, database=None,
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(st.sampled_from(targets), steps, st.booleans())
    def check(target, changes, forged):
        tried(bench, target, changes, forged)

    check()


@pytest.mark.parametrize("at", [0.4131452897267982, 0.42972089118796497])
def test_what_a_parquet_file_says_of_a_columns_sizes_is_not_asked_for(at, benches):
    """Arrow ended the process where one bit of that was flipped (two files of the study)."""
    assert tried(benches["parquet"], "log.parquet", [("flip", at, 497208953)])
    assert tried(benches["parquet"], "log.parquet", [("flip", at, 275737036)])


@pytest.mark.parametrize("kind", ["recordings", "checkpoint", "model", "store payload"])
@pytest.mark.parametrize("planted", PLANTS)
def test_what_is_no_file_is_refused_and_no_link_is_followed(kind, planted, benches):
    """A pipe above all: reading it would never end."""
    bench = benches[kind]
    target = next(iter(bench.reader.targets or bench.reader.files))
    for number in range(2):
        refused = tried(bench, target, [(planted, 0.0, number)])
        by_name = kind == "checkpoint" and planted in ("absent", "name", "dangling", "loop")
        by_name |= kind == "recordings" and planted == "name"
        allowed = planted == "link" and not bench.reader.closed
        assert refused or by_name or allowed


def test_mutations_do_something():
    content = Path(__file__).read_bytes()
    for name in EDITS:
        assert edited(content, [(name, 0.5, 12345)], [b"another file's"]) != content, name
    assert len(set(TOKENS)) == len(TOKENS)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("hydra: {callbacks: {a: {x: 1}}}", "key of it = hydra: choose from name"),
        ("gyro: {lines: [[{_target_: os.system}]]}", "key of lines = _target_"),
        ("a: !!python/name:os.system x", "the tag"),
        ("gyro: &a {range_deg_per_s: 1}\naccel: {<<: *a}", "key of accel = <<"),
        (
            "name: [&a0 [x, x]" + "".join(f", &a{i + 1} [*a{i}, *a{i}]" for i in range(13)) + "]",
            "more than 10000 values",
        ),
        ("name: [&a x" + ", *a" * 101 + "]", "100 aliases"),
        ("name: x\nname: y", "name stands there twice"),
        ("name: a\ndefaults: [mine, _self_]", "too many, or itself"),
        ("defaults: [/hydra/callbacks@hydra.callbacks: x]", "in its list of defaults"),
        ("defaults: [stim300, sdc500]", "takes _self_ and one other file of imu"),
        ("[" * 30 + "]" * 30, "nested more than 20 deep"),
        ("name: ${b}", "${...} is not filled in"),
        ("name: " + "9" * 5000, "more than 1000 characters"),
        ("gyro: {tone_hz: " + "9" * 400 + "}", "must be a finite number"),
        ("a: b: c", "mapping values are not allowed"),
        ("a: \ufffe", "not"),
    ],
)
def test_configurations_that_could_run_or_grow_are_refused(tmp_path, cli, text, says):
    (tmp_path / "imu").mkdir()
    (tmp_path / "imu/mine.yaml").write_text(text)
    done = cli("lbgc.bound", "--config-dir", str(tmp_path), "imu=mine")
    assert done.code == 2
    assert says in done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize("path", ["~no-such-user/x.csv", "x" * 5000, "a\x00b", "/dev/zero", "."])
def test_odd_paths_of_logs_are_refused(path):
    with pytest.raises(InputError, match=r"log\.path"):
        list(logs.read(LogConfig(path=path)))


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [("f_x", 1e300, "more than anything measures"), ("t", np.inf, "time in row 3 = inf")],
)
def test_numbers_that_nothing_measures_are_refused(tmp_path, column, value, says):
    from test_logs import columns, config, write

    values = columns()
    values[column] = values[column].copy()
    values[column][3] = value
    with pytest.raises(InputError, match=says):
        list(logs.read(config(write(tmp_path / "log.csv", values))))


def test_a_column_that_stands_there_twice_is_refused(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("t,w_x,w_x,w_y,w_z,f_x,f_y,f_z\n0,1,1,1,1,1,1,1\n1,1,1,1,1,1,1,1\n")
    with pytest.raises(InputError, match="w_x: stands in log twice"):
        list(logs.read(LogConfig(path=str(file), latitude=0.0, time_column="t")))


def test_nothing_is_unpacked_that_is_not_bounded(tmp_path):
    """NumPy would, by the file's ending, and a small file may hold a very large one."""
    import gzip

    (tmp_path / "a.imu.gz").write_bytes(gzip.compress(b"1 2 3 4 5 6\n" * 1000))
    with pytest.raises(InputError, match=r"log\.path"):
        list(logs.read(LogConfig(path=str(tmp_path / "a.imu.gz"), reader="psins", latitude=1.0)))


def test_a_store_opens_no_codec_that_it_names(benches):
    """Checksums made to fit: the schema alone says what is decoded, and how large it may be."""
    bench = benches["store documents"]
    for target, old, new in (
        ("d.zarr/gyro/zarr.json", b'"blosc"', b'"numcodecs.pickle"'),
        ("d.zarr/heading/zarr.json", b'"zarr_format": 3', b'"zarr_format": 2'),
        ("d.zarr/heading/zarr.json", b"[\n    2\n  ]", b"[\n    99999999999\n  ]"),
        ("d.zarr/accel/zarr.json", b"4200", b"4200000000000"),
        ("d.zarr/gyro/zarr.json", b'"shape"', b'"x": {}, "shape"'),
    ):
        content = bench.reader.files[target]
        assert old in content, target
        (bench.place / target).write_bytes(content.replace(old, new, 1))
        assert bench.reader.reseal is not None
        bench.reader.reseal(bench.place)
        with pytest.raises(InputError, match=r"is no dataset of this version|is damaged: "):
            bench.reader.read(bench.place)
        bench.mend()
    assert os.listdir(bench.place) == ["d.zarr"]


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    """Whole, and yet not this network's, or with counters that would be taken for its own."""
    file = tmp_path / "checkpoint.safetensors"
    tiny_trainer().run(file, lambda _: None)
    tensors, said = checkpoint.read(file)
    for changed in (
        (tensors | {"net": {}}, said),
        (tensors | {"optimiser": {f"0{n}": v for n, v in tensors["optimiser"].items()}}, said),
        (tensors, said | {"step": 3}),
        (tensors, said | {"history": [1]}),
        (tensors, said | {"schedule": said["schedule"] | {"optimizer": 1}}),
        (tensors, {k: v for k, v in said.items() if k != "groups"}),
    ):
        checkpoint.write(file, *changed)
        with pytest.raises(InputError, match="is of another training; delete it to start anew"):
            tiny_trainer().run(file, lambda _: None)
    checkpoint.write(file, tensors, said)
    tiny_trainer().run(file, lambda _: None)


@pytest.mark.parametrize("text", ["step,all\n1,x\n", "a,b\n1,2\n", "\x00", ""])
def test_a_damaged_history_is_named(tmp_path, text):
    from lbgc.report import history

    (tmp_path / history.FILE).write_text(text)
    with pytest.raises(InputError, match=r"run = .*history.csv: is damaged"):
        history.read(tmp_path / history.FILE, None)
