"""A finished training run as an estimator: the same call as the classical ones."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lbgc.data import unit_file
from lbgc.data.windows import Windows
from lbgc.errors import InputError, build, reading
from lbgc.estimators.estimate import Estimate, require_down
from lbgc.frames import wrap
from lbgc.learning import description, tensors
from lbgc.learning.model import HeadingNet, ModelConfig, make, von_mises_sigma
from lbgc.learning.residual import inputs
from lbgc.outputs import read_file
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.imu import ImuModel

WEIGHTS = "model.safetensors"
SHORTEST_WINDOW_S = 10.0
_BATCH = 4096
_MOST_BYTES = 2**30
"""Largest size of a file of weights."""
_TELLING = 4


@dataclass(eq=False)
class Learned:
    """A trained network as an estimator. It works at its own rate of means; faster windows are
    averaged down to it."""

    config: ModelConfig
    compute: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    """Features (W, T, C) float32 -> (heading less the base's, sigma), both (W,), rad"""
    rate_hz: float
    sensor: str
    trained_on: ImuModel
    """The sensor whose noise weights its base, with what is known of the unit that it is for"""

    @classmethod
    def load(cls, run: str | Path) -> "Learned":
        """The network in a run's directory, run by PyTorch. Raises InputError where there is no
        whole model."""
        net, said = load_net(run)
        config = net.config
        return cls.described(config, lambda x: compute_torch(net, x), said)

    @classmethod
    def described(
        cls,
        config: ModelConfig,
        compute: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
        said: Mapping[str, Any],
    ) -> "Learned":
        """A network that is run by `compute`, with its rate and sensor from a run's description,
        said."""
        sensor = build(ImuConfig, said["units"]["imu"])
        imu = sensor.model(float(said["imu_rate_hz"]))
        if said.get("calibration") is not None:
            imu = unit_file.parse(said["calibration"], sensor, "model.json").told(imu)
        return cls(config, compute, float(said["rate_hz"]), str(said["sensor"]), imu)

    @property
    def name(self) -> str:
        """The network's name in tables."""
        return self.config.name

    def __call__(self, windows: Windows, imu: ImuModel | None = None) -> Estimate:
        """The network's heading, and the sigma that a probabilistic one states (else NaN).

        Each answer is a function of its own window alone, and of nothing told about the sensor.
        Raises InputError where the windows' rate is no whole multiple of the model's, where they
        are too short, or where a value is not finite or a sensor's axis does not change at all.
        """
        require_down(self.name, windows)
        if windows.duration_s < SHORTEST_WINDOW_S - 1 / windows.rate_hz:
            raise InputError(
                "a window",
                f"{windows.duration_s:g}",
                "s",
                f"is shorter than the {SHORTEST_WINDOW_S:g} s that models are trained for",
            )
        x, base = inputs(self.config, windows, self.rate_hz, self.trained_on)
        self._check_alive(windows)
        heading, sigma = np.empty(len(windows)), np.empty(len(windows))
        for first in range(0, len(windows), _BATCH):
            part = slice(first, first + _BATCH)
            heading[part], sigma[part] = self.compute(x[part])
        return Estimate(wrap(base + heading), sigma)

    def _check_alive(self, windows: Windows) -> None:
        """Raise InputError where an axis that the network sees is constant over a window. In
        windows of fewer than four samples, which may agree by chance, only zeros are refused."""
        whole = self.config.base is not None or self.config.sways
        seen = ("gyro", "accel") if whole else self.config.channels
        for name in ("gyro", "accel"):
            values = getattr(windows, name)
            constant = np.ptp(values, axis=1) == 0.0  # (W, 3)
            if values.shape[1] < _TELLING:
                constant &= values[:, 0] == 0.0
            if name in seen and constant.any():
                row, axis = np.argwhere(constant)[0]
                value = values[row, 0, axis] + 0.0  # turns -0.0 to 0.0
                what = f"at every sample of window {row}: a stuck sensor, not a measurement"
                raise InputError(f"{name}'s {'xyz'[axis]} axis", f"{value:g}", "", what)


def load_net(run: str | Path) -> tuple[HeadingNet, dict[str, Any]]:
    """A run's network and description. Raises InputError where there is no whole model."""
    said = description.read(run)
    with reading("run", run, "holds a damaged model"):
        config = build(ModelConfig, said["model"])
        with torch.device("meta"):  # shapes alone, without memory for the values
            own = HeadingNet(config).state_dict()
        size = sum(value.nbytes for value in own.values())
        content = read_file(Path(run) / WEIGHTS, min(size + tensors.MOST_HEADER, _MOST_BYTES))
        if hashlib.sha256(content).hexdigest() != said["weights"]:
            raise ValueError(f"{WEIGHTS} is not as it was written")
        weights = tensors.parse(content)
        wanted = {name: (value.shape, value.dtype) for name, value in own.items()}
        if {name: (value.shape, value.dtype) for name, value in weights.items()} != wanted:
            raise ValueError(f"{WEIGHTS} holds another network's")
        if not all(bool(torch.isfinite(value).all()) for value in weights.values()):
            raise ValueError(f"{WEIGHTS} holds what is no number")
        net = make(config, seed=0)
        net.load_state_dict(weights)
        return net.eval(), said


@torch.inference_mode()
def compute_torch(net: HeadingNet, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(heading less the base's, sigma or NaN), both (W,), rad, of features (W, T, C)."""
    raw = net(torch.from_numpy(x))
    heading = np.deg2rad(net.heading_deg(raw).double().numpy())
    if net.config.output != "vonmises":
        return heading, np.full(len(x), np.nan)
    return heading, von_mises_sigma(net.log_kappa(raw).double()).numpy()
