"""Files of many loggers: the same samples, however they are printed; or refused by line."""

import cases
import numpy as np
import pytest
from test_clock import noted, one, records

from lbgc.data.readers.column_names import Described, described, unit
from lbgc.data.readers.sheets import shown
from lbgc.data.readers.stated import stated_rate
from lbgc.errors import InputError

N = 1200
T, W, F = cases.static(100, N / 100, arw=0.02, seed=1)
DEG = np.rad2deg(W)
NAMES = ["t", *cases.HEADER]


def rows(*columns, sep=",", decimal=".", fmt=".12g") -> list[str]:
    table = np.column_stack(columns)
    return [sep.join(format(v, fmt) for v in row).replace(".", decimal) for row in table]


def text(names, lines, sep=",", before="", end="\n") -> str:
    header = [sep.join(names)] if names else []
    return before + end.join([*header, *lines]) + end


SI = rows(T, W, F)
PLAIN = rows(T, DEG, F)
GERMAN = ["Zeit [s]", *(f"g{x} [°/s]" for x in "xyz"), *(f"a{x} [m/s²]" for x in "xyz")]
PHONE = [f"{a} {x} ({u})" for a, u in (("Gyroscope", "rad/s"), ("Acceleration", "m/s^2"))
         for x in "xyz"]  # fmt: skip
EUROC = [f"{a}_RS_S_{x} [{u}]" for a, u in (("w", "rad s^-1"), ("a", "m s^-2")) for x in "xyz"]
XSENS = ["PacketCounter", "SampleTimeFine", *(f"{k}_{x}" for k in ("Acc", "Gyr") for x in "XYZ")]
ROS = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
ROS += [f"{k}.{x}" for k in ("angular_velocity", "linear_acceleration") for x in "xyz"]
LABVIEW = (
    "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t,\nTime\t12:00:00,123\n"
    "***End_of_Header***\t\n\t\nSamples\t1200\t1200\t1200\t1200\t1200\t1200\t\n"
    "X0\t0,0E+0\t0,0E+0\t0,0E+0\t0,0E+0\t0,0E+0\t0,0E+0\t\n"
    "Delta_X\t0,01\t0,01\t0,01\t0,01\t0,01\t0,01\t\n***End_of_Header***\t\t\t\t\t\t\t\n"
)
PREAMBLE = "FILE_INFO\nModelName,TEST\n\n" + "".join(f"Key_{k},{k}\n" for k in range(3000))
CLOCK = [f"23:59:{t + 50:05.2f}" if t < 9.995 else f"00:00:{t - 10:05.2f}" for t in T]
NOON = [f"12:00:{t:06.3f}" for t in T]
ns = 1_403_636_579_758_555_392 + np.round(T * 1e9).astype(np.int64)

FILES: dict[str, tuple[str | bytes, dict]] = {
    "xsens": (text(XSENS, [f"{k:05d}\t{10_000 * t:.0f}\t{r}" for k, (t, r) in enumerate(zip(
        T, rows(F, W, sep="\t"), strict=True))], "\t", "// Start Time: Unknown\n// Update Rate: "
        "100.0Hz\n// Filter Profile: general (50.1)\n"), {"gyro_unit": "rad/s"}),
    "euroc": (text(["#timestamp [ns]", *EUROC],
                   [f"{t},{r}" for t, r in zip(ns, rows(W, F), strict=True)], end="\r\n"), {}),
    "ros": (text(ROS, [f"{t // 10**9},{t % 10**9},imu,{r}" for t, r in
                       zip(ns, rows(W, F), strict=True)]), {"gyro_unit": "rad/s"}),
    "phone": (text([f'"{n}"' for n in ("Time (s)", *PHONE)], SI), {}),
    "excel_german": (text(GERMAN, rows(T, DEG, F, sep=";", decimal=","), ";", end="\r\n")
                     .encode("cp1252"), {}),
    "bom_trailing": (text([*NAMES, ""], [r + ";" for r in rows(T, DEG, F, sep=";", decimal=",")],
                          ";", "\ufeff"), {}),
    "labview": (text(["X_Value", *(f"{k} {x}" for k in ("gyro", "acc") for x in "xyz"), "Comment"],
                     [r + "\t" for r in rows(T, DEG, F, sep="\t", decimal=",")], "\t", LABVIEW),
                {}),
    "matlab": (text([], PLAIN), {"columns": [2, 3, 4, 5, 6, 7], "time_column": 1}),
    "savetxt": (text(["# t", *NAMES[1:]], rows(T, DEG, F, sep=" ", fmt=".18e"), " "), {}),
    "units_row": (text(["t", "gx", "gy", "gz", "ax", "ay", "az"],
                       ["ms,dps,dps,dps,g,g,g", *rows(1e3 * T, DEG, F / 9.80665)]), {}),
    "r_table": (text([f'"{n}"' for n in NAMES], [f'"{k}" {r}' for k, r in enumerate(
        rows(T, DEG, F, sep=" "), start=1)], " "), {}),
    "aligned": (text(["Time (s)", "gx (deg/s)", "gy (deg/s)", "gz (deg/s)", "ax", "ay", "az"],
                     rows(T, DEG, F, sep="  ", fmt="18.12f"), "  "), {}),
    "quoted_decimal_comma": (text(NAMES, [",".join(f'"{v}"' for v in r.split(";")) for r in
                                          rows(T, DEG, F, sep=";", decimal=",")]), {}),
    "plus_signs": (text(NAMES, rows(T, DEG, F, fmt="+.12f")), {}),
    "old_mac": (text(NAMES, PLAIN, end="\r"), {}),
    "utf16": (text(NAMES, PLAIN).encode("utf-16"), {}),
    "utf16_bare": (text(NAMES, PLAIN).encode("utf-16-be"), {}),
    "pipes": (text([f"| {' | '.join(NAMES)} |", "|---|---|---|---|---|---|---|"],
                   ["| " + r.replace(",", " | ") + " |" for r in PLAIN], "\n"), {}),
    "long_preamble": (text(NAMES, PLAIN, before=PREAMBLE), {}),
    "comments_within": (text(NAMES, [*PLAIN[:600], "# a break, 1, 2", "", *PLAIN[600:]]), {}),
    "other_columns": (text(["t", "gps", "status", *NAMES[1:]],
                           [f"{r.split(',')[0]},{5.5 if k % 10 == 0 else ''},OK,"
                            f"{r.split(',', 1)[1]}" for k, r in enumerate(PLAIN)]), {}),
    "clock_times": (text(["clock", *NAMES[1:]], [f"{c},{r}" for c, r in zip(
        CLOCK, rows(DEG, F), strict=True)]), {"time_column": "clock"}),
    "german_dates": (text(["Zeit", *NAMES[1:]], [f"26.11.2026 {c};{r}".replace(".", ",").replace(
        "26,11,", "26.11.") for c, r in zip(NOON, rows(DEG, F, sep=";"), strict=True)], ";"), {}),
    "milli": (text(["Time (us)", *(f"Gyro {x} (mrad/s)" for x in "XYZ"),
                    *(f"Accel {x} (mg)" for x in "XYZ")],
                   rows(1e6 * T, 1e3 * W, 1e3 * F / 9.80665)), {}),
    "vicinity": (text(NAMES, PLAIN, before="Calibration 1 0 0 0 1 0 0 0 1\nSerial 12345\n\n"), {}),
}  # fmt: skip


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
