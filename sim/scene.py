"""The bench to look at: in a window, as a picture, as a film.

python sim/scene.py
python sim/scene.py out=scene.png
"""

from lbgc.commands import run_main
from sim import opengl

opengl.settle()

from sim.render import ViewConfig, view  # noqa: E402

if __name__ == "__main__":
    run_main(view, ViewConfig, "scene_view")
