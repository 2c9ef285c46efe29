"""What the examples of CONTRIBUTING.md must do once they are part of the project. A process of its
own runs this, in which lbgc and sim are a copy that holds them; see test_contributing.py.

    python tests/contributed.py "A noise term" "python lbgc/bound.py ..." ...
"""

import json
import re
import runpy
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import lbgc
from lbgc.errors import InputError

COPY = Path(lbgc.__file__).parents[1]


def generator() -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(20261126))


def refuses(call: Callable[[], object], what: str) -> None:
    with pytest.raises(InputError, match=re.escape(what)):
        call()


def noise_term() -> None:
    """Drawn means, means of drawn samples, the covariance of means, the Allan variance and the PSD
    agree: variances of 4,000 series within 5 standard errors, sqrt(2/4000) each."""
    from lbgc.sensor.datasheet import GyroConfig
    from lbgc.sensor.noise import Smoothed
    from lbgc.units import factor

    term, rng, dt, block = Smoothed(2.0, 7.0), generator(), 0.5, 20
    expected = term.covariance_of_means(3, dt, block)
    drawn = term.sample_means(rng, (4000, 3), dt, block)
    averaged = term.sample(rng, (4000, 3 * block), dt).reshape(4000, 3, block).mean(axis=2)
    for values in (drawn, averaged):
        found = values.T.astype(float) @ values / 4000
        error = np.sqrt((expected**2 + np.outer(*[np.diag(expected)] * 2)) / 4000)
        assert (np.abs(found - expected) < 5 * error).all()
    allan = expected[0, 0] - expected[0, 1]
    np.testing.assert_allclose(term.allan_variance(np.array([dt * block])), allan, rtol=1e-9)
    f = np.linspace(-500, 500, 1_000_001)
    variance = term.N**2 / (2 * term.T)  # of which 1e-4 is beyond: 2/pi over 2 pi f T
    np.testing.assert_allclose(term.psd(f).sum() * (f[1] - f[0]), variance, rtol=2e-4)
    triad = GyroConfig(smoothed_arw_deg_per_sqrt_h=0.1, smoothing_s=30.0).triad()
    assert triad.terms == ((Smoothed(0.1 * factor("deg_per_sqrt_h"), 30.0),),) * 3
    refuses(lambda: GyroConfig(smoothing_s=0.0), "smoothing_s = 0.0 s: must be greater than zero")


def drawn_once() -> None:
    """It is new at every power-up, stored, printed as it was drawn, and part of the floor."""
    from lbgc.data.store import Dataset
    from lbgc.errors import build
    from lbgc.estimators import error_patterns
    from lbgc.estimators.block_means import Site
    from lbgc.sensor.datasheet import ImuConfig
    from lbgc.units import factor

    dataset = Dataset.open_finished("sensitive.zarr")
    c = dataset.label("gyro_g_sensitivity_session")
    assert (c[0] == c[2]).all()
    assert (c[1] == c[3]).all()
    assert (c[0] != c[1]).all()
    true = error_patterns.EARTH_RATE * np.array(
        [np.cos(np.deg2rad(32.76)), np.sin(np.deg2rad(32.76))]
    )
    for record, own in zip(dataset.records(np.arange(4)), c, strict=True):
        psi = record.heading + record.plate_angle[0]
        felt = np.array([true[0] * np.cos(psi), -true[0] * np.sin(psi), -true[1]])
        printed = felt + own @ record.accel.mean(axis=0)
        np.testing.assert_allclose(record.gyro.mean(axis=0), printed, atol=1e-10)
    imu = build(ImuConfig, dataset.configuration["imu"]).model(20.0)
    site = Site.at(float(np.deg2rad(32.76)))
    size = error_patterns.causes(imu, np.eye(3)[None], site)["g-sensitivity"]
    expected = 2 * factor("deg_per_h_per_g") * site.gravity
    np.testing.assert_allclose(np.abs(size[..., error_patterns.ONE]).max(), expected)


def estimator() -> None:
    """It is in the evaluation's table, right where nothing errs, little moved by a knock, with a
    true sigma where noise is white (200 windows: 5 standard errors of a mean square), and refuses
    a plate that turns."""
    from lbgc.data.windows import joined, window_of
    from lbgc.earth import EARTH_RATE
    from lbgc.evaluate import KNOWN

    document = json.loads(Path("outputs/evaluate/latest/results.json").read_text())
    assert {row["estimator"] for row in document["rows"]} == {"mean", "median"}
    median, rng, psi = KNOWN["median"], generator(), 0.6
    north = EARTH_RATE * np.cos(0.5)
    rate = [north * np.cos(psi), -north * np.sin(psi), -EARTH_RATE * np.sin(0.5)]
    gyro = rate + 1e-6 * rng.standard_normal((200, 100, 3))
    force = np.broadcast_to([0.0, 0.0, -9.8], (100, 3))
    latitude = float(np.rad2deg(0.5))
    windows = joined([window_of(own, force, 10.0, latitude) for own in gyro])
    found = median(windows, None)
    normalised = np.mean(((found.heading - psi) / found.sigma) ** 2)
    assert abs(normalised - 1) < 5 * np.sqrt(2 / 200)
    gyro[0, 50] += 1e-3
    knocked = median(window_of(gyro[0], force, 10.0, latitude), None)
    assert abs(knocked.heading[0] - psi) < 5 * knocked.sigma[0]
    turning = window_of(gyro[0], force, 10.0, latitude, np.linspace(0, 1, 100))
    refuses(lambda: median(turning, None), "of plate travel")


