"""The tumble: poses at rest with unknown headings, against brute force, bounds and labels."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tumbled import LATITUDE, RATE_HZ, Dense, poses, sensor

from lbgc.attitudes import uniform
from lbgc.data.poses import Poses
from lbgc.data.windows import Windows
from lbgc.errors import InputError
from lbgc.estimators import error_patterns, pose_information
from lbgc.estimators import held as holding
from lbgc.estimators.held import held, planned, shortest
from lbgc.estimators.pose_information import form
from lbgc.estimators.torus import Torus, particles
from lbgc.estimators.tumble import solved, tumble, turned_by
from lbgc.estimators.tumble_floor import Tumbling, expected, small_errors
from lbgc.estimators.unit_posterior import Reference, evidence, posterior
from lbgc.frames import euler_to_matrix, rotation_matrix, wrap
from lbgc.sensor.imu import ImuModel
from lbgc.sensor.noise import White

DPH = np.deg2rad(1) / 3600


@pytest.fixture
def few_parts(monkeypatch):
    """Four parts a pose, so that dense matrices stay small."""
    monkeypatch.setattr(holding, "_PARTS", 1)
    pose_information.reduction.cache_clear()
    yield
    pose_information.reduction.cache_clear()


def level(*headings_deg: float) -> np.ndarray:
    return euler_to_matrix(0.0, 0.0, np.deg2rad(headings_deg))


def white(imu: ImuModel) -> ImuModel:
    """The sensor with white noise alone in its gyros, and accelerometers that hardly err."""
    terms = tuple((White(float(N)),) for N in imu.gyro.N)
    still = tuple((White(1e-6),) for _ in range(3))
    none = tuple(e.gone() for e in imu.accel.drawn)
    gyro = replace(imu.gyro, terms=terms, started=((), (), ()))
    accel = replace(imu.accel, terms=still, started=((), (), ()), drawn=none)
    return replace(imu, gyro=gyro, accel=accel)


def test_what_poses_tell_is_what_one_dense_gaussian_tells(few_parts):
    """Bins of the posterior's marginals, for two poses and three."""
    for seed, count, name in ((3, 2, "stim300"), (4, 3, "stim300"), (5, 3, "adis16495")):
        rng, imu = np.random.default_rng(seed), sensor(name)
        log = poses(rng, imu, uniform(rng, count), 30.0)
        of, _own, about = solved(held(log, imu), imu, "either")
        dense = Dense(imu, of)
        h, J = dense.form(about.modes[0])
        cell = np.deg2rad(2.5 + np.arange(0, 360, 5.0))
        grid = np.stack(np.meshgrid(*[cell] * count, indexing="ij"), -1).reshape(-1, count)
        q = np.concatenate([np.cos(grid), np.sin(grid)], axis=1)
        log_p = q @ h - np.einsum("ki,ki->k", q @ J, q) / 2
        weight = np.exp(log_p - log_p.max())
        weight /= weight.sum()
        found = particles(about, 4000)
        likely = grid[np.argsort(-weight)[:20]]
        ours = about.torus.log_p(likely)
        theirs = dense.log_p(likely)  # errors that follow the truth taken at each by itself
        np.testing.assert_allclose(ours - ours[0], theirs - theirs[0], atol=1e-3)
        for p in range(count):
            each = [
                np.bincount(((np.rad2deg(psi) + 15) % 360 // 30).astype(int), w, 12)
                for psi, w in ((grid[:, p], weight), (found.theta[:, p], found.weight))
            ]
            # Moved particles are not independent of each other: a fifth of them count.
            error = np.sqrt(each[0] * (1 - each[0]) / 800)
            assert (np.abs(each[1] - each[0]) < 4 * error + 1e-3).all(), (seed, p, each)


@pytest.mark.parametrize(
    ("name", "count", "dwell_s", "integrated"),
    [("stim300", 12, 120.0, False), ("hg4930", 6, 30.0, False), ("adis16495", 6, 30.0, True)],
)
def test_errors_are_as_large_as_the_bound_and_the_sigmas_say(name, count, dwell_s, integrated):
    imu, runs = sensor(name), 40
    square, normal, bound = np.empty((3, runs))
    for run in range(runs):
        rng = np.random.default_rng(run)
        truth = uniform(rng, count)
        of = held(poses(rng, imu, truth, dwell_s, integrated), imu)
        found = tumble(poses(np.random.default_rng(run), imu, truth, dwell_s, integrated), imu)
        off = turned_by(found.attitude, truth)
        square[run], normal[run] = np.mean(off**2), np.mean((off / found.sigma) ** 2)
        bound[run] = np.trace(small_errors(of, imu, turned_by(truth, of.base))) / count
    assert np.rad2deg(np.sqrt(bound.mean())) < 6
    ratio, error = square.mean() / bound.mean(), square.std() / bound.mean() / np.sqrt(runs)
    assert 0.9 - 3 * error < ratio < 1.05**2 + 3 * error
    assert abs(normal.mean() - 1) < 0.1 + 3 * normal.std() / np.sqrt(runs)


def test_an_unknown_latitude_is_in_its_interval():
    imu, runs, inside, nearest = sensor("hg4930"), 30, 0, []
    for run in range(runs):
        rng = np.random.default_rng(run)
        latitude = np.deg2rad(rng.uniform(-70, 70))
        log = poses(rng, imu, uniform(rng, 8), 30.0, latitude=latitude, known=False)
        found = tumble(log, imu)
        low, high = found.latitude_interval
        inside += low < latitude < high
        nearest.append(abs(found.latitude - latitude) / (high - low))
    # Of thirty 95% intervals fewer than 25 hold the truth once in three hundred.
    assert inside >= 25
    assert np.median(nearest) < 0.35


def test_told_labels_agree_with_the_labelled_posterior(monkeypatch):
    """One session whose headings are given: the bias is what labelled recordings tell of it."""
    monkeypatch.setattr(error_patterns, "_GRAVITY", 0.0)  # there each recording has its own
    monkeypatch.setattr(error_patterns, "_LATITUDE", 0.0)
    imu, rng = white(sensor("stim300")), np.random.default_rng(1)
    imu = replace(imu, gyro=imu.gyro.without("run"))
    truth = uniform(rng, 7)
    log = poses(rng, imu, truth, 24.0)
    of = held(log, imu)
    heading = turned_by(truth, of.base)
    own = form(of, imu, heading)
    bias = own.errors(Torus(own).v(heading)).bias
    gyro, accel = (np.array([x[a:b] for a, b in log.rests]) for x in (log.gyro, log.accel))
    none, P = np.zeros(len(truth)), len(truth)
    windows = Windows(
        gyro=gyro,
        accel=accel,
        plate_angle=np.zeros(gyro.shape[:2]),
        rate_hz=RATE_HZ,
        latitude=none + LATITUDE,
        start_s=none,
    )
    told = evidence(imu, [windows], heading, Reference(none))
    known = posterior(imu, told, np.zeros(P), 0.0).known
    at = np.array([
        [c.triad == "gyro" and c.error.startswith("bias_") and c.i == axis
         for c in known.coefficients] for axis in range(3)
    ], float)  # fmt: skip
    np.testing.assert_allclose(bias / DPH, at @ known.mean / DPH, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(
        own.bias_covariance / DPH**2, at @ known.covariance @ at.T / DPH**2, rtol=1e-4, atol=1e-7
    )


def test_turns_between_poses_are_what_the_gyros_tell():
    """Without errors the gyros' turns are the headings' differences, to the rotation in a sample;
    a saturated one is not used."""
    imu, rng = sensor("ideal"), np.random.default_rng(2)
    truth = uniform(rng, 5)
    log = poses(rng, imu, truth, 10.0, integrated=True)
    of = held(log, imu)
    own = form(of, sensor("stim300"))
    heading = turned_by(truth, of.base)
    assert own.linked.tolist() == [0, 1, 2, 3]
    off = Torus(own).v(heading)[-4:]
    # Earth turns by 0.04 degrees in ten seconds; that is part of the model, not of Delta.
    assert (np.abs(np.rad2deg(off)) < 0.05).all()
    most = float(np.abs(log.gyro[log.rests[1][1] : log.rests[2][0]]).max())
    few = replace(imu, gyro=replace(imu.gyro, range=most))
    assert 1 not in held(log, few).linked
    assert len(held(replace(log, integrated=False), imu).linked) == 0


def test_two_level_headings_leave_a_mirror_and_three_none():
    """The bias is told by no vertical rate: the known horizontal rate is a circle about it."""
    imu = white(sensor("stim300"))
    ways = {}
    for angles in ((10.0, 80.0), (10.0, 80.0, 200.0)):
        rng = np.random.default_rng(3)
        found = tumble(poses(rng, imu, level(*angles), 900.0), imu)
        ways[len(angles)] = found
        assert any(note.startswith("rank 1 of 3") for note in found.notes)
        assert "forward axis" in found.notes[0] or "right axis" in found.notes[0]
    assert len(ways[2].modes) == 2
    assert any("mirror" in own for own in ways[2].notes)
    assert any("ways to hold" in own for own in ways[2].notes)
    assert len(ways[3].modes) == 1
    assert not any("mirror" in own for own in ways[3].notes)
    np.testing.assert_allclose(sum(own.weight for own in ways[2].modes), 1, atol=0.01)


def test_the_sign_of_the_latitude_rests_on_the_prior_where_all_poses_are_level():
    imu, rng = white(sensor("stim300")), np.random.default_rng(4)
    log = poses(rng, imu, level(0, 60, 120, 180, 240, 300), 300.0, known=False)
    either, south = tumble(log, imu), tumble(log, imu, "south")
    assert any("sign of the latitude" in note for note in either.notes)
    assert any("g-sensitivity" in note for note in either.notes)
    signs = {np.sign(own.latitude) for own in either.modes}
    assert signs == {-1.0, 1.0}
    assert south.latitude_interval is not None
    assert south.latitude_interval[1] < 0
    assert -south.latitude_interval[1] < LATITUDE < -south.latitude_interval[0]
    with pytest.raises(InputError, match="hemisphere = east"):
        tumble(log, imu, "east")


def test_poses_that_tell_nothing_are_refused_by_what_is_missing():
    imu, rng = sensor("bmi160"), np.random.default_rng(5)
    alike = poses(rng, imu, level(30, 30), 30.0)
    with pytest.raises(InputError, match=r"tell no heading: rank 1 of 3.*would tell more"):
        tumble(alike, imu)
    with pytest.raises(InputError, match=r"rank 1 of 4.*one side"):
        tumble(replace(alike, latitude=None), imu)
    with pytest.raises(InputError, match="must be one or more"):
        tumble(replace(alike, rests=()), imu)
    gone = Poses(
        np.full_like(alike.gyro, np.nan), alike.accel, RATE_HZ, LATITUDE, alike.rests, True
    )
    with pytest.raises(InputError, match="every sample of each rest"):
        tumble(gone, imu)


def test_the_expected_error_is_the_bound_where_errors_are_small():
    imu = sensor("hg4930")
    for integrated in (False, True):
        plan = Tumbling(6, 30.0, 10.0, integrated)
        closed, floor = expected(imu, plan, LATITUDE, draws=6)
        assert abs(floor / closed - 1) < 0.06
        assert plan.seconds == 230
    separate, linked = (expected(imu, Tumbling(6, 30.0, 10.0, own), LATITUDE, draws=6)[0]
                        for own in (False, True))  # fmt: skip
    assert linked < 0.6 * separate
    wide, _ = expected(sensor("bmi160"), Tumbling(3, 30.0, 10.0, False), LATITUDE, draws=2)
    assert np.isnan(wide)


def test_planned_poses_tell_what_recorded_ones_do():
    imu, rng = sensor("stim300"), np.random.default_rng(6)
    truth = uniform(rng, 5)
    for integrated in (False, True):
        of = held(poses(rng, imu, truth, 30.0, integrated), imu)
        plan = planned(truth, 30.0, 10.0, LATITUDE, 9.795, imu, integrated)
        sizes = [np.sqrt(np.diag(small_errors(own, imu, turned_by(truth, own.base))))
                 for own in (of, plan)]  # fmt: skip
        np.testing.assert_allclose(sizes[0], sizes[1], rtol=0.02)


def test_half_a_turn_is_told_from_none():
    rng = np.random.default_rng(8)
    for angle in (0.0, 1e-9, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-9, np.pi):
        axis = rng.standard_normal(3)
        matrix = rotation_matrix(angle * axis / np.linalg.norm(axis))
        np.testing.assert_allclose(rotation_matrix(shortest(matrix)), matrix, atol=1e-7)


def test_slopes_and_curvature_are_those_of_log_p():
    imu, rng = sensor("stim300"), np.random.default_rng(7)
    log = poses(rng, imu, uniform(rng, 4), 30.0, integrated=True, known=False)
    torus = Torus(form(held(log, imu), imu))
    theta = np.append(wrap(rng.uniform(-3, 3, 4)), 0.6)
    torus = Torus(replace(torus.of, delta=wrap(np.diff(theta[:4]) + 0.1)))
    gradient, exact, _ = torus.curved(theta[None])
    step = 1e-5 * np.eye(5)
    slope = (torus.log_p(theta + step) - torus.log_p(theta - step)) / 2e-5
    np.testing.assert_allclose(gradient[0], slope, rtol=1e-4, atol=1e-5 * np.abs(slope).max())
    bend = (torus.curved(theta + step)[0] - torus.curved(theta - step)[0]) / 2e-5
    np.testing.assert_allclose(exact[0], -bend, rtol=1e-4, atol=1e-6 * np.abs(bend).max())


def test_bound_says_what_a_tumble_costs_beside_other_ways(cli, tmp_path):
    done = cli("lbgc.bound", "imu=kvh1775", "tumble=[6,3]", "tumble_dwell_s=60", "windows_s=[60]")
    assert "poses of 60 s in any attitudes, 10 s apart" in done.out
    few, many = json.loads((tmp_path / done.last_line / "bound.json").read_text())["tumble"]
    assert (few["poses"], many["poses"]) == (3, 6)
    np.testing.assert_allclose(many["minutes"], (6 * 60 + 5 * 10) / 60)
    assert many["integrated_deg"] < many["separate_deg"] < few["separate_deg"]
    assert many["separate_deg"] < many["labelled_deg"]
    assert many["two_position_deg"] < few["two_position_deg"]
    refused = cli("lbgc.bound", "imu=kvh1775", "tumble=[0]")
    assert "tumble = 0: must be from 1 to 100" in refused.err
