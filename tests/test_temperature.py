"""The bias against temperature is told from noise that wanders."""

import json

import numpy as np
import pytest
import yaml
from test_fit import spoil
from test_logs import write

from lbgc.data.logs import LogConfig, read
from lbgc.data.record import block_means
from lbgc.errors import InputError
from lbgc.sensor import gaussian
from lbgc.sensor.fitting.temperature import sensitivity
from lbgc.sensor.noise import Flicker, RandomWalk, White
from lbgc.units import DEG, HOUR

CORNERS = (1.0, 3600.0)
T = np.arange(7200) * 0.5


@pytest.mark.parametrize(
    "terms",
    [(White(1.0), Flicker(0.5), RandomWalk(0.1)), (White(0.1), RandomWalk(0.3)), (White(1.0),)],
    ids=["usual", "walk", "white"],
)
def test_intervals_hold_against_noise_that_wanders(terms, rng):
    """20 recordings of an hour, in which the sensor warms by 10 K or follows the room by 3 K: of 40
    intervals fewer than 33 hold by a chance of one in 1400."""
    held = 0
    for warmth in (10 * (1 - np.exp(-T / 900)), 3 * np.sin(2 * np.pi * T / 1500)):
        for y in gaussian.sample(terms, rng, (20, len(T)), 0.5):
            read_off = np.round(20 + warmth + 0.02 * rng.standard_normal(len(T)), 2)
            found = sensitivity((y + 0.3 * warmth)[None], read_off[None], 0.5, CORNERS)
            assert found is not None
            held += found.low <= 0.3 <= found.high
    assert held >= 33


def test_several_recordings_tell_it_better(rng):
    """Four are told with half the interval of one, within a third; biases are free."""
    warmth = np.tile(3 * np.sin(2 * np.pi * T / 1500), (4, 1))
    y = gaussian.sample((White(1.0), RandomWalk(0.05)), rng, (4, len(T)), 0.5)
    y += 0.3 * warmth + 100 * rng.standard_normal((4, 1))
    each = [sensitivity(y[[k]], warmth[[k]], 0.5, CORNERS) for k in range(4)]
    together = sensitivity(y, warmth, 0.5, CORNERS)
    assert together is not None
    assert together.low < 0.3 < together.high
    width = np.mean([one.high - one.low for one in each if one is not None])
    assert (together.high - together.low) / width == pytest.approx(0.5, rel=1 / 3)


def test_a_temperature_that_hardly_changes_tells_nothing(rng):
    y = rng.standard_normal((1, 7200))
    assert sensitivity(y, np.full(y.shape, 20.0), 0.5, CORNERS) is None
    assert sensitivity(y[:, :50], np.arange(50.0)[None], 0.5, CORNERS) is None


def log(rng, path, gaps=False):
    """200 s at 100 Hz, a gyro that follows the temperature by 2 deg/h/K forward and -1 down, with a
    temperature that is printed every second row where it has gaps."""
    rows = spoil("", rng)
    warmth = 25 + 5 * np.sin(2 * np.pi * np.arange(20_000) / 7000)
    for name, size in (("w_x", 2.0), ("w_z", -1.0)):
        rows[name] = rows[name] + size * DEG / HOUR * (warmth - warmth.mean())
    for name in ("w_x", "w_y", "w_z"):
        rows[name] = rows[name] - rows[name].mean() + {"w_x": 0, "w_y": -4e-5, "w_z": -5e-5}[name]
    rows["temp"] = np.where(np.arange(20_000) % 2, np.nan, warmth) if gaps else warmth
    write(path, rows)
    return warmth


def test_a_log_with_a_temperature_is_fitted_without_it(cli, tmp_path, rng):
    log(rng, tmp_path / "log.csv")
    options = ("log=csv", "log.path=log.csv", "log.rate_hz=100", "log.latitude=48", "processes=1",
               "log.gyro_unit=rad/s", "log.temperature_column=temp")  # fmt: skip
    done = cli("lbgc.fit", *options)
    assert done.code == 0, done.err
    assert "temperature: gyro forward: " in done.out
    assert "taken out before the noise is fitted" in done.out
    found = json.loads((tmp_path / done.last_line / "fit.json").read_text())["gyro"]
    for axis, size in ((0, 2.0), (2, -1.0)):
        e = found[axis]["bias_per_k"]
        assert e["low"] < size * DEG / HOUR < e["high"]
        assert found[axis]["courses"] == []
        n = found[axis]["estimates"]["N"]
        assert n["value"] == pytest.approx(1e-6, rel=4.5 / np.sqrt(2 * 20_000))
    sensor = yaml.safe_load((tmp_path / done.last_line / "imu" / "mine.yaml").read_text())
    assert sensor["gyro"]["bias_per_k_deg_per_h_per_k"][0] == pytest.approx(2.0, rel=0.1)
    assert "temperature" not in sensor


def test_temperatures_are_read_beside_the_samples(tmp_path, rng):
    """Rows without one are filled; block means have it too; a column of none is refused."""
    warmth = log(rng, tmp_path / "log.csv", gaps=True)
    config = LogConfig(path=str(tmp_path / "log.csv"), rate_hz=100.0, latitude=48.0,
                       temperature_column="temp")  # fmt: skip
    (record,) = read(config, north=False)
    assert record.temperature is not None
    np.testing.assert_allclose(record.temperature, warmth, atol=0.01)
    slow = block_means(record, 1.0)
    np.testing.assert_allclose(slow.temperature, warmth.reshape(-1, 100).mean(axis=1), atol=0.01)
    with pytest.raises(InputError, match="temperature_column = heat: is no column"):
        list(read(LogConfig(**{**vars(config), "temperature_column": "heat"}), north=False))
