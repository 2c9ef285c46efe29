"""Models that come with the package: used where the sensor is theirs, elsewhere refused."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from helpers import composed, default_config, generate

import lbgc.train
from lbgc.data.windows import stack
from lbgc.errors import InputError
from lbgc.learning import pretrained
from lbgc.train import TrainConfig

SDC500 = default_config().imu


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    """(a directory of one model, its windows): trained for two steps."""
    home = tmp_path_factory.mktemp("pretrained")
    data = generate(home / "d.zarr", protocol=default_config("protocol=static").protocol,
                    recordings=20, duration_s=20.0, output="means", split=[1, 1, 0])  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        options = ("experiment=pretrained", "steps=2", "validate_every=1", "batch=4")
        run = lbgc.train.main(
            composed(TrainConfig, "train", f"data={data.path}", "windows_s=[10,20]", *options)
        )
        shutil.copytree(run, home / "shelf" / "sdc500-static")
    return home / "shelf", stack(data.records(np.arange(20)), 0.2).windows


def test_what_it_was_not_trained_for_is_refused(shelf):
    directory, windows = shelf
    (model,) = pretrained.every(directory)
    assert model.sensor == SDC500
    assert model.meant_for == (
        "SDC500 as measured, protocol static, 10 s to 20 s, latitudes 20 to 60 degrees"
    )
    assert np.isfinite(model(windows).sigma).all()
    turned = windows.plate_angle + np.linspace(0, 1, windows.plate_angle.shape[1])
    for changes, says in (
        ({"latitude": windows.latitude + 0.6}, "= 67.14 deg: is no latitude of its"),
        ({"plate_angle": turned}, "a plate: that turns is none of its"),
        ({"rate_hz": 0.1}, "= 40 s: is no length of its"),
    ):
        with pytest.raises(InputError, match=says):
            model(replace(windows, **changes))


def test_a_log_of_its_sensor_has_a_learned_figure_at_once(cli, shelf, tmp_path, monkeypatch):
    monkeypatch.setattr(pretrained, "DIRECTORY", shelf[0])
    monkeypatch.setattr(pretrained.every, "__defaults__", (shelf[0],))
    rows = np.tile([0.0021, -0.0028, -0.0021, 0.0, 0.0, -1.0], (300, 1))
    rows += np.random.default_rng(1).standard_normal(rows.shape) * ([1e-4] * 3 + [1e-4] * 3)
    np.savetxt(tmp_path / "my.csv", rows, delimiter=",", header="w_x,w_y,w_z,f_x,f_y,f_z",
               comments="")  # fmt: skip
    log = ("log=csv", "log.path=my.csv", "log.heading_deg=50", "log.rate_hz=10", "windows_s=[10]")
    done = cli("lbgc.evaluate", *log, "log.latitude=32.8", "imu=sdc500")
    assert done.code == 0, done.err
    assert "sdc500-static, pretrained: meant for SDC500 as measured" in done.out
    results = json.loads((tmp_path / "outputs/evaluate/latest/results.json").read_text())
    assert "sdc500-static, pretrained" in [row["estimator"] for row in results["rows"]]
    other = cli("lbgc.evaluate", *log, "log.latitude=32.8", "imu=stim300")
    assert "no pretrained model is of STIM300; there are some of SDC500" in other.out
    far = cli("lbgc.evaluate", *log, "log.latitude=32.8", "imu=sdc500", "windows_s=[30]")
    assert far.code == 0
    assert "is no length of its" in far.out


@pytest.mark.parametrize("model", list(pretrained.every()), ids=lambda model: model.name)
def test_those_in_the_package_are_whole_and_small(model):
    directory = pretrained.DIRECTORY / model.name.split(",")[0]
    assert sum(f.stat().st_size for f in directory.iterdir()) < 1e5
    assert model.said["training"]["randomise"]["latitude"] == [20.0, 60.0]
