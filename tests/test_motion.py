"""Through MuJoCo: what the module feels, resting and moving, against a closed form of its own."""

from dataclasses import fields, replace

import closed_form
import mujoco
import numpy as np
import pytest

from lbgc.attitudes import with_attitudes
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.errors import InputError
from lbgc.frames import wrap
from lbgc.protocol import REST, SETTLE, SLEW, Plan, ProtocolConfig, plan
from lbgc.sensor import streams
from sim import motion, physics
from sim.disturbance import FloorConfig, VibrationConfig
from sim.hand import HandConfig
from sim.motion import Draw, Truth, truth
from sim.physics import execute
from sim.poses import Bench
from sim.sway import SwayConfig
from sim.turntable import SceneConfig, load, plate_inertia

DEG, ARCSEC = np.pi / 180, np.pi / 180 / 3600
SCENE = SceneConfig()
RATE_HZ = 600.0


def drawn(scene: SceneConfig = SCENE, azimuth: float = 0.0, index: int = 0) -> Draw:
    rng = streams.recording(1, index, streams.Purpose.MOTION)
    return motion.draw(scene, azimuth, lambda: rng, 60.0)


def resting(planned: Plan, latitude: float, azimuth: float = 0.0, scene=SCENE) -> Truth:
    bench = Bench(scene, RATE_HZ, 60)
    return truth(bench, planned, latitude, drawn(scene, azimuth))


# --- at rest --------------------------------------------------------------------------------------


@pytest.mark.parametrize("latitude_deg", [0.0, 32.76, 60.0, -45.0, 90.0])
def test_a_level_resting_imu_reads_earths_rate_and_gravity(latitude_deg):
    """Every 5 degrees of heading, to 1e-9 of Omega and 1e-6 m/s^2, by the resting formula."""
    lat = np.deg2rad(latitude_deg)
    for i in range(72):
        found = resting(plan(ProtocolConfig(), i, 0.1), float(lat))
        psi = np.deg2rad(5.0 * i + 180.0)  # the test module looks the other way
        expected = EARTH_RATE * np.array(
            [np.cos(lat) * np.cos(psi), -np.cos(lat) * np.sin(psi), -np.sin(lat)]
        )
        assert np.abs(found.omega_ib_b[:, 0] - expected).max() < 1e-9 * EARTH_RATE
        gravity = [0.0, 0.0, -normal_gravity(float(lat))]
        assert np.abs(found.f_ib_b[:, 0] - gravity).max() < 1e-6
        assert abs(wrap(found.heading - psi)) < 1e-12
        assert abs(wrap(found.heading_control + np.pi - found.heading)) < 1e-12
        assert found.roll == pytest.approx(0.0, abs=1e-12)
        assert found.pitch == pytest.approx(0.0, abs=1e-12)
        assert not found.plate_angle.any()


def test_resting_imu_at_the_pole_reads_earth_rate_on_z():
    found = resting(plan(ProtocolConfig(kind="static"), 0, 0.1), np.pi / 2, 1.0)
    np.testing.assert_allclose(found.omega_ib_b[:, 0], [0, 0, -EARTH_RATE], atol=1e-19)


def test_the_bases_azimuth_turns_the_heading():
    scan = plan(ProtocolConfig(), 3, 0.1)
    still, turned = resting(scan, 0.5), resting(scan, 0.5, azimuth=0.2)
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
    east = plan(ProtocolConfig(step_deg=90.0), 1, 0.1)
    assert resting(east, 0.0).heading_control == pytest.approx(np.pi / 2)


def test_rests_cost_no_physics_beyond_one_slew():
    """Of a scan's 72 plans the physics sees one slew, once."""
    physics._settling.cache_clear()
    stepped = []
    roll = physics.roll

    def counted(models, states, control, pool):
        stepped.append(control.shape[1])
        return roll(models, states, control, pool)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(physics, "roll", counted)
        settled = [resting(plan(ProtocolConfig(), i, 0.1), 0.6).settling_s for i in range(72)]
    assert len(set(settled)) == 1
    assert 0.3 < settled[0] < 20
    assert sum(stepped) < 25 * SCENE.physics_hz


# --- moving ---------------------------------------------------------------------------------------

