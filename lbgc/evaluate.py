"""Hold estimators against each other on a dataset or on a real log.

python lbgc/evaluate.py data=PATH run=RUN
python lbgc/evaluate.py log=lasergyro
"""

import csv
import io
import json
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from tqdm import tqdm

from lbgc.bound import floor
from lbgc.data import logs
from lbgc.data.record import Record
from lbgc.data.schema import SPLITS
from lbgc.data.store import Dataset
from lbgc.data.windows import Windows, cut
from lbgc.earth import heading_exists
from lbgc.errors import InputError, build, require, require_choice, require_positive, run_main
from lbgc.estimators import CLASSICAL
from lbgc.estimators.estimate import Estimate, Estimator
from lbgc.learning.estimator import Learned
from lbgc.metrics import Summary, heading_errors, summarise, time_to_reach
from lbgc.outputs import fingerprint, mark_latest, task_directory, write_atomically
from lbgc.report.page import Result, Subject, table, write_page
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.imu import ImuModel

KNOWN: dict[str, Estimator] = {**CLASSICAL, "floor": floor}
"""The floor is no estimator that one could have: it is told the sensor's law."""


@dataclass(frozen=True)
class EvaluateConfig:
    """What `conf/evaluate.yaml` holds."""

    data: str | None = None
    """A dataset's path; or give a log."""
    log: logs.LogConfig | None = None
    """A real log."""
    run: str | None = None
    """A training run's directory, to evaluate its model too."""
    estimators: list[str] = field(default_factory=lambda: ["mean"])
    """Classical ones, and the floor."""
    estimator: str | None = None
    """One of them, or all; instead of the list."""
    windows_s: list[float] = field(default_factory=lambda: [10.0, 20.0, 30.0, 60.0, 240.0])
    """Window lengths."""
    imu: ImuConfig | None = None
    """What estimators are told of the sensor: a log has nothing else to say it, and a dataset's own
    is used where this is null."""
    split: str = "test"
    """Of the dataset."""
    against: str = "truth"
    """truth or reference: what a dataset's errors are taken from. Real logs have a reference."""
    reach_deg: list[float] = field(default_factory=lambda: [5.0, 2.0, 1.0, 0.5, 0.1])
    """Errors for which the table of times says how long a window must be."""

    def __post_init__(self) -> None:
        one = (self.data is None) != (self.log is None)
        given = "both" if self.log is not None else "nothing"
        require(one, "data or log", given, "give one: data=PATH, or log=NAME")
        for name in self.estimators:
            require_choice("estimators", name, list(KNOWN))
        if self.estimator is not None:
            require_choice("estimator", self.estimator, ("all", *KNOWN))
        for error in self.reach_deg:
            require_positive("reach_deg", error)
        require_choice("split", self.split, SPLITS)
        require_choice("against", self.against, ("truth", "reference"))
        require(len(self.windows_s) > 0, "windows_s", self.windows_s, "must name a length")
        for window in self.windows_s:
            require_positive("windows_s", window)

    @property
    def asked(self) -> list[str]:
        if self.estimator is None:
            return self.estimators
        return list(KNOWN) if self.estimator == "all" else [self.estimator]


def main(config: EvaluateConfig) -> Path:
    """Evaluate, print the table and write what there is to say; return the report's path."""
    estimators: dict[str, Estimator] = {name: KNOWN[name] for name in config.asked}
    learned = None if config.run is None else Learned.load(config.run)
    subject, records, count = _subject(config)
    if learned is not None:
        estimators[learned.name] = learned
        subject.notes.append(
            f"{learned.name} was trained on simulated recordings of {learned.sensor}"
        )
    result, evaluation = _evaluate(config, estimators, subject, records, count)
    identity = fingerprint({**asdict(config), "subject": subject.identity})
    directory = task_directory("evaluate", identity)
    write_atomically(
        directory / "results.json", json.dumps(_as_json(config, result, evaluation), indent=2)
    )
    write_atomically(directory / "windows.csv", _csv(evaluation))
    for line in result.notes:
        print(line)
    print(table(result))
    page = write_page(directory / "report.html", result, config.run)
    mark_latest(directory)
    return page


