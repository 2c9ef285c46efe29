"""What make demo, picture and pretrained type, run with fewer recordings and steps."""

import shlex
import subprocess
import sys

import pytest
from helpers import ROOT
from programs import ran

SMALLER = {
    "sim/generate.py": ["recordings=20"],
    "sim/scene.py": [
        "width=96",
        "height=64",
        "duration_s=4",
        "protocol.slew_deg_per_s=180",
        "protocol.slew_deg_per_s2=360",
    ],
    "lbgc/train.py": ["steps=2", "validate_every=1", "batch=4"],
    "lbgc/evaluate.py": ["windows_s=[240]"],
}


def typed(target: str) -> list[list[str]]:
    """The programs of the project that a target runs, in their order."""
    done = subprocess.run(["make", "-n", target], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.replace("\\\n", " ").splitlines()
    words = [shlex.split(line) for line in lines if line.startswith(".venv/bin/python ")]
    return [own[1:] for own in words if own[1] in SMALLER]


@pytest.mark.parametrize(
    ("target", "programs"), [("demo", 4), ("picture", 3), ("pretrained-sdc500-two_position", 2)]
)
def test_the_target_runs(target, programs, tmp_path):
    commands = typed(target)
    assert len(commands) == programs
    for script, *options in commands:
        (tmp_path / "docs").mkdir(exist_ok=True)
        words = [ROOT / script, *options, *SMALLER[script]]
        if target == "picture":
            words = [sys.executable, *words]
            done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
        else:
            done = ran(*words, cwd=tmp_path)
        if script == "sim/scene.py" and "cannot render here" in done.stderr:
            pytest.skip("needs OpenGL without a display, as the README says")
        assert done.returncode == 0, done.stderr
