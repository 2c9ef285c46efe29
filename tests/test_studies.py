"""Every study from end to end: the code that `make study-NAME` runs, at a size for the tests."""

import pytest
from studies_small import OF_ONE_UNIT, OTHERS, SMALL, TRAINING, check


def test_every_study_has_a_size_for_the_tests():
    assert {*OTHERS, *TRAINING, *OF_ONE_UNIT} <= set(SMALL)


@pytest.mark.parametrize("name", OTHERS)
def test_the_study_runs(name, tmp_path):
    check(name, tmp_path)
