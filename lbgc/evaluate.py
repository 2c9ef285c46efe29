"""Hold estimators against each other on a dataset or on a real log.

python lbgc/evaluate.py data=PATH run=RUN
python lbgc/evaluate.py log=lasergyro
"""

import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from tqdm import tqdm

from lbgc.data import logs
from lbgc.data.record import Record
from lbgc.data.schema import SPLITS
from lbgc.data.store import Dataset
from lbgc.data.windows import cut
from lbgc.earth import heading_exists
from lbgc.errors import InputError, require, require_choice, require_positive, run_main
from lbgc.estimators import CLASSICAL
from lbgc.estimators.estimate import Estimator
from lbgc.learning.estimator import Learned
from lbgc.metrics import heading_errors, summarise
from lbgc.outputs import fingerprint, mark_latest, task_directory, write_atomically
from lbgc.report.page import Result, Subject, table, write_page


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
    """Classical ones."""
    windows_s: list[float] = field(default_factory=lambda: [10.0, 20.0, 30.0, 60.0, 240.0])
    """Window lengths."""
    split: str = "test"
    """Of the dataset."""
    against: str = "truth"
    """truth or reference: what a dataset's errors are taken from. Real logs have a reference."""

    def __post_init__(self) -> None:
        one = (self.data is None) != (self.log is None)
        given = "both" if self.log is not None else "nothing"
        require(one, "data or log", given, "give one: data=PATH, or log=NAME")
        for name in self.estimators:
            require_choice("estimators", name, list(CLASSICAL))
        require_choice("split", self.split, SPLITS)
        require_choice("against", self.against, ("truth", "reference"))
        require(len(self.windows_s) > 0, "windows_s", self.windows_s, "must name a length")
        for window in self.windows_s:
            require_positive("windows_s", window)


def main(config: EvaluateConfig) -> Path:
    """Evaluate, write results.json and report.html, print the table; return the report's path."""
    estimators: dict[str, Estimator] = {name: CLASSICAL[name] for name in config.estimators}
    learned = None if config.run is None else Learned.load(config.run)
    subject, records, count = _subject(config)
    if learned is not None:
        estimators[learned.name] = learned
        subject.notes.append(
            f"{learned.name} was trained on simulated recordings of {learned.sensor}"
        )
    result = _evaluate(config, estimators, subject, records, count)
    identity = fingerprint({**asdict(config), "subject": subject.identity})
    directory = task_directory("evaluate", identity)
    write_atomically(directory / "results.json", json.dumps(_as_json(config, result), indent=2))
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
        subject = Subject(config.log.name, "reference", notes, records[:16], identity="")
        return subject, iter(records), len(records)
    assert config.data is not None
    dataset = Dataset.open_finished(config.data)
    indices = dataset.in_split(config.split)
    require(len(indices) > 0, "split", config.split, "has no recordings in this dataset")
    sample = list(dataset.records(indices[:16]))
    subject = Subject(
        f"{dataset.path}, {config.split} split",
        config.against,
        [],
        sample,
        identity=dataset.identity,
        configuration=dataset.configuration,
        picture=dataset.path.with_suffix(".png"),
    )
    return subject, dataset.records(indices), len(indices)


def _evaluate(
    config: EvaluateConfig,
    estimators: dict[str, Estimator],
    subject: Subject,
    records: Iterator[Record],
    count: int,
) -> Result:
    """Every estimator on every window of every record."""
    errors: dict[tuple[str, float], list[np.ndarray]] = defaultdict(list)
    latitudes: dict[tuple[str, float], list[np.ndarray]] = defaultdict(list)
    longest = 0.0
    for record in tqdm(records, "evaluating", count, unit="rec", leave=False):
        heading = _heading(record, subject.against)
        longest = max(longest, record.duration_s)
        for window_s in config.windows_s:
            windows = cut(record, window_s)
            if len(windows) == 0:
                continue
            for name, estimate in estimators.items():
                wrong = heading_errors(
                    estimate(windows, None).heading, np.full(len(windows), heading)
                )
                errors[name, window_s].append(wrong)
                latitudes[name, window_s].append(windows.latitude)
    shortest = min(config.windows_s)
    if longest < shortest:
        raise InputError(
            "the longest recording",
            f"{longest:g}",
            "s",
            f"is shorter than the shortest window, {shortest:g} s (windows_s)",
        )
    notes = [
        f"windows of {window:g} s are left out: the longest recording has {longest:g} s"
        for window in config.windows_s
        if window > longest
    ]
    rows = {
        key: summarise(np.concatenate(errors[key]), np.concatenate(latitudes[key]))
        for name in estimators
        for key in ((name, window) for window in config.windows_s)
        if key in errors
    }
    sizes = {key: np.abs(np.rad2deg(np.concatenate(errors[key]))) for key in rows}
    return Result(subject, rows, sizes, [*subject.notes, *notes])


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


def _as_json(config: EvaluateConfig, result: Result) -> dict:
    return {
        "subject": result.subject.name,
        "against": result.subject.against,
        "run": config.run,
        "rows": [
            {"estimator": name, "window_s": window, **asdict(summary)}
            for (name, window), summary in result.rows.items()
        ],
        "notes": result.notes,
    }


if __name__ == "__main__":
    run_main(main, EvaluateConfig, "evaluate")
