"""Pictures and films, where this machine can make them; a clear word where it cannot."""

import os
import subprocess
import sys

import numpy as np
import pytest
from helpers import ROOT
from PIL import Image

from lbgc.protocol import ProtocolConfig
from lbgc.report.figures import strips
from sim.picture import try_picture
from sim.turntable import SceneConfig


def scene(tmp_path, *options, **environment) -> subprocess.CompletedProcess:
    command = [sys.executable, str(ROOT / "sim/scene.py"), *options]
    return subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, env=os.environ | environment
    )


@pytest.mark.parametrize(
    ("out", "options"),
    [
        ("scene.png", []),
        ("slew.gif", ["protocol.slew_deg_per_s=180", "protocol.slew_deg_per_s2=360"]),
        ("tumble.png", ["protocol=tumble"]),
        ("tumble.gif", ["protocol=tumble", "protocol.poses=2", "protocol.handling_s=3"]),
    ],
)
def test_a_picture_is_written_or_the_missing_library_named(tmp_path, out, options):
    done = scene(tmp_path, f"out={out}", "width=96", "height=64", "duration_s=4", *options)
    if done.returncode:
        assert done.returncode == 2
        assert "install libosmesa6, or libegl1" in done.stderr
        return
    with Image.open(tmp_path / out) as image:
        assert image.size[0] == 96
        assert len(np.unique(np.asarray(image.convert("L")))) > 8
        # of a film's 50 frames those alike are one
        frames = getattr(image, "n_frames", 1)
        assert frames == 1 if out.endswith("png") else 30 <= frames <= 50
    assert done.stdout.strip().endswith(out)


@pytest.mark.parametrize("renderer", ["disable", "nonsense"])
def test_where_nothing_can_render_it_says_what_to_install(tmp_path, renderer):
    done = scene(tmp_path, "out=scene.png", MUJOCO_GL=renderer)
    assert done.returncode == 2
    assert f"MUJOCO_GL = {renderer}: cannot render here" in done.stderr
    assert "libosmesa6" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_renderer_that_is_not_there_costs_a_picture_and_nothing_else(tmp_path):
    """MuJoCo's own import fails without OSMesa, or a renderer that it knows."""
    command = [sys.executable, str(ROOT / "sim/generate.py"), "recordings=2", "rate_hz=25",
               "duration_s=10", "out=d.zarr"]  # fmt: skip
    environment = os.environ | {"MUJOCO_GL": "nonsense"}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert "no picture of the scene: " in done.stderr
    assert "Traceback" not in done.stderr


def test_a_picture_that_takes_too_long_does_not_fail_its_dataset(tmp_path, monkeypatch):
    def never(*_, timeout, **__):
        raise subprocess.TimeoutExpired("scene.py", timeout)

    monkeypatch.setattr(subprocess, "run", never)
    why = try_picture(tmp_path / "d.png", SceneConfig(), ProtocolConfig())
    assert "not there after 120 s" in why


def test_without_a_display_the_window_is_refused(cli, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    done = cli("sim.scene")
    assert done.code == 2
    assert "there is no display here; give out=scene.png or out=slew.gif" in done.err


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("out=scene.jpg", "out = scene.jpg: must end in .png or .gif"),
        ("width=5000", "width = 5000: must be 1 to 1280 pixels"),
        ("duration_s=3", "takes 6.5 s with its slews"),
        ("latitude=91", "must be from -90 to 90"),
    ],
)
def test_wrong_views_are_refused(cli, override, says):
    done = cli("sim.scene", override)
    assert done.code == 2
    assert says in done.err


def test_the_strips_below_a_film_hold_rate_force_and_angle():
    t = np.arange(1, 101) / 10
    figure, rows = strips(t, np.ones((3, 100)), np.ones((3, 100)), np.ones(100), 640)
    labels = [axes.get_ylabel() for axes in rows]
    assert labels == ["rate, deg/h", "force, m/s²", "plate, deg"]
    assert figure.get_size_inches()[0] == pytest.approx(6.4)
