"""Models that somebody brought, their checksums made to fit: nothing runs, and nothing grows, that
lbgc would not have written."""

import json
import resource

import numpy as np
import pytest
import torch
from fuzzing import model_files, tiny_trainer
from safetensors.torch import save

from lbgc.errors import InputError, build
from lbgc.learning import checkpoint, description, onnx_graph, tensors
from lbgc.learning.estimator import WEIGHTS, Learned
from lbgc.learning.model import ModelConfig
from lbgc.outputs import UNSEALED, as_json, seal

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
from onnx import TensorProto, helper, numpy_helper  # noqa: E402

from lbgc.learning import onnx as ours  # noqa: E402

PROPERTY = "lbgc_checksum"


@pytest.fixture(scope="module")
def content() -> bytes:
    """A small graph of the form of ours, with the description of a network of ours; that those
    which are exported are taken too, test_export.py holds."""
    said = json.loads(model_files()[description.DESCRIPTION])
    width = build(ModelConfig, said["model"]).features
    graph = helper.make_graph(
        [
            helper.make_node("ReduceSum", ["features", "time"], ["sums"], keepdims=0),
            helper.make_node("Gemm", ["sums", "weights", "none"], ["both"]),
            helper.make_node("Split", ["both"], ["one", "other"], axis=1, num_outputs=2),
            helper.make_node("Squeeze", ["one", "time"], ["heading"]),
            helper.make_node("Squeeze", ["other", "time"], ["sigma"]),
        ],
        "network",
        [helper.make_tensor_value_info("features", TensorProto.FLOAT, ["w", "s", width])],
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, ["w"]) for n in ("heading", "sigma")],
        [
            numpy_helper.from_array(np.array([1]), "time"),
            numpy_helper.from_array(np.ones((width, 2), np.float32), "weights"),
            numpy_helper.from_array(np.zeros(2, np.float32), "none"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)
    helper.set_model_props(model, {"lbgc": as_json(said), PROPERTY: UNSEALED})
    return sealed(model)


def sealed(model: "onnx.ModelProto") -> bytes:
    """With the checksum that a forger would give it."""
    for entry in model.metadata_props:
        if entry.key == PROPERTY:
            entry.value = UNSEALED
    return seal(model.SerializeToString())


def answered(content: bytes) -> np.ndarray:
    """The headings of three windows."""
    learned = ours.parse(content, "x.onnx")
    return learned.compute(np.ones((3, 8, learned.config.features), np.float32))[0]


def test_what_we_write_is_taken(content):
    heading = answered(content)
    assert heading.shape == (3,)
    assert np.array_equal(answered(sealed(onnx.load_model_from_string(content))), heading)


def _graph_attribute(model):
    inner = helper.make_graph([], "inner", [], [])
    model.graph.node[0].attribute.append(helper.make_attribute("body", inner))


def _loop(model):
    inner = helper.make_graph([], "inner", [], [])
    model.graph.node.append(helper.make_node("Loop", ["", ""], ["q"], body=inner))


def _if(model):
    inner = helper.make_graph([], "inner", [], [])
    node = helper.make_node("If", ["a"], ["q"], then_branch=inner, else_branch=inner)
    model.graph.node.append(node)


def _operator(name, domain=""):
    def change(model):
        model.graph.node.append(helper.make_node(name, ["features"], ["q"], domain=domain))

    return change


def _outside(model):
    own = model.graph.initializer[0]
    own.ClearField("raw_data")
    own.data_location = TensorProto.EXTERNAL
    entry = own.external_data.add()
    entry.key, entry.value = "location", "../../../../etc/passwd"


def _outside_in_a_constant(model):
    value = numpy_helper.from_array(np.ones(3, np.float32))
    value.data_location = TensorProto.EXTERNAL
    model.graph.node.append(helper.make_node("Constant", [], ["q"], value=value))


def _input_name(model):
    model.graph.input[0].name = "feature"


def _another_input(model):
    model.graph.input.append(helper.make_tensor_value_info("more", TensorProto.FLOAT, [1]))


def _output_name(model):
    model.graph.output[0].name = "headings"


def _output_order(model):
    both = list(model.graph.output)[::-1]
    del model.graph.output[:]
    model.graph.output.extend(both)


def _features(model):
    model.graph.input[0].type.tensor_type.shape.dim[2].dim_value = 10**9


def _fixed(model):
    model.graph.input[0].type.tensor_type.shape.dim[0].dim_value = 10**9


def _doubles(model):
    model.graph.input[0].type.tensor_type.elem_type = TensorProto.DOUBLE


def _nodes(model):
    node = helper.make_node("Abs", ["features"], ["q"])
    model.graph.node.extend([node] * 400)


def _function(model):
    node = helper.make_node("Abs", ["a"], ["b"])
    own = helper.make_function("mine", "f", ["a"], ["b"], [node], [helper.make_opsetid("", 20)])
    model.functions.append(own)


def _domain(model):
    model.opset_import.append(helper.make_opsetid("com.microsoft", 1))


def _sparse(model):
    model.graph.sparse_initializer.add()


def _shape(model):
    model.graph.initializer[0].dims[:] = [10**6, 10**6]


def _negative(model):
    model.graph.initializer[0].dims[:] = [-1, -1]


def _strings(model):
    model.graph.initializer.append(helper.make_tensor("s", TensorProto.STRING, [1], [b"x"]))


def _no_description(model):
    for entry in model.metadata_props:
        entry.value = "{}" if entry.key == "lbgc" else entry.value


def _deep(model):
    for entry in model.metadata_props:
        entry.value = "[" * 10**5 if entry.key == "lbgc" else entry.value


def _large(model):
    for entry in model.metadata_props:
        if entry.key == "lbgc":
            said = json.loads(entry.value)
            said["model"] |= {"hidden": 10**9}
            entry.value = json.dumps(said)


def _empty_messages(field):
    """Very many of two bytes each."""

    def change(model):
        model.graph.MergeFromString(bytes([field << 3 | 2, 0]) * 70_000)

    return change


def _constant_of_nothing(model):
    model.graph.node.append(helper.make_node("Constant", [], ["q"], value=TensorProto()))


FORGERIES = {
    "a graph as attribute": _graph_attribute, "a loop": _loop, "a condition": _if,
    "Scan": _operator("Scan"), "SequenceMap": _operator("SequenceMap"),
    "Tile": _operator("Tile"), "Resize": _operator("Resize"), "OneHot": _operator("OneHot"),
    "another domain": _operator("Inverse", "com.microsoft"), "a name of none": _operator("Evil"),
    "ours of another domain": _operator("Abs", "evil"), "a domain": _domain,
    "numbers outside": _outside, "a constant outside": _outside_in_a_constant,
    "the input's name": _input_name, "another input": _another_input,
    "an output's name": _output_name, "outputs swapped": _output_order,
    "too many features": _features, "a fixed size": _fixed, "doubles": _doubles,
    "many nodes": _nodes, "a function": _function, "a sparse tensor": _sparse,
    "a shape": _shape, "a negative shape": _negative, "strings": _strings,
    "no description": _no_description, "a deep description": _deep, "a large network": _large,
    "empty nodes": _empty_messages(1), "empty tensors": _empty_messages(5),
    "empty values": _empty_messages(13), "empty outputs": _empty_messages(12),
    "a constant of nothing": _constant_of_nothing,
}  # fmt: skip


@pytest.mark.parametrize("forgery", FORGERIES)
def test_a_forged_graph_is_refused_before_it_runs(content, forgery, monkeypatch):
    """Before ONNX Runtime sees it."""
    model = onnx.load_model_from_string(content)
    FORGERIES[forgery](model)
    monkeypatch.setattr("onnxruntime.InferenceSession", lambda *_, **__: pytest.fail("it was run"))
    with pytest.raises(InputError, match="holds no model of lbgc's") as refused:
        ours.parse(sealed(model), "x.onnx")
    assert len(str(refused.value)) < 1000


def _doubling(model):
    for i in range(40):
        before = "features" if i == 0 else f"q{i - 1}"
        model.graph.node.append(helper.make_node("Concat", [before] * 2, [f"q{i}"], axis=1))
    return "q39"


def _expanding(model):
    model.graph.initializer.append(numpy_helper.from_array(np.array([10**7, 1, 1, 1]), "huge"))
    model.graph.node.append(helper.make_node("Expand", ["features", "huge"], ["q"]))
    return "q"


def _counting(model):
    for name, value in (("a", 0.0), ("b", 1e10), ("c", 1.0)):
        own = numpy_helper.from_array(np.float32(value), name)
        model.graph.initializer.append(own)
    model.graph.node.append(helper.make_node("Range", ["a", "b", "c"], ["q"]))
    return "q"


def _filling(model):
    model.graph.initializer.append(numpy_helper.from_array(np.array([10**11]), "huge"))
    model.graph.node.append(helper.make_node("ConstantOfShape", ["huge"], ["q"]))
    return "q"


def _squaring(model):
    for i in range(20):
        before = "features" if i == 0 else f"q{i - 1}"
        one, two = f"one{i}", f"two{i}"
        model.graph.initializer.append(numpy_helper.from_array(np.array([-1, 1]), one))
        model.graph.initializer.append(numpy_helper.from_array(np.array([1, -1]), two))
        model.graph.node.extend([
            helper.make_node("Reshape", [before, one], [f"r{i}"]),
            helper.make_node("Reshape", [before, two], [f"s{i}"]),
            helper.make_node("Add", [f"r{i}", f"s{i}"], [f"q{i}"]),
        ])  # fmt: skip
    return "q19"


GROWING = {"doubling": _doubling, "expanding": _expanding, "counting": _counting,
           "filling": _filling, "squaring": _squaring}  # fmt: skip


@pytest.mark.parametrize("bomb", GROWING)
def test_what_grows_without_end_is_stopped(content, bomb):
    """Every operator is one of ours; what they make together is not to be told from the graph."""
    model = onnx.load_model_from_string(content)
    last = GROWING[bomb](model)
    mean = helper.make_node("ReduceSum", [last], ["grown"], keepdims=0)
    model.graph.node.append(mean)
    (heading,) = (n for n in model.graph.node if "heading" in n.output)
    heading.output[0] = "before"
    model.graph.node.append(helper.make_node("Add", ["before", "grown"], ["heading"]))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=r"x\.onnx: (does not answer|holds no model)"):
        answered(sealed(model))
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert after - before < 2.5e6  # kB


