"""Evaluate estimators against each other on a dataset or on a real log.

python lbgc/evaluate.py data=PATH run=RUN
python lbgc/evaluate.py log=lasergyro
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from lbgc import tumbling
from lbgc.answers import Evaluation, Own, one_thread
from lbgc.commands import run_main
from lbgc.data import unit_file
from lbgc.data.looking.auto import AnyLog
from lbgc.data.schema import SPLITS
from lbgc.data.windows import cut, joined, length_note
from lbgc.errors import InputError, build, require, require_choice, require_positive
from lbgc.estimators import CLASSICAL, FROM_POSES, coarse, static
from lbgc.estimators.estimate import Estimator
from lbgc.estimators.floor import floor
from lbgc.outcome import document_of, doubts, outcome_of
from lbgc.outputs import as_json, fingerprint, mark_latest, task_directory, write_atomically
from lbgc.report.page import Result, Subject, table, write_page
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.dither import warnings
from lbgc.sensor.errors import LIFETIMES
from lbgc.sensor.imu import ImuModel
from lbgc.subjects import (
    Measured,
    batches,
    heading_of,
    of_dataset,
    of_log,
    of_unit,
    require_of_unit,
)
from lbgc.tumbling import TumbleConfig
from lbgc.verdict import Verdict, reached

if TYPE_CHECKING:
    from lbgc.learning.trained import Setting, Trained

KNOWN: dict[str, Estimator] = {**CLASSICAL, "floor": floor}
"""Estimators by name. The floor is not one that a user can have: it is told the sensor's law."""


@dataclass(frozen=True)
class EvaluateConfig:
    """The keys of `conf/evaluate.yaml`."""

    data: str | None = None
    """A dataset's path; or give a log."""
    log: AnyLog | None = None
    """A real log."""
    run: str | None = None
    """A training run's directory, to evaluate its model too."""
    untrained: bool = False
    """Whether models also answer what they were not trained for; the table then says so."""
    estimators: list[str] = field(default_factory=lambda: ["mean"])
    """Names of classical estimators, and the floor."""
    estimator: str | None = None
    """One estimator, or all; instead of the list. Of an IMU that is held in several attitudes:
    tumble."""
    tumble: TumbleConfig = field(default_factory=TumbleConfig)
    """What is asked of estimator=tumble."""
    windows_s: list[float] = field(default_factory=lambda: [10.0, 20.0, 30.0, 60.0, 240.0])
    """Window lengths."""
    imu: ImuConfig | None = None
    """The sensor that estimators are told. A log's sensor is known by this alone; where it is null,
    a dataset's own is used."""
    calibration: str | None = None
    """What is known of the unit, a file that `calibrate` wrote: estimators are told it in place of
    the sensor's law, and its means are taken off the recordings."""
    split: str = "test"
    """Split of the dataset that is evaluated on."""
    known: list[str] = field(default_factory=list)
    """Lifetimes (unit, session, run) whose drawn errors a second floor is told, which shows what
    knowing them would be worth. Datasets only."""
    against: str = "truth"
    """truth or reference: what a dataset's errors are relative to. Real logs have a reference."""
    reach_deg: list[float] = field(default_factory=lambda: [5.0, 2.0, 1.0, 0.5, 0.1])
    """Errors for which the table of times states the window length that they take."""

    def __post_init__(self) -> None:
        one = (self.data is None) != (self.log is None)
        given = "both" if self.log is not None else "nothing"
        require(one, "data or log", given, "give one: data=PATH, or log=NAME")
        for name in self.estimators:
            require_choice("estimators", name, list(KNOWN))
        if self.estimator is not None:
            require_choice("estimator", self.estimator, ("all", *KNOWN, *FROM_POSES))
        for error in self.reach_deg:
            require_positive("reach_deg", error)
        for name in self.known:
            require_choice("known", name, LIFETIMES)
        require(
            not self.known or self.data is not None,
            "known",
            self.known,
            "what a real log's sensor drew is not known; it is for datasets",
        )
        about = "and calibration are two things that are known of the unit: give one"
        require(not (self.known and self.calibration), "known", self.known, about)
        require(
            self.calibration is None or self.data is not None or self.imu is not None,
            "imu",
            None,
            "must be given with calibration: whose unit it is",
        )
        require_choice("split", self.split, SPLITS)
        require_choice("against", self.against, ("truth", "reference"))
        require(len(self.windows_s) > 0, "windows_s", self.windows_s, "must name a length")
        for window in self.windows_s:
            require_positive("windows_s", window)
        about = f"is for windows, and estimator={self.estimator} answers poses"
        for key in ("run", "known"):
            given = getattr(self, key)
            require(not (self.from_poses and given), key, given, about)

    @property
    def from_poses(self) -> bool:
        """Whether the estimator answers poses, and no windows."""
        return self.estimator in FROM_POSES

    @property
    def asked(self) -> list[str]:
        """Names of the estimators to evaluate."""
        if self.estimator is None:
            return self.estimators
        return list(KNOWN) if self.estimator == "all" else [self.estimator]


