"""Train the network on a dataset.

python lbgc/train.py data=PATH
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from safetensors.torch import save
from tqdm import tqdm

from lbgc.commands import run_main
from lbgc.data import picture, unit_file
from lbgc.data.compensated import without_mean
from lbgc.data.record import whole_multiple
from lbgc.data.store import Dataset
from lbgc.data.unit_file import CalibratedUnit
from lbgc.data.windows import Labelled, stack
from lbgc.earth import heading_exists
from lbgc.errors import (
    InputError,
    build,
    require,
    require_choice,
    require_not_negative,
    require_positive,
)
from lbgc.frames import AXES, DOWN
from lbgc.learning import board, demand, description
from lbgc.learning.augment import AugmentConfig, check_field
from lbgc.learning.batches import Drawn, Examples, Prepared, Sensed, Source, Stored
from lbgc.learning.description import DESCRIPTION, FORMAT
from lbgc.learning.estimator import SHORTEST_WINDOW_S, WEIGHTS, load_net
from lbgc.learning.labelled import chosen
from lbgc.learning.model import ModelConfig, parameter_count
from lbgc.learning.randomise import RandomiseConfig, Randomised
from lbgc.learning.stream import Streamed
from lbgc.learning.trainer import SCHEDULES, Trainer, TrainingPlan
from lbgc.outputs import fingerprint, mark_latest, task_directory, write_atomically
from lbgc.prospects import prospects
from lbgc.report import history
from lbgc.report.figures import loss_curve, png
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.imu import ImuModel

_MOST_THREADS = 1024
CHECKPOINT = "checkpoint.safetensors"
_CURVE = "loss.png"


@dataclass(frozen=True)
class TrainConfig:
    """The keys of `conf/train.yaml`."""

    data: str | list[str] | None = None
    """The dataset's path, or those of several: of other sensors, latitudes or scenes."""
    labelled: int | None = None
    """Number of labelled recordings to learn from, the first of the training split, of one unit:
    all that its owner has. One in five of them, the last, validates in the validation split's
    place; of fewer than five none can be spared, and all of them validate as well. null: all."""
    stream: bool = False
    """false: train on the stored recordings, augmented. true: draw new ones at every step, by the
    dataset's own sensor model; stored recordings then serve for validation."""
    calibration: str | None = None
    """What is known of the one unit that the network is for, a file that `calibrate` wrote: its
    means are taken off the recordings, which are the unit's own, or simulated from this file."""
    mean_s: float = 5.0
    """Length of the means that the model works on."""
    windows_s: list[float] = field(default_factory=lambda: [10.0, 20.0, 30.0, 60.0, 240.0])
    """Lengths of the training windows, one drawn for each step."""
    steps: int = 2000
    """Largest number of optimiser steps."""
    batch: int = 100
    """Number of windows in each step."""
    echo: int = 1
    """Number of steps in a row that take the same batch (data echoing). As many as take the time in
    which a batch is drawn keep training from waiting for it."""
    learning_rate: float = 0.004
    """Largest learning rate of Adam."""
    schedule: str = "onecycle"
    """onecycle: up within a tenth of the steps, then down. cosine: down from the start."""
    clip: float = 1.0
    """Largest norm of the gradient."""
    validate_every: int = 50
    """Steps between looks at the validation split; the best weights of all looks are kept."""
    patience: int | None = None
    """Number of looks without a better one after which training ends early; null: never."""
    checkpoint_every: int = 500
    """Steps between checkpoints, from which a killed training can go on."""
    threads: int | None = None
    """Threads of the network's arithmetic; null: one, or more for networks large enough to gain by
    them. Weights depend on it by rounding only."""
    tensorboard: bool = False
    """Metrics for TensorBoard too, in the run's directory."""
    warm_up: int = 0
    """Number of first steps in which a network that states a sigma learns headings alone: without a
    base it may otherwise learn no more than to state that it knows nothing."""
    tempering: int = 16_000
    """Number of windows of each length, drawn afresh (stream: true), by which a stated sigma is
    calibrated at the end: n of them determine it to 1/sqrt(2 n), 16000 to 0.6%."""
    seed: int = 1
    """Seed of the network's first weights and the order of windows."""
    model: ModelConfig = field(default_factory=ModelConfig)
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    randomise: RandomiseConfig = field(default_factory=RandomiseConfig)

    def __post_init__(self) -> None:
        require(bool(self.data), "data", self.data, "must be a dataset's path")
        for name in ("mean_s", "steps", "batch", "echo", "learning_rate", "clip", "validate_every",
                     "checkpoint_every", "tempering", "patience", "threads",
                     "labelled"):  # fmt: skip
            require_positive(name, getattr(self, name))
        many = self.threads is not None and self.threads > _MOST_THREADS
        require(not many, "threads", self.threads, f"must be {_MOST_THREADS} at most")
        require_choice("schedule", self.schedule, SCHEDULES)
        require_not_negative(self, "seed", "warm_up")
        one = len(self.paths) == 1
        require(one or not self.stream, "stream", True, "draws by one dataset's sensor; give one")
        few = self.labelled is not None
        about = "has more than a number of labelled recordings tells: give one dataset of one unit"
        require(one or not few, "data", self.data, about)
        about = "draws by what the dataset knows of its unit, and so more than labelled recordings "
        require(not (few and self.stream), "stream", True, about + "tell; use stream=false")
        still = not (self.model.sways and (self.stream or self.randomise.is_on))
        about = "takes what is stored: no stream, no randomise; give several datasets"
        require(still, "model", self.model.name, about)
        require(len(self.windows_s) > 0, "windows_s", self.windows_s, "must name a length")
        for window in self.windows_s:
            require(
                window >= SHORTEST_WINDOW_S and self.window_steps(window) is not None,
                "windows_s",
                window,
                f"must be {SHORTEST_WINDOW_S:g} s or more, in whole means of {self.mean_s:g} s",
            )

    @property
    def paths(self) -> list[str]:
        """Paths of the datasets."""
        return [self.data] if isinstance(self.data, str) else list(self.data or [])

    def window_steps(self, window_s: float) -> int | None:
        """Number of the model's means in a window; None where it is not whole."""
        return whole_multiple(window_s, self.mean_s)

    def content(self) -> dict:
        """The part of the configuration on which the trained weights depend."""
        content = asdict(self)
        del content["checkpoint_every"], content["tensorboard"], content["threads"]
        del content["calibration"]  # what it says counts, and not where it lies
        if self.labelled is None:  # as the content was before there was a choice
            del content["labelled"]
        return content

    def plan(self, longest_s: float, reference_error_deg: float) -> TrainingPlan:
        """The settings of a training on recordings of this length, s. Longer windows are left out.
        reference_error_deg : 1 sigma of the reference's error."""
        usable = [w for w in self.windows_s if w <= longest_s + 1e-9]
        require(
            bool(usable), "windows_s", self.windows_s, f"none fits recordings of {longest_s:g} s"
        )
        for window in sorted(set(self.windows_s) - set(usable)):
            print(f"windows of {window:g} s are left out: the recordings last {longest_s:g} s")
        names = ("model", "steps", "batch", "echo", "learning_rate", "schedule", "clip",
                 "validate_every", "patience", "checkpoint_every", "seed", "warm_up",
                 "tempering", "threads")  # fmt: skip
        lengths = {w: self.window_steps(w) or 1 for w in usable}
        return TrainingPlan(
            windows_steps=lengths,
            reference_sigma=float(np.deg2rad(reference_error_deg)),
            **{name: getattr(self, name) for name in names},
        )


