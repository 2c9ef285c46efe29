"""Logs of a gyro of one or two axes: no frame, no latitude, no figure of what was not measured."""

import json

import numpy as np
import pytest
import yaml

from lbgc.data import finished_fits
from lbgc.data.logconfig import LogConfig
from lbgc.data.logs import read_noise
from lbgc.data.looking.doctor import looked
from lbgc.data.readers.column_names import is_gyro
from lbgc.errors import InputError
from lbgc.exports import FORMATS, written
from lbgc.exports.subject import Subject
from lbgc.report import population
from lbgc.sensor.datasheet import ImuConfig

HZ, SAMPLES = 50.0, 15_000
ARW = (0.05, 0.1)  # deg/sqrt(h), white


def log(path, axes: int, names: str, seed: int = 3) -> str:
    """A resting gyro of so many axes, deg/h."""
    rng = np.random.default_rng(seed)
    noise = 60 * np.array(ARW[:axes]) * np.sqrt(HZ) * rng.standard_normal((SAMPLES, axes))
    table = np.column_stack([np.arange(SAMPLES) / HZ, 10 + noise])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=f"t (s),{names}", comments="")
    return str(path)


@pytest.mark.parametrize(
    ("axes", "names", "said"),
    [
        (1, "rate (deg/h)", "one axis of its gyros was measured, whose figures stand for all"),
        (2, "gx (deg/h),gy (deg/h)", "down was not, and has the figures of the second one"),
    ],
)
def test_a_gyro_of_fewer_axes_is_fitted(cli, tmp_path, axes, names, said):
    file = log(tmp_path / "fog.csv", axes, names)
    done = cli("lbgc.fit", f"log.path={file}", "name=fog", "processes=1", "flicker_short_s=1",
               "export=[kalibr]")  # fmt: skip
    assert done.code == 0, done.err
    assert said in done.out
    assert "gyro down" not in done.out
    directory = (tmp_path / "outputs/fit/latest").resolve()
    fits = json.loads((directory / "fit.json").read_text())["gyro"]
    assert len(fits) == axes == len(list((directory / "axes").iterdir()))
    for own, arw in zip(fits, ARW, strict=False):
        # white noise of n samples is known to 1/sqrt(2 n); four of these
        found = own["estimates"]["N"]["value"]
        assert found == pytest.approx(np.deg2rad(arw) / 60, rel=4 / np.sqrt(2 * SAMPLES))
    text = (directory / "imu/fog.yaml").read_text()
    sensor = yaml.safe_load(text)
    assert said in sensor["assumed"]
    white = sensor["gyro"]["arw_deg_per_sqrt_h"]
    assert white[axes:] == [white[axes - 1]] * (3 - axes)
    assert said in next((directory / "export").iterdir()).read_text()
    for command in ("evaluate", "calibrate"):
        refused = cli(f"lbgc.{command}", f"log.path={file}", "log.latitude=48")
        assert refused.code == 2
        assert "leaves one triad" in refused.err
        assert len(refused.err.strip().splitlines()) == 1


def test_every_export_says_whose_figures_they_are():
    """Of what a sensor assumes, each file of each tool says all."""
    said = "one axis of its gyros was measured, whose figures stand for all three"
    sensor = ImuConfig(name="fog", assumed=said)
    for text in written(Subject(sensor, 100.0), list(FORMATS)).values():
        assert said in text


def test_the_doctor_knows_a_gyro_of_fewer_axes(tmp_path):
    for at, (axes, names, columns) in enumerate(
        [
            (1, "Gyro [deg/h]", ["Gyro [deg/h]"]),
            (1, "wz (deg/h)", ["wz (deg/h)"]),
            (2, "gyro_x (deg/h),gyro_z (deg/h)", ["gyro_x (deg/h)", "gyro_z (deg/h)"]),
        ]
    ):
        look = looked(tmp_path / log(tmp_path / f"{at}.csv", axes, names), {})
        assert look.keys["gyro_columns"] == columns, look
        assert look.is_described
        assert look.rest is not None
        assert look.rest.triads["gyro"].shape == (SAMPLES, axes)
    # one column without a name that says it may be anything
    look = looked(tmp_path / log(tmp_path / "any.csv", 1, "value"), {})
    (asked,) = look.asks
    assert "log.gyro_columns with log.accel_columns=none" in asked.doubt
    told = {"gyro_columns": ["value"], "accel_columns": "none", "gyro_unit": "deg/h"}
    assert looked(tmp_path / "any.csv", told).is_described


def test_names_of_a_gyro_without_an_axis():
    for name in ("rate", "Rate (deg/s)", "gyro", "omega [rad/s]", "angular_rate", "w (rad/s)"):
        assert is_gyro(name), name
    for name in ("g", "sample rate", "w", "rate (Hz)", "gyro_x", "acceleration", "temperature"):
        assert not is_gyro(name), name


def test_fewer_axes_are_gyros_alone():
    one = LogConfig(path="a.csv", gyro_columns=["rate"], accel_columns="none", gyro_scale=2.0)
    assert one.each("gyro", "scale").tolist() == [2.0]
    for changes in ({"accel_columns": ["a", "b", "c"]}, {"gyro_scale": [1.0, 1.0]}):
        with pytest.raises(InputError, match=r"columns|one for each"):
            LogConfig(
                **{"path": "a.csv", "gyro_columns": ["rate"], "accel_columns": "none"} | changes
            )
    with pytest.raises(InputError, match="three column names"):
        LogConfig(path="a.csv", gyro_columns="none", accel_columns=["a"])


def test_a_scale_of_fewer_axes(tmp_path):
    file = log(tmp_path / "fog.csv", 1, "rate (deg/h)")
    keys = {"gyro_columns": ["rate (deg/h)"], "accel_columns": "none", "gyro_unit": "deg/h"}
    ((plain,),), ((twice,),) = (
        read_noise(LogConfig(path=file, gyro_scale=scale, **keys)) for scale in (1.0, -2.0)
    )
    np.testing.assert_allclose(twice.triads["gyro"], -2 * plain.triads["gyro"])


def test_units_of_one_kind_have_a_spread(tmp_path):
    one = {"estimates": {"N": {"value": 1.0, "low": 0.9, "high": 1.1, "upper": 1.1}}}
    units = []
    for at, scale in enumerate((1.0, 1.5, 2.0)):
        own = {key: scale * value for key, value in one["estimates"]["N"].items()}
        (tmp_path / str(at)).mkdir()
        content = {"gyro": [{"estimates": {"N": own}}]}
        (tmp_path / str(at) / "fit.json").write_text(json.dumps(content))
        units.append(finished_fits.estimates(str(tmp_path / str(at))))
    told = population.populations(units)
    assert "gyro measured" in population.report(told, 3)
    units[0]["gyro"] = units[0]["gyro"] * 3
    with pytest.raises(InputError, match="so many axes"):
        population.populations(units)
