"""Configurations are built from what users type, and refuse it by name, value, unit and choices."""

from dataclasses import dataclass, field

import pytest

from lbgc.errors import Axes, InputError, build, require
from lbgc.units import factor, unit_of


@dataclass(frozen=True)
class Inner:
    arw_deg_per_sqrt_h: Axes = 0.0
    range_deg_per_s: float | None = None

    def __post_init__(self) -> None:
        require(self.range_deg_per_s != 7, "range_deg_per_s", self.range_deg_per_s, "not seven")


@dataclass(frozen=True)
class Outer:
    name: str
    count: int = 1
    flag: bool = False
    shares: list[int] = field(default_factory=lambda: [1])
    inner: Inner = field(default_factory=Inner)


def test_values_arrive_with_their_types():
    built = build(
        Outer,
        {"name": "x", "inner": {"arw_deg_per_sqrt_h": [1, 2, 3], "range_deg_per_s": 5}},
    )
    assert built == Outer("x", inner=Inner([1.0, 2.0, 3.0], 5.0))
    assert isinstance(built.inner.range_deg_per_s, float)


@pytest.mark.parametrize(
    ("mapping", "says"),
    [
        ({}, "name = (missing): must be given"),
        ({"name": "x", "nme": 1}, "key = nme: choose from name, count, flag, shares, inner"),
        ({"name": 3}, "name = 3: must be a text"),
        ({"name": "x", "count": 1.5}, "count = 1.5: must be a whole number"),
        ({"name": "x", "count": True}, "count = True: must be a whole number"),
        ({"name": "x", "flag": 1}, "flag = 1: must be true or false"),
        ({"name": "x", "shares": 3}, "shares = 3: must be a list"),
        ({"name": "x", "shares": [1, "a"]}, "shares = a: must be a whole number"),
        ({"name": "x", "inner": 3}, "inner = 3: must be a group of parameters"),
        (
            {"name": "x", "inner": {"arw_deg_per_sqrt_h": float("nan")}},
            "inner.arw_deg_per_sqrt_h = nan deg/sqrt(h): must be a finite number",
        ),
        (
            {"name": "x", "inner": {"arw_deg_per_sqrt_h": "a"}},
            "inner.arw_deg_per_sqrt_h = a deg/sqrt(h): must be a number",
        ),
        ({"name": "x", "inner": {"range_deg_per_s": 7}}, "inner.range_deg_per_s = 7.0 deg/s: not"),
    ],
)
def test_wrong_values_are_named(mapping, says):
    with pytest.raises(InputError) as caught:
        build(Outer, mapping)
    assert str(caught.value).startswith(says)


def test_an_error_survives_pickling_between_processes():
    import pickle

    error = InputError("a", 3, "deg", ["x", "y"])
    assert str(pickle.loads(pickle.dumps(error))) == "a = 3 deg: choose from x, y"


@pytest.mark.parametrize(
    ("key", "value", "si", "unit"),
    [
        ("arw_deg_per_sqrt_h", 0.3, 8.7266462599716e-05, "deg/sqrt(h)"),
        ("bias_run_deg_per_h", 1.0, 4.84813681109536e-06, "deg/h"),
        ("rrw_deg_per_h_per_sqrt_h", 60.0, 4.84813681109536e-06, "deg/h/sqrt(h)"),
        ("noise_ug_per_sqrt_hz", 100.0, 100e-6 * 9.80665 / 2**0.5, "ug/sqrt(Hz)"),
        ("bias_unit_mg", 2.0, 0.0196133, "mg"),
        ("range_g", 10.0, 98.0665, "g"),
        ("rate_hz", 600.0, 600.0, "Hz"),
        ("latitude", 180.0, 3.141592653589793, "deg"),
    ],
)
def test_units_are_read_off_keys(key, value, si, unit):
    assert factor(key) * value == pytest.approx(si, rel=1e-12)
    assert unit_of(f"some.group.{key}") == unit


def test_a_key_without_unit_has_none():
    assert unit_of("recordings") == ""
    with pytest.raises(KeyError, match="recordings"):
        factor("recordings")
