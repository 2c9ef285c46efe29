"""Every error that a sensor can have says the same by all its faces: as it is drawn, as the floor
has it, as a filter has it, and taken out again."""

from dataclasses import replace

import floor_cases
import numpy as np
import pytest
from helpers import composed

from lbgc.bound import BoundConfig
from lbgc.estimators import reduced_order
from lbgc.estimators.block_means import Levelled, levelled
from lbgc.estimators.information import spread_of
from lbgc.sensor import errors
from lbgc.sensor.imu import ImuModel

COUNT = 1000
CASES = {
    "two positions": floor_cases.Case("", "ideal", floor_cases.TWO, 120.0),
    "carousel": floor_cases.Case("", "ideal", floor_cases.CAROUSEL, 120.0),
}
WARMING = ("imu.temperature.rise_k=20", "imu.temperature.time_s=100")
FIELD = ("horizontal_gauss=0.24", "vertical_gauss=0.42", "declination_deg=11")
GYRO = {
    "bias_unit": ("bias_unit_deg_per_h=2",),
    "bias_session": ("bias_session_deg_per_h=2",),
    "bias_run": ("bias_run_deg_per_h=2",),
    "matrix": ("scale_unit_ppm=3000", "misalignment_unit_mrad=2"),
    "g_sensitivity": ("g_sensitivity_deg_per_h_per_g=3",),
    "magnetic": ("magnetic_deg_per_h_per_gauss=5",),
    "bias_per_k": ("bias_per_k_deg_per_h_per_k=1",),
    "scale_per_k": ("scale_per_k_ppm_per_k=200",),
    "N": ("arw_deg_per_sqrt_h=0.2",),
    "B": ("bias_instability_deg_per_h=1",),
    "K": ("rrw_deg_per_h_per_sqrt_h=20",),
    "Q": ("quantisation_arcsec=5",),
    "R": ("ramp_deg_per_h_per_h=50",),
    "Gauss-Markov": ("gauss_markov_deg_per_h=2", "gauss_markov_s=30"),
    "line": ("lines=[{deg_per_h:5,hz:0.2,width_hz:0.05}]",),
    "resonance": ("lines=[{deg_per_h:5,hz:0.2,width_hz:0.05,poles:1}]",),
    "filter": ("arw_deg_per_sqrt_h=0.2", "bandwidth_hz=2"),
    "tone": ("arw_deg_per_sqrt_h=0.02", "tone_hz=0.03", "tone_deg_per_h=5"),
    "counts": ("arw_deg_per_sqrt_h=0.2", "rate_lsb_deg_per_s=0.002"),
    "carried counts": ("arw_deg_per_sqrt_h=0.2", "angle_lsb_arcsec=10"),
}
"""Figures that make one kind of error, large enough to be nothing else."""
SWINGS = ("line", "resonance", "tone")
"""What swings a filter knows by its size in the integral, not by its phase."""
REDUCED = {"K": 1.03, "B": 1.12, "R": 3.0, "bias_per_k": 1.5}
"""How many times the exact variance a filter of few states may have of it; 1.02 else, and 0.98 at
the least. A ramp, and a warming bias where that is no state of its own, are to it a constant that
walks."""


def sensor(*figures: str) -> ImuModel:
    own = (f"imu.gyro.{figure}" for figure in figures)
    field = (f"imu.magnetic_field.{figure}" for figure in FIELD)
    return composed(BoundConfig, "bound", "imu=ideal", *WARMING, *field, *own).imu.model(10.0)


def part_of(imu: ImuModel, case: floor_cases.Case) -> Levelled:
    (part,) = levelled(floor_cases.draw(case, imu, COUNT, 3).windows, imu.dt)
    return part


@pytest.fixture(scope="module")
def perfect():
    return {name: part_of(sensor(), case) for name, case in CASES.items()}


def looks(part: Levelled) -> np.ndarray:
    """Some weights of the gyros' parts, (k, 6, n): what north looks at, and the mean."""
    course, n = part.course, len(part.course.blocks)
    weights = np.zeros((9, 6, n))
    for k, pattern in enumerate((course.c, course.s, np.ones(n))):
        for axis in range(3):
            weights[3 * k + axis, axis] = pattern / n
    return weights


