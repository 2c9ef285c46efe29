"""Where learning helps, where it cannot, and whether it knows which.

    make study-learning
    python tests/studies/learning.py share swaying     some parts of it

A network learns the correction to a classical estimate, with its sigma. Every ratio is to the
Bayes-optimal estimator on the same windows, with a paired 95% interval: to the one that is told the
unit's errors where the network could have learned them, else to the one that is not.
"""

import json
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import swaying
import torch
from common import Report, cases
from helpers import composed, default_config, labelled
from matplotlib.figure import Figure
from scipy.stats import norm
from scoring import Scores, first, scored
from tqdm import tqdm

import lbgc.export
import lbgc.train
import sim.generate
from lbgc import cores
from lbgc.data.compensated import calibrated, drawn_errors
from lbgc.data.record import Record
from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled
from lbgc.errors import InputError
from lbgc.estimators import CLASSICAL
from lbgc.estimators.floor import floor
from lbgc.estimators.static import mean
from lbgc.export import ExportConfig
from lbgc.frames import wrap
from lbgc.learning import onnx
from lbgc.learning.description import DESCRIPTION
from lbgc.learning.estimator import Learned
from lbgc.report.figures import png
from lbgc.sensor.imu import ImuModel
from lbgc.train import TrainConfig

CASES = cases("learning")
DIRECTORY = Path("outputs/studies/learning")
IMPROVEMENT = (35.2, 43.3, 46.2, 46.6, 55.7)
"""Published, per cent, of the medians at the five windows."""


@dataclass(frozen=True)
class Case:
    name: str
    options: tuple[str, ...]
    steps: int
    units: int = 1
    windows_s: tuple[float, ...] = tuple(CASES["windows_s"])
    tested_on: int = CASES["test_recordings"]
    mean_s: float = 5.0
    stream: bool = True
    power_ups: bool = False
    """Each recording is one of its own."""
    training: tuple[str, ...] = ()
    """Other options of training."""
    echo: int = CASES["echo"]

    @classmethod
    def of_share(cls, share: float, echo: int = CASES["echo"]) -> "Case":
        """A share of the bias variance repeats; the rest is new in every recording."""
        whole = CASES["bias_deg_per_h"]
        return cls(
            f"share_{share:g}",
            bias(whole * np.sqrt(share), whole * np.sqrt(1 - share)),
            CASES["steps"],
            tested_on=CASES["calibration_recordings" if share in (0, 1) else "test_recordings"],
            echo=echo,
        )

    def dataset(self, part: str, recordings: int, seed: int, unit_seed: int, split: str) -> Dataset:
        units = recordings if self.units > 1 else 1
        config = default_config(
            "protocol=static",
            *self.options,
            f"out={DIRECTORY}/data/{self.name}_{part}.zarr",
            "output=means",
            f"mean_s={self.mean_s:g}",
            *([] if self.stream else ["cluster=local", f"cluster.workers={cores.count()}"]),
            f"recordings={recordings}",
            f"seed={seed}",
            f"unit_seed={unit_seed}",
            f"units={units}",
            f"split={split}",
            *(["split_by=unit"] if units > 1 else []),
            *([f"sessions={recordings}"] if self.power_ups else []),
        )
        return Dataset.open_finished(sim.generate.main(config))

    def trained(self) -> tuple[Learned, float, Path]:
        """The model, the minutes that it took, and its run's directory."""
        data = self.dataset("train", CASES["train_recordings"], CASES["seed"],
                            CASES["unit_seed"], "[90,10,0]")  # fmt: skip
        lengths = ",".join(f"{w:g}" for w in self.windows_s)
        options = (f"data={data.place}", f"experiment={CASES['experiment']}",
                   f"steps={self.steps}", f"tempering={CASES['tempering']}",
                   f"windows_s=[{lengths}]", f"mean_s={self.mean_s:g}",
                   f"stream={str(self.stream).lower()}", f"echo={self.echo}",
                   *self.training)  # fmt: skip
        run = lbgc.train.main(composed(TrainConfig, "train", *options))
        return Learned.load(run), json.loads((run / DESCRIPTION).read_text())["seconds"] / 60, run

    def tested(self) -> "Tested":
        other = CASES["unit_seed"] + (1000 if self.units > 1 else 0)
        count = self.tested_on
        data = self.dataset("test", count, CASES["seed"] + 1, other, "[0,0,1]")
        every = np.arange(len(data))
        config = composed(sim.generate.GenerateConfig, "generate", "protocol=static", *self.options)
        imu = config.imu.model(config.rate_hz)
        records = list(data.records(every))
        told = [
            calibrated(r, imu, *e, ("unit",))
            for r, e in zip(records, drawn_errors(data, every), strict=True)
        ]
        return Tested(records, told, imu)


