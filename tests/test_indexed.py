"""Estimators on level benches, the Gaussian model under them, and the bound that it makes."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import composed
from simulated import PROTOCOLS, windows

from lbgc.bound import BoundConfig
from lbgc.data.windows import joined
from lbgc.earth import EARTH_RATE
from lbgc.errors import InputError
from lbgc.estimators import CLASSICAL
from lbgc.estimators.block_means import Site, levelled
from lbgc.estimators.error_patterns import causes, factors, patterns
from lbgc.estimators.floor import course_of, crlb, expected_floor, floor, white_crlb
from lbgc.estimators.information import budget, information, told
from lbgc.estimators.plate import travel_within, usable
from lbgc.estimators.posterior import bayes
from lbgc.frames import euler_to_matrix, wrap
from lbgc.sensor.imu import ImuModel

RATE_HZ = 10.0
WHO = {
    "static": ("mean", "triad", "gls"),
    "two_position": ("two_position", "two_position_weighted", "gls"),
    "four_position": ("cosine_fit", "cosine_fit_weighted", "gls"),
    "carousel": ("carousel", "carousel_weighted", "gls"),
}
PAIRS = [(protocol, name) for protocol, names in WHO.items() for name in names]
COUNT = 400


def model(name: str = "sdc500") -> ImuModel:
    imu = composed(BoundConfig, "bound", f"imu={name}").imu.model(RATE_HZ)
    # ten samples a second make counts of 0.001 deg/s coarse; tests draw without
    return replace(imu, gyro=replace(imu.gyro, counts=None), accel=replace(imu.accel, counts=None))


IDEAL = model("ideal")
SDC500 = model()


def site(latitude_deg: float) -> Site:
    return Site.at(float(np.deg2rad(latitude_deg)))


@pytest.fixture(scope="module")
def drawn():
    return {p: windows(SDC500, p, 32.76, 240.0, COUNT, seed=5) for p in WHO}


def test_blocks_beside_a_slew_are_at_rest():
    """A rest's last block before a slew tells most of a bias that wanders; one in whose end the
    slew begins, however late, does not rest."""
    slew = np.deg2rad([[0, 0, 0, 40, 150, 180, 180, 180]])
    used, resting = usable(slew)
    np.testing.assert_array_equal(used[0], [1, 1, 1, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(used, resting)
    np.testing.assert_array_equal(travel_within(slew)[0] == 0, used[0])
    begun = slew + np.deg2rad([0, 0, 1e-5, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(usable(begun)[0][0], [1, 1, 0, 0, 0, 1, 1, 1])


def test_a_carousel_keeps_the_ends_where_its_rate_is_steady():
    even = np.deg2rad(6.0) * np.arange(8.0)
    spun_up = np.where(np.arange(8) == 0, np.deg2rad(0.002), even)
    np.testing.assert_array_equal(usable(even)[0], np.ones(8))
    np.testing.assert_array_equal(usable(spun_up)[0], [0, 1, 1, 1, 1, 1, 1, 1])


@pytest.mark.parametrize(("protocol", "name"), PAIRS)
@pytest.mark.parametrize("latitude", [-60.0, 0.0, 32.76, 80.0])
def test_without_errors_the_heading_is_exact(protocol, name, latitude):
    """Both hemispheres, the equator, all headings, a base that leans."""
    headings = np.deg2rad(np.arange(-170.0, 190.0, 30.0))
    w = windows(IDEAL, protocol, latitude, 120.0, len(headings), 0, tilt_deg=(3.0, -4.0),
                heading=headings)  # fmt: skip
    found = CLASSICAL[name](w.windows, SDC500)
    # a leaning carousel's axes turn by 6 degrees within a block, which its means know to 1e-3; a
    # slew's by 30, and its sigma says so
    turns = protocol == "carousel" or (protocol == "four_position" and name != "cosine_fit")
    close = np.deg2rad(0.02 if turns else 2e-3)
    np.testing.assert_allclose(wrap(found.heading - headings), 0.0, atol=close)


@pytest.mark.parametrize(("protocol", "name"), PAIRS)
def test_a_stated_sigma_is_true(drawn, protocol, name):
    """Mean of (error/sigma)^2 over 400: its own spread is sqrt(2/400) = 0.07; four of them."""
    w = drawn[protocol]
    found = CLASSICAL[name](w.windows, SDC500)
    nse = np.mean((wrap(found.heading - w.heading) / found.sigma) ** 2)
    assert nse == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize(("protocol", "name"), PAIRS)
def test_how_far_from_the_floor(drawn, protocol, name):
    """On the same windows: with weighting at most 1.02, plainly 1.05; and a sampling error of a
    ratio that is paired, so small where the two nearly agree."""
    w = drawn[protocol]
    rmse = [
        np.sqrt(np.mean(wrap(estimate(w.windows, SDC500).heading - w.heading) ** 2))
        for estimate in (CLASSICAL[name], floor)
    ]
    most = 1.02 if name.endswith("weighted") or name == "gls" else 1.05
    assert 0.97 < rmse[0] / rmse[1] < most + 0.015


def test_turning_the_plate_beats_resting(drawn):
    """sdc500, 1 deg/h of run bias, 240 s: the issue's figures, each with its sampling error."""

    def rmse(name, protocol):
        w = drawn[protocol]
        errors = wrap(CLASSICAL[name](w.windows, SDC500).heading - w.heading)
        return np.rad2deg(np.sqrt(np.mean(errors**2)))

    assert rmse("mean", "static") == pytest.approx(4.7, rel=4 / np.sqrt(2 * COUNT))
    assert rmse("two_position_weighted", "two_position") < 0.95
    assert rmse("carousel_weighted", "carousel") < 0.70


