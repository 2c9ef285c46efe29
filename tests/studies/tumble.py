"""Does the tumble find north as well as poses at rest allow, and does it say how well?

    make study-tumble

Every run is another sensor of its kind, in another session, in other attitudes and headings, drawn
by the sensor's own faces; between rests it turns evenly. The same log is answered as separate poses
and as an unbroken one. The bound is the van Trees bound in each run's own attitudes: runs whose
bound is below 6 degrees are held against it, and sigmas of those below 20 against errors; a case
qualifies where half of its runs do. Beside it
stands the linear answer: what that bound's own estimator, which is told the truth to be linear
about errs by on the same data: its mean square is the bound, and taken off as far as it differs
from that it takes most of the scatter with it. The plain figures stand beside, and the linear
answer's own normalised squared error, which is 1 where the data are as the model says. Errors of
one log's poses depend on each other (turns tie them together), so errors are over runs: a hundred
unbroken logs tell an NSE to 0.15 only, as the squares of a hundred normal errors do.

A few cases more are through MuJoCo, with protocol=tumble: a hand carries each sensor, which filters
and counts, from attitude to attitude, and its rests are found by themselves.
"""

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from common import Report, cases
from helpers import default_config
from tqdm import tqdm
from tumbled import LATITUDE, poses, sensor

import sim.generate
from lbgc import cores
from lbgc.attitudes import uniform
from lbgc.data.poses import Poses, poses_of
from lbgc.data.store import Dataset
from lbgc.errors import InputError
from lbgc.estimators.held import held
from lbgc.estimators.pose_information import form
from lbgc.estimators.torus import Torus
from lbgc.estimators.tumble import solved, tumble, turned_by
from lbgc.estimators.tumble_floor import small_errors
from lbgc.frames import euler_to_matrix
from lbgc.sensor.imu import ImuModel

CASES = cases("tumble")
KINDS = ("separate", "integrated")


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
    truth = uniform(rng, count)
    return answered(poses(rng, imu, truth, dwell_s), imu, truth)


def answered(log: Poses, imu: ImuModel, truth: np.ndarray) -> list[Run]:
    """A log, answered as of either kind. truth : (P, 3, 3), C_nb."""
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
    log = poses(rng, imu, uniform(rng, count), dwell_s, latitude=at, known=False)
    inside = []
    for integrated in (False, True):
        interval: tuple[float, float] | None = (-np.pi, np.pi)  # where nothing is told: anywhere
        with contextlib.suppress(InputError):
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
    as_lengths = bound < np.deg2rad(CASES["as_lengths_deg"]) ** 2
    normally = bound < np.deg2rad(CASES["normal_deg"]) ** 2
    # Less the linear answer's scatter, plus its mean: what is left scatters far less.
    steady, steady_normal = square - linear + bound, normal - linear_normal + 1
    return found | {
        "bound_deg": float(np.rad2deg(np.sqrt(bound.mean()))),
        "rmse_deg": float(np.rad2deg(np.sqrt(square.mean()))),
        "below_6": float(as_lengths.mean()),
        "below_20": float(normally.mean()),
        **_ratio("over_bound_all", square, bound),
        **_mean("nse_all", normal),
        **_ratio("over_bound", steady[as_lengths], bound[as_lengths]),
        **_ratio("over_bound_plain", square[as_lengths], bound[as_lengths]),
        **_mean("nse", steady_normal[normally]),
        **_mean("nse_plain", normal[normally]),
        **_mean("linear_nse", linear_normal[normally]),
    }


def _ratio(name: str, square: np.ndarray, bound: np.ndarray) -> dict[str, float]:
    """Root of the mean square over the mean bound, and its standard error."""
    if len(square) < 2:
        return {name: float("nan"), f"{name}_error": float("nan")}
    ratio = float(np.sqrt(max(square.mean() / bound.mean(), 0.0)))
    spread = (square - ratio**2 * bound).std(ddof=1) / np.sqrt(len(bound)) / bound.mean()
    return {name: ratio, f"{name}_error": float(spread / 2 / max(ratio, 1e-9))}


def _mean(name: str, values: np.ndarray) -> dict[str, float]:
    """A mean, and its standard error."""
    if len(values) < 2:
        return {name: float("nan"), f"{name}_error": float("nan")}
    error = values.std(ddof=1) / np.sqrt(len(values))
    return {name: float(values.mean()), f"{name}_error": float(error)}


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


