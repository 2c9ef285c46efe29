"""Display of the bench: in a window, as a picture, or as a film above plots of the true rates and
forces."""

import copy
import io
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image
from tqdm import tqdm

from lbgc.attitudes import drawn, with_attitudes
from lbgc.errors import InputError, require
from lbgc.frames import AXES
from lbgc.outputs import write_atomically
from lbgc.protocol import Plan, ProtocolConfig, plan
from lbgc.sensor.streams import Purpose, recording

from . import hand, motion, opengl
from .motion import execute
from .poses import Bench, Executed
from .turntable import SceneConfig, load

_FRAMES_A_S = 12.5
"""Frames a second: whole hundredths of a second each, which is the unit of a GIF."""
_RATE_HZ = 100.0
"""Rate of the samples in a film's plots."""
Joints = Mapping[str, np.ndarray]
"""Positions of joints, by name: the plate's angle, rad, or the place (m) and quaternion of an IMU
that is held, (7,)."""
_COLOURS = 96
"""Colours of a film's frame."""


@dataclass(frozen=True)
class ViewConfig:
    """The configuration of `python sim/scene.py`."""

    out: str | None = None
    """The picture (.png) or film (.gif) to write; null: an interactive window."""
    width: int = 960
    """Width of the picture, pixels."""
    height: int = 720
    """Height of the scene itself, pixels."""
    plate_angle_deg: float = 30.0
    """Angle of the plate in a picture. With protocol=tumble it shows the first attitude."""
    latitude: float = 32.76
    """Latitude for a film's rates and forces, degrees."""
    duration_s: float = 15.0
    """Duration of a film, and of the plan that the window repeats."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    """The bench."""
    protocol: ProtocolConfig = field(default_factory=ProtocolConfig)
    """What the plate is commanded to do."""

    def __post_init__(self) -> None:
        kinds = (".png", ".gif")
        good = self.out is None or self.out.endswith(kinds)
        require(good, "out", self.out, f"must end in {' or '.join(kinds)}")
        require(0 < self.width <= 1280, "width", self.width, "must be 1 to 1280 pixels")
        require(0 < self.height <= 960, "height", self.height, "must be 1 to 960 pixels")
        longest = 120
        in_range = 0 < self.duration_s <= longest
        require(in_range, "duration_s", self.duration_s, f"must be above 0, up to {longest}")
        require(abs(self.latitude) <= 90, "latitude", self.latitude, "must be from -90 to 90")
        if self.out is None or not self.out.endswith(".png"):
            plan(self.protocol, 0, self.duration_s)

    @property
    def bench(self) -> Bench:
        """The scene, and a film's samples."""
        axis = AXES.index(self.protocol.axis)
        return Bench(self.scene, _RATE_HZ, round(self.duration_s * _RATE_HZ), axis)

    @property
    def plan(self) -> Plan:
        """The plan of the protocol's first recording."""
        planned = plan(self.protocol, 0, self.duration_s)
        if planned.handling is None:
            return planned
        return with_attitudes(planned, self.protocol, recording(1, 0, Purpose.ATTITUDES))

    @property
    def model(self) -> mujoco.MjModel:
        """The bench's model: of a turntable, or of a hand above a table."""
        if self.protocol.kind == "tumble":
            return hand.load(self.scene.hand, self.scene.physics_hz, 9.8)
        return load(self.scene, 9.8, self.bench.axis)


def view(config: ViewConfig) -> Path | None:
    """Show the bench in a window, or write its picture or film. Raises InputError where this
    machine cannot render."""
    if config.out is None:
        look_round(config)
        return None
    out = Path(config.out)
    out.parent.mkdir(parents=True, exist_ok=True)
    content = io.BytesIO()
    if out.suffix == ".png":
        (pixels,) = _rendered(config, [_first(config)])
        Image.fromarray(pixels).save(content, "PNG")
    else:
        _film(config, content)
    write_atomically(out, content.getvalue())
    return out