def main(config: TrainConfig) -> Path:
    """Train, keep the best weights by the validation split, and return the run's directory.

    A training that was interrupted goes on, and ends with the weights it would have had.
    """
    datasets = [Dataset.open_finished(path) for path in config.paths]
    content = {**config.content(), "data": _identity(datasets), "format": FORMAT}
    unit = _unit(config, datasets)
    if unit is not None:
        content["calibration"] = unit.checksum
    run = task_directory("train", fingerprint(content))
    if (run / DESCRIPTION).exists() and _is_whole(run):
        print("this run is already finished")
        mark_latest(run)
        return run
    _check_demand(config, datasets)
    trainer = trainer_of(config, datasets, unit)
    if not config.model.sways:
        told = None if unit is None else unit.told(_law(datasets[0]))
        said = prospects(datasets[0].configuration, max(trainer.plan.windows_steps), told)
        if said is not None:
            print(said, flush=True)

    def on_look(looks: Sequence[dict[str, float]]) -> None:
        """Write the history after each look at the validation split."""
        write_atomically(run / history.FILE, history.compose(looks))
        if config.tensorboard:
            board.write(run / "tensorboard", looks[-1])

    trainer.run(run / CHECKPOINT, on_look)
    _save(run, config, datasets, trainer, unit)
    (run / CHECKPOINT).unlink(missing_ok=True)
    mark_latest(run)
    return run


