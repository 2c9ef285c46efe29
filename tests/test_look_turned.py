"""The log doctor on a plate that turned: it finds the angle's column, or asks; a log's memory."""

import subprocess
import sys

import numpy as np
import pytest
import yaml
from test_turned_logs import RATE, bench

from lbgc.data.logconfig import LogConfig
from lbgc.data.logs import read
from lbgc.data.looking import stretch
from lbgc.data.looking.doctor import looked

NAMES = "t,gx (deg/s),gy (deg/s),gz (deg/s),ax (m/s2),ay (m/s2),az (m/s2)"
LATITUDE = {"latitude": 48.1}


def write(path, values, column=None, name=""):
    """A log of rates, deg/s, and forces, with one more column."""
    t = np.arange(len(values)) / RATE
    header = NAMES if column is None else f"{NAMES},{name}"
    table = np.column_stack([t, values] if column is None else [t, values, column])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")
    return path


@pytest.fixture(scope="module")
def two():
    """Rates and forces of a plate that rests at 0, 180 and 0 degrees, and its angle, degrees."""
    values, angle, _ = bench([0, 180, 0], rest_s=60.0)
    return values, angle


@pytest.mark.parametrize(
    ("name", "made", "unit", "scale"),
    [
        ("plate_deg", lambda a: a, None, None),
        ("table angle", lambda a: a % 360, "deg", None),
        ("encoder", np.deg2rad, "rad", None),
        ("azimuth", lambda a: -a, "deg", -1.0),
        ("encoder", lambda a: np.round(a / 360 * 2**20), "deg", 360 / 2**20),
        ("anything", lambda a: a + 17, "deg", None),
    ],
)
def test_the_angles_column_is_known_by_what_the_gyros_felt(tmp_path, two, name, made, unit, scale):
    values, angle = two
    look = looked(write(tmp_path / "log.csv", values, made(angle), name), LATITUDE)
    assert look.is_sure, look
    assert look.keys["plate_column"] == name
    assert look.keys.get("plate_unit") == unit
    assert look.keys.get("plate_scale") == (None if scale is None else pytest.approx(scale))
    (record,) = read(LogConfig(**look.keys))
    felt = np.rad2deg(record.plate_angle - record.plate_angle[0])
    # To a count of the encoder, and the median of a rest.
    np.testing.assert_allclose(felt, angle, atol=0.02)


def test_a_column_that_does_not_turn_as_the_gyros_is_not_the_plates(tmp_path, two):
    values, angle = two
    look = looked(write(tmp_path / "log.csv", values, 0.8 * angle, "plate_deg"), LATITUDE)
    assert "plate_column" not in look.keys
    assert "plate_deg does not turn as the gyros do: it is not used" in look.facts
    assert [guess.key for guess in look.asks] == ["positions"]


@pytest.mark.parametrize("up", [False, True])
def test_turns_that_no_column_has_are_asked_about(tmp_path, up):
    values, _, spans = bench([0, 90, 180, 270], rest_s=40.0)
    values = values * [1, -1, -1, 1, -1, -1] if up else values
    file = write(tmp_path / "log.csv", values)
    look = looked(file, LATITUDE)
    (asked,) = look.asks
    assert (asked.key, asked.heading_only) == ("positions", True)
    assert look.is_described  # by its longest rest, for a fit of noise
    line = asked.doubt.split("log.positions=")[1].split(";")[0]
    positions = yaml.safe_load(line)
    assert [angle for *_, angle in positions] == [0, 90, 180, 270]
    for (first, last, _), span in zip(positions, spans, strict=True):
        assert span[0] / RATE <= first < first + 35 < last <= span[1] / RATE + 1.1
    told = looked(file, {**LATITUDE, "positions": positions})
    assert told.is_sure, told
    assert told.record is not None
    turned = np.rad2deg(told.record.plate_angle[-1] - told.record.plate_angle[0])
    assert turned == pytest.approx(270)
    alone = looked(file, {**LATITUDE, "from_s": positions[0][0], "to_s": positions[0][1]})
    assert alone.is_sure, alone