def write_log() -> None:
    """A minute at rest, looking east: float32, and a shorter file that is not whole."""
    from lbgc.earth import EARTH_RATE

    lat = np.deg2rad(48.1)
    rest = [0.0, -EARTH_RATE * np.cos(lat), -EARTH_RATE * np.sin(lat), 0.0, 0.0, -9.81]
    spread = [1e-5] * 3 + [1e-3] * 3
    rows = (rest + spread * generator().standard_normal((6000, 6))).astype("<f4")
    rows.tofile("mylog.bin")
    rows.ravel()[:-1].tofile("short.bin")


def log_format() -> None:
    """The samples come back as they were written, and what is no such file is refused."""
    from lbgc.data.logs import LogConfig, read

    config = {"reader": "binary", "latitude": 48.1, "rate_hz": 100.0}
    (record,) = read(LogConfig(path="mylog.bin", **config))
    rows = np.fromfile("mylog.bin", "<f4").reshape(-1, 6)
    np.testing.assert_array_equal(record.gyro, rows[:, :3])
    np.testing.assert_array_equal(record.accel, rows[:, 3:])
    short = LogConfig(path="short.bin", **config)
    refuses(lambda: list(read(short)), "holds 35999 numbers, not rows of six")
    document = json.loads(Path("outputs/evaluate/latest/results.json").read_text())
    (answer,) = document["headings"]
    (own,) = answer["recordings"]
    assert abs(own["heading_deg"] - 90) < 5


def disturbance() -> None:
    """It leans as much as was asked for, at any instants; what it drew is stored; and what the
    others draw is what they drew before."""
    from lbgc.data.store import Dataset
    from lbgc.units import factor
    from sim.disturbance import BuildingConfig, FloorConfig, KnocksConfig

    one = BuildingConfig(lean_arcsec=4.0, hz=0.5).draw(generator(), 60.0)
    t = np.arange(6000) / 100
    rotation, velocity = one.motion(t)
    size = np.linalg.norm(rotation, axis=1).max()
    np.testing.assert_allclose(size, 4 * factor("arcsec"), rtol=1e-3)
    np.testing.assert_array_equal(one.motion(t[7:5000:3])[0], rotation[7:5000:3])
    assert not velocity.any()
    assert not rotation[:, 2].any()
    knocks = KnocksConfig(per_minute=20.0)
    floor = FloorConfig(knocks=knocks).draw(generator(), 60.0)
    np.testing.assert_array_equal(floor.knocks.at, knocks.draw(generator().spawn(4)[1], 60.0).at)
    lean = Dataset.open_finished("leaning.zarr").label("building_lean") / factor("arcsec")
    assert ((lean >= 5) & (lean <= 20)).all()
    assert lean[0] != lean[1]


def export_format() -> None:
    """Its figures are the sensor's, and what it does not tell is said."""
    from lbgc.units import factor

    text = Path("outputs/export_imu/latest/table.csv").read_text()
    rows = [line.split(",") for line in text.splitlines() if line[0] != "#"]
    assert [row[:2] for row in rows[:2]] == [["gyro", "forward"], ["gyro", "right"]]
    density = np.sqrt(2) * 0.15 * factor("arw_deg_per_sqrt_h")  # and counts, hardly
    assert float(rows[0][2]) == pytest.approx(density, rel=1e-3)
    assert "# replaced by the drift: gyro.allan_minimum_deg_per_h = 0.3 deg/h" in text
    assert "# lost: gyro.bias_session_deg_per_h = 4.0 deg/h" in text


def network() -> None:
    """The trained run answers, each window from itself alone; and a correction starts from its
    base."""
    import torch

    from lbgc.data.windows import joined, window_of
    from lbgc.learning.estimator import Learned
    from lbgc.learning.model import ModelConfig, make

    learned = Learned.load("outputs/train/latest")
    assert learned.config.cell == "conv"
    rng = generator()
    every = [
        window_of(1e-5 * rng.standard_normal((12, 3)), rng.standard_normal((12, 3)), 0.2, 32.76)
        for _ in range(3)
    ]
    together = learned(joined(every)).heading
    alone = np.concatenate([learned(own).heading for own in every])
    np.testing.assert_allclose(together, alone, atol=1e-5)
    net = make(ModelConfig("conv", "conv", base="mean"), 1)
    x = torch.ones(2, 12, net.config.features)
    assert (net.heading_deg(net(x)) == 0).all()


PREPARED = {"A log format": write_log}
CHECKS = {
    "A noise term": noise_term,
    "An error that is drawn once": drawn_once,
    "A classical estimator": estimator,
    "A log format": log_format,
    "An export format": export_format,
    "A floor disturbance": disturbance,
    "A network": network,
}

if __name__ == "__main__":
    title, *commands = sys.argv[1:]
    PREPARED.get(title, lambda: None)()
    for command in commands:
        script, *arguments = shlex.split(command)[1:]
        sys.argv = [script, *arguments]
        runpy.run_path(str(COPY / script), run_name="__main__")
    CHECKS[title]()
