"""The bench of held poses: what an IMU feels in each attitude, how it is handled between, and that
its dataset says both."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import default_config

from lbgc.attitudes import with_attitudes
from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.frames import euler_to_matrix, wrap
from lbgc.protocol import REST, SLEW, ProtocolConfig, plan
from sim import motion
from sim.disturbance import FloorConfig, VibrationConfig
from sim.hand import HandConfig
from sim.poses import Bench
from sim.recordings import Sensor, recordings
from sim.sway import SwayConfig
from sim.turntable import SceneConfig

LATITUDE = 0.6
LISTED = ((0.0, 0.0, 20.0), (90.0, 10.0, -120.0), (170.0, -60.0, 100.0))
CONFIG = ProtocolConfig(kind="tumble", attitudes_deg=LISTED, placed_deg=0.0, dwell_s=8.0)
RATE_HZ, DURATION_S = 50.0, 34.0


def executed_truth(**changes: object) -> motion.Truth:
    """Truth on a bench with these keys of its scene, at an azimuth of 0.3 rad."""
    scene = SceneConfig(**changes)
    planned = with_attitudes(plan(CONFIG, 0, DURATION_S), CONFIG, np.random.default_rng(1))
    bench = Bench(scene, RATE_HZ, round(DURATION_S * RATE_HZ))
    drawn = motion.draw(scene, 0.3, lambda: np.random.default_rng(1), DURATION_S)
    return motion.truth(bench, planned, LATITUDE, drawn)


def attitudes(found: motion.Truth) -> np.ndarray:
    roll, pitch, turned = found.attitude.T
    return euler_to_matrix(roll, pitch, turned + found.heading)


def test_a_held_imu_feels_earth_rate_and_gravity_in_each_attitude():
    """Exactly, where it rests; and it is where the plan says."""
    found = executed_truth()
    middle = np.array([4.0, 16.0, 28.0]) * RATE_HZ
    roll, pitch, heading = np.deg2rad(LISTED).T
    planned = euler_to_matrix(roll, pitch, heading + 0.3)
    own = attitudes(found)
    np.testing.assert_allclose(own[middle.astype(int)], planned, atol=1e-12)
    rest = found.stage == REST
    omega = np.einsum("nij,i->jn", own, earth_rate_ned(LATITUDE))
    force = np.einsum("nij,i->jn", own, [0.0, 0.0, -normal_gravity(LATITUDE)])
    np.testing.assert_allclose(found.omega_ib_b[:, rest], omega[:, rest], atol=1e-12)
    np.testing.assert_allclose(found.f_ib_b[:, rest], force[:, rest], atol=1e-9)
    np.testing.assert_array_equal(found.plate_angle, 0.0)
    assert found.heading == pytest.approx(0.3 + np.deg2rad(20.0), abs=1e-12)
    assert wrap(found.heading_control - np.pi - found.heading) == pytest.approx(0.0, abs=1e-12)


def test_it_is_handled_when_the_plan_says_and_then_settles():
    found = executed_truth()
    t = np.arange(len(found.stage)) / RATE_HZ
    driven = ((t >= 8) & (t < 12)) | ((t >= 20) & (t < 24))
    np.testing.assert_array_equal(found.stage == SLEW, driven)
    for start in (8, 20):  # rests again within 3 s of each move's end
        assert (found.stage[(t >= start + 7) & (t < start + 8)] == REST).all()
    force = np.linalg.norm(found.f_ib_b, axis=0) - normal_gravity(LATITUDE)
    assert 0.05 < np.abs(force[driven]).max() < 2.0  # m/s^2, of lifting and swinging


def test_the_gyros_integral_is_the_turn_between_two_attitudes():
    """Earth's rate taken off, by increments over the samples: their commutators are the error."""
    found = executed_truth()
    own = attitudes(found)
    turning = found.omega_ib_b - np.einsum("nij,i->jn", own, earth_rate_ned(LATITUDE))
    turned = np.eye(3)
    for one in euler_steps(turning.T / RATE_HZ):
        turned = turned @ one
    np.testing.assert_allclose(own[0] @ turned, own[-1], atol=2e-4)


def euler_steps(angles: np.ndarray) -> np.ndarray:
    from lbgc.frames import rotation_matrix

    return rotation_matrix(angles)


@pytest.mark.parametrize(
    "hand",
    [HandConfig(frequency_hz=3.0), HandConfig(damping_ratio=0.8), HandConfig(lift_m=0.0)],
)
def test_every_key_of_the_hand_changes_the_handling_and_no_rest(hand):
    usual, other = executed_truth(), executed_truth(hand=hand)
    driven = usual.stage == SLEW
    assert np.abs(usual.f_ib_b - other.f_ib_b)[:, driven].max() > 1e-3
    last = slice(-50, None)
    np.testing.assert_allclose(usual.f_ib_b[:, last], other.f_ib_b[:, last], atol=1e-9)


def test_a_floor_that_vibrates_shakes_what_is_held():
    floor = FloorConfig(vibration=VibrationConfig(rate_deg_per_h=(90.0, 55.0, 0.0), hz=7.0))
    found, still = executed_truth(floor=floor), executed_truth()
    off = np.rad2deg(found.omega_ib_b - still.omega_ib_b) * 3600
    assert 50 < np.abs(off).max() < 500


def test_a_vehicle_is_refused(cli):
    with pytest.raises(InputError, match=r"scene.sway.level = 1.0: must be 0 with protocol=tum"):
        executed_truth(sway=SwayConfig(level=1.0))
    done = cli("sim.generate", "protocol=tumble", "scene=vehicle", "out=d.zarr", "duration_s=240")
    assert done.code == 2
    assert "scene.sway.level = 1.0: must be 0 with protocol=tumble" in done.err


def test_recordings_draw_their_own_attitudes_and_depend_on_nothing_else():
    config = default_config(
        *("protocol=tumble", "protocol.poses=3", "protocol.dwell_s=5", "duration_s=23"),
        *("rate_hz=50", "recordings=4", "imu=ideal"),
    )
    sensor = Sensor.of(config)
    all_of = list(recordings(config, sensor, [0, 1, 2]))
    alone = next(recordings(config, sensor, [2]))
    np.testing.assert_array_equal(all_of[2]["accel"], alone["accel"])
    first = [own["accel"][0] for own in all_of]
    assert len({tuple(own) for own in first}) == 3
    other = next(recordings(replace(config, seed=2), sensor, [0]))
    assert not np.array_equal(other["accel"][0], first[0])
