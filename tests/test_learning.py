"""The network, its loss, Algorithm 2's augmentation, and what a trained run can and cannot do."""

import json
import math
from dataclasses import MISSING, fields, replace

import numpy as np
import pytest
import torch
from helpers import composed, default_config, generate, labelled

import lbgc.train
from lbgc.data.record import mock_record
from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled, cut, stack
from lbgc.earth import earth_rate_ned
from lbgc.errors import InputError
from lbgc.estimators.static import mean
from lbgc.frames import euler_to_matrix, level, rotation_z, wrap
from lbgc.learning.augment import AugmentConfig, augment, earth_in_body
from lbgc.learning.batches import Stored
from lbgc.learning.description import FORMAT, Description
from lbgc.learning.estimator import Learned, load_net
from lbgc.learning.labelled import chosen
from lbgc.learning.loss import cyclic_error_deg, cyclic_mse, vector_mse
from lbgc.learning.model import ModelConfig, features, make, parameter_count
from lbgc.metrics import heading_errors
from lbgc.outputs import fingerprint
from lbgc.train import TrainConfig

PUBLISHED = ModelConfig("published", output="degrees", channels=["gyro"])
TURN_ONLY = AugmentConfig(noise=0.0, run_bias=0.0)
NO_SENSOR = default_config("imu=ideal").imu.gyro.triad()
SDC500 = default_config().imu.gyro.triad()


@pytest.mark.parametrize(
    ("layers", "hidden", "count"), [(1, 8, 850), (2, 16, 9122), (2, 24, 19826)]
)
def test_the_papers_architecture_has_so_many_parameters(layers, hidden, count):
    """Not the published 9,265, 42,065 and 98,965; reports say that they differ."""
    assert parameter_count(make(replace(PUBLISHED, layers=layers, hidden=hidden), 0)) == count


def test_time_is_the_sequence_and_each_direction_has_its_own_layer():
    """The summed output is linear in the two directions' final states: the forward one has read
    the last sample last, the backward one the first."""
    net = make(PUBLISHED, 0)
    x = torch.randn(3, 12, 3, generator=torch.Generator().manual_seed(1))
    y, _ = net.recurrent(x)
    hidden = net.config.hidden
    expected = net.forward_head(y[:, -1, :hidden]) + net.backward_head(y[:, 0, hidden:])
    torch.testing.assert_close(net(x), expected)
    assert net(torch.randn(2, 48, 3)).shape == (2, 1)


def test_initialisation_is_the_seeds_and_leaves_the_global_state_alone():
    before = torch.random.get_rng_state()
    a, b, c = (make(PUBLISHED, s).state_dict() for s in (1, 1, 2))
    assert torch.equal(before, torch.random.get_rng_state())
    assert all(torch.equal(a[k], b[k]) for k in a)
    assert not all(torch.equal(a[k], c[k]) for k in a)


def test_cyclic_mse_is_algorithm_1():
    truth = torch.tensor([0.0, 359.0, 10.0, 90.0])
    estimate = torch.tensor([1.0, 1.0, 725.0, -90.0])
    errors = cyclic_error_deg(truth, estimate)
    torch.testing.assert_close(errors.abs(), torch.tensor([1.0, 2.0, 5.0, 180.0]))
    assert float(cyclic_mse(truth[:3], estimate[:3])) == pytest.approx(10.0, rel=1e-5)


def test_vector_mse_is_the_squared_error_where_it_is_small():
    truth, off = torch.tensor([30.0, 200.0]), math.radians(0.5)
    estimate = torch.deg2rad(truth + 0.5)
    sincos = torch.stack([torch.sin(estimate), torch.cos(estimate)], dim=-1)
    assert float(vector_mse(truth, sincos)) == pytest.approx(off**2, rel=1e-3)


