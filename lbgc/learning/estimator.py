"""A finished training run as an estimator: the same call as the classical ones."""

import json
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file

from lbgc.data.windows import Windows, at_rate
from lbgc.errors import InputError, build, require
from lbgc.estimators.estimate import Estimate
from lbgc.frames import wrap
from lbgc.learning.model import HeadingNet, ModelConfig, features, make
from lbgc.sensor.imu import ImuModel

WEIGHTS, DESCRIPTION = "model.safetensors", "model.json"
FORMAT = 1
SHORTEST_WINDOW_S = 10.0


class Learned:
    """A trained network that works at its own means rate; what is faster is averaged down to it."""

    def __init__(self, net: HeadingNet, rate_hz: float, sensor: str):
        self.net, self.rate_hz, self.sensor = net.eval(), rate_hz, sensor

    @classmethod
    def load(cls, run: str | Path) -> "Learned":
        """From a run's directory. Raises InputError where there is no whole model."""
        directory = Path(run)
        description = directory / DESCRIPTION
        what = "is no finished training run; `python lbgc/train.py data=PATH` prints one's path"
        require(description.is_file(), "run", run, what)
        try:
            said = json.loads(description.read_text())
            require(said["format"] == FORMAT, "run", run, f"is of format {said['format']}")
            net = make(build(ModelConfig, said["model"]), seed=0)
            net.load_state_dict(load_file(directory / WEIGHTS))
            return cls(net, float(said["rate_hz"]), str(said["sensor"]))
        except (OSError, SafetensorError, RuntimeError, ValueError, KeyError, TypeError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError("run", run, "", f"holds a damaged model ({error})") from error

    @property
    def name(self) -> str:
        return self.net.config.name

    def __call__(self, windows: Windows, imu: ImuModel | None = None) -> Estimate:
        """The network's heading; it states no sigma.

        Raises InputError where the windows' rate is no whole multiple of the model's, where they
        are too short, or where a value is not finite.
        """
        if windows.duration_s < SHORTEST_WINDOW_S - 1e-9:
            raise InputError(
                "a window",
                f"{windows.duration_s:g}",
                "s",
                f"is shorter than the {SHORTEST_WINDOW_S:g} s that models are trained for",
            )
        x = features(self.net.config, at_rate(windows, self.rate_hz))
        with torch.inference_mode():
            heading = self.net.heading_deg(self.net(torch.from_numpy(x)))
        answer = wrap(np.deg2rad(heading.double().numpy()))
        return Estimate(answer, np.full(len(windows), np.nan))
