"""Is an exported sensor ours, in the other tool's own terms, where its file says that it is?

    make study-exports

Every sensor of conf/imu is written for every tool. What each file says to the tool is read back and
simulated by the tool's documentation alone (tests/exported.py). Two comparisons with ours: of the
laws, at every octave, which must agree within 5% exactly where the file says so; and of one
simulation each, Allan deviations side by side. It takes three minutes on two cores.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import Report, cases
from exported import AXES, PARTS, READERS, Model, claims, of_axes
from helpers import default_config
from matplotlib.figure import Figure
from tqdm import tqdm

from lbgc.commands import CONF
from lbgc.exports import FORMATS
from lbgc.exports.subject import Subject
from lbgc.sensor import stand_in
from lbgc.sensor.allan import overlapping_deviation

CASES = cases("exports")
_COLOURS = dict(
    zip(
        FORMATS,
        (
            *("#c0392b", "#e67e22", "#b8860b", "#7f7f7f", "#27895a"),
            *("#8e44ad", "#d68fd6", "#2c5d9b", "#17becf"),
        ),
        strict=True,
    )
)


@dataclass(frozen=True)
class Curve:
    """One triad of an export: (3, L) each, of its axes, at the octaves."""

    format: str
    part: str
    ours: np.ndarray
    """The Allan deviations that are meant."""
    theirs: np.ndarray
    claimed: np.ndarray
    models: list[Model]

    @property
    def ratio(self) -> np.ndarray:
        """Theirs over ours; 1 where neither has noise."""
        both = np.where((self.ours == 0) & (self.theirs == 0), 1.0, self.ours)
        return np.where(self.ours == 0, 1.0, self.theirs) / both

    @property
    def agrees(self) -> np.ndarray:
        return np.abs(np.log(self.ratio)) <= np.log(1.05) * (1 + 1e-6)


def curves(own: Subject) -> Iterator[Curve]:
    """What each tool makes of a sensor."""
    m = np.round(own.octaves / own.dt).astype(int)
    for name, made in FORMATS.items():
        text = made.text(own)
        said = claims(text, own.octaves)
        for part, models in READERS[name](text, own.dt).items():
            ours = own.triad(part).allan_variance(own.octaves, own.dt)
            if len(models) == 1:
                ours = np.broadcast_to(ours.max(axis=0), ours.shape)
            theirs = [[model.allan_variance(k) for k in m] for model in of_axes(models)]
            claimed = np.stack([said[part, axis] for axis in AXES])
            yield Curve(name, part, np.sqrt(ours), np.sqrt(theirs), claimed, of_axes(models))


def simulated(own: Subject, rng: np.random.Generator, taus: np.ndarray) -> dict[str, np.ndarray]:
    """Our samples' Allan deviations of each triad, (3, L)."""
    found = {}
    for part in PARTS:
        triad = own.triad(part)
        drawn = triad.draw_run(rng, triad.none_drawn())
        samples, _ = triad.measure(rng, np.zeros((3, 1)), drawn, CASES["samples"], own.dt)
        scaled = samples.T * (triad.output_scale(own.dt) or 1.0)
        found[part] = overlapping_deviation([scaled], own.dt, taus)
    return found


def simulated_there(
    model: Model, rng: np.random.Generator, dt: float, taus: np.ndarray
) -> np.ndarray:
    """The tool's samples' Allan deviations of one axis, (L,), once its drift has its law."""
    n = CASES["samples"]
    settling = 0 if model.pole == 1 else int(min(-5 / np.log(model.pole), n))
    samples = model.simulate(rng, (1, n + settling))[0, settling:]
    return overlapping_deviation([samples[:, None]], dt, taus)[0]


def draw(report: Report, name: str, own: Subject, found: list[Curve], seen: dict) -> None:
    """A sensor's curves, forward axis: ours, each tool's law, and what was simulated."""
    figure = Figure(figsize=(12, 5.2), layout="constrained")
    for i, part in enumerate(PARTS):
        axes = figure.add_subplot(1, 2, i + 1)
        ours = np.sqrt(own.triad(part).allan_variance(own.octaves, own.dt)[0])
        axes.loglog(own.octaves, ours, color="black", linewidth=4, alpha=0.35, label="ours")
        for curve in (c for c in found if c.part == part):
            colour = _COLOURS[curve.format]
            axes.loglog(own.octaves, curve.theirs[0], color=colour, linewidth=1, label=curve.format)
            taus, deviations = seen[curve.format, part]
            axes.loglog(taus, deviations, "o", color=colour, markersize=3)
            held = curve.claimed[0]
            axes.loglog(own.octaves[held], curve.theirs[0][held], "|", color=colour, markersize=9)
        axes.set(title=f"{name}, {part}, forward", xlabel="averaging time, s")
        axes.set_ylabel("rad/s" if part == "gyro" else "m/s^2")
        axes.set_ylim(ours[ours > 0].min() / 3, ours.max() * 3)
        axes.grid(True, which="both", color="0.9", linewidth=0.5)
    said = "lines: law\ndots: simulated\nticks: claimed"
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside right upper", fontsize="x-small", title=said
    )
    figure.savefig(report.directory / f"{name}.png", dpi=120)


