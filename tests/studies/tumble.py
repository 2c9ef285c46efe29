"""Does the tumble find north as well as poses at rest allow, and does it say how well?

    make study-tumble

Every run is another sensor of its kind, in another session, in other attitudes and headings, drawn
by the sensor's own faces; between rests it turns evenly. The same log is answered as separate poses
and as an unbroken one. The bound is the van Trees bound in each run's own attitudes. Beside it
stands the linear answer: what that bound's own estimator, which is told the truth to be linear
about errs by on the same data: its mean square is the bound, and taken off as far as it differs
from that it takes most of the scatter with it. The plain figures stand beside, and the linear
answer's own normalised squared error, which is 1 where the data are as the model says. Errors of
one log's poses depend on each other (turns tie them together), so errors are over runs.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from common import Report, cases
from tqdm import tqdm
from tumbled import LATITUDE, poses, sensor

from lbgc import cores
from lbgc.errors import InputError
from lbgc.estimators.held import held
from lbgc.estimators.pose_information import form
from lbgc.estimators.torus import Torus
from lbgc.estimators.tumble import solved, tumble, turned_by
from lbgc.estimators.tumble_floor import attitudes, small_errors

CASES = cases("tumble")
KINDS = ("separate", "integrated")
FIGURES = [
    *("bound_deg", "rmse_deg", "over_bound", "over_bound_error", "over_bound_plain"),
    *("over_bound_plain_error", "nse", "nse_error", "nse_plain", "nse_plain_error"),
    *("linear_nse", "linear_nse_error"),
]


@dataclass(frozen=True)
class Run:
    """One log, in one of two kinds."""

    square: float
    """rad^2, mean over the poses of the squared error; NaN where the log is refused"""
    normal: float
    """The same of the error by its sigma"""
    bound: float
    """rad^2"""
    linear: float
    """rad^2, of the linear answer, whose mean is the bound where the data are as the model says"""
    linear_normal: float
    """Its squared errors by the bound's variances, whose mean is then one"""


def one(name: str, count: int, dwell_s: float, seed: Sequence[int]) -> list[Run]:
    """A log of each kind."""
    rng, imu = np.random.default_rng(seed), sensor(name)
    truth = attitudes(rng, count)
    log = poses(rng, imu, truth, dwell_s)
    found = []
    for integrated in (False, True):
        own = replace(log, integrated=integrated)
        of = solved(held(own, imu), imu, "either")[0]
        heading = turned_by(truth, of.base)
        spread = small_errors(of, imu, heading)
        told = Torus(form(of, imu, heading))
        left = told.of.h - told.of.J @ told.v(heading)
        linear = spread @ told.slopes(heading[None])[0].T @ left
        square = normal = np.nan
        try:
            answer = tumble(own, imu)
        except InputError:
            pass
        else:
            off = turned_by(answer.attitude, truth)
            square, normal = float(np.mean(off**2)), float(np.mean((off / answer.sigma) ** 2))
        sizes = np.diag(spread)
        found.append(
            Run(
                square,
                normal,
                float(sizes.mean()),
                float(np.mean(linear**2)),
                float(np.mean(linear**2 / sizes)),
            )
        )
    return found


def latitude(name: str, count: int, dwell_s: float, seed: Sequence[int]) -> list[bool]:
    """Whether the latitude's interval holds it, of a log of each kind."""
    rng, imu = np.random.default_rng(seed), sensor(name)
    at = float(np.arcsin(rng.uniform(-1, 1)))
    log = poses(rng, imu, attitudes(rng, count), dwell_s, latitude=at, known=False)
    inside = []
    for integrated in (False, True):
        interval = tumble(replace(log, integrated=integrated), imu).latitude_interval
        assert interval is not None
        inside.append(interval[0] < at < interval[1])
    return inside


def rows(pool: ProcessPoolExecutor) -> Iterator[dict[str, object]]:
    every = list(product(CASES["sensors"], CASES["dwell_s"], CASES["poses"]))
    for case, (name, dwell, count) in enumerate(tqdm(every, "tumbling", leave=False)):
        n = CASES["runs"]
        seeds = [(CASES["seed"], case, run) for run in range(n)]
        found = list(pool.map(one, [name] * n, [count] * n, [dwell] * n, seeds))
        for kind, runs in zip(KINDS, zip(*found, strict=True), strict=True):
            yield {"imu": name, "kind": kind, "poses": count, "dwell_s": dwell, **scored(runs)}


