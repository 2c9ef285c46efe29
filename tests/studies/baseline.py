"""The paper's experiment over many seeds, and a repeatable bias over many units.

    make study-baseline

1. Median of the plain mean's error over 80 recordings, at each of the paper's windows, 50 seeds.
2. Sensors whose whole bias is `unit`, 8 of them: RMSE of the learned model over the plain mean's on
   held-out recordings, 60 s windows; one model a unit. A unit's ratio depends on the bias that it
   happened to draw: a small one leaves little to win.
"""

from dataclasses import replace

import numpy as np
from common import Report, cases, interval95
from helpers import default_config, labelled
from tqdm import tqdm

import lbgc.train
import sim.generate
from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled
from lbgc.estimators.static import mean
from lbgc.learning.estimator import Learned
from lbgc.metrics import heading_errors, summarise
from lbgc.report import paper
from lbgc.train import TrainConfig
from sim.generate import GenerateConfig

CASES = cases("baseline")
SEEDS, UNITS, RECORDINGS = (CASES[name] for name in ("seeds", "units", "recordings"))


def dataset(config: GenerateConfig, name: str) -> Dataset:
    out = f"outputs/studies/baseline/data/{name}.zarr"
    return Dataset.open_finished(sim.generate.main(replace(config, out=out)))


def errors(data: Dataset, estimate, window_s: float, split: str) -> np.ndarray:
    records = data.records(data.in_split(split))
    own = Labelled.joined([labelled(record, window_s) for record in records])
    return heading_errors(estimate(own.windows).heading, own.heading)


def medians(report: Report, config: GenerateConfig) -> None:
    report.line(f"median |error| of the plain mean over 80 recordings, {SEEDS} seeds, deg")
    report.line("window  mean of medians  [95% of it]     2.5%..97.5% of medians   paper (over 16)")
    config = replace(config, output="means", split=[0, 0, 1])
    by_window: dict[float, list[float]] = {w: [] for w in paper.WINDOWS_S}
    for seed in tqdm(range(SEEDS), "seeds"):
        data = dataset(replace(config, seed=seed), f"seed{seed}")
        for window, found in by_window.items():
            e = errors(data, mean, window, "test")
            found.append(summarise(e, np.zeros(len(e))).median_deg)
    for window, found in by_window.items():
        low, high = np.percentile(found, [2.5, 97.5])
        a, b = interval95(np.array(found))
        published = paper.published(paper.MEDIAN_DEG, "baseline", window)
        report.line(
            f"{window:5g} s  {np.mean(found):12.2f}  [{a:.2f}, {b:.2f}]  {low:12.2f}..{high:.2f}"
            f"  {published:16.2f}"
        )
        report.summary[f"mean_of_medians_{window:g}s_deg"] = round(float(np.mean(found)), 3)


def units(report: Report, config: GenerateConfig) -> None:
    gyro = replace(config.imu.gyro, bias_unit_deg_per_h=1.0, bias_run_deg_per_h=0.0)
    config = replace(config, imu=replace(config.imu, gyro=gyro), output="means")
    config = replace(config, recordings=RECORDINGS, split=[60, 10, 30])
    report.line()
    report.line("all bias the unit's, 1 deg/h: RMSE at 60 s on held-out recordings, deg")
    report.line("unit_seed   mean  learned  ratio")
    ratios = []
    for seed in range(1, UNITS + 1):
        data = dataset(replace(config, unit_seed=seed), f"unit{seed}")
        run = lbgc.train.main(TrainConfig(data=str(data.path), steps=CASES["steps"]))
        rmse = [
            float(np.rad2deg(np.sqrt(np.mean(errors(data, e, 60.0, "test") ** 2))))
            for e in (mean, Learned.load(run))
        ]
        ratios.append(rmse[1] / rmse[0])
        report.line(f"{seed:9d}  {rmse[0]:5.2f}  {rmse[1]:7.2f}  {ratios[-1]:5.2f}")
    report.line(f"median ratio {np.median(ratios):.2f}")
    report.summary["learned_over_mean_60s_by_unit"] = [round(r, 3) for r in ratios]
    report.summary["learned_over_mean_60s_median"] = round(float(np.median(ratios)), 3)


if __name__ == "__main__":
    with Report("studies/baseline") as study:
        medians(study, default_config())
        units(study, default_config())
