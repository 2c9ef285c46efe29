"""The paper's tables and figures, regenerated from simulation beside the published ones.

    make study-paper

Each table has the columns paper, ours and floor (the Bayes-optimal estimator on the same windows).
The report's first part says what the comparison means: how much of the bias must have been known.
"""

import base64
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import jinja2
import numpy as np
from common import Report, cases
from helpers import composed, default_config, labelled
from matplotlib.figure import Figure
from scipy.optimize import brentq
from scoring import first
from tqdm import tqdm

import lbgc.train
import sim.generate
from lbgc.data.compensated import calibrated, drawn_errors
from lbgc.data.record import Record
from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled
from lbgc.earth import EARTH_RATE, earth_rate_ned
from lbgc.estimators.block_means import Site
from lbgc.estimators.estimate import Estimator
from lbgc.estimators.floor import course_of, floor
from lbgc.estimators.information import information
from lbgc.estimators.static import mean
from lbgc.frames import rotation_z, wrap
from lbgc.learning.estimator import Learned
from lbgc.learning.model import parameter_count
from lbgc.metrics import time_to_reach
from lbgc.outputs import write_atomically
from lbgc.report import figures, paper
from lbgc.sensor.allan import overlapping_deviation
from lbgc.sensor.gaussian import covariance_of_means
from lbgc.sensor.imu import ImuModel
from lbgc.train import TrainConfig
from lbgc.units import DEG, HOUR
from sim.generate import GenerateConfig

CASES = cases("paper")
DIRECTORY = Path("outputs/studies/paper")
DEG_PER_H = DEG / HOUR
MEDIAN = 0.67449
"""Of a Gaussian's size, in standard deviations."""
NAMES = ("baseline", "learned")


@lru_cache
def config(name: str, *options: str) -> GenerateConfig:
    left, whole = CASES["bias_left_deg_per_h"], CASES["bias_deg_per_h"]
    return default_config(
        f"out={DIRECTORY}/data/{name}.zarr",
        f"unit_seed={CASES['unit_seed']}",
        f"imu.gyro.bias_run_deg_per_h={left}",
        f"imu.gyro.bias_unit_deg_per_h={np.sqrt(whole**2 - left**2):.6f}",
        "protocol=static",
        *options,
    )


def generated(own: GenerateConfig) -> Dataset:
    return Dataset.open_finished(sim.generate.main(own))


def means(name: str, recordings: int, seed: int, *options: str) -> Dataset:
    return generated(
        config(
            name,
            "output=means",
            f"mean_s={CASES['mean_s']}",
            f"recordings={recordings}",
            f"seed={seed}",
            *options,
        )
    )


def sizes(estimate: Estimator, own: Labelled, imu: ImuModel | None = None) -> np.ndarray:
    """|error| against the reference, as the paper has it, (W,), degrees."""
    return np.abs(np.rad2deg(wrap(estimate(own.windows, imu).heading - own.heading_reference)))


@dataclass
class Section:
    """Of the report's page."""

    title: str
    columns: Sequence[str] = ()
    rows: list[list[str]] = field(default_factory=list)
    note: str = ""
    picture: str = ""


def drawn(figure: Figure, name: str) -> str:
    data = figures.png(figure)
    (DIRECTORY / f"{name}.png").write_bytes(data)
    return base64.b64encode(data).decode()


@dataclass(frozen=True)
class Experiment:
    """The test set, the hours, and the estimators on them."""

    records: list[Record]
    calibrated: list[Record]
    hours: list[Record]
    hour_bias: np.ndarray
    """(H, 3), rad/s, drawn: unit and run"""
    single: list[Record]
    """Hours at the paper's heading"""
    imu: ImuModel
    learned: Learned

    @property
    def knowing(self) -> ImuModel:
        return self.imu.without("unit")

    def by_name(self, window_s: float) -> dict[str, np.ndarray]:
        """|error| of each test recording's first window, degrees."""
        windows = first(self.records, window_s)
        return {
            "baseline": sizes(mean, windows),
            "learned": sizes(self.learned, windows),
            "floor, nothing known": sizes(floor, windows, self.imu),
            "floor, unit known": sizes(floor, first(self.calibrated, window_s), self.knowing),
        }


