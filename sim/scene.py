"""The turntable's model: the only file that builds one, and the one that pictures it.

python sim/scene.py out=scene.png
"""

import ctypes.util
import math
import os
import subprocess
import sys
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from lbgc.errors import (
    InputError,
    require,
    require_not_negative,
    require_positive,
    run_main,
)
from sim.sway import JOINTS, SwayConfig

_BACKENDS = {"egl": "EGL", "osmesa": "OSMesa"}
if "MUJOCO_GL" not in os.environ:  # MuJoCo chooses how it renders when it is imported
    for _name, _library in _BACKENDS.items():
        if ctypes.util.find_library(_library):
            os.environ["MUJOCO_GL"] = _name
            break

import mujoco  # noqa: E402
import numpy as np  # noqa: E402

XML = Path(__file__).with_name("turntable.xml")


@dataclass(frozen=True)
class SceneConfig:
    """The bench, what `conf/scene/*.yaml` holds. Geometry is in `turntable.xml`."""

    physics_hz: float = 1200.0
    """Physics steps a second; the IMU's period must be a whole number of steps."""
    servo_stiffness_nm_per_rad: float = 60.0
    """Of the position servo that drives the plate."""
    servo_damping_nm_s_per_rad: float = 9.0
    """Of the servo."""
    bearing_damping_nm_s_per_rad: float = 0.05
    """Viscous, of the plate's bearing."""
    reference_error_deg: float = 0.2
    """1 sigma of the control module's heading, new every recording."""
    sway: SwayConfig = field(default_factory=SwayConfig)

    def __post_init__(self) -> None:
        require_positive("physics_hz", self.physics_hz)
        require_positive("servo_stiffness_nm_per_rad", self.servo_stiffness_nm_per_rad)
        require_positive("servo_damping_nm_s_per_rad", self.servo_damping_nm_s_per_rad)
        require_not_negative(self, "bearing_damping_nm_s_per_rad", "reference_error_deg")


@lru_cache(maxsize=8)
def load(config: SceneConfig, gravity: float) -> mujoco.MjModel:
    """The compiled model. gravity : m/s^2, down."""
    spec = mujoco.MjSpec.from_file(str(XML))
    spec.option.timestep = 1.0 / config.physics_hz
    spec.option.gravity = [0.0, 0.0, -gravity]
    spec.joint("azimuth").damping[0] = config.bearing_damping_nm_s_per_rad
    servo = spec.actuator("servo")
    stiffness, damping = config.servo_stiffness_nm_per_rad, config.servo_damping_nm_s_per_rad
    servo.gainprm[0] = stiffness
    servo.biasprm[:3] = [0.0, -stiffness, -damping]
    if config.sway.present:
        return _on_springs(spec, config.sway)
    for name in JOINTS:
        spec.delete(spec.actuator(name))
        spec.delete(spec.joint(name))
    return spec.compile()


def _on_springs(spec: mujoco.MjSpec, sway: SwayConfig) -> mujoco.MjModel:
    """The vehicle's mass, its roll axis, and springs and dampers of the stated frequencies.

    M is the mass matrix in the pose of rest, table and plate included; with the other joints held,
    joint i has the stiffness M_ii (2 pi f)^2 and the damping 2 zeta M_ii (2 pi f).
    """
    vehicle = spec.body("vehicle")
    vehicle.mass, vehicle.inertia = sway.mass_kg, sway.inertia_kg_m2
    vehicle.ipos = [0.0, 0.0, sway.com_height_m]
    spec.joint("roll").pos = [0.0, 0.0, sway.roll_axis_height_m]
    spec.joint("pitch").pos = [0.0, 0.0, sway.pitch_axis_height_m]
    slope = math.radians(sway.roll_axis_slope_deg)
    spec.joint("roll").axis = [math.cos(slope), 0.0, -math.sin(slope)]
    for name in ("vehicle", "base", "plate"):
        spec.body(name).gravcomp = 1.0  # springs are at rest where the vehicle stands
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    for name, f, zeta in zip(JOINTS, sway.frequency_hz, sway.damping_ratio, strict=True):
        joint = model.joint(name)
        i, w = joint.dofadr[0], 2 * math.pi * f
        joint.stiffness[0] = mass[i, i] * w**2
        joint.damping[0] = 2 * zeta * mass[i, i] * w
    return model


@dataclass(frozen=True)
class PictureConfig:
    """`python sim/scene.py`"""

    out: str = "outputs/scene.png"
    """The picture to write."""
    width: int = 960
    """Pixels."""
    height: int = 720
    """Pixels."""
    plate_angle_deg: float = 30.0
    """Where the plate stands."""
    scene: SceneConfig = field(default_factory=SceneConfig)

    def __post_init__(self) -> None:
        require(self.out.endswith(".png"), "out", self.out, "must end in .png")
        require(0 < self.width <= 1280, "width", self.width, "must be 1 to 1280 pixels")
        require(0 < self.height <= 960, "height", self.height, "must be 1 to 960 pixels")


def picture(config: PictureConfig) -> Path:
    """Render the scene to a PNG, offscreen. Raises InputError where this machine cannot."""
    import matplotlib.image

    model = load(config.scene, 9.8)
    data = mujoco.MjData(model)
    data.joint("azimuth").qpos[0] = np.deg2rad(config.plate_angle_deg)
    mujoco.mj_forward(model, data)
    try:
        with mujoco.Renderer(model, config.height, config.width) as renderer:
            renderer.update_scene(data, camera="overview")
            pixels = renderer.render()
    except Exception as error:  # each backend fails in a way of its own
        raise InputError(
            "MUJOCO_GL",
            os.environ.get("MUJOCO_GL", "(not set)"),
            "",
            f"cannot render here ({type(error).__name__}: {error}); install libosmesa6, or libegl1 "
            "and libgl1-mesa-dri, and set MUJOCO_GL to osmesa or egl",
        ) from error
    out = Path(config.out)
    out.parent.mkdir(parents=True, exist_ok=True)
    matplotlib.image.imsave(out, pixels)
    return out


def try_picture(out: Path, config: SceneConfig) -> str | None:
    """Render in a process of its own, so that a graphics driver's crash costs a picture only.

    Returns None, or why there is no picture.
    """
    # At rest the picture is the same, whatever sways.
    options = [f"scene.{name}={value}" for name, value in vars(config).items() if name != "sway"]
    command = [sys.executable, str(Path(__file__)), f"out='{out.resolve()}'", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    if done.returncode == 0 and out.exists():
        return None
    return (done.stderr.strip().splitlines() or ["it crashed"])[-1]


if __name__ == "__main__":
    run_main(picture, PictureConfig, "scene_picture")
