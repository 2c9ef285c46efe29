"""The floor on bases that lean, with slews inside, in windows of any length: no estimator does
better, and its sigma is true."""

from dataclasses import replace

import floor_cases
import numpy as np
import pytest
from helpers import composed, default_config, fields_of, generate, labelled

from lbgc.bound import BoundConfig, bounds
from lbgc.data.windows import Labelled, Windows, at_rate
from lbgc.estimators import CLASSICAL, coarse
from lbgc.estimators.block_means import Course, Site, block_size, levelled
from lbgc.estimators.error_patterns import timeless
from lbgc.estimators.floor import course_of, crlb, expected_floor, floor
from lbgc.estimators.information import fitted, information, told
from lbgc.frames import wrap
from lbgc.protocol import plan

CASES = floor_cases.cases()
QUICK = tuple(name for name in CLASSICAL if not name.startswith("oba"))
"""Those that align by velocity are many times worse, and slow; the study has them."""
SITE = Site.at(float(floor_cases.LATITUDE))
COUNT = 300


def only(windows: Windows, samples: int) -> Windows:
    """The first so many samples."""
    cut = {name: getattr(windows, name)[:, :samples] for name in ("gyro", "accel", "plate_angle")}
    return replace(windows, **cut)


def test_there_are_twenty_cases():
    assert len(CASES) == 20


@pytest.mark.parametrize("name", CASES)
def test_no_estimator_beats_the_floor(name):
    """By four standard errors of the paired loss, over some two hundred comparisons. What the floor
    says of itself is true: the mean of 60 normalised squares has a spread of sqrt(2/60) = 0.18."""
    scores = floor_cases.run(CASES[name], 60, 1, QUICK)
    assert {"floor", "gls", "ekf"} <= scores.keys()
    assert min(score.above for score in scores.values()) > -4
    assert scores["floor"].nees == pytest.approx(1.0, abs=4 * 0.18)


@pytest.fixture(scope="module")
def leaning():
    """stim300 on two positions at five degrees: 250 deg/h of bias on the vertical gyro."""
    case = CASES["stim300_two_position_5deg"]
    imu = case.model()
    return imu, floor_cases.draw(case, imu, COUNT, seed=3)


def test_a_lean_of_the_base_costs_next_to_nothing(leaning):
    """It took the floor from 2.8 degrees to 27.5 when it levelled the vertical gyro's bias into the
    horizontal rates."""
    imu, drawn = leaning
    windows = drawn.windows
    found = {name: CLASSICAL[name](windows, imu) for name in ("ekf", "two_position_weighted")}
    found["floor"] = floor(windows, imu)
    error = {name: wrap(own.heading - drawn.heading) for name, own in found.items()}
    level = expected_floor(information(imu, course_of(floor_cases.TWO, 240.0), SITE))
    for own in error.values():
        assert np.sqrt(np.mean(own**2)) < 1.05 * level * (1 + 3 / np.sqrt(2 * COUNT))
    nees = np.mean((error["floor"] / found["floor"].sigma) ** 2)
    assert nees == pytest.approx(1.0, abs=4 * np.sqrt(2 / COUNT))


def test_a_plain_estimators_sigma_knows_the_lean(leaning):
    """It levels the vertical gyro's bias into the horizontal rates, 5 degrees' sine times 83 deg/h:
    half of Earth's horizontal rate. A posterior on the circle has the squared errors that it says,
    whose relative spread is 1.4 or less."""
    imu, drawn = leaning
    found = CLASSICAL["two_position"](drawn.windows, imu)
    squares = (wrap(found.heading - drawn.heading) / found.sigma) ** 2
    assert np.sqrt(np.mean(found.sigma**2)) > np.deg2rad(15.0)
    assert np.mean(squares) < 1.0 + 8 * np.sqrt(2 / COUNT)