def experiment() -> Experiment:
    c = CASES
    train = means("train", c["train_recordings"], c["seed"], "split=[90,10,0]")
    test = means("test", c["test_recordings"], c["seed"] + 1, "split=[0,0,1]")
    hours = means("hours", c["hours"], c["seed"] + 2, "duration_s=3600")
    # the test module looks backwards
    azimuth = f"scene.base_azimuth_deg={(c['heading_deg'] - 180) % 360:g}"
    single = means("single", c["single_hours"], c["seed"] + 3, "duration_s=3600", azimuth)
    options = (f"data={train.path}", f"model={c['model']}", f"steps={c['steps']}")
    run = lbgc.train.main(composed(TrainConfig, "train", *options))
    every = np.arange(len(test))
    records = list(test.records(every))
    errors = drawn_errors(test, every)
    imu = config("test").imu.model(600.0)
    known_unit = [calibrated(r, imu, *e, ("unit",)) for r, e in zip(records, errors, strict=True)]
    bias = hours.label("gyro_bias_unit") + hours.label("gyro_bias_run")
    one, other = (list(d.records(np.arange(len(d)))) for d in (hours, single))
    return Experiment(records, known_unit, one, bias, other, imu, Learned.load(run))


def allan(report: Report) -> Section:
    """One hour at every sample, as the authors took it."""
    data = generated(
        config("allan", "recordings=1", "duration_s=3610", f"seed={CASES['seed'] + 3}",
               f"rate_hz={CASES['allan_rate_hz']}")
    )  # fmt: skip
    dt = 1 / CASES["allan_rate_hz"]
    record = next(iter(data.records(np.arange(1))))
    taus = np.array(CASES["allan_taus_s"], float)
    fine = np.geomspace(dt, 1800, 60)
    whole = np.unique((fine / dt).round()) * dt
    at, drawn_at = (
        overlapping_deviation(record.gyro[None], dt, t) / DEG_PER_H for t in (taus, whole)
    )
    triad = config("test").imu.gyro.triad()
    model = np.sqrt(triad.allan_variance(taus, dt)) / DEG_PER_H
    arw = triad.N[0] / np.sqrt(taus) / DEG_PER_H
    rows = []
    for i, tau in enumerate(taus):
        published = CASES["allan_published"][int(tau)]
        for axis, name in enumerate(figures.AXIS_NAMES):
            values = (published[axis], at[axis, i], model[axis, i], arw[i])
            rows.append([f"{tau:g} s, {name}", *(f"{v:.3g}" for v in values)])
    curve = fine, np.sqrt(triad.allan_variance(fine, dt)) / DEG_PER_H
    figure = figures.allan_deviation(whole, drawn_at, curve, EARTH_RATE / DEG_PER_H)
    worst = max(abs(np.log(float(r[3]) / float(r[1]))) for r in rows)
    report.summary["allan_model_over_paper_worst"] = float(np.exp(worst))
    return Section(
        "Allan deviation over one hour, deg/h",
        ["at", "paper", "ours, one hour", "ours, model", "floor: white noise alone"],
        rows,
        "At 1800 s an hour has about one degree of freedom.",
        drawn(figure, "allan"),
    )


def lines(title: str, x: str, y: str, size: tuple[float, float] = (7.0, 4.2)) -> tuple:
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.add_subplot()
    axes.set(title=title, xlabel=x, ylabel=y)
    axes.grid(True, which="both", color="0.9", linewidth=0.6)
    return figure, axes


