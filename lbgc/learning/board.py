"""A training's metrics as TensorBoard's event files."""

from collections.abc import Mapping
from pathlib import Path

from lbgc.errors import InputError


def write(directory: Path, row: Mapping[str, float]) -> None:
    """Write the metrics of one look at the validation split, a row of the history, to a directory.
    Raises InputError where TensorBoard is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        what = "needs TensorBoard: python -m pip install 'lbgc[tensorboard]' brings it"
        raise InputError("tensorboard", True, "", what) from error
    with SummaryWriter(str(directory)) as writer:
        for name, value in row.items():
            if name != "step":
                writer.add_scalar(name, value, int(row["step"]))
