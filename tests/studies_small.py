"""What the tests of the studies share: which studies there are, and how one is run."""

import json
from importlib.util import find_spec
from pathlib import Path

import yaml
from helpers import ROOT, ran_small

STUDIES = ROOT / "tests/studies"
SMALL = yaml.safe_load((STUDIES / "small.yaml").read_text())
_HELPERS = {
    *("common", "scoring", "swaying", "vehicle_likeness"),
    *("transactional_harm", "transactional_stores", "logs_day", "logs_formats"),
    *("unit_learners_own", "unit_learners_picture"),
}
_NAMES = {path.stem for path in STUDIES.glob("*.py")} - _HELPERS
if find_spec("distributed") is None:  # an extra
    _NAMES.discard("million")
TRAINING = ["baseline", "faults", "hyperparameters", "learning", "paper"]
OF_ONE_UNIT = ["unit_learners", "unit"]
"""The second reads what the first left."""
OTHERS = sorted(_NAMES - {*TRAINING, *OF_ONE_UNIT})


def check(name: str, where: Path) -> None:
    """The study runs in this directory, and says what it found."""
    done = ran_small(STUDIES / f"{name}.py", where)
    summary = json.loads((where / f"outputs/studies/{name}/summary.json").read_text())
    assert "minutes" in summary, done.stdout
    assert len(summary) > 2
