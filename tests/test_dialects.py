"""Files of many loggers: the same samples, however they are printed; or refused by line."""

import cases
import numpy as np
import pytest
from dialect_files import NAMES, files, rows, text
from test_clock import noted, one, records

from lbgc.data.readers.column_names import Described, described, unit
from lbgc.data.readers.sheets import shown
from lbgc.data.readers.stated import stated_rate
from lbgc.errors import InputError

N = 1200
T, W, F = cases.static(100, N / 100, arw=0.02, seed=1)
DEG = np.rad2deg(W)
PLAIN = rows(T, DEG, F)
FILES = files(T, W, F)


@pytest.mark.parametrize("name", FILES)
def test_the_same_samples_are_read_from_every_logger(tmp_path, name):
    content, options = FILES[name]
    path = tmp_path / "log.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    record = one(path, **({"gyro_unit": "auto", "accel_unit": "auto"} | options))
    np.testing.assert_allclose(record.gyro, W, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(record.accel, F, rtol=1e-9, atol=1e-9)
    assert record.rate_hz == pytest.approx(100.0, rel=1e-6)


def test_the_cases_are_read_right(tmp_path):
    cases.dialects(tmp_path)
    own = {"gyro_unit": "rad/s", "axes": ["x", "-y", "-z"]}
    usual = one(tmp_path / "ok.csv", **own)
    _, w, _ = cases.static(100, 120, seed=1)
    np.testing.assert_allclose(usual.gyro, w, rtol=1e-8)
    for file in sorted(tmp_path.glob("*")):
        if file.stem == "headerless_blanks":
            says = r"no header, and 7 columns.*log.columns=\[2,3,4,5,6,7\] log.time_column=1"
            with pytest.raises(InputError, match=says):
                one(file, **own)
            own |= {"columns": [2, 3, 4, 5, 6, 7], "time_column": 1}
        record = one(file, **own)
        np.testing.assert_array_equal(record.gyro, usual.gyro, file.stem)
        np.testing.assert_array_equal(record.accel, usual.accel, file.stem)
        assert record.rate_hz == usual.rate_hz


def with_line(at: int, line: str, instead: int = 0) -> list[str]:
    return [*PLAIN[:at], line, *PLAIN[at + instead :]]


SPOILED = {
    "short row": (with_line(500, "5.0,1,2,3"),
                  r"line 502 = 5.0,1,2,3: has 4 fields, where the rows before it have 7"),
    "third row": (with_line(2, "5.0,1,2,3"), r"line 4 = 5.0,1,2,3: has 4 fields"),
    "escape": (with_line(500, "5,1,2,3,\x1b[31mred,5,6"),
               r"line 502 = \\x1b\[31mred: is no number"),
    "header again": (with_line(500, ",".join(NAMES)), r"line 502 = (t|w_x): is no n"),
    "empty": (with_line(500, "5.0,,2,3,4,5,6", 1), "gyro x in row 500 = nan"),
    "code": (with_line(500, "5.0,=1+1,2,3,4,5,6", 1), r"line 502 = =1\+1: is no number"),
    "thousands": ([*rows(T, DEG, F, sep=";", decimal=","), *["1.234,5;0;0;0;0;0;9"] * 2],
                  r"line 1202 = .*: (is no number|has)"),
}  # fmt: skip


@pytest.mark.parametrize("name", SPOILED)
def test_rows_that_do_not_fit_are_refused_by_their_line(tmp_path, name):
    lines, says = SPOILED[name]
    path = tmp_path / "log.csv"
    path.write_text(text(NAMES, lines, ";" if name == "thousands" else ","))
    with pytest.raises(InputError, match=says):
        one(path)


@pytest.mark.parametrize(
    ("last", "first", "topic"),
    [
        ("12.00,0.1,0.", None, "last line"),
        ("END", None, "last line"),
        (None, "6,1,2", "first lines"),
    ],
)
def test_what_is_left_out_is_said(tmp_path, last, first, topic):
    path = tmp_path / "log.csv"
    path.write_text(text(NAMES, [*([first] if first else []), *PLAIN, *([last] if last else [])]))
    record = one(path)
    np.testing.assert_allclose(record.gyro, W, rtol=1e-9)
    assert noted(record, topic)


def test_units_that_contradict_the_file_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(FILES["phone"][0])
    with pytest.raises(InputError, match=r"log.gyro_unit = deg/s: but log's columns say rad/s"):
        one(path, gyro_unit="deg/s")
    by_position = {"columns": [2, 3, 4, 5, 6, 7], "time_column": 1, "accept": ["unit", "bias"]}
    assert len(records(path, gyro_unit="deg/s", **by_position)) == 1


def test_two_sets_of_columns_are_not_chosen_from(tmp_path):
    path = tmp_path / "log.csv"
    names = ["t", "gx", "gy", "gz", "ax", "ay", "az", "acc_x", "acc_y", "acc_z"]
    path.write_text(text(names, rows(T, DEG, F, F)))
    with pytest.raises(
        InputError, match=r"ax, acc_x could each be the accel's x: give log.columns"
    ):
        one(path)
    six = ["gx", "gy", "gz", "acc_x", "acc_y", "acc_z"]
    assert len(one(path, columns=six).gyro) == N


@pytest.mark.parametrize(
    "changes",
    [{"columns": [1, 2, 3, 4, 5, 5]}, {"columns": [0, 1, 2, 3, 4, 5]}, {"columns": ["a"]},
     {"time_column": ["a"]}, {"time_column": 0}, {"time_unit": "h/s"}, {"gaps": "fill"},
     {"repeats": "maybe"}],
)  # fmt: skip
def test_wrong_options_are_refused(tmp_path, changes):
    with pytest.raises(InputError, match=next(iter(changes))):
        one(tmp_path / "log.csv", **changes)


def test_binary_and_empty_files_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    for content in (b"", b"\n\n", b"abc\0def\n" * 9, b"words alone\n" * 9, bytes(range(256)) * 9):
        path.write_bytes(content)
        with pytest.raises(InputError):
            one(path)


def test_stated_rates():
    assert stated_rate(["// Update Rate: 100.0Hz"]) == 100.0
    assert stated_rate(["Sampling frequency = 1.5 kHz", "LPF rate 40 Hz"]) == 1500.0
    assert stated_rate(["Delta_X\t0,01\t0,01"]) == pytest.approx(100.0)
    assert stated_rate(["sample interval: 5 ms"]) == pytest.approx(200.0)
    assert stated_rate(["rate 100 Hz", "rate 200 Hz"]) is None
    assert stated_rate(["bench 3", "50 Hz mains"]) is None


def test_rows_of_other_sensors_that_come_less_often_are_left_out_where_there_is_a_clock(tmp_path):
    """As MicroStrain's export has a position once a second, in a row of its own."""
    path = tmp_path / "log.csv"
    names = ["GPS TOW", *NAMES[1:], "Lat [x8103]", "UTC Second [x8108]"]
    lines = [f"{row},," for row in PLAIN]
    lines[700:700] = ["6.9999,,,,,,,48.1,7", "7.0001,,,,,,,48.1,7"]
    path.write_text(text(names, lines))
    record = one(path)
    np.testing.assert_allclose(record.gyro, W, rtol=1e-9, atol=1e-12)
    assert noted(record, "rows: 2 of log")
    with pytest.raises(InputError, match="gyro x in row 700 = nan"):  # may as well be lost samples
        one(path, time_column="none", rate_hz=100.0)


def test_a_stated_rate_is_taken_where_there_is_no_time(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(text(cases.HEADER, rows(DEG, F), before="# Update Rate: 100 Hz\n"))
    record = one(path)
    assert record.rate_hz == 100.0
    assert noted(record, "rate")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("acc_x [g]", ("accel", "x", "g")), ("XGYRO_OUT", ("gyro", "x", None)),
        ("accel_z_m_s2", ("accel", "z", "m/s2")), ("wx_dps", ("gyro", "x", "deg/s")),
        ("field.linear_acceleration.y", ("accel", "y", None)), ("TimeUS", ("time", None, "us")),
        ("Time since start in ms", ("time", None, "ms")), ("Temp", (None, None, None)),
        ("angular_velocity_covariance_0", (None, None, None)), ("Mag_X", (None, None, None)),
        ("ωz [°/s]", ("gyro", "z", "deg/s")), ("gz (g)", (None, None, "g")),
        ("x", (None, None, None)), ("UTC Second [x8108]", (None, None, None)),
        ("GPS TOW", ("time", None, None)), ("raw_acceleration_x_gs", ("accel", "x", "g")),
        ("wb_x", ("gyro", "x", None)), ("fb_z", ("accel", "z", None)),
    ],
)  # fmt: skip
def test_names_are_understood(name, says):
    assert described(name) == Described(*says)


def test_units_as_people_write_them():
    written = ("°/s", "deg s^-1", "m/s²", "m·s⁻²", "[rad/sec]", "m/s^2", "µs", "furlong")
    assert [unit(w) for w in written] == [
        "deg/s", "deg/s", "m/s2", "m/s2", "rad/s", "m/s2", "us", None]  # fmt: skip


def test_words_of_a_file_are_harmless_on_a_terminal():
    assert shown("\x1b]0;x\x07" + "a" * 200).startswith("\\x1b]0;x\\x07aaa")
    assert len(shown("a" * 200)) == 60
