"""Every study from end to end: the code that `make study-NAME` runs, at a size for the tests."""

import json
import os
import subprocess
import sys

import pytest
import yaml
from helpers import ROOT

STUDIES = ROOT / "tests/studies"
HELPERS = {"common", "scoring", "swaying", "vehicle_likeness"}
SMALL = yaml.safe_load((STUDIES / "small.yaml").read_text())
NAMES = sorted(path.stem for path in STUDIES.glob("*.py") if path.stem not in HELPERS)


def test_every_study_has_a_size_for_the_tests():
    assert set(NAMES) <= set(SMALL)


@pytest.mark.parametrize("name", NAMES)
def test_the_study_runs(name, tmp_path):
    done = ran(STUDIES / f"{name}.py", tmp_path)
    summary = json.loads((tmp_path / f"outputs/studies/{name}/summary.json").read_text())
    assert "minutes" in summary, done.stdout
    assert len(summary) > 2


def ran(script, where) -> subprocess.CompletedProcess:
    parts = (ROOT, ROOT / "tests", STUDIES)
    small = {"LBGC_STUDY": "small", "PYTHONPATH": os.pathsep.join(map(str, parts))}
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=where,
        capture_output=True,
        text=True,
        env=os.environ | small,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done