def test_white_noise_reaches_the_closed_form():
    """Variance over N^2/(Omega^2 cos^2 T): 1 within four of its sampling errors."""
    none = dict.fromkeys(("B", "K", "tone"), (0.0, 0.0, 0.0))
    known = SDC500.without("unit", "session", "run")
    quiet = replace(known.accel, N=(1e-9,) * 3, **none)
    imu = replace(known, gyro=replace(known.gyro, **none), accel=quiet)
    w = windows(imu, "static", 32.76, 60.0, 2000, seed=2, interval=5.0)
    closed = white_crlb(imu.gyro.N[0], w.windows.latitude[0], 60.0)
    for name in ("mean", "gls"):
        variance = np.mean(wrap(CLASSICAL[name](w.windows, imu).heading - w.heading) ** 2)
        assert variance / closed**2 == pytest.approx(1.0, abs=4 * np.sqrt(2 / 2000))
    found = information(imu, course_of(PROTOCOLS["static"], 60.0), site(32.76))
    assert crlb(found) == pytest.approx(closed, rel=1e-3)


@pytest.mark.parametrize("bias_deg_per_h", [3.0, 10.0, 100.0])
def test_a_wide_sigma_is_true_too(bias_deg_per_h):
    """A quarter of the circle, or nothing known at all: errors end at 180 degrees, and sigma knows.

    Squares of errors that are uniform over the circle have a relative spread of 0.9, less than a
    Gaussian's 1.4: sqrt(2/400) = 0.07 at most; four of them."""
    bias = (np.deg2rad(bias_deg_per_h / 3600),) * 3
    imu = replace(SDC500, gyro=SDC500.gyro.with_bias(run=bias))
    w = windows(imu, "static", 32.76, 120.0, COUNT, seed=9, interval=10.0)
    found = CLASSICAL["gls"](w.windows, imu)
    nse = np.mean((wrap(found.heading - w.heading) / found.sigma) ** 2)
    assert nse == pytest.approx(1.0, abs=0.3)


def test_the_secant_law():
    wide = [
        crlb(information(SDC500, course_of(PROTOCOLS["two_position"], 240.0), site(lat)))
        for lat in (0.0, 40.0, 70.0)
    ]
    np.testing.assert_allclose(
        np.array(wide) * np.cos(np.deg2rad([0.0, 40.0, 70.0])), wide[0], rtol=0.02
    )