def side_by_side(
    own: Subject, found: list[Curve], rng: np.random.Generator
) -> tuple[dict[tuple[str, str], tuple[np.ndarray, np.ndarray]], int, int]:
    """One simulation of each curve's forward axis beside ours: averaging times and deviations, by
    format and triad; at how many octaves the files say that they agree; at how many of these they
    do, beside so many standard errors of both deviations (about sqrt(m/n) together, of means over m
    of n samples)."""
    n = CASES["samples"]
    taus = own.octaves[own.octaves * own.rate_hz * CASES["blocks"] <= n]
    error = CASES["standard_errors"] * np.sqrt(taus * own.rate_hz / n)
    ours = simulated(own, rng, taus)
    seen, claimed, right = {}, 0, 0
    for curve in found:
        theirs = simulated_there(curve.models[0], rng, own.dt, taus)
        seen[curve.format, curve.part] = taus, theirs
        shared = all(model is curve.models[0] for model in curve.models)
        worst = own.triad(curve.part).allan_variance(taus, own.dt).argmax(axis=0)
        meant = ours[curve.part][worst if shared else 0, np.arange(len(taus))]
        with np.errstate(divide="ignore", invalid="ignore"):  # imu=ideal has no noise
            off = np.abs(np.log(theirs / meant)) > np.log(1.05) + error
        held = curve.claimed[0][: len(taus)]
        claimed += int(held.sum())
        right += int((held & ~off).sum())
    return seen, claimed, right


def run(report: Report) -> None:
    names = CASES["sensors"] or sorted(path.stem for path in Path(CONF, "imu").glob("*.yaml"))
    octaves = stand_in.octaves(1 / CASES["rate_hz"], CASES["longest_s"])
    report.line(
        f"of {len(octaves)} octaves, from {octaves[0]:g} to {octaves[-1]:g} s: at how many an"
    )
    report.line("export's law is ours within 5%, on the axis that has least; gyro, accel")
    report.line(f"{'sensor':18s}" + "".join(f"{name:>14s}" for name in FORMATS))
    every: list[Curve] = []
    good, claimed, right = 0, 0, 0
    for number, name in enumerate(tqdm(names, leave=False)):
        own = Subject(default_config(f"imu={name}").imu, CASES["rate_hz"], CASES["longest_s"])
        rng = np.random.Generator(np.random.SFC64([CASES["seed"], number]))
        found = list(curves(own))
        every += found
        seen, said, agreed = side_by_side(own, found, rng)
        claimed, right = claimed + said, right + agreed
        cells = {form: [c for c in found if c.format == form] for form in FORMATS}
        good += sum(all(c.agrees[c.claimed].all() for c in cell) for cell in cells.values())
        row = (" ".join(str(c.agrees.sum(axis=1).min()) for c in cell) for cell in cells.values())
        report.line(f"{name:18s}" + "".join(f"{cell:>14s}" for cell in row))
        if name in CASES["pictures"]:
            draw(report, name, own, found, seen)
    report.line()
    for name in FORMATS:
        share = 100 * np.mean([curve.agrees for curve in every if curve.format == name])
        report.summary[f"exports_{name}_octaves_percent"] = round(float(share), 1)
        report.line(f"{name:14s} is the sensor within 5% at {share:.0f}% of octaves and axes")
    exports = len(names) * len(FORMATS)
    wrong = sum(int((curve.agrees != curve.claimed).sum()) for curve in every)
    report.line(
        f"{good} of {exports} exports agree by law at every octave that they claim; of "
        f"{sum(curve.claimed.size for curve in every)} octaves their sentences are wrong at {wrong}"
    )
    report.line(f"simulated side by side: {right} of {claimed} claimed octaves agree beyond chance")
    report.summary |= {
        "exports": exports,
        "exports_within_5_percent": round(100 * good / exports, 2),
        "exports_sentences_wrong": wrong,
        "exports_simulated_octaves": claimed,
        "exports_simulated_within_percent": round(100 * right / max(claimed, 1), 2),
    }


if __name__ == "__main__":
    with Report("studies/exports") as study:
        run(study)
