"""The choice of MuJoCo's renderer before MuJoCo is imported. Its import fails where the renderer is
missing, although a bench can be simulated without being drawn."""

import ctypes.util
import os

_BACKENDS = {"egl": "EGL", "osmesa": "OSMesa"}

lacking: str | None = None
"""The reason why the renderer that MUJOCO_GL asks for cannot be used; None where none is known."""


def settle() -> None:
    """Import MuJoCo with a renderer: the one that MUJOCO_GL asks for, or else the first one that is
    installed; and without any where that one cannot be loaded."""
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