def test_an_answer_of_another_shape_is_refused(content):
    model = onnx.load_model_from_string(content)
    (heading,) = (n for n in model.graph.node if "heading" in n.output)
    heading.output[0] = "before"
    model.graph.node.append(helper.make_node("Concat", ["before"] * 2, ["heading"], axis=0))
    with pytest.raises(InputError, match="does not answer"):
        answered(sealed(model))


def test_a_batch_is_answered_in_parts(content, monkeypatch):
    learned = ours.parse(content, "x")
    values = np.random.default_rng(1).normal(size=(50, 8, learned.config.features))
    whole = learned.compute(values.astype(np.float32))[0]
    monkeypatch.setattr(ours, "_VALUES_AT_ONCE", 7 * values[0].size)
    parts = learned.compute(values.astype(np.float32))[0]
    np.testing.assert_allclose(parts, whole, atol=1e-4)
    assert learned.compute(values[:0].astype(np.float32))[0].shape == (0,)


@pytest.mark.parametrize("size", [2**26 + 1])
def test_a_file_too_large_is_not_read(tmp_path, size):
    file = tmp_path / "x.onnx"
    with file.open("wb") as opened:
        opened.truncate(size)
    with pytest.raises(InputError, match="bytes, and 67108864 are the most"):
        ours.load(file)


