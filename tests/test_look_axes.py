"""The log doctor on turns about a level axis, and on a carousel whose angle no column has."""

import numpy as np
import pytest
import yaml
from test_look_turned import LATITUDE, write
from test_turned_logs import RATE, bench

from lbgc.data.logs import LogConfig, read
from lbgc.data.looking import carousel
from lbgc.data.looking.doctor import looked
from lbgc.data.looking.sensor import Means
from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.frames import AXES, euler_to_matrix, rotation_z

AHEAD = ["x", "y", "z"]


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("angles", [[0, 180, 0], [180, 0, 180], [0, 90]])
def test_turns_about_a_level_axis_are_known(tmp_path, axis, angles):
    """By a column, whatever it is called, and by the gyros alone, which is asked about."""
    values, angle, _ = bench(angles, rest_s=40.0, axis=axis)
    look = looked(write(tmp_path / "log.csv", values, angle, "plate_deg"), LATITUDE)
    up = angles[0] == 180 and angles.count(180) > 1 and _starts_over(look)
    if not up:
        assert look.is_sure, look
        assert (look.keys["plate_column"], look.keys["plate_axis"]) == ("plate_deg", AXES[axis])
        (record,) = read(LogConfig(**look.keys))
        assert record.axis == axis
    alone = looked(write(tmp_path / "alone.csv", values), LATITUDE)
    (asked,) = alone.asks
    assert asked.key == "positions"
    assert f"about its level {AXES[axis]} axis" in asked.why
    assert f"log.plate_axis={AXES[axis]}" in asked.doubt
    positions = yaml.safe_load(asked.doubt.split("log.positions=")[1].split(";")[0])
    told = looked(
        tmp_path / "alone.csv", {**LATITUDE, "positions": positions, "plate_axis": AXES[axis]}
    )
    assert told.is_sure or up, told


def _starts_over(look) -> bool:
    """Whether its longest rest, by which its down is told, is that with the body over."""
    return any("deg off at its first rest" in fact for fact in look.facts)


def test_a_column_whose_zero_is_not_level_is_not_the_plates(tmp_path):
    values, angle, _ = bench([0, 180, 0], rest_s=40.0, axis=0)
    look = looked(write(tmp_path / "log.csv", values, angle + 25, "plate_deg"), LATITUDE)
    assert [guess.key for guess in look.asks] == ["positions"]
    assert any("25 deg off at its first rest, by gravity" in fact for fact in look.facts)


def even(deg_per_s: float, seconds: float = 300.0, lean_deg=(0.05, 0.0), arw: float = 0.1, seed=1):
    """Rates, deg/s, and forces of a body that turns evenly about its down axis."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    c_nb = euler_to_matrix(*np.deg2rad(lean_deg), 0.0) @ rotation_z(np.deg2rad(deg_per_s * t))
    rate = np.rad2deg(earth_rate_ned(np.deg2rad(48.1)) @ c_nb)
    rate[:, 2] += deg_per_s
    force = np.array([0.0, 0.0, -normal_gravity(np.deg2rad(48.1))]) @ c_nb
    rate += arw / 60 * np.sqrt(RATE) * rng.standard_normal(rate.shape)
    return np.hstack([rate, force + 1e-3 * rng.standard_normal(force.shape)])


@pytest.mark.parametrize("deg_per_s", [6.0, -3.0])
def test_a_carousel_without_an_angle_is_asked_about(tmp_path, deg_per_s):
    values = even(deg_per_s, 600.0)
    look = looked(write(tmp_path / "log.csv", values), LATITUDE)
    asked = {guess.key: guess for guess in look.asks}
    assert "a carousel, whose angle no column has" in asked["plate_column"].why
    assert not look.is_described  # its noise is not told from the turning's either
    angle = (np.arange(len(values)) + 1) / RATE * deg_per_s
    column = looked(write(tmp_path / "angle.csv", values, angle % 360, "table_deg"), LATITUDE)
    assert column.keys["plate_column"] == "table_deg"
    assert column.refusal is None
    # whether +1 g is up or down is not told beside a rate that large
    assert {guess.key for guess in column.asks} <= {"axes"}


def test_a_bias_is_no_carousel_and_a_large_rate_is_asked_about():
    """Of 200 resting gyros with biases and slow noise, none is taken for a carousel."""
    rng = np.random.default_rng(5)
    found = []
    for _ in range(200):
        bias = rng.uniform(1.5, 10.0)
        walk = np.cumsum(rng.standard_normal((2400, 3)), axis=0) * rng.uniform(0, 3e-4)
        gyro = walk + 2e-3 * rng.standard_normal((2400, 3)) + [0, 0, bias]
        force = [0, 0, -9.8] + 1e-3 * rng.standard_normal((2400, 3)) + walk
        guess = carousel.guess(Means("log", gyro, force, 5.0), "deg/s", AHEAD)
        found.append((bias, guess))
    assert not any(guess is not None and "carousel, whose" in guess.why for _, guess in found)
    assert all((guess is not None) == (bias >= 2.0) for bias, guess in found)
    assert all(guess.heading_only for _, guess in found if guess is not None)


def test_doubts_of_an_angles_column_are_said(tmp_path):
    values, angle, _ = bench([0, 180, 0], rest_s=40.0)
    azimuth = looked(write(tmp_path / "a.csv", values, angle + 70, "SVI Azimuth"), LATITUDE)
    (guess,) = [own for own in azimuth.guesses if own.key == "plate_column"]
    assert "log.heading_column" in guess.doubt
    counts = np.round(angle / 360 * 2**20)
    encoder = looked(write(tmp_path / "e.csv", values, counts, "encoder_position"), LATITUDE)
    (guess,) = [own for own in encoder.guesses if own.key == "plate_scale"]
    assert (guess.doubt, "1048576 a turn" in guess.why) == ("has its encoder so many?", True)
