"""Magnetic sensitivity: printed as it was drawn, part of floor and filter, and known to mimic
north."""

from dataclasses import replace

import floor_cases
import numpy as np
import pytest
from helpers import composed, generate

from lbgc.bound import BoundConfig, bounds, main
from lbgc.data import store
from lbgc.data.compensated import calibrated, drawn_errors
from lbgc.data.schema import ALWAYS
from lbgc.data.store import Dataset
from lbgc.data.windows import stack
from lbgc.earth import earth_rate_ned
from lbgc.errors import InputError, build
from lbgc.estimators.floor import floor
from lbgc.estimators.kalman import ekf
from lbgc.frames import euler_to_matrix, wrap
from lbgc.learning.augment import AugmentConfig, check_field
from lbgc.learning.stream import Streamed
from lbgc.protocol import STAGES, ProtocolConfig
from lbgc.sensor.datasheet import FieldConfig, GyroConfig, ImuConfig
from lbgc.units import DEG, GAUSS, HOUR

FIELD = FieldConfig(0.24, 0.42, 11.0)
SENSOR = ImuConfig(gyro=GyroConfig(magnetic_deg_per_h_per_gauss=5.0), magnetic_field=FIELD)
SMALL = {"recordings": 6, "units": 3, "duration_s": 40.0, "rate_hz": 20.0, "imu": SENSOR}
TWO = ProtocolConfig("two_position", "indexed", angles_deg=(0.0, 180.0))


def printed(dataset: Dataset, i: int) -> tuple[np.ndarray, np.ndarray]:
    """What the gyros of recording i print on a level base, and what they would without
    sensitivity, (T, 3) each, by what was drawn and where it looked."""
    (record,) = dataset.records(np.array([i]))
    c_nb = euler_to_matrix(0.0, 0.0, record.heading + record.plate_angle)
    field = np.einsum("nij,i->nj", c_nb, FIELD.ned)
    rate = np.einsum("nij,i->nj", c_nb, earth_rate_ned(np.deg2rad(32.76)))
    return rate + field @ dataset.label("gyro_magnetic")[i].T, rate


@pytest.mark.parametrize("protocol", [ProtocolConfig("static", "static"), TWO])
def test_a_sensor_prints_what_was_drawn_of_it(protocol, tmp_path):
    """At the rests; the unit's errors taken out, Earth's rate is left."""
    dataset = generate(tmp_path / "d.zarr", **SMALL, protocol=protocol)
    c = dataset.label("gyro_magnetic")
    assert (c[:3] == c[3:]).all()
    sigma = 5.0 * DEG / HOUR / GAUSS
    assert 0.5 * sigma < c[:3].std() < 1.6 * sigma  # 27 figures: 3.5 of their own sigma
    imu = SENSOR.model(20.0)
    every = np.arange(6)
    for i, record, drawn in zip(
        every, dataset.records(every), drawn_errors(dataset, every), strict=True
    ):
        rests = dataset.label("stage", range(i, i + 1))[0] == STAGES.index("rest")
        assert rests.sum() > 500
        expected, rate = printed(dataset, i)
        np.testing.assert_allclose(record.gyro[rests], expected[rests], atol=1e-8)
        left = calibrated(record, imu, *drawn, ("unit",))
        np.testing.assert_allclose(left.gyro[rests], rate[rests], atol=1e-8)


def test_a_dataset_has_the_variable_only_where_it_is_drawn(tmp_path):
    without = generate(tmp_path / "a.zarr", **(SMALL | {"imu": ImuConfig()}))
    assert without.layout.variables == ALWAYS
    with_it = generate(tmp_path / "b.zarr", **SMALL)
    assert with_it.layout.variables == (*ALWAYS, "gyro_magnetic")
    assert Dataset.open_finished(with_it.path).digest() == with_it.digest()
    file = with_it.path / "gyro_magnetic" / "c.0.0.0"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        Dataset.open_finished(with_it.path)


def test_a_variable_of_a_later_version_is_refused_by_name(tmp_path, monkeypatch):
    dataset = generate(tmp_path / "d.zarr", **SMALL)
    later = {n: v for n, v in store.VARIABLES.items() if n != "gyro_magnetic"}
    monkeypatch.setattr("lbgc.data.manifest.VARIABLES", later)
    with pytest.raises(InputError, match=r"does not know \(gyro_magnetic\)"):
        Dataset.open(dataset.path)