def _subject(config: EvaluateConfig) -> tuple[Subject, Iterator[Record], int]:
    """What is evaluated on: its description, its recordings and how many there are."""
    if config.log is not None:
        records = list(logs.read(config.log))
        notes = [f"{config.log.name}: a real log has no truth; errors are from its reference"]
        imu = None if config.imu is None else config.imu.model(records[0].rate_hz)
        subject = Subject(config.log.name, "reference", notes, records[:16], identity="", imu=imu)
        return subject, iter(records), len(records)
    assert config.data is not None
    dataset = Dataset.open_finished(config.data)
    indices = dataset.in_split(config.split)
    require(len(indices) > 0, "split", config.split, "has no recordings in this dataset")
    sample = list(dataset.records(indices[:16]))
    configuration = dataset.configuration
    own = build(ImuConfig, configuration["imu"])
    notes = []
    if config.imu is not None:
        notes.append(f"estimators are told of {config.imu.name}; the data are of {own.name}")
    subject = Subject(
        f"{dataset.path}, {config.split} split",
        config.against,
        notes,
        sample,
        identity=dataset.identity,
        configuration=configuration,
        imu=(config.imu or own).model(float(configuration["rate_hz"])),
        picture=dataset.path.with_suffix(".png"),
    )
    return subject, dataset.records(indices), len(indices)


@dataclass
class _Answers:
    """Of one estimator at one window length, recording by recording."""

    errors: list[np.ndarray] = field(default_factory=list)
    sigma: list[np.ndarray] = field(default_factory=list)
    estimate: list[np.ndarray] = field(default_factory=list)
    latitude: list[np.ndarray] = field(default_factory=list)
    heading: list[np.ndarray] = field(default_factory=list)
    start_s: list[np.ndarray] = field(default_factory=list)
    recording: list[np.ndarray] = field(default_factory=list)
    seconds: float = 0.0

    def add(
        self, estimate: Estimate, windows: Windows, heading: float, recording: int, seconds: float
    ) -> None:
        truth = np.full(len(windows), heading)
        self.errors.append(heading_errors(estimate.heading, truth))
        self.sigma.append(estimate.sigma)
        self.estimate.append(estimate.heading)
        self.latitude.append(windows.latitude)
        self.heading.append(truth)
        self.start_s.append(windows.start_s)
        self.recording.append(np.full(len(windows), recording))
        self.seconds += seconds

    def all_of(self, name: str) -> np.ndarray:
        return np.concatenate(getattr(self, name))

    def summary(self) -> Summary:
        names = ("errors", "latitude", "sigma", "recording")
        errors, latitude, sigma, recording = (self.all_of(name) for name in names)
        return summarise(errors, latitude, sigma, recording, self.seconds)


@dataclass
class _Evaluation:
    """Every estimator's answers, and why one has none."""

    recordings: list[str] = field(default_factory=list)
    """Their names, by number."""
    answers: dict[tuple[str, float], _Answers] = field(default_factory=dict)
    """By estimator and window length."""
    refused: dict[tuple[str, float], str] = field(default_factory=dict)
    """Likewise."""

    def ask(
        self,
        key: tuple[str, float],
        estimate: Estimator,
        windows: Windows,
        imu: ImuModel | None,
        heading: float,
    ) -> None:
        """One that refuses a recording's windows is asked no more at this length: figures over
        some recordings would not compare with figures over all."""
        if key in self.refused:
            return
        started = time.process_time()
        try:
            found = estimate(windows, imu)
        except InputError as error:
            self.refused[key] = str(error)
            self.answers.pop(key, None)
            return
        seconds = time.process_time() - started
        own = self.answers.setdefault(key, _Answers())
        own.add(found, windows, heading, len(self.recordings) - 1, seconds)

    def why_not(self) -> list[str]:
        """A line for each estimator, with its window lengths and the shortest one's reason: the
        others' differ in their figures; results.json has them all."""
        own: dict[str, dict[float, str]] = defaultdict(dict)
        for (name, window), reason in self.refused.items():
            own[name][window] = reason
        return [
            f"{name} is left out at {', '.join(f'{w:g}' for w in sorted(r))} s: {r[min(r)]}"
            for name, r in own.items()
        ]


