"""A hand that holds an IMU at rest above a table in one attitude after the other: its MuJoCo model,
which is built in this file only, and the course that it is told. `sim/held.py` executes it."""

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from lbgc.errors import require_not_negative, require_positive

from . import opengl

opengl.settle()

import mujoco  # noqa: E402
import numpy as np  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402

from lbgc.frames import NED_FROM_NWU, euler_to_matrix  # noqa: E402
from lbgc.protocol import Handling  # noqa: E402

XML = Path(__file__).with_name("tumble.xml")
_ABOVE = np.array([0.0, 0.0, 0.53])
"""Where the IMU is held, m, North-West-Up: above the table."""


@dataclass(frozen=True)
class HandConfig:
    """How a hand holds an IMU, with protocol=tumble: springs and dampers between both, in six
    directions."""

    frequency_hz: float = 5.0
    """Frequency of the IMU on the hand's springs, in translation and in rotation."""
    damping_ratio: float = 1.0
    """Their damping ratio."""
    lift_m: float = 0.15
    """Height by which the hand lifts the IMU from one attitude to the next."""

    def __post_init__(self) -> None:
        require_positive("frequency_hz", self.frequency_hz)
        require_positive("damping_ratio", self.damping_ratio)
        require_not_negative(self, "lift_m")


@lru_cache(maxsize=8)
def load(hand: HandConfig, physics_hz: float, gravity: float) -> mujoco.MjModel:
    """The compiled MuJoCo model. gravity : m/s^2, down."""
    spec = mujoco.MjSpec.from_file(str(XML))
    spec.option.timestep = 1.0 / physics_hz
    spec.option.gravity = [0.0, 0.0, -gravity]
    model = spec.compile()
    w = 2 * math.pi * hand.frequency_hz
    for number, own in enumerate(_inertia(model)):
        stiffness, damping = own * w**2, 2 * hand.damping_ratio * own * w
        model.actuator_gainprm[number, 0] = stiffness
        model.actuator_biasprm[number, :3] = [0.0, -stiffness, -damping]
    return model


def _inertia(model: mujoco.MjModel) -> list[float]:
    """The IMU's mass, three times, and its moments of inertia about its axes: as the free joint has
    them."""
    data, found = mujoco.MjData(model), np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, found)
    return [float(own) for own in np.diag(found)]


def grip(model: mujoco.MjModel) -> np.ndarray:
    """Where the hand holds the IMU, in the IMU's axes, (3,), m."""
    return np.array(model.site("grip").pos)


class Course:
    """Where the hand is at any time of a recording, and how it is turned."""

    def __init__(self, handling: Handling, hand: HandConfig, grip: np.ndarray):
        angles = np.array(handling.attitudes)
        self._attitudes = _turned(euler_to_matrix(*angles.T))
        turns = self._attitudes[:-1].inv() * self._attitudes[1:]
        self._turns = turns.as_rotvec()  # (P - 1, 3), in the body
        self._starts = np.array(handling.starts_s)
        self._lasts, self._lift, self._grip = handling.duration_s, hand.lift_m, grip

    def at(self, t: np.ndarray) -> np.ndarray:
        """The hand's place (m, North-West-Up) and quaternion (w first) at times t (n,), s: (n, 7).

        It turns about one axis from each attitude to the next, by the share 10 s^3 - 15 s^4 + 6 s^5
        of the turn, and lifts the IMU meanwhile; the grip is where it holds the IMU.
        """
        move = np.clip(np.searchsorted(self._starts, t, side="right") - 1, 0, None)
        s = np.clip((t - self._starts[move]) / self._lasts, 0.0, 1.0)
        share = s**3 * (10 + s * (6 * s - 15))
        turned = self._attitudes[move] * Rotation.from_rotvec(share[:, None] * self._turns[move])
        found = _reaching(turned, self._grip)
        found[:, 2] += self._lift * 4 * share * (1 - share)
        return found


def _turned(attitude: np.ndarray) -> Rotation:
    """Attitudes C_nb, (*S, 3, 3), as rotations to North-West-Up."""
    return Rotation.from_matrix(NED_FROM_NWU @ attitude)


def _reaching(turned: Rotation, grip: np.ndarray) -> np.ndarray:
    """The hand's place and quaternion, (*S, 7), with the IMU above the table in these rotations."""
    quaternion = turned.as_quat()[..., [3, 0, 1, 2]]
    return np.concatenate([_ABOVE + turned.apply(grip), quaternion], axis=-1)


def reaching(attitude: np.ndarray, grip: np.ndarray) -> np.ndarray:
    """The hand's pose, (7,), with the IMU above the table in an attitude C_nb (3, 3)."""
    return _reaching(_turned(attitude), grip)


def state(model: mujoco.MjModel, hand: np.ndarray) -> np.ndarray:
    """The full physics state, (s,), of the IMU at rest in the hand. hand : (7,), its pose."""
    data = mujoco.MjData(model)
    data.qpos[:] = at_rest(model, hand)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    found = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, found, kind)
    return found


def at_rest(model: mujoco.MjModel, hand: np.ndarray) -> np.ndarray:
    """The IMU's place and quaternion, (7,), where it is at rest in the hand."""
    turned = Rotation.from_quat(hand[[4, 5, 6, 3]])
    return np.concatenate([hand[:3] - turned.apply(grip(model)), hand[3:]])
