"""Logs of the kinds that people's public reports are about, which must be read right or refused.

An independent generator: NumPy and SciPy alone, nothing of lbgc. Each function writes one kind's
files into a directory. Rates are 100 Hz, the latitude 48.1, the heading 90 degrees unless said.
What is right for each file stands in the tests that use it and in tests/studies/realworld.yaml.

python tests/cases.py OUT writes them all, 128 MB.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.signal

EARTH_RAD_S = 7.292115e-5
HEADER = ("w_x", "w_y", "w_z", "f_x", "f_y", "f_z")
G0 = 9.80665


def gravity(latitude_deg: float) -> float:
    """Normal gravity (Somigliana, GRS 80), m/s^2."""
    s = np.sin(np.deg2rad(latitude_deg)) ** 2
    return float(9.7803253359 * (1 + 0.00193185265241 * s) / np.sqrt(1 - 0.00669437999013 * s))


def static(
    rate_hz: float,
    seconds: float,
    latitude: float = 48.1,
    heading: float = 90.0,
    arw: float = 0.1,
    accel_ug: float = 60.0,
    bias: Sequence[float] = (0, 0, 0),
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A level IMU at rest, forward-right-down: t (n,) s, gyro (n, 3) rad/s, accel (n, 3) m/s^2.

    arw : deg/sqrt(h), white; accel_ug : ug/sqrt(Hz), white, two-sided; bias : deg/h.
    """
    rng = np.random.default_rng(seed)
    n = round(rate_hz * seconds)
    lat, psi = np.deg2rad([latitude, heading])
    north, down = np.cos(lat), -np.sin(lat)
    truth = EARTH_RAD_S * np.array([north * np.cos(psi), -north * np.sin(psi), down])
    white = np.deg2rad(arw) / 60 * np.sqrt(rate_hz)
    gyro = truth + np.deg2rad(np.array(bias)) / 3600 + white * rng.standard_normal((n, 3))
    force = np.array([0, 0, -gravity(latitude)])
    accel = force + accel_ug * 1e-6 * G0 * np.sqrt(rate_hz) * rng.standard_normal((n, 3))
    return np.arange(n) / rate_hz, gyro, accel


def table(gyro: np.ndarray, accel: np.ndarray, *before: np.ndarray) -> np.ndarray:
    """Columns of a file: deg/s and m/s^2 behind what stands before them."""
    return np.column_stack([*before, np.rad2deg(gyro), accel])


def write(
    path: Path, values: np.ndarray, header: Sequence[str] = HEADER, fmt: str = "%.9g"
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, values, fmt=fmt, delimiter=",", header=",".join(header), comments="")


def time_unit(out: Path) -> None:
    t, w, f = static(100, 300, seed=1)
    for name, per_s in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        write(out / f"{name}.csv", table(w, f, np.round(t * per_s)), ["t", *HEADER], "%.12g")


def two_lines(out: Path) -> None:
    t, w, f = static(100, 300, seed=20)
    rng = np.random.default_rng(3)
    for hz, width, rms in ((17, 0.5, 60), (31, 0.7, 40)):
        b, a = scipy.signal.iirpeak(hz, hz / width, fs=100)
        x = scipy.signal.lfilter(b, a, rng.standard_normal((len(t), 3)), axis=0)
        w = w + np.deg2rad(rms / 3600) * x / x.std(axis=0)
    write(out / "log.csv", table(w, f))


def sample_hold(out: Path) -> None:
    for times, seconds in ((2, 300), (3, 120), (5, 120), (10, 120)):
        _, w, f = static(100 / times, seconds, seed=9)
        write(out / f"hold{times}.csv", np.repeat(table(w, f), times, axis=0))


def accel_sign(out: Path) -> None:
    _, w, f = static(100, 300, arw=0.01, seed=1)
    write(out / "ok.csv", table(w, f))
    write(out / "accel_reversed.csv", table(w, -f))
    write(out / "gyro_flu_accel_frd.csv", table(w * [1, -1, -1], f))


def forward_vertical(out: Path) -> None:
    _, w, f = static(100, 300, arw=0.01, seed=1)
    w, f = (np.column_stack([v[:, 2], v[:, 1], -v[:, 0]]) for v in (w, f))
    write(out / "log.csv", table(w, f))


