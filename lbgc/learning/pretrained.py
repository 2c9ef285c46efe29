"""Small models that come with the package (`make pretrained`).

Each is of one sensor, of any serial number and power-up, and one protocol. What of a bias is new
in every recording no model can take out at rest: there it ties with the plain mean, and adds a
sigma.
"""

from collections.abc import Iterator
from pathlib import Path

from lbgc.learning.description import DESCRIPTION
from lbgc.learning.trained import Trained

DIRECTORY = Path(__file__).resolve().parents[1] / "pretrained"


def every(directory: Path = DIRECTORY) -> Iterator[Trained]:
    """All networks that came with the package."""
    for file in sorted(directory.glob(f"*/{DESCRIPTION}")):
        yield Trained.load(file.parent, f"{file.parent.name}, pretrained")
