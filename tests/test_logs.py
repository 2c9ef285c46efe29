"""Real logs: read as they are, or refused with the reason."""

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from helpers import needs_recording

from lbgc.data.logs import LogConfig, read
from lbgc.data.record import mock_record
from lbgc.errors import InputError
from lbgc.units import DEG

MOCK = mock_record()
COLUMNS = ["t", "w_x", "w_y", "w_z", "f_x", "f_y", "f_z"]


def columns(n: int = 250) -> dict[str, np.ndarray]:
    """The mock record as a file has it: deg/s and m/s2, time in s."""
    gyro = np.rad2deg(MOCK.gyro[:n])
    values = [np.arange(n) / 10.0, *gyro.T, *MOCK.accel[:n].T]
    return dict(zip(COLUMNS, values, strict=True))


def write(path, values: dict[str, np.ndarray]):
    table = pa.table(values)
    if path.suffix == ".parquet":
        pa.parquet.write_table(table, path)
    else:
        pa.csv.write_csv(table, path)
    return path


def config(file, **changes) -> LogConfig:
    values = {
        "path": str(file),
        "time_column": "t",
        "gyro_unit": "deg/s",
        "latitude": 32.76,
        "heading_deg": 40.0,
        "bias_limit_deg_per_h": 5.0,
    }
    return LogConfig(**(values | changes))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_table_becomes_the_record_it_was_written_from(tmp_path, suffix):
    (record,) = read(config(write(tmp_path / f"log{suffix}", columns())))
    np.testing.assert_allclose(record.gyro, MOCK.gyro, rtol=1e-12)
    np.testing.assert_allclose(record.accel, MOCK.accel, rtol=1e-12)
    assert record.rate_hz == pytest.approx(10.0)
    assert record.heading is None
    assert record.heading_reference == pytest.approx(np.deg2rad(40.0))
    assert record.latitude == pytest.approx(MOCK.latitude)


@pytest.mark.parametrize(
    ("gyro_unit", "gyro_si", "accel_unit", "accel_si"),
    [
        ("rad/s", 1.0, "m/s2", 1.0),
        ("deg/h", DEG / 3600, "g", 9.80665),
        ("arcsec", DEG / 3600 * 10, "m/s", 10.0),  # increments over 0.1 s
        ("rad", 10.0, "ug*s", 9.80665e-6 * 10),
        ("deg/s", DEG, "auto", 9.80665),
        ("deg/s", DEG, "auto", 1.0),
    ],
)
def test_units_and_increments(tmp_path, gyro_unit, gyro_si, accel_unit, accel_si):
    values = columns()
    for i, axis in enumerate("xyz"):
        values[f"w_{axis}"] = MOCK.gyro[:, i] / gyro_si
        values[f"f_{axis}"] = MOCK.accel[:, i] / accel_si
    path = write(tmp_path / "log.parquet", values)
    (record,) = read(config(path, gyro_unit=gyro_unit, accel_unit=accel_unit, rate_hz=10.0))
    np.testing.assert_allclose(record.gyro, MOCK.gyro, rtol=1e-9)
    np.testing.assert_allclose(record.accel, MOCK.accel, rtol=1e-9)


def test_counts_have_a_scale(tmp_path):
    values = columns()
    for axis in "xyz":
        values[f"w_{axis}"] = values[f"w_{axis}"] / 1e-6
        values[f"f_{axis}"] = values[f"f_{axis}"] / 0.01
    path = write(tmp_path / "log.csv", values)
    (record,) = read(config(path, gyro_scale=1e-6, accel_scale=0.01))
    np.testing.assert_allclose(record.gyro, MOCK.gyro, rtol=1e-9)


def test_axes_are_turned_to_forward_right_down(tmp_path):
    """A sensor with x right, y forward, z up."""
    values = columns()
    f = {f"{k}_{a}": values[f"{k}_{a}"] for k in "wf" for a in "xyz"}
    for k in "wf":
        values |= {f"{k}_x": f[f"{k}_y"], f"{k}_y": f[f"{k}_x"], f"{k}_z": -f[f"{k}_z"]}
    path = write(tmp_path / "log.csv", values)
    (record,) = read(config(path, axes=["y", "x", "-z"]))
    np.testing.assert_allclose(record.gyro, MOCK.gyro, rtol=1e-12)


