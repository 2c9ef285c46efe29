"""Domain randomisation: another place is what a recording there would have been; every field does
something; it is training's alone."""

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers import composed, default_config, generate

from lbgc.data.windows import stack
from lbgc.errors import InputError
from lbgc.learning.augment import AugmentConfig
from lbgc.learning.batches import Stored
from lbgc.learning.randomise import RandomiseConfig, Randomised, moved
from lbgc.train import TrainConfig


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """(at 32.76 degrees, at 55): noiseless, on a leaning base, two positions."""
    home, found = tmp_path_factory.mktemp("randomise"), []
    config = default_config("imu=ideal", "protocol=two_position", "scene.base_roll_deg=1",
                            "scene.reference_error_deg=0")  # fmt: skip
    for latitude in (32.76, 55.0):
        made = generate(home / f"{latitude}.zarr", imu=config.imu, protocol=config.protocol,
                        scene=config.scene, latitude=latitude, recordings=2, duration_s=20.0,
                        output="means", mean_s=1.0)  # fmt: skip
        found.append(stack(made.records(np.arange(2)), 1.0))
    return found


def source(recordings) -> Stored:
    plain = AugmentConfig(rotate=False, mix=False)
    units = np.zeros(len(recordings), int)
    return Stored(recordings, units, plain, default_config().imu.gyro.triad())


def test_another_latitude_is_the_recording_made_there(recordings):
    """At rest; a servo's slew is as it was. A degree of lean times what Earth's rate is there."""
    here, there = recordings[0], recordings[1].windows
    made = moved(here, float(there.latitude[0])).windows
    still = np.abs(np.diff(here.windows.plate_angle[0], prepend=0.0)) < 1e-6
    assert still.sum() > 8
    np.testing.assert_allclose(made.gyro[:, still], there.gyro[:, still], atol=2e-9)
    np.testing.assert_allclose(made.accel[:, still], there.accel[:, still], atol=1e-5)
    np.testing.assert_array_equal(made.latitude, there.latitude)


CHANGES = {
    "latitude": (50.0, 60.0),
    "noise": 1.0,
    "run_bias": 1.0,
    "vibration_deg_per_h": 100.0,
}


@pytest.mark.parametrize("field", CHANGES)
def test_every_field_changes_what_training_is_given(recordings, field):
    imu = default_config().imu.model(600.0)
    config = replace(RandomiseConfig(), **{field: CHANGES[field]})
    assert config.is_on
    assert not RandomiseConfig().is_on
    one = Randomised(source(recordings[0]), config, imu).draw(np.random.default_rng(1), 4, 5)
    two = source(recordings[0]).draw(np.random.default_rng(1), 4, 5)
    assert not np.array_equal(one.windows.gyro, two.windows.gyro)
    np.testing.assert_array_equal(one.heading, two.heading)
    assert {*CHANGES, "vibration_hz"} == {f.name for f in fields(RandomiseConfig)}


def test_a_vibrations_frequency_counts(recordings):
    imu = default_config().imu.model(600.0)
    made = [
        Randomised(source(recordings[0]), RandomiseConfig(None, 0, 0, 100.0, hz), imu)
        .draw(np.random.default_rng(1), 4, 5)
        .windows.gyro
        for hz in ((45.0, 51.0), (20.0, 20.0))
    ]
    assert not np.array_equal(*made)


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ("randomise.latitude=[40]", r"latitude = \(40.0,\) deg: must be \[low, high\]"),
        ("randomise.latitude=[10,95]", "within 89"),
        ("randomise.noise=-1", "must not be negative"),
    ],
)
def test_bad_ranges_are_named(option, says):
    with pytest.raises(InputError, match=says):
        composed(TrainConfig, "train", "data=x", option)