@dataclass(frozen=True)
class Tested:
    records: list[Record]
    told: list[Record]
    """The same, the unit's errors taken out."""
    imu: ImuModel

    def scores(self, learned: Learned, window_s: float, bases: Sequence = ()) -> dict[str, Scores]:
        plain = {"mean": mean} if not bases else dict(bases)
        found = scored(iter([first(self.records, window_s)]),
                       {**plain, "learned": learned, "floor": floor}, self.imu)  # fmt: skip
        knowing = self.imu.without("unit")
        best = scored(iter([first(self.told, window_s)]), {"told": floor}, knowing)
        return found | best


class Calibration:
    """Do intervals hold as often as they say, by window length and third of stated sigma?"""

    def __init__(self) -> None:
        self.rows: list[tuple[str, float, float, float]] = []

    def add(
        self,
        name: str,
        tested: Tested,
        learned: Learned,
        windows_s: Sequence[float] = tuple(CASES["windows_s"]),
    ) -> None:
        for window in windows_s:
            cuts = [labelled(record, window) for record in tested.records]
            pick = np.unique(np.linspace(0, len(cuts[0]) - 1, CASES["calibration_windows"]).round())
            picked = Labelled.joined([own.rows(pick.astype(int)) for own in cuts])
            recording = np.repeat(np.arange(len(cuts)), len(pick))
            found = learned(picked.windows)
            z = np.abs(wrap(found.heading - picked.heading)) / found.sigma
            order = np.argsort(found.sigma, kind="stable")
            for third, part in enumerate((order, *np.array_split(order, 3))):
                for level in CASES["calibration_levels"]:
                    inside = z[part] <= norm.ppf((1 + level) / 2)
                    which = "all" if third == 0 else f"third {third}"
                    error = _clustered_error(inside, recording[part])
                    held = float(np.mean(inside))
                    self.rows.append((f"{name}, {window:g} s, {which}", level, held, error))

    def report(self, report: Report) -> None:
        worst = max(self.rows, key=lambda row: abs(row[2] - row[1]))
        report.line()
        report.line("calibration: share of errors inside the stated 50, 90, 95% intervals, and "
                    "their sampling error (1 sigma)")  # fmt: skip
        for row in sorted(self.rows, key=lambda r: -abs(r[2] - r[1]))[:12]:
            report.line(f"  {row[0]:40s} {row[1]:.0%}: {row[2]:.2%} +- {row[3]:.2%}")
        rng = np.random.default_rng(CASES["seed"])
        errors = np.array([row[3] for row in self.rows])
        chance = np.abs(errors * rng.standard_normal((2000, len(errors)))).max(axis=1)
        median, most = 100 * np.quantile(chance, [0.5, 0.95])
        report.line(f"  by sampling alone the worst of {len(errors)} would be {median:.1f} points "
                    f"off (95%: {most:.1f})")  # fmt: skip
        report.summary["calibration_worst_by_chance_points"] = float(median)
        report.summary["calibration_worst_points"] = 100 * abs(worst[2] - worst[1])
        report.summary["calibration_worst"] = worst[0]


def _clustered_error(inside: np.ndarray, recording: np.ndarray) -> float:
    """Standard error of a share whose recordings, not whose windows, are independent."""
    sums = np.bincount(recording, inside - inside.mean())
    return float(np.sqrt(np.sum(sums**2)) / len(inside))


def table(
    report: Report, name: str, tested: Tested, learned: Learned, against: str, bases: Sequence = ()
) -> tuple[list[float], list[dict[str, Scores]]]:
    """Print one case; upper ends of RMSE over the floor, by window, and the scores."""
    base = next(iter(dict(bases))) if bases else "mean"
    report.line()
    report.line(f"{name}: RMSE, degrees; ratios over the floor"
                f"{' that is told the unit' if against == 'told' else ''}")  # fmt: skip
    report.line(f"window   {base:>22s}  learned  sigma    floor     told   over the floor [95%]   "
                " less than the base, paper")  # fmt: skip
    uppers, all_scores = [], []
    for i, window in enumerate(CASES["windows_s"]):
        found = tested.scores(learned, window, bases)
        over = found["learned"].over(found[against])
        gain = 1 - found["learned"].rmse_deg / found[base].rmse_deg
        sigma = np.rad2deg(np.sqrt(np.mean(found["learned"].sigma ** 2)))
        rmse = {name: scores.rmse_deg for name, scores in found.items()}
        report.line(
            f"{window:4g} s   {rmse[base]:22.3f}  {rmse['learned']:7.3f}  {sigma:5.3f}  "
            f"{rmse['floor']:7.3f}  {rmse['told']:7.3f}   {over.value:.4f} "
            f"({over.low:.4f} to {over.high:.4f})   {gain:6.1%}, {IMPROVEMENT[i]:g}%"
        )
        uppers.append(over.high)
        all_scores.append(found)
    return uppers, all_scores


