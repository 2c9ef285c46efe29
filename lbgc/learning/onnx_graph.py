"""The graphs that lbgc takes of an ONNX file: those of the form in which it writes them.

An ONNX file is a program, of a language that has loops, files of its own beside it, and operators
that grow without end. A network of ours needs none of these.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from lbgc.learning.model import ModelConfig

OPERATORS = {
    "Abs", "Add", "Atan", "Cast", "Clip", "Concat", "Constant", "ConstantOfShape", "Div",
    "Exp", "Expand", "Flatten", "GRU", "Gather", "Gemm", "Greater", "Identity", "IsNaN",
    "LSTM", "Less", "Log", "MatMul", "Max", "Mul", "Neg", "Pow", "RNN", "Range", "Reciprocal",
    "ReduceMean", "ReduceSum", "Reshape", "Shape", "Sin", "Slice", "Split", "Sqrt", "Squeeze",
    "Sub", "Tanh", "Transpose", "Unsqueeze", "Where",
}  # fmt: skip
"""The operators that the networks of `conf/model/` are written with."""
_NODES, _NODES_A_LAYER = 300, 30
"""Largest number of nodes, and how many more each layer may have."""
_ATTRIBUTES = {"FLOAT", "INT", "STRING", "TENSOR", "FLOATS", "INTS", "STRINGS"}
"""Kinds of attributes; others are graphs, which loops and conditions run."""
_GRAPH, _INITIALIZER = 7, 5
"""Numbers of fields: of a model's graph, and of a graph's stored tensors."""
_FIXED = {1: 8, 5: 4}
"""Sizes of the kinds of fields that have one."""
_OVERHEAD = 16
"""Bytes that a field takes in memory beside its content, at least."""
_MOST_BESIDE = 2**20
_BYTES = {"FLOAT": 4, "INT64": 8, "BOOL": 1}
"""Kinds of numbers that are stored, and the size of each."""


def require_small(content: bytes) -> None:
    """Raise ValueError unless a file has few bytes beside the numbers that it stores: what is made
    of an empty message of two bytes takes a hundred in memory."""
    beside = 0
    for number, part in _fields(memoryview(content)):
        beside += _OVERHEAD + (0 if number == _GRAPH else len(part))
        for own, inner in _fields(part) if number == _GRAPH else ():
            beside += _OVERHEAD + (0 if own == _INITIALIZER else len(inner))
            _require(beside <= _MOST_BESIDE, f"more than {_MOST_BESIDE} bytes beside its numbers")
        _require(beside <= _MOST_BESIDE, f"more than {_MOST_BESIDE} bytes beside its numbers")


def _fields(content: memoryview) -> Iterator[tuple[int, memoryview]]:
    """The fields of a protocol buffer: their numbers, and their content as it is stored."""
    at = 0
    while at < len(content):
        tag, at = _varint(content, at)
        kind, size = tag & 7, 0
        _require(kind in (*_FIXED, 0, 2), "a damaged field")
        if kind == 0:
            _, end = _varint(content, at)
        elif kind == 2:
            size, at = _varint(content, at)
            end = at + size
        else:
            end = at + _FIXED[kind]
        _require(end <= len(content), "a damaged field")
        yield tag >> 3, content[at:end]
        at = end


def _varint(content: memoryview, at: int) -> tuple[int, int]:
    """A whole number of a protocol buffer, and where it ends."""
    value = 0
    for place in range(10):
        _require(at + place < len(content), "a damaged field")
        byte = content[at + place]
        value |= (byte & 127) << 7 * place
        if byte < 128:
            return value, at + place + 1
    raise ValueError("it has a damaged field")


def require_ours(model: Any, config: ModelConfig, given: str, asked: Sequence[str]) -> None:
    """Raise ValueError unless an ONNX model is of the form in which lbgc writes a network.

    model : the protocol buffer as the package onnx reads it; given : the input's name; asked : the
    outputs' names, in order.
    """
    graph = model.graph
    most = _NODES + _NODES_A_LAYER * config.layers
    _require(len(graph.node) <= most, f"{len(graph.node)} nodes, and {most} are the most")
    _require([own.name for own in graph.input] == [given], f"another input than {given}")
    _require([own.name for own in graph.output] == list(asked), f"other outputs than {asked}")
    kind = graph.input[0].type.tensor_type
    sizes = kind.shape.dim
    free = len(sizes) == 3 and not any(size.HasField("dim_value") for size in sizes[:2])
    right = free and kind.elem_type == 1 and sizes[2].dim_value == config.features
    _require(right, f"an input that is not (windows, samples, {config.features}) of float32")
    for what in ("functions", "training_info"):
        _require(not len(getattr(model, what)), f"{what} of its own")
    _require(not len(graph.sparse_initializer), "sparse tensors")
    _require({own.domain for own in model.opset_import} == {""}, "operators that are not ONNX's")
    _require_stored(graph.initializer)
    for node in graph.node:
        _require_operator(node)


def _require_operator(node: Any) -> None:
    """Raise ValueError unless a node is an operator that lbgc writes."""
    known = node.domain == "" and node.op_type in OPERATORS
    _require(known, f"the operator {node.domain or 'ONNX'}.{node.op_type}")
    for attribute in node.attribute:
        kind = attribute.AttributeType.Name(attribute.type)
        plain = kind in _ATTRIBUTES and not attribute.ref_attr_name
        _require(plain, f"an attribute of kind {kind}")
        _require_stored([attribute.t] if kind == "TENSOR" else [])


def _require_stored(tensors: Iterable[Any]) -> None:
    """Raise ValueError unless tensors hold as many numbers as their shapes say, in the file
    itself."""
    for tensor in tensors:
        kind = tensor.DataType.Name(tensor.data_type)
        _require(kind in _BYTES, f"numbers of kind {kind}")
        outside = tensor.data_location or len(tensor.external_data) or tensor.HasField("segment")
        _require(not outside, "numbers in another file")
        count = math.prod(tensor.dims)
        listed = {"FLOAT": tensor.float_data, "INT64": tensor.int64_data, "BOOL": tensor.int32_data}
        held = len(tensor.raw_data) / _BYTES[kind] + len(listed[kind])
        whole = min(tensor.dims, default=0) >= 0 and held == count
        _require(whole, f"a tensor of shape {list(tensor.dims)[:8]} with {held:g} numbers")


def _require(condition: bool, otherwise: str) -> None:
    """Raise ValueError unless the condition holds."""
    if not condition:
        raise ValueError(f"it has {otherwise}")
