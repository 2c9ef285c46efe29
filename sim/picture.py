"""The scene's picture beside a dataset."""

import subprocess
import sys
from pathlib import Path

from .turntable import SceneConfig

_LONGEST_S = 120


def try_picture(out: Path, config: SceneConfig) -> str | None:
    """Render in a process of its own, so that a graphics driver's crash costs a picture only.

    Returns None, or why there is no picture.
    """
    scene = (sys.executable, "-P", "-m", f"{__package__}.scene")  # from no directory of the user's
    # Of all that a scene has, the arms are what one sees.
    command = [*scene, f"out='{out.resolve()}'", f"scene.arm_m={config.arm_m}"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST_S)
    except subprocess.TimeoutExpired:
        return f"it was not there after {_LONGEST_S} s; python sim/scene.py out=PATH draws one"
    except OSError as error:
        return str(error)
    if done.returncode == 0 and out.exists():
        return None
    return (done.stderr.strip().splitlines() or ["it crashed"])[-1]
