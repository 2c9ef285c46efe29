"""The turntable's MuJoCo model, which is built in this file only. `sim/render.py` shows it."""

import math
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from lbgc.errors import require, require_not_negative, require_positive
from lbgc.frames import DOWN

from . import opengl
from .disturbance import FloorConfig
from .hand import HandConfig
from .sway import JOINTS, SwayConfig

opengl.settle()

import mujoco  # noqa: E402
import numpy as np  # noqa: E402

XML = Path(__file__).with_name("turntable.xml")


@dataclass(frozen=True)
class SceneConfig:
    """The bench's configuration, which `conf/scene/*.yaml` holds. Its geometry is in
    `turntable.xml`."""

    physics_hz: float = 1200.0
    """Physics steps a second; the IMU's period must be a whole number of steps."""
    servo_stiffness_nm_per_rad: float = 60.0
    """Stiffness of the servo that drives the plate."""
    servo_damping_nm_s_per_rad: float = 9.0
    """Damping of the servo, which acts on the commanded rate less the plate's."""
    servo_torque_nm: float = 5.0
    """The largest torque that the servo can give."""
    bearing_damping_nm_s_per_rad: float = 0.05
    """Viscous damping of the plate's bearing."""
    bearing_friction_nm: float = 0.0
    """Dry friction of the bearing. Below a rate (rad/s) of twice the friction over the servo's
    damping it acts like viscous friction, half as large as that damping."""
    arm_m: float = 0.27
    """Distance from the plate's axis to either module."""
    base_azimuth_deg: float | None = None
    """Azimuth of the base; null: each recording draws its own, as its protocol has it."""
    base_roll_deg: float = 0.0
    """The base's roll, of z-y-x angles from north-east-down whose yaw is its azimuth."""
    base_pitch_deg: float = 0.0
    """The base's pitch, of the same z-y-x angles as its roll."""
    level_error_deg: float = 0.0
    """1 sigma of the base's levelling error in roll and in pitch, drawn anew for each recording."""
    axis_tilt_deg: float = 0.0
    """Tilt of the hinge axis relative to the base's vertical, to the right; of a level hinge, about
    the next axis of forward, right, down."""
    axis_wobble_arcsec: float = 0.0
    """Half angle of a cone that the hinge axis goes round twice in a turn of the plate."""
    encoder_lsb_arcsec: float | None = None
    """Count of the plate's encoder; null: it reads without rounding."""
    encoder_error_arcsec: float = 0.0
    """Amplitude of the encoder's error, which has the period of a turn (an eccentric disc)."""
    encoder_latency_s: float = 0.0
    """Age of the encoder's reading."""
    reference_error_deg: float = 0.2
    """1 sigma of the control module's heading error, drawn anew for each recording."""
    floor: FloorConfig = field(default_factory=FloorConfig)
    """What moves the floor."""
    sway: SwayConfig = field(default_factory=SwayConfig)
    """The vehicle on which the bench stands, if it sways."""
    hand: HandConfig = field(default_factory=HandConfig)
    """With protocol=tumble, the hand that holds the IMU; there is no turntable then."""

    def __post_init__(self) -> None:
        for name in (
            "physics_hz",
            "servo_stiffness_nm_per_rad",
            "servo_damping_nm_s_per_rad",
            "servo_torque_nm",
            "arm_m",
            "encoder_lsb_arcsec",
        ):
            require_positive(name, getattr(self, name))
        require_not_negative(
            self,
            "bearing_damping_nm_s_per_rad",
            "bearing_friction_nm",
            "level_error_deg",
            "axis_wobble_arcsec",
            "encoder_error_arcsec",
            "encoder_latency_s",
            "reference_error_deg",
        )
        require(self.arm_m <= 0.3, "arm_m", self.arm_m, "must be on the plate: 0.3 at most")
        for name in ("base_roll_deg", "base_pitch_deg", "axis_tilt_deg"):
            angle = getattr(self, name)
            require(abs(angle) <= 45, name, angle, "must be from -45 to 45")


_HINGE = ([-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0])
"""The axes of the test module, which looks south at plate angle zero, in North-West-Up."""


@lru_cache(maxsize=8)
def load(config: SceneConfig, gravity: float, axis: int = DOWN) -> mujoco.MjModel:
    """The compiled MuJoCo model of a bench. gravity : m/s^2, down; axis : of the test module, about
    which the plate turns."""
    spec = mujoco.MjSpec.from_file(str(XML))
    spec.option.timestep = 1.0 / config.physics_hz
    spec.option.gravity = [0.0, 0.0, -gravity]
    for module, side in (("control", 1.0), ("test", -1.0)):
        for part in (spec.geom(module), spec.site(module)):
            part.pos[0] = side * config.arm_m
    joint = spec.joint("azimuth")
    joint.axis = _HINGE[axis]
    if axis != DOWN:
        _on_trunnions(spec, axis)
    joint.damping[0] = config.bearing_damping_nm_s_per_rad
    joint.actfrclimited = True
    joint.actfrcrange = [-config.servo_torque_nm, config.servo_torque_nm]
    stiffness, damping = config.servo_stiffness_nm_per_rad, config.servo_damping_nm_s_per_rad
    spec.actuator("servo").gainprm[0] = stiffness
    spec.actuator("servo").biasprm[:3] = [0.0, -stiffness, 0.0]
    spec.actuator("servo_rate").gainprm[0] = damping
    spec.actuator("servo_rate").biasprm[:3] = [0.0, 0.0, -damping]
    if config.bearing_friction_nm > 0:
        _with_friction(spec, config.bearing_friction_nm, damping / 2)
    if config.sway.present:
        return _on_springs(spec, config.sway)
    for name in JOINTS:
        spec.delete(spec.actuator(name))
        spec.delete(spec.joint(name))
    return spec.compile()


