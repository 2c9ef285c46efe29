"""The paper's hyperparameter table, regenerated: parameters, latency, and error with its spread.

    make study-hyperparameters

The paper does not say what it timed; ours is one call of the estimator on one four-minute
window at the means rate, the features included, by PyTorch and by ONNX Runtime.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from common import Report, cases
from helpers import ROOT, composed, default_config
from scoring import first, scored

import lbgc.train
import sim.generate
from lbgc.data.store import Dataset
from lbgc.data.windows import Windows
from lbgc.estimators.static import mean
from lbgc.learning import onnx
from lbgc.learning.description import DESCRIPTION
from lbgc.learning.estimator import Learned
from lbgc.report import paper
from lbgc.train import TrainConfig

CASES = cases("hyperparameters")
DIRECTORY = Path("outputs/studies/hyperparameters")


def dataset(part: str, recordings: int, seed: int, split: str) -> Dataset:
    whole, left = CASES["bias_deg_per_h"], CASES["bias_left_deg_per_h"]
    config = default_config(
        "protocol=static",
        f"imu.gyro.bias_unit_deg_per_h={np.sqrt(whole**2 - left**2):.6f}",
        f"imu.gyro.bias_run_deg_per_h={left}",
        f"out={DIRECTORY}/{part}.zarr",
        "output=means",
        f"recordings={recordings}",
        f"seed={seed}",
        f"unit_seed={CASES['unit_seed']}",
        f"split={split}",
    )
    return Dataset.open_finished(sim.generate.main(config))


def latency_ms(estimate: Callable, window: Windows) -> float:
    """Median of 100 calls."""
    taken = []
    for _ in range(100):
        started = time.perf_counter()
        estimate(window)
        taken.append(time.perf_counter() - started)
    return 1e3 * float(np.median(taken))


def exported(run: Path) -> Learned:
    """By a process of its own: PyTorch 2.13's exporter fixes the length of a second network
    that has one recurrent layer."""
    command = [sys.executable, str(ROOT / "lbgc/export.py"), f"run={run}"]
    subprocess.run(command, check=True, capture_output=True)
    return onnx.load(run / "model.onnx")


def main() -> None:
    with Report("studies/hyperparameters") as report:
        train = dataset("train", CASES["train_recordings"], CASES["seed"], "[90,10,0]")
        test = dataset("test", CASES["test_recordings"], CASES["seed"] + 1, "[0,0,1]")
        records = list(test.records(np.arange(len(test))))
        tested = first(records, CASES["window_s"])
        base = scored(iter([tested]), {"mean": mean}, None)["mean"].rmse_deg
        report.line(f"{CASES['window_s']} s, {len(test)} recordings; plain mean {base:.2f} "
                    f"deg; RMSE: mean and deviation over {len(CASES['seeds'])} seeds")  # fmt: skip
        report.line(f"{'model':13s} {'parameters':>10s} {'paper':>6s}   {'PyTorch':>7s} "
                    f"{'ONNX':>6s} {'paper':>6s} ms   {'RMSE, deg':>12s} {'paper':>12s}   "
                    "training")  # fmt: skip
        for model, options in CASES["models"].items():
            errors, seconds = [], []
            for seed in CASES["seeds"]:
                steps = () if any("steps=" in o for o in options) else (f"steps={CASES['steps']}",)
                asked = (f"data={train.place}", f"model={model}", f"seed={seed}", *steps, *options)
                run = lbgc.train.main(composed(TrainConfig, "train", *asked))
                learned, said = Learned.load(run), json.loads((run / DESCRIPTION).read_text())
                errors.append(scored(iter([tested]), {model: learned}, None)[model].rmse_deg)
                seconds.append(said["seconds"])
            one = tested.windows.rows(slice(0, 1))
            times = latency_ms(learned, one), latency_ms(exported(run), one)
            size = learned.config.layers, learned.config.hidden
            theirs = ("-", "-", "-")
            if learned.config.cell == "lstm":
                off = "{:.2f} +- {:.2f}".format(*paper.ERROR_DEG[size])
                theirs = f"{paper.PARAMETERS[size]}", f"{paper.LATENCY_MS[size]:.2f}", off
            error = float(np.mean(errors)), float(np.std(errors, ddof=1))
            report.line(
                f"{model:13s} {said['parameters']:10d} {theirs[0]:>6s}   {times[0]:7.2f} "
                f"{times[1]:6.2f} {theirs[1]:>6s} ms   {error[0]:5.2f} +- {error[1]:.2f} "
                f"{theirs[2]:>13s}   {np.median(seconds) / 60:.1f} min"
            )
            report.summary[model] = {
                "parameters": said["parameters"],
                "torch_latency_240s_ms": times[0],
                "onnx_latency_240s_ms": times[1],
                "rmse_deg": error,
                "train_minutes": float(np.median(seconds)) / 60,
            }


if __name__ == "__main__":
    main()