def tilted(heading: float, bias: np.ndarray) -> Labelled:
    """A window of a tilted resting IMU with a body-frame bias."""
    record = mock_record()
    c_nb = euler_to_matrix(0.05, -0.08, heading)
    gyro = earth_rate_ned(record.latitude) @ c_nb + bias
    accel = np.linalg.norm(record.accel[0]) * np.array([0.0, 0.0, -1.0]) @ c_nb
    both = {"heading": heading, "heading_reference": heading}
    return labelled(
        replace(record, gyro=np.tile(gyro, (250, 1)), accel=np.tile(accel, (250, 1)), **both), 25.0
    )


def test_augmentation_gives_the_recording_that_would_have_been_made_there():
    """Turned by d, tilt and body-frame bias included: the numbers of a recording at psi + d."""
    bias = np.array([3e-6, -2e-6, 1e-6])
    made = augment(TURN_ONLY, tilted(0.7, bias), NO_SENSOR, np.random.default_rng(3))
    there = tilted(float(made.heading[0]), bias)
    assert abs(made.heading[0] - 0.7) > 0.1
    np.testing.assert_allclose(made.windows.gyro, there.windows.gyro, atol=1e-17)
    np.testing.assert_array_equal(made.windows.accel, there.windows.accel)


@pytest.mark.parametrize("protocol", ["two_position", "carousel"])
def test_a_turning_plates_recording_is_turned_as_a_whole(tmp_path, protocol):
    """A noiseless sensor on a level plate: what is felt at rest or in steady turning, at every
    heading, is what was stored at that heading."""
    config = default_config("imu=ideal", f"protocol={protocol}")
    made = generate(tmp_path / "d.zarr", imu=config.imu, protocol=config.protocol, recordings=2,
                    duration_s=40.0, output="means", mean_s=1.0, split=[1, 0, 0])  # fmt: skip
    recordings = stack(made.records(np.arange(2)), 1.0)
    windows, heading = recordings.windows, recordings.heading
    one, two = (earth_in_body(windows.rows(slice(i, i + 1)), heading[i : i + 1])
                for i in (0, 1))  # fmt: skip
    difference = windows.gyro[1] - windows.gyro[0]
    travel = np.abs(np.diff(windows.plate_angle[0], prepend=0.0))
    steady = np.abs(np.diff(travel, prepend=travel[:1], append=travel[-1:]))
    good = (steady[:-1] < 1e-3) & (steady[1:] < 1e-3)
    assert good.sum() > 20
    np.testing.assert_allclose((two - one)[0][good][:, :2], difference[good][:, :2], atol=1e-7)


def test_the_papers_literal_form_turns_the_bias_too():
    bias = np.array([3e-6, -2e-6, 1e-6])
    config = replace(TURN_ONLY, form="literal")
    made = augment(config, tilted(0.7, bias), NO_SENSOR, np.random.default_rng(3))
    d = made.heading[0] - 0.7
    original = rotation_z(d).T @ tilted(0.7, bias).windows.gyro[0, 0]
    np.testing.assert_allclose(made.windows.gyro[0, 0], original, atol=1e-17)
    level = mock_record()
    turned = augment(config, labelled(level, 25.0), NO_SENSOR, np.random.default_rng(3))
    np.testing.assert_allclose(mean(turned.windows).heading, wrap(turned.heading), atol=1e-9)


def test_every_copy_draws_its_own_noise_and_bias(rng):
    """Two copies of one recording differ, by as much as the sensor's own noise and run bias say:
    1,000 copies x 3 axes, 4.5 x 1/sqrt(6000) = 6%."""
    stored = stack([mock_record()] * 1000, 0.2)
    noisy = AugmentConfig(rotate=False, noise=1.0, run_bias=1.0)
    made = augment(noisy, stored, SDC500, rng).windows.gyro - stored.windows.gyro
    means = made.mean(axis=1)
    assert len(np.unique(means[:, 0])) == 1000
    rows = SDC500.sample_noise(rng, 1000, 5, 5.0).mean(axis=1)
    expected = np.sqrt(rows.var(axis=0) + np.square(SDC500.bias("run")))
    np.testing.assert_allclose(means.std(axis=0), expected, rtol=0.1)