def _check_demand(config: TrainConfig, datasets: Sequence[Dataset]) -> None:
    """Raise InputError where a training on these datasets takes more than this machine has."""
    rates = [d.rate_hz if config.model.sways else 1 / config.mean_s for d in datasets]
    lengths = [d.layout.samples / d.rate_hz for d in datasets]
    means = sum(len(d) * s * r for d, s, r in zip(datasets, lengths, rates, strict=True))
    longest = max(config.windows_s) if min(lengths) > max(config.windows_s) else min(lengths)
    steps = 1 if config.model.sways else max(1, round(longest / config.mean_s))
    demand.check(config.model, config.batch, config.tempering, steps, config.steps, round(means))


def trainer_of(
    config: TrainConfig, datasets: Sequence[Dataset], unit: CalibratedUnit | None = None
) -> Trainer:
    """A training on these datasets that has not begun. unit : what is known of theirs."""
    train, validation = (_load(datasets, split, config, unit) for split in ("train", "validation"))
    law = _law(datasets[0])
    imu = law if unit is None else unit.told(law)
    sensed = Sensed(config.model, 1 / config.mean_s, imu)
    plan = config.plan(train.windows.duration_s, _reference_error_deg(datasets))
    source: Examples
    if config.model.sways:
        source = Prepared.of(sensed, train, plan.windows_steps.values())
    else:
        units = _units(datasets, config.labelled)
        if not config.stream:
            check_field(config.augment, imu)
        windows: Source = Stored(train, units, config.augment, imu.gyro)
        if config.stream:
            windows = Streamed.of(datasets[0], datasets[0].in_split("train"), train, unit)
        if config.randomise.is_on:
            windows = Randomised(windows, config.randomise, imu)
        source = Drawn(windows, sensed)
    return Trainer(plan, source, sensed, train, validation)


def _unit(config: TrainConfig, datasets: Sequence[Dataset]) -> CalibratedUnit | None:
    """What is known of the unit that a network is for. Raises InputError where the datasets are of
    another sensor, of several units, or of another power-up than is known."""
    if config.calibration is None:
        return None
    for path, dataset in zip(config.paths, datasets, strict=True):
        unit = unit_file.load(config.calibration, build(ImuConfig, dataset.configuration["imu"]))
        for split in ("train", "validation"):
            unit_file.require_of_dataset(unit, path, split)
    return unit


def _law(dataset: Dataset) -> ImuModel:
    """The model of a dataset's sensor."""
    said = dataset.configuration
    return build(ImuConfig, said["imu"]).model(float(said["rate_hz"]))


def _identity(datasets: Sequence[Dataset]) -> str | list[str]:
    """The dataset's identity, or those of several."""
    identities = [dataset.identity for dataset in datasets]
    return identities[0] if len(identities) == 1 else identities


def _is_whole(run: Path) -> bool:
    """Whether a run's model and history are as they were written; if not, it is said that it is
    trained again. A damaged picture of its history is drawn again."""
    try:
        _, said = load_net(run)
        looks = history.read(run / history.FILE, said.get("history"))
    except InputError as error:
        print(f"{error}: training it again")
        return False
    if picture.read(run / _CURVE) is None:
        _draw(run, looks)
    return True


def _draw(run: Path, looks: Sequence[Mapping[str, float]]) -> None:
    """Write the picture of a run's history."""
    write_atomically(run / _CURVE, png(loss_curve(looks), dpi=150))