@pytest.mark.parametrize("course", CASES)
@pytest.mark.parametrize("kind", GYRO)
def test_what_is_drawn_is_what_the_floor_expects(kind, course, perfect):
    """Variances of three looks at each gyro, by 1,000 recordings of as many units: 5 of a
    variance's standard errors, sqrt(2/1000), which a ramp's or a tone's are below."""
    if kind == "filter" and course == "two positions":
        pytest.skip(
            "what moves comes later through a filter: its end is no part of the slew's block"
        )
    imu = sensor(*GYRO[kind])
    part, true = part_of(imu, CASES[course]), perfect[course]
    assert part.course == true.course
    weights = looks(part)
    found = np.mean(np.einsum("kcn,vcn->vk", weights, part.body - true.body) ** 2, axis=0)
    lean = (0.0, 0.0)
    none = spread_of(sensor(), part.course, part.site, weights, lean)
    expected = np.diag(spread_of(imu, part.course, part.site, weights, lean) - none)
    there = expected > 1e-6 * expected.max()
    np.testing.assert_allclose(found[there], expected[there], rtol=5 * np.sqrt(2 / COUNT))
    assert (found[~there] < 1e-5 * expected.max()).all()


TURNING = ("matrix", "scale_per_k", "magnetic")
"""What turns with the plate is no constant of a filter's: see `reduced_order.like_north`."""


@pytest.mark.parametrize("kind", [k for k in GYRO if k not in (*SWINGS, *TURNING)])
def test_a_filter_has_it_with_few_states(kind, perfect):
    """One rest's mean, and the difference of two by turns: reduced states against the exact law.
    What follows the plate's rate is a state of its own, `reduced_order.turning`."""
    imu, part = (
        sensor(*GYRO[kind]),
        perfect["two positions"].only(perfect["two positions"].course.resting),
    )
    course, site = part.course, part.site
    at, h, count = np.array(course.blocks), course.interval, course.count
    first = np.arange(len(at)) < np.argmax(np.diff(at) > 1) + 1
    one = np.ones(1)
    when = reduced_order.When(count * h, 0 * one, floor_cases.LATITUDE * one, site.gravity * one)
    law, none = (reduced_order.of_gyro(own, when) for own in (imu, sensor()))
    for look in (first / first.sum(), first / first.sum() - ~first / (~first).sum()):
        weights = np.zeros((1, 6, len(at)))
        weights[0, 0] = look
        lean = (0.0, 0.0)
        exact = float(spread_of(imu, course, site, weights, lean)[0, 0])
        exact -= float(spread_of(sensor(), course, site, weights, lean)[0, 0])
        w = np.zeros(count)
        w[at] = look
        later = np.cumsum(w[::-1])[::-1]
        lag = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) * h
        reduced = law.constant[0, 0] * w.sum() ** 2 + law.walk[0, 0] * h * np.sum(later**2)
        reduced += law.wander[0] * w @ np.exp(-lag / law.time[0]) @ w
        reduced += (law.white[0] - none.white[0]) / h * np.sum(w**2)
        reduced += law.angle[0] / h**2 * np.sum(np.diff(w, prepend=0, append=0) ** 2)
        assert 0.98 * exact - 1e-20 < reduced < REDUCED.get(kind, 1.02) * exact + 1e-20


@pytest.mark.parametrize("kind", [*(k for k in GYRO if k.startswith(("bias", "g_"))), *TURNING])
def test_what_was_drawn_can_be_taken_out(kind, rng):
    imu = sensor(*GYRO[kind])
    drawn = imu.gyro.draw_unit(rng) | imu.gyro.draw_session(rng)
    drawn = imu.gyro.draw_run(rng, drawn)
    truth, force = rng.standard_normal((3, 50)) * 1e-2, rng.standard_normal((3, 50)) * 10
    around = replace(imu.warming, force=force, field=rng.standard_normal((3, 50)) * 1e-5)
    warmth = around.rise(50, 1.0)
    printed = errors.printed(imu.gyro.drawn, drawn, truth, around, warmth)
    assert np.abs(printed - truth).max() > 1e-7
    found = errors.undone(imu.gyro.drawn, drawn, printed, around, warmth)
    np.testing.assert_allclose(found, truth, atol=1e-15)


def test_an_error_of_any_kind_is_printed_and_taken_out(rng):
    """A sensitivity to force that grows with the temperature: no figure of today's makes one."""
    kind = errors.Proportional("new", "new", "unit", errors.FORCE, cross=(1e-3,) * 3, warms=True)
    imu = sensor(*GYRO["bias_unit"])
    own = (*imu.gyro.drawn, kind)
    drawn = imu.gyro.draw_run(rng, imu.gyro.none_drawn()) | {"new": kind.draw(rng)}
    truth, force, warmth = (
        rng.standard_normal((3, 50)),
        rng.standard_normal((3, 50)),
        np.arange(50.0),
    )
    around = replace(imu.warming, force=force)
    printed = errors.printed(own, drawn, truth, around, warmth)
    expected = truth + drawn["bias_run"][:, None] + drawn["new"] @ force * warmth
    np.testing.assert_allclose(printed, expected, atol=1e-12)
    np.testing.assert_allclose(
        errors.undone((kind,), drawn, drawn["new"] @ force * warmth, around, warmth), 0, atol=1e-12
    )