def scattered(count: int, rng: np.random.Generator) -> Labelled:
    """Recordings of one heading, with white noise of their own."""
    stored = stack([mock_record()] * count, 0.2)
    gyro = stored.windows.gyro
    gyro = gyro + 1e-6 * rng.standard_normal(gyro.shape)
    return replace(stored, windows=replace(stored.windows, gyro=gyro))


@pytest.mark.parametrize(
    "changed",
    [{"rotate": False}, {"form": "literal"}, {"mix": False}, {"noise": 0.5}, {"run_bias": 0.5}],
    ids=lambda c: next(iter(c)),
)
def test_every_augmentation_field_changes_the_copies(changed, rng):
    stored = scattered(3, rng)
    one, two = (
        Stored(stored, np.zeros(3, int), c, SDC500).draw(np.random.default_rng(1), 3, 5).windows
        for c in (AugmentConfig(), replace(AugmentConfig(), **changed))
    )
    assert not np.array_equal(one.gyro, two.gyro)
    assert set(changed) < {f.name for f in fields(AugmentConfig)}


def test_mixed_recordings_have_the_law_of_the_stored_ones(rng):
    """Bias of the unit, run bias and in-run noise of 600 recordings, tilts of a degree, any
    heading: 4,000 mixtures have their means (six standard errors of either) and covariance over
    time (a variance from 600 is known to 6%: 4.5 of these, 26%)."""
    count, steps, unit = 600, 6, np.array([8e-6, -5e-6, 3e-6])
    psi, tilt = rng.uniform(-np.pi, np.pi, count), np.deg2rad(rng.standard_normal((2, count)))
    noise = SDC500.sample_noise(rng, count, steps, 5.0) + 5e-6 * rng.standard_normal((count, 1, 3))
    base = euler_to_matrix(*tilt, psi)
    earth = np.einsum("wij,i->wj", base, earth_rate_ned(0.6))
    like = stack([mock_record(latitude=0.6)] * count, 0.2)
    windows = replace(
        like.windows,
        gyro=np.repeat((earth + unit)[:, None], steps, axis=1) + noise,
        accel=np.repeat(-9.8 * base[:, None, 2], steps, axis=1),
        plate_angle=np.zeros((count, steps)),
    )
    stored = Labelled(windows=windows, heading=psi, heading_reference=psi)
    only = AugmentConfig(rotate=False)
    made = Stored(stored, np.zeros(count, int), only, SDC500).draw(rng, 4000, steps)
    roll, pitch = level(made.windows.accel.mean(axis=1))
    base = euler_to_matrix(roll, pitch, made.heading)
    left = made.windows.gyro - np.einsum("wij,i->wj", base, earth_rate_ned(0.6))[:, None]
    error = 6 * 5.2e-6 / np.sqrt(count)
    np.testing.assert_allclose(left.mean(axis=(0, 1)), unit + noise.mean(axis=(0, 1)), atol=error)
    for axis in range(3):
        spread = [np.cov(v[..., axis].T) for v in (left, noise)]
        np.testing.assert_allclose(spread[0], spread[1], rtol=0.26)
    np.testing.assert_allclose(np.std([roll, pitch], axis=1), np.std(tilt, axis=1), rtol=0.2)


def test_what_has_no_two_others_of_its_unit_is_not_mixed(rng):
    recordings = scattered(5, rng)
    source = Stored(recordings, np.array([7, 3, 3, 3, 7]), AugmentConfig(rotate=False), SDC500)
    made, own = source.draw(rng, 200, 5).windows.gyro, recordings.windows.gyro
    stored = [any(np.array_equal(g, w) for w in own) for g in made]
    alone = [any(np.array_equal(g, own[i]) for i in (0, 4)) for g in made]
    assert 40 < sum(alone) < 120
    assert stored == alone