def test_each_window_is_answered_from_its_own_row(leaning):
    """However many others lean otherwise, and whether their slews fit or not."""
    imu, drawn = leaning
    windows = drawn.windows
    together, alone = floor(windows, imu), floor(windows.rows(np.arange(5)), imu)
    np.testing.assert_allclose(alone.heading, together.heading[:5], atol=1e-9)
    np.testing.assert_allclose(alone.sigma, together.sigma[:5], rtol=1e-9)


def test_a_slew_that_the_model_does_not_explain_is_left_out():
    """A plate whose axis jolts: a slew's mean rates are off by 100 times what misalignment does."""
    case = CASES["sdc500_eight_position_120s"]
    imu = case.model()
    windows = floor_cases.draw(case, imu, 20, seed=4).windows
    (part,) = levelled(windows, imu.dt)
    slew = part.course.blocks[int(np.flatnonzero(part.course.slewing)[2])]
    windows.gyro[7, slew : slew + 3, 0] += np.deg2rad(3.0)
    (jolted,) = levelled(windows, imu.dt)
    found, rest = fitted(imu, jolted), told(imu, jolted.only(~jolted.course.slewing), check=True)
    np.testing.assert_allclose(found.h[7], rest.h[7])
    others = np.arange(20) != 7
    assert (np.trace(found.J, axis1=1, axis2=2) > np.trace(rest.J, axis1=1, axis2=2))[others].all()


def test_rests_tell_of_north_where_the_plate_turns_for_most_of_the_window():
    """Two positions in ten seconds, six of them in the slew: without the rests the error would be
    half as large again. What is expected of the floor is what it has: the root mean square of 600
    errors is known to 3%, three of them."""
    case = floor_cases.Case("short", "sdc500", floor_cases.TWO, 10.0, 0.1)
    imu = case.model()
    drawn = floor_cases.draw(case, imu, 600, seed=9)
    (part,) = levelled(drawn.windows, imu.dt)
    course = part.course
    assert course.resting.sum() > 25
    expected, of_slew = (
        expected_floor(information(imu, c, SITE)) for c in (course, course.only(~course.resting))
    )
    assert of_slew > 1.4 * expected
    found = floor(drawn.windows, imu)
    error = wrap(found.heading - drawn.heading)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(expected, rel=0.09)
    assert np.mean((error / found.sigma) ** 2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 600))


@pytest.mark.parametrize("protocol", ["static", "two_position", "four_position", "carousel"])
@pytest.mark.parametrize("lean_deg", [0, 5])
def test_a_perfect_sensor_finds_north(protocol, lean_deg, tmp_path):
    """What the bench does that no sensor's model has is noise enough: nothing is refused, asks for
    gigabytes or states a certainty that no arithmetic has."""
    options = [f"protocol={protocol}", "imu=ideal", f"scene.base_pitch_deg={lean_deg}",
               "recordings=2", "rate_hz=20", "mean_s=1", "duration_s=240"]  # fmt: skip
    config = default_config(*options)
    changes = {name: value for name, value in fields_of(config).items() if name != "out"}
    data = generate(tmp_path / "d.zarr", **changes)
    made = Labelled.joined([labelled(record, 240.0) for record in data.records(np.arange(2))])
    imu = config.imu.model(config.rate_hz)
    own = {"static": "triad", "two_position": "two_position_weighted",
           "four_position": "cosine_fit_weighted", "carousel": "carousel_weighted"}  # fmt: skip
    for name in ("gls", "floor", "ekf", own[protocol]):
        estimate = floor if name == "floor" else CLASSICAL[name]
        found = estimate(made.windows, imu)
        off = np.rad2deg(np.abs(wrap(found.heading - made.heading)))
        assert (off < (0.3 if name == "ekf" else 0.01)).all(), name  # its encoder has one sigma


def test_slews_tell_of_north():
    """Of eight positions in two minutes, an eighth of the time: 4% of the error at least."""
    case = CASES["sdc500_eight_position_120s"]
    course = course_of(case.protocol, case.duration_s)
    assert course.slewing.sum() == 7
    with_slews, without = (
        crlb(information(case.model(), c, SITE)) for c in (course, course.only(~course.slewing))
    )
    assert with_slews < 0.97 * without


