"""Part of `make study-unit-learners` and `make study-unit`: what networks learn of a unit, as
points on the curves of floor(k) against k."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from common import Report
from matplotlib.figure import Figure

from lbgc.outputs import write_atomically
from lbgc.report.figures import png

RESULTS = Path("outputs/studies/unit_learners/results.json")
KEYS = (
    "context_over_floor_k_max",
    "context_over_floor_k_max_upper",
    "published_over_floor_56",
    "published_units",
    "context_over_linear_nongaussian_upper",
)
"""What study-unit takes over into its own summary."""
_MARKS = {"in context": "o", "residual": "s", "tuned": "^", "published": "X"}
_NAMES = {
    "in context": "in context, trained once on other units",
    "residual": "ours, trained on the k",
    "tuned": "ours, trained on other units, tuned on the k",
    "published": "published, trained on the k",
}
Lines = Mapping[float, Sequence[tuple[int, float]]]
"""floor(k), deg, by the share of the variance that repeats."""


def left() -> dict[str, Any] | None:
    """What make study-unit-learners left; None where it has not been run."""
    return json.loads(RESULTS.read_text()) if RESULTS.exists() else None


def shown(study: Report, lines: Lines) -> None:
    """The learners in another study's table, summary and picture, with their date."""
    said = left()
    study.line()
    if said is None:
        study.line("no learners: make study-unit-learners has not been run")
        return
    study.line(f"learners, as make study-unit-learners left them on {said['date']}; over floor(k)")
    for row in said["learners"]:
        value, low, high = row["over_floor"]
        study.line(
            f"{row['learner']:12s}{row['labelled']:4d}, {row['units']:3d} units: "
            f"{row['rmse_deg']:.3f} deg, {value:.3f} ({low:.3f} to {high:.3f})"
        )
    study.summary |= {key: said["summary"][key] for key in KEYS}
    study.summary["learners_date"] = said["date"]
    picture(study, lines, said["learners"], said["share"])


def picture(
    study: Report, lines: Lines, learners: Sequence[Mapping[str, Any]], share: float
) -> None:
    """learners.png. A learner's point is the line's value times its ratio to floor(k) on the same
    windows: its few units' own luck is not in it."""
    figure = Figure(figsize=(8, 5.5), layout="constrained")
    axes = figure.subplots()
    for number, (own, points) in enumerate(lines.items()):
        k, degrees = zip(*points, strict=True)
        label = f"floor(k), {own:.0%} of the variance repeats"
        axes.plot(k, degrees, "-", color=f"C{number}", label=label)
    k, degrees = zip(*lines[share], strict=True)
    for n, who in enumerate(_MARKS):
        rows = [row for row in learners if row["learner"] == who]
        if not rows:
            continue
        at = np.array([row["labelled"] for row in rows])
        value, low, high = np.array([row["over_floor"] for row in rows]).T
        line = np.interp(np.log1p(at), np.log1p(k), degrees)
        units = sorted({row["units"] for row in rows})
        axes.errorbar(
            at * (1 + 0.03 * (n - 1)), line * value, line * np.array([value - low, high - value]),
            fmt=_MARKS[who], color="k", markerfacecolor="none" if who != "in context" else "k",
            markersize=6, capsize=2, linewidth=0.8,
            label=f"{_NAMES[who]} ({'/'.join(map(str, units))} units)",
        )  # fmt: skip
    axes.set_xscale("symlog", linthresh=1)
    axes.set_yscale("log")
    ticks = [1, 2, 3, 5, 10, 20, 50, 100]
    axes.set_yticks(ticks, [f"{tick}" for tick in ticks])
    axes.set_ylim(0.8, axes.dataLim.y1 * 1.5)
    marks = [0, 1, 3, 10, 30, 56, 80]
    axes.set_xticks(marks, [f"{mark}" for mark in marks])
    axes.set_xlim(-0.1, 120)
    axes.minorticks_off()
    axes.set_xlabel("labelled recordings k, 240 s at rest each")
    axes.set_ylabel("RMSE of one more heading, deg")
    axes.set_title(f"Networks where {share:.0%} of the variance repeats, told", fontsize=10)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)
    write_atomically(study.directory / "learners.png", png(figure))