def test_every_operator_of_ours_is_one_of_onnx():
    known = {schema.name for schema in onnx.defs.get_all_schemas() if schema.domain == ""}
    assert known >= onnx_graph.OPERATORS
    looping = {"Loop", "If", "Scan", "SequenceMap"}
    assert not looping & onnx_graph.OPERATORS


def test_protocol_buffers_that_are_none_are_refused():
    for bad in (
        b"\x3a",
        b"\x3a\xff\xff\xff\xff\x0f",
        b"\xff" * 20,
        b"\x3b",
        b"\x08",
        b"\x3a\x02\x0a\x05",
    ):
        with pytest.raises(ValueError, match="damaged field"):
            onnx_graph.require_small(bad)
    onnx_graph.require_small(b"")


# --- weights and checkpoints ----------------------------------------------------------------------


def with_header(header: bytes, rest: bytes = b"") -> bytes:
    return len(header).to_bytes(8, "little") + header + rest


def one(kind: str, shape: list[int], size: int, names: str = "a") -> bytes:
    told = {"dtype": kind, "shape": shape, "data_offsets": [0, size]}
    return with_header(json.dumps(dict.fromkeys(names, told)).encode(), bytes(size))


SAFETENSORS = {
    "nothing": b"", "a short one": b"\x01" * 7, "no header": bytes(8),
    "a header of 16 EB": b"\xff" * 8 + b"{}", "a header of 2 GB": (2**31).to_bytes(8, "little"),
    "a header longer than the file": (100).to_bytes(8, "little") + b"{}",
    "a long header": with_header(b"{}" + b" " * 2**20),
    "no JSON": with_header(b"\xff\xfe\x00"), "a deep one": with_header(b'{"a":' * 10**5),
    "a tensor of 4 EB": one("F32", [2**30, 2**30], 4), "holes": one("F32", [1], 4) + b"more",
    "more than 2^64 numbers": one("F32", [2**32] * 3, 0), "negative": one("F32", [-1], 4),
    "twice the same": one("F32", [1], 4, names="ab"), "a kind of none": one("F999", [1], 4),
}  # fmt: skip


