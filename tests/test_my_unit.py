"""One's own unit, simulated: datasets whose units are drawn from what is known of one."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from helpers import default_config
from test_evaluate import results

from lbgc.data.unit_file import CalibratedUnit
from lbgc.outputs import fingerprint
from lbgc.sensor.known import Known
from lbgc.sensor.streams import Purpose
from lbgc.sensor.unit import coefficients
from sim.configuration import GenerateConfig
from sim.recordings import Sensor

BIAS = ("imu.gyro.bias_unit_deg_per_h=1.5", "imu.gyro.bias_session_deg_per_h=0.3",
        "imu.gyro.bias_run_deg_per_h=0.2")  # fmt: skip
STILL = ("protocol=static", "output=means", "duration_s=240", "split=[0,0,100]")


def written(path: Path, config: GenerateConfig, now: str | None = None) -> CalibratedUnit:
    """The file of a unit, all of whose coefficients are known in part, and depend on each other."""
    rng = np.random.default_rng(5)
    lifetimes = ("unit",) if now is None else ("unit", "session")
    own = coefficients(config.imu.model(config.rate_hz), *lifetimes)
    sigma = np.array(list(own.values()))
    mixed = rng.standard_normal((len(own), len(own) + 9)) / np.sqrt(len(own))
    covariance = 0.1 * sigma * (mixed @ mixed.T) * sigma[:, None]
    known = Known(tuple(own), sigma * rng.standard_normal(len(own)), covariance)
    sizes = (1e-6,) * 3, (2e-6,) * 3, (3e-6,) * 3
    law = fingerprint(asdict(config.imu))
    unit = CalibratedUnit(config.imu.name, law, sizes, known, 3, ("a", "b"), now)
    unit.save(path)
    return unit


@pytest.mark.parametrize("now", [None, "b"])
def test_units_are_drawn_from_what_is_known(now, tmp_path):
    """What is drawn of 2,000 units, in the law's own measure: means within 4.5 standard errors of
    zero, products within 6 (there are some two hundred)."""
    count = 2000
    base = replace(default_config(), units=count)
    unit = written(tmp_path / "unit.json", base, now)
    config = replace(base, calibration=str(tmp_path / "unit.json"))
    sensor = Sensor.of(config)
    drawn = sensor.lasting(range(count))
    triads = {"gyro": drawn[Purpose.GYRO], "accel": drawn[Purpose.ACCEL]}
    values = []
    for c in unit.known.coefficients:
        own = triads[c.triad][c.error]
        values.append(own[:, c.i] if own.ndim == 2 else own[:, c.i, c.j])
    off = np.array(values) - unit.known.mean[:, None]
    white = np.linalg.solve(np.linalg.cholesky(unit.known.covariance), off)
    assert np.abs(white.mean(axis=1)).max() < 4.5 / np.sqrt(count)
    products = white @ white.T / count - np.eye(len(white))
    assert np.abs(products).max() < 6 * np.sqrt(2 / count)
    assert sensor.gyro.bias("run").tolist() == [3e-6] * 3
    if now is None:  # other power-ups have errors of their own, of the size that was found
        session = triads["gyro"]["bias_session"]
        assert session.std() == pytest.approx(2e-6, rel=4.5 / np.sqrt(2 * session.size))


def test_a_dataset_is_named_by_what_the_file_says(tmp_path):
    base = default_config()
    written(tmp_path / "unit.json", base)
    (tmp_path / "copy.json").write_bytes((tmp_path / "unit.json").read_bytes())
    one, two = (
        replace(base, calibration=str(tmp_path / f"{name}.json")).content()
        for name in ("unit", "copy")
    )
    assert one == two
    assert one["calibration"] == json.loads((tmp_path / "unit.json").read_text())["sha256"]
    assert "calibration" not in base.content()


def test_one_power_up_is_known_alone(cli, tmp_path):
    written(tmp_path / "unit.json", default_config(), "b")
    refused = cli("sim.generate", "imu=sdc500", "sessions=2", "calibration=unit.json")
    assert refused.code == 2
    assert "sessions = 2: must be 1: the calibration knows the errors of one" in refused.err


def test_estimators_that_are_told_the_unit_hold_on_it(cli, tmp_path):
    """From recordings to the file, to simulations of this unit, to answers: the error is the
    bound's, and what is stated of it holds. 400 units, of two errors each, 4.5 sampling errors; one
    that is told the sensor's law alone does worse."""
    assert cli("sim.generate", *STILL, *BIAS, "sessions=4", "recordings=12", "out=a.zarr").code == 0
    unit = Path(cli("lbgc.calibrate", "data=a.zarr").last_line).with_name("unit.json")
    told = f"calibration={unit}"
    many = ("units=400", "recordings=400", "split_by=unit", "seed=9", "out=mine.zarr")
    done = cli("sim.generate", *STILL, *BIAS, told, *many)
    assert done.code == 0, done.err
    ask = ("data=mine.zarr", "estimators=[mean,gls,ekf,floor]", "windows_s=[240]")
    plain, own = cli("lbgc.evaluate", *ask), cli("lbgc.evaluate", *ask, told)
    assert "unless they are given it too" in plain.out
    rows = {row["estimator"]: row for row in results(own, tmp_path)["rows"]}
    before = {row["estimator"]: row for row in results(plain, tmp_path)["rows"]}
    bound = cli("lbgc.bound", told, *BIAS, "windows_s=[240]")
    floor = json.loads((tmp_path / bound.last_line / "bound.json").read_text())["bounds"][0]
    for name, row in rows.items():
        assert abs(row["mean_normalised_squared_error"] - 1) < 4.5 * np.sqrt(2 / 400)
        assert row["rmse_deg"] == pytest.approx(floor["floor_deg"], rel=4.5 / np.sqrt(2 * 400))
        assert row["rmse_deg"] < 0.6 * before[name]["rmse_deg"]


