"""Through MuJoCo: what a resting module feels, and what the model must be."""

from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest

from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.errors import InputError
from lbgc.frames import wrap
from lbgc.protocol import Plan, ProtocolConfig, plan
from sim import motion
from sim.motion import rest
from sim.scene import SceneConfig, load

SCENE = SceneConfig()


@pytest.mark.parametrize("latitude_deg", [0.0, 32.76, 60.0, -45.0, 90.0])
def test_a_level_resting_imu_reads_earths_rate_and_gravity(latitude_deg):
    """Every 5 degrees of heading, to 1e-9 of Omega and 1e-6 m/s^2, by the resting formula."""
    lat = np.deg2rad(latitude_deg)
    for i in range(72):
        truth = rest(SCENE, plan(ProtocolConfig(), i), float(lat), 0.0)
        psi = np.deg2rad(5.0 * i + 180.0)  # the test module looks the other way
        expected = EARTH_RATE * np.array(
            [np.cos(lat) * np.cos(psi), -np.cos(lat) * np.sin(psi), -np.sin(lat)]
        )
        assert np.abs(truth.omega_ib_b - expected).max() < 1e-9 * EARTH_RATE
        gravity = [0.0, 0.0, -normal_gravity(float(lat))]
        assert np.abs(truth.f_ib_b - gravity).max() < 1e-6
        assert abs(wrap(truth.heading - psi)) < 1e-12
        assert abs(wrap(truth.heading_control + np.pi - truth.heading)) < 1e-12
        assert truth.roll == pytest.approx(0.0, abs=1e-12)
        assert truth.pitch == pytest.approx(0.0, abs=1e-12)


def test_resting_imu_at_the_pole_reads_earth_rate_on_z():
    truth = rest(SCENE, Plan(0.0, 0.0, 0.0), np.pi / 2, 1.0)
    np.testing.assert_allclose(truth.omega_ib_b, [0, 0, -EARTH_RATE], atol=1e-19)


def test_the_bases_azimuth_turns_the_heading():
    still = rest(SCENE, Plan(0.0, 0.3, 0.0), 0.5, 0.0)
    turned = rest(SCENE, Plan(0.0, 0.3, 0.0), 0.5, 0.2)
    assert turned.heading - still.heading == pytest.approx(0.2)


def test_truth_agrees_with_mujocos_own_sensors():
    """At rest the model's accelerometers read what we say, and its gyros nothing."""
    model = load(SCENE, 9.8)
    data = mujoco.MjData(model)
    data.joint("azimuth").qpos[0] = 0.7
    data.actuator("servo").ctrl[0] = 0.7
    mujoco.mj_forward(model, data)
    for module in ("test", "control"):
        np.testing.assert_allclose(data.sensor(f"{module}_accel").data, [0, 0, -9.8], atol=1e-9)
        np.testing.assert_allclose(data.sensor(f"{module}_gyro").data, 0, atol=1e-12)
    assert data.sensor("encoder").data[0] == 0.7


def test_a_positive_hinge_angle_is_clockwise_from_above():
    truth = rest(SCENE, Plan(0.0, np.pi / 2, 0.0), 0.0, 0.0)
    assert truth.heading_control == pytest.approx(np.pi / 2)  # the control module looks east


def test_a_settled_pose_is_not_simulated_twice():
    before = motion._settle.cache_info()
    planned = plan(ProtocolConfig(step_deg=7.0), 3)
    rest(SCENE, planned, 0.6, 0.1)
    rest(SCENE, planned, 0.6, 0.2)
    after = motion._settle.cache_info()
    assert after.misses - before.misses == 1
    assert after.hits - before.hits == 1


def test_a_servo_that_never_rests_is_refused():
    undamped = SceneConfig(servo_damping_nm_s_per_rad=1e-3, bearing_damping_nm_s_per_rad=0.0)
    with pytest.raises(InputError, match="still moves at"):
        rest(undamped, Plan(0.0, 0.5, 0.0), 0.6, 0.0)


@pytest.mark.parametrize("field", [f.name for f in fields(SceneConfig) if f.name != "sway"])
def test_every_scene_parameter_changes_something(field):
    """The reference's error is read by sim/generate.py and tested there, sway in test_sway.py."""
    changed = replace(SCENE, **{field: 2 * getattr(SCENE, field)})
    if field == "bearing_damping_nm_s_per_rad":
        changed = replace(SCENE, bearing_damping_nm_s_per_rad=1.0)
    planned = Plan(0.0, 0.5, 0.0)
    if field != "reference_error_deg":
        usual = rest(SCENE, planned, 0.6, 0.0)
        assert rest(changed, planned, 0.6, 0.0).settling_s != usual.settling_s


@pytest.mark.parametrize(
    ("config", "says"),
    [
        (lambda: ProtocolConfig(name="spin"), "choose from heading_scan, static"),
        (lambda: ProtocolConfig(step_deg=0.0), "step_deg = 0.0 deg"),
        (lambda: SceneConfig(physics_hz=0.0), "physics_hz = 0.0 Hz"),
        (lambda: SceneConfig(reference_error_deg=-1.0), "must not be negative"),
    ],
)
def test_wrong_benches_are_refused(config, says):
    with pytest.raises(InputError, match=says):
        config()


def test_a_scan_goes_round_the_circle_and_the_base_fills_the_gaps():
    scan = ProtocolConfig(step_deg=5.0)
    angles = [plan(scan, i).target for i in range(144)]
    np.testing.assert_allclose(np.diff(angles[:72]), np.deg2rad(5.0))
    assert angles[72:] == angles[:72]
    assert plan(scan, 10).azimuth_range == pytest.approx(np.deg2rad(5.0))
    assert plan(ProtocolConfig(name="static"), 10).azimuth_range == pytest.approx(2 * np.pi)