TILTED = {"base_roll_deg": 0.7, "base_pitch_deg": -1.1, "axis_tilt_deg": 0.4}
MOTIONS = {
    "two positions, 30 deg/s": ({"kind": "indexed"}, 24.0),
    "four positions, 90 deg/s": (
        {"kind": "indexed", "angles_deg": (0.0, 90.0, 180.0, 270.0), "slew_deg_per_s": 90.0},
        30.0,
    ),
    "hardly settled between": (
        {"kind": "indexed", "angles_deg": (20.0, 60.0, -10.0), "dwell_s": (1.0, 1.5, 3.0)},
        12.0,
    ),
    "carousel, 1 deg/s": ({"kind": "carousel", "carousel_deg_per_s": 1.0}, 12.0),
    "carousel, -20 deg/s": ({"kind": "carousel", "carousel_deg_per_s": -20.0}, 12.0),
    "carousel, 90 deg/s, a turn": (
        {"kind": "carousel", "carousel_deg_per_s": 90.0, "turns": 1.0},
        12.0,
    ),
}


def trajectory(bench: Bench, planned: Plan, gravity: float) -> np.ndarray:
    """The plate's angle at every physics instant from t_-1 to one after the recording's end, as
    the physics had it."""
    last = bench.samples * bench.steps
    executed = execute(bench, gravity, planned)
    angle = executed.angle_at(np.arange(-1, last + 2) * bench.step)
    if executed.stretches[-1].moves:
        angle[-1] = executed.stretches[-1].poses.angle[-1]
    return angle


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("latitude_deg", [32.76, -45.0, 70.0])
def test_truth_is_the_closed_form_in_every_sample(name, latitude_deg):
    """Through rest, slew, settling and carousel, base and axis tilted: rates to 1e-9 rad/s, forces
    to 1e-6 m/s^2."""
    values, duration = MOTIONS[name]
    scene = SceneConfig(**TILTED, bearing_friction_nm=0.2)
    bench = Bench(scene, RATE_HZ, round(duration * RATE_HZ))
    planned = plan(ProtocolConfig(**values), 0, duration)
    lat = float(np.deg2rad(latitude_deg))
    gravity = normal_gravity(lat)
    found = truth(bench, planned, lat, drawn(scene, azimuth=0.9))
    angle = trajectory(bench, planned, gravity)
    omega, force = closed_form.sample_means(
        angle,
        bench.step,
        bench.steps,
        latitude=lat,
        gravity=gravity,
        azimuth=0.9,
        roll=0.7 * DEG,
        pitch=-1.1 * DEG,
        axis_tilt=0.4 * DEG,
        arm=0.27,
    )
    assert np.abs(found.omega_ib_b.T - omega).max() < 1e-9
    assert np.abs(found.f_ib_b.T - force).max() < 1e-6
    assert np.ptp(angle) > 10 * DEG


@pytest.mark.parametrize("name", MOTIONS)
def test_the_vertical_rate_adds_up_to_the_plates_angle(name):
    """In every sample: its increment of angle and Earth's share, to 1e-8 rad."""
    values, duration = MOTIONS[name]
    bench = Bench(SCENE, RATE_HZ, round(duration * RATE_HZ))
    planned = plan(ProtocolConfig(**values), 0, duration)
    found = truth(bench, planned, 0.5, drawn())
    earth = -EARTH_RATE * np.sin(0.5) / RATE_HZ
    turned = np.diff(found.plate_angle, prepend=0.0)
    vertical = np.broadcast_to(found.omega_ib_b[2] / RATE_HZ, turned.shape)
    assert np.abs(vertical - turned - earth).max() < 1e-8
    assert np.abs(np.cumsum(vertical - earth) - found.plate_angle).max() < 1e-8