def test_augmentation_leaves_the_originals_alone():
    stored = stack([mock_record()], 0.2)
    before = stored.windows.gyro.copy()
    augment(AugmentConfig(noise=1.0), stored, SDC500, np.random.default_rng(1))
    np.testing.assert_array_equal(stored.windows.gyro, before)


def test_a_prediction_is_a_function_of_its_own_window_alone(unit_bias_run):
    """The batch around it permuted, shortened and extended: float32 arithmetic may regroup, so to
    1e-4 degrees, where windows differ by tens of degrees."""
    dataset, run = unit_bias_run
    learned = Learned.load(run)
    windows = stack(list(dataset.records(dataset.in_split("test")[:40])), 0.2).windows
    together = np.rad2deg(learned(windows).heading)
    order = np.random.default_rng(0).permutation(40)

    rows = windows.rows
    np.testing.assert_allclose(np.rad2deg(learned(rows(order)).heading), together[order], atol=1e-4)
    np.testing.assert_allclose(np.rad2deg(learned(rows(slice(3))).heading), together[:3], atol=1e-4)
    alone = [float(np.rad2deg(learned(rows(slice(i, i + 1))).heading)[0]) for i in range(40)]
    np.testing.assert_allclose(alone, together, atol=1e-4)


def rmse_deg(estimate, dataset: Dataset, window_s: float) -> float:
    errors = [
        heading_errors(estimate(w.windows).heading, w.heading)
        for w in (labelled(r, window_s) for r in dataset.records(dataset.in_split("test")))
    ]
    return float(np.rad2deg(np.sqrt(np.mean(np.square(np.concatenate(errors))))))


def test_a_repeatable_bias_is_learned(unit_bias_run):
    """One unit whose whole bias is its own, held-out recordings, 60 s windows: the learned RMSE is
    at most half of the baseline's."""
    dataset, run = unit_bias_run
    assert rmse_deg(Learned.load(run), dataset, 60.0) <= 0.5 * rmse_deg(mean, dataset, 60.0)


def test_without_gyro_and_accelerometer_the_plate_tells_nothing(unit_bias_run):
    """Zeros for both (which the estimator itself refuses): RMSE at chance, 104 degrees for errors
    uniform on the circle; the network's one answer against n headings round the circle."""
    dataset, run = unit_bias_run
    recordings = stack(list(dataset.records(dataset.in_split("test"))), 0.2)
    windows = recordings.windows
    blind = replace(windows, gyro=0 * windows.gyro, accel=0 * windows.accel)
    with pytest.raises(InputError, match="gyro's x axis = 0: at every sample of window 0"):
        Learned.load(run)(blind)
    net = load_net(run)[0]
    with torch.inference_mode():
        answer = net.heading_deg(net(torch.from_numpy(features(net.config, blind))))
    errors = heading_errors(np.deg2rad(answer.double().numpy()), recordings.heading)
    assert np.rad2deg(np.sqrt(np.mean(errors**2))) == pytest.approx(180 / np.sqrt(3), rel=0.1)


def test_training_on_the_plate_alone_stays_at_chance(tmp_path, monkeypatch, unit_bias_run):
    monkeypatch.chdir(tmp_path)
    options = ("model.channels=[plate]", "steps=100", "validate_every=100", "augment.rotate=false")
    config = composed(TrainConfig, "train", f"data={unit_bias_run[0].path}", *options)
    run = lbgc.train.main(config)
    assert json.loads((run / "model.json").read_text())["best_validation_deg"] > 90


@pytest.mark.parametrize(
    ("record", "says"),
    [
        (mock_record(rate_hz=0.3), "must be a whole multiple of 0.2 Hz"),
        (mock_record(rate_hz=0.1), "must be a whole multiple of 0.2 Hz"),
        (mock_record(gyro=np.full((250, 3), np.nan)), "not finite"),
    ],
)
def test_what_a_model_cannot_use_is_refused(unit_bias_run, record, says):
    learned = Learned.load(unit_bias_run[1])
    with pytest.raises(InputError, match=says):
        learned(cut(record, 20.0))


