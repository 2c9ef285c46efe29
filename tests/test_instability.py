"""A printed Allan minimum and B are told from each other, and from N and K."""

import numpy as np
import pytest
import yaml
from helpers import default_config, figures

from lbgc.errors import InputError, build
from lbgc.sensor import noise
from lbgc.sensor.datasheet import AccelConfig, GyroConfig, ImuConfig
from lbgc.sensor.instability import allan_minimum, instability
from lbgc.sensor.noise import Flicker, RandomWalk
from lbgc.units import DEG, HOUR, factor

CORNERS = (1.0, 3600.0)
COEFFICIENTS = [(0.15, 0.4, 0.0), (0.15, 0.4, 2.0), (2.0, 25.0, 0.0), (0.0, 1.0, 0.0)]


@pytest.mark.parametrize(("n", "b", "k"), COEFFICIENTS)
@pytest.mark.parametrize("corners", [None, CORNERS, (20.0, 500.0)])
def test_the_minimum_gives_b_back(n, b, k, corners):
    lowest, _ = allan_minimum(n, b, k, corners)
    assert instability(lowest, n, k, corners) == pytest.approx(b, rel=1e-9)


def test_without_corners_it_is_the_closed_form():
    """Against a search over the averaging time."""
    n, b, k = 0.2, 0.5, 0.03
    tau = np.geomspace(0.01, 1e4, 200_001)
    curve = n**2 / tau + 2 * np.log(2) / np.pi * b**2 + k**2 * tau / 3
    lowest, where = allan_minimum(n, b, k)
    assert lowest == pytest.approx(np.sqrt(curve.min()), rel=1e-9)
    assert where == pytest.approx(tau[curve.argmin()], rel=1e-3)
    assert allan_minimum(0.0, 1.0, 0.0) == (pytest.approx(0.664, abs=5e-4), np.inf)


def test_with_corners_it_is_the_terms_own_curve():
    """Between the corners, by the terms that everything else uses."""
    n, b, k = 0.2, 0.5, 0.03
    terms = (noise.White(n), noise.Flicker(b, *CORNERS), noise.RandomWalk(k))
    curve = noise.allan_variance(terms, np.geomspace(*CORNERS, 50_001))
    assert allan_minimum(n, b, k, CORNERS)[0] == pytest.approx(np.sqrt(curve.min()), rel=1e-5)


def test_what_noise_alone_exceeds_is_refused():
    with pytest.raises(ValueError, match=r"alone have a minimum of 0.5"):
        instability(0.4, 0.25 * np.sqrt(3), 0.5)
    said = r"allan_minimum_deg_per_h = 0.1 deg/h: is below 0.15, which white noise and random walk"
    with pytest.raises(InputError, match=said):
        GyroConfig(arw_deg_per_sqrt_h=0.15, allan_minimum_deg_per_h=0.1).triad()


def test_b_and_the_minimum_are_two_statements_of_one_thing():
    said = r"allan_minimum_ug = 20.0 ug: and bias_instability_ug = 50.0 are two statements"
    with pytest.raises(InputError, match=said):
        AccelConfig(bias_instability_ug=50.0, allan_minimum_ug=20.0).triad()
    with pytest.raises(InputError, match=r"disagrees by over 15% with allan_minimum_ug = 20.0"):
        AccelConfig(allan_minimum_ug=20.0, allan_minimum_mg=0.03).triad()
    milli, micro = (AccelConfig(**{k: v}) for k, v in (("allan_minimum_mg", 0.02),
                                                        ("allan_minimum_ug", 20.0)))  # fmt: skip
    np.testing.assert_allclose(
        figures(milli.triad(), Flicker, "B"), figures(micro.triad(), Flicker, "B")
    )


