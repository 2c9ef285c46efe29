"""Logs of one triad, of two files and of two clocks; scale and offset an axis; what is left out."""

import json

import numpy as np
import pytest
from test_logs import columns, config, write

from lbgc import fit
from lbgc.data import two_clocks
from lbgc.data.logs import LogConfig, read, read_noise
from lbgc.data.record import mock_record
from lbgc.errors import InputError

RATE, SAMPLES = 20.0, 3000
GYRO_N, ACCEL_N = 2e-6, 2e-3  # rad/sqrt(s), m/s^1.5


def log(rate: float = RATE, samples: int = SAMPLES, seed: int = 1, start: float = 0.0):
    """Columns of a resting log with white noise, deg/s and m/s2, stamps at the samples' ends."""
    rng, mock = np.random.default_rng(seed), mock_record()
    gyro, accel = (
        mean[0] + n * np.sqrt(rate) * rng.standard_normal((samples, 3))
        for mean, n in ((mock.gyro, GYRO_N), (mock.accel, ACCEL_N))
    )
    values = {"t": start + np.arange(1, samples + 1) / rate}
    values |= {f"w_{a}": np.rad2deg(own) for a, own in zip("xyz", gyro.T, strict=True)}
    return values | {f"f_{a}": own for a, own in zip("xyz", accel.T, strict=True)}


def only(values: dict[str, np.ndarray], kind: str) -> dict[str, np.ndarray]:
    """The time and the columns of one triad, w or f."""
    return {name: own for name, own in values.items() if name == "t" or name.startswith(kind)}


@pytest.fixture
def files(tmp_path):
    """One log as one file and as two."""
    values = log()
    return {
        "both": write(tmp_path / "both.csv", values),
        "gyro": write(tmp_path / "gyro.csv", only(values, "w")),
        "accel": write(tmp_path / "accel.csv", only(values, "f")),
    }


def fitted(log: LogConfig, tmp_path, monkeypatch, **more) -> tuple[dict, str]:
    """The estimates of a fit, and the sensor's YAML."""
    monkeypatch.chdir(tmp_path)
    directory = fit.main(fit.FitConfig(log=log, processes=1, flicker_short_s=1.0, **more))
    yaml = (directory / "imu" / "mine.yaml").read_text()
    return json.loads((directory / "fit.json").read_text()), yaml


def test_one_triad_is_read_as_in_the_whole_log(files):
    (whole,) = read(config(files["both"]))
    for part, other in (("gyro", "accel"), ("accel", "gyro")):
        for file in (files[part], files["both"]):
            ((one,),) = read_noise(config(file, **{f"{other}_columns": "none"}))
            assert one.part == part
            np.testing.assert_array_equal(one.values, whole.triads[part])
            assert any(note.startswith("one triad:") for note in one.notes)


def test_the_fit_of_gyros_alone_is_that_of_the_whole_log(files, tmp_path, monkeypatch, capsys):
    whole, _ = fitted(config(files["both"]), tmp_path, monkeypatch)
    alone, yaml = fitted(
        config(files["gyro"], accel_columns="none"), tmp_path, monkeypatch, export=["kalibr", "px4"]
    )
    assert alone == {"gyro": whole["gyro"]}
    assert "its accelerometers were not measured and have no errors here" in yaml
    assert "\naccel:" not in yaml
    assert (
        "no accelerometers were recorded: mine has none of their errors" in capsys.readouterr().out
    )
    written = (tmp_path / "outputs/fit/latest/export/imu.yaml").read_text()
    assert "accelerometers were not measured" in written
    assert "accel: stated without noise" in written


def test_a_heading_takes_both_triads(files):
    for part, other in (("gyro", "accel"), ("accel", "gyro")):
        with pytest.raises(InputError, match="need gyros and accelerometers both") as caught:
            list(read(config(files[part], **{f"{other}_columns": "none"})))
        assert caught.value.name == f"log.{other}_columns"
        with pytest.raises(InputError, match=f"log.{other}_columns=none where that triad"):
            list(read(config(files[part])))


