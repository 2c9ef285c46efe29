"""What moves the floor: as much as was asked for, and a closed form of time."""

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers import default_config

from lbgc.data.schema import VARIABLES
from lbgc.errors import InputError
from lbgc.units import DEG, HOUR, STANDARD_GRAVITY
from sim.disturbance import (
    FloorConfig,
    KnocksConfig,
    MooredConfig,
    TiltingConfig,
    VibrationConfig,
    pick,
)

VIBRATION = VibrationConfig(
    rate_deg_per_h=(90.0, 55.0, 0.0), force_ug=(100.0, 0.0, 300.0), drift_hz=1.5, drift_s=20.0
)
KNOCKS = KnocksConfig(per_minute=20.0)
TILTING = TiltingConfig(arcsec_per_h=30.0)
MOORED = MooredConfig(roll_deg=2.0, pitch_deg=1.0, heave_m=0.2)
T = np.arange(120_000) / 2000.0


def generator(index: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(5, spawn_key=(index,))))


@pytest.mark.parametrize("config", [VIBRATION, KNOCKS, TILTING, MOORED])
def test_a_motion_is_smooth_and_the_same_at_any_instants(config):
    """No jump of angle or velocity between instants half a millisecond apart, and asking for some
    of them gives what asking for all gives."""
    part = config.draw(generator(), 60.0)
    rotation, velocity = part.motion(T)
    some, carried = part.motion(T[5000:60_000:7])
    np.testing.assert_allclose(some, rotation[5000:60_000:7], atol=1e-15)
    np.testing.assert_allclose(carried, velocity[5000:60_000:7], atol=1e-15)
    for values in (rotation, velocity):
        steps = np.abs(np.diff(values, axis=0)).max(axis=0)
        assert (steps <= 0.3 * np.abs(values).max(axis=0) + 1e-18).all()


def test_vibration_has_its_amplitudes_and_its_frequency_swings():
    part = VIBRATION.draw(generator(), 60.0)
    rotation, velocity = part.motion(T)
    rate = np.gradient(rotation, T, axis=0)
    force = np.gradient(velocity, T, axis=0)
    np.testing.assert_allclose(
        np.sqrt(2 * np.mean(rate**2, axis=0)) / (DEG / HOUR), [90, 55, 0], rtol=0.01
    )
    np.testing.assert_allclose(
        np.sqrt(2 * np.mean(force**2, axis=0)) / (1e-6 * STANDARD_GRAVITY), [100, 0, 300], rtol=0.01
    )
    at = np.flatnonzero(np.diff(np.sign(rotation[:, 0])) > 0)
    before, after = rotation[at, 0], rotation[at + 1, 0]
    frequency = 1 / np.diff(T[at] + before / (before - after) * (T[1] - T[0]))
    assert frequency.min() == pytest.approx(46.5, abs=0.3)
    assert frequency.max() == pytest.approx(49.5, abs=0.3)


def test_knocks_come_as_often_and_as_hard_as_asked():
    """Counts are Poisson (300 draws of one minute at 20: 4.5 sampling errors), and the peak
    acceleration's 1 sigma is that asked for (some 6,000 knocks x 3, 4.5 of them)."""
    parts = [KNOCKS.draw(generator(i), 60.0) for i in range(300)]
    counts = np.array([len(p.at) for p in parts])
    assert counts.mean() == pytest.approx(20, abs=4.5 * np.sqrt(20 / 300))
    assert counts.var() == pytest.approx(20, rel=4.5 * np.sqrt(2 / 300))
    force = np.concatenate([p.force for p in parts])
    assert force.std() == pytest.approx(2e-3 * STANDARD_GRAVITY, rel=4.5 / np.sqrt(2 * force.size))
    one = replace(
        parts[0],
        at=np.array([1.0]),
        force=np.array([[1.0, -2.0, 0.5]]),
        tilt=np.array([[1e-6, 2e-6, 0.0]]),
    )
    rotation, velocity = one.motion(T)
    peak = np.abs(np.gradient(velocity, T, axis=0)).max(axis=0)
    np.testing.assert_allclose(peak, [1.0, 2.0, 0.5], rtol=0.01)
    np.testing.assert_allclose(np.abs(rotation).max(axis=0), [1e-6, 2e-6, 0], rtol=0.01)
    assert not rotation[T < 1].any()
    assert np.abs(velocity[-1]).max() < 1e-8


def test_a_floor_leans_ever_more():
    rotation, velocity = TILTING.draw(generator(), 60.0).motion(T)
    assert np.linalg.norm(rotation[-1]) == pytest.approx(30 * DEG / HOUR**2 * T[-1])
    assert rotation[-1, 2] == 0
    assert not velocity.any()


