"""A plate that turns about a level axis: what its sensors feel, what can be told of north, and what
cannot."""

from dataclasses import replace

import floor_cases
import numpy as np
import pytest
import yaml
from helpers import composed, default_config, generate

import lbgc.fit
from lbgc.bound import BoundConfig, bounds
from lbgc.data import course
from lbgc.data.record import Record, mock_record
from lbgc.data.windows import cut, joined
from lbgc.earth import EARTH_RATE, earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.estimators import CLASSICAL
from lbgc.estimators.block_means import levelled
from lbgc.estimators.floor import floor
from lbgc.estimators.information import information
from lbgc.estimators.reduced_order import When, turned_with_plate
from lbgc.fit import FitConfig
from lbgc.frames import AXES, across, euler_to_matrix, rotation, rotation_z, turned, wrap
from lbgc.learning import pretrained
from lbgc.outputs import fingerprint
from lbgc.protocol import ProtocolConfig, plan
from lbgc.sensor.datasheet import AccelConfig, GyroConfig, ImuConfig
from lbgc.train import TrainConfig
from sim import physics
from sim.motion import Draw, Truth, truth
from sim.poses import Bench
from sim.turntable import SceneConfig, load, out_of_balance

DEG = np.pi / 180
LEVEL = (0, 1)
LATITUDE, AZIMUTH = 0.6, 0.7
SCENE = SceneConfig()


def indexed(axis: int, *angles: float, **changes) -> ProtocolConfig:
    return ProtocolConfig("over", "indexed", axis=AXES[axis], angles_deg=angles, **changes)


def moved(protocol: ProtocolConfig, seconds: float, lean=(0.0, 0.0), scene=SCENE) -> Truth:
    """100 samples a second on a base of azimuth 0.7 rad, which leans by roll and pitch, rad."""
    bench = Bench(scene, 100.0, round(100 * seconds), AXES.index(protocol.axis))
    drawn = Draw(AZIMUTH, *lean, scene.floor.still, 0.0, None)
    return truth(bench, plan(protocol, 0, seconds), LATITUDE, drawn)


# --- geometry -------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", range(3))
def test_vectors_turn_about_the_axis_by_the_right_hand_rule(axis):
    v, angle = np.random.default_rng(1).standard_normal((4, 3)), np.array([0.3, -2.0, 4.0, 0.0])
    by_matrix = (rotation(angle, axis) @ v[..., None])[..., 0]
    np.testing.assert_allclose(turned(v, angle, axis), by_matrix, atol=1e-15)
    i, j = across(axis)
    np.testing.assert_allclose(turned(np.eye(3)[i], np.array(np.pi / 2), axis), np.eye(3)[j],
                               atol=1e-15)  # fmt: skip


