"""The plans: what is commanded, for how long, and what cannot be."""

import numpy as np
import pytest
from helpers import default_config
from hypothesis import given
from hypothesis import strategies as st

from lbgc.attitudes import drawn, with_attitudes
from lbgc.errors import InputError
from lbgc.protocol import Move, Plan, ProtocolConfig, plan

DEG = np.pi / 180


@given(
    by=st.floats(-800, 800).filter(lambda x: abs(x) > 1e-3),
    rate=st.floats(0.5, 100),
    acceleration=st.floats(1, 200),
)
def test_a_slew_gets_there_within_its_limits(by, rate, acceleration):
    move = Move(1.0, by * DEG, rate * DEG, acceleration * DEG)
    t = np.linspace(0, move.end_s + 1, 4001)
    angle, turning = move.command(t)
    assert angle[0] == 0
    assert angle[-1] == pytest.approx(by * DEG, rel=1e-12)
    assert np.abs(turning).max() <= rate * DEG * (1 + 1e-9)
    assert (np.diff(angle) * np.sign(by) > -1e-12).all()
    # the angle is the rate's integral: a trapezoid is exact but where the acceleration jumps
    dt = t[1]
    summed = np.concatenate([[0], np.cumsum((turning[1:] + turning[:-1]) / 2)]) * dt
    assert np.abs(summed - angle).max() < acceleration * DEG * dt**2


def test_two_positions_share_what_the_slew_leaves():
    planned = plan(ProtocolConfig(kind="indexed"), 0, 240.0)
    (move,) = planned.moves
    assert move.duration_s == pytest.approx(6.5)  # 180/30 + 30/60
    assert move.start_s == pytest.approx((240 - 6.5) / 2)
    assert planned.azimuth_range == pytest.approx(2 * np.pi)


def test_dwells_are_as_given_and_the_last_takes_the_rest():
    config = ProtocolConfig(kind="indexed", angles_deg=(10.0, 100.0, 10.0), dwell_s=(5.0, 7.0, 1.0))
    planned = plan(config, 0, 100.0)
    first, second = planned.moves
    assert (first.start_s, second.start_s) == pytest.approx((5.0, 5.0 + first.duration_s + 7.0))
    at = planned.command(np.array([0.0, 4.9, second.start_s - 0.1, 99.0]))[0]
    np.testing.assert_allclose(at / DEG, [10, 10, 100, 10], atol=1e-9)


def test_a_carousel_turns_either_way_until_the_end_or_for_whole_turns():
    t = np.linspace(0, 120, 1201)
    for rate in (6.0, -6.0):
        angle, turning = plan(
            ProtocolConfig(kind="carousel", carousel_deg_per_s=rate), 0, 120.0
        ).command(t)
        assert turning[-2] == pytest.approx(rate * DEG)
        assert np.sign(angle[-1]) == np.sign(rate)
    stopping = ProtocolConfig(kind="carousel", carousel_deg_per_s=-12.0, turns=2.0)
    angle, turning = plan(stopping, 0, 120.0).command(t)
    assert angle[-1] == pytest.approx(-4 * np.pi)
    assert turning[-1] == 0


def test_a_scan_goes_round_the_circle_and_the_base_fills_the_gaps():
    scan = ProtocolConfig(step_deg=5.0)
    angles = [plan(scan, i, 240.0).start for i in range(144)]
    np.testing.assert_allclose(np.diff(angles[:72]), np.deg2rad(5.0))
    assert angles[72:] == angles[:72]
    assert plan(scan, 10, 240.0).azimuth_range == pytest.approx(np.deg2rad(5.0))
    assert plan(ProtocolConfig(kind="static"), 10, 240.0).azimuth_range == pytest.approx(2 * np.pi)
    assert not plan(scan, 10, 240.0).moves


@pytest.mark.parametrize(
    ("choice", "angles"),
    [("two_position", [0, 180]), ("four_position", [0, 90, 180, 270]), ("indexed", [0, 120, 240])],
)
def test_the_named_protocols_are_what_they_are_called(choice, angles):
    config = default_config(f"protocol={choice}").protocol
    assert config.name == choice
    assert list(config.angles_deg) == angles


CHANGED = {
    "kind": "static",
    "step_deg": 7.0,
    "angles_deg": (0.0, 90.0),
    "dwell_s": 20.0,
    "carousel_deg_per_s": -3.0,
    "turns": 1.0,
    "slew_deg_per_s": 10.0,
    "slew_deg_per_s2": 20.0,
    "poses": 5,
    "downs": "cube",
    "attitudes_deg": ((0.0, 0.0, 0.0), (90.0, 0.0, 40.0)),
    "placed_deg": 2.0,
    "handling_s": 3.0,
}
KIND = {"step_deg": "heading_scan", "carousel_deg_per_s": "carousel", "turns": "carousel"}
TUMBLE = ("poses", "downs", "attitudes_deg", "placed_deg", "handling_s")
KIND |= dict.fromkeys(TUMBLE, "tumble")


@pytest.mark.parametrize("field", CHANGED)
def test_every_field_changes_the_plan(field):
    kind = KIND.get(field, "indexed")
    downs = {"downs": "cube"} if field == "placed_deg" else {}
    usual, other = (
        ProtocolConfig(**({"kind": kind} | downs | changed))
        for changed in ({}, {field: CHANGED[field]})
    )
    assert planned(usual) != planned(other)