def running_means(hours: Sequence[Record]) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,), s, and the running mean rates (H, T, 3), rad/s."""
    rates = np.stack([r.gyro for r in hours])
    t = np.arange(1, rates.shape[1] + 1) / hours[0].rate_hz
    return t, np.cumsum(rates, axis=1) / np.arange(1, rates.shape[1] + 1)[:, None]


def snr(e: Experiment) -> Section:
    t, running = running_means(e.hours)
    heading = np.array([r.heading for r in e.hours])
    earth = np.einsum("i,hij->hj", earth_rate_ned(e.hours[0].latitude), rotation_z(heading))
    horizontal = (running - (e.hour_bias + earth)[:, None])[..., :2]
    noise = np.sqrt(horizontal.var(axis=0).mean(axis=-1))  # about what the bias and Earth make
    found = 20 * np.log10(EARTH_RATE / noise)
    early = (t >= 5) & (t <= 50)
    slope = np.polyfit(np.log10(t[early]), found[early], 1)[0]
    peak = t[np.argmax(found)]
    some = np.unique(np.geomspace(1, len(t), 30).astype(int)) - 1
    model = [
        20 * np.log10(EARTH_RATE / np.sqrt(np.mean(
            [covariance_of_means(e.imu.gyro.terms[a], 1, float(x))[0, 0] for a in (0, 1)])))
        for x in t[some]
    ]  # fmt: skip
    figure, axes = lines("SNR of the sample mean", "averaging time, s", "dB")
    axes.semilogx(t, found, color="#2c5d9b", label=f"{len(e.hours)} simulated hours")
    axes.semilogx(t[some], model, "--", color="#d1691f", label="the noise model")
    axes.legend(fontsize="small")
    return Section(
        "SNR of the sample mean against averaging time",
        ["", "paper", "ours"],
        [
            ["slope while noise averages out, dB/decade", "about 10", f"{slope:.1f}"],
            ["best at, s", "about 2000", f"{peak:.0f}"],
        ],
        "Earth's rate over the standard deviation of the mean about its own bias. A mean's in-run "
        "error has its least where white noise and rate random walk balance.",
        drawn(figure, "snr"),
    )


def sensitivity(report: Report, e: Experiment) -> Section:
    t, running = running_means(e.hours)
    norm = np.linalg.norm(running, axis=2) / DEG_PER_H
    rms = np.sqrt(np.cumsum(norm**2, axis=1) / np.arange(1, norm.shape[1] + 1))
    at = np.searchsorted(t, 1800.0)
    low, high = np.percentile(rms[:, at], [2.5, 97.5])
    figure, axes = lines("Running RMS of the mean's norm", "averaging time, s", "deg/h")
    axes.fill_between(t, *np.percentile(rms, [2.5, 97.5], axis=0), color="#2c5d9b", alpha=0.2,
                      label=f"95% of {len(e.hours)} hours")  # fmt: skip
    axes.semilogx(t, rms[0], color="#2c5d9b", label="one hour")
    axes.axhline(EARTH_RATE / DEG_PER_H, color="0.4", linestyle="--", label="Earth's rate")
    axes.axhline(15.8, color="#27895a", linestyle=":", label="paper, after 30 minutes")
    axes.legend(fontsize="small")
    said = f"{rms[0, at]:.2f}", f"{low:.2f} to {high:.2f}", f"{EARTH_RATE / DEG_PER_H:.2f}"
    report.summary["norm_30_min_95_percent_deg_per_h"] = [round(low, 2), round(high, 2)]
    return Section(
        "Sensitivity of the sample mean to Earth's rate, deg/h",
        ["", "paper", "ours, one hour", "ours, 95% of hours", "floor: Earth's rate"],
        [["norm after 30 minutes", "15.8", *said]],
        "A constant bias does not average out; the norm shows its part along Earth's rate only.",
        drawn(figure, "sensitivity"),
    )


def single(e: Experiment) -> list[Section]:
    """Mean |error| over an hour's windows of each length."""
    published = {
        "baseline": (4.77, 5.26, 5.23, 4.94, 4.01),
        "learned": (3.26, 2.93, 2.58, 2.26, 1.89),
    }
    rows = []
    for i, window in enumerate(paper.WINDOWS_S):
        hours = Labelled.joined([labelled(r, window) for r in e.single])
        errors = {
            "baseline": sizes(mean, hours),
            "learned": sizes(e.learned, hours),
            "floor": sizes(floor, hours, e.imu),
        }
        hourly = {n: v.reshape(len(e.single), -1).mean(axis=1) for n, v in errors.items()}
        for name in NAMES:
            low, middle, high = np.percentile(hourly[name], [2.5, 50, 97.5])
            ours = f"{middle:.2f}", f"{low:.2f} to {high:.2f}"
            least = f"{np.median(hourly['floor']):.2f}"
            rows.append([f"{window:g} s, {name}", f"{published[name][i]:.2f}", *ours, least])
    t, running = running_means(e.single[:1])
    truth = np.deg2rad(CASES["heading_deg"])
    heading = np.arctan2(-running[0, :, 1], running[0, :, 0])
    figure, axes = lines("One hour: the running mean's heading", "time, s", "heading, deg")
    axes.semilogx(t, np.rad2deg(truth + wrap(heading - truth)), ".", markersize=3, color="#2c5d9b",
                  label="baseline")  # fmt: skip
    at = list(paper.WINDOWS_S)
    guesses = [float(e.learned(first(e.single[:1], w).windows, None).heading[0]) for w in at]
    axes.semilogx(at, [np.rad2deg(truth + wrap(g - truth)) for g in guesses], "^", color="#d1691f",
                  label="learned")  # fmt: skip
    axes.axhline(CASES["heading_deg"], color="#27895a", linewidth=1, label="truth")
    axes.legend(fontsize="small")
    return [
        Section(
            "Error against window length from a single measurement (one hour), degrees",
            ["window", "paper", "ours, median hour", "ours, 95% of hours", "floor, nothing known"],
            rows,
            "Mean size of the error over an hour's windows. One hour has one bias, so hours differ "
            "far more than windows do.",
            drawn(figure, "single"),
        )
    ]


