"""Execution of a plan in MuJoCo: the pose of the test module at every physics step.

Where the base is rigid, only the stretches in which the plate moves are stepped; where it sways,
the whole recording is.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import mujoco
import numpy as np
from mujoco import rollout

from lbgc.errors import InputError
from lbgc.frames import NED_FROM_NWU
from lbgc.protocol import REST, SETTLE, SLEW, Move, Plan

from .kinematics import joined
from .poses import Bench, Executed, Poses, Stretch, lean_of_axis
from .sway import JOINTS, SwayConfig
from .turntable import SceneConfig, load, out_of_balance, plate_inertia

SETTLED_RATE = 1e-13
"""Rate below which a plate is taken to be exactly at rest, rad/s. Earth's rate is 7e-5."""
_RESTING_RATE = 2e-13
"""Rate below which the stage is `rest`, rad/s; with the rounding of the angle it is 1e-12."""
_LONGEST_SETTLING_S = 60.0
"""Time after the last move in which a plate must come to rest, s."""
_CHUNK_S = 0.5
"""Physics between two tests of whether the plate is at rest, s."""
_BLOCK_S = 5.0
"""Physics of a swaying base that is stepped in one go, s."""
_SWAY_LEAD_S = 20.0
"""Physics before a recording, with the plate held, in which a suspension forgets its start: e^-12
at 2 Hz and a damping ratio of 5%, s."""


@lru_cache(maxsize=4)  # few are kept, since a carousel's poses are tens of megabytes
def execute(bench: Bench, gravity: float, plan: Plan) -> Executed:
    """Drive the plate through a plan on a rigid base. gravity : m/s^2.

    Raises InputError where the servo has too little torque for the plan, or the plate does not come
    to rest.
    """
    check_servo(bench.scene, plan, bench.axis)
    settling = 0.0
    if plan.before:
        move = Move(0.0, plan.before, plan.rate, plan.acceleration)
        settling = _settling(bench.scene, gravity, move)
    stretches: list[Stretch] = []
    at, stands = 0, plan.start
    for move in plan.moves:
        first = int(move.start_s * bench.rate_hz + 1e-6)
        if first >= bench.samples:
            break
        if first < at:  # it began before the last move had settled, and was driven with that one
            continue
        if first > at:
            stretches.append(_rest(bench, gravity, stands, at, first - at))
        stretches.append(_drive(bench, gravity, plan, stands, first))
        at = first + stretches[-1].samples
        stands = float(stretches[-1].poses.angle[-1])
    if at < bench.samples:
        stretches.append(_rest(bench, gravity, stands, at, bench.samples - at))
    control = _sensed(bench.scene, gravity, plan.start, bench.axis)[1]
    return Executed(bench, tuple(stretches), control, settling)


@lru_cache(maxsize=512)
def execute_resting(bench: Bench, gravity: float, plan: Plan) -> Executed:
    """Execute a plan without moves. The result is a single pose, so that many are kept."""
    return execute(bench, gravity, plan)


@lru_cache(maxsize=4096)
def _sensed(
    scene: SceneConfig, gravity: float, angle: float, axis: int
) -> tuple[Poses, np.ndarray]:
    """The test module's pose and the control module's attitude with the plate at rest at this
    angle, rad, about this axis."""
    model = load(scene, gravity, axis)
    data = mujoco.MjData(model)
    data.joint("azimuth").qpos[0] = angle
    mujoco.mj_forward(model, data)
    sensors = np.asarray(data.sensordata)
    return _poses(model, sensors[None]), _control(scene, model, sensors, axis)


def _rest(bench: Bench, gravity: float, angle: float, first: int, samples: int) -> Stretch:
    """A stretch of samples in which the plate is at rest at this angle, rad."""
    poses, _ = _sensed(bench.scene, gravity, angle, bench.axis)
    return Stretch(first, samples, poses, np.broadcast_to(np.int8(REST), samples))


