"""What a training asks of the machine, by its configuration alone and before it starts."""

import torch

from lbgc import machine
from lbgc.learning.model import RECURRENT, HeadingNet, ModelConfig, parameter_count

_KEPT = 12
"""Values kept a step of the network, direction and hidden unit, until the gradient is taken."""
_WEIGHT, _VALUE = 20.0, 4.0
"""Bytes for each weight, with its gradient, Adam's moments and the best so far; and a value."""
_OPERATIONS_PER_S = 5e9


def check(
    model: ModelConfig, batch: int, tempering: int, longest: int, steps: int, means: int
) -> None:
    """Say what the training takes, where it is much. Raises InputError, naming what is too large,
    where it takes more memory than this machine has.

    batch, tempering : windows at once, in training and at its end; longest : steps of the network
    in the longest window; steps : of the optimiser; means : values of each axis in all recordings.
    """
    with torch.device("meta"):  # shapes alone, without memory for the values
        weights = parameter_count(HeadingNet(model))
    own = _WEIGHT * weights
    machine.require_memory("model.hidden", model.hidden, own, f"a network of {weights} weights")
    directions = 2 if model.cell in RECURRENT else 1
    inside = model.layers * model.hidden * directions * (_KEPT if model.cell != "pool" else 1)
    a_window = _VALUE * longest * (12.0 * model.features + inside)
    machine.require_memory("batch", batch, own + batch * a_window, "a batch")
    if model.output == "vonmises":
        last = own + tempering * a_window / _KEPT
        machine.require_memory("tempering", tempering, last, "the calibration of sigma")
    stored = 16.0 * 7 * means
    machine.require_memory("mean_s", means, own + stored, "all recordings' means together")
    operations = 6.0 * weights * batch * (longest if model.cell in RECURRENT else 4)
    machine.told(own + stored + batch * a_window, steps * operations / _OPERATIONS_PER_S)
