"""Corrections to a classical estimate, the von Mises head, windows drawn afresh, and resuming."""

import json
import multiprocessing
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers import composed, default_config, generate
from scipy.special import i0e

import lbgc.train
from lbgc import cores
from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled, stack
from lbgc.errors import InputError
from lbgc.estimators import CLASSICAL
from lbgc.estimators.static import mean
from lbgc.frames import wrap
from lbgc.learning import checkpoint, threads, trainer
from lbgc.learning.ahead import Batches, ahead
from lbgc.learning.estimator import Learned
from lbgc.learning.loss import von_mises_nll
from lbgc.learning.model import ModelConfig, make, moments, von_mises_sigma
from lbgc.learning.residual import base_heading, inputs
from lbgc.learning.stream import Streamed
from lbgc.train import TrainConfig

POOL = ModelConfig("pool", "pool", output="vonmises", base="mean")
GYRO = default_config().imu.gyro.triad()


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Dataset:
    """Level, static, its whole bias the unit's."""
    bias = ("imu.gyro.bias_run_deg_per_h=0", "imu.gyro.bias_unit_deg_per_h=1", "protocol=static")
    config = default_config(*bias)
    path = tmp_path_factory.mktemp("residual") / "d.zarr"
    return generate(path, imu=config.imu, protocol=config.protocol, recordings=300,
                    duration_s=60.0, output="means", split=[60, 40, 0])  # fmt: skip


def recordings(dataset: Dataset, split: str = "train") -> Labelled:
    return stack(dataset.records(dataset.in_split(split)), 0.2)


def trained(dataset: Dataset, home, monkeypatch, *options: str):
    home.mkdir(exist_ok=True)
    monkeypatch.chdir(home)
    data = f"data={dataset.path}"
    return lbgc.train.main(composed(TrainConfig, "train", data, "experiment=residual", *options))


def test_the_likelihood_is_von_mises_density():
    """Against SciPy's scaled Bessel function; and it survives errors of an arcsecond."""
    truth, kappa = torch.tensor([10.0, 359.0, -90.0]), torch.tensor([0.1, 30.0, 5e9])
    off = torch.tensor([70.0, 2.0, 0.0])
    for t, k, e in zip(truth, kappa, off, strict=True):
        k64, e64 = float(k), np.deg2rad(float(e))
        expected = np.log(2 * np.pi * i0e(k64)) + k64 * (1 - np.cos(e64))
        got = von_mises_nll(t[None], t[None] - e + 360.0, torch.log(k)[None])
        assert float(got) == pytest.approx(expected, rel=1e-4)


def test_the_references_own_error_is_no_part_of_sigma():
    """Truth within 1 degree of the estimate and a reference within 2 of the truth, 1 sigma: of all
    concentrations the truth's makes the loss least, to the sampling error of 20,000 (1/sqrt(2 n) of
    5, of which 1 is to be told apart: 2.5%, four of them)."""
    rng = torch.Generator().manual_seed(3)
    off = np.sqrt(5.0) * torch.randn(20_000, generator=rng)
    sigma = torch.linspace(0.5, 2.0, 151)
    log_kappa = -2 * torch.log(torch.deg2rad(sigma))
    losses = [float(von_mises_nll(off, torch.zeros(1), k, np.deg2rad(2))) for k in log_kappa]
    assert float(sigma[int(np.argmin(losses))]) == pytest.approx(1.0, abs=0.1)


def test_tempering_is_of_the_windows_length(dataset):
    """What is added, and how much wider it gets, at 4 and at 16 samples is there, half of both in
    the middle (8), and the end's beyond; again on top of it; the heading is as it was."""
    net, windows = make(POOL, 1), recordings(dataset).windows
    x = torch.from_numpy(inputs(POOL, windows, windows.rate_hz, None)[0])
    lengths = (2, 4, 8, 12)
    before = [net(x[:, :n]).detach() for n in lengths]
    net.temper(np.array([4, 16]), np.array([0.2, -0.4]), np.array([0.5, -0.1]))
    net.temper(np.array([4]), np.array([1.0]), np.array([1.0]))
    after = [net(x[:, :n]).detach() for n in lengths]
    share = np.array([0.0, 0.0, 0.5, 0.5 * np.log2(3.0)])
    for one, two, s in zip(before, after, share, strict=True):
        np.testing.assert_array_equal(two[:, :2], one[:, :2])
        once = one[:, 2] * (1.5 - 0.6 * s) + 0.2 - 0.6 * s
        np.testing.assert_allclose(two[:, 2], 2 * once + 1.0, rtol=1e-4)