def _drive(bench: Bench, gravity: float, plan: Plan, stands: float, first: int) -> Stretch:
    """The stretch that begins at sample `first`, with the plate at rest at the angle `stands`, rad,
    and lasts until the plate is at rest again and nothing is commanded, or the recording ends."""
    model = load(bench.scene, gravity, bench.axis)
    state, pool = _state(model, stands), data_for(model, 1)
    chunk = max(1, round(_CHUNK_S * bench.rate_hz))
    parts, stages, at, settled = [], [], first, False
    while at < bench.samples and not settled:
        count = min(chunk, bench.samples - at)
        control = _servo(model, bench, plan, at * bench.steps, count * bench.steps)
        states, sensors = roll([model], [state], control[None], pool)
        state = states[0, -1]
        speed = np.abs(states[0, :, 1 + model.nq + int(model.joint("azimuth").dofadr[0])])
        driven = (control[:, model.actuator("servo_rate").id] != 0).reshape(count, -1).any(axis=1)
        slow = speed.reshape(count, -1).max(axis=1) < _RESTING_RATE
        still = not driven.any() and _stands_still(_angles(model, states[0]))
        parts.append(sensors[0])
        stages.append(np.where(driven, SLEW, np.where(slow | still, REST, SETTLE)).astype(np.int8))
        at += count
        settled = still or (bool(speed[-2:].max() < SETTLED_RATE) and not driven[-1])
        since = at / bench.rate_hz - max(
            m.end_s for m in plan.moves if m.start_s < at / bench.rate_hz
        )
        if not settled and since > _LONGEST_SETTLING_S:
            raise InputError(
                "scene.servo_damping_nm_s_per_rad",
                bench.scene.servo_damping_nm_s_per_rad,
                "N m s/rad",
                f"the plate still moves at {speed.max():.1e} rad/s after "
                f"{_LONGEST_SETTLING_S:.0f} s; damp the servo or the bearing more",
            )
    # Sensors are one step old, so two more steps give the end and the instant after it.
    _, after = roll([model], [state], _servo(model, bench, plan, at * bench.steps, 2)[None], pool)
    sensors = np.concatenate([parts[0][:1], *parts, after[0]])
    return Stretch(first, at - first, _poses(model, sensors), np.concatenate(stages))


def _angles(model: mujoco.MjModel, states: np.ndarray) -> np.ndarray:
    """The hinge's angle after each step, (n,) rad, from the states (n, s)."""
    return states[:, 1 + int(model.joint("azimuth").qposadr[0])]


def _stands_still(angles: np.ndarray) -> bool:
    """Whether the angles of a chunk are equal to rounding. A velocity of less than half the angle's
    last bit a step no longer changes the angle, and the servo then has nothing to correct: at 5 rad
    and 1200 steps a second a velocity of 5e-13 rad/s stays for ever."""
    return bool(np.ptp(angles) <= 2 * np.spacing(np.abs(angles).max()))


@lru_cache(maxsize=16)
def _settling(scene: SceneConfig, gravity: float, move: Move) -> float:
    """How long a slew from rest moves the plate, settling included, s."""
    rate = scene.physics_hz / max(1, round(scene.physics_hz / 100))
    bench = Bench(scene, rate, int((move.duration_s + _LONGEST_SETTLING_S + 2) * rate))
    slew = Plan(0.0, 0.0, 0.0, move.rate, move.acceleration, (move,))
    return _drive(bench, gravity, slew, 0.0, 0).samples / rate


def check_servo(scene: SceneConfig, plan: Plan, axis: int) -> None:
    """Raise InputError where a slew needs more torque than the servo has. It needs the inertia
    times the acceleration, the torque of the bearing at the highest rate, and about a level axis
    that of gravity on what is out of balance."""
    moves = plan.moves
    if plan.before:
        moves = (*moves, Move(0.0, plan.before, plan.rate, plan.acceleration))
    inertia, held = _load(scene, axis)
    for move in moves:
        drag = held + scene.bearing_friction_nm + scene.bearing_damping_nm_s_per_rad * move.rate
        needed, torque = inertia * move.acceleration + drag, scene.servo_torque_nm
        if needed > torque:
            could = "the load alone takes more at that rate: slew slower"
            if drag < torque:
                could = f"it can do {np.rad2deg((torque - drag) / inertia):.3g} deg/s2 at that rate"
            raise InputError(
                "protocol.slew_deg_per_s2",
                round(float(np.rad2deg(move.acceleration)), 6),
                "deg/s2",
                f"needs {needed:.3g} N m, and the servo gives {torque:g} (scene.servo_torque_nm); "
                f"{could}",
            )


@lru_cache(maxsize=8)
def _load(scene: SceneConfig, axis: int) -> tuple[float, float]:
    """The plate's moment of inertia on a rigid base, kg m^2, and the largest torque of gravity on
    it, N m."""
    model = load(replace(scene, sway=SwayConfig()), 9.8, axis)
    return plate_inertia(model), out_of_balance(model)


