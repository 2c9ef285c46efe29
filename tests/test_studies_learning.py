"""The studies that train networks, as those of test_studies.py: apart, for another process."""

import pytest
from studies_small import TRAINING, check


@pytest.mark.parametrize("name", TRAINING)
def test_the_study_runs(name, tmp_path):
    check(name, tmp_path)