def test_stages_say_what_the_plate_does():
    """Driven samples are slew; a settled one turns at less than 1e-12 rad/s."""
    bench = Bench(SCENE, RATE_HZ, round(24 * RATE_HZ))
    planned = plan(ProtocolConfig(kind="indexed"), 0, 24.0)
    found = truth(bench, planned, 0.5, drawn())
    (move,) = planned.moves
    t = (np.arange(bench.samples) + 0.5) / RATE_HZ
    driven = (t > move.start_s) & (t < move.end_s)
    assert (found.stage[driven] == SLEW).all()
    assert (found.stage[t < move.start_s - 0.01] == REST).all()
    assert found.stage[np.argmax(t > move.end_s + 0.01)] == SETTLE
    assert found.stage[-1] == REST
    angle = trajectory(bench, planned, normal_gravity(0.5))
    turned = np.diff(angle[1:-1]).reshape(-1, bench.steps) / bench.step
    assert np.abs(turned.mean(axis=1)[found.stage == REST]).max() < 1e-12
    assert abs(turned[found.stage == REST].mean()) < 1e-13
    assert angle[-1] == pytest.approx(np.pi, abs=1e-12)


def test_friction_slows_the_plate_and_lets_it_rest():
    """Held at a rate against friction f and viscous drag c, the servo lags by (f + c w)/k; once
    settled it stands where it was sent."""
    lag = {}
    for friction in (0.0, 0.5):
        scene = replace(SCENE, bearing_friction_nm=friction)
        bench = Bench(scene, RATE_HZ, round(20 * RATE_HZ))
        planned = plan(ProtocolConfig(kind="indexed"), 0, 20.0)
        middle = planned.moves[0].start_s + 4.0
        executed = execute(bench, 9.8, planned)
        commanded = planned.command(np.array(middle))[0]
        lag[friction] = float(commanded - executed.angle_at(np.array(middle)))
        assert executed.stage[-1] == REST
        assert executed.angle_at(np.array(20.0)) == pytest.approx(np.pi, abs=1e-11)
    viscous = 0.05 * 30 * DEG / 60
    assert lag[0.0] == pytest.approx(viscous, rel=1e-3)
    assert lag[0.5] == pytest.approx(0.5 / 60 + viscous, rel=1e-3)