def test_its_gradient_in_the_concentration_is_right_where_it_is_narrow():
    """d/d(log kappa) at no error is -1/2 + O(1/kappa): what float32 would lose."""
    log_kappa = torch.full((1,), 20.0, requires_grad=True)
    von_mises_nll(torch.zeros(1), torch.zeros(1), log_kappa).backward()
    assert float(log_kappa.grad) == pytest.approx(-0.5, abs=1e-5)


def test_sigma_is_the_densitys_rms_angle():
    found = von_mises_sigma(torch.log(torch.tensor([1e-6, 1e6])).double()).numpy()
    np.testing.assert_allclose(found, [np.pi / np.sqrt(3), 1e-3], rtol=1e-4)
    angle = np.linspace(-np.pi, np.pi, 20_001)
    density = np.exp(2 * np.cos(angle))
    expected = np.sqrt(np.sum(density * angle**2) / np.sum(density))
    assert float(von_mises_sigma(torch.log(torch.tensor([2.0])))) == pytest.approx(
        expected, rel=1e-3
    )


def test_an_untrained_correction_is_none(dataset):
    """Its last layers start at zero: the heading is the base's, whatever the cell."""
    windows = recordings(dataset).windows
    for cell in ("pool", "lstm", "gru", "rnn"):
        net = make(replace(POOL, cell=cell), 1)
        x, base = inputs(net.config, windows, windows.rate_hz, None)
        off = net.heading_deg(net(torch.from_numpy(x))).detach()
        np.testing.assert_array_equal(off.numpy(), 0.0)
        np.testing.assert_allclose(wrap(base - mean(windows).heading), 0.0, atol=1e-12)


def test_a_turned_window_points_north(dataset):
    """The mean rate to the east is zero by the base's making; the body's residual is that of a
    known heading, turned."""
    windows = recordings(dataset).windows
    x, base = inputs(POOL, windows, windows.rate_hz, None)
    assert x.shape == (len(windows), 12, POOL.features)
    east = x[..., 1].mean(axis=1)
    np.testing.assert_allclose(east, 0.0, atol=2e-3)  # the sine of the lean's own turn
    north, right = x[..., 0].mean(axis=1), x[..., 4].mean(axis=1)
    np.testing.assert_allclose(right, -np.sin(base) * north, atol=2e-3)
    np.testing.assert_allclose(x[:, 0, -4], np.sin(base), rtol=1e-6)


def test_moments_are_legendres():
    t = (2 * torch.arange(40) + 1) / 40 - 1
    found = moments((3 * t**2 - 1)[None, :, None] / 2)[0]
    np.testing.assert_allclose(found.numpy(), [0.0, 0.0, 0.2, 0.0], atol=2e-3)


def test_many_at_once_have_the_law_of_one_by_one(rng):
    """Covariance over a recording's blocks of 4,000 draws against the same of `Triad`'s own:
    each variance is known to 2.2%, so five sigma of a ratio is 16%."""
    n, dt, block, count = 6, 1 / 600, 3000, 4000
    clean = GYRO.none_drawn() | {"bias_unit": np.full(3, 1e-6)}
    each = {name: np.repeat(values[None], count, axis=0) for name, values in clean.items()}
    truth = np.zeros((count, 3, 1))
    many = GYRO.measure_means(rng, truth, GYRO.draw_run(rng, each), n, dt, block)
    many = np.moveaxis(many, 1, 2)
    one = np.empty((count, n, 3))
    for row in one:
        drawn = GYRO.draw_run(rng, clean)
        row[:] = GYRO.measure_means(rng, truth[0], drawn, n, dt, block).T
    for axis in range(3):
        spread = [np.cov(v[..., axis].T) for v in (many, one)]
        np.testing.assert_allclose(np.diag(spread[0]), np.diag(spread[1]), rtol=0.16)
        np.testing.assert_allclose(spread[0][0, -1], spread[1][0, -1], rtol=0.16)
    bias = GYRO.bias("run")
    np.testing.assert_allclose(many.mean(axis=(0, 1)), 1e-6, atol=float(6 * bias.max() / 63))


