"""Every study from end to end: the code that `make study-NAME` runs, at a size for the tests."""

import json

import pytest
import yaml
from helpers import ROOT, ran_small

STUDIES = ROOT / "tests/studies"
HELPERS = {"common", "scoring", "swaying", "vehicle_likeness"}
SMALL = yaml.safe_load((STUDIES / "small.yaml").read_text())
NAMES = sorted(path.stem for path in STUDIES.glob("*.py") if path.stem not in HELPERS)


def test_every_study_has_a_size_for_the_tests():
    assert set(NAMES) <= set(SMALL)


@pytest.mark.parametrize("name", NAMES)
def test_the_study_runs(name, tmp_path):
    done = ran_small(STUDIES / f"{name}.py", tmp_path)
    summary = json.loads((tmp_path / f"outputs/studies/{name}/summary.json").read_text())
    assert "minutes" in summary, done.stdout
    assert len(summary) > 2