def bias(unit: float, run: float) -> tuple[str, ...]:
    return (f"imu.gyro.bias_unit_deg_per_h={unit:.6f}", f"imu.gyro.bias_run_deg_per_h={run:.6f}")


def by_share(report: Report, minutes: list[float], calibration: Calibration) -> None:
    """How much there is to win, by the share of bias variance that repeats."""
    points = {}
    for share in (0.0, *CASES["shares"], 1.0):
        case = Case.of_share(share)
        tested, (learned, took, run) = case.tested(), case.trained()
        minutes.append(took)
        uppers, scores = table(report, f"{share:.0%} of the bias variance repeats", tested, learned,
                               "told")  # fmt: skip
        points[share] = [
            (
                1 - s["learned"].rmse_deg / s["mean"].rmse_deg,
                1 - s["told"].rmse_deg / s["mean"].rmse_deg,
            )
            for s in scores
        ]
        if share == 1.0:
            report.summary["unit_bias_over_floor_max"] = max(uppers)
            calibration.add("repeats", tested, learned)
            latency(report, learned, run, tested)
        if share == 0.0:
            report.summary["run_bias_over_floor_max"] = max(uppers)
            sigma = np.rad2deg(np.sqrt(np.mean(scores[-1]["learned"].sigma ** 2)))
            report.summary["run_bias_sigma_240s_deg"] = float(sigma)
            calibration.add("new every run", tested, learned)
    report.summary["improvement_by_repeatable_share"] = [
        {"share": share, "learned": [p[0] for p in own], "floor": [p[1] for p in own]}
        for share, own in points.items()
    ]
    (DIRECTORY / "improvement_by_share.png").write_bytes(png(_curve(points)))


def _curve(points: dict[float, list[tuple[float, float]]]) -> Figure:
    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    axes = figure.add_subplot()
    shares = list(points)
    for i, (window, colour) in enumerate(
        zip(
            CASES["windows_s"],
            ("#9ecae1", "#6baed6", "#3182bd", "#08519c", "#08306b"),
            strict=False,
        )
    ):
        axes.plot(shares, [100 * points[s][i][1] for s in shares], color=colour, linewidth=1)
        axes.plot(shares, [100 * points[s][i][0] for s in shares], "o", color=colour,
                  label=f"{window:g} s")  # fmt: skip
    axes.axhspan(35.2, 55.7, color="#27895a", alpha=0.12, label="published, 35 to 56%")
    axes.set(
        title="What learning wins over the plain mean, by how much of the bias repeats",
        xlabel="share of the bias variance that repeats",
        ylabel="RMSE less than the mean's, %",
    )
    axes.grid(True, color="0.9")
    axes.legend(fontsize="small", title="points: learned; lines: the floor told the unit")
    return figure


def echoed(report: Report, minutes: list[float], _: Calibration) -> None:
    """What it costs to take each batch for several steps in a row, and what that saves."""
    report.line()
    report.line("by how often a batch is used: the worst window's RMSE over the floor that is told "
                "the unit, and minutes")  # fmt: skip
    worst = 0.0
    for share in CASES["echoed_shares"]:
        tested = Case.of_share(share).tested()
        for echo in (CASES["echo"], CASES["echoed"]):
            learned, took, _ = Case.of_share(share, echo).trained()
            found = [tested.scores(learned, window) for window in CASES["windows_s"]]
            over = max((s["learned"].over(s["told"]) for s in found), key=lambda ratio: ratio.value)
            report.line(f"  {share:4.0%} repeats, {echo} steps a batch: {over.value:.4f} "
                        f"({over.low:.4f} to {over.high:.4f}), {took:.2f} minutes")  # fmt: skip
            if echo == CASES["echoed"]:
                worst = max(worst, over.value)
            else:
                minutes.append(took)
    report.summary["echoed_over_floor_max"] = worst