@pytest.mark.parametrize(
    ("angles_deg", "physics_hz"), [((0, 90, 270), 1200), ((0, 5, 355), 600), ((720, -450), 2400)]
)
def test_it_comes_to_rest_wherever_it_is_sent(angles_deg, physics_hz):
    """A velocity that moves a large angle by less than its last bit never dies: that is rest."""
    bench = Bench(SceneConfig(physics_hz=physics_hz), physics_hz / 4, 75 * physics_hz // 4)
    planned = plan(ProtocolConfig(kind="indexed", angles_deg=angles_deg, dwell_s=5.0), 0, 75.0)
    executed = execute(bench, 9.8, planned)
    last = executed.stretches[-1]
    assert (last.stage == REST).all()
    assert last.samples > 8 * bench.rate_hz, "it rests soon after the slew"
    assert last.poses.angle[-1] == pytest.approx(planned.command(np.array(75.0))[0], abs=1e-11)


def test_the_servo_overshoots_and_a_stiffer_one_less():
    def overshoot(stiffness):
        scene = replace(SCENE, servo_stiffness_nm_per_rad=stiffness)
        planned = plan(ProtocolConfig(kind="indexed"), 0, 20.0)
        t = np.linspace(planned.moves[0].end_s, 20, 4000)
        return float(execute(Bench(scene, RATE_HZ, 12_000), 9.8, planned).angle_at(t).max() - np.pi)

    assert overshoot(60.0) > overshoot(200.0) > 1e-6


def test_a_servo_has_its_torque_and_no_more():
    inertia = plate_inertia(load(SCENE, 9.8))
    asked = ProtocolConfig(kind="indexed", slew_deg_per_s2=float(np.rad2deg(6.0 / inertia)))
    with pytest.raises(InputError, match=r"slew_deg_per_s2 = .* deg/s2: needs 6.03 N m, and the "):
        execute(Bench(SCENE, RATE_HZ, 12_000), 9.8, plan(asked, 0, 20.0))
    stiff = replace(SCENE, servo_torque_nm=1.0, bearing_friction_nm=1.5)
    with pytest.raises(InputError, match="the load alone takes more"):
        execute(Bench(stiff, RATE_HZ, 12_000), 9.8, plan(ProtocolConfig(kind="indexed"), 0, 20.0))


def test_a_servo_that_never_rests_is_refused():
    undamped = replace(SCENE, servo_damping_nm_s_per_rad=1e-3, bearing_damping_nm_s_per_rad=0.0)
    with pytest.raises(InputError, match="still moves at"):
        resting(plan(ProtocolConfig(), 1, 0.1), 0.6, scene=undamped)


def test_a_bias_does_not_leak_into_what_turning_tells():
    """100 deg/h on every axis, in the body: the two-position difference and the least-squares fit
    of a carousel's whole turns do not see it, to 1e-6 degrees."""
    bias = 100 * DEG / 3600
    lat = 0.5718
    for values, duration in (
        ({"kind": "indexed"}, 40.0),
        ({"kind": "carousel", "carousel_deg_per_s": 36.0, "turns": 3.0}, 40.0),
    ):
        bench = Bench(SCENE, RATE_HZ, round(duration * RATE_HZ))
        found = truth(bench, plan(ProtocolConfig(**values), 0, duration), lat, drawn(azimuth=0.4))
        middle = found.plate_angle - np.diff(found.plate_angle, prepend=0.0) / 2
        used = found.stage == (REST if values["kind"] == "indexed" else SLEW)
        headings = [
            closed_form.heading_from_turning(middle[used], *(found.omega_ib_b[:2, used] + added))
            for added in (0.0, bias)
        ]
        assert abs(np.rad2deg(headings[1] - headings[0])) < 1e-6
        assert abs(np.rad2deg(wrap(headings[0] - found.heading))) < 1e-4


# --- the bench's imperfections --------------------------------------------------------------------


def test_levelling_errors_are_drawn_and_felt():
    """1 sigma from 400 recordings: 4.5 x 1/sqrt(800) = 16%."""
    scene = replace(SCENE, level_error_deg=0.3)
    draws = [drawn(scene, index=i) for i in range(400)]
    angles = np.array([(d.roll, d.pitch) for d in draws])
    assert angles.std() == pytest.approx(0.3 * DEG, rel=0.16)
    found = truth(
        Bench(scene, RATE_HZ, 60), plan(ProtocolConfig(kind="static"), 0, 0.1), 0.5, draws[3]
    )
    # the module looks backwards: what pitches the base up pitches it down
    assert found.pitch == pytest.approx(-draws[3].pitch, abs=1e-9)
    assert found.f_ib_b[0, 0] == pytest.approx(
        -normal_gravity(0.5) * np.sin(draws[3].pitch), rel=1e-6
    )


def test_the_axis_wobbles_twice_a_turn():
    scene = replace(SCENE, axis_wobble_arcsec=20.0)
    bench = Bench(scene, RATE_HZ, round(12 * RATE_HZ))
    values = {"kind": "carousel", "carousel_deg_per_s": 90.0, "turns": 2.0}
    found = truth(bench, plan(ProtocolConfig(**values), 0, 12.0), 0.5, drawn(scene))
    roll, pitch = found.attitude[:, 0], found.attitude[:, 1]
    lean = np.hypot(roll, pitch)
    np.testing.assert_allclose(lean, 20 * ARCSEC, rtol=1e-6)
    # in the body the cone turns once a turn: twice round the room, less the plate's own once
    moving = found.stage == SLEW
    body = np.unwrap(np.arctan2(pitch, roll))[moving]
    assert abs(body[-1] - body[0]) == pytest.approx(2 * 2 * np.pi, rel=0.02)


def test_the_encoder_counts_is_late_and_eccentric():
    values = {"kind": "carousel", "carousel_deg_per_s": 30.0}
    planned = plan(ProtocolConfig(**values), 0, 12.0)

    def reads(**changes):
        scene = replace(SCENE, **changes)
        return truth(Bench(scene, RATE_HZ, 7200), planned, 0.5, drawn(scene)).plate_angle

    ideal = reads()
    assert ideal[0] != 0
    counts = reads(encoder_lsb_arcsec=36.0) / (36 * ARCSEC)
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    assert np.abs(counts * 36 - ideal / ARCSEC).max() < 18.01
    late = ideal - reads(encoder_latency_s=0.01)
    assert late[3600] == pytest.approx(0.3 * DEG, rel=1e-6)
    off = reads(encoder_error_arcsec=30.0) - ideal
    np.testing.assert_allclose(off, 30 * ARCSEC * np.sin(ideal), atol=1e-12)


def test_a_longer_arm_feels_more():
    values = {"kind": "carousel", "carousel_deg_per_s": 90.0}
    planned = plan(ProtocolConfig(**values), 0, 5.0)
    for arm in (0.1, 0.2):
        scene = replace(SCENE, arm_m=arm)
        found = truth(Bench(scene, RATE_HZ, 3000), planned, 0.5, drawn(scene))
        # the module looks outwards, and is drawn inwards: f = -w^2 r; and a little Coriolis
        assert found.f_ib_b[0, -1] == pytest.approx(-((90 * DEG) ** 2) * arm, rel=1e-3)


# --- a base that moves ----------------------------------------------------------------------------


def test_vibration_has_the_amplitudes_asked_for():
    """Over whole periods of 48 Hz at rest: the samples' own averaging takes 1 - sinc(48/600)."""
    floor = FloorConfig(vibration=VibrationConfig(rate_deg_per_h=(90.0, 55.0, 0.0)))
    scene = replace(SCENE, floor=floor)
    found = truth(
        Bench(scene, RATE_HZ, 6000), plan(ProtocolConfig(kind="static"), 0, 10.0), 0.5, drawn(scene)
    )
    moving = found.omega_ib_b - found.omega_ib_b.mean(axis=1, keepdims=True)
    amplitude = np.sqrt(2 * np.mean(moving**2, axis=1)) / (DEG / 3600) / np.sinc(48 / 600)
    np.testing.assert_allclose(amplitude[:2], [90.0, 55.0], rtol=1e-3)
    assert amplitude[2] < 1e-2
    assert np.ptp(found.attitude[:, 0]) > 0


def test_a_moving_floor_and_a_turning_plate_are_felt_together():
    """Composed, or each alone and added: a vibration of microradians is small enough to add."""
    floor = FloorConfig(vibration=VibrationConfig(rate_deg_per_h=(90.0, 55.0, 20.0)))
    shaken = replace(SCENE, floor=floor)
    planned = plan(ProtocolConfig(kind="indexed"), 0, 20.0)
    still = plan(ProtocolConfig(kind="static"), 0, 20.0)

    def rates(scene, planned):
        return truth(Bench(scene, RATE_HZ, 12_000), planned, 0.5, drawn(shaken)).omega_ib_b

    together = rates(shaken, planned)[2] - rates(SCENE, planned)[2]
    alone = (rates(shaken, still) - rates(SCENE, still))[2]
    np.testing.assert_allclose(together, alone, atol=1e-8)


def test_a_sway_of_nothing_is_a_rigid_base():
    """All stepped, in blocks, on seven joints: the same truth as the skipped rests."""
    scene = replace(SCENE, sway=SwayConfig(level=1.0))
    nothing = replace(drawn(scene), sway_level=0.0)
    planned = plan(ProtocolConfig(kind="indexed"), 0, 20.0)
    lat = 0.5
    swaying = truth(Bench(scene, 100.0, 2000), planned, lat, nothing)
    rigid = truth(Bench(SCENE, 100.0, 2000), planned, lat, nothing)
    at_rest = rigid.stage == REST
    np.testing.assert_allclose(
        swaying.omega_ib_b[:, at_rest], rigid.omega_ib_b[:, at_rest], atol=1e-7
    )
    np.testing.assert_allclose(swaying.plate_angle, rigid.plate_angle, atol=1e-4)
    np.testing.assert_array_equal(swaying.stage, rigid.stage)
    assert wrap(swaying.heading - rigid.heading) == pytest.approx(0.0, abs=1e-9)


def test_the_table_stands_in_the_vehicle_as_on_the_ground():
    """A sway of nothing, the table tilted: the tilt inside the physics or laid on afterwards."""
    level = {"base_roll_deg": 0.5, "base_pitch_deg": -0.8}
    planned = plan(ProtocolConfig(kind="static"), 0, 1.0)
    swaying, rigid = (
        truth(Bench(scene, 100.0, 100), planned, 0.5, replace(drawn(scene, 0.7), sway_level=0.0))
        for scene in (SceneConfig(**level, sway=SwayConfig(level=1.0)), SceneConfig(**level))
    )
    np.testing.assert_allclose(swaying.omega_ib_b, np.tile(rigid.omega_ib_b, 100), atol=1e-12)
    np.testing.assert_allclose(swaying.f_ib_b, np.tile(rigid.f_ib_b, 100), atol=1e-8)
    for name in ("heading", "heading_control", "roll", "pitch"):
        assert getattr(swaying, name) == pytest.approx(getattr(rigid, name), abs=1e-12)


def test_no_number_depends_on_threads_or_company():
    scene = replace(SCENE, sway=SwayConfig(level=1.0))
    bench = Bench(scene, 100.0, 300)
    planned = plan(ProtocolConfig(kind="static"), 0, 3.0)

    def all_of(count, threads):
        draws = [drawn(scene, index=i) for i in range(count)]
        found = motion.truths(bench, [planned] * count, 0.5, draws, threads)
        return np.concatenate([t.omega_ib_b for t in found])

    alone = all_of(1, 1)
    for threads in (1, 2, 3, 4):
        together = all_of(5, threads)
        np.testing.assert_array_equal(together[0], alone[0])
        np.testing.assert_array_equal(together, all_of(5, 1))


def test_a_swaying_base_moves_everything_and_is_bounded():
    scene = replace(SCENE, sway=SwayConfig(level=1.0))
    found = truth(
        Bench(scene, 100.0, 6000), plan(ProtocolConfig(kind="static"), 0, 60.0), 0.5, drawn(scene)
    )
    assert (found.omega_ib_b.std(axis=1) > 1e-7).all()
    assert np.abs(found.attitude).max() < 2 * DEG
    assert np.linalg.norm(found.f_ib_b.mean(axis=1)) == pytest.approx(normal_gravity(0.5), rel=1e-3)


CHANGED = {
    "base_azimuth_deg": 30.0,
    "base_roll_deg": 1.0,
    "base_pitch_deg": 1.0,
    "level_error_deg": 0.1,
    "axis_tilt_deg": 0.1,
    "axis_wobble_arcsec": 5.0,
    "encoder_lsb_arcsec": 1.0,
    "encoder_error_arcsec": 1.0,
    "encoder_latency_s": 0.01,
    "bearing_friction_nm": 0.1,
    "bearing_damping_nm_s_per_rad": 1.0,
    "servo_torque_nm": 0.65,
    "floor": FloorConfig(vibration=VibrationConfig(rate_deg_per_h=(90.0, 55.0, 0.0))),
    "sway": SwayConfig(level=1.0),
    "hand": HandConfig(lift_m=0.2),
}


@pytest.mark.parametrize("field", [f.name for f in fields(SceneConfig)])
def test_every_scene_parameter_changes_something(field):
    """The reference's error is read by sim/generate.py and tested there."""
    if field == "reference_error_deg":
        return
    value = CHANGED[field] if field in CHANGED else getattr(SCENE, field) / 2
    changed = replace(SCENE, **{field: value})
    planned = plan(ProtocolConfig(kind="indexed"), 0, 12.0)
    if field == "hand":
        config = ProtocolConfig(kind="tumble", poses=2)
        planned = with_attitudes(plan(config, 0, 12.0), config, np.random.default_rng(1))
    one, other = (truth(Bench(s, 100.0, 1200), planned, 0.5, drawn(s)) for s in (SCENE, changed))
    assert any(
        not np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("omega_ib_b", "f_ib_b", "plate_angle")
    )


@pytest.mark.parametrize(
    ("config", "says"),
    [
        (lambda: SceneConfig(physics_hz=0.0), "physics_hz = 0.0 Hz"),
        (lambda: SceneConfig(reference_error_deg=-1.0), "must not be negative"),
        (lambda: SceneConfig(arm_m=0.5), "arm_m = 0.5 m: must be on the plate"),
        (lambda: SceneConfig(base_roll_deg=60.0), "must be from -45 to 45"),
        (lambda: SceneConfig(encoder_lsb_arcsec=0.0), "must be greater than zero"),
        (lambda: SceneConfig(servo_torque_nm=-1.0), "servo_torque_nm = -1.0 N m"),
    ],
)
def test_wrong_benches_are_refused(config, says):
    with pytest.raises(InputError, match=says):
        config()