@pytest.mark.parametrize("kind", SAFETENSORS)
def test_weights_of_nonsense_are_refused(kind):
    with pytest.raises(Exception) as refused:  # noqa: PT011 whatever safetensors says of it
        tensors.parse(SAFETENSORS[kind])
    assert not isinstance(refused.value, MemoryError)


@pytest.fixture
def run(tmp_path):
    files = model_files()
    home = tmp_path / "run"
    home.mkdir()
    for name, content in files.items():
        (home / name).write_bytes(content)
    return home


def forged(run, weights: bytes) -> None:
    """A run whose checksums are made to fit these weights."""
    (run / WEIGHTS).write_bytes(weights)
    said = json.loads((run / description.DESCRIPTION).read_bytes())
    said = {k: v for k, v in said.items() if k not in ("format", "weights", "checksum")}
    (run / description.DESCRIPTION).write_bytes(description.compose(said, weights))


@pytest.mark.parametrize("kind", SAFETENSORS)
def test_a_run_of_nonsense_is_refused(run, kind):
    forged(run, SAFETENSORS[kind])
    with pytest.raises(InputError, match="holds a damaged model"):
        Learned.load(run)


@pytest.mark.parametrize("kind", [torch.float64, torch.float16, torch.int32, torch.bool])
def test_weights_are_of_one_kind(run, kind):
    weights = tensors.parse((run / WEIGHTS).read_bytes())
    forged(run, save({name: value.to(kind) for name, value in weights.items()}))
    with pytest.raises(InputError, match="holds another network's"):
        Learned.load(run)


def test_a_file_larger_than_its_network_is_not_read(run):
    with (run / WEIGHTS).open("r+b") as file:
        file.truncate(2**40)
    with pytest.raises(InputError, match=r"bytes, and \d+ are the most"):
        Learned.load(run)
    with (run / description.DESCRIPTION).open("r+b") as file:
        file.truncate(2**40)
    with pytest.raises(InputError, match="1048576 are the most"):
        Learned.load(run)


@pytest.mark.parametrize("kind", SAFETENSORS)
def test_a_checkpoint_of_nonsense_is_refused(tmp_path, kind):
    file = tmp_path / "checkpoint.safetensors"
    file.write_bytes(SAFETENSORS[kind])
    with pytest.raises(InputError, match="is damaged; delete it to start anew"):
        checkpoint.read(file)


def test_a_checkpoint_too_large_is_not_read(tmp_path):
    file = tmp_path / "checkpoint.safetensors"
    with file.open("wb") as opened:
        opened.truncate(2**40)
    with pytest.raises(InputError, match="4294967296 are the most"):
        checkpoint.read(file)


def test_a_checkpoint_of_other_kinds_of_numbers_is_refused(tmp_path):
    file = tmp_path / "checkpoint.safetensors"
    tiny_trainer().run(file, lambda _: None)
    groups, said = checkpoint.read(file)
    best = {name: value.double() for name, value in groups["best"].items()}
    checkpoint.write(file, groups | {"best": best}, said)
    with pytest.raises(InputError, match="is of another training"):
        tiny_trainer().run(file, lambda _: None)
