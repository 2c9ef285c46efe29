"""One recording at 100 Hz as the loggers of many makers print it: separators, decimal marks,
headers, units, clocks, encodings, and what stands around the rows."""

from collections.abc import Sequence

import cases
import numpy as np

NAMES = ["t", *cases.HEADER]
Said = dict[str, object]
"""What a user must say of a file, by the keys of `LogConfig`"""


def rows(*columns: np.ndarray, sep: str = ",", decimal: str = ".", fmt: str = ".12g") -> list[str]:
    """Rows of numbers as text."""
    table = np.column_stack(columns)
    return [sep.join(format(v, fmt) for v in row).replace(".", decimal) for row in table]


def text(
    names: Sequence[str], lines: Sequence[str], sep: str = ",", before: str = "", end: str = "\n"
) -> str:
    """A file of rows, behind a header where names are given."""
    header = [sep.join(names)] if names else []
    return before + end.join([*header, *lines]) + end


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


def _time(seconds: float, digits: int) -> str:
    """A time of day."""
    whole, part = divmod(round(seconds % 86_400 * 10**digits), 10**digits)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}.{part:0{digits}d}"


def files(t: np.ndarray, w: np.ndarray, f: np.ndarray) -> dict[str, tuple[str | bytes, Said]]:
    """Each dialect's file and what must be said of it. t : (N,), s, at 100 Hz; w : (N, 3), rad/s;
    f : (N, 3), m/s^2."""
    deg = np.rad2deg(w)
    si, plain = rows(t, w, f), rows(t, deg, f)
    clock = [_time(86_390 + s, 2) for s in t]
    noon = [_time(43_200 + s, 3) for s in t]
    ns = 1_403_636_579_758_555_392 + np.round(t * 1e9).astype(np.int64)
    return {
        "xsens": (text(XSENS, [f"{k:05d}\t{10_000 * t:.0f}\t{r}" for k, (t, r) in enumerate(zip(
            t, rows(f, w, sep="\t"), strict=True))], "\t", "// Start Time: Unknown\n"
            "// Update Rate: 100.0Hz\n// Filter: general (50.1)\n"), {"gyro_unit": "rad/s"}),
        "euroc": (text(["#timestamp [ns]", *EUROC],
                       [f"{t},{r}" for t, r in zip(ns, rows(w, f), strict=True)], end="\r\n"), {}),
        "ros": (text(ROS, [f"{t // 10**9},{t % 10**9},imu,{r}" for t, r in
                           zip(ns, rows(w, f), strict=True)]), {"gyro_unit": "rad/s"}),
        "phone": (text([f'"{n}"' for n in ("Time (s)", *PHONE)], si), {}),
        "excel_german": (text(GERMAN, rows(t, deg, f, sep=";", decimal=","), ";", end="\r\n")
                         .encode("cp1252"), {}),
        "bom_trailing": (text([*NAMES, ""], [
            r + ";" for r in rows(t, deg, f, sep=";", decimal=",")], ";", "\ufeff"), {}),
        "labview": (text(["X_Value", *(f"{k} {x}" for k in ("gyro", "acc") for x in "xyz"),
                          "Comment"],
                         [r + "\t" for r in rows(t, deg, f, sep="\t", decimal=",")], "\t", LABVIEW),
                    {}),
        "matlab": (text([], plain), {"columns": [2, 3, 4, 5, 6, 7], "time_column": 1}),
        "savetxt": (text(["# t", *NAMES[1:]], rows(t, deg, f, sep=" ", fmt=".18e"), " "), {}),
        "units_row": (text(["t", "gx", "gy", "gz", "ax", "ay", "az"],
                           ["ms,dps,dps,dps,g,g,g", *rows(1e3 * t, deg, f / 9.80665)]), {}),
        "r_table": (text([f'"{n}"' for n in NAMES], [f'"{k}" {r}' for k, r in enumerate(
            rows(t, deg, f, sep=" "), start=1)], " "), {}),
        "aligned": (text(["Time (s)", "gx (deg/s)", "gy (deg/s)", "gz (deg/s)", "ax", "ay", "az"],
                         rows(t, deg, f, sep="  ", fmt="18.12f"), "  "), {}),
        "quoted_decimal_comma": (text(NAMES, [",".join(f'"{v}"' for v in r.split(";")) for r in
                                              rows(t, deg, f, sep=";", decimal=",")]), {}),
        "plus_signs": (text(NAMES, rows(t, deg, f, fmt="+.12f")), {}),
        "old_mac": (text(NAMES, plain, end="\r"), {}),
        "utf16": (text(NAMES, plain).encode("utf-16"), {}),
        "utf16_bare": (text(NAMES, plain).encode("utf-16-be"), {}),
        "pipes": (text([f"| {' | '.join(NAMES)} |", "|---|---|---|---|---|---|---|"],
                       ["| " + r.replace(",", " | ") + " |" for r in plain], "\n"), {}),
        "long_preamble": (text(NAMES, plain, before=PREAMBLE), {}),
        "comments_within": (text(NAMES, [*plain[:600], "# a break, 1, 2", "", *plain[600:]]), {}),
        "other_columns": (text(["t", "gps", "status", *NAMES[1:]],
                               [f"{r.split(',')[0]},{5.5 if k % 10 == 0 else ''},OK,"
                                f"{r.split(',', 1)[1]}" for k, r in enumerate(plain)]), {}),
        "clock_times": (text(["clock", *NAMES[1:]], [f"{c},{r}" for c, r in zip(
            clock, rows(deg, f), strict=True)]), {"time_column": "clock"}),
        "german_dates": (text(["Zeit", *NAMES[1:]], [
            f"26.11.2026 {c};{r}".replace(".", ",").replace("26,11,", "26.11.")
            for c, r in zip(noon, rows(deg, f, sep=";"), strict=True)], ";"), {}),
        "milli": (text(["Time (us)", *(f"Gyro {x} (mrad/s)" for x in "XYZ"),
                        *(f"Accel {x} (mg)" for x in "XYZ")],
                       rows(1e6 * t, 1e3 * w, 1e3 * f / 9.80665)), {}),
        "vicinity": (text(NAMES, plain, before="Calibration 1 0 0 0 1 0 0 0 1\nSerial 12345\n\n"),
                     {}),
    }  # fmt: skip