def test_each_axis_has_its_own_minimum_and_zero_is_none():
    triad = GyroConfig(
        arw_deg_per_sqrt_h=[0.1, 0.2, 0.1], allan_minimum_deg_per_h=[1, 1, 0]
    ).triad()
    B = figures(triad, Flicker, "B")
    assert B[0] > B[1] > B[2] == 0.0
    for axis in (0, 1):
        lowest = allan_minimum(triad.N[axis], B[axis], 0.0, CORNERS)[0]
        assert lowest == pytest.approx(DEG / HOUR, rel=1e-9)


@pytest.mark.parametrize(
    ("preset", "key"),
    [("stim300", "bias_instability_deg_per_h"), ("kvh1775", "allan_minimum_deg_per_h")],
)
def test_on_the_command_line_either_replaces_the_other(cli, preset, key):
    done = cli("lbgc.bound", f"imu={preset}", f"imu.gyro.{key}=1", "protocol=static", "latitude=40")
    assert done.code == 0, done.err


PRESETS = {
    "adis16405": (25.2, 200.0),
    "adis16495": (0.8, 3.2),
    "hg4930": (0.25, 25.0),
    "mti630": (8.0, [10.0, 10.0, 15.0]),
    "stim300": (0.3, 50.0),
    "vn100": (10.0, 40.0),
}


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_have_their_sheets_minimum(preset):
    """By the whole model's Allan variance, rounding and filter as well: within 2%."""
    model = default_config(f"imu={preset}").imu.model(100.0)
    tau = np.geomspace(10.0, 3600.0, 300)
    for triad, unit, sheet in zip(
        (model.gyro, model.accel), ("deg_per_h", "ug"), PRESETS[preset], strict=True
    ):
        lowest = np.sqrt(triad.allan_variance(tau, 0.01)).min(axis=1)
        np.testing.assert_allclose(lowest / factor(unit), np.broadcast_to(sheet, 3), rtol=0.02)


KALIBR = """
accelerometer_noise_density: 1.86e-03
accelerometer_random_walk: 4.33e-04
gyroscope_noise_density: 1.87e-04
gyroscope_random_walk: 2.66e-05
rostopic: /imu0
update_rate: 200.0
"""


@pytest.mark.parametrize("text", [KALIBR, "imu0:" + KALIBR.replace("\n", "\n  ").rstrip(" ")])
def test_an_imu_file_of_kalibrs_is_taken(text):
    """Two-sided and SI, so N and K themselves."""
    model = build(ImuConfig, yaml.safe_load(text)).model(200.0)
    np.testing.assert_allclose(model.gyro.N, 1.87e-4)
    np.testing.assert_allclose(figures(model.gyro, RandomWalk, "K"), 2.66e-5)
    np.testing.assert_allclose(model.accel.N, 1.86e-3)
    np.testing.assert_allclose(figures(model.accel, RandomWalk, "K"), 4.33e-4)
    assert figures(model.gyro, Flicker, "B") == (0.0, 0.0, 0.0)


def test_such_a_file_is_an_imu_of_the_command_line(cli, tmp_path):
    (tmp_path / "imu").mkdir()
    (tmp_path / "imu" / "mine.yaml").write_text(KALIBR)
    done = cli("lbgc.bound", "--config-dir", ".", "imu=mine", "protocol=static", "latitude=40")
    assert done.code == 0, done.err


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"gyroscope_noise_density": "x"}, "gyroscope_noise_density = x: must be a number"),
        ({"gyroscope_random_walk": -1.0}, "must be a number, zero or more"),
        ({"gyroscope_noise_density": 1e-4, "gyro": 3}, "must be a group"),
        (
            {"gyroscope_noise_density": 1e-4, "gyro": {"arw_deg_per_sqrt_h": 1.0}},
            "disagrees by over 15% with gyro.arw_deg_per_sqrt_h = 1.0: it is 0.343775 in that unit",
        ),
        ({"gyroscope_noise_density": 1e-4, "gyr_n": 3}, "key = gyr_n: choose from"),
    ],
)
def test_what_is_wrong_with_such_a_file_is_said(content, says):
    with pytest.raises(InputError, match=says):
        build(ImuConfig, content)