def test_the_published_layout(tmp_path):
    """x_<heading>.csv with an unnamed index column; a directory or one file."""
    values = columns()
    del values["t"]
    for heading in (40, 355):
        write(tmp_path / f"x_{heading}.csv", {"": np.arange(250)} | values)
    published = config(
        tmp_path,
        reader="recordings",
        time_column=None,
        rate_hz=10.0,
        heading_deg=None,
        accel_unit="auto",
    )
    records = list(read(published))
    assert [r.name for r in records] == ["x_355.csv", "x_40.csv"]
    assert [round(np.rad2deg(r.heading_reference)) for r in records] == [355, 40]
    one = config(
        tmp_path / "x_40.csv", reader="recordings", time_column=None, rate_hz=10.0, heading_deg=None
    )
    assert len(list(read(one))) == 1


PSINS = """% comment
1 2 -40.0 0 0 0
32.76 35.0 0 0 100.0 9.78
0.5 0.5 0.5 10 10 10
"""


def test_psins_says_the_rest_in_its_header(tmp_path):
    """Right-forward-up increments, arcsec and ug s a count, g the header's."""
    arcsec = np.rad2deg(MOCK.gyro) * 3600 * 0.1 / 0.5
    ugs = MOCK.accel / 9.78 * 1e6 * 0.1 / 10
    rows = np.column_stack(
        [arcsec[:, 1], arcsec[:, 0], -arcsec[:, 2], ugs[:, 1], ugs[:, 0], -ugs[:, 2]]
    )
    path = tmp_path / "log.imu"
    path.write_text(PSINS + "\n".join(" ".join(f"{v:.9g}" for v in row) for row in rows))
    log = LogConfig(reader="psins", path=str(path), axes=["y", "x", "-z"], bias_limit_deg_per_h=5)
    (record,) = read(log)
    np.testing.assert_allclose(record.gyro, MOCK.gyro, rtol=1e-6)
    np.testing.assert_allclose(record.accel, MOCK.accel, rtol=1e-6)
    assert record.rate_hz == pytest.approx(10.0)
    assert np.rad2deg(record.heading_reference) == pytest.approx(40.0)
    assert np.rad2deg(record.latitude) == pytest.approx(32.76)


@pytest.mark.parametrize(
    "text", ["", "hello\n", "1 2 3\n4 5 6\n", PSINS, PSINS.replace("100.0", "0")]
)
def test_what_is_no_psins_file_is_refused(tmp_path, text, recwarn):
    path = tmp_path / "log.imu"
    path.write_text(text)
    with pytest.raises(InputError, match=r"log.path = .*log.imu"):
        list(read(LogConfig(reader="psins", path=str(path))))


@pytest.mark.parametrize(
    "changes",
    [("0.5 0.5", "1e300 0.5"), ("100.0", "5e-324"), ("9.78", "1e-320"), ("-40.0", "1e29"),
     ("10 10 10", "1e29 10 10")],
)  # fmt: skip
def test_a_psins_header_that_overflows_is_refused(tmp_path, changes):
    """Before anything is computed from it: NumPy would warn, which is an error here."""
    path = tmp_path / "log.imu"
    path.write_text(PSINS.replace(*changes) + "1 0 1 0 3 8000\n" * 100)
    with pytest.raises(InputError):
        list(read(LogConfig(reader="psins", path=str(path))))