def main(config: EvaluateConfig) -> Path:
    """Evaluate, print the table, write the results, and return the report's path."""
    if config.from_poses:
        return _tumbled(config)
    estimators: dict[str, Estimator] = {name: KNOWN[name] for name in config.asked}
    if config.run is not None:
        from lbgc.learning.trained import Trained  # imports PyTorch, which takes a second

        learned = Trained.load(config.run)
    subject, records, count = _subject_of(config)
    models: list[Trained] = []
    if config.run is not None:
        subject.notes.append(
            f"{learned.name} was trained on simulated recordings of {learned.learned.sensor}"
        )
        models = [learned]
    elif config.log is not None:
        models = _pretrained(config.imu, subject.notes)
    models = [model.asked(_setting(config, subject), config.untrained) for model in models]
    for model in models:
        free = model.name not in estimators
        require(free, "model.name", model.name, "is another estimator's name here")
        estimators[model.name] = model
    found, said = _verdict(config, subject)
    with one_thread():
        result, evaluation = _evaluate(config, estimators, subject, records, count, said)
    notes = [f"{m.name} answers all the same: {why}" for m in models for why in m.overridden]
    notes += doubts(result) if config.log is not None else []
    result = replace(
        result, learned=tuple(model.name for model in models), notes=[*result.notes, *notes]
    )
    document = document_of(config.run, result, evaluation, found)
    of_run = learned.said if config.run is not None else None
    return _written(config, result, evaluation, document, of_run)


def _tumbled(config: EvaluateConfig) -> Path:
    """Evaluate an estimator of poses, print the table, write the results, and return the report's
    path."""
    assert config.estimator is not None
    subject, records, count = _subject_of(config)
    with one_thread():
        ask = config.tumble, config.estimator, FROM_POSES[config.estimator]
        found = tumbling.asked(*ask, subject, records, count)
    notes = [*subject.notes, *found.notes, *found.evaluation.why_not()]
    notes += [*tumbling.ways(found.each), *tumbling.latitudes(found.each)]
    evaluation = found.evaluation
    result = outcome_of(subject, evaluation, list(evaluation.answers), notes, config.reach_deg)
    document = {**document_of(None, result, evaluation), "tumbles": found.each}
    return _written(config, result, evaluation, document)


def _written(
    config: EvaluateConfig,
    result: Result,
    evaluation: Evaluation,
    document: dict,
    of_run: Mapping | None = None,
) -> Path:
    """Print the results and write them; return the report's path. of_run : what its training says
    of the run, where there is one."""
    identity = fingerprint({**asdict(config), "subject": result.subject.identity})
    directory = task_directory("evaluate", identity)
    write_atomically(directory / "results.json", as_json(document))
    write_atomically(directory / "windows.csv", evaluation.as_csv())
    for line in (*result.notes, *result.verdicts):
        print(line)
    print(table(result))
    page = write_page(directory / "report.html", result, config.run, of_run)
    mark_latest(directory)
    return page


def _subject_of(config: EvaluateConfig) -> tuple[Subject, Iterator[Measured], int]:
    """The description of what is evaluated, its recordings, and their number."""
    if config.log is not None:
        found = of_log(config.log, config.imu, config.from_poses)
    else:
        assert config.data is not None
        found = of_dataset(config.data, config.split, config.against, config.known, config.imu)
    if config.calibration is None:
        if (found[0].configuration or {}).get("calibration") is not None:
            found[0].notes.append(
                "its units were drawn from what a calibration tells of one; estimators are told "
                "the sensor's law alone, unless they are given it too (calibration=FILE)"
            )
        return found
    sensor = config.imu or build(ImuConfig, (found[0].configuration or {})["imu"])
    unit, said = unit_file.load(config.calibration, sensor), config.data or config.log
    assert said is not None
    require_of_unit(unit, said, config.split)
    return of_unit(*found, unit)


def _verdict(config: EvaluateConfig, subject: Subject) -> tuple[list[Verdict], list[str]]:
    """The verdicts whether this sensor, these recordings and windows can find north, and the
    sentences that say so. The sensor's stated model is doubted wherever it is not the one by which
    the recordings were simulated."""
    doubted = config.log is not None or config.imu is not None
    records = list(subject.records() if doubted else islice(subject.records(), 1))
    return reached(
        subject.name,
        subject.sensor,
        subject.imu,
        records,
        config.windows_s,
        doubted,
        _bias_sigma(config),
    )


def _bias_sigma(config: EvaluateConfig) -> float | None:
    """1 sigma of each gyro's bias, rad/s, by the user's limit on it, as of a uniform distribution
    within that limit; None where there is no limit, or the sensor is named."""
    limit = None if config.log is None or config.imu is not None else config.log.bias_limit
    return None if limit is None else limit / 3**0.5


def _setting(config: EvaluateConfig, subject: Subject) -> "Setting":
    """What is known, beside the windows, of the recordings that a network is asked about."""
    from lbgc.learning.trained import Setting

    said = subject.configuration
    if said is None:
        records = list(subject.records())
        return Setting(config.imu, records=records, calibration=subject.calibration)
    units, own = (int(said["unit_seed"]), int(said["units"])), build(ImuConfig, said["imu"])
    protocol = said["protocol"]["name"]
    return Setting(own, protocol, units, calibration=subject.calibration)


