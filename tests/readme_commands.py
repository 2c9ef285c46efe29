"""The README's commands, and the directory of a user who types them."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tumbled
from helpers import REAL_LOGS, ROOT
from programs import ran

from lbgc.attitudes import uniform

README = (ROOT / "README.md").read_text()
NEEDS = {"log=lasergyro": "lasergyro.imu"}


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.M | re.S)


COMMANDS = [line for block in blocks("bash") for line in block.splitlines() if line.strip()]


def furnish(home: Path, rows: int) -> None:
    """The README's own files, and logs with the columns that it names: so many rows at 100 Hz."""
    for block in blocks("yaml"):
        path = home / block.splitlines()[0].removeprefix("# ")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block)
    mean = [0.0, -0.0028, -0.0031, 0.0, 0.0, -1.0]
    spread = [1e-3] * 3 + [1e-4] * 3
    log = mean + np.random.default_rng(1).standard_normal((rows, 6)) * spread
    turned = np.column_stack([np.arange(0, 360, 10), np.zeros((36, 3))])
    names = "heading_deg,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"
    turned[:, 1], turned[:, 2] = (0.0035 * f(np.deg2rad(turned[:, 0])) for f in (np.cos, np.sin))
    turned[:, 2] *= -1
    np.savetxt(home / "mymeans.csv", turned, delimiter=",", header=names, comments="")
    taus = 2.0 ** np.arange(12)
    curve = np.column_stack([taus, np.sqrt(9 / taus + 1)])
    np.savetxt(home / "datasheet.csv", curve, delimiter=",", header="tau,deviation", comments="")
    header = "w_x,w_y,w_z,f_x,f_y,f_z"
    np.savetxt(home / "mylog.csv", log, delimiter=",", header=header, comments="", fmt="%.7g")
    (home / "labelled").mkdir(exist_ok=True)
    for heading in range(0, 360, 36):
        north, east = 0.0028 * np.cos(np.deg2rad(heading)), 0.0028 * np.sin(np.deg2rad(heading))
        rest = np.add(mean, [north, 0.0028 - east, 0.0, 0.0, 0.0, 0.0])
        rest = rest + np.random.default_rng(heading).standard_normal((rows // 2, 6)) * spread
        path = home / f"labelled/x_{heading}.csv"
        np.savetxt(path, rest, delimiter=",", header=header, comments="", fmt="%.7g")
    _furnish_held(home)
    for name, turn in (("up", 1.0), ("down", -1.0)):
        rest = np.multiply(mean, [turn, turn, 1.0, turn, turn, 1.0])
        rest = rest + np.random.default_rng(2).standard_normal((11_500, 6)) * spread
        np.savetxt(home / f"{name}.csv", rest, delimiter=",", header=header, comments="")


def _furnish_held(home: Path) -> None:
    """A log of a sensor that is held in six attitudes, half a minute each."""
    rng, imu = np.random.default_rng(3), tumbled.sensor("stim300")
    own = tumbled.poses(rng, imu, uniform(rng, 6), 30.0)
    stamps = np.arange(1, len(own.gyro) + 1) / own.rate_hz
    rows = np.column_stack([stamps, own.gyro, own.accel])
    header = "t,gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s),f_x,f_y,f_z"
    np.savetxt(home / "held.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")


def lacking(command: str) -> str | None:
    """The recording that a command needs and this machine has not."""
    for option, recording in NEEDS.items():
        if option in command and not (REAL_LOGS / recording).exists():
            return recording
    return None


def run(
    command: str, home: Path, options: Sequence[str] = (), really: bool = False
) -> subprocess.CompletedProcess:
    """Type it there, these options behind it. really : else the rules of `make` are only said, and
    programs spared their imports."""
    words = shlex.split(command)
    if words[0] == "make":
        words, home = ["make", *([] if really else ["-n"]), *words[1:]], ROOT
    elif words[0] == "source":
        words, home = ["bash", "-c", f"test -d {words[1].split('/')[0]} && {command}"], ROOT
    else:
        assert words[0] == "python"
        script, options = ROOT / words[1], [*words[2:], *options]
        if script.name != "scene.py" and not really:
            return ran(script, *options, cwd=home)
        words = [sys.executable, str(script), *options]
    environment = (
        dict(os.environ) if "scene.py" in command else os.environ | {"MUJOCO_GL": "disable"}
    )
    return subprocess.run(words, cwd=home, capture_output=True, text=True, env=environment)
