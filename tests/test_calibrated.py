"""Taking out what was drawn leaves what a perfect sensor would have printed."""

import numpy as np
import pytest
from helpers import default_config, fields_of, generate

from lbgc.data.compensated import calibrated, drawn_errors

LOUD = (
    "imu=ideal",
    "rate_hz=50",
    "duration_s=20",
    "recordings=2",
    "split=[0,0,1]",
    "protocol=two_position",
    "scene.physics_hz=400",
)
ERRORS = (
    "imu.gyro.scale_unit_ppm=2000",
    "imu.gyro.misalignment_unit_mrad=3",
    "imu.gyro.bias_unit_deg_per_h=50",
    "imu.gyro.bias_run_deg_per_h=20",
    "imu.gyro.g_sensitivity_deg_per_h_per_g=30",
    "imu.gyro.bias_per_k_deg_per_h_per_k=3",
    "imu.gyro.scale_per_k_ppm_per_k=100",
    "imu.accel.bias_session_mg=2",
    "imu.accel.scale_unit_ppm=900",
    "imu.temperature.rise_k=20",
    "imu.temperature.time_s=10",
)


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    home = tmp_path_factory.mktemp("calibrated")
    made = []
    for name, options in (("perfect", LOUD), ("loud", LOUD + ERRORS)):
        config = fields_of(default_config(*options))
        made.append(
            generate(home / f"{name}.zarr", **{k: v for k, v in config.items() if k != "out"})
        )
    return made


def test_all_lifetimes_taken_out_leave_the_truth(both):
    perfect, loud = both
    imu = default_config(*LOUD, *ERRORS).imu.model(50.0)
    indices = np.arange(2)
    for clean, record, errors in zip(
        perfect.records(indices), loud.records(indices), drawn_errors(loud, indices), strict=True
    ):
        found = calibrated(record, imu, *errors, ("unit", "session", "run"))
        # stored as float32: 6e-8 of the slew's rate, and of g
        np.testing.assert_allclose(found.gyro, clean.gyro, atol=1e-7 * np.abs(clean.gyro).max())
        np.testing.assert_allclose(found.accel, clean.accel, atol=3e-6)
        np.testing.assert_array_equal(found.plate_angle, record.plate_angle)


def test_one_lifetime_leaves_the_others(both):
    perfect, loud = both
    indices = np.arange(1)
    clean, record = next(perfect.records(indices)), next(loud.records(indices))
    gyro, accel = next(drawn_errors(loud, indices))
    imu = default_config(*LOUD, *ERRORS).imu.model(50.0)
    found = calibrated(record, imu, gyro, accel, ("session",))
    np.testing.assert_array_equal(found.gyro, record.gyro - gyro["bias_session"])
    assert np.abs(found.accel - clean.accel).max() < np.abs(record.accel - clean.accel).max()
