"""Nothing that was recorded has changed; see recording.py. `make golden` records it anew, and a
line of the CHANGELOG says why. (Help texts are compared where all commands run: test_architecture.)
"""

import json

import numpy as np
import pytest
import recording

from lbgc.learning import pretrained
from lbgc.learning.description import DESCRIPTION, compose, parse

ANSWERS = json.loads(recording.ANSWERS.read_text())
RELATIVE = 1e-6  # what another processor's order of sums changes in a search for the best heading
LEARNED = 1e-4  # PyTorch reckons with single precision, in an order of its own choosing


@pytest.mark.parametrize("name", recording.DATASETS)
def test_datasets_have_the_bytes_they_had(name, tmp_path):
    own = recording.arithmetic()
    recorded = json.loads(recording.DIGESTS.read_text())
    if own not in recorded:
        pytest.skip(f"no digests are recorded for this machine's arithmetic, {own}: make golden")
    assert recording.digest(name, tmp_path) == recorded[own][name]


@pytest.mark.parametrize("name", recording.SITUATIONS)
def test_estimators_answer_what_they_answered(name):
    found, before = recording.answers(name), ANSWERS[name]
    assert found.keys() == before.keys()
    for who, own in before.items():
        if isinstance(own, str):
            assert found[who] == own
            continue
        learned = who.endswith("pretrained")
        for key, values in own.items():
            was, now = np.array(values, float), np.array(found[who][key], float)
            scale = LEARNED if learned else RELATIVE
            tolerance = scale * np.maximum(np.abs(was), 1.0 if key == "heading" else 0.0)
            same = np.isnan(was) & np.isnan(now) | (np.abs(now - was) <= tolerance)
            assert same.all(), f"{who}'s {key}: {was} became {now}"


def test_models_that_were_written_are_written_so_today():
    assert recording.models() == json.loads(recording.MODELS.read_text())
    for file in pretrained.DIRECTORY.glob(f"*/{DESCRIPTION}"):
        said = parse(file.read_bytes(), "model", file)
        weights = file.with_name("model.safetensors").read_bytes()
        own = {k: v for k, v in said.items() if k not in ("format", "weights", "checksum")}
        assert compose(own, weights) == file.read_bytes()