# --- the bench ------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", LEVEL)
def test_a_plate_on_its_side_and_over_feels_earths_rate_and_gravity_there(axis):
    """By Rodrigues on a base that leans, at the angle that the encoder reads: a servo without an
    integrator sags by a third of a degree under the modules' weight."""
    lean = (0.05, -0.03)
    found = moved(indexed(axis, 0, 90, 180), 60.0, lean)
    level = euler_to_matrix(*lean, 0.0)
    base = rotation_z(AZIMUTH) @ level @ rotation_z(np.pi)  # the test module looks the other way
    for at, degrees in ((0, 0.0), (3000, 90.0), (5999, 180.0)):
        angle = found.plate_angle[at]
        assert angle / DEG == pytest.approx(degrees, abs=0.5)
        c_nb = base @ rotation(angle, axis)
        np.testing.assert_allclose(found.omega_ib_b[:, at], c_nb.T @ earth_rate_ned(LATITUDE),
                                   atol=1e-9 * EARTH_RATE)  # fmt: skip
        gravity = c_nb.T @ [0.0, 0.0, -normal_gravity(LATITUDE)]
        np.testing.assert_allclose(found.f_ib_b[:, at], gravity, atol=1e-9)
    assert abs(found.plate_angle[3000] / DEG - 90) > 0.1
    assert found.plate_angle[5999] / DEG == pytest.approx(180.0, abs=1e-6)
    np.testing.assert_allclose(np.ptp(found.attitude, axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize("axis", LEVEL)
def test_the_gyro_along_the_axis_feels_all_of_the_turn_and_the_arm_is_felt(axis):
    """On a wheel about right the module goes round at 0.27 m, and 42 mm above the axis; about
    forward the axis goes through below it."""
    wheel = ProtocolConfig("wheel", "carousel", axis=AXES[axis], carousel_deg_per_s=30.0)
    found = moved(wheel, 20.0)
    earth = rotation_z(AZIMUTH + np.pi).T @ earth_rate_ned(LATITUDE)
    turn = np.sum(found.omega_ib_b[axis] - earth[axis]) / 100
    assert turn == pytest.approx(found.plate_angle[-1], abs=1e-9)
    late = slice(1000, None)
    angle = found.plate_angle[late] - 0.5 * 0.3 * DEG  # at the samples' middles
    down = np.array([0.0, 0.0, -normal_gravity(LATITUDE)])
    gravity = turned(np.tile(down, (len(angle), 1)), -angle, axis).T * np.sinc(0.15 * DEG / np.pi)
    arm = np.array([0.27, 0.0, -0.042]) * (np.arange(3) != axis)
    rest = found.f_ib_b[:, late] - gravity
    expected = -arm * (30 * DEG) ** 2
    np.testing.assert_allclose(rest.mean(axis=1), expected, atol=2e-4)


def test_the_servo_carries_what_is_out_of_balance():
    """The modules, 1 kg together, stand 42 mm above the axis."""
    for axis in LEVEL:
        torque = out_of_balance(load(SCENE, 9.8, axis))
        assert torque == pytest.approx(1.0 * 9.8 * 0.042)
    assert out_of_balance(load(SCENE, 9.8)) == 0.0
    weak = replace(SCENE, servo_torque_nm=0.6)
    slews = plan(indexed(0, 0, 180, slew_deg_per_s2=60.0), 0, 60.0)
    physics.check_servo(replace(SCENE, servo_torque_nm=0.7), slews, 0)
    with pytest.raises(InputError, match="it can do"):
        physics.check_servo(weak, slews, 0)


def test_a_plate_about_down_is_the_dataset_that_it_was():
    content = default_config().content()
    assert "axis" not in content["protocol"]
    other = replace(default_config(), protocol=indexed(0, 0, 180)).content()
    assert other["protocol"]["axis"] == "forward"
    down = replace(default_config(), protocol=indexed(2, 0, 180)).content()
    assert len({fingerprint(own) for own in (content, other, down)}) == 3


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"kind": "static", "axis": "forward"}, "must be down"),
        ({"kind": "heading_scan", "axis": "right"}, "must be down"),
        ({"kind": "indexed", "axis": "right", "angles_deg": (90.0, 270.0)}, "must begin with 0"),
        ({"kind": "indexed", "axis": "up"}, "forward"),
    ],
)
def test_what_no_plate_can_do_is_refused(changes, says):
    with pytest.raises(InputError, match=says):
        ProtocolConfig(**changes)


# --- what can be told -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rolled():
    """sdc500, turned over its forward axis: 500 recordings, each of its own unit."""
    case = floor_cases.Case("roll", "sdc500", floor_cases.ROLL, 240.0, 2.0)
    imu = case.model()
    return imu, floor_cases.draw(case, imu, 500, seed=8)


@pytest.mark.parametrize(
    "name", ["floor", "gls", "two_position", "two_position_weighted", "ekf"]
)  # fmt: skip
def test_estimators_know_their_errors(rolled, name):
    """The mean of 500 normalised squares has a spread of 0.07, a third more where two peaks
    merge."""
    imu, drawn = rolled
    found = floor_cases.EVERY[name](drawn.windows, imu)
    errors = wrap(found.heading - drawn.heading)
    assert np.mean((errors / found.sigma) ** 2) == pytest.approx(1.0, abs=4 * 0.09)
    best = floor(drawn.windows, imu)
    least = np.sqrt(np.mean(wrap(best.heading - drawn.heading) ** 2))
    assert np.sqrt(np.mean(errors**2)) < 1.15 * least


