"""What a network is shown of a base that sways, and what it makes of it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers import composed, default_config, labelled
from numpy.polynomial.legendre import legval
from simulated import swaying

import lbgc.train
import sim.generate
from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled, Windows
from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.frames import euler_to_matrix, rotation_vector, rotation_z, turned, wrap
from lbgc.learning.estimator import Learned, load_net
from lbgc.learning.filter import legendre
from lbgc.learning.model import ModelConfig, make
from lbgc.learning.residual import inputs
from lbgc.learning.sway import Swaying
from lbgc.train import TrainConfig

CONFIG = ModelConfig("sway", "filter", 2, 8, "vonmises", ["sway"])


def still(count: int, n: int) -> np.ndarray:
    return np.zeros((count, n + 1, 3))


def bend(values: np.ndarray) -> np.ndarray:
    """Second Legendre moment over time, (W, 2)."""
    n = values.shape[1]
    p2 = legval((2 * np.arange(n) + 1) / n - 1, [0, 0, 1])
    return np.einsum("t,wti->wi", p2, values) / n


def rocking(arm: float, rate_hz: float, duration_s: float, heading: float) -> Windows:
    """A body that rolls to and fro at 0.7 Hz about an axis `arm` m below it."""
    n = round(duration_s * rate_hz)
    t = np.arange(-1, n + 1) / rate_hz
    roll = 0.01 * np.sin(2 * np.pi * 0.7 * t + 0.3)
    to_n = euler_to_matrix(roll, 0.0, heading)  # (n + 2, 3, 3)
    place = to_n @ [0.0, 0.0, -arm]
    velocity = np.gradient(place, 1 / rate_hz, axis=0)
    latitude = 0.6
    earth, down = earth_rate_ned(latitude), np.array([0.0, 0.0, normal_gravity(latitude)])
    before, after = to_n[:-1], to_n[1:]
    middle = (before + after) / 2
    turn = rotation_vector(np.swapaxes(before, -1, -2) @ after) * rate_hz
    gyro = turn + np.einsum("tij,i->tj", middle, earth)
    accel = np.einsum("tij,ti->tj", middle, np.diff(velocity, axis=0) * rate_hz - down)
    return Windows(gyro=gyro[None, 1:], accel=accel[None, 1:], plate_angle=np.zeros((1, n)),
                   rate_hz=rate_hz, latitude=np.array([latitude]),
                   start_s=np.zeros(1))  # fmt: skip


@pytest.mark.parametrize("latitude", [-50.0, 0.0, 65.0])
@pytest.mark.parametrize("duration", [10.0, 60.0])
@pytest.mark.parametrize("turn_deg_s", [0.0, 6.0])
def test_velocity_bends_eastward_by_one_unit(latitude, duration, turn_deg_s):
    """-dg/dt = -Omega x g = g Omega cos(lat) east; a lean, a length or a turning plate make no
    odds. (The moment's of 50 steps: 5/50^2 less.)"""
    n = round(50 * duration)
    tilt = (0.0, 0.0) if turn_deg_s else (3.0, -2.0)
    w = swaying(4, duration, 50.0, latitude, tilt, still(4, n), turn=np.deg2rad(turn_deg_s))
    seen = Swaying.of(w.windows, 5.0)
    north_east = bend(turned(seen.velocity, w.heading[:, None]))
    np.testing.assert_allclose(north_east, [[0.0, 1.0]] * 4, atol=4e-3)
    np.testing.assert_allclose(seen.residual(w.heading)[..., :2], 0.0, atol=0.015)


def test_a_rocking_body_moves_as_its_rate_says():
    """On an arm of 0.6 m, velocity is 0.6 i times the rate, as complex numbers."""
    seen = Swaying.of(rocking(0.6, 100.0, 20.0, 1.1), 4.0)
    v, w = (part[0, :, 0] + 1j * part[0, :, 1] for part in (seen.velocity, seen.rate))
    p = legendre(len(v), 6, torch.zeros(1, dtype=torch.float64)).numpy()
    v, w = (x - np.linalg.lstsq(p.T, x, rcond=None)[0] @ p for x in (v, w))
    np.testing.assert_allclose(np.vdot(w, v) / np.vdot(w, w), 0.6j, atol=0.01)


@pytest.mark.parametrize("base", [None, "oba"])
def test_an_answer_turns_with_the_mount(base):
    """Whatever the weights are: turned about z, the heading follows and sigma stays."""
    rng = np.random.default_rng(5)
    w = swaying(6, 10.0, 50.0, 40.0, (0.0, 0.0), 1e-3 * rng.standard_normal((6, 501, 3))).windows
    net = make(replace(CONFIG, base=base), 3)
    with torch.no_grad(), torch.random.fork_rng():
        torch.manual_seed(1)
        for weights in net.parameters():
            weights.add_(0.3 * torch.randn_like(weights))

    def answers(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
        x, heading = inputs(net.config, windows, 2.5, None)
        raw = net(torch.from_numpy(x)).detach()
        return wrap(heading + np.deg2rad(net.heading_deg(raw).numpy())), raw[:, 2].numpy()

    heading, kappa = answers(w)
    R = rotation_z(0.9)
    of_turned, same = answers(replace(w, gyro=w.gyro @ R, accel=w.accel @ R))
    np.testing.assert_allclose(wrap(of_turned - heading - 0.9), 0.0, atol=1e-5)
    np.testing.assert_allclose(same, kappa, rtol=1e-3)


def test_slow_samples_are_refused():
    w = swaying(1, 10.0, 20.0, 40.0, (0.0, 0.0), still(1, 200)).windows
    with pytest.raises(InputError, match="20 Hz: must be 50 Hz or more"):
        inputs(CONFIG, w, 4.0, None)


def test_its_channel_takes_its_own_cell():
    with pytest.raises(InputError, match="cell"):
        replace(CONFIG, cell="pool")
    with pytest.raises(InputError, match="cell"):
        replace(CONFIG, channels=["gyro"])
    with pytest.raises(InputError, match="output"):
        replace(CONFIG, output="degrees")


@pytest.fixture(scope="module")
def resting(tmp_path_factory) -> list[Dataset]:
    """Two latitudes, 50 Hz, 20 s each."""
    home = tmp_path_factory.mktemp("resting")
    return [
        Dataset.open_finished(sim.generate.main(default_config(
            "imu=hg9900", "protocol=static", "rate_hz=50", "duration_s=20", "recordings=60",
            "split=[8,2,0]", f"latitude={latitude}", f"seed={latitude}", f"out={home}/{latitude}",
        )))
        for latitude in (20, 50)
    ]  # fmt: skip


def train(resting, home, monkeypatch, *options):
    monkeypatch.chdir(home)
    paths = ",".join(str(dataset.path) for dataset in resting)
    always = (f"data=[{paths}]", "experiment=sway", "windows_s=[10]")
    return lbgc.train.main(composed(TrainConfig, "train", *always, *options))


def test_it_learns_which_way_north_is(resting, tmp_path, monkeypatch):
    """From chance, 104 degrees, to below 10 on recordings kept apart, at both latitudes, in 300
    steps: what velocity alignment has is 1.5."""
    run = train(resting, tmp_path, monkeypatch, "steps=300", "warm_up=150", "validate_every=100")
    learned = Learned.load(run)
    for dataset in resting:
        rows = dataset.in_split("validation")
        held = Labelled.joined([labelled(record, 10.0) for record in dataset.records(rows)])
        found = learned(held.windows)
        off = np.rad2deg(wrap(found.heading - held.heading))
        assert np.sqrt(np.mean(off**2)) < 10.0
        assert np.isfinite(found.sigma).all()


def test_a_warm_up_is_of_headings_alone(resting, tmp_path, monkeypatch):
    """The concentration's layer starts at zero, and stays there."""
    last = {}
    for steps in (0, 4):
        own = tmp_path / str(steps)
        own.mkdir()
        run = train(resting, own, monkeypatch, "steps=4", "validate_every=4", f"warm_up={steps}")
        last[steps] = load_net(run)[0].filter.out.weight[-1].detach()
    assert last[4].abs().max() == 0.0
    assert last[0].abs().max() > 0.0


def test_datasets_trained_on_together_agree(resting, tmp_path, monkeypatch):
    config = default_config("imu=hg9900", "protocol=static", "rate_hz=50", "duration_s=10",
                            "recordings=10", f"out={tmp_path}/short")  # fmt: skip
    short = Dataset.open_finished(sim.generate.main(config))
    with pytest.raises(InputError, match="differs from the first one in rate or duration"):
        train([resting[0], short], tmp_path, monkeypatch, "steps=4")
    with pytest.raises(InputError, match="draws by one dataset's sensor"):
        train(resting, tmp_path, monkeypatch, "stream=true")
