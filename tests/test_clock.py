"""Clocks as logs print them: units of time, rounded, repeated, bursty and lost stamps, gaps."""

import cases
import numpy as np
import pytest

from lbgc.data.logs import LogConfig, read
from lbgc.data.readers.instants import Hole, instants
from lbgc.data.record import Record, mock_record, require_one_rate
from lbgc.errors import InputError

N = 6000
T, W, F = cases.static(100, N / 100, seed=1)


def records(path, **changes) -> list[Record]:
    values = {"path": str(path), "latitude": 48.1, "gyro_unit": "deg/s", "accel_unit": "m/s2"}
    return list(read(LogConfig(**(values | changes))))


def one(path, **changes) -> Record:
    (record,) = records(path, **changes)
    return record


def log(path, stamps, name="t", rows=slice(None), fmt="%.17g"):
    """A minute at 100 Hz with these stamps."""
    header = [name, *cases.HEADER]
    cases.write(path, cases.table(W, F, np.asarray(stamps))[rows], header, fmt)
    return path


def noted(record: Record, topic: str) -> bool:
    return any(note.startswith(topic) for note in record.notes)


def arw(record: Record) -> float:
    """deg/sqrt(h), of the forward gyro, of what is white."""
    return float(np.rad2deg(record.gyro[:, 0].std()) * 60 / np.sqrt(record.rate_hz))


@pytest.mark.parametrize("case", [cases.time_unit, cases.real_clock, cases.stamps])
def test_the_cases_are_read_right(tmp_path, case):
    """Rate, noise and mean rates, the noise within 4 of its sampling errors."""
    case(tmp_path)
    rates = {
        "ms_stamps_400": 400,
        "ms_stamps_600": 600,
        "rate_99.983": 99.983,
        "rate_98.317": 98.317,
    }
    for file in sorted(tmp_path.glob("*.csv")):
        record = one(file)
        assert record.rate_hz == pytest.approx(rates.get(file.stem, 100.0), rel=1e-6), file.stem
        n = len(record.gyro)
        assert arw(record) == pytest.approx(0.1, rel=4 / np.sqrt(2 * n)), file.stem
        mean = np.rad2deg(record.gyro.mean(axis=0)) * 3600
        sigma = 0.1 * 60 / np.sqrt(record.duration_s)  # deg/h
        np.testing.assert_allclose(mean, [0, -10.045, -11.195], atol=4.5 * sigma)


@pytest.mark.parametrize(
    ("name", "per_s", "option"),
    [
        ("Time (ms)", 1e3, "auto"), ("timestamp_us", 1e6, "auto"), ("t_ns", 1e9, "auto"),
        ("Elapsed time (min)", 1 / 60, "auto"), ("SampleTimeFine", 1e4, "auto"),
        ("t", 1 / 3600, "h"), ("t", 1 / 86400, "d"), ("t", 1e4, "100us"), ("clock", 1e3, "ms"),
    ],
)  # fmt: skip
def test_a_unit_of_time_is_what_the_name_or_the_user_says(tmp_path, name, per_s, option):
    changes = {"time_column": name} if name == "clock" else {}
    record = one(log(tmp_path / "log.csv", T * per_s, name), time_unit=option, **changes)
    assert record.rate_hz == pytest.approx(100.0, rel=1e-6)
    assert not noted(record, "time unit")


@pytest.mark.parametrize(
    ("stamps", "unit"),
    [
        (1.7e9 + T, "s"), (1.7e12 + 1e3 * T, "ms"), (1.7e15 + 1e6 * T, "us"),
        (1_700_000_000_123_456_789 + np.round(1e9 * T).astype(np.int64), "ns"),
    ],
)  # fmt: skip
def test_dates_in_unix_time_are_told_by_their_century(tmp_path, stamps, unit):
    path = tmp_path / "log.csv"
    rows = np.column_stack([np.rad2deg(W), F])
    lines = [
        f"{s},{','.join(f'{v:.9g}' for v in row)}" for s, row in zip(stamps, rows, strict=True)
    ]
    path.write_text("\n".join([",".join(["t", *cases.HEADER]), *lines]))
    record = one(path)
    assert record.rate_hz == pytest.approx(100.0, rel=1e-7)
    assert noted(
        record, f"time unit: log's time column does not say it and was read in {unit}"
    ) is (unit != "s")