@pytest.mark.parametrize("samples", [240, 241, 359, 480, 481, 719, 997, 144_000, 144_001])
def test_windows_of_any_length_have_some_two_hundred_blocks(samples):
    size = block_size(samples)
    assert 119 <= samples // size <= 240
    assert samples % size <= samples / 240  # cut at the end


def test_a_prime_number_of_means_is_as_good_as_one_less():
    """241 means were one block, and the floor said 101 degrees for 0.5."""
    case = replace(CASES["sdc500_two_position_0deg"], duration_s=241.0)
    imu = case.model()
    windows = floor_cases.draw(case, imu, 100, seed=6).windows
    own, less = floor(windows, imu), floor(only(windows, 240), imu)
    assert np.rad2deg(np.sqrt(np.mean(own.sigma**2))) < 0.8
    np.testing.assert_allclose(own.sigma, less.sigma, rtol=0.03)


def test_a_warm_up_is_known_to_the_filter_too():
    """Its course is known, its size is not: no random walk. The filter may be a quarter worse than
    the floor, which has everything; its sigma is true to 4 sqrt(2/200)."""
    scores = floor_cases.run(CASES["sdc500_two_position_warming_up"], 200, 2, ("ekf",))
    assert scores["ekf"].over_floor < 1.25
    assert scores["ekf"].nees == pytest.approx(1.0, abs=0.4)


@pytest.mark.parametrize("protocol", [floor_cases.TWO, floor_cases.CAROUSEL],
                         ids=lambda protocol: protocol.name)  # fmt: skip
def test_scale_factors_that_warm_up_are_known_to_floor_and_filter(protocol):
    """20 K at up to 300 ppm/K. The mean of 400 normalised squares has a spread of sqrt(2/400) = 7%;
    three of them."""
    warms = ("imu.temperature.rise_k=20", "imu.temperature.time_s=300",
             "imu.gyro.bias_per_k_deg_per_h_per_k=0.5", "imu.gyro.scale_per_k_ppm_per_k=300",
             "imu.accel.scale_per_k_ppm_per_k=100")  # fmt: skip
    case = floor_cases.Case("warms", "sdc500", protocol, 240.0, 2.0, lean_deg=2.0, overrides=warms)
    imu = case.model()
    drawn = floor_cases.draw(case, imu, 400, seed=11)
    for estimate in (floor, CLASSICAL["ekf"]):
        found = estimate(drawn.windows, imu)
        squares = (wrap(found.heading - drawn.heading) / found.sigma) ** 2
        assert np.mean(squares) == pytest.approx(1.0, abs=3 * np.sqrt(2 / 400))


def test_the_bounds_plan_settles_as_the_bench_does():
    """The blocks at rest after each slew, of the bench's own encoder and of the plan."""
    from sim.physics import execute
    from sim.poses import Bench
    from sim.turntable import SceneConfig

    protocol = floor_cases.EIGHT
    bench = Bench(SceneConfig(), 100.0, 12_000)
    angle = execute(bench, 9.8, plan(protocol, 0, 120.0)).encoder
    really = Course.planned(np.asarray(angle), 0.5, size=50)
    planned = course_of(protocol, 120.0, settle_s=BoundConfig.settle_s)
    assert really.slewing.sum() == planned.slewing.sum() == 7
    assert abs(int(really.resting.sum()) - int(planned.resting.sum())) <= 7
    assert really.resting.sum() < course_of(protocol, 120.0).resting.sum()
    imu = CASES["sdc500_eight_position_120s"].model()
    each = [crlb(information(imu, course, SITE)) for course in (really, planned)]
    assert each[1] == pytest.approx(each[0], rel=0.01)


