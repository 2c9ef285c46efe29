import numpy as np
import pytest

from lbgc.data.record import block_means, mock_record, whole_multiple
from lbgc.data.windows import at_rate, cut, length_note, stack, window_of
from lbgc.errors import InputError


@pytest.mark.parametrize(
    ("rate", "target", "whole"),
    [
        (600, 0.2, 3000),
        (100, 0.2, 500),
        (0.2, 0.2, 1),
        (1, 0.2, 5),
        (0.5, 0.2, None),
        (0.1, 0.2, None),
    ],
)
def test_whole_multiples(rate, target, whole):
    assert whole_multiple(rate, target) == whole


def test_a_record_of_the_wrong_shape_is_refused():
    with pytest.raises(InputError, match=r"gyro's shape"):
        mock_record(gyro=np.zeros((5, 2)))


def test_block_means_average_and_cut_the_rest(rng):
    record = mock_record(gyro=rng.standard_normal((250, 3)))
    means = block_means(record, 0.4)  # blocks of 25 samples
    np.testing.assert_allclose(means.gyro[3], record.gyro[75:100].mean(axis=0))
    assert (len(means.gyro), means.rate_hz) == (10, 0.4)
    assert len(block_means(record, 0.3333333333333).gyro) == 8
    with pytest.raises(InputError, match="10 Hz: must be a whole multiple of the 3 Hz"):
        block_means(record, 3.0)


def test_windows_are_consecutive_and_know_where_they_start(rng):
    record = mock_record(gyro=rng.standard_normal((250, 3)))
    windows = cut(record, 10.0)
    assert windows.gyro.shape == (2, 100, 3)
    np.testing.assert_array_equal(windows.gyro[1], record.gyro[100:200])
    np.testing.assert_array_equal(windows.start_s, [0.0, 10.0])
    assert len(cut(record, 30.0)) == 0
    with pytest.raises(InputError, match=r"windows_s = 0.14 s: must be whole samples of 0.1 s"):
        cut(record, 0.14)


@pytest.mark.parametrize("rate_hz", [99.983, 98.317, 400.02])
def test_windows_of_any_rate_are_the_nearest_whole_number_of_samples(rng, rate_hz):
    """And blocks of them are as equal as whole samples can be: the same mean, nothing left out."""
    n = round(130 * rate_hz)
    values = {"gyro": rng.standard_normal((n, 3)), "accel": rng.standard_normal((n, 3))}
    record = mock_record(**values, plate_angle=np.zeros(n), rate_hz=rate_hz)
    windows = cut(record, 60.0)
    size = round(60 * rate_hz)
    assert windows.gyro.shape == (2, size, 3)
    np.testing.assert_allclose(windows.start_s, [0, size / rate_hz])
    assert length_note(record, 60.0) == (
        f"windows of 60 s are {size} samples, {size / rate_hz:.6g} s, at {rate_hz:.6g} Hz"
    )
    low = at_rate(windows, 4.0)
    assert low.gyro.shape[1] == 240
    assert low.rate_hz == pytest.approx(4.0, rel=1e-3)
    assert low.duration_s == pytest.approx(windows.duration_s)
    edges = np.round(np.arange(241) * size / 240).astype(int)
    np.testing.assert_allclose(low.gyro[1, 7], windows.gyro[1, edges[7] : edges[8]].mean(axis=0))
    assert set(np.diff(edges)) <= {size // 240, size // 240 + 1}
    assert len(block_means(record, 4.0).gyro) == 520


def test_a_whole_window_says_nothing_of_its_length():
    assert length_note(mock_record(), 10.0) is None
    assert length_note(mock_record(rate_hz=400.0000003), 10.0) is None


def test_unknown_headings_are_nan():
    recordings = stack([mock_record(heading=None, heading_reference=None)], 0.2)
    assert np.isnan(recordings.heading).all()
    assert np.isnan(recordings.heading_reference).all()


def test_windows_at_a_lower_rate(rng):
    record = mock_record(gyro=rng.standard_normal((250, 3)))
    low = at_rate(cut(record, 10.0), 0.2)
    np.testing.assert_allclose(low.gyro[1, 1], record.gyro[150:200].mean(axis=0))
    with pytest.raises(InputError, match=r"whole multiple of 3 Hz"):
        at_rate(cut(record, 10.0), 3.0)
    with pytest.raises(InputError, match="whole blocks of 5 s"):
        at_rate(cut(record, 12.0), 0.2)


def test_stacked_recordings_are_a_training_set():
    recordings = stack([mock_record(), mock_record(heading=1.0)], 0.2)
    assert recordings.windows.gyro.shape == (2, 5, 3)
    np.testing.assert_allclose(recordings.heading, [np.deg2rad(40), 1.0])


def test_arrays_of_ones_own_are_one_window():
    gyro, accel = np.ones((30, 3)), np.full((30, 3), 2.0)
    window = window_of(gyro, accel, rate_hz=2.0, latitude_deg=-45.0)
    assert len(window) == 1
    assert window.duration_s == 15.0
    assert window.latitude[0] == pytest.approx(-np.pi / 4)
    np.testing.assert_array_equal(window.plate_angle, np.zeros((1, 30)))
    with pytest.raises(InputError, match="accel's shape"):
        window_of(gyro, accel[:20], rate_hz=2.0, latitude_deg=0.0)
