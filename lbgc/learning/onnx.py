"""A trained network as ONNX: features in, heading and sigma out, any batch and window length."""

import io
import json
import logging
import math
import re
import warnings
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from lbgc.errors import InputError, reading
from lbgc.learning import description, onnx_graph
from lbgc.learning.estimator import Learned
from lbgc.learning.model import HeadingNet, von_mises_sigma
from lbgc.outputs import UNSEALED, as_json, is_sealed, read_file, seal, write_atomically

INPUT, OUTPUTS = "features", ("heading", "sigma")
_SAID, _SEALED = "lbgc", "lbgc_checksum"
_OWN = re.compile(_SEALED.encode() + rb"\x12\x40([0-9a-f]{64})")
_EXAMPLE = (3, 7)
"""Numbers of windows and samples that the graph is traced with: they are not 1 and differ, so that
both stay free."""
_FREE = ("windows", "samples")
_OPSET = 18
_NONE = "holds no model of lbgc's"
_MOST_BYTES = 2**26
"""Largest size of a file."""
_MOST_MEMORY = 2**31
"""Bytes that a graph's values may take while it is run."""
_VALUES_AT_ONCE = 2**21
"""Features that are given at once."""


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
    """Write a network to an ONNX file, as `compose` has it."""
    write_atomically(file, compose(net, said))


def compose(net: HeadingNet, said: Mapping[str, Any]) -> bytes:
    """A network as the content of an ONNX file. said : the run's description, which it carries in
    its metadata. Raises InputError where the packages for it are missing."""
    onnx = _needed("onnx")
    _needed("onnxscript")
    graph, x = _Graph(net).eval(), torch.zeros(*_EXAMPLE, net.config.features)
    names: dict[str, Any] = {"input_names": [INPUT], "output_names": list(OUTPUTS)}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    torch.compiler.reset()  # after another network's it would fix this one's window length
    with warnings.catch_warnings(action="ignore"):
        if net.config.cell == "rnn":  # the export below would fix it to one window length
            made = io.BytesIO()
            torch.onnx.export(graph, (x,), made, dynamo=False, opset_version=_OPSET,  # type: ignore[arg-type]
                              dynamic_axes={INPUT: dict(enumerate(_FREE))}, **names)  # fmt: skip
            model = onnx.load_model_from_string(made.getvalue())
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
    return seal(model.SerializeToString())


def load(file: str | Path, threads: int = 0) -> Learned:
    """An exported network as an estimator, run by ONNX Runtime.

    threads : number of threads; 0: as many as ONNX Runtime chooses. Raises InputError where the
    file is missing, damaged, or none of lbgc's, or where ONNX Runtime is not installed.
    """
    _needed("onnxruntime")
    if not Path(file).is_file():
        raise InputError("file", file, "", "is not there; python lbgc/export.py run=RUN makes one")
    with reading("file", file, _NONE):
        content = read_file(Path(file), _MOST_BYTES)
    return parse(content, file, threads)


def parse(content: bytes, where: object, threads: int = 0) -> Learned:
    """An estimator from the content of an ONNX file; see `load`. where : the file as an error names
    it."""
    onnx, runtime = _needed("onnx"), _needed("onnxruntime")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.use_env_allocators", "1")
    with reading("file", where, _NONE):
        # The checksum is compared before any other part of the file is read. _OWN finds it there by
        # the protocol buffer's tag and length that stand before its value.
        if len(content) > _MOST_BYTES:
            raise ValueError(f"{len(content)} bytes, and {_MOST_BYTES} are the most")
        own = _OWN.search(content)
        if own is None or not is_sealed(content, own[1].decode()):
            raise ValueError("it is not as python lbgc/export.py wrote it")
        onnx_graph.require_small(content)
        model = onnx.load_model_from_string(content)
        said = json.loads({entry.key: entry.value for entry in model.metadata_props}[_SAID])
        config = description.whole(said).model
        said["model"] = vars(config)
        onnx_graph.require_ours(model, config, INPUT, OUTPUTS)
        _limit_memory(runtime)
        session = runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])

    def compute(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The headings and sigmas, (W,) each, of features (W, T, C), some windows at a time."""
        some = max(1, _VALUES_AT_ONCE // max(1, math.prod(x.shape[1:])))
        found: list[list[np.ndarray]] = [[], []]
        with reading("file", where, "does not answer"):
            for first in range(0, max(1, len(x)), some):
                part = x[first : first + some]
                for into, values in zip(found, session.run(OUTPUTS, {INPUT: part}), strict=True):
                    if values.shape != (len(part),):
                        raise ValueError(f"an answer of shape {values.shape}")
                    into.append(values.astype(np.float64))
            heading, sigma = (np.concatenate(values) for values in found)
            return heading, sigma

    return Learned.described(config, compute, said)


@cache
def _limit_memory(runtime: Any) -> None:
    """Give ONNX Runtime's sessions one store of memory, with a limit: what a graph's operators make
    of their inputs cannot be told from the graph alone."""
    where = runtime.OrtMemoryInfo(
        "Cpu", runtime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, runtime.OrtMemType.DEFAULT
    )
    as_needed = {"arena_extend_strategy": 1, "initial_chunk_size_bytes": -1}
    limits = {"max_mem": _MOST_MEMORY, "max_dead_bytes_per_chunk": -1, **as_needed}
    runtime.create_and_register_allocator(where, runtime.OrtArenaCfg(limits))


def _needed(package: str) -> Any:
    """The module of an optional package. Raises InputError where it is not installed."""
    try:
        return __import__(package)
    except ImportError as error:
        what = "is not installed: python -m pip install 'lbgc[onnx]' (or onnx onnxscript "
        raise InputError("package", package, "", what + "onnxruntime) brings it") from error