def _load(
    datasets: Sequence[Dataset], split: str, config: TrainConfig, unit: CalibratedUnit | None
) -> Labelled:
    """A split's whole recordings at the model's rate, or at the dataset's own where the model takes
    samples, with the means of what is known of the unit taken off."""
    parts: list[Labelled] = []
    for path, dataset in zip(config.paths, datasets, strict=True):
        indices = chosen(dataset, split, config.labelled)
        require(len(indices) > 0, "data", path, f"has no recordings in its {split} split")
        read = dataset.records(indices)
        if unit is not None:
            read = map(partial(without_mean, imu=_law(dataset), known=unit.known), read)
        records = tqdm(read, f"reading {split}", len(indices), leave=False, unit="rec")
        rate = dataset.rate_hz if config.model.sways else 1 / config.mean_s
        parts.append(stack(records, rate))
        own, first = parts[-1].windows, parts[0].windows
        alike = (own.rate_hz, own.duration_s) == (first.rate_hz, first.duration_s)
        require(alike, "data", path, "differs from the first one in rate or duration")
    recordings = Labelled.joined(parts)
    axis = recordings.windows.axis
    about = f"has plates that turn about {AXES[axis]}: networks are trained on those about down"
    require(axis == DOWN, "data", config.data, about)
    require(
        bool(heading_exists(recordings.windows.latitude).all()),
        "data",
        config.data,
        "was generated at a pole, where heading does not exist: there is nothing to learn",
    )
    return recordings


def _units(datasets: Sequence[Dataset], labelled: int | None) -> np.ndarray:
    """The number of each training recording's unit, counted through all datasets."""
    units: list[np.ndarray] = []
    for dataset in datasets:
        before = 1 + max((int(part.max()) for part in units), default=-1)
        units.append(before + dataset.label("unit")[chosen(dataset, "train", labelled)])
    return np.concatenate(units)


def _reference_error_deg(datasets: Sequence[Dataset]) -> float:
    """1 sigma of the reference's error. Raises InputError where datasets differ in it."""
    errors = [float(d.configuration["scene"]["reference_error_deg"]) for d in datasets]
    same = len(set(errors)) == 1
    require(same, "data", errors, "differ in scene.reference_error_deg: a sigma needs one")
    return errors[0]


def _save(
    run: Path,
    config: TrainConfig,
    datasets: Sequence[Dataset],
    trainer: Trainer,
    unit: CalibratedUnit | None,
) -> None:
    """Write all files of a run, the description last, since it marks the run as finished."""
    _draw(run, trainer.history)
    looks = history.compose(trainer.history)
    write_atomically(run / history.FILE, looks)
    weights = {k: v.cpu().contiguous() for k, v in trainer.best.items()}
    stored = save(weights)
    write_atomically(run / WEIGHTS, stored)
    kept = min(trainer.history, key=lambda row: row["score"])
    of_data = datasets[0].configuration
    latitudes = [float(dataset.configuration["latitude"]) for dataset in datasets]
    said = {
        "model": asdict(config.model),
        "rate_hz": 1 / config.mean_s,
        "sensor": of_data["imu"]["name"],
        "parameters": parameter_count(trainer.net),
        "best_validation_deg": kept["all"],
        "steps": trainer.step,
        "training": asdict(config),
        "dataset": _identity(datasets),
        "protocol": of_data["protocol"]["name"],
        "latitude_deg": config.randomise.latitude or [min(latitudes), max(latitudes)],
        "imu_rate_hz": of_data["rate_hz"],
        "units": {k: of_data[k] for k in ("unit_seed", "units", "imu")},
        "seconds": round(trainer.seconds, 1),
        "history": history.checksum(looks),
    }
    if unit is not None:
        said["calibration"] = unit.content
    write_atomically(run / DESCRIPTION, description.compose(said, stored))


def validation_error(run: Path) -> float:
    """A run's best validation RMSE, degrees, which an optimising sweeper minimises."""
    return float(description.read(run)["best_validation_deg"])


if __name__ == "__main__":
    import lbgc.learning.comparison
    import lbgc.train  # a launcher's processes can import this module by name, not as __main__

    run_main(
        lbgc.train.main,
        lbgc.train.TrainConfig,
        "train",
        score=lbgc.train.validation_error,
        summary=lbgc.learning.comparison.show,
    )