def test_windows_shorter_than_trained_for_are_refused(unit_bias_run):
    with pytest.raises(InputError, match="shorter than the 10 s"):
        Learned.load(unit_bias_run[1])(cut(mock_record(), 5.0))


def test_a_damaged_or_foreign_run_is_refused(tmp_path, unit_bias_run):
    with pytest.raises(InputError, match="is no finished training run"):
        Learned.load(tmp_path)
    for name in ("model.json", "model.safetensors"):
        (tmp_path / name).write_bytes((unit_bias_run[1] / name).read_bytes()[:-200])
        other = "model.safetensors" if name == "model.json" else "model.json"
        (tmp_path / other).write_bytes((unit_bias_run[1] / other).read_bytes())
        with pytest.raises(InputError, match="holds a damaged model"):
            Learned.load(tmp_path)
    said = json.loads((unit_bias_run[1] / "model.json").read_text())
    (tmp_path / "model.json").write_text(json.dumps(said | {"model": {"hidden": 8}}))
    with pytest.raises(InputError, match="holds a damaged model"):
        Learned.load(tmp_path)


def test_a_run_of_another_format_is_refused_by_number(tmp_path, unit_bias_run):
    for name in ("model.json", "model.safetensors"):
        (tmp_path / name).write_bytes((unit_bias_run[1] / name).read_bytes())
    said = (tmp_path / "model.json").read_text().replace(f'"format": {FORMAT}', '"format": 2')
    (tmp_path / "model.json").write_text(said)
    with pytest.raises(
        InputError, match=f"is of format 2, this version reads {FORMAT}; train it again"
    ):
        Learned.load(tmp_path)


def test_a_format_has_one_content():
    """Another content is another format: give it the next number, and say so in the CHANGELOG. A
    key that a description may lack is none: nothing that reads a run needs it."""
    kinds = (
        ModelConfig(),
        ModelConfig(cell="pool", base="gls", output="vonmises"),
        ModelConfig(cell="filter", channels=["sway"], output="vonmises"),
    )
    always = [f.name for f in fields(Description) if f.default is MISSING]
    content = [sorted(always), sorted(f.name for f in fields(ModelConfig))]
    shapes = [{n: list(v.shape) for n, v in make(k, 1).state_dict().items()} for k in kinds]
    assert (FORMAT, fingerprint({"keys": content, "weights": shapes})) == (5, "a15318110ebea4dc")


def test_a_damaged_run_is_trained_again(tmp_path, monkeypatch, unit_bias_run):
    """The same command mends it; a whole one is left as it is."""
    monkeypatch.chdir(tmp_path)
    options = (f"data={unit_bias_run[0].path}", "steps=2", "validate_every=1", "windows_s=[10]")
    config = composed(TrainConfig, "train", *options, "batch=4", "model=bilstm_8")
    weights = lbgc.train.main(config) / "model.safetensors"
    good = weights.read_bytes()
    weights.write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
    assert lbgc.train.main(config) / "model.safetensors" == weights
    assert weights.read_bytes() == good


def test_a_run_leaves_what_it_promises(unit_bias_run):
    run = unit_bias_run[1]
    names = {"history.csv", "loss.png", "model.json", "model.safetensors"}
    assert {p.name for p in run.iterdir()} == names
    said = json.loads((run / "model.json").read_text())
    assert said["parameters"] == 20836
    header, *rows = (run / "history.csv").read_text().splitlines()
    assert "validation_60s_deg" in header.split(",")
    assert len(rows) == 6


