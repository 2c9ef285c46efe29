"""The bench to look at: in a window, as a picture, as a film.

python sim/scene.py
python sim/scene.py out=scene.png
"""

__package__ = __package__ or "sim"  # it has none where it runs as a script (PEP 366)

from lbgc.commands import run_main

from .render import ViewConfig, view

if __name__ == "__main__":
    run_main(view, ViewConfig, "scene_view")
