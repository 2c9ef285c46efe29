"""The table that compares training runs: size, error with its spread over seeds, latency."""

import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lbgc.errors import InputError
from lbgc.learning import description
from lbgc.learning.description import DESCRIPTION
from lbgc.learning.estimator import compute_torch, load_net
from lbgc.outputs import (
    as_csv,
    as_json,
    fingerprint,
    listed,
    mark_latest,
    task_directory,
    write_atomically,
)

_REPEATS = 20


@dataclass(frozen=True)
class Row:
    """One row of the table: all runs that differ in nothing but their seed."""

    model: str
    dataset: str
    changed: str
    """Keys of the training's configuration that differ between rows, key=value."""
    parameters: int
    seeds: int
    """Number of runs."""
    rmse_deg: float
    """Mean over seeds of the validation RMSE over all window lengths, against the reference."""
    spread_deg: float
    """Standard deviation of that RMSE over seeds; NaN for one."""
    latency_ms: float
    """Median latency of one window of the longest length, on this machine."""


def show(directories: Sequence[Path]) -> None:
    """Print the table of these runs, as at a sweep's end, and write it as CSV."""
    several = {d: description.read(d) for d in directories}
    print(tabulated(list(several.items())))


def tabulated(found: Sequence[tuple[Path, dict[str, Any]]]) -> Path:
    """Print the table of runs and their descriptions, write it as CSV, and return that path."""
    rows = compare(found)
    print(table(rows))
    directory = task_directory("compare", fingerprint({"runs": sorted(str(d) for d, _ in found)}))
    lines = [list(vars(rows[0])), *(list(vars(row).values()) for row in rows)]
    write_atomically(directory / "runs.csv", as_csv(lines))
    mark_latest(directory)
    return directory / "runs.csv"


def runs(directory: Path) -> list[tuple[Path, dict[str, Any]]]:
    """The finished runs in a directory, with their descriptions. A training that has not ended has
    no description and is left out, as is a damaged one. Raises InputError where none is left."""
    files = [f for f in listed(directory, f"*/{DESCRIPTION}") if not f.parent.is_symlink()]
    good = []
    for file in files:
        try:
            good.append((file.parent, description.read(file.parent)))
        except InputError as error:  # the others can still be compared
            print(f"left out: {error}", file=sys.stderr)
    if not good:
        raise InputError("runs", directory, "", "holds no finished training run")
    return good


def compare(found: Sequence[tuple[Path, dict[str, Any]]]) -> list[Row]:
    """The rows of the table of runs and their descriptions, by dataset and error."""
    groups: dict[str, list[tuple[Path, dict[str, Any]]]] = defaultdict(list)
    for run, said in found:
        content = {k: v for k, v in _flat(said["training"]).items() if k not in ("seed", "data")}
        groups[as_json([said["dataset"], content], sort_keys=True)].append((run, said))
    contents = [_flat(own[0][1]["training"]) for own in groups.values()]
    same = {"seed", "data", "model.name"}
    differing = {
        key for c in contents for key in c if any(o.get(key) != c[key] for o in contents)
    } - same
    rows = []
    for own, content in zip(groups.values(), contents, strict=True):
        errors = [said["best_validation_deg"] for _, said in own]
        run, said = own[0]
        changed = " ".join(f"{key}={content[key]}" for key in sorted(differing))
        spread = float(np.std(errors, ddof=1)) if len(errors) > 1 else float("nan")
        rows.append(
            Row(said["model"]["name"], _dataset(said), changed, said["parameters"], len(own),
                float(np.mean(errors)), spread, _latency_ms(run, said))
        )  # fmt: skip
    return sorted(rows, key=lambda row: (row.dataset, row.rmse_deg))


def _dataset(said: dict[str, Any]) -> str:
    """Identity of the dataset that a run was trained on, or those of several, joined by +."""
    own = said["dataset"]
    return own if isinstance(own, str) else "+".join(own)


def _flat(content: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested dictionaries as one, with their keys joined by dots."""
    flat: dict[str, Any] = {}
    for key, value in content.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat


def _latency_ms(run: Path, said: dict[str, Any]) -> float:
    """Median latency, ms, of a run's network on one window of its longest length."""
    net, _ = load_net(run)
    steps = round(max(said["training"]["windows_s"]) * said["rate_hz"])
    x = np.zeros((1, steps, net.config.features), np.float32)
    taken = []
    for _ in range(_REPEATS):
        started = time.perf_counter()
        compute_torch(net, x)
        taken.append(time.perf_counter() - started)
    return float(1e3 * np.median(taken))


def table(rows: list[Row]) -> str:
    """The rows as text, RMSE in degrees and latency in ms."""
    lines = [
        "validation RMSE over all window lengths, degrees; latency of one window, ms",
        f"{'model':16s} {'parameters':>10s} {'seeds':>5s} {'RMSE':>8s} {'spread':>8s} "
        f"{'latency':>8s}  what differs",
    ]
    for r in rows:
        spread = "-" if np.isnan(r.spread_deg) else f"{r.spread_deg:.3f}"
        lines.append(
            f"{r.model:16s} {r.parameters:10d} {r.seeds:5d} {r.rmse_deg:8.3f} {spread:>8s} "
            f"{r.latency_ms:8.2f}  {r.changed}"
        )
    return "\n".join(lines)
