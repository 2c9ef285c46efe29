"""Executes a plan with physics: what the modules' sites really feel.

Earth's rate is added here, since MuJoCo's world does not rotate. The world is the same in every
azimuth, so the base's azimuth is a rotation applied afterwards, exactly, and a settled pose serves
every recording that rests in it.
"""

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.frames import NED_FROM_NWU, matrix_to_euler, rotation_z
from lbgc.protocol import Plan
from sim.scene import SceneConfig, load

SETTLED_RATE = 1e-13
"""rad/s: below it a plate rests. Earth's rate is 7e-5."""
_LONGEST_SETTLING_S = 60.0
_STRIDE = 64  # physics steps between looks at whether it rests


@dataclass(frozen=True)
class Rest:
    """A resting recording's truth: constants of its whole duration."""

    omega_ib_b: np.ndarray  # (3,), rad/s, of the test module
    f_ib_b: np.ndarray  # (3,), m/s^2
    heading: float  # rad, of the test module
    heading_control: float  # rad, of the control module
    roll: float
    pitch: float
    settling_s: float


@dataclass(frozen=True)
class _Pose:
    """A settled pose with the base pointing north: C_nb of both modules."""

    test: np.ndarray  # (3, 3)
    control: np.ndarray  # (3, 3)
    settling_s: float


def rest(scene: SceneConfig, plan: Plan, latitude: float, azimuth: float) -> Rest:
    """Drive the plate to its target, wait until it rests, and read what the test module feels.

    latitude, azimuth (of the base) : rad. Raises InputError where the plate does not come to rest.
    """
    gravity = normal_gravity(latitude)
    pose = _settle(scene, gravity, plan.start, plan.target)
    c_nb = rotation_z(azimuth) @ pose.test
    roll, pitch, heading = matrix_to_euler(c_nb)
    return Rest(
        omega_ib_b=c_nb.T @ earth_rate_ned(latitude),
        f_ib_b=c_nb.T @ (NED_FROM_NWU @ -load(scene, gravity).opt.gravity),
        heading=float(heading),
        heading_control=float(matrix_to_euler(rotation_z(azimuth) @ pose.control)[2]),
        roll=float(roll),
        pitch=float(pitch),
        settling_s=pose.settling_s,
    )


@lru_cache(maxsize=4096)
def _settle(scene: SceneConfig, gravity: float, start: float, target: float) -> _Pose:
    model = load(scene, gravity)
    data = mujoco.MjData(model)
    joint = data.joint("azimuth")
    joint.qpos[0] = start
    data.actuator("servo").ctrl[0] = target
    # Twice running: a plate that turns round passes through zero rate once without resting.
    quiet = 0
    while quiet < 2:
        mujoco.mj_step(model, data, nstep=_STRIDE)
        quiet = quiet + 1 if abs(joint.qvel[0]) < SETTLED_RATE else 0
        if data.time > _LONGEST_SETTLING_S:
            raise InputError(
                "scene.servo_damping_nm_s_per_rad",
                scene.servo_damping_nm_s_per_rad,
                "N m s/rad",
                f"the plate still moves at {abs(joint.qvel[0]):.1e} rad/s after "
                f"{_LONGEST_SETTLING_S:.0f} s; damp the servo or the bearing more",
            )
    settling = float(data.time)
    joint.qvel[0] = 0.0
    mujoco.mj_forward(model, data)
    return _Pose(_attitude(data, "test"), _attitude(data, "control"), settling)


def _attitude(data: mujoco.MjData, module: str) -> np.ndarray:
    """C_nb of a module, from its orientation sensor."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, data.sensor(f"{module}_attitude").data)
    return NED_FROM_NWU @ matrix.reshape(3, 3)
