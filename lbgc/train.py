"""Train the network on a dataset.

python lbgc/train.py data=PATH
"""

import copy
import json
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save
from torch import nn
from tqdm import tqdm

from lbgc.data.record import whole_multiple
from lbgc.data.store import Dataset
from lbgc.data.windows import Windows, stack
from lbgc.earth import heading_exists
from lbgc.errors import build, require, require_not_negative, require_positive, run_main
from lbgc.learning import loss
from lbgc.learning.augment import AugmentConfig, augment
from lbgc.learning.estimator import DESCRIPTION, FORMAT, SHORTEST_WINDOW_S, WEIGHTS
from lbgc.learning.model import HeadingNet, ModelConfig, features, make, parameter_count
from lbgc.outputs import fingerprint, mark_latest, task_directory, write_atomically
from lbgc.report.figures import loss_curve
from lbgc.sensor import streams
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.imu import Triad


@dataclass(frozen=True)
class TrainConfig:
    """What `conf/train.yaml` holds."""

    data: str | None = None
    """The dataset's path."""
    mean_s: float = 5.0
    """The model works on means over this long."""
    windows_s: list[float] = field(default_factory=lambda: [10.0, 20.0, 30.0, 60.0, 240.0])
    """Lengths of the training windows, one drawn for each step."""
    steps: int = 2000
    """Optimiser steps."""
    batch: int = 100
    """Windows a step."""
    learning_rate: float = 0.004
    """Adam's, at its highest (one-cycle schedule)."""
    clip: float = 1.0
    """Largest norm of the gradient."""
    validate_every: int = 50
    """Steps between looks at the validation split; the best of them is kept."""
    seed: int = 1
    """Of the network's first weights and the order of windows."""
    model: ModelConfig = field(default_factory=ModelConfig)
    augment: AugmentConfig = field(default_factory=AugmentConfig)

    def __post_init__(self) -> None:
        require(bool(self.data), "data", self.data, "must be a dataset's path")
        for name in ("mean_s", "steps", "batch", "learning_rate", "clip", "validate_every"):
            require_positive(name, getattr(self, name))
        require_not_negative(self, "seed")
        require(len(self.windows_s) > 0, "windows_s", self.windows_s, "must name a length")
        for window in self.windows_s:
            require(
                window >= SHORTEST_WINDOW_S and self.window_steps(window) is not None,
                "windows_s",
                window,
                f"must be {SHORTEST_WINDOW_S:g} s or more, in whole means of {self.mean_s:g} s",
            )

    def window_steps(self, window_s: float) -> int | None:
        return whole_multiple(window_s, self.mean_s)


def main(config: TrainConfig) -> Path:
    """Train, keep the best checkpoint on the validation split, and return the run's directory."""
    assert config.data is not None
    dataset = Dataset.open_finished(config.data)
    content = {**asdict(config), "data": dataset.identity, "format": FORMAT}
    run = task_directory("train", fingerprint(content))
    if (run / DESCRIPTION).exists():
        print("this run is already finished")
        mark_latest(run)
        return run
    train, validation = (_load(dataset, split, config) for split in ("train", "validation"))
    longest = train.duration_s
    usable = [w for w in config.windows_s if w <= longest + 1e-9]
    require(bool(usable), "windows_s", config.windows_s, f"none fits recordings of {longest:g} s")
    for window in sorted(set(config.windows_s) - set(usable)):
        print(f"windows of {window:g} s are left out: the recordings last {longest:g} s")
    imu = build(ImuConfig, dataset.configuration["imu"])
    trainer = _Trainer(replace(config, windows_s=usable), train, validation, imu.gyro.triad())
    started = time.perf_counter()
    best = trainer.run()
    _save(run, config, dataset, trainer, best, time.perf_counter() - started)
    mark_latest(run)
    return run


def _load(dataset: Dataset, split: str, config: TrainConfig) -> Windows:
    """A split's whole recordings at the model's rate."""
    indices = dataset.in_split(split)
    require(len(indices) > 0, "data", config.data, f"has no recordings in its {split} split")
    records = tqdm(
        dataset.records(indices), f"reading {split}", len(indices), leave=False, unit="rec"
    )
    windows = stack(records, 1 / config.mean_s)
    require(
        bool(heading_exists(windows.latitude).all()),
        "data",
        config.data,
        "was generated at a pole, where heading does not exist: there is nothing to learn",
    )
    return windows


def _crop(windows: Windows, rows: np.ndarray, starts: np.ndarray, steps: int) -> Windows:
    """One window of `steps` samples from each of these rows, from these starts on."""
    at = starts[:, None] + np.arange(steps)
    pick = rows[:, None], at
    return Windows(
        windows.gyro[pick],
        windows.accel[pick],
        windows.plate_angle[pick],
        windows.rate_hz,
        windows.latitude[rows],
        windows.heading[rows],
        windows.heading_reference[rows],
        starts / windows.rate_hz,
    )