def scored(runs: Sequence[Run]) -> dict[str, float]:
    """What a case's runs show."""
    every = np.array(
        [(run.square, run.normal, run.bound, run.linear, run.linear_normal) for run in runs]
    )
    good = np.isfinite(every[:, 0])
    found: dict[str, float] = {"refused": int((~good).sum())}
    square, normal, bound, linear, linear_normal = every[good].T
    if good.sum() < 2:
        return found | dict.fromkeys(FIGURES, float("nan"))
    size, root = bound.mean(), np.sqrt(good.sum())
    # Less the linear answer's scatter, plus its mean: what is left scatters far less.
    steady, steady_normal = square - linear + bound, normal - linear_normal + 1
    values = {
        "bound_deg": np.rad2deg(np.sqrt(size)),
        "rmse_deg": np.rad2deg(np.sqrt(square.mean())),
        "over_bound": np.sqrt(max(steady.mean(), 0.0) / size),
        "over_bound_error": (steady - bound).std(ddof=1) / root / size / 2,
        "over_bound_plain": np.sqrt(square.mean() / size),
        "over_bound_plain_error": (square - bound).std(ddof=1) / root / size / 2,
        "nse": steady_normal.mean(),
        "nse_error": steady_normal.std(ddof=1) / root,
        "nse_plain": normal.mean(),
        "nse_plain_error": normal.std(ddof=1) / root,
        "linear_nse": linear_normal.mean(),
        "linear_nse_error": linear_normal.std(ddof=1) / root,
    }
    assert list(values) == FIGURES
    return found | {key: float(value) for key, value in values.items()}


def coverage(study: Report, pool: ProcessPoolExecutor) -> None:
    of, inside = CASES["latitude"], []
    every = product(of["sensors"], of["dwell_s"], of["poses"])
    for case, (name, dwell, count) in enumerate(every):
        n = of["runs"]
        seeds = [(CASES["seed"], 1000 + case, run) for run in range(n)]
        found = np.array(list(pool.map(latitude, [name] * n, [count] * n, [dwell] * n, seeds)))
        inside.append(found.ravel())
        shares = ", ".join(f"{k} {v:.0%}" for k, v in zip(KINDS, found.mean(axis=0), strict=True))
        study.line(f"  {name:10s} {count:3d} poses of {dwell:g} s: {shares}")
    joint = np.concatenate(inside)
    share, error = joint.mean(), np.sqrt(joint.mean() * (1 - joint.mean()) / len(joint))
    study.line(f"  together {share:.1%} of {len(joint)} (standard error {error:.1%})")
    study.summary["latitude_interval_coverage_percent"] = round(100 * float(share), 2)
    study.summary["latitude_interval_coverage_error_percent"] = round(100 * float(error), 2)


def main() -> None:
    with Report("studies/tumble") as study, ProcessPoolExecutor(cores.count()) as pool:
        study.line(
            f"poses in any attitudes, latitude {np.rad2deg(LATITUDE):g}, {CASES['runs']} runs a "
            "case; errors in degrees, RMS over poses and runs"
        )
        study.line(
            f"{'imu':11s}{'dwell':>6s}{'poses':>6s} {'kind':11s}{'refused':>8s}{'bound':>9s}"
            f"{'rmse':>9s}{'over bound':>17s}{'plain':>17s}{'NSE':>17s}{'plain':>17s}"
            f"{'linear NSE':>17s}"
        )
        found = []
        for row in rows(pool):
            found.append(row)
            study.line(
                f"{row['imu']:11s}{row['dwell_s']:6g}{row['poses']:6d} {row['kind']:11s}"
                f"{row['refused']:8d}{row['bound_deg']:9.3f}{row['rmse_deg']:9.3f}"
                + "".join(
                    f"{row[key]:10.3f} +-{row[f'{key}_error']:5.3f}"
                    for key in ("over_bound", "over_bound_plain", "nse", "nse_plain", "linear_nse")
                )
            )
        small = [row for row in found if row["bound_deg"] < CASES["as_lengths_deg"]]
        normal = [row for row in found if row["bound_deg"] < CASES["normal_deg"]]
        study.summary["rows"] = found
        study.summary["tumble_qualifying"] = {
            name: {
                f"{dwell:g}_s": sum(row["imu"] == name and row["dwell_s"] == dwell for row in small)
                for dwell in CASES["dwell_s"]
            }
            for name in CASES["sensors"]
        }
        study.line(f"cases with a bound below 6 deg: {study.summary['tumble_qualifying']}")
        if small:
            most = max(small, key=lambda row: row["over_bound"])
            study.summary |= {
                "tumble_over_bound_max": most["over_bound"],
                "tumble_over_bound_max_error": most["over_bound_error"],
                "tumble_over_bound_plain_max": max(row["over_bound_plain"] for row in small),
            }
        if normal:
            study.summary |= {
                "tumble_nees_min": min(row["nse"] for row in normal),
                "tumble_nees_max": max(row["nse"] for row in normal),
                "tumble_nees_error_max": max(row["nse_error"] for row in normal),
                "tumble_nees_plain_min": min(row["nse_plain"] for row in normal),
                "tumble_nees_plain_max": max(row["nse_plain"] for row in normal),
                "tumble_linear_nees_mean": float(np.mean([row["linear_nse"] for row in normal])),
            }
        study.line("how often the 95% interval of an unknown latitude holds it:")
        coverage(study, pool)


if __name__ == "__main__":
    main()