def test_an_even_turn_is_no_rest_and_a_knock_no_turn(rng):
    rate = 1e-3 * rng.standard_normal((40_000, 3))
    force = 1e-3 * rng.standard_normal((40_000, 3))
    turns = rate.copy()
    turns[10_000:30_000, 2] += 1.0  # longer than either rest
    found = stretch.rest(turns, force, 100.0)
    assert (found.last - found.first) <= 10_000
    assert len(found.rests) == 2
    rate[20_000:20_100] += np.sin(2 * np.pi * np.arange(100) / 10)[:, None]
    knocked = stretch.rest(rate, force, 100.0)
    assert (knocked.first, knocked.last) == (0, 40_000)


def test_evaluate_reads_a_turned_log_by_its_file_alone(cli, tmp_path, two):
    values, angle = two
    write(tmp_path / "log.csv", values, angle, "plate_deg")
    options = ("windows_s=[195]", "estimators=[two_position]", "log.heading_deg=70")
    done = cli("lbgc.evaluate", "log.path=log.csv", "log.latitude=48.1", *options)
    assert done.code == 0, done.err
    assert "found log.plate_column=plate_deg" in done.out
    asked = cli("lbgc.evaluate", "log.path=log.csv", *options)
    assert "log.latitude = None: is not told by the file" in asked.err
    # a fit needs no latitude, and takes the longest rest
    fitted = cli("lbgc.fit", "log.path=log.csv", "processes=1")
    assert fitted.code == 0, fitted.err
    assert "bias: not told, since log.latitude is not given" in fitted.out
    assert "nan" not in (next(tmp_path.glob("outputs/fit/*/imu/mine.yaml"))).read_text().lower()


def test_a_temperature_column_is_found(tmp_path, two):
    values, _ = two
    rest = values[:1200]
    warm = 30 + 0.001 * np.arange(1200)
    look = looked(write(tmp_path / "log.csv", rest, warm, "Temperature (C)"), LATITUDE)
    assert look.keys["temperature_column"] == "Temperature (C)"
    assert look.record is not None
    assert look.record.temperature is not None
    np.testing.assert_allclose(look.record.temperature, warm, atol=1e-6)
    cold = looked(write(tmp_path / "odd.csv", rest, 1000 + warm, "Temperature (C)"), LATITUDE)
    assert "temperature_column" not in cold.keys


def test_a_directory_is_its_files(cli, tmp_path, two):
    values, angle = two
    (tmp_path / "logs").mkdir()
    write(tmp_path / "logs/one.csv", values, angle, "plate_deg")
    write(tmp_path / "logs/one.txt", values[:1200])
    (tmp_path / "logs/letter.txt").write_text("Dear Sir\n")
    said = cli("lbgc.look", "files=[logs]", "log.latitude=48.1")
    assert said.code == 0, said.err
    assert "1 of 3 are no logs that can be read:" in said.out
    assert {own.name for own in (tmp_path / "mine/log").iterdir()} == {"one.yaml", "one_2.yaml"}
    assert "log.plate_column=null log.from_s=" in said.out  # what a fit of it takes


CHILD = """
import resource, sys
import numpy as np
from lbgc.data.logconfig import LogConfig
from lbgc.data.logs import read
path, rows = sys.argv[1], int(sys.argv[2])
table = np.lib.format.open_memmap(path, "w+", "f8", (rows, 7))
rng = np.random.default_rng(1)
for first in range(0, rows, 2**16):
    own = table[first : first + 2**16]
    own[:] = 1e-5 * rng.standard_normal(own.shape)
    own[:, 0] = (first + np.arange(len(own))) / 200
    own[:, 6] -= 9.8
del own, table
(record,) = read(LogConfig(path=path, columns=[2, 3, 4, 5, 6, 7], time_column=1), north=False)
assert len(record.gyro) == rows
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""
"""Writes a log, of which the pages of the file are few at a time, reads it, and prints its peak."""


def test_a_long_log_is_held_once(tmp_path):
    """Memory by the byte of the six columns that are kept. A day at 200 Hz has 0.83 GB of them, and
    1.5 GB less 0.25 for the program are 1.5 times that; they were held six times once."""
    peak = {}
    for rows in (2_000_000, 6_000_000):
        out = subprocess.run([sys.executable, "-c", CHILD, str(tmp_path / "a.npy"), str(rows)],
                             check=True, capture_output=True, text=True)  # fmt: skip
        peak[rows] = float(out.stdout)
    assert (peak[6_000_000] - peak[2_000_000]) / (48 * 4_000_000) < 1.8
