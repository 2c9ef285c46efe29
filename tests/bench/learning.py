"""Whether training waits for its data, how long an answer takes, and what a GPU adds."""

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import torch
from helpers import composed, default_config
from table import Row, Table
from timing import CASES, seconds
from tqdm import tqdm

import sim.generate
from lbgc.data.store import Dataset
from lbgc.data.windows import Windows
from lbgc.learning import description, onnx
from lbgc.learning.model import make, parameter_count
from lbgc.learning.trainer import Trainer
from lbgc.train import TrainConfig, trainer_of

_STEPS, _ANSWERS = CASES["learning"]["steps"], CASES["learning"]["answers"]
_MODELS: dict[str, list[str]] = CASES["learning"]["models"]
_MOST_WAIT, _WINDOW_S = 5.0, 240.0


def rows(table: Table, home: Path) -> None:
    made = replace(
        default_config(f"recordings={CASES['learning']['recordings']}", "output=means", "mean_s=5"),
        out=str(home / "train.zarr"),
    )
    dataset = Dataset.open_finished(sim.generate.main(made))
    waits = {
        name: _wait(dataset, (*options, f"windows_s=[{_WINDOW_S:g}]"))
        for name, options in _MODELS.items()
    }
    worst = max(waits, key=lambda name: waits[name])
    table.add(
        Row("data_wait_percent", f"training waits for data, % of a step ({worst})", waits[worst],
            f"<={_MOST_WAIT:g}", waits[worst] <= _MOST_WAIT)
    )  # fmt: skip
    for name, value in waits.items():
        table.note(f"data_wait_{name}_percent", value)
    for key, case in CASES["learning"]["latencies"].items():
        for model in _MODELS:
            own = key if model == "bilstm_24" else f"{model}_{key}"
            _latency(
                *(table, dataset, model, case["rate_hz"], case["goal_ms"]),
                f"onnx_latency_{own}_ms",
            )
    _gpu(table, dataset)


def _trainer(dataset: Dataset, *options: str) -> Trainer:
    config = composed(TrainConfig, "train", f"data={dataset.path}", *options)
    return trainer_of(config, [dataset])


def _wait(dataset: Dataset, options: tuple[str, ...]) -> float:
    """Share of a training's time that it waits for batches, %."""
    trainer = _trainer(dataset, *options)
    waited, next_batch = [0.0], trainer.batch

    def timed() -> tuple[torch.Tensor, torch.Tensor]:
        started = time.perf_counter()
        batch = next_batch()
        waited[0] += time.perf_counter() - started
        return batch

    trainer.batch = timed  # type: ignore[method-assign]
    with trainer.drawing_ahead():
        for step in range(_STEPS + 10):
            if step == 10:
                waited[0], started = 0.0, time.perf_counter()
            trainer.step += 1
            trainer._train()
        return 100 * waited[0] / (time.perf_counter() - started)


def _latency(
    table: Table, dataset: Dataset, model: str, rate_hz: float, goal: float, key: str
) -> None:
    """One window through an exported network, features and base included, on one core."""
    config = composed(TrainConfig, "train", f"data={dataset.path}", f"model={model}")
    network = make(config.model, seed=1).eval()
    about = {
        "model": vars(config.model), "rate_hz": rate_hz, "sensor": "bench", "imu_rate_hz": 600.0,
        "units": {"imu": dataset.configuration["imu"], "units": 1, "unit_seed": 1},
        "parameters": parameter_count(network), "best_validation_deg": 1.0, "steps": 1,
        "training": {"windows_s": [_WINDOW_S]}, "dataset": "bench", "protocol": "static",
        "latitude_deg": [32.76, 32.76], "seconds": 1.0,
    }  # fmt: skip
    said = description.parse(description.compose(about, b""), "run", "bench")
    what = f"240 s window at {rate_hz:g} Hz, ONNX, {model}, ms"
    with tempfile.TemporaryDirectory() as home:
        file = Path(home) / "model.onnx"
        onnx.write(network, said, file)
        learned = onnx.load(file, threads=1)
    windows = _window(rate_hz)
    x: list[np.ndarray] = []
    compute = learned.compute

    def keep(features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x.append(features)
        return compute(features)

    learned.compute = keep
    learned(windows)
    learned.compute = compute
    whole = np.median([seconds(lambda: learned(windows))[0] for _ in range(_ANSWERS)]) * 1e3
    alone = np.median([seconds(lambda: compute(x[0]))[0] for _ in range(_ANSWERS)]) * 1e3
    table.add(
        Row(key, what, float(whole), f"<={goal:g}", bool(whole <= goal), float(alone / whole),
            f"the graph alone ({alone:.2f} ms)")
    )  # fmt: skip


def _window(rate_hz: float) -> Windows:
    rng = np.random.default_rng(1)
    n = round(_WINDOW_S * rate_hz)
    gyro = 5e-5 + 1e-6 * rng.standard_normal((1, n, 3))
    accel = np.array([0.01, 0.01, -9.8]) + 1e-4 * rng.standard_normal((1, n, 3))
    return Windows(
        gyro=gyro,
        accel=accel,
        plate_angle=np.zeros((1, n)),
        rate_hz=rate_hz,
        latitude=np.full(1, 0.57),
        start_s=np.zeros(1),
    )


def _gpu(table: Table, dataset: Dataset) -> None:
    """The training step there against here, recordings a second."""
    what = "training on the GPU over the CPU"
    if not torch.cuda.is_available():
        table.absent(what, "no GPU here")
        return
    speeds = {}
    for where in ("cpu", "gpu"):
        with patch.object(torch.cuda, "is_available", lambda: where == "gpu"):  # noqa: B023
            trainer = _trainer(dataset, "model=bilstm_24", "windows_s=[240]")
        with trainer.drawing_ahead():
            for step in tqdm(range(_STEPS), where, leave=False):
                if step == 10:
                    started = time.perf_counter()
                trainer.step += 1
                trainer._train()
        torch.cuda.synchronize()
        speeds[where] = trainer.plan.batch * (_STEPS - 10) / (time.perf_counter() - started)
        table.note(f"training_{where}_recordings_per_s", speeds[where])
    ratio = speeds["gpu"] / speeds["cpu"]
    table.add(Row("training_gpu_over_cpu", what, ratio, "-", True))
