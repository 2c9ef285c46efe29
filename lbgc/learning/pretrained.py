"""Small models that come with the package (`make pretrained`): for whom, and where they refuse.

Each is of one sensor, of any serial number and power-up, and one protocol. What of a bias is new
in every recording no model can take out at rest: there it ties with the plain mean, and adds a
sigma.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lbgc.data.windows import Windows
from lbgc.errors import build
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.learning import description
from lbgc.learning.description import DESCRIPTION
from lbgc.learning.estimator import Learned
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.imu import ImuModel

DIRECTORY = Path(__file__).resolve().parents[1] / "pretrained"
_TURNS = np.deg2rad(1.0)
_NEAR_DEG = 0.5


@dataclass(frozen=True)
class Pretrained:
    """An estimator that refuses what its model was not trained for."""

    name: str
    learned: Learned
    said: dict[str, Any]

    @classmethod
    def load(cls, run: Path) -> "Pretrained":
        """Raises InputError where the model is damaged or of another format."""
        said = description.read(run)
        return cls(f"{run.name}, pretrained", Learned.load(run), said)

    @property
    def sensor(self) -> ImuConfig:
        return build(ImuConfig, self.said["units"]["imu"])

    @property
    def meant_for(self) -> str:
        low, high = self.said["latitude_deg"]
        windows = self.said["training"]["windows_s"]
        lengths = f"{min(windows):g} s" + (f" to {max(windows):g} s" if len(windows) > 1 else "")
        return (f"{self.sensor.name}, protocol {self.said['protocol']}, {lengths}, latitudes "
                f"{low:g} to {high:g} degrees")  # fmt: skip

    def __call__(self, windows: Windows, imu: ImuModel | None = None) -> Estimate:
        """Raises InputError where latitude, length or the plate's motion are none of training's."""
        low, high = self.said["latitude_deg"]
        at = np.rad2deg(windows.latitude)
        lengths = self.said["training"]["windows_s"]
        turns = bool(np.ptp(windows.plate_angle, axis=1).max(initial=0.0) > _TURNS)
        about = f"; it is meant for {self.meant_for}"
        if at.min() < low - _NEAR_DEG or at.max() > high + _NEAR_DEG:
            raise refusal(self.name, f"{at[0]:.4g}", "deg", "is no latitude of its" + about)
        sample = 1 / windows.rate_hz  # a window is of the nearest whole number of samples
        if not min(lengths) - sample < windows.duration_s < max(lengths) + sample:
            raise refusal(self.name, f"{windows.duration_s:g}", "s", "is no length of its" + about)
        if turns != (self.said["protocol"] not in ("static", "heading_scan")):
            does = "turns" if turns else "rests"
            raise refusal(self.name, "a plate", "", f"that {does} is none of its" + about)
        return self.learned(windows, imu)


def every(directory: Path = DIRECTORY) -> Iterator[Pretrained]:
    """All that came with the package."""
    for file in sorted(directory.glob(f"*/{DESCRIPTION}")):
        yield Pretrained.load(file.parent)