def _film(config: ViewConfig, out: io.BytesIO) -> None:
    """Write a film of the plan in real time, above plots of rate, specific force and plate angle
    over time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # half a second; only for films

    from lbgc.report.figures import strips

    bench = config.bench
    bench_draw = motion.draw(
        config.scene, 0.0, lambda: recording(1, 0, Purpose.MOTION), config.duration_s
    )
    latitude = float(np.deg2rad(config.latitude))
    truth = motion.truth(bench, config.plan, latitude, bench_draw)
    t = np.arange(1, bench.samples + 1) / _RATE_HZ
    figure, axes = strips(
        t,
        np.broadcast_to(truth.omega_ib_b, (3, len(t))),
        np.broadcast_to(truth.f_ib_b, (3, len(t))),
        truth.plate_angle,
        config.width,
    )
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    below = np.asarray(canvas.buffer_rgba())[:, :, :3]
    frames_t = np.arange(0, config.duration_s, 1 / _FRAMES_A_S)
    executed = execute(bench, 9.8, config.plan)
    frames = []
    scenes = _rendered(config, [_joints(executed, own) for own in frames_t], quick=True)
    shown = tqdm(scenes, "filming", len(frames_t), unit="frame", leave=False)
    for now, above in zip(frames_t, shown, strict=True):
        strip = below.copy()
        for own in axes:
            x, low = own.transData.transform((now, own.get_ylim()[0])).astype(int)
            top = int(own.transData.transform((now, own.get_ylim()[1]))[1])
            strip[len(strip) - top : len(strip) - low, x : x + 2] = (209, 105, 31)
        whole = Image.fromarray(np.concatenate([above, strip]))
        frames.append(whole.quantize(_COLOURS, dither=Image.Dither.NONE))
    every = round(1000 / _FRAMES_A_S)
    frames[0].save(out, "GIF", save_all=True, append_images=frames[1:], duration=every, loop=0)


def _first(config: ViewConfig) -> Joints:
    """The joints of a picture: the plate's stated angle, or the first attitude in the hand."""
    if config.protocol.kind != "tumble":
        return {"azimuth": np.deg2rad([config.plate_angle_deg])}
    attitudes = drawn(config.protocol, recording(1, 0, Purpose.ATTITUDES))
    at = hand.reaching(attitudes[0], hand.grip(config.model))
    return {"held": hand.at_rest(config.model, at)}


def _joints(executed: Executed, t: float) -> Joints:
    """The joints at a time of a recording, s."""
    if not executed.held:
        return {"azimuth": executed.angle_at(np.array([t]))}
    quaternion, place = executed.pose_at(t)
    return {"held": np.concatenate([place, quaternion])}


def _rendered(
    config: ViewConfig, poses: Sequence[Joints], quick: bool = False
) -> Iterator[np.ndarray]:
    """Render the scene offscreen with its joints in these places: images (height, width, 3),
    uint8.

    quick : coarser shadows and edges, for a film. Raises InputError where this machine cannot
    render.
    """
    if opengl.lacking is not None:
        raise _cannot(opengl.lacking)
    model = copy.copy(config.model)
    if quick:
        model.vis.quality.shadowsize, model.vis.quality.offsamples = 2048, 2
    data = mujoco.MjData(model)
    try:
        with mujoco.Renderer(model, config.height, config.width) as renderer:
            for joints in poses:
                _put(data, joints)
                mujoco.mj_forward(model, data)
                renderer.update_scene(data, camera="overview")
                yield renderer.render()
    except Exception as error:  # each backend fails in a way of its own
        raise _cannot(f"{type(error).__name__}: {error}") from error


def _put(data: mujoco.MjData, joints: Joints) -> None:
    """Set the joints."""
    for name, values in joints.items():
        data.joint(name).qpos[:] = values


def _cannot(why: str) -> InputError:
    """The InputError for a machine that cannot render."""
    return InputError(
        "MUJOCO_GL",
        os.environ.get("MUJOCO_GL", "(not set)"),
        "",
        f"cannot render here ({why}); install libosmesa6, or libegl1 and libgl1-mesa-dri, and set "
        "MUJOCO_GL to osmesa or egl",
    )


def look_round(config: ViewConfig) -> None:
    """Show the plan in MuJoCo's window, repeated in real time, until the window is closed. Raises
    InputError where there is no display."""
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise InputError(
            "out", None, "", "there is no display here; give out=scene.png or out=slew.gif"
        )
    import mujoco.viewer

    model = config.model
    data = mujoco.MjData(model)
    executed = execute(config.bench, 9.8, config.plan)
    with mujoco.viewer.launch_passive(
        model, data, show_left_ui=False, show_right_ui=False
    ) as window:
        started = time.monotonic()
        while window.is_running():
            now = (time.monotonic() - started) % config.duration_s
            _put(data, _joints(executed, now))
            mujoco.mj_forward(model, data)
            window.sync()
            time.sleep(1 / 60)
