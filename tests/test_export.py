"""ONNX: the same answers as PyTorch, at any batch and window length."""

import sys

import numpy as np
import pytest
from helpers import composed, default_config, generate

import lbgc.export
import lbgc.train
from lbgc.data.windows import stack
from lbgc.errors import InputError
from lbgc.export import ExportConfig
from lbgc.learning import onnx
from lbgc.learning.estimator import Learned
from lbgc.train import TrainConfig


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    home = tmp_path_factory.mktemp("export")
    config = default_config("protocol=static")
    data = generate(home / "d.zarr", protocol=config.protocol, recordings=20, duration_s=30.0,
                    output="means", split=[50, 50, 0])  # fmt: skip
    return data, home


@pytest.mark.filterwarnings("ignore")  # the exporter's own
@pytest.mark.parametrize(
    "model", ["residual", "bilstm_8", "gru_24", "rnn_24", "rnn_24 model.output=vonmises"]
)
def test_it_answers_as_pytorch_does(small, monkeypatch, model):
    for package in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(package)
    data, home = small
    monkeypatch.chdir(home)
    options = (f"data={data.path}", "steps=5", "validate_every=5", "batch=8")
    options += tuple(f"model={model}".split())
    run = lbgc.train.main(composed(TrainConfig, "train", *options, "windows_s=[10]"))
    file = lbgc.export.main(ExportConfig(run=str(run)))
    windows = stack(data.records(np.arange(20)), 0.2).windows
    ours, theirs = Learned.load(run)(windows), onnx.load(file)(windows)
    np.testing.assert_allclose(theirs.heading, ours.heading, atol=1e-5)
    np.testing.assert_allclose(theirs.sigma, ours.sigma, atol=1e-5)


def test_what_to_install_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(InputError, match=r"pip install 'lbgc\[onnx\]'"):
        onnx.load("anything.onnx")
