"""What MuJoCo draws with, settled before it is imported: its import fails where that is not there,
and a bench need not be drawn to be simulated."""

import ctypes.util
import os

_BACKENDS = {"egl": "EGL", "osmesa": "OSMesa"}

lacking: str | None = None
"""Why what MUJOCO_GL asks for cannot be used; None: nothing is known against it."""


def settle() -> None:
    """Import MuJoCo, with the first renderer that is installed where none is asked for, and with
    none where the one that MUJOCO_GL asks for cannot be had."""
    global lacking
    if "MUJOCO_GL" not in os.environ:
        for name, library in _BACKENDS.items():
            if ctypes.util.find_library(library):
                os.environ["MUJOCO_GL"] = name
                break
    asked = os.environ.get("MUJOCO_GL")
    try:
        import mujoco
    except Exception as error:  # each renderer's library fails in a way of its own
        os.environ["MUJOCO_GL"] = "disable"
        import mujoco  # noqa: F401

        lacking = f"{type(error).__name__}: {error}"
    finally:
        if asked is not None:
            os.environ["MUJOCO_GL"] = asked
