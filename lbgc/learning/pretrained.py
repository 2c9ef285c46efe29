"""Small models that come with the package (`make pretrained`).

Each is for one sensor, of any serial number and power-up, and for one protocol. At rest no model
can take out the part of a bias that is new in every recording: there it is as good as the plain
mean, and adds a sigma.
"""

from collections.abc import Iterator
from pathlib import Path

from lbgc.learning.description import DESCRIPTION
from lbgc.learning.trained import Trained

DIRECTORY = Path(__file__).resolve().parents[1] / "pretrained"


def every(directory: Path = DIRECTORY) -> Iterator[Trained]:
    """All networks that come with the package."""
    for file in sorted(directory.glob(f"*/{DESCRIPTION}")):
        yield Trained.load(file.parent, f"{file.parent.name}, pretrained")