def turn_on(out: Path) -> None:
    t, w, f = static(20, 3600, seed=11)
    decay = np.exp(-t / 600)
    w[:, 0] += np.deg2rad(60 / 3600) * decay
    f[:, 2] += 5e-3 * G0 * decay
    write(out / "log.csv", table(w, f))


def saturated(out: Path) -> None:
    _, w, f = static(100, 300, accel_ug=2000, seed=12)
    f[:, 2] = np.clip(f[:, 2], -G0, G0)
    write(out / "log.csv", table(w, f))


def real_clock(out: Path) -> None:
    for rate in (400, 600):
        t, w, f = static(rate, 120, seed=2)
        stamps = np.floor(t * 1e3 + 1e-6) / 1e3
        write(out / f"ms_stamps_{rate}.csv", table(w, f, stamps), ["t", *HEADER])
    for odd in (99.983, 98.317):
        t, w, f = static(odd, 120, seed=2)
        write(out / f"rate_{odd}.csv", table(w, f, t), ["t", *HEADER])


def stamps(out: Path) -> None:
    t, w, f = static(100, 300, seed=1)
    kept = np.random.default_rng(5).random(len(t)) > 1e-3
    write(out / "one_in_a_thousand_lost.csv", table(w, f, t)[kept], ["t", *HEADER])
    twice = t.copy()
    twice[37::37] = twice[36:-1:37][: len(twice[37::37])]
    write(out / "stamps_repeated.csv", table(w, f, twice), ["t", *HEADER])
    k = np.arange(len(t))
    bursts = k // 4 * 0.04 + k % 4 * 0.001
    write(out / "bursts_of_four.csv", table(w, f, bursts), ["t", *HEADER])


def mems_bias(out: Path) -> None:
    biases = (("b25", (25, -10, 12)), ("b500", (500, -300, 200)), ("b1800", (1800, -1080, 720)))
    for name, bias in biases:
        _, w, f = static(100, 300, arw=0.3, accel_ug=300, seed=1, bias=bias)
        write(out / f"{name}.csv", table(w, f))


def oba_bias(out: Path) -> None:
    for latitude in (48.1, -48.1, 33.9, -33.9):
        for seed in (2, 3):
            _, w, f = static(100, 900, latitude=latitude, heading=60, seed=seed)
            write(out / f"latitude_{latitude}_seed_{seed}.csv", table(w, f))


def dialects(out: Path) -> None:
    t, w, f = static(100, 120, seed=1)
    flu = np.array([1, -1, -1])
    rates = np.column_stack([t, w * flu, f * flu])  # rad/s
    rows = [[f"{v:.9g}" for v in row] for row in rates]
    names = ["Time (s)", "gx", "gy", "gz", "ax", "ay", "az"]
    out.mkdir(parents=True, exist_ok=True)

    def lay(
        name: str,
        before: str = "",
        separator: str = ",",
        decimal: str = ".",
        header: bool = True,
        encoding: str = "utf-8",
    ) -> None:
        lines = [separator.join(names)] if header else []
        lines += [separator.join(row).replace(".", decimal) for row in rows]
        (out / name).write_bytes((before + "\n".join(lines) + "\n").encode(encoding))

    lay("ok.csv")
    lay("semicolon_decimal_comma.csv", separator=";", decimal=",")
    lay("tab.csv", separator="\t")
    lay("comments.csv", "# bench 3\n# 100 Hz\n")
    lay("update_rate.txt", "// Update Rate: 100.0Hz\n", "\t")
    lay("preamble.csv", "FILE_INFO\nModelName,TEST\n\nDATA_START\n")
    lay("headerless_blanks.txt", separator=" ", header=False)
    lay("utf16.csv", encoding="utf-16")


CASES = (
    time_unit,
    two_lines,
    sample_hold,
    accel_sign,
    forward_vertical,
    turn_on,
    saturated,
    real_clock,
    stamps,
    mems_bias,
    oba_bias,
    dialects,
)

if __name__ == "__main__":
    for case in CASES:
        case(Path(sys.argv[1]) / case.__name__)
        print(case.__name__)
