"""Before a training starts it is said whether there is anything to win."""

import re
from dataclasses import asdict

import pytest
from helpers import default_config

from lbgc.prospects import prospects


def said(*options: str, window_s: float = 240.0) -> str | None:
    return prospects(asdict(default_config("protocol=static", *options)), window_s)


def figures(text: str) -> tuple[float, float, float]:
    """Share that repeats, the floor, and the floor who knows it; percent, degrees."""
    share = re.search(r"recordings ([\d.]+)% of", text)
    plain = re.search(r"better than ([\d.]+) deg", text)
    told = re.search(r"comes to ([\d.]+):", text)
    return float(share[1]), float(plain[1]), float(told[1]) if told else float("nan")


def bias(unit: float, run: float) -> tuple[str, str]:
    return f"imu.gyro.bias_unit_deg_per_h={unit}", f"imu.gyro.bias_run_deg_per_h={run}"


def test_what_repeats_can_be_won():
    """Of 0.8 and 0.6 deg/h, 64% of the variance: the error goes with what is left, 0.6 of it, but
    for the noise that both have (some 0.2 degrees of 3)."""
    share, plain, told = figures(said(*bias(0.8, 0.6)))
    assert share == 64
    assert told / plain == pytest.approx(0.6, abs=0.03)


def test_what_is_new_in_every_recording_cannot():
    text = said(*bias(0.0, 1.0))
    assert figures(text)[0] == 0
    assert "no gain is to be had" in text


def test_nor_what_repeats_in_units_that_are_many_nor_what_a_turn_shows():
    assert "of 40 units' recordings 0%" in said(*bias(1.0, 0.0), "units=40", "recordings=40")
    assert "no gain is to be had" in said(*bias(1.0, 0.0), "protocol=two_position")


@pytest.mark.parametrize(
    "options", [("latitude=90",), ("latitude=-89.99999",), ("imu=ideal",), ("scene=vehicle",)]
)
def test_where_the_floor_says_nothing_nor_does_it(options):
    text = said(*options)
    assert text is None or "no gain" in text


def test_a_training_says_it_first(cli):
    asked = ("recordings=20", "output=means", "duration_s=20", "out=d.zarr", "protocol=static")
    assert cli("sim.generate", *asked, *bias(1.0, 0.0)).code == 0
    done = cli("lbgc.train", "data=d.zarr", "steps=2", "windows_s=[20]", "batch=2")
    assert "in 20 s no estimator" in done.out.splitlines()[0]
