"""Execution of a tumble in MuJoCo: the pose of an IMU that a hand holds, at every physics step in
which it moves."""

from dataclasses import replace
from functools import lru_cache

import mujoco
import numpy as np

from lbgc.errors import InputError, require
from lbgc.frames import rotation_z
from lbgc.protocol import REST, SETTLE, SLEW, Handling, Plan

from . import hand
from .hand import Course
from .physics import data_for, roll
from .poses import Bench, Executed, Poses, Stretch
from .turntable import SceneConfig

_COMMAND = int(mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT)
_SETTLED = 1e-12
"""Rate and speed below which the IMU is taken to be exactly at rest, rad/s and m/s: springs and
dampers in equilibrium keep a velocity of up to 2e-13 that is too small to change a pose."""
_LONGEST_SETTLING_S = 60.0
"""Time after a move in which the IMU must come to rest, s."""
_CHUNK_S = 0.5
"""Physics between two tests of whether the IMU is at rest, s."""


def check(scene: SceneConfig, plan: Plan) -> None:
    """Raise InputError where a hand would hold the IMU on a vehicle that sways."""
    free = plan.handling is None or not scene.sway.present
    about = "must be 0 with protocol=tumble: a hand that holds an IMU is on no vehicle here"
    require(free, "scene.sway.level", scene.sway.level, about)


@lru_cache(maxsize=4)
def execute(bench: Bench, gravity: float, plan: Plan) -> Executed:
    """Carry an IMU through the attitudes of a plan. gravity : m/s^2.

    Raises InputError where the IMU does not come to rest.
    """
    handling = plan.handling
    assert handling is not None
    assert handling.attitudes, "the recording's attitudes are drawn before"
    own = bench.scene.hand
    model = hand.load(own, bench.scene.physics_hz, gravity)
    course = Course(handling, own, hand.grip(model))
    state = hand.state(model, course.at(np.zeros(1))[0])
    resting, stretches, at = _sensed(model, state), list[Stretch](), 0
    for start in handling.starts_s:
        first = int(start * bench.rate_hz + 1e-6)
        if first >= bench.samples:
            break
        if first < at:  # it began before the last move had settled, and was done with that one
            continue
        if first > at:
            stretches.append(_rest(resting, at, first - at))
        moved, state = _carry(bench, model, course, handling, state, first)
        stretches.append(moved)
        at, resting = first + moved.samples, moved.poses[-2:-1]
    if at < bench.samples:
        stretches.append(_rest(resting, at, bench.samples - at))
    found = Executed(bench, tuple(stretches), np.eye(3), 0.0, held=True)
    # The instrument that reads its heading looks the other way, as a turntable's control module.
    return replace(found, control=rotation_z(np.pi) @ found.start)


def _rest(pose: Poses, first: int, samples: int) -> Stretch:
    """A stretch of samples in which the IMU is at rest in this pose."""
    return Stretch(first, samples, pose, np.broadcast_to(np.int8(REST), samples))


def _carry(
    bench: Bench,
    model: mujoco.MjModel,
    course: Course,
    handling: Handling,
    state: np.ndarray,
    first: int,
) -> tuple[Stretch, np.ndarray]:
    """The stretch that begins at sample `first` with the IMU at rest in this state, (s,), and lasts
    until it is at rest again and no move is on, or the recording ends; and the state then."""
    starts, pool = np.array(handling.starts_s), data_for(model, 1)
    chunk = max(1, round(_CHUNK_S * bench.rate_hz))
    parts, stages, at, settled = [], [], first, False
    while at < bench.samples and not settled:
        count = min(chunk, bench.samples - at)
        t = (at * bench.steps + np.arange(count * bench.steps)) * bench.step
        states, sensors = roll([model], [state], course.at(t)[None], pool, _COMMAND)
        state = states[0, -1]
        since = t[:, None] - starts
        on = ((since >= 0) & (since < handling.duration_s)).any(axis=1).reshape(count, -1)
        speed = np.abs(states[0, :, 1 + model.nq : 1 + model.nq + model.nv]).max(axis=1)
        still = speed.reshape(count, -1).max(axis=1) < _SETTLED
        driven = on.any(axis=1)
        parts.append(sensors[0])
        stages.append(np.where(driven, SLEW, np.where(still, REST, SETTLE)).astype(np.int8))
        at += count
        settled = bool(still[-1]) and not driven[-1]
        over = at / bench.rate_hz - starts[starts < at / bench.rate_hz].max() - handling.duration_s
        if not settled and over > _LONGEST_SETTLING_S:
            raise InputError(
                "scene.hand.damping_ratio", bench.scene.hand.damping_ratio, "", f"the IMU still "
                f"moves at {speed[-1]:.1e} after {_LONGEST_SETTLING_S:.0f} s; damp it more"
            )  # fmt: skip
    # Sensors are one step old, so two more steps give the end and the instant after it.
    t = (at * bench.steps + np.arange(2)) * bench.step
    _, after = roll([model], [state], course.at(t)[None], pool, _COMMAND)
    sensors = np.concatenate([parts[0][:1], *parts, after[0]])
    return Stretch(first, at - first, _poses(model, sensors), np.concatenate(stages)), state


def _sensed(model: mujoco.MjModel, state: np.ndarray) -> Poses:
    """The IMU's pose in a state of rest, (s,)."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.mj_forward(model, data)
    return _poses(model, np.array(data.sensordata)[None])


def _poses(model: mujoco.MjModel, sensors: np.ndarray) -> Poses:
    """The IMU's poses from the sensors at m instants, (m, sensors). No plate turns."""

    def read(name: str) -> np.ndarray:
        sensor = model.sensor(name)
        return sensors[:, int(sensor.adr[0]) : int(sensor.adr[0] + sensor.dim[0])].copy()

    return Poses(read("attitude"), read("position"), np.zeros(len(sensors)))