@pytest.mark.parametrize("lean", [(0.0, 0.0), (4.0, -3.0)])
def test_the_floors_estimator_against_brute_force(lean):
    """A window of few blocks and a slew: the posterior by integrating the full Gaussian density
    over the heading and over both errors of the level, on a grid, with the covariance inverted
    whole; attitudes are composed as matrices."""
    w = windows(SDC500, "two_position", 50.0, 30.0, 2, seed=3, interval=1.25, tilt_deg=lean)
    (part,) = levelled(w.windows, SDC500.dt)
    assert part.course.slewing.sum() == 1
    here, course, n = site(50.0), part.course, len(part.course.blocks)
    base = euler_to_matrix(*np.deg2rad(lean), 0.0)
    B, factor = patterns(SDC500, course), factors(SDC500, course)
    whole = np.zeros((6 * n, 6 * n))
    for c in range(6):
        whole[c * n : (c + 1) * n, c * n : (c + 1) * n] = factor[c] @ factor[c].T
    for drawn in causes(SDC500, base[None], here).values():
        U = np.einsum("nb,rcb->cnr", B, drawn[0]).reshape(6 * n, -1)
        whole += U @ U.T
    inverse = np.linalg.inv(whole)
    plate = np.array([[course.c, course.s, 0 * course.c], [-course.s, course.c, 0 * course.c],
                      [0 * course.c, 0 * course.c, 1 + 0 * course.c]])  # fmt: skip

    def felt(psi, x, y):
        """(*S, 6 n) at this heading and these errors of the level about forward and right."""
        zero = np.zeros(np.broadcast_shapes(np.shape(psi), np.shape(x)))
        small = np.stack([np.stack([1 + zero, zero, y + zero], -1),
                          np.stack([zero, 1 + zero, -x + zero], -1),
                          np.stack([-y + zero, x + zero, 1 + zero], -1)], -2)  # fmt: skip
        earth = np.stack([here.north * np.cos(psi) + zero, -here.north * np.sin(psi) + zero,
                          here.down + zero], -1)  # fmt: skip
        force = np.stack([zero, zero, -here.gravity + zero], -1)
        vectors = np.stack([earth, force], -2)[..., None, :] @ (small @ base)[..., None, :, :]
        return np.einsum("ijn,...tkj->...tin", plate, vectors).reshape(*zero.shape, -1)

    psi = np.linspace(-np.pi, np.pi, 361)[:-1]
    errors = np.linspace(-1.2e-2, 1.2e-2, 31)
    x, y = np.meshgrid(errors, errors)
    found = told(SDC500, part)
    estimate = bayes(found.h, found.J)
    for row, data in enumerate(part.body):
        p = np.zeros(len(psi))
        for k, angle in enumerate(psi):
            at = felt(angle, np.zeros(3), np.zeros(3))[0]
            D = np.stack([felt(angle, *e)[0] - at for e in np.eye(2)[:, :, None] * 1e-3]).T / 1e-3
            best = np.linalg.solve(D.T @ inverse @ D, D.T @ inverse @ (data.ravel() - at))
            off = data.ravel() - felt(angle, best[0] + x, best[1] + y)
            p[k] = np.sum(
                np.exp(-0.5 * np.einsum("...i,ij,...j->...", off, inverse, off, optimize=True))
            )
        p /= p.sum()
        mean = np.angle(np.sum(p * np.exp(1j * psi)))
        assert wrap(estimate.heading[row] - mean) == pytest.approx(0.0, abs=np.deg2rad(0.02))
        spread = np.sqrt(np.sum(p * wrap(psi - mean) ** 2))
        assert estimate.sigma[row] == pytest.approx(spread, rel=0.01)


def test_above_thirty_degrees_the_floor_saturates_and_the_closed_form_is_silent():
    noisy = replace(SDC500, gyro=SDC500.gyro.with_bias(run=(1e-2,) * 3))
    found = information(noisy, course_of(PROTOCOLS["static"], 60.0), site(32.76))
    assert np.isnan(crlb(found))
    # the RMS of a uniform angle is 180/sqrt 3 = 103.9 degrees
    assert np.rad2deg(expected_floor(found)) == pytest.approx(103.9, rel=0.04)


def test_the_budget_adds_up_to_the_bound():
    course = course_of(PROTOCOLS["two_position"], 240.0)
    parts = budget(SDC500, course, site(32.76), np.deg2rad(np.arange(0, 360, 10.0)))
    found = information(SDC500, course, site(32.76))
    assert np.sqrt(sum(v**2 for v in parts.values())) == pytest.approx(crlb(found), rel=1e-3)
    assert parts["bias of the run"] < 0.1 * parts["bias instability"]


def test_a_later_window_of_a_random_walk_is_worse():
    known = SDC500.without("run")
    walk = replace(known, gyro=replace(known.gyro, K=(2e-7,) * 3))
    early, late = (
        crlb(information(walk, course_of(PROTOCOLS["static"], 60.0, start), site(0.0)))
        for start in (0.0, 600.0)
    )
    assert late > 1.5 * early


@pytest.mark.parametrize(
    ("protocol", "name", "says"),
    [
        ("static", "two_position", "half a turn apart"),
        ("two_position", "cosine_fit", "three or more"),
        ("static", "carousel", "half a turn or more"),
        ("two_position", "mean", "at rest only"),
        ("two_position", "triad", "at rest only"),
    ],
)
def test_what_an_estimator_cannot_answer_it_refuses(drawn, protocol, name, says):
    with pytest.raises(InputError, match=says):
        CLASSICAL[name](drawn[protocol].windows, SDC500)


def test_other_refusals(drawn):
    w = drawn["static"].windows
    with pytest.raises(InputError, match="noise model"):
        CLASSICAL["gls"](w, None)
    with pytest.raises(InputError, match="without accelerometers"):
        CLASSICAL["gls"](replace(w, accel=0 * w.accel), SDC500)
    with pytest.raises(InputError, match="no north"):
        CLASSICAL["gls"](replace(w, latitude=0 * w.latitude + np.pi / 2), SDC500)
    leaning = windows(IDEAL, "static", 40.0, 20.0, 2, 0, tilt_deg=(20.0, 0.0)).windows
    with pytest.raises(InputError, match="degrees of level"):
        CLASSICAL["gls"](leaning, SDC500)


