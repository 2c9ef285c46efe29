"""The networks: the paper's (an LSTM over time in both directions), its variants, and a pooling one
for corrections to a classical estimate."""

import math
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE
from lbgc.errors import InputError, require, require_choice, require_name
from lbgc.estimators import CLASSICAL
from lbgc.learning import sway
from lbgc.learning.filter import Filter
from lbgc.units import STANDARD_GRAVITY

CHANNELS = {"gyro": 3, "accel": 3, "plate": 2, "sway": sway.PER_STEP + sway.CONSTANTS}
"""The channels that a model may see, and the number of features of each: the plate's angle is
cosine and sine, a base that sways as lbgc.learning.sway says."""
RESIDUAL_CHANNELS = {"gyro": 5, "accel": 5, "plate": 2}
"""Number of features of each channel of a window that is turned by its own classical estimate; see
lbgc.learning.residual."""
CONSTANTS = 4
"""Number of further features of such a window: sine and cosine of the estimate, the window's
length, and the logarithm of the latitude's cosine, to which Earth's horizontal rate is
proportional."""
OUTPUTS = {"sincos": 2, "degrees": 1, "vonmises": 3}
"""Kinds of output, and how many numbers each has."""
RECURRENT = {"lstm": nn.LSTM, "gru": nn.GRU, "rnn": nn.RNN}
MOMENTS = 4
"""Number of Legendre moments over time of each feature."""
LENGTHS = 16
"""Number of window lengths, 1, 2, 4... samples, between which the tempering of the concentration is
interpolated linearly."""
_LOG_KAPPA = (-10.0, 25.0)
_NODES = 256
_DEGREES = 180 / math.pi
"""Degrees in a radian; not every exporter knows torch.rad2deg."""


@dataclass(frozen=True)
class ModelConfig:
    """A network's architecture: the keys of `conf/model/*.yaml`."""

    name: str = "bilstm_24"
    """Its name in tables."""
    cell: str = "lstm"
    """lstm, gru, rnn: recurrent, in both directions. pool: moments over the window's time, then
    layers without memory; fast, and enough for errors that are nearly Gaussian. filter: weights of
    such moments, chosen by how a base sways; for the channel sway alone."""
    layers: int = 2
    """Number of layers of the cell."""
    hidden: int = 24
    """Size of each layer, a direction."""
    output: str = "sincos"
    """sincos: sine and cosine of the heading. degrees: the heading, unbounded, as published.
    vonmises: heading and concentration, trained by likelihood, so that it states a sigma."""
    channels: list[str] = field(default_factory=lambda: ["gyro", "accel", "plate"])
    """What the network sees; the published network sees the gyro only."""
    base: str | None = None
    """A classical estimator that turns each window by its estimate, to which the network learns a
    correction; null: the network has the window as it is."""

    def __post_init__(self) -> None:
        for name, most in (("layers", 64), ("hidden", 4096)):
            value = getattr(self, name)
            require(1 <= value <= most, name, value, f"must be from 1 to {most}")
        require_name("name", self.name)
        plain = unicodedata.normalize("NFKC", self.name).casefold().strip()
        taken = plain in (*CLASSICAL, "floor") or plain.startswith("floor,")
        require(not taken, "name", self.name, "is an estimator's; call the network otherwise")
        require_choice("cell", self.cell, (*RECURRENT, "pool", "filter"))
        require_choice("output", self.output, list(OUTPUTS))
        for channel in self.channels:
            require_choice("channels", channel, list(CHANNELS))
        unique = len(set(self.channels)) == len(self.channels) > 0
        require(unique, "channels", self.channels, "must name each channel once, at least one")
        if self.base is not None:
            require_choice("base", self.base, list(CLASSICAL))
        both = ("sway" in self.channels) == (self.cell == "filter")
        require(
            both, "cell", self.cell, "is what the channel sway takes: cell=filter, and no other"
        )
        if self.sways:
            require(self.channels == ["sway"], "channels", self.channels, "has sway beside others")
            require_choice("output", self.output, ("sincos", "vonmises"))

    @property
    def sways(self) -> bool:
        """Whether the network takes samples on a base that sways, not means on one that rests."""
        return "sway" in self.channels

    @property
    def features(self) -> int:
        """Number of features a step of the network."""
        if self.base is None or self.sways:
            return sum(CHANNELS[c] for c in self.channels)
        return sum(RESIDUAL_CHANNELS[c] for c in self.channels) + CONSTANTS