def test_a_streamed_bench_is_the_stored_one(tmp_path):
    """A noiseless sensor on a carousel: what is drawn at a recording's own heading is what was
    stored, where the plate turns steadily; lever arm and tilt included."""
    config = default_config("imu=ideal", "protocol=carousel", "scene.base_roll_deg=1")
    made = generate(tmp_path / "d.zarr", imu=config.imu, protocol=config.protocol,
                    scene=config.scene, recordings=2, duration_s=20.0, output="means", mean_s=1.0,
                    split=[1, 0, 0])  # fmt: skip
    stored = stack(made.records(np.arange(2)), 1.0)
    source = Streamed.of(made, np.arange(2), stored)
    inside = slice(2, -2)
    rate, force, _ = source._truth(np.arange(2), stored.heading, inside)
    for felt, printed, atol in (
        (rate, stored.windows.gyro, 3e-7),
        (force, stored.windows.accel, 1e-4),
    ):
        np.testing.assert_allclose(np.swapaxes(felt, 1, 2), printed[:, inside], atol=atol)


def test_a_moving_bench_cannot_be_streamed(tmp_path):
    config = default_config("scene=moored")
    made = generate(tmp_path / "d.zarr", scene=config.scene, recordings=2, duration_s=20.0,
                    output="means", split=[1, 0, 0])  # fmt: skip
    with pytest.raises(InputError, match="draws a bench that stands still"):
        Streamed.of(made, np.arange(2), stack(made.records(np.arange(2)), 0.2))


def test_a_correction_learns_what_repeats_and_says_how_sure_it_is(dataset, tmp_path, monkeypatch):
    """120 held-out recordings, 60 s, each window a third of the mean's error at most, and errors
    over sigma of 1: chi-square of 120 has a deviation of 13%, five of them 65%."""
    options = ("steps=150", "validate_every=50", "windows_s=[20,60]")
    learned = Learned.load(trained(dataset, tmp_path / "a", monkeypatch, *options))
    held = recordings(dataset, "validation")
    found = learned(held.windows)
    error = wrap(found.heading - held.heading)
    plain = wrap(mean(held.windows).heading - held.heading)
    assert np.mean(error**2) < 0.25 * np.mean(plain**2)
    assert 0.35 < np.mean((error / found.sigma) ** 2) < 1.65


def test_more_windows_set_the_sigma_right_otherwise(dataset, tmp_path, monkeypatch):
    """And the headings not at all."""
    options = ("steps=2", "validate_every=2", "batch=8", "windows_s=[60]")
    windows, found = recordings(dataset, "validation").windows, []
    for count in (100, 200):
        own = (*options, f"tempering={count}")
        learned = Learned.load(trained(dataset, tmp_path / str(count), monkeypatch, *own))
        found.append(learned(windows))
    np.testing.assert_array_equal(found[0].heading, found[1].heading)
    assert not np.any(found[0].sigma == found[1].sigma)


def test_a_killed_training_ends_with_the_same_weights(dataset, tmp_path, monkeypatch):
    """Killed at step 17, checkpointed at 10: the same bytes and the same history; and the seconds
    of both parts are added up."""
    options = ("steps=24", "validate_every=4", "checkpoint_every=10", "batch=32")
    whole = trained(dataset, tmp_path / "whole", monkeypatch, *options).resolve()
    step = trainer.Trainer._train

    def killed(self):
        if self.step == 17:
            raise KeyboardInterrupt
        return step(self)

    monkeypatch.setattr(trainer.Trainer, "_train", killed)
    with pytest.raises(KeyboardInterrupt):
        trained(dataset, tmp_path / "cut", monkeypatch, *options)
    (left,) = (tmp_path / "cut/outputs/train").glob("*")
    assert (left / "checkpoint.safetensors").exists()
    monkeypatch.setattr(trainer.Trainer, "_train", step)
    tensors, said = checkpoint.read(left / "checkpoint.safetensors")
    assert said["seconds"] > 0
    checkpoint.write(left / "checkpoint.safetensors", tensors, said | {"seconds": 1000.0})
    run = trained(dataset, tmp_path / "cut", monkeypatch, *options).resolve()
    for name in ("model.safetensors", "history.csv"):
        assert (run / name).read_bytes() == (whole / name).read_bytes()
    assert not (run / "checkpoint.safetensors").exists()
    assert json.loads((run / "model.json").read_text())["seconds"] > 1000