def test_north_is_sharp_ahead_and_blurred_aside(rolled):
    """Over the forward axis the right gyro's bias goes, and it feels Omega cos(lat) sin(psi)."""
    imu, drawn = rolled
    found = floor(drawn.windows, imu)
    ahead = np.abs(np.sin(drawn.heading)) < 0.3
    aside = np.abs(np.cos(drawn.heading)) < 0.3
    assert np.median(found.sigma[aside]) > 2 * np.median(found.sigma[ahead])


def test_a_hidden_bias_along_the_axis_leaves_two_headings():
    """The gyros' biases are far above Earth's rate: psi and 180 degrees less psi are alike, either
    is likeliest, and the floor answers their mean. All say so."""
    case = floor_cases.Case("roll", "sdc500", floor_cases.ROLL, 240.0, 2.0)
    biased = ("imu.gyro.bias_run_deg_per_h=3000",)
    imu = replace(case, overrides=biased).model()
    drawn = floor_cases.draw(case, imu, 200, seed=9)
    found = CLASSICAL["two_position"](drawn.windows, imu)
    mirrored = np.pi - drawn.heading
    off = np.minimum(*(np.abs(wrap(found.heading - own)) for own in (drawn.heading, mirrored)))
    near = np.abs(np.cos(drawn.heading)) > 0.5
    assert np.median(off[near]) < 3 * DEG
    wrong = np.abs(wrap(found.heading - drawn.heading)) > 30 * DEG
    assert 0.25 < wrong[near].mean() < 0.75
    assert found.sigma[near].min() > 20 * DEG
    for estimate in (found, floor(drawn.windows, imu)):
        errors = wrap(estimate.heading - drawn.heading)
        assert np.mean((errors / estimate.sigma) ** 2) == pytest.approx(1.0, abs=0.3)


def test_a_bound_about_a_level_axis():
    """It agrees with the floor's own errors, and quotes no linear bound where there is none."""
    config = composed(BoundConfig, "bound", "imu=sdc500", "protocol=two_position_tumble",
                      "windows_s=[240]")  # fmt: skip
    (row,) = bounds(config, config.protocol)
    assert np.isnan(row["crlb_deg"])
    case = floor_cases.Case("over", "sdc500", floor_cases.OVER, 240.0, 2.0)
    imu = case.model()
    drawn = floor_cases.draw(case, imu, 2000, seed=5)
    squares = wrap(floor(drawn.windows, imu).heading - drawn.heading) ** 2
    spread = squares.std() / np.sqrt(len(squares)) / np.mean(squares) / 2
    rmse = float(np.rad2deg(np.sqrt(squares.mean())))
    assert row["floor_deg"] == pytest.approx(rmse, rel=4 * (spread + 0.01))
    fine = composed(BoundConfig, "bound", "imu=hg9900", "protocol=two_position_tumble",
                    "windows_s=[240]")  # fmt: skip
    (own,) = bounds(fine, fine.protocol)
    assert own["crlb_deg"] == pytest.approx(own["floor_deg"], rel=0.03)


def test_what_follows_gravity_turns_as_north_does(rolled):
    """A gyro's g-sensitivity is no bias there: 2 deg/h/g blurs what was sharp, and filter and floor
    say so alike."""
    case = floor_cases.Case("g", "sdc500", floor_cases.ROLL, 240.0, 2.0,
                            overrides=("imu.gyro.g_sensitivity_deg_per_h_per_g=2",))  # fmt: skip
    imu = case.model()
    variances = turned_with_plate(imu, When(240.0, *(np.zeros(1),) * 2, np.full(1, 9.8), 0))
    assert np.sqrt(variances[0, 0, 0]) == pytest.approx(2 * DEG / 3600, rel=1e-3)
    drawn = floor_cases.draw(case, imu, 200, seed=2)
    sigma = {}
    for name in ("floor", "ekf"):
        found = floor_cases.EVERY[name](drawn.windows, imu)
        errors = wrap(found.heading - drawn.heading)
        assert np.mean((errors / found.sigma) ** 2) == pytest.approx(1.0, abs=4 * 0.12), name
        sigma[name] = np.median(found.sigma)
    without, _ = rolled
    sharp = floor_cases.draw(replace(case, overrides=()), without, 200, seed=2)
    assert sigma["floor"] > 2 * np.median(floor(sharp.windows, without).sigma)
    assert sigma["ekf"] == pytest.approx(sigma["floor"], rel=0.05)