def features(config: ModelConfig, windows: Windows) -> np.ndarray:
    """The features of a network without a base, float32 (W, T, C), normalised by physics (Earth's
    rate, g), not by data.

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
    """A network from windows of any length T to one heading each, or to a correction of the base's.

    A correction is the direction of a point (1 + scale c, scale s) in the plane: if the only error
    is a body-frame bias, known and without noise, then c and s are linear in the features, and the
    layer `skip` finds them at once.
    """

    scale: Tensor
    gain: Tensor
    tempering: Tensor

    def __init__(self, config: ModelConfig):
        super().__init__()
        self.config = config
        outputs = OUTPUTS[config.output]
        if config.output == "vonmises":
            self.register_buffer("tempering", torch.zeros(2, LENGTHS))
        if config.cell == "filter":
            corrects = config.base is not None
            self.filter = Filter(config.hidden, config.layers, outputs, corrects)
            return
        if config.cell == "pool":
            self.pool = _Pool(config, outputs)
        else:
            self.recurrent = RECURRENT[config.cell](
                config.features, config.hidden, config.layers, batch_first=True, bidirectional=True
            )
            self.forward_head = nn.Linear(config.hidden, outputs)
            self.backward_head = nn.Linear(config.hidden, outputs)
        if config.base is not None:
            self.skip = nn.Linear(MOMENTS * config.features, outputs)
            self.register_buffer("scale", torch.tensor(1.0))
            scaled = [c in ("gyro", "accel") for c in config.channels
                      for _ in range(RESIDUAL_CHANNELS[c])]  # fmt: skip
            self.register_buffer(
                "gain", torch.tensor([*scaled, *[False] * CONSTANTS]), persistent=False
            )
            for layer in self._last_layers():
                nn.init.zeros_(layer.weight)
                nn.init.zeros_(layer.bias)

    def _last_layers(self) -> list[nn.Linear]:
        """Layers that are zero at first, so that training starts from the base itself."""
        if self.config.cell == "pool":
            return [self.skip, self.pool.out]
        return [self.skip, self.forward_head, self.backward_head]

    def forward(self, x: Tensor) -> Tensor:
        """The raw output for features x, (W, T, C): (W, 2) sine and cosine, (W, 1) degrees, or
        (W, 3) sine, cosine and logarithm of the concentration."""
        length = (x[0, :, 0] * 0 + 1).sum()
        if self.config.cell == "filter":
            raw = self.filter(x)  # (W, outputs)
            return self._tempered(raw, length) if self.config.output == "vonmises" else raw
        if self.config.base is not None:
            x = torch.where(self.gain, x / self.scale, x)  # (W, T, C): errors of about 1
        if self.config.cell == "pool":
            raw = self.pool(x)  # (W, outputs)
        else:
            h = self._ends(x)  # (2 layers, W, H): the last layer's two ends are the last two
            raw = self.forward_head(h[-2]) + self.backward_head(h[-1])  # (W, outputs)
        if self.config.base is not None:
            raw = self._corrected(raw + self.skip(moments(x)))
        return self._tempered(raw, length) if self.config.output == "vonmises" else raw

    def _tempered(self, raw: Tensor, length: Tensor) -> Tensor:
        """The raw output with the concentration's logarithm corrected, by an offset and by a factor
        on its spread from window to window, as calibrated at this length, in samples."""
        nodes = torch.arange(LENGTHS, device=raw.device, dtype=raw.dtype)
        between = torch.clamp(1 - torch.abs(torch.log2(length) - nodes), min=0)  # (LENGTHS,)
        more, wider = (between * self.tempering).sum(dim=1)
        return torch.cat([raw[:, :2], raw[:, 2:] * (1 + wider) + more], dim=1)

    def temper(self, lengths: np.ndarray, more: np.ndarray, wider: np.ndarray) -> None:
        """Change the concentration's logarithm l to l (1 + wider) + more for windows of these
        lengths, samples, ascending. Both are interpolated over the length's logarithm, and constant
        beyond the first and the last."""
        at = np.arange(LENGTHS)
        added, stretched = (
            torch.from_numpy(np.interp(at, np.log2(lengths), v)).to(self.tempering)
            for v in (more, wider)
        )
        before, spread = self.tempering.clone()
        self.tempering[0] = before * (1 + stretched) + added
        self.tempering[1] = spread * (1 + stretched) + stretched

    def _ends(self, x: Tensor) -> Tensor:
        """Final hidden states of all layers in both directions, (2 layers, W, H)."""
        _, state = self.recurrent(x)
        return state[0] if self.config.cell == "lstm" else state

    def _corrected(self, raw: Tensor) -> Tensor:
        """A correction's outputs, from units of `scale` to the units of every network's outputs,
        (W, outputs)."""
        if self.config.output == "degrees":
            return raw * self.scale * _DEGREES
        direction = raw[:, :2] * self.scale + torch.tensor([0.0, 1.0], device=raw.device)
        return torch.cat([direction, raw[:, 2:] - 2 * torch.log(self.scale)], dim=1)

    def heading_deg(self, raw: Tensor) -> Tensor:
        """The heading (less the base's) of a raw output, (W,), degrees."""
        if self.config.output == "degrees":
            return raw[:, 0]
        return torch.atan2(raw[:, 0], raw[:, 1]) * _DEGREES

    def log_kappa(self, raw: Tensor) -> Tensor:
        """Logarithm of the von Mises concentration of a raw output, (W,)."""
        return raw[:, 2].clamp(*_LOG_KAPPA)


class _Pool(nn.Module):
    """The pooling network: moments over time and means of squashed features, through layers without
    memory."""

    def __init__(self, config: ModelConfig, outputs: int):
        super().__init__()
        size = config.hidden
        self.encode = nn.Linear(config.features, size)
        inside = [nn.Linear(MOMENTS * config.features + size, size)]
        inside += [nn.Linear(size, size) for _ in range(config.layers - 1)]
        self.inside = nn.ModuleList(inside)
        self.out = nn.Linear(size, outputs)

    def forward(self, x: Tensor) -> Tensor:
        squashed = torch.tanh(self.encode(x)).mean(dim=1)  # (W, H): bounds what a knock counts
        h = torch.cat([moments(x), squashed], dim=1)  # (W, 4 C + H)
        for layer in self.inside:
            h = torch.tanh(layer(h))  # (W, H)
        return self.out(h)  # (W, outputs)


def moments(x: Tensor) -> Tensor:
    """Legendre moments of features, (W, 4 C): means over time of x, (W, T, C), times the first four
    Legendre polynomials of time. Any weighting that varies slowly along a window is made of them.
    """
    count = x.shape[1]
    t = (2 * torch.arange(count, device=x.device, dtype=x.dtype) + 1) / count - 1  # (T,)
    weights = torch.stack([t * 0 + 1, t, (3 * t**2 - 1) / 2, (5 * t**3 - 3 * t) / 2])  # (4, T)
    return torch.matmul(weights / count, x).flatten(1)  # (W, 4, C) -> (W, 4 C)


def von_mises_sigma(log_kappa: Tensor) -> Tensor:
    """RMS angle from the mean direction, rad, of von Mises densities, (W,): 1/sqrt(kappa) where
    they are narrow, pi/sqrt(3) where they are flat. By quadrature over the whole circle, or twelve
    widths either way."""
    kappa = torch.exp(log_kappa)[:, None]
    reach = torch.clamp(12 / torch.sqrt(kappa), max=math.pi)
    nodes = (torch.arange(_NODES, device=kappa.device, dtype=kappa.dtype) + 0.5) / _NODES
    angle = reach * nodes  # (W, nodes)
    density = torch.exp(-2 * kappa * torch.sin(angle / 2) ** 2)
    return torch.sqrt((density * angle**2).sum(dim=1) / density.sum(dim=1))


def make(config: ModelConfig, seed: int) -> HeadingNet:
    """A freshly initialised network; the global random state is left as it was."""
    with first_weights(seed):
        return HeadingNet(config)


@contextmanager
def first_weights(seed: int) -> Iterator[None]:
    """Let networks that are made inside the `with` block have the first weights of a seed, and the
    global random state be as it was afterwards."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


def parameter_count(net: nn.Module) -> int:
    """Number of a network's trainable parameters."""
    return sum(p.numel() for p in net.parameters())