def test_training_ends_where_nothing_gets_better(dataset, tmp_path, monkeypatch):
    options = ("steps=200", "validate_every=1", "patience=3", "learning_rate=1e-12", "batch=8")
    run = trained(dataset, tmp_path / "early", monkeypatch, *options)
    assert len((run / "history.csv").read_text().splitlines()) < 100


class Numbers:
    """Examples that show which numbers they were drawn with."""

    fresh = None

    def draw(self, rng, count, steps):
        return rng.standard_normal((count, steps, 2)).astype(np.float32), rng.uniform(size=count)


def test_small_networks_take_one_thread_and_large_ones_more(monkeypatch):
    """The published networks' matrices are too small for two: they would wait for each other."""
    monkeypatch.setattr("lbgc.cores.count", lambda: 8)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 8)
    for config in (ModelConfig(hidden=8), ModelConfig(hidden=24), ModelConfig(cell="pool")):
        assert threads.wanted(config, batch=100) == 1
    assert threads.wanted(ModelConfig(hidden=1024), batch=100) == 8
    assert 1 < threads.wanted(ModelConfig(hidden=128), batch=100) < 8


def test_cores_are_those_that_this_process_may_use(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {3}, raising=False)
    assert cores.count() == 1
    monkeypatch.delattr("os.sched_getaffinity")
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    assert cores.count() == 8


def test_the_option_overrides_how_many_threads(monkeypatch):
    told = []
    monkeypatch.setattr(torch, "set_num_threads", told.append)
    before = torch.get_num_threads()
    with threads.limited(3):
        pass
    assert told == [3, before]
    config = TrainConfig(data="x", threads=3)
    assert config.plan(240.0, 0.0).threads == 3
    assert config.content() == TrainConfig(data="x").content()


@pytest.mark.parametrize(
    ("long_steps", "processes", "daemon"),
    [(True, 2, False), (False, 2, False), (False, 0, True)],
    ids=["by a thread", "by processes", "in a daemon"],
)
@pytest.mark.parametrize("echo", [1, 3])
def test_whoever_draws_ahead_draws_the_same(monkeypatch, long_steps, processes, daemon, echo):
    monkeypatch.setattr("lbgc.cores.count", lambda: 3)
    process = multiprocessing.current_process()
    monkeypatch.setattr(type(process), "daemon", daemon)
    batches = Batches(Numbers(), seed=1, batch=3, windows_steps={10.0: 2, 20.0: 4}, echo=echo)
    count, seeds = torch.get_num_threads(), torch.random.get_rng_state()
    with ahead(batches, range(5, 12), long_steps) as drawn:
        first = [next(drawn) for _ in range(3)]
        assert len(multiprocessing.active_children()) == (0 if long_steps else processes)
        rest = list(drawn)
    del drawn
    for step, (x, off) in enumerate([*first, *rest], start=5):
        for found, own in zip((x, off), batches[step], strict=True):
            np.testing.assert_array_equal(found, own)
    assert len(first + rest) == 7
    # Steps 5 and 6 are left of the batch that is for 4, 5 and 6.
    own = [float(off[0]) for _, off in [*first, *rest]]
    assert [own.index(value) for value in own] == {1: [*range(7)], 3: [0, 0, 2, 2, 2, 5, 5]}[echo]
    assert multiprocessing.active_children() == []
    assert torch.get_num_threads() == count
    assert torch.equal(torch.random.get_rng_state(), seeds)


@pytest.mark.parametrize("name", ["gls", "two_position_weighted", "cosine_fit_weighted"])
def test_a_base_answers_windows_that_its_sensors_model_does_not_explain(dataset, name):
    """Those that domain randomisation shakes, such as; the estimator itself refuses them."""
    angles = {"gls": [0.0], "two_position_weighted": [0.0, np.pi]}
    steps = angles.get(name, [0.0, np.pi / 2, np.pi])
    windows = recordings(dataset).windows.rows(np.arange(3))
    imu = default_config().imu.model(100.0)
    n = windows.gyro.shape[1]
    plate = np.tile(np.repeat(steps, -(-n // len(steps)))[:n], (3, 1))
    shaking = 0.1 * np.sin(np.arange(n))[:, None]
    shaken = replace(windows, plate_angle=plate, accel=windows.accel + shaking)
    with pytest.raises(InputError, match="the base moves"):
        CLASSICAL[name](shaken, imu)
    assert np.isfinite(base_heading(name, shaken, imu)).all()
