"""Counts that the noise does not shake: means are refused, and what goes on says so."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import composed

import lbgc.bound
from lbgc.errors import InputError
from lbgc.sensor.datasheet import AccelConfig, GyroConfig
from lbgc.sensor.dither import check_means, quietest, warnings


def sensor(name, rate_hz):
    config = composed(lbgc.bound.BoundConfig, "bound", f"imu={name}", f"rate_hz={rate_hz}")
    return config.imu.model(rate_hz)


@pytest.mark.parametrize(
    ("name", "rate_hz", "refused"),
    [
        ("lasergyro", 100, ("imu.gyro.angle_lsb_arcsec", "imu.accel.velocity_lsb_m_per_s")),
        ("adis16405", 10, ("imu.accel.lsb_ug",)),
        ("adis16405", 100, ()),
        ("adis16495", 100, ("imu.accel.lsb_ug",)),
        ("adis16495", 600, ()),
        ("stim300", 100, ()),
        ("sdc500", 600, ()),
    ],
)
def test_presets_whose_counts_their_noise_does_not_shake(name, rate_hz, refused):
    imu = sensor(name, rate_hz)
    said = warnings(imu, 1.0)
    assert len(said) == len(refused)
    for line, key in zip(said, refused, strict=True):
        assert key in line
        part = key.split(".")[1]
        with pytest.raises(InputError, match=f"{key} .*dead band.*output=samples"):
            check_means(getattr(imu, part), f"imu.{part}", imu.dt, 1.0, 0.0)
    for part in {"gyro", "accel"} - {key.split(".")[1] for key in refused}:
        check_means(getattr(imu, part), f"imu.{part}", imu.dt, 1.0, 0.0)


def test_a_carried_count_is_shaken_by_the_angle_noise_within_a_mean():
    """0.06 deg/sqrt(h) is 3.6 arcsec in 1 s and 36 in 100 s: half a count of 20 arcsec in 7.7 s."""
    triad = GyroConfig(arw_deg_per_sqrt_h=0.06, angle_lsb_arcsec=20.0).triad()
    with pytest.raises(InputError, match=r"noise over 7 s is 9.52 arcsec.*dead band"):
        check_means(triad, "imu.gyro", 0.01, 7.0, 0.0)
    check_means(triad, "imu.gyro", 0.01, 8.0, 0.0)


def test_what_wanders_or_swings_is_no_dither():
    slow = AccelConfig(bias_instability_ug=1000, random_walk_ug_per_sqrt_h=1000, lsb_ug=10)
    assert quietest(replace(slow, tone_ug=500, tone_hz=20).triad(), 0.01) == 0
    assert quietest(replace(slow, noise_ug_per_sqrt_hz=[100, 50, 80]).triad(), 0.01) > 0


@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_the_dead_band_is_where_rounding_stops_being_noise(rng, offset):
    """Just above half a count the variance of means over 100 samples is the model's within 3% and
    sampling error, wherever the mean stands; at a fifth of a count it is far from it."""
    counts = 4.0
    for sigma, is_noise in ((0.55, True), (0.2, False)):
        N = sigma * counts * 1e-6 * 9.80665 * np.sqrt(0.01) * 60
        triad = AccelConfig(vrw_m_per_s_per_sqrt_h=N, lsb_ug=counts).triad()
        truth = np.full((3, 1), (7 + offset) * triad.counts.lsb)
        errors = triad.draw_run(rng, triad.none_drawn())
        y = triad.measure(rng, truth, errors, 400_000, 0.01)[0] * triad.counts.lsb
        means = y.reshape(3, 4000, 100).mean(axis=-1)
        model = triad.N[0] ** 2 + triad.counts.lsb**2 * 0.01 / 12
        ratio = np.mean((means - means.mean(axis=1, keepdims=True)) ** 2) / model
        assert (abs(ratio - 1) < 0.03 + 4.5 * np.sqrt(2 / means.size)) == is_noise


def test_bound_names_what_is_assumed_and_what_is_not_shaken(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ("imu=lasergyro", "imu.assumed=its gyro bias", "windows_s=[10]")
    lbgc.bound.main(composed(lbgc.bound.BoundConfig, "bound", *options))
    said = capsys.readouterr().out
    assert "assumed of the sensor, not measured: its gyro bias" in said
    assert "imu.gyro.angle_lsb_arcsec = 0.93 arcsec has a dead band" in said
    lbgc.bound.main(composed(lbgc.bound.BoundConfig, "bound", "imu=stim300", "windows_s=[10]"))
    assert "assumed" not in capsys.readouterr().out
