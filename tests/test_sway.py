"""A vehicle on its suspension: the law of its forces, and the springs it stands on."""

from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest
import scipy.signal
from helpers import default_config

from lbgc.errors import InputError
from lbgc.frames import NED_FROM_NWU, matrix_to_euler
from sim.sway import JOINTS, SwayConfig, forces, spells
from sim.turntable import SceneConfig, load

SWAY = SwayConfig(level=1.0)
STILL = replace(
    SWAY, load_n=0.0, load_nm=(0.0, 0.0), agitation_n=0.0, agitation_nm=0.0, wind_n=0.0, wind_nm=0.0
)
"""Nobody there, no wind."""
G = 9.8


def lengths(active: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Of the whole quiets and of the whole spells, s."""
    edges = np.flatnonzero(np.diff(active.astype(int)))
    runs = np.diff(edges) * dt
    spell_first = active[edges[0] + 1]
    return runs[int(spell_first) :: 2], runs[1 - int(spell_first) :: 2]


def test_quiet_and_spells_have_the_stated_lengths(rng):
    """Means within 5 sigma, L / sqrt(k n) each; the scatter within 5 sigma of L / sqrt(k)."""
    config, dt = replace(SWAY, restlessness=0.0), 0.05
    activity = spells(config, rng, 2_000_000, dt)
    for found, mean in zip(
        lengths(activity > 0, dt), (config.quiet_s, config.spell_s), strict=True
    ):
        n, k = len(found), config.regularity
        assert n > 1000
        assert abs(found.mean() / mean - 1) < 5 / np.sqrt(k * n)
        # Kurtosis 6/k of a gamma law: the variance's relative sigma is sqrt((2 + 6/k)/n).
        assert abs(found.var() * k / mean**2 - 1) < 5 * np.sqrt((2 + 6 / k) / n)


def test_a_recording_starts_anywhere_in_a_cycle(rng):
    """Active at its start as often as at any time, within 5 sigma of a binomial."""
    config, n = replace(SWAY, restlessness=0.0), 4000
    active = [spells(config, rng, 1, 0.1)[0] > 0 for _ in range(n)]
    share = config.spell_s / (config.spell_s + config.quiet_s)
    assert abs(np.mean(active) - share) < 5 * np.sqrt(share * (1 - share) / n)


def test_spells_differ_and_the_quiet_is_not_dead(rng):
    activity = spells(replace(SWAY, spell_spread=0.5), rng, 4_000_000, 0.05)
    sizes = np.unique(activity[activity > SWAY.restlessness])
    assert np.std(np.log(sizes)) == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(2 * len(sizes)))
    assert activity.min() == SWAY.restlessness


def test_the_load_stays_put_in_the_quiet(rng):
    """Once a move is over, nothing changes until the next spell; then everything has."""
    config = replace(STILL, restlessness=0.0, load_nm=(500.0, 300.0), move_s=(0.1, 0.1, 0.1))
    activity_rng = np.random.Generator(np.random.SFC64(5))
    dt, steps = 0.01, 60_000
    activity = spells(config, np.random.Generator(np.random.SFC64(5)), steps, dt)
    force = forces(config, activity_rng, steps, dt)[:, 3]
    quiet = scipy.signal.lfilter(np.ones(400), [1.0], activity) == 0  # for 4 s: 40 time constants
    quiet[:400] = False
    change = np.abs(np.diff(force))
    assert change[quiet[1:]].max() < 1e-9 * 500
    assert np.ptp(force[quiet]) > 100


def test_while_people_move_the_load_forgets_as_stated(rng):
    """An Ornstein-Uhlenbeck process: variance and correlation after one load_s, within 5 sigma
    (its variance over a time T has the relative sigma sqrt(2 tau / T))."""
    tau, dt, steps = 2.0, 0.05, 1_000_000
    config = replace(
        STILL, quiet_s=0.0, spell_spread=0.0, load_nm=(500.0, 300.0),
        load_s=(tau, tau, tau), move_s=(1e-3, 1e-3, 1e-3),
    )  # fmt: skip
    force = forces(config, rng, steps, dt)
    sigma = np.sqrt(2 * tau / (steps * dt))
    lag = round(tau / dt)
    for i, size in ((3, 500.0), (4, 300.0)):
        x = force[:, i] / size
        assert abs(np.mean(x**2) - 1) < 5 * sigma
        assert abs(np.mean(x[lag:] * x[:-lag]) - np.exp(-1)) < 5 * sigma


def test_weight_in_front_of_the_springs_pitches_the_nose_down(rng):
    config = replace(STILL, load_n=400.0, load_forward_m=0.7)
    force = forces(config, rng, 10_000, 0.01)
    np.testing.assert_allclose(force[:, 4], -0.7 * force[:, 2], rtol=1e-12)
    assert np.all(force[:, [0, 1, 3, 5]] == 0)


@pytest.mark.parametrize(
    ("part", "corner", "order"), [("agitation", "agitation_hz", 2), ("wind", "wind_hz", 1)]
)
def test_noise_has_the_stated_size_and_corner(rng, part, corner, order):
    """Rms within 5 sigma of sqrt(1 / (4 B T)), B its bandwidth; half the power at the corner."""
    dt, steps, hz = 0.02, 500_000, 2.0
    always = replace(STILL, quiet_s=0.0, spell_spread=0.0)
    config = replace(always, **{f"{part}_n": 7.0, f"{part}_nm": 3.0, corner: hz})
    force = forces(config, rng, steps, dt)
    rms = np.sqrt(np.mean(force**2, axis=0)) / [7.0, 7.0, 7.0, 3.0, 3.0, 3.0]
    assert np.abs(rms - 1).max() < 5 / np.sqrt(4 * hz * steps * dt)
    f, psd = scipy.signal.welch(force / force.std(axis=0), 1 / dt, nperseg=500, axis=0)
    psd = psd.mean(axis=1)  # of six times 2000 overlapping pieces: 1%
    flat = psd[(f > 0.05 * hz) & (f < 0.3 * hz)].mean()
    at_corner = psd[np.argmin(np.abs(f - hz))]
    expected = {1: 0.5 * (1 + 0.3**2 / 3), 2: 0.5}[order]  # the first order's flat is not quite
    assert at_corner / flat == pytest.approx(expected, rel=0.06)


def test_forces_follow_from_their_generator_alone():
    draw = [forces(SWAY, np.random.Generator(np.random.SFC64(s)), 5000, 0.01) for s in (1, 1, 2)]
    np.testing.assert_array_equal(draw[0], draw[1])
    assert np.abs(draw[0] - draw[2]).max() > 1


def on_springs(**changes: object) -> mujoco.MjModel:
    return load(SceneConfig(sway=replace(SWAY, **changes)), G)


def test_without_sway_the_model_is_a_single_hinge():
    model = load(SceneConfig(), G)
    assert (model.nv, model.nu) == (1, 2)
    assert model.joint("azimuth").id == 0
    assert (on_springs().nv, on_springs().nu) == (7, 8)


def test_each_joint_alone_swings_at_its_frequency_and_damping():
    model = on_springs()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    for name, f, zeta in zip(JOINTS, SWAY.frequency_hz, SWAY.damping_ratio, strict=True):
        i, joint = model.joint(name).dofadr[0], model.joint(name)
        w = np.sqrt(joint.stiffness[0] / mass[i, i])
        assert w / (2 * np.pi) == pytest.approx(f)
        assert joint.damping[0] / (2 * mass[i, i] * w) == pytest.approx(zeta)


def test_sway_and_roll_couple_into_two_modes():
    """Let go in a mode of the plane problem, with y + h phi the centre of mass's way to the right,

        [[m, m h], [m h, I + m h^2]] q'' + diag(m w_y^2, (I + m h^2) w_phi^2) q = 0,

    the model is back after ten periods. The vehicle is so heavy that the table does not matter.
    """
    m, inertia, h = 1e6, 4e5, 0.6
    model = on_springs(
        mass_kg=m, inertia_kg_m2=(inertia, 1e6, 1e6), com_height_m=h - 0.4, roll_axis_height_m=-0.4,
        roll_axis_slope_deg=0.0, damping_ratio=(0.0,) * 6,
    )  # fmt: skip
    mass = np.array([[m, m * h], [m * h, inertia + m * h**2]])
    w = 2 * np.pi * np.array(SWAY.frequency_hz)[[1, 3]]
    values, modes = np.linalg.eig(np.linalg.solve(mass, np.diag(np.diag(mass) * w**2)))
    for value, mode in zip(values, modes.T, strict=True):
        data = mujoco.MjData(model)
        data.joint("sway").qpos[0], data.joint("roll").qpos[0] = start = 1e-5 * mode
        steps = round(10 * 2 * np.pi / np.sqrt(value) / model.opt.timestep)
        mujoco.mj_step(model, data, nstep=steps)
        now = [data.joint("sway").qpos[0], data.joint("roll").qpos[0]]
        np.testing.assert_allclose(now, start, atol=2e-7)


def test_the_vehicle_does_not_sag():
    model = on_springs()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1200)
    assert np.abs(data.qpos).max() < 1e-12
    np.testing.assert_allclose(data.sensor("test_accel").data, [0, 0, -G], atol=1e-9)


def test_the_vehicle_heads_where_the_test_module_looks():
    """So each joint moves it as its name says: forward, right, down; roll, pitch, yaw."""
    model = on_springs(roll_axis_slope_deg=0.0)

    def pose(**joints: float) -> tuple[np.ndarray, np.ndarray]:
        data = mujoco.MjData(model)
        for name, value in joints.items():
            data.joint(name).qpos[0] = value
        mujoco.mj_kinematics(model, data)
        site = data.site("test")
        return NED_FROM_NWU @ site.xpos, NED_FROM_NWU @ site.xmat.reshape(3, 3)

    origin, c_nb = pose()
    for axis, name in enumerate(("surge", "sway", "heave")):
        moved, _ = pose(**{name: 0.1})
        np.testing.assert_allclose(c_nb.T @ (moved - origin), 0.1 * np.eye(3)[axis], atol=1e-12)
    _, turned = pose(roll=0.01, pitch=0.02, yaw=0.03)
    relative = matrix_to_euler(c_nb.T @ turned)
    np.testing.assert_allclose(relative, [0.01, 0.02, 0.03], atol=1e-12)


def test_the_roll_axis_points_down_in_front():
    """Rolling to the right then turns the nose to the right as well."""
    data = mujoco.MjData(on_springs(roll_axis_slope_deg=5.0))
    data.joint("roll").qpos[0] = 1e-6
    mujoco.mj_forward(data.model, data)
    turned = NED_FROM_NWU @ data.site("test").xmat.reshape(3, 3)
    roll, _, yaw = matrix_to_euler(np.diag([-1.0, -1.0, 1.0]) @ turned)
    assert yaw / roll == pytest.approx(np.tan(np.deg2rad(5.0)), rel=1e-6)


_FORCES = {"load_n", "load_nm", "load_forward_m", "load_s", "move_s", "agitation_n", "agitation_nm",
           "agitation_hz", "wind_n", "wind_nm", "wind_hz", "restlessness", "quiet_s", "spell_s",
           "regularity", "spell_spread"}  # fmt: skip


@pytest.mark.parametrize("field", [f.name for f in fields(SwayConfig) if f.name != "level"])
def test_every_parameter_changes_the_forces_or_the_springs(field):
    value = getattr(SWAY, field)
    changed = {field: tuple(1.1 * v for v in value) if isinstance(value, tuple) else 1.1 * value}
    if field in _FORCES:
        draws = [
            forces(replace(SWAY, **c), np.random.Generator(np.random.SFC64(3)), 20_000, 0.01)
            for c in ({}, changed)
        ]
        assert np.abs(draws[0] - draws[1]).max() > 1e-3
        return
    pushed = []
    for model in (on_springs(), on_springs(**changed)):
        data = mujoco.MjData(model)
        for name in JOINTS:
            data.actuator(name).ctrl[0] = 100.0
        mujoco.mj_step(model, data, nstep=300)
        pushed.append(data.qpos.copy())
    assert np.abs(pushed[0] - pushed[1]).max() > 1e-7


def test_the_vehicle_scene_says_every_figure():
    scene = default_config("scene=vehicle").scene
    assert scene.sway == SWAY
    assert not default_config().scene.sway.present


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"level": -1.0}, "level = -1.0: must be 0 or more"),
        ({"level": (2.0, 1.0)}, r"must be a number, or \[low, high\]"),
        ({"level": ()}, "level"),
        ({"level": (0.0, 1.0, 2.0)}, "level"),
        ({"mass_kg": 0.0}, "mass_kg = 0.0 kg: must be greater than zero"),
        ({"inertia_kg_m2": (1.0, 1.0, 3.0)}, "has one above the others' sum"),
        ({"inertia_kg_m2": (1.0, 1.0)}, "must be 3 numbers"),
        ({"frequency_hz": (1.0,) * 5}, "must be 6 numbers"),
        ({"frequency_hz": (1.0,) * 5 + (0.0,)}, "frequency_hz = 0.0 Hz"),
        ({"damping_ratio": (-0.1,) * 6}, "must not be negative"),
        ({"load_nm": (1.0,)}, "must be 2 numbers"),
        ({"load_n": -1.0}, "load_n = -1.0 N: must not be negative"),
        ({"move_s": (0.1, 0.0, 0.1)}, "move_s = 0.0 s"),
        ({"regularity": 0.0}, "regularity"),
        ({"quiet_s": -1.0}, "quiet_s = -1.0 s"),
    ],
)
def test_impossible_vehicles_are_refused(changes, says):
    with pytest.raises(InputError, match=says):
        replace(SWAY, **changes)


def test_a_corner_that_the_steps_cannot_hold_is_refused(rng):
    with pytest.raises(InputError, match=r"wind_hz = 60\.0 Hz: must be below 50"):
        forces(replace(SWAY, wind_hz=60.0), rng, 100, 0.01)