def test_triad_is_the_mean_by_another_way(drawn):
    w = drawn["static"].windows
    both = [CLASSICAL[name](w, None).heading for name in ("mean", "triad")]
    np.testing.assert_allclose(wrap(both[0] - both[1]), 0.0, atol=1e-9)


def test_the_command_prints_bound_and_budget(cli, tmp_path):
    done = cli("lbgc.bound", "imu=stim300", "protocol=two_position", "latitude=60",
               "windows_s=[60,240]")  # fmt: skip
    assert done.code == 0, done.err
    assert "STIM300, two_position, latitude 60: degrees" in done.out
    assert "white noise" in done.out
    assert (tmp_path / done.last_line / "bound.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("latitude=90",), "must be between the poles"),
        (("known=[month]",), "choose from unit, session, run"),
        (("windows_s=[]",), "must name a length"),
        (("protocol=two_position", "windows_s=[5]"), "takes 6.5 s with its slews"),
    ],
)
def test_bad_bound_input_is_named(cli, options, says):
    done = cli("lbgc.bound", *options)
    assert done.code == 2
    assert says in done.err


def test_one_block_is_a_window_too():
    w = windows(IDEAL, "static", 40.0, 10.0, 3, 0, interval=10.0)
    for name in ("mean", "gls"):
        found = CLASSICAL[name](w.windows, SDC500)
        np.testing.assert_allclose(wrap(found.heading - w.heading), 0.0, atol=1e-4)
        assert np.isfinite(found.sigma).all()


@pytest.mark.parametrize("name", ["floor", "gls", "two_position_weighted"])
def test_what_weighs_by_a_model_refuses_windows_that_contradict_it(drawn, name):
    """One that rocks among all the others, too."""
    w = drawn["two_position" if name.startswith("two") else "static"].windows
    estimate = {**CLASSICAL, "floor": floor}[name]
    estimate(w, SDC500)
    w.accel[3:4] += 0.05 * np.sin(np.arange(w.accel.shape[1]))[:, None]
    try:
        with pytest.raises(InputError, match=f"in 1 of {len(w)} windows: the base moves"):
            estimate(w, SDC500)
    finally:
        w.accel[3:4] -= 0.05 * np.sin(np.arange(w.accel.shape[1]))[:, None]


@pytest.mark.parametrize("protocol", ["static", "two_position"])
def test_a_plain_estimators_sigma_has_the_motion_that_windows_show(drawn, protocol):
    """A base that turns to and fro at up to Earth's rate: the mean rate is off by some share of it,
    no more than white noise as large as the eighths' scatter makes. A window that fits the sensor's
    model keeps its sigma to the last digit."""
    name = {"static": "mean", "two_position": "two_position"}[protocol]
    w, heading = drawn[protocol].windows, drawn[protocol].heading
    gyro = w.gyro.copy()
    gyro[3, :, 0] += EARTH_RATE * np.sin(np.linspace(0, 10, gyro.shape[1]))
    found, moved = (CLASSICAL[name](own, SDC500) for own in (w, replace(w, gyro=gyro)))
    others = np.arange(len(w)) != 3
    np.testing.assert_array_equal(moved.sigma[others], found.sigma[others])
    assert moved.sigma[3] > 2 * found.sigma[3]
    assert abs(wrap(moved.heading[3] - heading[3])) < 3 * moved.sigma[3]


@pytest.mark.parametrize("protocol", ["static", "two_position"])
@pytest.mark.parametrize("name", ["bmi160", "sdc500", "stim300", "hg9900"])
def test_what_a_sensor_measures_fits_its_own_model(name, protocol):
    """From phone to navigation grade. The mean of N squares is known to sqrt(2/N), 2% here; five of
    them, and misalignment's share, which the model averages over headings."""
    imu = model(name)
    (part,) = levelled(windows(imu, protocol, 32.76, 60.0, 60, seed=9).windows)
    left = np.mean(told(imu, part, check=True).misfit)
    assert left == pytest.approx(1.0, abs=0.1)


def test_windows_of_several_latitudes_are_answered_each_for_its_own():
    both = [
        windows(SDC500, "two_position", lat, 120.0, 3, seed=8).windows for lat in (32.76, -60.0)
    ]
    for estimate in (CLASSICAL["two_position_weighted"], CLASSICAL["gls"]):
        alone = np.concatenate([estimate(w, SDC500).sigma for w in both])
        np.testing.assert_allclose(estimate(joined(both), SDC500).sigma, alone, rtol=1e-9)