def test_a_moored_platform_rolls_pitches_and_heaves_as_much_as_asked():
    """Rms over 400 draws at one instant, 4.5 x 1/sqrt(800); periods about 8 s."""
    parts = [MOORED.draw(generator(i), 60.0) for i in range(400)]
    at = np.array([3.0, 3.001])
    motions = [p.motion(at) for p in parts]
    angle = np.array([m[0][0] for m in motions])
    np.testing.assert_allclose(angle.std(axis=0) / DEG, [2, 1, 0], rtol=0.16)
    velocity = np.array([m[1][0, 2] for m in motions])
    expected = 0.2 * 2 * np.pi / 8 * np.sqrt(1 + 0.15**2)
    assert velocity.std() == pytest.approx(expected, rel=0.16)
    roll = parts[0].motion(np.arange(0, 600, 0.1))[0][:, 0]
    waves = np.sum(np.diff(np.sign(roll)) > 0)
    assert 600 / waves == pytest.approx(8.0, rel=0.1)


def test_one_disturbance_does_not_change_anothers_numbers():
    alone = FloorConfig(knocks=KNOCKS).draw(generator(), 60.0)
    together = FloorConfig(vibration=VIBRATION, knocks=KNOCKS, moored=MOORED).draw(
        generator(), 60.0
    )
    np.testing.assert_array_equal(alone.knocks.at, together.knocks.at)
    np.testing.assert_array_equal(alone.knocks.force, together.knocks.force)


def test_a_range_is_drawn_from_and_recorded():
    config = default_config(
        "scene.floor.vibration.hz=[45,51]",
        "scene.floor.vibration.rate_deg_per_h=[90,55,0]",
        "scene.floor.knocks.per_minute=[0,6]",
        "scene.floor.moored.roll_deg=[1,3]",
    )
    floors = [config.scene.floor.draw(generator(i), 60.0).values() for i in range(200)]
    hz = np.array([f["vibration_frequency"] for f in floors])
    assert 45 <= hz.min() < 45.5 < 50.5 < hz.max() <= 51
    roll = np.array([f["moored_roll"] for f in floors]) / DEG
    assert 1 <= roll.min() < 1.2 < 2.8 < roll.max() <= 3
    assert len({f["knock_rate"] for f in floors}) == 200
    assert all(f["knock_peak"] == pytest.approx(2e-3 * STANDARD_GRAVITY) for f in floors)
    assert not any(f["floor_tilt_rate"] for f in floors)
    assert set(floors[0]) <= set(VARIABLES)


def test_one_number_is_drawn_whatever_the_range():
    a, b = generator(), generator()
    assert pick(a, 3.0) == 3.0
    assert 1 <= pick(b, (1.0, 2.0)) <= 2
    assert a.random() == b.random()


CHANGED = {
    "level": 2.0,
    "rate_deg_per_h": (1.0, 2.0, 3.0),
    "force_ug": (1.0, 2.0, 3.0),
    "hz": 20.0,
    "drift_hz": 0.7,
    "drift_s": 33.0,
    "damping": 0.3,
    "width": 0.3,
}


@pytest.mark.parametrize("config", [VIBRATION, KNOCKS, TILTING, MOORED])
def test_every_figure_changes_the_motion(config):
    usual = config.draw(generator(), 60.0).motion(T)
    for field in fields(config):
        value = CHANGED.get(field.name, 3.7)
        other = replace(config, **{field.name: value}).draw(generator(), 60.0).motion(T)
        assert any(not np.array_equal(a, b) for a, b in zip(usual, other, strict=True)), field.name


@pytest.mark.parametrize(
    "config", [VibrationConfig(), KnocksConfig(), TiltingConfig(), MooredConfig()]
)
def test_nothing_moves_unless_asked_for(config):
    assert not config.is_on


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: VibrationConfig(hz=0.0), "hz = 0.0 Hz"),
        (lambda: VibrationConfig(rate_deg_per_h=(1.0,)), "must be three figures"),
        (lambda: VibrationConfig(level=(2.0, 1.0)), r"must be a number, or \[low, high\]"),
        (lambda: KnocksConfig(per_minute=-1.0), "per_minute = -1.0: must be 0 or more"),
        (lambda: KnocksConfig(damping=0.0), "must be from 0.01 to below 1"),
        (lambda: TiltingConfig(arcsec_per_h=(1.0, 2.0, 3.0)), r"\[low, high\]"),
        (lambda: MooredConfig(period_s=0.0), "period_s = 0.0 s: must be 0.1 or more"),
        (lambda: MooredConfig(width=0.5), "must be above 0, up to 0.3"),
    ],
)
def test_wrong_disturbances_are_refused(make, says):
    with pytest.raises(InputError, match=says):
        make()