@pytest.mark.parametrize("zone", ["", "Z", "+02:00"])
def test_iso_times_are_read_by_themselves(tmp_path, zone):
    dates = np.datetime64("2026-11-26T23:59:40", "us") + np.round(T * 1e6).astype("m8[us]")
    rows = np.column_stack([np.rad2deg(W), F])
    lines = [f"{d}{zone}," + ",".join(f"{v:.9g}" for v in row)
             for d, row in zip(dates, rows, strict=True)]  # fmt: skip
    path = tmp_path / "log.csv"
    path.write_text("\n".join([",".join(["UTC", *cases.HEADER]), *lines]))
    assert one(path).rate_hz == pytest.approx(100.0, rel=1e-9)


def test_an_implausible_unit_is_refused_naming_what_makes_sense(tmp_path):
    path = log(tmp_path / "log.csv", T * 1e6)
    says = (
        r"log.time_unit = s: log would be 0.0001 Hz, 6e\+07 s; it would make sense in us "
        r"\(log.time_unit=us makes it 100 Hz, 60 s\)"
    )
    with pytest.raises(InputError, match=says):
        one(path, time_unit="s")
    assert one(path, time_unit="us").rate_hz == pytest.approx(100.0)


def test_stamps_of_two_plausible_units_are_not_guessed_at(tmp_path):
    """Whole numbers one by one: 1 kHz in ms, 1 Hz in s, or samples counted."""
    path = log(tmp_path / "log.csv", np.arange(N))
    with pytest.raises(InputError, match=r"in s \(.*1 Hz.*\) or ms \(.*1000 Hz.*: say which"):
        one(path)
    assert one(path, rate_hz=1000.0).rate_hz == 1000.0
    assert one(path, rate_hz=100.0, time_column="none").rate_hz == 100.0


@pytest.mark.parametrize(
    ("start", "wrap", "scale"),
    [(2**32 - 10_000_000, 2**32, 1e6), (65_000, 2**16, 1e3), (86_390.0, 86400, 1.0),
     (604_790.0, 604800, 1.0)],
)  # fmt: skip
def test_counters_that_begin_again_are_carried_on(tmp_path, start, wrap, scale):
    stamps = (start + np.round(T * scale, 6)) % wrap
    record = one(log(tmp_path / "log.csv", stamps))
    assert record.rate_hz == pytest.approx(100.0, rel=1e-6)
    assert noted(record, "counter")


def test_seconds_and_nanoseconds_are_one_time(tmp_path):
    """As ROS prints them; beyond what a float holds."""
    ns = 1_700_000_000_987_654_321 + np.round(T * 1e9).astype(np.int64)
    rows = np.column_stack([np.rad2deg(W), F])
    lines = [f"{s // 10**9},{s % 10**9}," + ",".join(f"{v:.9g}" for v in row)
             for s, row in zip(ns, rows, strict=True)]  # fmt: skip
    path = tmp_path / "log.csv"
    names = ["header.stamp.secs", "header.stamp.nsecs", *cases.HEADER]
    path.write_text("\n".join([",".join(names), *lines]))
    assert one(path).rate_hz == pytest.approx(100.0, rel=1e-9)
    assert one(path, time_column=["header.stamp.secs", 2]).rate_hz == pytest.approx(100.0, rel=1e-9)


@pytest.mark.parametrize(
    ("gaps", "lengths"), [("join", [N]), ("longest", [4000]), ("split", [2000, 4000])]
)
@pytest.mark.parametrize("jump", [5.0, -7.3])
def test_long_gaps_are_refused_or_dealt_with_as_said(tmp_path, gaps, lengths, jump):
    stamps = T + jump * (np.arange(N) >= 2000)
    path = log(tmp_path / "log.csv", stamps)
    says = "a gap of 5.01 s" if jump > 0 else "does not increase"
    with pytest.raises(InputError, match=f"{says}.*log.gaps=longest"):
        records(path)
    found = records(path, gaps=gaps)
    assert [len(r.gyro) for r in found] == lengths
    assert all(r.rate_hz == pytest.approx(100.0, rel=1e-6) for r in found)
    assert all(noted(r, "gaps") for r in found)
    if gaps != "join":
        np.testing.assert_allclose(found[-1].gyro, W[2000:], rtol=1e-12)


def test_many_lost_samples_are_refused_naming_the_option(tmp_path):
    kept = np.random.default_rng(5).random(N) > 0.03
    path = log(tmp_path / "log.csv", T, rows=kept)
    with pytest.raises(InputError, match=r"of 6000 samples: are missing.*log.gaps=join"):
        one(path)
    assert one(path, gaps="join").rate_hz == pytest.approx(100.0, rel=1e-9)


K = np.arange(30_000)


