"""The paper's network: an LSTM over time in both directions, a linear layer for each, summed."""

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE
from lbgc.errors import InputError, require, require_choice, require_positive
from lbgc.units import STANDARD_GRAVITY

CHANNELS = {"gyro": 3, "accel": 3, "plate": 2}
"""What a model may see, and how many features it makes: the plate's angle as cosine and sine."""


@dataclass(frozen=True)
class ModelConfig:
    """What `conf/model/*.yaml` holds."""

    name: str = "bilstm_24"
    """How tables call it."""
    layers: int = 2
    """Of the LSTM."""
    hidden: int = 24
    """Its state's size, a direction."""
    output: str = "sincos"
    """sincos: sine and cosine of the heading. degrees: the heading, unbounded, as published."""
    channels: list[str] = field(default_factory=lambda: ["gyro", "accel", "plate"])
    """What it sees; the published network sees the gyro only."""

    def __post_init__(self) -> None:
        require_positive("layers", self.layers)
        require_positive("hidden", self.hidden)
        require_choice("output", self.output, ("sincos", "degrees"))
        for channel in self.channels:
            require_choice("channels", channel, list(CHANNELS))
        unique = len(set(self.channels)) == len(self.channels) > 0
        require(unique, "channels", self.channels, "must name each channel once, at least one")

    @property
    def features(self) -> int:
        return sum(CHANNELS[c] for c in self.channels)


def features(config: ModelConfig, windows: Windows) -> np.ndarray:
    """The network's input, float32 (W, T, C): normalised by physics (Earth's rate, g), not by data.

    Raises InputError where a value is not finite.
    """
    columns = {
        "gyro": lambda: windows.gyro / EARTH_RATE,
        "accel": lambda: windows.accel / STANDARD_GRAVITY,
        "plate": lambda: np.stack([np.cos(windows.plate_angle), np.sin(windows.plate_angle)], -1),
    }
    x = np.concatenate([columns[c]() for c in config.channels], axis=-1).astype(np.float32)
    if not np.isfinite(x).all():
        raise InputError("window", "not finite", "", "every value must be a finite number")
    return x


class HeadingNet(nn.Module):
    """Many to one: windows of any length T to a heading."""

    def __init__(self, config: ModelConfig):
        super().__init__()
        self.config = config
        self.lstm = nn.LSTM(
            config.features, config.hidden, config.layers, batch_first=True, bidirectional=True
        )
        outputs = 2 if config.output == "sincos" else 1
        self.forward_head = nn.Linear(config.hidden, outputs)
        self.backward_head = nn.Linear(config.hidden, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """x : (W, T, C). Returns the raw output, (W, 2) sine and cosine or (W, 1) degrees."""
        _, (h, _) = self.lstm(x)  # (2 layers, W, H): the last layer's two ends are the last two
        return self.forward_head(h[-2]) + self.backward_head(h[-1])  # (W, 2) or (W, 1)

    def heading_deg(self, raw: Tensor) -> Tensor:
        """The heading that a raw output means, (W,), degrees."""
        if self.config.output == "degrees":
            return raw[:, 0]
        return torch.rad2deg(torch.atan2(raw[:, 0], raw[:, 1]))


def make(config: ModelConfig, seed: int) -> HeadingNet:
    """A freshly initialised network; the global random state is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return HeadingNet(config)


def parameter_count(net: nn.Module) -> int:
    return sum(p.numel() for p in net.parameters())