def planned(config: ProtocolConfig) -> Plan:
    """The plan of a recording, that of a tumble with its attitudes."""
    found = plan(config, 3, 240.0)
    if found.handling is None:
        return found
    return with_attitudes(found, config, np.random.default_rng(1))


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"kind": "spin"}, "choose from static, heading_scan, indexed, carousel"),
        ({"step_deg": 0.0}, "step_deg = 0.0 deg"),
        ({"angles_deg": ()}, "must name an angle"),
        ({"dwell_s": (1.0,)}, "must be one figure, or 2"),
        ({"dwell_s": 0.0}, "must be above zero"),
        ({"carousel_deg_per_s": 0.0}, "carousel_deg_per_s = 0.0 deg/s: must not be zero"),
        ({"slew_deg_per_s2": 0.0}, "slew_deg_per_s2 = 0.0 deg/s2: must be greater"),
        ({"turns": -1.0}, "turns = -1.0: must be greater"),
        ({"poses": 1}, "poses = 1: must be from 2 to 1000"),
        ({"downs": "up"}, "choose from sphere, cube"),
        ({"downs": "cube", "placed_deg": 0.0}, "exactly on its nose has no heading"),
        ({"attitudes_deg": ((0.0, 0.0, 0.0),)}, "must name two or more"),
        ({"attitudes_deg": ((0.0, 0.0), (1.0, 2.0))}, r"must be \[roll, pitch, heading\] each"),
        ({"attitudes_deg": ((0.0, 90.0, 0.0),) * 2}, "forward axis is vertical and has no heading"),
        ({"handling_s": 0.1}, "handling_s = 0.1 s: must be 0.5 or more"),
        ({"kind": "tumble", "dwell_s": (1.0, 2.0)}, "must be one figure, or 12"),
    ],
)
def test_wrong_protocols_are_refused(values, says):
    with pytest.raises(InputError, match=says):
        ProtocolConfig(**values)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"kind": "indexed", "dwell_s": 60.0}, r"protocol.dwell_s = 60.0 s: takes 126.5 s"),
        (
            {"kind": "indexed", "slew_deg_per_s": 1.5},
            r"protocol.angles_deg = \[0.0, 180.0\]: takes",
        ),
        ({"kind": "carousel", "turns": 3.0}, r"protocol.turns = 3.0: takes 180.1 s .* lasts 120 s"),
        ({"kind": "tumble", "poses": 32}, r"poses = 32: takes 124 s with its handling"),
        ({"kind": "tumble", "dwell_s": 30.0}, r"dwell_s = 30.0 s: takes 404 s .* handle faster"),
    ],
)
def test_a_protocol_longer_than_the_recording_is_refused(values, says):
    with pytest.raises(InputError, match=says):
        plan(ProtocolConfig(**values), 0, 120.0)


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("protocol.angles_deg=[0,nan]", "protocol.angles_deg = nan deg: must be a finite number"),
        ("protocol.angles_deg=[0,x]", "protocol.angles_deg = x deg: must be a number"),
        ("duration_s=5", "takes 6.5 s with its slews, and a recording lasts 5 s"),
        ("protocol.slew_deg_per_s2=2000", "protocol.slew_deg_per_s2 = 2000.0 deg/s2: needs"),
        ("scene.physics_hz=1000", "each sample must be a whole number of physics steps"),
        ("protocol=spin", "two_position"),
    ],
)
def test_what_the_bench_cannot_do_is_refused_and_leaves_nothing_behind(
    cli, tmp_path, override, says
):
    done = cli("sim.generate", "protocol=two_position", "out=d.zarr", override)
    assert done.code == 2
    assert says in done.err
    assert "Traceback" not in done.err
    assert list(tmp_path.iterdir()) == []


def test_nothing_commanded_is_a_rest():
    angle, rate = Plan(0.3, 0.0, 0.0, 1.0, 1.0).command(np.array([-1.0, 0.0, 5.0]))
    np.testing.assert_array_equal(angle, 0.3)
    assert not rate.any()


def test_any_direction_is_as_probable_to_be_down():
    """Mean and second moments of the unit downs, whose 1 sigma over n are sqrt(1/3n) and, of d_i^2,
    sqrt(4/45n)."""
    n = 1000
    down = drawn(ProtocolConfig(kind="tumble", poses=n), np.random.default_rng(2))[:, 2]
    assert np.abs(down.mean(axis=0)).max() < 4 * np.sqrt(1 / 3 / n)
    assert np.abs((down**2).mean(axis=0) - 1 / 3).max() < 4 * np.sqrt(4 / 45 / n)


def test_a_box_lies_on_each_face_once_before_any_again():
    config = ProtocolConfig(kind="tumble", poses=12, downs="cube", placed_deg=1.0)
    down = drawn(config, np.random.default_rng(3))[:, 2]
    faces = np.rint(down)
    for six in (faces[:6], faces[6:]):
        assert {tuple(own) for own in six} == {tuple(s * e) for e in np.eye(3) for s in (1, -1)}
    beside = np.rad2deg(np.arccos(np.sum(down * faces, axis=1)))
    assert 0 < beside.min() < beside.max() < 5


def test_listed_attitudes_are_held_in_their_order():
    listed = ((10.0, 20.0, 30.0), (-100.0, -80.0, 170.0))
    config = ProtocolConfig(kind="tumble", attitudes_deg=listed, placed_deg=0.0, dwell_s=(3.0, 5.0))
    found = planned(config).handling
    assert found is not None
    assert found.starts_s == (3.0,)
    np.testing.assert_allclose(np.rad2deg(found.attitudes), listed, atol=1e-9)