def _on_trunnions(spec: mujoco.MjSpec, axis: int) -> None:
    """Hang the plate between two posts, high enough to turn over."""
    spec.delete(spec.geom("post"))
    plate, base, along = spec.body("plate"), spec.body("base"), np.array(_HINGE[axis])
    height, reach = 0.45, 0.38  # of the hinge above the floor, and from the plate's middle, m
    plate.pos = [0.0, 0.0, height]
    for side in (-reach, reach):
        at = [*(side * along[:2]), height / 2]
        base.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=at, size=[0.025, 0.025, height / 2],
                      material="steel")  # fmt: skip
    ends = [*(-reach * along), *(reach * along)]
    plate.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=[0.01, 0.0, 0.0], mass=0.0,
                   material="steel")  # fmt: skip


def _with_friction(spec: mujoco.MjSpec, torque: float, viscosity: float) -> None:
    """Give the plate's bearing dry friction, which in MuJoCo is a constraint torque -D (a + b v) of
    at most `torque`, N m, with a and v the plate's acceleration and rate.

    An impedance d makes D = d I/(1 - d), with I the plate's inertia; a small d keeps this virtual
    inertia small. b is chosen so that the torque is complete above torque/viscosity (rad/s) and
    viscous below: a plate then comes to rest where the servo commands, and does not creep there for
    ever. viscosity : N m s/rad.
    """
    joint = spec.joint("azimuth")
    joint.frictionloss = torque
    impedance = 0.05
    virtual = impedance / (1 - impedance) * plate_inertia(spec.compile())
    joint.solimp_friction = [impedance, impedance, 0.001, 0.5, 2.0]
    joint.solref_friction = [-1.0, -impedance * viscosity / virtual]


def plate_inertia(model: mujoco.MjModel) -> float:
    """The plate's moment of inertia about the hinge, kg m^2, modules included."""
    dof = int(model.joint("azimuth").dofadr[0])
    return float(_mass_matrix(model)[dof, dof])


def out_of_balance(model: mujoco.MjModel) -> float:
    """The largest torque of gravity about the hinge, N m: none about down, and that of the modules
    on their side of the plate about a level axis."""
    data, torques = mujoco.MjData(model), []
    for angle in (0.0, np.pi / 2):
        data.joint("azimuth").qpos[0] = angle
        mujoco.mj_forward(model, data)
        torques.append(float(data.qfrc_bias[int(model.joint("azimuth").dofadr[0])]))
    return math.hypot(*torques)


def _mass_matrix(model: mujoco.MjModel) -> np.ndarray:
    """The joint-space mass matrix in the pose at rest, (nv, nv)."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    matrix = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return matrix


def _on_springs(spec: mujoco.MjSpec, sway: SwayConfig) -> mujoco.MjModel:
    """The compiled model on a vehicle: its mass and its roll axis, and springs and dampers with the
    stated frequencies.

    M is the mass matrix in the pose at rest, table and plate included. So that joint i has the
    frequency f and the damping ratio zeta with the other joints held, it gets the stiffness
    M_ii (2 pi f)^2 and the damping 2 zeta M_ii (2 pi f).
    """
    vehicle = spec.body("vehicle")
    vehicle.mass, vehicle.inertia = sway.mass_kg, sway.inertia_kg_m2
    vehicle.ipos = [0.0, 0.0, sway.com_height_m]
    spec.joint("roll").pos = [0.0, 0.0, sway.roll_axis_height_m]
    spec.joint("pitch").pos = [0.0, 0.0, sway.pitch_axis_height_m]
    slope = math.radians(sway.roll_axis_slope_deg)
    spec.joint("roll").axis = [-math.cos(slope), 0.0, -math.sin(slope)]
    for name in ("vehicle", "base", "plate"):
        spec.body(name).gravcomp = 1.0  # so that the springs carry no weight
    model = spec.compile()
    mass = _mass_matrix(model)
    for name, f, zeta in zip(JOINTS, sway.frequency_hz, sway.damping_ratio, strict=True):
        joint = model.joint(name)
        i, w = joint.dofadr[0], 2 * math.pi * f
        joint.stiffness[0] = mass[i, i] * w**2
        joint.damping[0] = 2 * zeta * mass[i, i] * w
    return model
