"""The log doctor on formats that state the axes of their sensors."""

import numpy as np
import pytest
from test_formats import installed
from test_look import still
from written import EVERY

from lbgc.data.logs import LogConfig, read
from lbgc.data.looking.doctor import looked
from lbgc.data.readers.axes import matrix_of

STATED = {
    "ros 1": (["x", "-y", "-z"], "unless the sensor's own frame is another"),
    "ulog combined": (["x", "y", "z"], ""),
    "dataflash text": (["x", "y", "z"], ""),
}


def made(kind: str, home, axes: list[str]):
    """A resting log, forward-right-down, in a file whose axes are these."""
    installed(EVERY[kind].package)
    table = still(seconds=40, arw=0.02)
    table[:, 1:4] = np.deg2rad(table[:, 1:4])
    for part in (slice(1, 4), slice(4, 7)):
        table[:, part] = table[:, part] @ matrix_of(axes)
    EVERY[kind].write(home / EVERY[kind].name, table)
    return home / EVERY[kind].name


@pytest.mark.parametrize("kind", STATED)
@pytest.mark.parametrize("said", [{}, {"latitude": 48.1}])
def test_the_axes_that_a_format_states_are_taken(kind, said, tmp_path):
    axes, doubt = STATED[kind]
    look = looked(made(kind, tmp_path, axes), said)
    (guess,) = [own for own in look.guesses if own.key == "axes"]
    assert guess.sure, guess
    assert (guess.value, doubt in guess.doubt) == (axes, True)
    assert "states" in guess.why or "REP 103" in guess.why
    assert [own.key for own in look.asks] == ([] if said else ["latitude"])
    if said:
        (record,) = read(LogConfig(**look.keys))
        assert record.accel.mean(axis=0)[2] < -9.7


@pytest.mark.parametrize("kind", STATED)
def test_axes_against_which_the_log_rests_are_asked_about(kind, tmp_path):
    other = ["x", "-y", "-z"] if STATED[kind][0] == ["x", "y", "z"] else ["x", "y", "z"]
    look = looked(made(kind, tmp_path, other), {"latitude": 48.1})
    (asked,) = look.asks
    assert asked.key == "axes"
    assert "that down is 180 deg from the vertical" in asked.doubt