def through_mujoco(study: Report, pool: ProcessPoolExecutor, drawn: Sequence[dict]) -> None:
    """Cases whose logs are of a hand in MuJoCo, beside those drawn: RMSE over bound, and NSE."""
    of, rows = CASES["mujoco"], []
    count, rate = of["recordings"], of["rate_hz"]
    seconds = of["poses"] * of["dwell_s"] + (of["poses"] - 1) * of["handling_s"]
    protocol = [f"protocol.{key}={of[key]}" for key in ("poses", "dwell_s", "handling_s")]
    for name in of["sensors"]:
        with tempfile.TemporaryDirectory() as home:
            config = default_config(
                "protocol=tumble", *protocol, f"imu={name}", f"latitude={np.rad2deg(LATITUDE)}",
                f"recordings={count}", f"units={count}", f"rate_hz={rate}",
                f"duration_s={seconds}", f"seed={CASES['seed']}", f"out={home}/held.zarr",
            )  # fmt: skip
            dataset = Dataset.open_finished(sim.generate.main(config))
            logs, truths = [], []
            for record in dataset.records(np.arange(count)):
                log = poses_of(record)
                assert record.held is not None
                assert record.held.attitude is not None
                middle = [(first + last) // 2 for first, last in log.rests]
                logs.append(log)
                truths.append(euler_to_matrix(*record.held.attitude[middle].T))
        found = pool.map(answered, logs, [config.imu.model(rate)] * count, truths)
        for kind, runs in zip(KINDS, zip(*found, strict=True), strict=True):
            own = {"imu": name, "kind": kind, "poses": of["poses"], "dwell_s": of["dwell_s"]}
            beside = [row for row in drawn if row.items() >= own.items()]
            rows.append(own | scored(runs))
            study.line(f"  {name:10s} {kind:11s} {_compared(rows[-1])}")
            for row in beside:
                study.line(f"  {'':10s} {'drawn':11s} {_compared(row)}")
    study.summary["mujoco"] = rows


def _compared(row: dict) -> str:
    """RMSE over bound and NSE, in words, over all runs of a case."""
    return (
        f"RMSE {row['rmse_deg']:.3f}, over the bound {row['over_bound_all']:.3f} +-"
        f"{row['over_bound_all_error']:.3f}, NSE {row['nse_all']:.3f} +-{row['nse_all_error']:.3f}"
    )


def main() -> None:
    with Report("studies/tumble") as study, ProcessPoolExecutor(cores.count()) as pool:
        study.line(
            f"poses in any attitudes, latitude {np.rad2deg(LATITUDE):g}, {CASES['runs']} runs a "
            "case; errors in degrees, RMS over poses and runs"
        )
        study.line(
            f"{'imu':11s}{'dwell':>6s}{'poses':>6s} {'kind':11s}{'refused':>8s}{'bound':>9s}"
            f"{'rmse':>9s}{'below 6':>9s}{'below 20':>9s}"
            + "".join(
                f"{name:>17s}" for name in ("over bound", "plain", "NSE", "plain", "linear NSE")
            )
        )
        found = []
        for row in rows(pool):
            found.append(row)
            study.line(
                f"{row['imu']:11s}{row['dwell_s']:6g}{row['poses']:6d} {row['kind']:11s}"
                f"{row['refused']:8d}{row['bound_deg']:9.3f}{row['rmse_deg']:9.3f}"
                f"{row['below_6']:9.0%}{row['below_20']:9.0%}"
                + "".join(
                    f"{row[key]:10.3f} +-{row[f'{key}_error']:5.3f}"
                    for key in ("over_bound", "over_bound_plain", "nse", "nse_plain", "linear_nse")
                )
            )
        small = [row for row in found if row["below_6"] >= 0.5]
        normal = [row for row in found if row["below_20"] >= 0.5]
        study.summary["rows"] = found
        study.summary["tumble_qualifying"] = {
            name: {
                f"{dwell:g}_s": sum(row["imu"] == name and row["dwell_s"] == dwell for row in small)
                for dwell in CASES["dwell_s"]
            }
            for name in CASES["sensors"]
        }
        study.line(
            "cases half of whose runs have a bound below 6 deg, of three poses and two kinds:"
        )
        study.line(f"  {study.summary['tumble_qualifying']}")
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
        of = CASES["mujoco"]
        study.line(f"through MuJoCo, {of['poses']} poses of {of['dwell_s']:g} s, handled for "
                   f"{of['handling_s']:g} s each, {of['recordings']} sensors:")  # fmt: skip
        through_mujoco(study, pool, found)
        study.line("how often the 95% interval of an unknown latitude holds it:")
        coverage(study, pool)


if __name__ == "__main__":
    main()