def test_the_gyro_along_the_axis_is_asked_for_its_bias(rolled):
    imu, drawn = rolled
    with pytest.raises(InputError, match=r"imu: is not known: the gyro forward.* keeps its bias"):
        CLASSICAL["two_position"](drawn.windows, None)
    part = levelled(drawn.windows.rows(slice(0, 1)), imu.dt)[0]
    free = information(imu, part.course, part.site, free_bias=True)
    assert np.linalg.eigvalsh(free.J[0])[0] > 1.0  # the bias along the axis is the sensor's own


@pytest.mark.parametrize("name", ["mean", "triad", "gls"])
def test_a_plate_that_rests_over_answers_as_one_that_is_level(rolled, name):
    """Static methods answer either position by itself, the second one upside down."""
    imu, drawn = rolled
    for part in (slice(0, 50), slice(-50, None)):
        values = {k: getattr(drawn.windows, k)[:, part] for k in ("gyro", "accel", "plate_angle")}
        found = CLASSICAL[name](replace(drawn.windows, **values), imu)
        errors = wrap(found.heading - drawn.heading)
        assert np.mean((errors / found.sigma) ** 2) == pytest.approx(1.0, abs=4 * 0.09)


def test_what_takes_a_plate_about_down_says_so(rolled, tmp_path, monkeypatch):
    imu, drawn = rolled
    says = "that is turned about forward is none of its"
    for name in ("oba", "oba_bias", "oba_interval"):
        with pytest.raises(InputError, match=says):
            CLASSICAL[name](drawn.windows, imu)
    for model in pretrained.every():
        with pytest.raises(InputError, match=says):
            replace(model, untrained=True)(drawn.windows)
    monkeypatch.chdir(tmp_path)
    generate(tmp_path / "d.zarr", recordings=20, rate_hz=10.0, duration_s=60.0, output="means",
             mean_s=1.0, protocol=indexed(0, 0, 180))  # fmt: skip
    with pytest.raises(InputError, match="turn about forward: networks are trained on those about"):
        lbgc.train.main(composed(TrainConfig, "train", "data=d.zarr", "windows_s=[60]",
                                 "mean_s=1", "steps=1"))  # fmt: skip


def test_a_base_that_moves_under_a_level_axis_is_refused(rolled):
    imu, drawn = rolled
    rng = np.random.default_rng(3)
    shaken = drawn.windows.accel + 0.05 * rng.standard_normal(drawn.windows.accel.shape)
    with pytest.raises(InputError, match="the base moves, which takes a plate about down"):
        CLASSICAL["ekf"](replace(drawn.windows, accel=shaken).rows(slice(0, 4)), imu)


@pytest.mark.parametrize("axis", range(3))
def test_a_base_that_sways_widens_what_least_squares_say(rolled, axis):
    """About whichever axis: a block's rate scatters by twenty times the sensor's noise."""
    imu, drawn = rolled
    windows = drawn.windows.rows(slice(0, 20))
    gyro = windows.gyro.copy()
    noise = np.random.default_rng(6).standard_normal(gyro.shape[:2])
    gyro[..., axis] += 20 * 9e-6 / np.sqrt(2.0) * noise
    still, sways = (
        CLASSICAL["two_position"](own, imu) for own in (windows, replace(windows, gyro=gyro))
    )
    assert np.median(sways.sigma) > 3 * np.median(still.sigma)
    errors = wrap(sways.heading - drawn.heading[:20])
    assert np.mean((errors / sways.sigma) ** 2) < 2.0