@pytest.mark.parametrize(
    ("changes", "name", "says"),
    [
        ({"accel_columns": "none", "gyro_unit": "auto"}, "log.gyro_unit", "do not say it"),
        ({"accel_columns": "none", "gyro_columns": "none"}, "accel_columns", "nothing is left"),
        ({"accel_columns": "none", "accel_path": "x"}, "accel_path", "whose columns are none"),
        ({"accel_columns": "none", "reader": "psins"}, "reader", "both triads in each row"),
        ({"accel_columns": "none", "positions": [[0, 60, 0]]}, "log.positions", "at rest"),
        ({"gyro_columns": ["w_x"]}, "gyro_columns", "three column names"),
        ({"accel_columns": "none", "columns": [1, 2, 3, 4, 5, 6]}, "columns", "leaves one triad"),
        ({"accel_late_s": 1.0}, "accel_late_s", "another file, table"),
        ({"accel_path": ["a", "b"]}, "accel_path", "must name 1"),
        ({"gyro_scale": [1.0, 2.0]}, "gyro_scale", "three: x, y, z"),
        ({"accel_scale": [1.0, 0.0, 1.0]}, "accel_scale", "must not be zero"),
        ({"gyro_offset": [1.0]}, "gyro_offset", "three: x, y, z"),
        ({"accel_rows": ["sensor", "acc"]}, "accel_rows", "needs gyro_rows"),
        ({"gyro_rows": ["sensor"]}, "gyro_rows", "column, value"),
        ({"leave_out": [[9, 5]]}, "leave_out", "in order of time"),
        ({"leave_out": [[5, 9], [8, 12]]}, "leave_out", "without overlap"),
        ({"leave_out": [[900, 950]]}, "log.leave_out", "ends at 150 s"),
        ({"leave_out": [[0, 900]]}, "log.leave_out", "leaves nothing"),
        ({"rows": [5]}, "rows", "first, last"),
        ({"rows": [9, 5]}, "rows", "first, last"),
        ({"rows": [1, 4000]}, "log.rows", "3000 rows"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_its_key(files, changes, name, says):
    with pytest.raises(InputError, match=says) as caught:
        read_noise(config(files["both"], **changes))
    assert caught.value.name == name
    assert "\n" not in str(caught.value)


def test_two_files_of_one_clock_are_the_one_file(files):
    (whole,) = read(config(files["both"]))
    (two,) = read(config(files["gyro"], accel_path=str(files["accel"])))
    for name in ("gyro", "accel", "plate_angle"):
        np.testing.assert_array_equal(getattr(two, name), getattr(whole, name))
    assert (two.rate_hz, two.notes) == (whole.rate_hz, whole.notes)


def test_two_tables_of_one_file(tmp_path):
    """Tables of one triad may call their columns x, y and z, as those of ULog do."""
    values = log()
    kind = np.dtype([(name, "f8") for name in "txyz"])
    tables = {}
    for name, letter in (("sensor_gyro", "w"), ("sensor_accel", "f")):
        rows = np.empty(SAMPLES, kind)
        for column, own in zip("txyz", only(values, letter).values(), strict=True):
            rows[column] = own
        tables[name] = rows
    np.savez(tmp_path / "log.npz", **tables)
    said = {"table": "sensor_gyro", "accel_table": "sensor_accel"}
    (two,) = read(config(tmp_path / "log.npz", **said))
    (whole,) = read(config(write(tmp_path / "log.parquet", values)))
    np.testing.assert_array_equal(two.gyro, whole.gyro)
    np.testing.assert_array_equal(two.accel, whole.accel)


def test_stamps_that_nearly_agree_are_joined_row_by_row(tmp_path):
    values = log()
    gyro = write(tmp_path / "gyro.csv", only(values, "w"))
    late = only(values, "f") | {"t": values["t"] + 0.2 / RATE}
    (record,) = read(config(gyro, accel_path=str(write(tmp_path / "accel.csv", late))))
    np.testing.assert_allclose(record.accel[:, 1], values["f_y"], rtol=1e-12)
    assert record.notes[0].startswith("one clock:")
    assert "0.2 of a sample" in record.notes[0]
    late["mark"] = late.pop("t")  # a name that tells no time
    file = write(tmp_path / "accel.csv", late)
    (same,) = read(config(gyro, accel_path=str(file), accel_time_column="mark"))
    np.testing.assert_array_equal(same.accel, record.accel)
    assert same.notes == record.notes


def test_files_without_a_clock_have_rows_of_the_same_instants(tmp_path):
    values = log()
    gyro, accel = only(values, "w"), only(values, "f")
    del gyro["t"], accel["t"]
    files = [write(tmp_path / f"{name}.csv", own) for name, own in (("w", gyro), ("f", accel))]
    said = {"time_column": None, "rate_hz": RATE, "accel_path": str(files[1])}
    (record,) = read(config(files[0], **said))
    assert (len(record.gyro), record.rate_hz) == (SAMPLES, RATE)
    short = {name: own[:-1] for name, own in accel.items()}
    write(files[1], short)
    with pytest.raises(InputError, match="gyros have 3000 rows, the accelerometers 2999"):
        list(read(config(files[0], **said)))


def apart(tmp_path, accel_hz: float, start: float = 0.31, **said) -> tuple[LogConfig, dict, dict]:
    """A log of two files on two clocks, and their columns."""
    gyro = only(log(), "w")
    accel = only(log(accel_hz, round(150 * accel_hz), seed=2, start=start), "f")
    file = write(tmp_path / "accel.csv", accel)
    return config(write(tmp_path / "gyro.csv", gyro), accel_path=str(file), **said), gyro, accel


@pytest.mark.parametrize("accel_hz", [7.3, 20.05, 53.0])
def test_two_clocks_keep_means_and_heading(tmp_path, accel_hz):
    """The integral of the faster triad is kept: over whole intervals it is that of its samples."""
    own, gyro, accel = apart(tmp_path, accel_hz)
    (record,) = read(own)
    slow = accel_hz if accel_hz < RATE else RATE
    assert record.rate_hz == pytest.approx(slow, rel=1e-6)
    note = next(one for one in record.notes if one.startswith("two clocks:"))
    assert "takes each triad's own samples" in note
    begin = 0.31 if slow == accel_hz else np.ceil(0.31 * RATE) / RATE  # the accelerometers are late
    span = len(record.gyro) / record.rate_hz
    ends, rates = gyro["t"], np.deg2rad(gyro["w_x"])
    integral = np.concatenate([[0.0], np.cumsum(rates) / RATE])
    over = np.interp([begin, begin + span], np.concatenate([[0.0], ends]), integral)
    assert record.gyro[:, 0].sum() / record.rate_hz == pytest.approx(np.diff(over)[0], rel=1e-6)
    ends, forces = accel["t"] - 0.31, accel["f_z"]
    integral = np.concatenate([[0.0], np.cumsum(forces) / accel_hz])
    over = np.interp(np.array([begin, begin + span]) - 0.31, np.r_[0.0, ends], integral)
    assert record.accel[:, 2].sum() / record.rate_hz == pytest.approx(np.diff(over)[0], rel=1e-6)


def test_means_over_another_clocks_intervals_are_overlaps():
    rng = np.random.default_rng(3)
    values = rng.standard_normal((40, 2))
    for offset, ratio in ((0.0, 1.0), (0.3, 1.0), (0.7, 2.6), (3.0, 4.0), (1.25, 0.98)):
        count = int((40 - offset) / ratio)
        got = two_clocks._means(values, offset, ratio, 0, count)
        for k in range(count):
            low, high = offset + k * ratio, offset + (k + 1) * ratio
            edges = np.arange(40)
            share = np.clip(np.minimum(high, edges + 1) - np.maximum(low, edges), 0, None)
            np.testing.assert_allclose(got[k], share @ values / ratio, atol=1e-12)


@pytest.mark.parametrize("ratio", [1.0003, 1.7, 3.2])
def test_white_noise_of_resampled_values_is_as_derived(ratio):
    """Variance N^2/tau (1 - 1/(3 r)), covariance of neighbours N^2/tau/(6 r); five sigma of as many
    values, of which neighbours are correlated."""
    values = np.random.default_rng(4).standard_normal((60_000, 3))
    count = int(60_000 / ratio) - 2
    got = two_clocks._means(values, 0.4, ratio, 0, count) * np.sqrt(ratio)
    error = 5 * np.sqrt(2 * 1.5 / (3 * count))
    assert got.var() == pytest.approx(1 - 1 / (3 * ratio), abs=error)
    assert (got[1:] * got[:-1]).mean() == pytest.approx(1 / (6 * ratio), abs=error)


def test_a_fit_takes_each_triads_own_samples(tmp_path, monkeypatch):
    """White noise is recovered within five sampling errors although the clocks differ."""
    own, _, accel = apart(tmp_path, 53.0)
    gyros, forces = read_noise(own)
    assert [len(group[0].values) for group in (gyros, forces)] == [SAMPLES, len(accel["t"])]
    found, yaml = fitted(own, tmp_path, monkeypatch)
    for part, n, samples in (("gyro", GYRO_N, SAMPLES), ("accel", ACCEL_N, len(accel["t"]))):
        for axis in found[part]:
            assert axis["estimates"]["N"]["value"] == pytest.approx(n, rel=5 / np.sqrt(2 * samples))
    assert "its gyro: 1 x 150 s at 20 Hz" in yaml
    assert "its accel: 1 x 150 s at 53 Hz" in yaml


def test_clocks_without_common_time_are_refused_and_moved(tmp_path):
    own, *_ = apart(tmp_path, 20.0, start=1e5)
    with pytest.raises(InputError, match="begin 100000 s after the gyros'; "):
        list(read(own))
    own, *_ = apart(tmp_path, 20.0, start=1e5, accel_late_s=1e5)
    (record,) = read(own)
    assert len(record.gyro) == SAMPLES


def test_rows_of_one_triad_each(tmp_path):
    """As loggers of telephones write them: empty cells where the row is of the other sensor."""
    gyro, accel = only(log(), "w"), only(log(50.0, 7500, seed=2, start=0.004), "f")
    times = np.concatenate([gyro["t"], accel["t"]])
    order = np.argsort(times)
    values = {"t": times[order]}
    for name, own in (gyro | accel).items():
        if name != "t":
            empty = np.full(SAMPLES if name[0] == "f" else 7500, np.nan)
            values[name] = np.concatenate([empty, own] if name[0] == "f" else [own, empty])[order]
    file = write(tmp_path / "log.csv", values)
    (record,) = read(config(file))
    accels = write(tmp_path / "accel.csv", accel)
    (two,) = read(config(write(tmp_path / "gyro.csv", gyro), accel_path=str(accels)))
    np.testing.assert_allclose(record.gyro, two.gyro, rtol=1e-9)
    np.testing.assert_allclose(record.accel, two.accel, rtol=1e-9)
    few = log()
    few["f_y"][7] = np.nan
    with pytest.raises(InputError, match="accel y in row 7"):
        list(read(config(write(tmp_path / "few.csv", few))))


def test_sensors_that_write_rows_of_one_table(tmp_path):
    """Time, sensor, x, y, z, as telephones have it: each sensor's rows are stated, and rows of two
    are not read as one's."""
    gyro, accel = only(log(samples=1500), "w"), only(log(samples=1500, seed=2, start=0.01), "f")
    rows = [
        f"{own['t'][k]:.6f},{name},{','.join(repr(float(own[f'{kind}_{a}'][k])) for a in 'xyz')}"
        for k in range(1500)
        for name, kind, own in (("gyr", "w", gyro), ("acc", "f", accel))
    ]
    file = tmp_path / "phone.csv"
    file.write_text("\n".join(["t,sensor,x,y,z", *rows]) + "\n")
    said = {"gyro_rows": ["sensor", "gyr"], "accel_rows": ["sensor", "acc"]}
    (record,) = read(config(file, **said))
    accels = write(tmp_path / "accel.csv", accel)
    (two,) = read(config(write(tmp_path / "gyro.csv", gyro), accel_path=str(accels)))
    np.testing.assert_allclose(record.gyro, two.gyro, rtol=1e-12)
    np.testing.assert_allclose(record.accel, two.accel, rtol=1e-12)
    with pytest.raises(InputError, match="rows of phone are of two sensors") as caught:
        read_noise(config(file, accel_columns="none"))
    assert caught.value.name == "log.gyro_rows"
    with pytest.raises(InputError, match="is in no row of phone, which has gyr, acc"):
        list(read(config(file, **said | {"gyro_rows": ["sensor", "gyro"]})))
    ((alone,),) = read_noise(config(file, accel_columns="none", gyro_rows=["sensor", "gyr"]))
    np.testing.assert_array_equal(alone.values[:, 0], np.deg2rad(gyro["w_x"]))


def test_scale_and_offset_of_each_axis(tmp_path):
    """value = scale (count - offset)."""
    (plain,) = read(config(write(tmp_path / "plain.csv", log())))
    scale, offset = [2.0, -0.5, 4.0], [0.5, -1.0, 30.0]
    counts = log()
    for a, factor, zero in zip("xyz", scale, offset, strict=True):
        counts[f"w_{a}"] = counts[f"w_{a}"] / factor + zero
        counts[f"f_{a}"] = counts[f"f_{a}"] / factor + zero
    said = {"gyro_scale": scale, "gyro_offset": offset, "accel_scale": scale,
            "accel_offset": offset}  # fmt: skip
    file = write(tmp_path / "counts.csv", counts)
    with pytest.raises(InputError, match="mirrored frame with the signs of gyro_scale"):
        config(file, **said)
    (record,) = read(config(file, accel_axes=["x", "y", "z"], **said))
    np.testing.assert_allclose(record.gyro, plain.gyro, atol=1e-15)
    np.testing.assert_allclose(record.accel, plain.accel, atol=1e-13)


def test_signs_by_scale_make_the_frame():
    """Axes that are mirrored with a scale that mirrors them back are right-handed."""
    mirrored = {"axes": ["x", "y", "-z"]}
    with pytest.raises(InputError, match="mirrored frame"):
        config("x", **mirrored)
    both = {"gyro_scale": [1.0, 1.0, -1.0], "accel_scale": [2.0, 2.0, -2.0]}
    assert config("x", **mirrored, **both).axes == ["x", "y", "-z"]
    assert config("x", gyro_scale=[1.0, 1.0, -1.0]).axes == ["x", "y", "z"]  # the gyros' alone


def test_times_are_left_out(tmp_path):
    """A knock, in which cells may even be empty, does not end a log: its longest piece is read, or
    each."""
    values = log()
    (whole,) = read(config(write(tmp_path / "whole.csv", values)))
    for name in ("w_x", "f_z"):
        values[name][900:1000] = np.nan
    file = write(tmp_path / "log.csv", values)
    with pytest.raises(InputError, match="gyro x in row 900"):
        list(read(config(file)))
    said = {"leave_out": [[45.0, 50.0]]}
    (record,) = read(config(file, **said))
    np.testing.assert_array_equal(record.gyro, whole.gyro[1000:])
    assert record.notes[0].startswith("left out: 5 s of log (log.leave_out); of the 2 pieces")
    first, second = read(config(file, gaps="split", **said))
    np.testing.assert_array_equal(first.accel, whole.accel[:900])
    np.testing.assert_array_equal(second.accel, whole.accel[1000:])
    (joined,) = read(config(file, gaps="join", **said))
    np.testing.assert_array_equal(joined.gyro, np.delete(whole.gyro, slice(900, 1000), axis=0))
    assert "the 2 pieces were joined" in joined.notes[0]
    (cut,) = read(config(file, from_s=10.0, to_s=60.0, **said))
    np.testing.assert_array_equal(cut.gyro, whole.gyro[200:900])


def test_rows_are_left_out(tmp_path):
    values = {name: np.concatenate([[0.0] * 10, own]) for name, own in columns().items()}
    values["t"][:10] = np.arange(-10, 0) / 10.0
    file = write(tmp_path / "log.csv", values)
    (record,) = read(config(file, rows=[11, 255]))
    (whole,) = read(config(write(tmp_path / "whole.csv", columns())))
    np.testing.assert_array_equal(record.gyro, whole.gyro[:245])
    assert any(note.startswith("rows: 15 of log's 260") for note in record.notes)
