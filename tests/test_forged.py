"""Right checksums, and nonsense under them: refused in one line, or answered with numbers. Many
more: `make study-fuzz`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from forging import Forger, clear, tried

import lbgc.bound
from lbgc import fault, machine
from lbgc.data import logs, store
from lbgc.data.logs import LogConfig
from lbgc.data.readers import tables
from lbgc.data.store import Dataset, Layout
from lbgc.errors import InputError, build
from lbgc.learning import description
from lbgc.learning.demand import check
from lbgc.learning.model import ModelConfig
from lbgc.sensor.datasheet import ImuConfig


@pytest.fixture(scope="module")
def forger(tmp_path_factory) -> Forger:
    return Forger.at(tmp_path_factory.mktemp("forged"))


@pytest.mark.parametrize("number", [0, 1, 2, 4, 5, 6, 7, 8, 17])
def test_a_forgery_is_refused_or_answered_with_numbers(forger, number):
    name, wrong = tried(forger, 7, number)
    assert wrong is None, name


def changed(content: dict, path: str, value: object) -> dict:
    *above, last = path.split(".")
    inside = content = {**content}
    for key in above:
        inside[key] = {**inside[key]}
        inside = inside[key]
    inside[last] = value
    return content


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("latitude", 91, "latitude = 91.0 deg: must be from -90 to 90"),
        ("latitude", 1e300, "latitude = 1e+300 deg: must be 0, or from 1e-30 to 1e+30 in size"),
        ("units", 10**9 + 1, "units = 1000000001"),
        ("recordings", 23, "but the dataset has 24"),
        ("mean_s", 10.0, "rate_hz = 600.0 Hz: is not that of the dataset's values"),
        ("imu", None, "imu = None: must be a group"),
        ("imu.gyro.arw_deg_per_sqrt_h", "x", "imu.gyro.arw_deg_per_sqrt_h = x"),
        ("scene", {}, "scene.arm_m = (missing)"),
        ("scene.reference_error_deg", -1, "must not be negative"),
        ("protocol.kind", "spiral", "protocol.kind = spiral: choose from"),
        ("split", [1, 2], "must be three shares"),
    ],
)
def test_a_stored_configuration_is_held_to_what_a_command_line_is(forger, path, value, says):
    where = forger.home / "own.zarr"
    clear(where)
    dataset = store.create(where, forger.layout, changed(forger.configuration, path, value), {})
    with pytest.raises(InputError, match="that no generation takes") as error:
        _ = dataset.configuration
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [("unit", 2**31 - 1), ("session", -1), ("split", 3), ("latitude", 1.6), ("heading", np.nan),
     ("heading_reference", 7.0), ("gyro", np.inf), ("gyro_bias_unit", -np.inf)],
)  # fmt: skip
def test_labels_are_numbers_within_their_bounds(forger, name, value):
    where = forger.home / "labels.zarr"
    clear(where)
    dataset = store.create(where, forger.layout, forger.configuration, {})
    arrays = dict(forger.arrays)
    arrays[name] = arrays[name].copy()
    arrays[name].flat[-1] = value
    dataset.write_shard(0, arrays)
    with pytest.raises(InputError, match=f"holds what no generation writes .{name} ="):
        list(dataset.records(np.arange(24))) if name == "gyro" else dataset.label(name)


@pytest.mark.parametrize(
    ("key", "value"),
    [("latitude_deg", [1.0]), ("latitude_deg", [50.0, 40.0]), ("steps", -1), ("seconds", -1.0),
     ("units", {"unit_seed": -1, "units": 1, "imu": {}}), ("training", {"windows_s": [-20.0]}),
     ("training", {"windows_s": [20.0], "a": [[[[[[[1]]]]]]]}), ("rate_hz", 1e300)],
)  # fmt: skip
def test_a_models_description_is_checked_by_value(forger, key, value):
    content = description.compose({**forger.said, key: value}, forger.weights)
    with pytest.raises(InputError, match="holds a damaged model"):
        description.parse(content, "run", "here")


def test_a_fault_of_ours_is_two_lines_a_log_and_exit_3(cli, monkeypatch):
    monkeypatch.setattr(lbgc.bound.BoundConfig, "__post_init__", _breaks)
    done = cli("lbgc.bound")
    assert done.code == fault.EXIT == 3
    assert len(done.err.strip().splitlines()) == 2, done.err
    first, second = done.err.strip().splitlines()
    assert "a fault of lbgc's own, not of the input: KeyError: 'absent' (tests/" in first
    log = second.removeprefix("its report is ").split(";")[0]
    report = Path(log).read_text()
    for part in ("Traceback", "KeyError: 'absent'", "command   lbgc.bound", "numpy 2"):
        assert part in report
    done = cli("lbgc.bound", "-m", "latitude=10,20")
    assert done.code == 3
    assert "Traceback" not in done.err
    assert "a fault of lbgc's own" in done.err


def _breaks(_: object) -> None:
    raise KeyError("absent")


@pytest.mark.parametrize(
    ("module", "arguments", "says"),
    [
        ("sim.generate", "imu=null", "imu = null: choose from adis16405"),
        ("sim.generate", "imu=1", "imu = 1: choose from adis16405"),
        ("sim.generate", "cluster=null", "cluster = null: choose from dask"),
        ("sim.generate", "recordings=1000000000", "recordings = 1000000000: must be 64000000"),
        ("sim.generate", "recordings=60000000", "recordings = 60000000: takes at least 34.6 TB"),
        ("sim.generate", "duration_s=1e12", "duration_s = 1000000000000.0 s: must be 166667 at"),
        ("sim.generate", "duration_s=1e5 protocol=carousel", "duration_s = 100000.0 s: one"),
        ("sim.generate", "scene.physics_hz=1.2e9", "scene.physics_hz = 1200000000.0 Hz: a minute"),
        ("sim.generate", "split=[1000000000000,1,1]", "1000000 together at most"),
        ("sim.generate", "imu.gyro.arw_deg_per_sqrt_h=1e300", "from 1e-30 to 1e+30 in size"),
        ("sim.generate", "imu.gyro.arw_deg_per_sqrt_h=1e-300", "from 1e-30 to 1e+30 in size"),
        ("sim.generate", f"seed={10**40}", "must be less than 2^63"),
        ("lbgc.bound", "windows_s=[1e-9]", "must be a sample or more"),
        ("lbgc.bound", "height_m=1e9", "height_m = 1000000000.0 m: must be from -12000"),
        ("lbgc.bound", "start_s=1e30", "by more than numbers can hold"),
    ],
)
def test_numbers_beyond_the_machine_are_refused_by_name(cli, monkeypatch, module, arguments, says):
    monkeypatch.setattr(machine, "memory", lambda: 24e9)
    done = cli(module, *arguments.split())
    assert done.code == 2
    assert says in done.err
    assert "Traceback" not in done.err


def test_a_key_that_is_taken_away_is_as_the_dataclass_has_it(cli):
    for own in ("~imu.gyro.arw_deg_per_sqrt_h", "~imu", "~cluster"):
        done = cli("sim.generate", own, "recordings=1", "duration_s=10", f"out={own[1:]}.zarr")
        assert done.code == 0, done.err


def test_what_a_training_takes_is_known_before_it(monkeypatch):
    monkeypatch.setattr(machine, "memory", lambda: 24e9)
    check(ModelConfig(), 100, 16_000, 48, 2000, 10**6)
    huge = ModelConfig(layers=64, hidden=4096)
    for named, own in (
        ("model.hidden", (huge, 1, 1, 1, 1, 1)),
        ("batch", (ModelConfig(), 10**9, 1, 48, 1, 1)),
        ("mean_s", (ModelConfig(), 1, 1, 48, 1, 10**12)),
    ):
        with pytest.raises(InputError, match=f"{named} = .* of memory, and this machine has 24 GB"):
            check(*own)


def test_parquet_that_unfolds_beyond_a_limit_is_not_read(tmp_path, monkeypatch):
    """A few kilobytes hold any number of equal values, and one long text many times."""
    file = tmp_path / "a.parquet"
    table = pa.table({name: pa.repeat(0.0, 300_000) for name in "tabcdef"})
    pa.parquet.write_table(table, file, compression="zstd")
    assert file.stat().st_size < 50_000
    monkeypatch.setattr(tables, "LARGEST", 10**7)
    config = LogConfig(path=str(file), latitude=1.0, rate_hz=10.0, columns=[2, 3, 4, 5, 6, 7])
    with pytest.raises(InputError, match=r"unfolds to .* bytes, and 10000000 are the most"):
        list(logs.read(config))
    text = pa.DictionaryArray.from_arrays(pa.repeat(0, 10_000), ["x" * 200_000])
    table = pa.table({"t": text, **{n: pa.repeat(0.0, 10_000) for n in "abcdef"}})
    pa.parquet.write_table(table, file)
    config = replace(config, time_column="t", gyro_columns=["a", "b", "c"], rate_hz=None,
                     accel_columns=["d", "e", "f"])  # fmt: skip
    with pytest.raises(InputError, match="holds a text of 200000 bytes"):
        list(logs.read(config))


def test_a_store_that_claims_a_thousand_million_recordings_opens_at_once(tmp_path):
    dataset = store.create(tmp_path / "d.zarr", Layout(10**9, 4, 0.2, {}), {"a": 1}, {})
    assert Dataset.open(dataset.path).layout.shards == 1953125
    with pytest.raises(InputError, match="1953125 of 1953125 shards are missing"):
        Dataset.open_finished(dataset.path)


def test_memory_is_the_least_of_machine_group_and_process(monkeypatch, tmp_path):
    (tmp_path / "own").mkdir()
    (tmp_path / "own/memory.max").write_text("123000000\n")
    (tmp_path / "memory.max").write_text("max\n")
    files = [tmp_path / name for name in ("own/memory.max", "memory.max", "absent")]
    monkeypatch.setattr(machine, "_limits", lambda: files)
    assert machine.memory() == 123e6
    assert machine.size(123e6) == "123 MB"
    assert machine.span(7200) == "2 hours"


@pytest.mark.parametrize("value", [1e31, -1e31, 1e-31, 2**120])
def test_every_number_of_a_configuration_has_a_size(value):
    with pytest.raises(InputError, match="in size"):
        build(ImuConfig, {"name": "x", "gyro": {"arw_deg_per_sqrt_h": value}})