class _Trainer:
    """The training loop: a window length, a batch, an augmentation and a step at a time."""

    def __init__(self, config: TrainConfig, train: Windows, validation: Windows, gyro: Triad):
        self.config, self.train, self.gyro = config, train, gyro
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.net = make(config.model, config.seed).to(self.device)
        self.optimiser = torch.optim.Adam(self.net.parameters(), lr=config.learning_rate)
        self.schedule = torch.optim.lr_scheduler.OneCycleLR(
            self.optimiser, config.learning_rate, total_steps=config.steps, pct_start=0.1
        )
        self.validation = [
            (window, *self._tensors(_every(validation, config.window_steps(window) or 1)))
            for window in config.windows_s
        ]
        self.history: list[dict[str, float]] = []

    def run(self) -> dict[str, torch.Tensor]:
        """Train and return the best state by validation error."""
        best_error, best = np.inf, copy.deepcopy(self.net.state_dict())
        bar = tqdm(range(1, self.config.steps + 1), "training", unit="step")
        smoothed = None
        for step in bar:
            value = self._step(step)
            smoothed = value if smoothed is None else 0.98 * smoothed + 0.02 * value
            if step % self.config.validate_every == 0 or step == self.config.steps:
                errors = self._validate()
                error = float(np.sqrt(np.mean(np.square(list(errors.values())))))
                self.history.append({"step": step, "train_loss": smoothed, **errors, "all": error})
                if error < best_error:
                    best_error, best = error, copy.deepcopy(self.net.state_dict())
                bar.set_postfix_str(f"validation {error:.2f} deg, best {best_error:.2f}")
        return best

    def _step(self, step: int) -> float:
        rng = streams.training(self.config.seed, step)
        steps = self.config.window_steps(float(rng.choice(self.config.windows_s))) or 1
        rows = rng.integers(len(self.train), size=self.config.batch)
        latest = self.train.gyro.shape[1] - steps
        windows = _crop(self.train, rows, rng.integers(latest + 1, size=len(rows)), steps)
        windows = augment(self.config.augment, windows, self.gyro, rng)
        x, truth_deg = self._tensors(windows)
        self.net.train()
        value = _loss(self.net, x, truth_deg)
        self.optimiser.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(self.net.parameters(), self.config.clip)
        self.optimiser.step()
        self.schedule.step()
        return float(value.detach())

    def _tensors(self, windows: Windows) -> tuple[torch.Tensor, torch.Tensor]:
        """Input and target; the target is the reference, all that training may know."""
        x = torch.from_numpy(features(self.config.model, windows))
        truth = torch.from_numpy(np.rad2deg(windows.heading_reference).astype(np.float32))
        return x.to(self.device), truth.to(self.device)

    @torch.inference_mode()
    def _validate(self) -> dict[str, float]:
        """RMSE in degrees against the reference, for each window length."""
        self.net.eval()
        return {
            f"validation_{window:g}s_deg": float(
                loss.cyclic_mse(truth, self.net.heading_deg(self.net(x))).sqrt()
            )
            for window, x, truth in self.validation
        }


def _every(windows: Windows, steps: int) -> Windows:
    """All consecutive windows of this many samples of all rows."""
    count = windows.gyro.shape[1] // steps
    rows = np.repeat(np.arange(len(windows)), count)
    return _crop(windows, rows, np.tile(np.arange(count) * steps, len(windows)), steps)


def _loss(net: HeadingNet, x: torch.Tensor, truth_deg: torch.Tensor) -> torch.Tensor:
    raw = net(x)
    if net.config.output == "sincos":
        return loss.vector_mse(truth_deg, raw)
    return loss.cyclic_mse(truth_deg, net.heading_deg(raw))


def _save(
    run: Path,
    config: TrainConfig,
    dataset: Dataset,
    trainer: _Trainer,
    best: dict[str, torch.Tensor],
    seconds: float,
) -> None:
    """Everything of a run; the description last, since it says that the run is whole."""
    history = trainer.history
    lines = [",".join(history[0]), *(",".join(f"{v:.9g}" for v in row.values()) for row in history)]
    write_atomically(run / "history.csv", "\n".join(lines) + "\n")
    loss_curve(history).savefig(run / "loss.png", dpi=150)
    write_atomically(run / WEIGHTS, save({k: v.cpu().contiguous() for k, v in best.items()}))
    description = {
        "format": FORMAT,
        "model": asdict(config.model),
        "rate_hz": 1 / config.mean_s,
        "sensor": dataset.configuration["imu"]["name"],
        "parameters": parameter_count(trainer.net),
        "best_validation_deg": min(row["all"] for row in history),
        "training": asdict(config),
        "dataset": dataset.identity,
        "units": {k: dataset.configuration[k] for k in ("unit_seed", "units", "imu")},
        "seconds": round(seconds, 1),
    }
    write_atomically(run / DESCRIPTION, json.dumps(description, indent=2) + "\n")


if __name__ == "__main__":
    run_main(main, TrainConfig, "train")