def test_plates_about_two_axes_are_no_one_set():
    one = cut(mock_record(), 10.0)
    assert joined([one, one]).axis == 2
    with pytest.raises(InputError, match="forward and down: must be one"):
        joined([one, replace(one, axis=0)])


# --- noise of a turned recording ------------------------------------------------------------------


def turned_record(axis: int, kind: str, rng: np.random.Generator) -> Record:
    """100 s of white noise, 1e-4 rad/s and 1e-2 m/s^2 a sample, on a plate with a bias."""
    n, rate = 2000, 20.0
    t = (np.arange(n) + 1) / rate
    angle = 0.1 * t if kind == "even" else np.where(t > 50, np.pi, 0.0)
    still = mock_record()
    gyro, accel = (turned(np.tile(v[0], (n, 1)), -angle, axis) for v in (still.gyro, still.accel))
    gyro[:, axis] += np.gradient(angle, t) if kind == "even" else 0.0
    gyro = gyro + 1e-4 * rng.standard_normal((n, 3))
    accel = accel + 1e-2 * rng.standard_normal((n, 3))
    return replace(still, gyro=gyro, accel=accel, plate_angle=angle, rate_hz=rate, axis=axis)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("kind", ["even", "rests"])
def test_a_turned_recording_without_its_turns_is_its_noise(axis, kind, rng):
    record = turned_record(axis, kind, rng)
    parts = course.resting_parts(record)
    assert len(parts) == {"even": 1, "rests": 2}[kind]
    assert all(not np.ptp(part.plate_angle) for part in parts)
    for part in parts:
        share = np.sqrt(2 / len(part.gyro))  # of a variance
        for values, sigma in ((part.gyro, 1e-4), (part.accel, 1e-2)):
            np.testing.assert_allclose(values.var(axis=0) / sigma**2, 1.0, atol=4.5 * share)
    first = parts[0]
    off = first.accel.mean(axis=0) - mock_record().accel[0]
    assert np.abs(off).max() < 5 * 1e-2 / np.sqrt(len(first.accel) / 2)
    assert any("turned: noise is fitted to" in note for note in first.notes)


def test_a_plate_that_never_rests_nor_turns_evenly_is_refused(rng):
    record = turned_record(0, "even", rng)
    wild = replace(record, plate_angle=record.plate_angle**1.5)
    with pytest.raises(InputError, match="neither rests for some seconds nor turns evenly"):
        course.resting_parts(wild)


def test_fit_reads_the_noise_of_a_turned_dataset(tmp_path, monkeypatch, capsys):
    """Within four sigma: 1200 samples tell white noise to 2%, and a fit to half as many again. What
    an even turn's scale errors leave is stated as no bias; rests are recordings of their own."""
    monkeypatch.chdir(tmp_path)
    own = ImuConfig(
        "own",
        gyro=GyroConfig(arw_deg_per_sqrt_h=0.05, scale_unit_ppm=500.0, bias_run_deg_per_h=1.0),
        accel=AccelConfig(vrw_m_per_s_per_sqrt_h=0.05),
    )
    for kind in ("indexed", "carousel"):
        generate(tmp_path / kind, recordings=1, rate_hz=10.0, duration_s=150.0, imu=own,
                 protocol=replace(indexed(0, 0, 180), kind=kind))  # fmt: skip
    (static,) = lbgc.fit._read(FitConfig(data="indexed", name="mine"))
    assert static.gyro.shape == (2, 685, 3)
    assert not static.turned
    assert static.heading is None
    assert "noise is fitted to 2 rests of" in capsys.readouterr().out
    found = lbgc.fit.main(FitConfig(data="carousel", name="mine", processes=1))
    said = (found / "imu/mine.yaml").read_text()
    fitted = yaml.safe_load(said)
    for triad, key in (("gyro", "arw_deg_per_sqrt_h"), ("accel", "vrw_m_per_s_per_sqrt_h")):
        np.testing.assert_allclose(fitted[triad][key], 0.05, rtol=0.12)
    assert "gyro bias of" not in said