def batch(e: Experiment) -> Section:
    """Sixteen recordings, error against time: all of them, and two zooms."""
    rng = np.random.default_rng(CASES["seed"])
    sixteen = [e.records[i] for i in rng.permutation(len(e.records))[:16]]
    times = CASES["batch_times_s"]
    both: dict[str, np.ndarray] = {}
    usual = {"baseline": mean, "learned": e.learned}
    for name, estimate in usual.items():
        own = [t for t in times if name == "baseline" or t >= 10]
        found = [sizes(estimate, first(sixteen, t)) for t in own]
        both[name] = np.stack(found, axis=1)
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    for axes, (title, low, high) in zip(
        figure.subplots(1, 3),
        (("all", times[0], 240), ("the first minute", times[0], 60), ("the last two", 120, 240)),
        strict=True,
    ):
        for name, colour in (("baseline", "#7f7f7f"), ("learned", "#d1691f")):
            own = times[-both[name].shape[1] :]
            axes.plot(own, both[name].T, color=colour, linewidth=0.6, alpha=0.6)
            axes.plot(own, np.median(both[name], axis=0), color=colour, linewidth=2.2, label=name)
        axes.set(title=title, xlim=(low, high), xlabel="time, s", ylim=(0, None))
        axes.grid(True, color="0.9")
    axes.legend(fontsize="small", title="bold: median")
    figure.axes[0].set_ylabel("|heading error|, deg")
    return Section("Performance over the whole test batch", picture=drawn(figure, "batch"))


def test_set(report: Report, e: Experiment) -> list[Section]:
    rng = np.random.default_rng(CASES["seed"] + 1)
    picks = rng.integers(len(e.records), size=(CASES["sixteens"], 16))
    rows, box, medians = [], {n: {} for n in NAMES}, {n: {} for n in NAMES}
    inside = dict.fromkeys(NAMES, 0)
    for i, window in enumerate(tqdm(paper.WINDOWS_S, "windows", leave=False)):
        found = e.by_name(window)
        for name in NAMES:
            box[name][window] = found[name][picks[0]]
            medians[name][window] = float(np.median(found[name]))
            best = found["floor, nothing known" if name == "baseline" else "floor, unit known"]
            for what, published, of in (
                ("median", paper.MEDIAN_DEG, lambda v: np.median(v, axis=-1)),
                ("IQR", paper.IQR_DEG, lambda v: np.subtract(*np.percentile(v, [75, 25], axis=-1))),
            ):
                low, high = np.percentile(of(found[name][picks]), [2.5, 97.5])
                if what == "median":
                    inside[name] += bool(low <= published[name][i] <= high)
                rows.append([f"{what}, {window:g} s, {name}", f"{published[name][i]:.2f}",
                             f"{of(found[name]):.2f}", f"{low:.2f} to {high:.2f}",
                             f"{of(best):.2f}"])  # fmt: skip
        report.summary[f"learned_over_floor_{window:g}s"] = float(
            np.sqrt(np.mean(found["learned"] ** 2) / np.mean(found["floor, unit known"] ** 2))
        )
    report.summary |= {f"{n}_medians_inside": v for n, v in inside.items()}
    tables = Section(
        "Error against window length from the test set, degrees",
        ["", "paper (16)", f"ours ({len(e.records)})", "ours, 95% of sixteens", "floor"],
        rows,
        f"{CASES['sixteens']} sets of sixteen recordings show how far one such set may lie. Floor: "
        "for the baseline with nothing known of the bias, for the learned with the unit's known.",
    )
    plots = Section("Box plots of sixteen recordings",
                    picture=drawn(figures.box_plots(box), "boxes"))  # fmt: skip
    return [tables, plots, time_error(report, e, medians)]


