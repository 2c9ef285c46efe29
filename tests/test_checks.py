"""A log's values and frames: right, described by an option, noted, or refused with the reason."""

import numpy as np
import pytest
from test_logs import MOCK, columns, config, write

from lbgc.data.logs import read
from lbgc.errors import InputError


def test_accelerometers_may_have_axes_and_a_sign_of_their_own(tmp_path):
    """Gyros forward-left-up beside accelerometers that print +g down."""
    values = columns()
    for axis, sign in zip("xyz", (1, -1, -1), strict=True):
        values[f"w_{axis}"] = sign * values[f"w_{axis}"]
        values[f"f_{axis}"] = -values[f"f_{axis}"]
    path = write(tmp_path / "log.csv", values)
    own = {"axes": ["x", "-y", "-z"], "accel_axes": ["-x", "-y", "-z"]}
    (record,) = read(config(path, **own))
    np.testing.assert_allclose(record.gyro, MOCK.gyro, rtol=1e-12)
    np.testing.assert_allclose(record.accel, MOCK.accel, rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"accel_axes": ["x", "x", "z"]}, "accel_axes = .*must be x, y, z"),
        ({"accept": ["everything"]}, "accept = everything: choose from stuck, outliers"),
    ],
)
def test_wrong_options_of_checks(changes, says):
    with pytest.raises(InputError, match=says):
        config("x.csv", **changes)
