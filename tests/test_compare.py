"""A sweep's table: runs that differ in their seed alone share a row."""

from dataclasses import asdict

import pytest
from safetensors.torch import save

from lbgc.compare import CompareConfig, main
from lbgc.errors import InputError
from lbgc.learning.comparison import compare, runs
from lbgc.learning.description import compose
from lbgc.learning.model import ModelConfig, make
from lbgc.sensor.datasheet import ImuConfig
from lbgc.train import TrainConfig


def finished(
    home, name: str, seed: int, hidden: int, error: float, dataset: str | list[str] = "one"
) -> None:
    model = ModelConfig(name, hidden=hidden, layers=1)
    said = {
        "model": asdict(model),
        "training": asdict(TrainConfig(data="x", seed=seed, model=model)),
        "dataset": dataset,
        "protocol": "static",
        "latitude_deg": [32.76, 32.76],
        "rate_hz": 0.2,
        "parameters": 1000 * hidden,
        "best_validation_deg": error,
        "sensor": "x",
        "steps": 1,
        "imu_rate_hz": 600.0,
        "units": {"unit_seed": 4, "units": 1, "imu": asdict(ImuConfig())},
        "seconds": 1.0,
    }
    run = home / f"{name}{seed}"
    run.mkdir(parents=True)
    weights = save(make(model, seed).state_dict())
    (run / "model.json").write_bytes(compose(said, weights))
    (run / "model.safetensors").write_bytes(weights)


def test_seeds_share_a_row(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for seed, error in ((1, 2.0), (2, 4.0)):
        finished(tmp_path / "t", "small", seed, 4, error)
    finished(tmp_path / "t", "large", 1, 8, 1.0)
    (tmp_path / "t" / "unfinished").mkdir()
    large, small = compare(runs(tmp_path / "t"))
    assert (large.model, large.seeds, large.changed) == ("large", 1, "model.hidden=8")
    assert (small.seeds, small.rmse_deg) == (2, 3.0)
    assert small.spread_deg == pytest.approx(2**0.5)
    assert small.parameters == 4000
    assert small.latency_ms > 0
    path = main(CompareConfig("t"))
    assert len(path.read_text().splitlines()) == 3
    assert "small" in capsys.readouterr().out


def test_runs_of_one_dataset_and_of_several_share_a_table(tmp_path):
    finished(tmp_path, "one", 1, 4, 2.0)
    finished(tmp_path, "several", 1, 4, 1.0, ["one", "other"])
    assert {row.dataset for row in compare(runs(tmp_path))} == {"one", "one+other"}


def test_no_runs_are_an_error(tmp_path):
    with pytest.raises(InputError, match="holds no finished training run"):
        runs(tmp_path)