def unseen_units(report: Report, minutes: list[float], calibration: Calibration) -> None:
    case = Case(
        "unseen",
        bias(CASES["bias_deg_per_h"], 0.0),
        CASES["steps"],
        units=CASES["train_recordings"],
        tested_on=CASES["calibration_recordings"],
    )
    tested, (learned, took, _) = case.tested(), case.trained()
    minutes.append(took)
    uppers, _ = table(
        report, "all of it repeats, but in units never seen", tested, learned, "floor"
    )
    report.summary["unseen_unit_over_floor_max"] = max(uppers)
    calibration.add("unseen units", tested, learned)


def turned(report: Report, minutes: list[float], calibration: Calibration) -> None:
    for protocol in CASES["turned"]:
        case = Case(protocol, (f"protocol={protocol}", *bias(0.0, CASES["bias_deg_per_h"])),
                    CASES["steps"], windows_s=(240.0,),
                    tested_on=CASES["calibration_recordings"])  # fmt: skip
        tested, (learned, took, _) = case.tested(), case.trained()
        minutes.append(took)
        report.line()
        whole = tested.scores(learned, 240.0, [(protocol, CLASSICAL[protocol])])
        over = whole["learned"].over(whole["told"])
        report.line(
            f"{protocol}, 240 s: {protocol} {whole[protocol].rmse_deg:.3f}, learned "
            f"{whole['learned'].rmse_deg:.3f}, floor {whole['told'].rmse_deg:.3f} deg: "
            f"{over.value:.4f} ({over.low:.4f} to {over.high:.4f}), NSE {whole['learned'].nse:.3f}"
        )
        report.summary[f"{protocol}_over_floor"] = over.high
        calibration.add(protocol, tested, learned, case.windows_s)


def presets(report: Report, minutes: list[float], _: Calibration) -> None:
    """The paper's first future question: which class of sensor gains?"""
    report.line()
    report.line("every preset as its file says, a power-up each recording, static, 240 s: RMSE, "
                "degrees")  # fmt: skip
    report.line(f"{'sensor':12s} {'mean':>10s} {'learned':>10s} {'floor':>10s}   learned over the "
                "floor told the unit   learned over mean")  # fmt: skip
    found, bars = {}, {}
    for name in tqdm(CASES["presets"], "presets", leave=False):
        case = Case(f"preset_{name}", (f"imu={name}",), CASES["preset_steps"], power_ups=True)
        tested, (learned, took, _) = case.tested(), case.trained()
        minutes.append(took)
        try:
            s = tested.scores(learned, 240.0)
        except InputError as error:  # the floor refuses where its model does not fit
            report.line(f"{name:12s} {error}")
            continue
        over = s["learned"].over(s["told"])
        gain = s["learned"].over(s["mean"])
        found[name] = gain.value
        bars[name] = [s[of].rmse_deg for of in ("mean", "learned", "told")]
        rmse = " ".join(f"{value:10.4f}" for value in bars[name])
        ratios = "   ".join(f"{r.value:.3f} ({r.low:.3f} to {r.high:.3f})" for r in (over, gain))
        report.line(f"{name:12s} {rmse}   {ratios}")
    report.summary["learned_over_mean_by_preset"] = found
    (DIRECTORY / "presets.png").write_bytes(png(_by_preset(bars)))


def _by_preset(bars: dict[str, list[float]]) -> Figure:
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    at = np.arange(len(bars))
    looks = (("mean", "#9ecae1", "plain mean"), ("learned", "#08519c", "learned"),
             ("told", "#27895a", "the floor, told the unit's errors"))  # fmt: skip
    for i, (_, colour, label) in enumerate(looks):
        values = [own[i] for own in bars.values()]
        axes.bar(at + 0.27 * (i - 1), values, 0.25, color=colour, label=label)
    axes.axhline(180 / np.sqrt(3), color="0.5", linewidth=0.8, linestyle=":")
    axes.annotate("chance", (len(bars) - 1, 115), color="0.4", fontsize="small", ha="center")
    axes.set(title="Four minutes at rest: which class of sensor gains?", yscale="log",
             ylabel="RMSE, degrees", xticks=at, xticklabels=list(bars))  # fmt: skip
    axes.set_ylim(top=2000)  # room for the legend
    axes.grid(True, axis="y", color="0.9")
    axes.set_axisbelow(True)
    axes.legend(fontsize="small", loc="upper right", ncols=3)
    return figure