def _evaluate(
    config: EvaluateConfig,
    estimators: dict[str, Estimator],
    subject: Subject,
    records: Iterator[Record],
    count: int,
) -> tuple[Result, _Evaluation]:
    """Every estimator on every window of every record."""
    evaluation = _Evaluation()
    longest = 0.0
    for record in tqdm(records, "evaluating", count, unit="rec", leave=False):
        heading = _heading(record, subject.against)
        evaluation.recordings.append(record.name)
        longest = max(longest, record.duration_s)
        for window_s in config.windows_s:
            windows = cut(record, window_s)
            if len(windows) == 0:
                continue
            for name, estimate in estimators.items():
                evaluation.ask((name, window_s), estimate, windows, subject.imu, heading)
    shortest = min(config.windows_s)
    if longest < shortest:
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
        if window > longest
    ]
    if len(evaluation.recordings) == 1:
        notes.append("one recording: intervals are over its windows, as if they were independent")
    keys = [(n, w) for n in estimators for w in config.windows_s if (n, w) in evaluation.answers]
    rows = {key: evaluation.answers[key].summary() for key in keys}
    sizes = {key: np.abs(np.rad2deg(evaluation.answers[key].all_of("errors"))) for key in keys}
    notes = [*subject.notes, *notes, *evaluation.why_not()]
    by_heading = {key: _per_heading(evaluation.answers[key]) for key in keys}
    return Result(subject, rows, sizes, notes, _reach(config, rows), by_heading), evaluation


def _reach(
    config: EvaluateConfig, rows: Mapping[tuple[str, float], Summary]
) -> dict[str, dict[float, str]]:
    """Estimator -> error in degrees -> the window length that it takes, in words."""
    found = {}
    for name in dict.fromkeys(name for name, _ in rows):
        own = sorted((w, s.rmse_deg) for (n, w), s in rows.items() if n == name)
        windows, rmse = zip(*own, strict=True)
        found[name] = {e: time_to_reach(windows, rmse, e) for e in config.reach_deg}
    return found


def _per_heading(answers: _Answers) -> list[dict[str, float]]:
    """RMSE by true heading, in sectors of 30 degrees about their middles."""
    sector = np.round(np.rad2deg(answers.all_of("heading")) / 30).astype(int) % 12
    errors = np.rad2deg(answers.all_of("errors"))
    return [
        {
            "heading_deg": 30.0 * s,
            "windows": int(np.sum(sector == s)),
            "rmse_deg": float(np.sqrt(np.mean(errors[sector == s] ** 2))),
        }
        for s in np.unique(sector)
    ]


def _csv(evaluation: _Evaluation) -> str:
    """A line for each window and estimator."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = ("heading_deg", "estimate_deg", "error_deg", "sigma_deg")
    writer.writerow(("recording", "window_s", "start_s", "estimator", *names))
    for (name, window), own in evaluation.answers.items():
        angles = [np.rad2deg(own.all_of(n)) for n in ("heading", "estimate", "errors", "sigma")]
        columns = [own.all_of("recording"), own.all_of("start_s"), *(a.round(6) for a in angles)]
        for number, start, *degrees in zip(*(c.tolist() for c in columns), strict=True):
            recording = evaluation.recordings[number]
            writer.writerow((recording, f"{window:g}", f"{start:g}", name, *degrees))
    return out.getvalue()


def _heading(record: Record, against: str) -> float:
    """What the record's errors are taken from, rad. Raises InputError where it has none."""
    require(
        bool(heading_exists(record.latitude)),
        "latitude",
        round(float(np.rad2deg(record.latitude)), 6),
        f"{record.name} was taken at a pole: Earth's rate has no horizontal part there and heading "
        "does not exist, so there is nothing to evaluate",
    )
    heading = record.heading if against == "truth" else record.heading_reference
    if heading is None:
        raise InputError(
            f"{record.name}'s heading", "(unknown)", "", "give log.heading_deg to have errors"
        )
    return heading


def _as_json(config: EvaluateConfig, result: Result, evaluation: _Evaluation) -> dict:
    return {
        "subject": result.subject.name,
        "against": result.subject.against,
        "run": config.run,
        "rows": [
            {
                "estimator": name,
                "window_s": window,
                **asdict(summary),
                "by_heading": result.by_heading[name, window],
            }
            for (name, window), summary in result.rows.items()
        ],
        "time_to_reach": {
            name: {f"{error:g} deg": said for error, said in by_error.items()}
            for name, by_error in result.reach.items()
        },
        "left_out": [
            {"estimator": name, "window_s": window, "why": why}
            for (name, window), why in evaluation.refused.items()
        ],
        "notes": result.notes,
    }


if __name__ == "__main__":
    run_main(main, EvaluateConfig, "evaluate")
