"""Write a trained network as ONNX, and check it against PyTorch.

python lbgc/export.py run=RUN
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lbgc.commands import run_main
from lbgc.errors import InputError, reading, require
from lbgc.learning import onnx
from lbgc.learning.estimator import compute_torch, load_net
from lbgc.outputs import write_atomically
from lbgc.sensor import streams

AGREES = 1e-5
"""Largest difference, rad, between the answers of ONNX Runtime and of PyTorch."""
_SHAPES = ((1, 2), (5, 12), (2, 48))  # numbers of windows and samples


@dataclass(frozen=True)
class ExportConfig:
    """The keys of `conf/export.yaml`."""

    run: str | None = None
    """A training run's directory."""
    out: str | None = None
    """The file; null: model.onnx in the run's directory."""

    def __post_init__(self) -> None:
        require(bool(self.run), "run", self.run, "must be a training run's directory")


def main(config: ExportConfig) -> Path:
    """Export, compare with PyTorch at several batches and lengths, and return the file's path.

    Raises InputError where the two differ by more than 1e-5 rad.
    """
    assert config.run is not None
    net, said = load_net(config.run)
    file = Path(config.out or Path(config.run) / "model.onnx")
    content = onnx.compose(net, said)
    exported = onnx.parse(content, file)
    rng = streams.figures()
    worst = 0.0
    for windows, samples in _SHAPES:
        size = 0.1 * np.ones(net.config.features)
        x = (size * rng.standard_normal((windows, samples, len(size)))).astype(np.float32)
        with reading("run", config.run, "cannot be run as ONNX"):
            found = exported.compute(x)
        for ours, theirs in zip(compute_torch(net, x), found, strict=True):
            worst = max(worst, float(np.nanmax(np.abs(ours - theirs), initial=0.0)))
    if worst > AGREES:
        raise InputError("run", config.run, "", f"differs by {worst:.2g} rad as ONNX")
    write_atomically(file, content)
    print(f"ONNX Runtime and PyTorch agree to {worst:.1g} rad")
    return file


if __name__ == "__main__":
    run_main(main, ExportConfig, "export")