def test_one_seed_one_set_of_weights(tmp_path, monkeypatch, unit_bias_run):
    """And another seed, or any other field, another."""
    path = unit_bias_run[0].path

    def weights(home: str, *options: str) -> bytes:
        (tmp_path / home).mkdir()
        monkeypatch.chdir(tmp_path / home)
        run = lbgc.train.main(
            composed(TrainConfig, "train", f"data={path}", "steps=4", "validate_every=2", *options)
        )
        return (run / "model.safetensors").read_bytes()

    usual = weights("usual")
    assert weights("again") == usual
    changes = {
        "data": None,  # another dataset: below
        "mean_s": "mean_s=10",
        "windows_s": "windows_s=[60]",
        "steps": "steps=6",
        "batch": "batch=50",
        "echo": "echo=2",
        "learning_rate": "learning_rate=0.002",
        "clip": "clip=0.01",
        "validate_every": "validate_every=1",
        "labelled": "labelled=3",
        "stream": "stream=true",
        "calibration": None,  # one unit's: tests/test_my_unit.py
        "schedule": "schedule=cosine",
        "warm_up": None,  # of models that state a sigma: tests/test_swaying.py
        "tempering": None,  # likewise: tests/test_residual.py
        "patience": None,  # when training ends: see its own test
        "threads": None,  # how fast, and not what; see test_residual
        "tensorboard": None,  # who is told, not what is learned
        "checkpoint_every": None,  # what may be lost, not what is learned
        "seed": "seed=2",
        "model": "model.hidden=8",
        "augment": "augment.rotate=false",
        "randomise": "randomise.noise=1",
    }
    assert set(changes) == {f.name for f in fields(TrainConfig)}
    for field, option in changes.items():
        if field == "validate_every":  # which weights are kept may or may not change
            continue
        if option is not None:
            assert weights(field, option) != usual, field
    path = generate(tmp_path / "other.zarr", recordings=20, output="means", seed=5).path
    assert weights("data") != usual


@pytest.mark.parametrize(
    "changed",
    [
        {"cell": "gru"},
        {"layers": 1},
        {"hidden": 8},
        {"output": "degrees"},
        {"channels": ["gyro"]},
        {"base": "mean"},
    ],
    ids=lambda c: next(iter(c)),
)
def test_every_model_field_changes_the_network(changed):
    """`name` is what tables call it; see the report's test."""
    usual, other = make(ModelConfig(), 0), make(replace(ModelConfig(), **changed), 0)
    shapes = [{k: v.shape for k, v in net.state_dict().items()} for net in (usual, other)]
    assert shapes[0] != shapes[1]


def test_features_are_normalised_by_physics():
    x = features(ModelConfig(), cut(mock_record(), 25.0))
    assert x.shape == (1, 250, 8)
    assert np.linalg.norm(x[0, 0, :3]) == pytest.approx(1.0)
    assert x[0, 0, 5] == pytest.approx(-1.0, abs=2e-3)
    np.testing.assert_array_equal(x[0, 0, 6:], [1.0, 0.0])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "data = None: must be a dataset's path"),
        (("data=nonesuch",), "data = nonesuch: is no dataset"),
        (("data=x", "windows_s=[5]"), "windows_s = 5.0 s: must be 10 s or more"),
        (("data=x", "windows_s=[12]"), "in whole means of 5 s"),
        (("data=x", "windows_s=[]"), "must name a length"),
        (("data=x", "steps=0"), "steps = 0: must be greater than zero"),
        (("data=x", "model=transformer"), "bilstm_16"),
        (("data=x", "model.name=floor"), "model.name = floor: is an estimator's"),
        (("data=x", "model.output=radians"), "choose from sincos, degrees, vonmises"),
        (("data=x", "model.channels=[magnetometer]"), "choose from gyro, accel, plate"),
        (("data=x", "augment.form=wrong"), "choose from earth, literal"),
        (("data=x", "labelled=0"), "labelled = 0: must be greater than zero"),
        (("data=x", "labelled=3", "stream=true"), "by what the dataset knows of its unit"),
        (("data=[x,y]", "labelled=3"), "give one dataset of one unit"),
        (("data=x", "learning_rate=nan"), "learning_rate = nan: must be a finite number"),
    ],
)
def test_bad_training_input_is_named(cli, tmp_path, options, says):
    done = cli("lbgc.train", *options)
    assert done.code == 2
    assert says in done.err
    assert list(tmp_path.iterdir()) == []