def departures(report: Report, minutes: list[float], _: Calibration) -> None:
    """What no Gaussian model of the sensor knows of, or no classical estimator is told."""
    summary = {}
    for name, own in CASES["departures"].items():
        case = Case(name, tuple(own["options"]), CASES["departure_steps"], mean_s=own["mean_s"],
                    windows_s=tuple(own["windows_s"]), stream=own["stream"],
                    training=tuple(own.get("training", ())))  # fmt: skip
        tested, (learned, took, _) = case.tested(), case.trained()
        minutes.append(took)
        report.line()
        report.line(f"{name}: {own['what']}; RMSE, degrees; ratio to the best classical [95%]")
        for window in case.windows_s:
            windows = first(tested.records, window)
            found = scored(iter([windows]), {"learned": learned}, tested.imu)
            for estimator in own["classical"]:
                try:
                    by = {estimator: CLASSICAL[estimator]}
                    found |= scored(iter([windows]), by, tested.imu)
                except InputError as error:  # some refuse what their model does not fit
                    report.line(f"{window:4g} s   {error}")
            best = min(found.keys() - {"learned"}, key=lambda n: found[n].rmse_deg)
            over = found["learned"].over(found[best])
            shown = ", ".join(f"{n} {s.rmse_deg:.3f}" for n, s in found.items())
            report.line(f"{window:4g} s   {shown}   over {best} {over.value:.4f} "
                        f"({over.low:.4f} to {over.high:.4f})")  # fmt: skip
            summary[f"{name}_{window:g}s"] = [over.value, over.low, over.high]
    report.summary["learned_over_best_classical_by_departure"] = summary


def stored_against_streamed(report: Report, minutes: list[float], _: Calibration) -> None:
    """Training on 2,700 recordings, turned and mixed, and on ones drawn afresh."""
    case = Case("share_1", bias(CASES["bias_deg_per_h"], 0.0), CASES["steps"],
                tested_on=CASES["calibration_recordings"])  # fmt: skip
    tested, learned = case.tested(), {}
    for stream in (True, False):
        learned[stream], took, _ = replace(case, stream=stream).trained()
        minutes.append(took)
    report.line()
    ratios = []
    for window in CASES["windows_s"]:
        both = {"streamed": learned[True], "stored": learned[False]}
        found = scored(iter([first(tested.records, window)]), both, tested.imu)
        ratios.append(found["stored"].over(found["streamed"]))
    shown = ", ".join(f"{r.value:.4f} ({r.low:.4f} to {r.high:.4f})" for r in ratios)
    report.line(f"trained on stored recordings over streamed, 10 to 240 s: {shown}")
    report.summary["stored_over_streamed"] = [r.value for r in ratios]


def latency(report: Report, learned: Learned, run: Path, tested: Tested) -> None:
    """Of one 240 s window of 5 s means on one core, classical base and features included."""
    window = first(tested.records[:1], 240.0).windows
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # two would wait for each other longer than they work
    exported = onnx.load(lbgc.export.main(ExportConfig(run=str(run))))
    for name, estimate in (("torch", learned), ("onnx", exported)):
        times = []
        for _ in range(200):
            started = time.perf_counter()
            estimate(window)
            times.append(time.perf_counter() - started)
        report.summary[f"{name}_latency_240s_ms"] = 1e3 * float(np.median(times))
    torch.set_num_threads(threads)
    torch_ms, onnx_ms = (report.summary[f"{n}_latency_240s_ms"] for n in ("torch", "onnx"))
    report.line(f"a 240 s window: PyTorch {torch_ms:.2f} ms, ONNX Runtime {onnx_ms:.2f} ms "
                "(published: 3.99, 7.81, 26.62)")  # fmt: skip


def real(report: Report, minutes: list[float], _: Calibration) -> None:
    swaying.sim_to_real(report, DIRECTORY, minutes)


PARTS: dict[str, Callable[[Report, list[float], Calibration], None]] = {
    "share": by_share,
    "echo": echoed,
    "unseen": unseen_units,
    "turned": turned,
    "stored": stored_against_streamed,
    "departures": departures,
    "swaying": real,
    "presets": presets,
}


def main() -> None:
    minutes: list[float] = []
    calibration = Calibration()
    asked = sys.argv[1:] or list(PARTS)
    with Report("studies/learning") as report:
        for part in asked:
            PARTS[part](report, minutes, calibration)
        if calibration.rows:
            calibration.report(report)
        report.summary["train_minutes_median"] = float(np.median(minutes))
    shutil.rmtree(DIRECTORY / "data")


if __name__ == "__main__":
    main()