def test_a_bound_without_accelerometer_errors_is_one():
    """Gyro noise alone, and not even that: nothing is singular."""
    for arw in (0.0, 0.1):
        options = ("imu=ideal", f"imu.gyro.arw_deg_per_sqrt_h={arw}", "protocol=two_position")
        rows = bounds(composed(BoundConfig, "bound", *options, "windows_s=[240]"), floor_cases.TWO)
        assert rows[0]["floor_deg"] == pytest.approx(1.78 * arw / 0.1, rel=0.02, abs=1e-3)


@pytest.mark.parametrize(
    ("option", "more"),
    [("lean_deg=5", 1.01), ("level_error_deg=4", 1.01), ("settle_s=40", 1.05)],
)
def test_each_option_of_the_bound_counts(option, more):
    base = ("imu=stim300", "imu.gyro.g_sensitivity_deg_per_h_per_g=4", "windows_s=[240]")
    configs = [composed(BoundConfig, "bound", *base, *own) for own in ((), (option,))]
    plain, own = (bounds(config, floor_cases.TWO)[0] for config in configs)
    assert own["floor_deg"] > more * plain["floor_deg"]


def test_the_bound_of_a_lean_is_of_its_worst_direction():
    config = composed(BoundConfig, "bound", "imu=stim300", "lean_deg=8", "windows_s=[60]")
    (row,) = bounds(config, floor_cases.STATIC)
    assert np.hypot(row["worst_roll_deg"], row["worst_pitch_deg"]) == pytest.approx(8.0)


def test_coarser_means_of_the_same_windows_agree():
    """Means of one second and of half a second, slews told by either."""
    case = CASES["sdc500_eight_position_120s"]
    imu = case.model()
    fine = floor_cases.draw(case, imu, 100, seed=8).windows
    two = [floor(windows, imu) for windows in (fine, at_rate(fine, 1.0))]
    assert np.sqrt(np.mean(wrap(two[0].heading - two[1].heading) ** 2)) < 0.4 * two[0].sigma[0]


@pytest.mark.parametrize(("interval", "says"), [(1.0, False), (5.0, True)])
def test_means_that_are_too_coarse_for_the_plate_are_named(interval, says):
    """Four positions in a minute: means of five seconds double the floor's error, and the table
    says so; those of one second tell each slew's course."""
    case = floor_cases.Case("", "sdc500", floor_cases.FOUR, 60.0, interval)
    imu = case.model()
    windows = floor_cases.draw(case, imu, 3, seed=9).windows
    said = coarse.note(windows, imu.dt)
    assert (said is not None) == says
    assert not says or "67% of the time and tell nothing of north" in said
    sigma = np.rad2deg(floor(windows, imu).sigma.mean())
    assert sigma == pytest.approx(2.6 if says else 1.16, rel=0.1)


def test_a_slew_within_one_block_of_many_samples_is_told():
    """An hour's blocks take fifteen seconds, a slew of a right angle three and a half."""
    t = (np.arange(36_000) + 0.5) * 0.1
    angle = plan(floor_cases.FOUR, 0, 3600.0).command(t)[0]
    course = Course.planned(angle, 15.0, size=150)
    assert course.slewing.sum() == 3
    assert sum(course.lengths) == 240


def test_when_a_window_starts_matters_where_errors_grow():
    """A log's windows are one set where the sensor's law is the same all the time; a random walk
    and a warm-up tell them apart."""
    case = replace(CASES["sdc500_static_60s"], duration_s=10.0, interval_s=1.0)
    for imu, same in (
        (CASES["stim300_carousel_0deg"].model(), True),
        (case.model(), False),
        (CASES["sdc500_two_position_warming_up"].model(), False),
    ):
        assert timeless(imu) == same
        windows = floor_cases.draw(case, imu, 4, seed=10).windows
        later = replace(windows, start_s=np.array([0.0, 600.0, 1200.0, 6000.0]))
        alone, own = floor(windows, imu), floor(later, imu)
        assert (np.abs(own.sigma / alone.sigma - 1).max() < 1e-9) == same
