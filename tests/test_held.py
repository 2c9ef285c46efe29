"""Loggers faster than their sensor: rows that are printed again, told from coarse counts."""

import cases
import numpy as np
import pytest
from test_clock import arw, noted, one

from lbgc.data.readers import held, repeats
from lbgc.data.readers.held import Holds, taken
from lbgc.errors import InputError

N = 20_000


def noise(seed: int, n: int = N) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, 6))


def holds(rows: np.ndarray) -> Holds:
    return held.holds(rows[:, :3], rows[:, 3:])


def sampled(name: str, rows: np.ndarray, rate_hz: float, how: str):
    gyro, accel, rate, notes = repeats.sampled(name, rows[:, :3], rows[:, 3:], rate_hz, how)
    return np.hstack([gyro, accel]), rate, notes


def counted(values: np.ndarray, lsb: float) -> np.ndarray:
    return np.round(values / lsb) * lsb if lsb else values


def test_the_cases_are_read_at_the_sensors_rate(tmp_path):
    cases.sample_hold(tmp_path)
    for file in sorted(tmp_path.glob("*.csv")):
        times = int(file.stem.removeprefix("hold"))
        record = one(file, rate_hz=100.0)
        assert record.rate_hz == pytest.approx(100 / times, rel=1e-12)
        assert arw(record) == pytest.approx(0.1, rel=4 / np.sqrt(2 * len(record.gyro)))
        assert noted(record, "held samples")
        assert one(file, rate_hz=100.0, repeats="keep").rate_hz == 100.0