@pytest.mark.parametrize("name", ["two positions", "carousel"])
def test_floor_and_filter_allow_for_it(name):
    """Normalised squared error of 500 recordings, 4 of its sampling errors of 6%; without a word of
    it, it would be several."""
    protocol = {"two positions": floor_cases.TWO, "carousel": floor_cases.CAROUSEL}[name]
    field = ("horizontal_gauss=0.24", "vertical_gauss=0.42", "declination_deg=11")
    case = floor_cases.Case("", "stim300", protocol, 240.0, overrides=(
        "imu.gyro.magnetic_deg_per_h_per_gauss=5", *(f"imu.magnetic_field.{f}" for f in field)
    ))  # fmt: skip
    imu = case.model()
    made = floor_cases.draw(case, imu, 500, 4)
    none = replace(imu, gyro=replace(imu.gyro, drawn=tuple(
        e.gone() if e.name == "magnetic" else e for e in imu.gyro.drawn
    )))  # fmt: skip
    for estimator in (floor, ekf):
        found = estimator(made.windows, imu)
        error = wrap(found.heading - made.heading)
        assert np.mean((error / found.sigma) ** 2) == pytest.approx(1.0, abs=0.25)
        unaware = estimator(made.windows, none)
        error = wrap(unaware.heading - made.heading)
        assert np.mean((error / unaware.sigma) ** 2) > 2.5


def test_streamed_training_draws_it(tmp_path):
    """At rest, without noise: three numbers that turn with the heading that was drawn."""
    dataset = generate(tmp_path / "d.zarr", **SMALL)
    every = np.arange(6)
    stored = stack(dataset.records(every), 0.1)
    made = Streamed.of(dataset, every, stored).draw(np.random.default_rng(1), 40, 2)
    c_nb = euler_to_matrix(0.0, 0.0, made.heading)
    rate = np.einsum("wij,i->wj", c_nb, earth_rate_ned(np.deg2rad(32.76)))
    field = np.einsum("wij,i->wj", c_nb, FIELD.ned)
    units = dataset.label("gyro_magnetic")[:3]
    expected = rate[:, None] + np.einsum("uij,wj->wui", units, field)
    off = np.abs(made.windows.gyro.mean(axis=1)[:, None] - expected).max(axis=2)
    assert off.min(axis=1).max() < 1e-8  # of one of the three units


def test_the_bound_says_what_no_schedule_takes_out(capsys, monkeypatch, tmp_path):
    """On a carousel half of its variance is left, at rest all of it: 1 deg/h
    per gauss in 0.24 gauss, over Earth's horizontal rate, is v of a sensor without other errors."""
    monkeypatch.chdir(tmp_path)
    config = composed(
        BoundConfig, "bound", "imu=ideal", "imu.gyro.magnetic_deg_per_h_per_gauss=1",
        "imu.magnetic_field.horizontal_gauss=0.24", "imu.gyro.arw_deg_per_sqrt_h=1e-5",
        "windows_s=[240]",
    )  # fmt: skip
    v = 0.24 / (np.cos(np.deg2rad(32.76)) * 15.041067)
    carousel, static = (
        bounds(config, own)[0]["crlb_deg"] for own in (floor_cases.CAROUSEL, floor_cases.STATIC)
    )
    assert np.deg2rad(carousel) == pytest.approx(v * np.sqrt(0.5), rel=0.01)
    assert np.deg2rad(static) == pytest.approx(v, rel=0.01)
    main(config)
    assert f"MIMICS NORTH: {np.rad2deg(v * np.sqrt(0.5)):.3g} deg" in capsys.readouterr().out


def test_what_it_needs_is_said():
    with pytest.raises(InputError, match=r"magnetic_deg_per_h_per_gauss = 5.0 deg/h/gauss: takes"):
        build(ImuConfig, {"gyro": {"magnetic_deg_per_h_per_gauss": 5.0}})
    imu = SENSOR.model(20.0)
    with pytest.raises(InputError, match=r"augment.rotate = True: the gyros feel"):
        check_field(AugmentConfig(), imu)
    check_field(AugmentConfig(rotate=False, mix=False), imu)
    check_field(AugmentConfig(), ImuConfig().model(20.0))