def spoiled(name: str) -> dict[str, np.ndarray]:
    values = columns()
    if name == "nan":
        values["w_y"][17] = np.nan
    elif name == "gap":
        values["t"][100:] += 5.0
    elif name == "backward":
        values["t"][100:] -= 1.0
    elif name == "missing":
        del values["f_z"]
    elif name == "g":
        values |= {f"f_{a}": values[f"f_{a}"] / 9.80665 for a in "xyz"}
    elif name == "rad":
        values |= {f"w_{a}": np.deg2rad(values[f"w_{a}"]) for a in "xyz"}
    elif name == "moving":
        values |= {f"w_{a}": values[f"w_{a}"] * 1e5 for a in "xyz"}
    elif name == "text":
        values["w_x"] = np.array(["a"] * 250)
    elif name == "one":
        values = columns(1)
    return values


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nan", r"gyro y in row 17 = nan: is not a number \(1 such values\)"),
        ("gap", r"time after row 99 = 9.9 s: a gap of 5.1 s where samples are 0.1 s apart"),
        ("backward", r"time in row 100 = 9 s: does not increase: 9.9 s stands before it"),
        ("missing", r"log.accel_columns = f_z: is no column of log; it has t, w_x"),
        ("g", r"log.accel_unit = m/s2: log would rest at 0.99.. m/s2.*in g or"),
        ("rad", r"log.gyro_unit = deg/s: .*mean rate would be 0.26.* in rad/s it would make sense"),
        ("moving", r"no unit makes sense of it: is it at rest"),
        ("text", r"log.gyro_columns = w_x: of log holds string, not numbers"),
        ("one", r"1 samples: is no recording"),
    ],
)
def test_bad_logs_are_refused_with_the_reason(tmp_path, name, says):
    path = write(tmp_path / "log.csv", spoiled(name))
    with pytest.raises(InputError, match=says):
        list(read(config(path)))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"rate_hz": 20.0}, "log.rate_hz = 20.0 Hz: but log's time says 10 Hz"),
        ({"time_column": "none"}, "log.rate_hz = None Hz: must be given"),
        ({"latitude": None}, "log.latitude = None deg: must be given"),
        ({"path": "nonesuch.csv"}, "log.path = nonesuch.csv: is not at nonesuch.csv"),
        ({"time_column": "time"}, "log.time_column = time: is no column"),
    ],
)
def test_wrong_descriptions_of_a_log(tmp_path, changes, says):
    path = write(tmp_path / "log.csv", columns())
    with pytest.raises(InputError, match=says):
        list(read(config(path, **changes)))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"reader": "excel"}, "choose from table, recordings, psins"),
        ({"gyro_unit": "rpm"}, "choose from auto, rad/s, deg/s"),
        ({"accel_unit": "ft/s2"}, "choose from auto, m/s2"),
        ({"axes": ["x", "y"]}, "must be x, y, z"),
        ({"axes": ["x", "y", "-z"]}, "is a mirrored frame"),
        ({"gyro_columns": ["a", "a", "b"]}, "three column names"),
        ({"latitude": 91.0}, "from -90 to 90"),
        ({"rate_hz": 0.0}, "greater than zero"),
        ({"path": ""}, "must name a file"),
    ],
)
def test_wrong_log_configurations(changes, says):
    with pytest.raises(InputError, match=says):
        config("x.csv", **changes)


@pytest.mark.parametrize("content", [b"", b"PAR1garbage", b"\xff\xfe\x00,"])
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_unreadable_files_are_refused(tmp_path, content, suffix):
    path = tmp_path / f"log{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError):
        list(read(config(path)))


def test_logs_are_looked_for_where_the_environment_points(tmp_path, monkeypatch):
    write(tmp_path / "log.csv", columns())
    monkeypatch.setenv("LBGC_REAL_LOGS", str(tmp_path))
    assert len(list(read(config("log.csv")))) == 1


@needs_recording("lasergyro.imu")
def test_lasergyro_rates_are_as_measured():
    """Mean rates, norm and sample count of ../shared's README, in the file's own axes."""
    log = LogConfig(reader="psins", path="lasergyro.imu", axes=["x", "y", "z"])
    (record,) = read(log, north=False)
    mean = np.rad2deg(record.gyro.mean(axis=0)) * 3600
    np.testing.assert_allclose(mean, [-12.27, 0.44, 8.36], atol=0.01)
    assert record.duration_s == pytest.approx(1847, abs=1)


@needs_recording("adis16405_imu1.parquet")
@pytest.mark.parametrize("number", [1, 2])
def test_adis16405_reads(number):
    from helpers import composed

    from lbgc.evaluate import EvaluateConfig

    log = composed(EvaluateConfig, "evaluate", f"log=adis16405_imu{number}").log
    (record,) = read(log)
    assert record.duration_s == 10_000
    assert record.heading_reference is None
    assert np.linalg.norm(np.rad2deg(record.gyro.mean(axis=0))) * 3600 > 1000