@pytest.mark.parametrize(
    ("stamps", "rate"),
    [
        (np.floor(K / 450 * 1e3 + 1e-6), 0.45), (np.floor(K / 833 * 1e3 + 1e-6), 0.833),
        (np.floor(K / 999.1 * 1e3 + 1e-6), 0.9991), (K // 20 * 0.2 + K % 20 * 5e-4, 100.0),
        (K / 100 + np.random.default_rng(1).exponential(0.004, len(K)), 100.0),
        (np.floor(K / 100), 100.0), (K / 100 + 1e-5 * np.sin(K / 3000), 100.0),
        (K * 0.01 - 4.0 * (K == 9000), 100.0),
    ],
)  # fmt: skip
def test_uneven_stamps_of_even_samples_have_no_holes(stamps, rate):
    """Rounded, in bursts, late, whole seconds, a wandering clock, one stamp gone astray."""
    found = instants(stamps)
    assert found.holes == ()
    assert 1 / found.step == pytest.approx(rate, rel=3e-5)


@pytest.mark.parametrize("jitter_s", [0.0, 0.001])
@pytest.mark.parametrize("lost", [1, 4, 200])
def test_holes_are_found_where_they_are(jitter_s, lost):
    rng = np.random.default_rng(2)
    stamps = np.delete(K / 100 + jitter_s * rng.standard_normal(len(K)), slice(7001, 7001 + lost))
    (hole,) = instants(stamps).holes
    assert hole == Hole(7000, lost)


def test_stamps_that_no_clock_has_are_a_hole_without_end(rng):
    """Stamps of the size of the largest numbers that are read, and no warning of NumPy's."""
    stamps = 0.01 * np.arange(500) + 0.003 * rng.standard_normal(500)
    stamps[250:] += 1e27
    found = instants(stamps)
    assert max(hole.missing for hole in found.holes) == 2**53


def test_stamps_that_take_no_time_are_refused(tmp_path):
    with pytest.raises(InputError, match="take no time"):
        one(log(tmp_path / "log.csv", 0 * T))


@pytest.mark.parametrize("rate_hz", [512.0, 1000.3, 2000.0])
def test_a_rate_that_could_be_another_in_another_unit_is_not_guessed(tmp_path, rate_hz):
    """In ms, with fractions: as seconds they would be 0.5 to 2 Hz."""
    path = log(tmp_path / "log.csv", np.arange(N) / rate_hz * 1e3)
    with pytest.raises(InputError, match=r"makes sense in s .* or ms"):
        one(path)
    assert one(path, time_unit="ms").rate_hz == pytest.approx(rate_hz, rel=1e-6)
    named = log(tmp_path / "named.csv", np.arange(N) / rate_hz * 1e3, "t_ms")
    assert one(named).rate_hz == pytest.approx(rate_hz, rel=1e-6)


@pytest.mark.parametrize("rate_hz", [600.0, 1000.3, 4000.0])
@pytest.mark.parametrize("defect", ["even", "jitter", "late", "repeated", "bursts", "lost"])
def test_stamps_coarser_than_a_sample_invent_no_holes(rate_hz, defect):
    """Rounded to ms; of one sample in a thousand lost, no more are told than were."""
    rng, k = np.random.default_rng(7), np.arange(40_000)
    t = k / rate_hz
    if defect == "jitter":
        t = t + 0.3 / rate_hz * rng.standard_normal(len(k))
    elif defect == "late":
        t = t + rng.exponential(0.3 / rate_hz, len(k))
    elif defect == "repeated":
        t[37::37] = t[36:-1:37][: len(t[37::37])]
    elif defect == "bursts":
        t = (k // 4 * 4 + k % 4 * 0.1) / rate_hz
    elif defect == "lost":
        t = t[rng.random(len(t)) > 1e-3]
    found = instants(np.floor(t * 1e3 + 1e-6))
    lost = len(k) - len(t)
    assert all(0 < hole.missing <= 3 for hole in found.holes)
    assert sum(hole.missing for hole in found.holes) <= 1.2 * lost
    assert 1e3 / found.step == pytest.approx(rate_hz, rel=3e-4 + 1.2 * lost / len(k))


def test_noise_is_not_pooled_over_recordings_of_two_rates():
    first, second = mock_record(), mock_record(name="other", rate_hz=10.2)
    require_one_rate([first, mock_record(rate_hz=10.05)])
    with pytest.raises(InputError, match=r"other: its rate = 10.2 Hz: but mock has 10 Hz"):
        require_one_rate([first, second])
