"""A trained network as ONNX: features in, heading and sigma out, any batch and window length."""

import json
import logging
import math
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from lbgc.errors import InputError, build, reading
from lbgc.learning.estimator import Learned
from lbgc.learning.model import HeadingNet, ModelConfig, von_mises_sigma
from lbgc.outputs import UNSEALED, as_json, is_sealed, seal

INPUT, OUTPUTS = "features", ("heading", "sigma")
_SAID, _SEALED = "lbgc", "lbgc_checksum"
_OWN = re.compile(_SEALED.encode() + rb"\x12\x40([0-9a-f]{64})")
_EXAMPLE = (3, 7)
"""Numbers of windows and samples that the graph is traced with: they are not 1 and differ, so that
both stay free."""
_FREE = ("windows", "samples")
_OPSET = 18


class _Graph(nn.Module):
    """The graph that is exported: features (W, T, C) to the heading less the base's and its sigma,
    rad, (W,) each; the sigma is NaN for a network that states none."""

    def __init__(self, net: HeadingNet):
        super().__init__()
        self.net = net

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        raw = self.net(x)
        heading = self.net.heading_deg(raw) * (math.pi / 180)
        if self.net.config.output != "vonmises":
            return heading, heading * float("nan")
        return heading, von_mises_sigma(self.net.log_kappa(raw))


def write(net: HeadingNet, said: Mapping[str, Any], file: Path) -> None:
    """Write a network to an ONNX file. said : the run's description, which the file carries in its
    metadata. Raises InputError where the packages for it are missing."""
    onnx = _needed("onnx")
    _needed("onnxscript")
    graph, x = _Graph(net).eval(), torch.zeros(*_EXAMPLE, net.config.features)
    names: dict[str, Any] = {"input_names": [INPUT], "output_names": list(OUTPUTS)}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings(action="ignore"):
        if net.config.cell == "rnn":  # the export below would fix it to one window length
            torch.onnx.export(graph, (x,), file, dynamo=False, opset_version=_OPSET,
                              dynamic_axes={INPUT: dict(enumerate(_FREE))}, **names)  # fmt: skip
            model = onnx.load(file)
        else:
            free = {0: torch.export.Dim(_FREE[0]), 1: torch.export.Dim(_FREE[1], min=2)}
            program = torch.onnx.export(graph, (x,), dynamic_shapes=(free,), dynamo=True,
                                        verbose=False, **names)  # fmt: skip
            assert program is not None
            model = program.model_proto
    for key, value in ((_SAID, as_json(said)), (_SEALED, UNSEALED)):
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.checker.check_model(model)
    file.write_bytes(seal(model.SerializeToString()))


def load(file: str | Path, threads: int = 0) -> Learned:
    """An exported network as an estimator, run by ONNX Runtime.

    threads : number of threads; 0: as many as ONNX Runtime chooses. Raises InputError where the
    file is missing, damaged, or none of lbgc's, or where ONNX Runtime is not installed.
    """
    runtime = _needed("onnxruntime")
    if not Path(file).is_file():
        raise InputError("file", file, "", "is not there; python lbgc/export.py run=RUN makes one")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = threads
    with reading("file", file, "holds no model of lbgc's"):
        content = Path(file).read_bytes()
        # The checksum is compared before ONNX Runtime sees any of the file. _OWN finds it there by
        # the protocol buffer's tag and length that stand before its value.
        own = _OWN.search(content)
        if own is None or not is_sealed(content, own[1].decode()):
            raise ValueError("it is not as python lbgc/export.py wrote it")
        session = runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        said = json.loads(session.get_modelmeta().custom_metadata_map[_SAID])

    def compute(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heading, sigma = session.run(None, {INPUT: x})
        return heading.astype(np.float64), sigma.astype(np.float64)

    return Learned.described(build(ModelConfig, said["model"]), compute, said)


def _needed(package: str) -> Any:
    """The module of an optional package. Raises InputError where it is not installed."""
    try:
        return __import__(package)
    except ImportError as error:
        what = "is not installed: python -m pip install 'lbgc[onnx]' (or onnx onnxscript "
        raise InputError("package", package, "", what + "onnxruntime) brings it") from error