QUICK = ("experiment=residual", "windows_s=[240]", "steps=4", "validate_every=2", "batch=8",
         "tempering=200", "seed=3")  # fmt: skip


@pytest.mark.parametrize("stream", [True, False])
def test_a_network_for_one_unit(stream, cli, tmp_path):
    """Means are taken off what it learns from, its base is told what is left, and it answers this
    unit alone. So little trained it is its base, within a tenth of the base's error; its stated
    sigma, tempered on 200 windows and held against 100, is within 4.5 sampling errors."""
    assert cli("sim.generate", *STILL, *BIAS, "sessions=4", "recordings=12", "out=a.zarr").code == 0
    unit = Path(cli("lbgc.calibrate", "data=a.zarr").last_line).with_name("unit.json")
    told = f"calibration={unit}"
    many = ("units=300", "recordings=300", "split_by=unit", "seed=9", "out=mine.zarr")
    kind = ("protocol=static", "output=means", "duration_s=240", "split=[1,1,1]")
    assert cli("sim.generate", *kind, *BIAS, told, *many).code == 0
    ask = ("data=mine.zarr", "windows_s=[240]", "estimators=[gls]")
    trained = cli("lbgc.train", "data=mine.zarr", told, *QUICK, f"stream={str(stream).lower()}")
    assert trained.code == 0, trained.err
    assert "told what is known of this unit can do better than" in trained.out
    run = f"run={trained.last_line}"
    own = {
        row["estimator"]: row
        for row in results(cli("lbgc.evaluate", *ask, run, told), tmp_path)["rows"]
    }
    net, gls = own["residual"], own["gls"]
    assert net["rmse_deg"] == pytest.approx(gls["rmse_deg"], rel=0.1)
    assert abs(net["mean_normalised_squared_error"] - 1) < 4.5 * np.sqrt(2 / 100 + 2 / 200)
    without = cli("lbgc.evaluate", *ask, run)
    assert "is not its: it was trained with that of checksum" in without.out + without.err
    plain = cli("lbgc.train", "data=mine.zarr", *QUICK, f"stream={str(stream).lower()}")
    if stream:
        assert plain.code == 2
        assert "must be the one from which this dataset was simulated" in plain.err
    else:
        asked = cli("lbgc.evaluate", *ask, told, f"run={plain.last_line}")
        assert "it was trained without one" in asked.out + asked.err