def time_error(report: Report, e: Experiment, medians: dict) -> Section:
    published = {"baseline": ("50.6", "78.3", "203.1", "984.2", "never", "never"),
                 "learned": ("5.7", "7.22", "13.8", "31.1", "47", "248")}  # fmt: skip
    long = list(CASES["hour_windows_s"])
    hour = [float(np.median(sizes(mean, first(e.hours, w)))) for w in long]
    best = {}
    for w in (10.0, 20.0, 30.0, 60.0, 120.0, 240.0):
        best[w] = float(np.median(sizes(floor, first(e.calibrated, w), e.knowing)))
    rows = []
    for i, error in enumerate((4.0, 3.5, 3.0, 2.5, 2.0, 1.5)):
        curves = {"baseline": dict(zip(long, hour, strict=True)), "learned": medians["learned"]}
        reached = {n: time_to_reach(list(c), list(c.values()), error) for n, c in curves.items()}
        least = time_to_reach(list(best), list(best.values()), error)
        rows += [[f"{error:g} deg, {n}", f"{published[n][i]}", reached[n], least] for n in NAMES]
    report.summary["baseline_median_one_hour_deg"] = round(hour[-1], 2)
    return Section(
        "Time that a median error takes, s",
        ["median error", "paper", "ours", "floor, unit known"],
        rows,
        f"The baseline on {len(e.hours)} one-hour recordings, the learned on "
        "windows up to the 240 s that it was trained on.",
    )


def hyperparameters() -> Section:
    from lbgc.learning.model import ModelConfig, make

    rows = []
    for (layers, hidden), count in paper.PARAMETERS.items():
        own = ModelConfig(layers=layers, hidden=hidden, output="degrees", channels=["gyro"])
        rows.append([f"{layers} x {hidden}", f"{count}", f"{parameter_count(make(own, 0))}"])
    return Section(
        "Parameters of the three networks",
        ["layers x hidden", "paper", "ours"],
        rows,
        "A Bi-LSTM on three channels with a linear layer a direction has fewer than published.",
    )


def what_must_be_known(report: Report) -> Section:
    """The bias left unknown, of each published learned median: the floor's median equal to it."""
    site = Site.at(float(np.deg2rad(32.76)))
    rows, lefts = [], []
    for i, window in enumerate(paper.WINDOWS_S):
        course = course_of(config("test").protocol, window)

        def median(left: float, course=course) -> float:
            gyro = replace(
                config("test").imu.gyro, bias_run_deg_per_h=left, bias_unit_deg_per_h=0.0
            )
            imu = replace(config("test").imu, gyro=gyro).model(600.0)
            sigma = information(imu, course, site).sigma(np.deg2rad(np.arange(0, 360, 10.0)))
            return MEDIAN * float(np.rad2deg(np.sqrt(np.mean(sigma**2))))

        published = paper.MEDIAN_DEG["learned"][i]
        alone, unknown = median(0.0), median(CASES["bias_deg_per_h"])
        # a median over 16 has a 95% range of about +-55%
        left, low, high = (_left(median, published * f, alone) for f in (1.0, 1 / 1.55, 1 / 0.45))
        lefts.append(left)
        share = 1 - (left / CASES["bias_deg_per_h"]) ** 2
        rows.append([f"{window:g} s", f"{published:.2f}", f"{alone:.2f}", f"{unknown:.2f}",
                     f"{left:.2f} ({low:.2f} to {high:.2f})", f"{share:.0%}"])  # fmt: skip
    report.summary["bias_left_deg_per_h"] = [round(v, 3) for v in lefts]
    return Section(
        "How much of the bias must have been known",
        ["window", "published learned median", "floor, bias known", "floor, 1 deg/h unknown",
         "bias left, deg/h (95% of a median over 16)", "share of variance known"],
        rows,
        "The floor's median equals the published one where this much bias, new in every recording, "
        "is left. Below the third column no estimator could go.",
    )  # fmt: skip


def _left(median: Callable[[float], float], wanted: float, alone: float) -> float:
    """deg/h, at which the floor's median is the wanted one; 0 where in-run noise alone is more."""
    return 0.0 if wanted <= alone else float(brentq(lambda b: median(b) - wanted, 0, 5))


def main() -> None:
    with Report("studies/paper") as report:
        table = what_must_be_known(report)
        e = experiment()
        sections = [table, allan(report), snr(e), sensitivity(report, e), *single(e), batch(e),
                    *test_set(report, e), hyperparameters()]  # fmt: skip
        for section in sections:
            report.line()
            report.line(section.title)
            for row in [list(section.columns), *section.rows] if section.rows else []:
                report.line("  ".join(cell.rjust(24) for cell in row))
        template = jinja2.Environment(
            autoescape=True, undefined=jinja2.StrictUndefined
        ).from_string(Path(__file__).with_suffix(".html.j2").read_text())
        page = template.render(sections=sections, summary=report.summary, cases=CASES)
        write_atomically(DIRECTORY / "report.html", page)
    shutil.rmtree(DIRECTORY / "data")


if __name__ == "__main__":
    main()
