"""A recording that is taken for resting, and was turned."""

from dataclasses import replace

import cases
import numpy as np
import pytest
from helpers import default_config

from lbgc.data.checks.moved import moved_finding
from lbgc.data.record import Record
from lbgc.earth import EARTH_RATE


def recording(gyro: np.ndarray, accel: np.ndarray, rate_hz: float) -> Record:
    return Record("log", gyro, accel, np.zeros(len(gyro)), rate_hz, 0.8)


@pytest.fixture
def still() -> Record:
    _, gyro, accel = cases.static(50, 300, arw=0.3, seed=8)
    return recording(gyro, accel, 50.0)


@pytest.mark.parametrize(("axis", "name"), [(0, "forward"), (1, "right"), (2, "down")])
@pytest.mark.parametrize(("angle", "speed"), [(180, 30), (-90, 9), (20, 1)])
def test_a_turn_by_hand_is_found_with_its_angle_and_time(still, axis, name, angle, speed):
    gyro = still.gyro.copy()
    seconds = abs(angle) / speed
    turning = slice(5000, 5000 + round(seconds * 50))
    gyro[turning, axis] += np.sign(angle) * np.deg2rad(speed)
    found = moved_finding(replace(still, gyro=gyro), north=True)
    assert found.refuses
    assert found.value == pytest.approx(abs(angle), rel=0.05)
    start, end = (float(t) for t in found.says.split("between ")[1].split(" s:")[0].split(" and "))
    assert f"its {name} axis" in found.says
    assert start == pytest.approx(100, abs=1)
    assert end == pytest.approx(100 + seconds, abs=1)
    assert not moved_finding(replace(still, gyro=gyro), north=False).refuses


def test_what_rests_warms_up_or_sways_is_not_turned(still):
    assert moved_finding(still, north=True) is None
    t = np.arange(len(still.gyro)) / 50
    warm = np.deg2rad(500 / 3600) * np.exp(-t / 60)
    sway = np.deg2rad(1.5) * np.pi * np.cos(np.pi * t)  # 1.5 degrees at half a hertz
    for more in (warm, sway):
        assert moved_finding(replace(still, gyro=still.gyro + more[:, None]), True) is None
    assert moved_finding(replace(still, plate_angle=0.1 * t, gyro=still.gyro + 0.1), True) is None


@pytest.mark.parametrize("preset", ["bmi160", "adis16405", "vn100", "stim300", "lasergyro"])
def test_no_sensor_at_rest_is_said_to_be_turned(preset):
    """Ten of each, an hour at 5 Hz: none."""
    triad = default_config(f"imu={preset}").imu.model(5.0).gyro
    truth = np.full((3, 1), EARTH_RATE)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        errors = triad.draw_run(rng, triad.draw_unit(rng) | triad.draw_session(rng))
        printed, _ = triad.measure(rng, truth, errors, 18000, 0.2)
        gyro = printed.T * (triad.output_scale(0.2) or 1.0)
        assert moved_finding(recording(gyro, np.zeros_like(gyro), 5.0), True) is None