@pytest.mark.parametrize("times", [2, 3, 7, 10, 100])
@pytest.mark.parametrize("lsb", [0, 1.0, 3.0])
def test_regular_holds_are_taken_once(times, lsb):
    own = counted(noise(1, N // times), lsb)
    rows = np.repeat(own, times, axis=0)[1:]
    values, rate, _ = sampled("x", rows, 100.0, "auto")
    assert rate == pytest.approx(100 / times)
    np.testing.assert_array_equal(values, own)


def test_regular_holds_with_lost_rows_are_taken_once():
    kept = np.random.default_rng(3).random(N) > 1e-3
    found, rate, _ = sampled("x", np.repeat(noise(1, N // 5), 5, axis=0)[kept], 100.0, "auto")
    assert rate == pytest.approx(20.0)
    assert len(found) == pytest.approx(N // 5, abs=2)


def test_a_sample_that_is_held_for_a_row_more_now_and_then_tells_the_rate():
    """33.2 Hz in a log of 100: every 83rd sample stands there four times."""
    rows = noise(7)[np.floor(np.arange(N) * 0.332 + 1e-9).astype(int)]
    _, rate, _ = sampled("x", rows, 100.0, "auto")
    assert rate == pytest.approx(33.2, rel=1e-3)


def test_nothing_is_dropped_where_repeats_may_be_samples():
    """Coarse counts that are no holds stay, whatever is said; few repeats are dropped."""
    coarse = counted(noise(8), 3.0)
    assert len(sampled("x", coarse, 100.0, "drop")[0]) == N
    some = noise(8)
    some[100::100] = some[99:-1:100][: len(some[100::100])]
    values, rate, _ = sampled("x", some, 100.0, "drop")
    assert len(values) == N - 199
    assert rate == pytest.approx(99.0, rel=1e-3)
    assert len(sampled("x", some, 100.0, "auto")[0]) == N


def test_columns_that_are_held_differently_become_means_over_the_same_time():
    """Gyros at every row, accelerometers at every other: white noise of 1 becomes 1/sqrt(2)."""
    rows = noise(2)
    rows[:, 3:] = np.repeat(rows[::2, 3:], 2, axis=0)
    assert holds(rows).columns == (1, 1, 1, 2, 2, 2)
    values, rate, notes = sampled("x", rows, 100.0, "auto")
    assert rate == 50.0
    sigma = np.array([np.sqrt(0.5)] * 3 + [1.0] * 3)
    np.testing.assert_allclose(values.std(axis=0), sigma, rtol=4 / np.sqrt(N))
    assert "the gyros' values hold for 1 rows, the accelerometers' for 2" in notes[0]


def test_columns_of_too_different_rates_are_refused():
    rows, k = noise(9), np.arange(N)
    rows[:, :3], rows[:, 3:] = rows[k // 17, :3], rows[k // 19, 3:]
    with pytest.raises(InputError, match="hold for 17 rows, the accelerometers' for 19"):
        sampled("x", rows, 1000.0, "auto")


def test_axes_that_take_turns_are_taken_once_each():
    own = noise(4)
    rows = np.column_stack([own[(np.arange(N) + 3 - c) // 3, c] for c in range(6)])
    values = taken(rows, holds(rows))
    assert len(values) == pytest.approx(N / 3, abs=2)
    np.testing.assert_allclose(values.std(axis=0), 1.0, rtol=4 / np.sqrt(2 * N / 3))


@pytest.mark.parametrize("ratio", [0.37, 0.73, 0.45])
@pytest.mark.parametrize("lsb", [0, 1.5, 3.0])
def test_irregular_holds_are_refused(ratio, lsb):
    """Coarse counts too, up to three times the noise; dropped only where repeats are no samples."""
    rows = counted(noise(5), lsb)[np.floor(np.arange(N) * ratio).astype(int)]
    with pytest.raises(InputError, match=r"log.repeats = .*the logger is faster than the sensor"):
        sampled("x", rows, 100.0, "auto")
    if lsb < 2:
        _, rate, _ = sampled("x", rows, 100.0, "drop")
        assert rate == pytest.approx(100 * ratio, rel=0.005)
    else:
        with pytest.raises(InputError, match="counts too coarse"):
            sampled("x", rows, 100.0, "drop")


def test_sensors_of_two_rates_of_their_own_are_not_dropped():
    rows, k = noise(6), np.arange(N)
    rows[:, :3] = rows[np.floor(k * 0.37).astype(int), :3]
    rows[:, 3:] = rows[np.floor(k * 0.61).astype(int), 3:]
    for how in ("auto", "drop"):
        with pytest.raises(InputError, match="rates of their own"):
            sampled("x", rows, 100.0, how)


def _sway(k: np.ndarray) -> np.ndarray:
    return np.sin(2 * np.pi * 0.003 * k)[:, None] * np.array([3, 2, 1, 4, -2, 3])


@pytest.mark.parametrize("lsb", [0, 0.5, 1, 1.5, 2, 3, 5, 20])
@pytest.mark.parametrize("kind", ["white", "filtered", "swaying", "drifting", "quiet sway"])
def test_coarse_counts_are_no_holds(kind, lsb):
    """What noise, a filter, a slow sway or a drift make repeat is no hold (five sigma and 5%)."""
    import scipy.signal

    k = np.arange(N)
    for seed in range(3):
        rows = noise(10 + seed)
        if kind == "filtered":
            rows = scipy.signal.lfilter(*scipy.signal.butter(2, 0.3), rows, axis=0)
        elif kind != "white":
            rows = (0.2 if kind == "quiet sway" else 1) * rows + (
                _sway(k) if "sway" in kind else np.outer(k / N, [5, -3, 1, 2, 8, 0])
            )
        found = holds(counted(rows, lsb))
        assert found.times == 1
        assert not found.irregular
        assert sampled("x", counted(rows, lsb), 100.0, "auto")[1] == 100.0


def test_constant_columns_are_no_holds():
    assert holds(np.ones((250, 6))) == Holds((1,) * 6, {"gyros": 0.0, "accelerometers": 0.0}, 1.0)


def test_rows_that_stand_there_twice_with_their_stamps_are_left_out(tmp_path):
    t, w, f = cases.static(100, 60, seed=1)
    rows = np.repeat(cases.table(w, f, t), 2, axis=0)
    cases.write(tmp_path / "log.csv", rows, ["t", *cases.HEADER])
    record = one(tmp_path / "log.csv")
    assert record.rate_hz == pytest.approx(100.0, rel=1e-6)
    assert len(record.gyro) == 6000
    assert noted(record, "printed twice")