def _pretrained(imu: ImuConfig | None, notes: list[str]) -> "list[Trained]":
    """The models of this sensor that come with the package; a note where there is none."""
    from lbgc.learning import pretrained  # imports PyTorch

    every = list(pretrained.every())
    own = [model for model in every if model.sensor == imu]
    if every and not own:
        known = ", ".join(dict.fromkeys(model.sensor.name for model in every))
        whose = "an unknown sensor (say imu=NAME)" if imu is None else imu.name
        notes.append(f"no pretrained model is of {whose}; there are some of {known}")
    notes += [f"{model.name}: meant for {model.meant_for}" for model in own]
    return own


@dataclass(frozen=True)
class _Contender:
    """An estimator with the model and the recordings that it is given."""

    estimate: Estimator
    imu: ImuModel | None
    """The sensor's model that it is told."""
    calibrated: bool = False
    """Whether it is given the recordings from which known errors are taken out."""


def _contenders(
    config: EvaluateConfig, estimators: Mapping[str, Estimator], imu: ImuModel | None
) -> dict[str, _Contender]:
    """The estimators, with what each is told, by name; a second floor is added where errors are
    known."""
    found = {name: _Contender(estimate, imu) for name, estimate in estimators.items()}
    bias_sigma = _bias_sigma(config)
    if bias_sigma is not None:
        for name in found.keys() & {"mean", "triad"}:
            own = partial(getattr(static, name), bias_sigma=bias_sigma)
            found[name] = _Contender(own, imu)
    if config.known:
        assert imu is not None
        name = f"floor, {' and '.join(config.known)} known"
        found[name] = _Contender(floor, imu.without(*config.known), calibrated=True)
    return found


def _evaluate(
    config: EvaluateConfig,
    estimators: dict[str, Estimator],
    subject: Subject,
    records: Iterator[Measured],
    count: int,
    verdicts: Sequence[str],
) -> tuple[Result, Evaluation]:
    """Evaluate every estimator on every window of every recording."""
    evaluation = Evaluation()
    contenders = _contenders(config, estimators, subject.imu)
    longest, coarse_means = 0.0, dict[float, str | None]()
    lengths: list[str | None] = []
    bar = tqdm(total=count, desc="evaluating", unit="rec", leave=False)
    for batch in batches(records):
        heading = np.array([heading_of(own.record, subject.against) for own in batch])
        reference = np.array([own.record.reference_sigma or 0.0 for own in batch])
        numbers = np.arange(len(batch)) + len(evaluation.recordings)
        evaluation.recordings += [own.record.name for own in batch]
        longest = max(longest, batch[0].record.duration_s)
        for window_s in config.windows_s:
            each = [cut(own.record, window_s) for own in batch]
            lengths.append(length_note(batch[0].record, window_s))
            sizes = [len(windows) for windows in each]
            if not any(sizes):
                continue
            calibrated = [cut(own.calibrated, window_s) for own in batch if own.calibrated]
            given = joined(each), joined(calibrated) if calibrated else None
            if window_s not in coarse_means:
                sample_s = None if subject.imu is None else subject.imu.dt
                coarse_means[window_s] = coarse.note(given[0], sample_s)
            windows = given[0]
            known = (np.repeat(one, sizes) for one in (heading, numbers, reference))
            true, number, sigma = known
            own = Own(true, number, windows.latitude, windows.start_s, sigma)
            for name, one in contenders.items():
                told = given[one.calibrated]
                assert told is not None
                evaluation.ask((name, window_s), partial(one.estimate, told, one.imu), own)
        bar.update(len(batch))
    bar.close()
    shortest = min(config.windows_s)
    if longest < shortest and not evaluation.answers:
        raise InputError(
            "the longest recording",
            f"{longest:g}",
            "s",
            f"is shorter than the shortest window, {shortest:g} s (windows_s)",
        )
    if not evaluation.answers:
        raise InputError("estimators", list(estimators), "", "; ".join(evaluation.why_not()))
    notes = [
        f"windows of {window:g} s are left out: the longest recording has {longest:g} s"
        for window in config.windows_s
        if window > longest and not any(window == own for _, own in evaluation.answers)
    ]
    notes += dict.fromkeys(note for note in lengths if note)
    if len(evaluation.recordings) == 1:
        notes.append("one recording: intervals are over its windows, as if they were independent")
    keys = [(n, w) for n in contenders for w in config.windows_s if (n, w) in evaluation.answers]
    of_sensor = warnings(subject.imu, shortest)
    notes += [note for note in coarse_means.values() if note is not None]
    notes = [*subject.notes, *of_sensor, *notes, *evaluation.why_not()]
    return outcome_of(subject, evaluation, keys, notes, config.reach_deg, verdicts), evaluation


if __name__ == "__main__":
    run_main(main, EvaluateConfig, "evaluate")