def execute_swaying(
    bench: Bench,
    gravity: float,
    plans: Sequence[Plan],
    levels: Sequence[np.ndarray],
    forces: Sequence[np.ndarray],
    threads: int,
) -> list[Executed]:
    """Execute the plans of several recordings on a base that sways under these forces. No result
    depends on the number of recordings or of threads.

    gravity : m/s^2; levels : (3, 3) each, attitude of the table in the vehicle, both
    forward-right-down; forces : (steps, 6) each, N and N m, on the joints of `sim.sway.JOINTS`,
    from `lead_steps` before the recording to two steps after it.
    """
    model = load(bench.scene, gravity, bench.axis)
    pool = data_for(model, min(threads, len(plans)))
    models = [_with_level(model, level) for level in levels]
    lead, total = lead_steps(bench), len(forces[0])
    rigid = replace(bench, scene=replace(bench.scene, sway=SwayConfig()))
    still = [execute(rigid, gravity, p) for p in plans]
    states = [_loaded(own, p.start, f[0]) for own, p, f in zip(models, plans, forces, strict=True)]
    motors = [model.actuator(name).id for name in JOINTS]
    size = round(_BLOCK_S * bench.scene.physics_hz)
    parts: list[list[Poses]] = [[] for _ in plans]
    controls: list[np.ndarray] = []
    for begin in range(0, total, size):
        count = min(size, total - begin)
        control = np.stack([_servo(model, bench, p, begin - lead, count) for p in plans])
        for own, force in zip(control, forces, strict=True):
            own[:, motors] = force[begin : begin + count]
        after, sensors = roll(models, states, control, pool)
        states = list(after[:, -1])
        for own, sensed in zip(parts, sensors, strict=True):
            own.append(_poses(model, sensed[max(lead - 1 - begin, 0) :]))
        if begin <= lead < begin + count:
            at_start = [sensed[lead - begin] for sensed in sensors]
            controls = [_control(bench.scene, model, own, bench.axis) for own in at_start]
    return [
        Executed(bench, (Stretch(0, bench.samples, joined(own), rest.stage),), at, rest.settling_s)
        for own, rest, at in zip(parts, still, controls, strict=True)
    ]


def _with_level(model: mujoco.MjModel, level: np.ndarray) -> mujoco.MjModel:
    """The model with its table at this attitude (3, 3) in the vehicle."""
    own = copy.copy(model)
    turned = NED_FROM_NWU @ level @ NED_FROM_NWU
    mujoco.mju_mat2Quat(own.body("base").quat, turned.ravel())
    return own


def _loaded(model: mujoco.MjModel, angle: float, forces: np.ndarray) -> np.ndarray:
    """The state at rest in which the springs balance these forces (6,), since loads last for
    minutes, with the plate at this angle, rad."""
    data = mujoco.MjData(model)
    for name, force in zip(JOINTS, forces, strict=True):
        data.joint(name).qpos[0] = force / model.joint(name).stiffness[0]
    data.joint("azimuth").qpos[0] = angle
    return _full_state(model, data)


def lead_steps(bench: Bench) -> int:
    """The number of physics steps that a swaying base is stepped before a recording starts."""
    return round(_SWAY_LEAD_S * bench.scene.physics_hz)


def roll(
    models: Sequence[mujoco.MjModel],
    states: Sequence[np.ndarray],
    control: np.ndarray,
    pool: Sequence[mujoco.MjData],
    control_is: int = int(mujoco.mjtState.mjSTATE_CTRL),
) -> tuple[np.ndarray, np.ndarray]:
    """Step r models with MuJoCo's rollout, each from its state (s,) under the control (r, n, nu),
    on as many threads as the pool has members. control_is : the part of MuJoCo's state that the
    control is.

    Returns the states after each step, (r, n, s), and the sensors before it, (r, n, sensors),
    because MuJoCo first senses and then steps.
    """
    return rollout.rollout(
        list(models),
        list(pool),
        np.stack(states),
        np.ascontiguousarray(control),
        control_spec=control_is,
    )


def data_for(model: mujoco.MjModel, threads: int) -> list[mujoco.MjData]:
    """A pool for `roll` with one member a thread. Making it takes as long as half a second of
    physics."""
    return [mujoco.MjData(model) for _ in range(threads)]


def _servo(model: mujoco.MjModel, bench: Bench, plan: Plan, first: int, count: int) -> np.ndarray:
    """The plan's commands to the servo at the starts of `count` physics steps from step `first` on:
    (count, nu)."""
    angle, rate = plan.command((first + np.arange(count)) * bench.step)
    control = np.zeros((count, model.nu))
    control[:, model.actuator("servo").id] = angle
    control[:, model.actuator("servo_rate").id] = rate
    return control


def _state(model: mujoco.MjModel, angle: float) -> np.ndarray:
    """The state at rest with the plate at this angle, rad."""
    data = mujoco.MjData(model)
    data.joint("azimuth").qpos[0] = angle
    return _full_state(model, data)


def _full_state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """The full physics state of `data`, (s,), as `roll` needs it."""
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state


def _control(
    scene: SceneConfig, model: mujoco.MjModel, sensors: np.ndarray, axis: int
) -> np.ndarray:
    """The control module's attitude, (3, 3), from the sensors of one instant."""
    start = int(model.sensor("control_attitude").adr[0])
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, sensors[start : start + 4])
    angle = sensors[int(model.sensor("encoder").adr[0])]
    lean = lean_of_axis(scene, np.array([angle]), axis)[0]
    return lean @ NED_FROM_NWU @ matrix.reshape(3, 3)


def _poses(model: mujoco.MjModel, sensors: np.ndarray) -> Poses:
    """The test module's poses from the sensors at m instants, (m, sensors)."""

    def read(name: str) -> np.ndarray:
        sensor = model.sensor(name)
        return sensors[:, int(sensor.adr[0]) : int(sensor.adr[0] + sensor.dim[0])].copy()

    return Poses(read("test_attitude"), read("test_position"), read("encoder")[:, 0])
