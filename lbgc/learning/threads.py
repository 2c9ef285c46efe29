"""The number of threads for a network's arithmetic, by the size of its matrices."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from lbgc import cores
from lbgc.learning.model import RECURRENT, ModelConfig

_WORTH = 4e6
"""Multiplications of one matrix product that are worth a further thread: some 0.1 ms. With fewer,
threads spend their time waiting for each other, and all of it where others use the cores."""


def wanted(config: ModelConfig, batch: int) -> int:
    """Number of threads for a training step: one for the published networks, however many cores
    there are."""
    if config.cell in RECURRENT:  # a step of time at once, four gates of the hidden size at most
        product = batch * 4 * config.hidden * (config.hidden + max(config.features, config.hidden))
    else:
        product = batch * config.hidden * max(config.features, config.hidden)
    return max(1, min(int(product / _WORTH), torch.get_num_threads(), cores.count()))


@contextmanager
def limited(count: int) -> Iterator[None]:
    """Let PyTorch compute in this number of threads inside the `with` block."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
