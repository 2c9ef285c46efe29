"""Describe a dataset, finished or not: what it holds, and what of it is damaged or missing.

python lbgc/info.py PATH
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lbgc.commands import run_main
from lbgc.data import manifest, store
from lbgc.data.record import Record
from lbgc.data.schema import SPLITS, VARIABLES
from lbgc.data.store import Dataset
from lbgc.data.verification import State
from lbgc.errors import require, require_positive
from lbgc.outputs import mark_latest, shown, task_directory, write_atomically
from lbgc.report.figures import dataset_overview, png

_SECTOR_DEG = 30


@dataclass(frozen=True)
class InfoConfig:
    """The keys of `conf/info.yaml`."""

    data: str | None = None
    """The dataset's path or URL."""
    lines: int = 5
    """Number of samples to show of the first recording."""

    def __post_init__(self) -> None:
        require(self.data is not None, "data", self.data, "give a dataset's path")
        require_positive("lines", self.lines)


def main(config: InfoConfig) -> Path | None:
    """Print the description; return the picture's path, or None where there is nothing to draw."""
    assert config.data is not None
    place = store.find(config.data)
    damaged = store.damaged_documents(place)
    if damaged:
        print(f"{place}: damaged metadata: {', '.join(damaged)}; {manifest.AGAIN}")
        print("until then its data cannot be told from damage")
        return None
    dataset = Dataset.open(config.data)
    print("\n".join(_whole(dataset)))
    state = dataset.state()
    good = sorted(set(range(dataset.layout.shards)).difference(state.unfinished))
    print("\n".join(_state(state, dataset.layout.shards)))
    if not good:
        return None
    print("\n".join(_drawn(dataset, good)))
    record = next(dataset.records(np.array(dataset.layout.rows(good[0])[:1])))
    print("\n".join(_first_lines(record, config.lines)))
    return _picture(dataset, record, good)


def _whole(dataset: Dataset) -> list[str]:
    """Lines on the dataset as its configuration states it."""
    layout, stored = dataset.layout, dataset.configuration
    imu, protocol = stored.get("imu", {}), stored.get("protocol", {})
    return [
        f"{dataset.place}: dataset {dataset.identity}, schema {layout.schema}",
        f"sensor       {shown(imu.get('name', 'unknown'))}",
        f"protocol     {shown(protocol.get('kind', 'unknown'))}"
        + (f" about {shown(protocol['axis'])}" if "axis" in protocol else ""),
        f"recordings   {layout.recordings} of {layout.samples / layout.rate_hz:g} s: "
        f"{layout.samples} values at {layout.rate_hz:g} Hz",
        f"shards       {layout.shards} of {layout.shard} recordings at most",
    ]


def _state(state: State, shards: int) -> list[str]:
    """Lines on shards that are missing or damaged, and on files that do not belong there."""
    lines = [
        f"{name:13s}{store.some(what)}; {manifest.AGAIN}"
        for name, what in (
            ("missing", state.missing),
            ("damaged", state.damaged),
            ("left over", state.strays),
        )
        if what
    ]
    if lines or state.read == shards:
        return lines or ["state        finished, every file as it was written"]
    known = f"{shards - state.read} of {shards} shards were found whole before, and are unchanged"
    return [f"state        finished; {known} (--verify reads all)"]


def _rows(dataset: Dataset, name: str, good: list[int]) -> np.ndarray:
    """One variable's values for every recording in the whole shards `good`."""
    return np.concatenate([dataset.label(name, dataset.layout.rows(s)) for s in good])


def _drawn(dataset: Dataset, good: list[int]) -> list[str]:
    """Lines on splits, headings, and the range of every label and drawn value that is not always
    zero."""
    split = np.bincount(_rows(dataset, "split", good), minlength=len(SPLITS))
    heading = np.rad2deg(np.mod(_rows(dataset, "heading", good), 2 * np.pi))
    sectors = np.histogram(heading, np.arange(0, 361, _SECTOR_DEG))[0]
    lines = [
        "split        " + ", ".join(f"{n} {c}" for n, c in zip(SPLITS, split, strict=True)),
        f"headings     by {_SECTOR_DEG} deg from north: " + " ".join(map(str, sectors)),
        "",
        f"{'value':24s}{'unit':>16s}{'least':>12s}{'mean':>12s}{'1 sigma':>12s}{'most':>12s}",
    ]
    for name in dataset.layout.variables:
        variable = VARIABLES[name]
        if "time" in variable.dims or variable.flags:
            continue
        values = _rows(dataset, name, good)
        if values.any():
            figures = (values.min(), values.mean(), values.std(), values.max())
            shown = "".join(f"{v:12.4g}" for v in figures)
            lines.append(f"{name:24s}{variable.units:>16s}{shown}")
    return lines


def _first_lines(record: Record, count: int) -> list[str]:
    """Lines with the first `count` samples of a recording."""
    lines = [
        "",
        f"{record.name}: t, s; gyro, deg/h (forward, right, down); force, m/s^2; plate, deg",
    ]
    for i in range(min(count, len(record.gyro))):
        gyro = "".join(f"{v:11.2f}" for v in np.rad2deg(record.gyro[i]) * 3600)
        force = "".join(f"{v:11.5f}" for v in record.accel[i])
        plate = np.rad2deg(record.plate_angle[i])
        lines.append(f"{(i + 1) / record.rate_hz:9.4f}{gyro}{force}{plate:10.4f}")
    return lines


def _picture(dataset: Dataset, record: Record, good: list[int]) -> Path:
    """Draw the headings in the whole shards `good`, and one recording; the picture's path."""
    t = (np.arange(len(record.gyro)) + 1) / record.rate_hz
    headings = _rows(dataset, "heading", good)
    figure = dataset_overview(headings, t, record.gyro, record.accel, record.plate_angle)
    path = task_directory("info", dataset.identity) / "dataset.png"
    write_atomically(path, png(figure))
    mark_latest(path.parent)
    return path


def as_override(arguments: list[str]) -> list[str]:
    """The arguments with a first one that is a path, and no `key=value` or option, written as
    `data='PATH'`."""
    first, *others = arguments or [""]
    if not first or first.startswith("-") or ("=" in first and not Path(first).exists()):
        return arguments
    quoted = first.replace("\\", "\\\\").replace("'", "\\'")
    return [f"data='{quoted}'", *others]


if __name__ == "__main__":
    sys.argv[1:] = as_override(sys.argv[1:])
    run_main(main, InfoConfig, "info")