def test_a_diverged_training_says_so(cli, tmp_path):
    size = {"recordings": 20, "output": "means", "duration_s": 20.0, "split": [50, 30, 20]}
    generate(tmp_path / "d.zarr", **size)
    done = cli("lbgc.train", "data=d.zarr", "learning_rate=1e30", "steps=9", "windows_s=[20]")
    assert done.code == 2
    assert "learning_rate = 1e+30: training diverged at step" in done.err
    assert not list(tmp_path.glob("outputs/train/*/model.json"))


def test_unsuitable_datasets_are_refused(cli, tmp_path):
    size = {"recordings": 20, "output": "means", "duration_s": 20.0, "mean_s": 2.0}
    generate(tmp_path / "two.zarr", **size)
    done = cli("lbgc.train", "data=two.zarr")
    assert done.code == 2
    assert "must be a whole multiple of the 0.2 Hz" in done.err
    generate(tmp_path / "none.zarr", **(size | {"mean_s": 5.0}), split=[0, 0, 1])
    assert "has no recordings in its train split" in cli("lbgc.train", "data=none.zarr").err
    generate(tmp_path / "pole.zarr", **(size | {"mean_s": 5.0}), latitude=-90.0)
    assert "was generated at a pole" in cli("lbgc.train", "data=pole.zarr").err
    generate(tmp_path / "short.zarr", **(size | {"mean_s": 5.0}))
    done = cli("lbgc.train", "data=short.zarr", "windows_s=[60]")
    assert "none fits recordings of 20 s" in done.err


@pytest.mark.parametrize(
    ("labelled", "training", "validating"),
    [(1, [0], [0]), (4, [0, 1, 2, 3], [0, 1, 2, 3]), (5, [0, 1, 2, 3], [4]), (12, range(10), 0)],
)
def test_labelled_recordings_are_all_that_is_read(tmp_path, labelled, training, validating):
    """Neither further recordings of the training split nor the validation split: with all others
    spoiled, training is the same."""
    data = generate(tmp_path / "d.zarr", recordings=20, output="means", split=[70, 20, 10])
    every = data.in_split("train")
    own, held = (chosen(data, split, labelled) for split in ("train", "validation"))
    expected = [10, 11] if validating == 0 else validating
    assert own.tolist() == every[list(training)].tolist()
    assert held.tolist() == every[list(expected)].tolist()
    config = composed(TrainConfig, "train", f"data={data.path}", f"labelled={labelled}", "steps=1")
    trainer = lbgc.train.trainer_of(config, [data])
    assert len(trainer.source.source.recordings) == len(own)
    windows = trainer.validation[-1][1]
    assert len(windows) == len(held), "one window of 240 s each"


def test_labelled_recordings_are_of_one_unit_and_there(cli, tmp_path):
    generate(tmp_path / "d.zarr", recordings=20, output="means", split=[50, 30, 20])
    done = cli("lbgc.train", "data=d.zarr", "labelled=11")
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert "labelled = 11: is more than the 10 recordings in the training split" in done.err
    generate(tmp_path / "two.zarr", recordings=20, output="means", units=2)
    done = cli("lbgc.train", "data=two.zarr", "labelled=2")
    assert done.code == 2
    assert "labelled = 2: recordings would be of the 2 units" in done.err
    assert "generate units=1" in done.err


def test_a_run_says_from_how_many_it_learned(cli, tmp_path):
    generate(tmp_path / "d.zarr", recordings=20, output="means", split=[50, 30, 20])
    done = cli("lbgc.train", "data=d.zarr", "labelled=6", "steps=2", "validate_every=1")
    assert done.code == 0, done.err
    said = tmp_path / "outputs/train/latest/model.json"
    assert json.loads(said.read_text())["training"]["labelled"] == 6
