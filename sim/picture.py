"""A picture of the scene, which is put beside a dataset."""

import subprocess
import sys
from pathlib import Path

from lbgc.data import picture
from lbgc.outputs import shown
from lbgc.protocol import ProtocolConfig

from .turntable import SceneConfig

_LONGEST_S = 120


def try_picture(out: Path, config: SceneConfig, protocol: ProtocolConfig) -> str | None:
    """Render the scene in a process of its own, so that a crash of the graphics driver costs only
    the picture.

    Returns None, or the reason why there is no picture.
    """
    scene = (sys.executable, "-P", "-m", f"{__package__}.scene")  # from no directory of the user's
    # The arms are the only part of a scene's configuration that a picture shows.
    command = [*scene, f"out='{out.resolve()}'", f"scene.arm_m={config.arm_m}"]
    if protocol.kind == "tumble":
        command.append("protocol=tumble")
    else:
        command += ["protocol.kind=carousel", f"protocol.axis={protocol.axis}"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST_S)
    except subprocess.TimeoutExpired:
        return f"it was not there after {_LONGEST_S} s; python sim/scene.py out=PATH draws one"
    except OSError as error:
        return str(error)
    if done.returncode == 0 and picture.read(out) is not None:
        return None
    return shown((done.stderr.strip().splitlines() or ["it crashed"])[-1])
