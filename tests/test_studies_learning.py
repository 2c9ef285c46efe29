"""The studies that train networks, as those of test_studies.py: apart, for another process."""

import json

import pytest
from studies_small import OF_ONE_UNIT, TRAINING, check


@pytest.mark.parametrize("name", TRAINING)
def test_the_study_runs(name, tmp_path):
    check(name, tmp_path)


def test_what_learners_left_is_shown_by_the_study_of_a_unit(tmp_path):
    for name in OF_ONE_UNIT:
        check(name, tmp_path)
    said = [
        json.loads((tmp_path / f"outputs/studies/{name}/{file}.json").read_text())
        for name, file in (("unit_learners", "results"), ("unit", "summary"))
    ]
    assert said[1]["learners_date"] == said[0]["date"]
    for key in ("context_over_floor_k_max", "context_over_linear_nongaussian_upper"):
        assert said[1][key] == said[0]["summary"][key]
    assert {row["learner"] for row in said[0]["learners"]} == {
        *("residual", "tuned", "in context", "published")
    }
    assert (tmp_path / "outputs/studies/unit/learners.png").exists()
