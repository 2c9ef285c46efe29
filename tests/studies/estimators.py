"""How far is every classical estimator from the best that physics allows, and is its sigma true?

    make study-estimators
    PYTHONPATH=tests:tests/studies .venv/bin/python tests/studies/estimators.py sway real_log

The second runs only the parts named (estimators.yaml lists them all), and its summary has their
figures alone. Recordings are drawn by the product's generator (full sensors, exact block means),
never from the covariance that the bound is made of. Every ratio is paired, over independent
recordings.
"""

import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import scipy.linalg
from common import Report, cases
from helpers import REAL_LOGS, composed, default_config, labelled
from scipy.signal import lfilter
from scoring import Scores, first_windows, named, scored
from simulated import swaying
from tqdm import tqdm

import sim.generate
from lbgc.data import logs
from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled, at_rate
from lbgc.errors import require_choice
from lbgc.estimators import CLASSICAL
from lbgc.estimators.block_means import Site, levelled
from lbgc.estimators.error_patterns import ANY_TILT, causes, factors, patterns, signal
from lbgc.estimators.floor import course_of, crlb, floor, white_crlb
from lbgc.estimators.information import Information, information
from lbgc.evaluate import EvaluateConfig
from lbgc.frames import rotation_z, wrap
from lbgc.report import paper
from lbgc.report.figures import error_against_window, png
from lbgc.sensor.imu import ImuModel
from sim.generate import GenerateConfig

CASES = cases("estimators")
DIRECTORY = Path("outputs/studies/estimators")
WHITE_ONLY = (
    "imu=ideal",
    "imu.gyro.arw_deg_per_sqrt_h=0.031",
    "protocol=static",
)


@dataclass(frozen=True)
class Case:
    """A dataset as means."""

    name: str
    options: tuple[str, ...]
    recordings: int
    mean_s: float

    @cached_property
    def config(self) -> GenerateConfig:
        return default_config(
            f"latitude={CASES['latitude']}",
            *self.options,
            f"out={DIRECTORY}/data/{self.name}.zarr",
            f"recordings={self.recordings}",
            f"seed={CASES['seed']}",
            *(("output=means", f"mean_s={self.mean_s}") if self.mean_s else ()),
            "units=1000000",  # each recording's own, so that a unit's errors are drawn afresh
        )

    @cached_property
    def imu(self) -> ImuModel:
        return self.config.imu.model(self.config.rate_hz)


def generated(case: Case) -> Dataset:
    return Dataset.open_finished(sim.generate.main(case.config))


def told(imu: ImuModel, protocol: str, latitude_deg: float, window_s: float) -> Information:
    config = default_config(f"protocol={protocol}").protocol
    site = Site.at(float(np.deg2rad(latitude_deg)))
    return information(imu, course_of(config, window_s), site)


def white_cases() -> dict[str, Case]:
    c = CASES["white"]
    own = {"white": Case("white", WHITE_ONLY, c["recordings"], c["mean_s"])}
    for latitude in c["latitudes"]:
        options = (*WHITE_ONLY, f"latitude={latitude}")
        name = f"white_{latitude}"
        own[name] = Case(name, options, c["latitude_recordings"], c["latitude_mean_s"])
    return own


def white(report: Report, data: Mapping[str, Dataset], cases: Mapping[str, Case]) -> None:
    report.line("white noise only: variance over the closed form N^2/(Omega^2 cos^2(lat) T)")
    report.line("latitude  window  recordings  crlb, deg    mean     gls   [sampling error]")
    ratios = []
    rows = [("white", CASES["latitude"], w) for w in CASES["white"]["windows_s"]]
    rows += [(f"white_{lat}", lat, 240) for lat in CASES["white"]["latitudes"]]
    for name, latitude, window in rows:
        imu = cases[name].imu
        closed = white_crlb(imu.gyro.N[0], np.deg2rad(latitude), window)
        found = scored(first_windows(data[name], window), named("mean", "gls"), imu)
        own = [float(np.mean(s.errors**2) / closed**2) for s in found.values()]
        count = len(found["mean"].errors)
        said = "   ".join(f"{r:.4f}" for r in own)
        report.line(f"{latitude:8g}  {window:4g} s  {count:10d}  {np.rad2deg(closed):9.3f}  "
                    f"{said}   {np.sqrt(2 / count):.4f}")  # fmt: skip
        ratios += own
    report.summary["white_variance_over_crlb_min"] = min(ratios)
    report.summary["white_variance_over_crlb_max"] = max(ratios)


def general_form_case() -> Case:
    c = CASES["general_form"]
    options = ("imu=ideal", "protocol=static", f"imu.gyro.bias_run_deg_per_h={c['gyro_deg_per_h']}",
               f"imu.accel.bias_run_mg={c['accel_mg']}", f"latitude={c['latitude']}")  # fmt: skip
    return Case("general_form", options, c["recordings"], 240.0)


def general_form(report: Report, data: Dataset) -> None:
    """Least squares of the error on its four predicted parts: each coefficient is 1."""
    own = next(first_windows(data, 240.0, batch=len(data)))
    error = wrap(CLASSICAL["mean"](own.windows, None).heading - own.heading)
    gyro, accel = data.label("gyro_bias_run"), data.label("accel_bias_run")
    latitude = own.windows.latitude[0]
    site = Site.at(float(latitude))
    s, c = np.sin(own.heading), np.cos(own.heading)
    parts = np.stack(
        [
            -gyro[:, 0] * s / site.north,
            -gyro[:, 1] * c / site.north,
            np.tan(latitude) * accel[:, 0] * s / site.gravity,
            np.tan(latitude) * accel[:, 1] * c / site.gravity,
        ],
        axis=1,
    )
    found = np.linalg.lstsq(parts, error, rcond=None)[0]
    left = np.rad2deg(np.abs(error - parts.sum(axis=1)).max())
    report.line()
    report.line(f"error as dw_x, dw_y, df_x, df_y predict, {len(error)} headings, latitude "
                f"{np.rad2deg(latitude):g}: coefficients {np.round(found, 4).tolist()}, worst "
                f"difference {left:.4f} deg of {np.rad2deg(np.abs(error).max()):.2f}")  # fmt: skip
    report.summary["general_form_coefficients"] = found.round(5).tolist()
    report.summary["general_form_worst_deg"] = float(left)


def gaussian_cases() -> dict[str, Case]:
    c = CASES["gaussian"]
    return {
        f"bias_{b}": Case(
            f"bias_{b}",
            ("protocol=static", f"imu.gyro.bias_run_deg_per_h={b}"),
            CASES["recordings"],
            c["mean_s"],
        )
        for b in c["bias_run_deg_per_h"]
    }


def gaussian(report: Report, data: Mapping[str, Dataset], cases: Mapping[str, Case]) -> None:
    report.line()
    report.line("full Gaussian model, static, 240 s: degrees; NSE of gls")
    report.line(
        "run bias   floor [95%]         crlb   gls/floor [95%]          floor/crlb [2 se]  NSE"
    )
    worst_gls, worst_floor = [], []
    for name, case in cases.items():
        found = scored(first_windows(data[name], 240), named("gls", "floor"), case.imu)
        least, count = found["floor"], len(found["floor"].errors)
        over = found["gls"].over(least)
        worst_gls.append(over.high)
        closed = np.rad2deg(crlb(told(case.imu, "static", CASES["latitude"], 240)))
        half = 1.96 / np.sqrt(2 * count) * least.rmse_deg
        beside = "    -              "
        if np.isfinite(closed):
            ratio, spread = least.rmse_deg / closed, least.rmse_deg / closed / np.sqrt(2 * count)
            worst_floor.append((ratio, spread))
            beside = f"{ratio:.4f} +- {2 * spread:.4f}  "
        report.line(
            f"{name[5:]:>5s} deg/h {least.rmse_deg:7.3f} +- {half:.3f}  "
            f"{f'{closed:8.3f}' if np.isfinite(closed) else '       -'}   {over.value:.4f} "
            f"({over.low:.4f} to {over.high:.4f})  {beside} {found['gls'].nse:.3f}"
        )
        report.summary[f"floor_bias_{name[5:]}_deg_per_h_deg"] = round(least.rmse_deg, 3)
    report.summary["gls_over_floor_max"] = max(worst_gls)
    report.summary["floor_over_crlb_max"] = max(r for r, _ in worst_floor)
    report.summary["floor_over_crlb_beyond_standard_errors"] = max(
        max((r - 1.01) / s, (1.0 - r) / s) for r, s in worst_floor
    )


def brute_force(report: Report, data: Dataset, case: Case) -> None:
    """The floor's circular mean against integrating over heading the likelihood of the data
    themselves, three block means a channel, tilts having a prior so wide that it is flat."""
    some = next(first_windows(data, 240.0, CASES["gaussian"]["brute_force"]))
    windows = at_rate(some.windows, 3 / 240)
    found = floor(windows, case.imu)
    part = levelled(windows, case.imu.dt)[0]
    B, psi = patterns(case.imu, part.course), np.deg2rad(np.arange(0, 360, 0.01))
    q, worst = np.stack([np.cos(psi), np.sin(psi)]), 0.0

    def column(coefficients: np.ndarray) -> np.ndarray:
        return (coefficients @ B.T).reshape(-1)  # of six channels by three blocks

    for row, base, own in zip(part.rows, part.base, part.body.reshape(-1, 18), strict=True):
        felt = signal(base[None], part.site)
        C = scipy.linalg.block_diag(*(L @ L.T for L in factors(case.imu, part.course)))
        for drawn in causes(case.imu, base[None], part.site).values():
            for one in drawn[0]:
                C += np.outer(column(one), column(one))
        size = np.sqrt(np.diag(C))
        for tilt in felt.tilt:
            C += ANY_TILT**2 * np.outer(column(tilt[0]), column(tilt[0]))
        precision = np.linalg.inv(C / np.outer(size, size))
        means = np.stack([column(of[0]) for of in felt.q], axis=1) / size[:, None] @ q
        left = ((own - column(felt.known[0])) / size)[:, None] - means
        log_p = -0.5 * np.sum(left * (precision @ left), axis=0)
        mean = np.angle(np.sum(np.exp(log_p - log_p.max() + 1j * psi)))
        worst = max(worst, abs(float(wrap(mean - found.heading[row]))))
    report.line(f"floor against integration over the data themselves, {len(part.rows)} recordings")
    report.line(f"of three blocks: worst difference {np.rad2deg(worst):.1e} deg")
    report.summary["floor_against_brute_force_deg"] = float(np.rad2deg(worst))


def protocol_cases() -> dict[str, Case]:
    c = CASES["protocols"]
    kinds = [k for k in c if isinstance(c[k], list)]
    return {k: Case(k, (f"protocol={k}",), CASES["recordings"], c["mean_s"]) for k in kinds}


def protocols(report: Report, data: Mapping[str, Dataset], cases: Mapping[str, Case]) -> None:
    c = CASES["protocols"]
    report.line()
    report.line("sdc500, 1 deg/h of run bias, 240 s, slews and settling inside")
    report.line(
        "protocol       estimator                 RMSE, deg  over the floor [95%]       NSE"
    )
    told_by: dict[str, dict[str, Scores]] = {}
    for name, case in cases.items():
        found = scored(first_windows(data[name], c["window_s"]), named(*c[name], "floor"), case.imu)
        told_by[name] = found
        for estimator, own in found.items():
            over = own.over(found["floor"])
            ratio = f"{over.value:.4f} ({over.low:.4f} to {over.high:.4f})"
            report.line(
                f"{name:13s}  {estimator:24s}  {own.rmse_deg:9.3f}  {ratio:25s}  {own.nse:.3f}"
            )
            if estimator != "floor":
                report.summary[f"{name}_{estimator}_over_floor"] = round(over.high, 4)
                _note_nees(f"{estimator} on {name}", own)
    two, turning = told_by["two_position"], told_by["carousel"]
    report.summary |= {
        "two_position_weighted_over_floor": two["two_position_weighted"].over(two["floor"]).high,
        "two_position_plain_over_floor": two["two_position"].over(two["floor"]).high,
        "carousel_weighted_over_floor": turning["carousel_weighted"].over(turning["floor"]).high,
        "two_position_240s_rmse_deg": two["two_position_weighted"].rmse_deg,
        "carousel_240s_rmse_deg": turning["carousel_weighted"].rmse_deg,
        "static_240s_rmse_deg": told_by["static"]["mean"].rmse_deg,
    }


_NEES: dict[str, tuple[float, float, int]] = {}
"""Of estimators on data of their own assumptions: value, standard error, recordings."""


def _note_nees(name: str, own: Scores) -> None:
    _NEES[name] = own.nse, own.nse_error, len(own.errors)


def paper_cases() -> dict[str, Case]:
    c = CASES["paper"]
    return {
        f"paper_{b}": Case(
            f"paper_{b}",
            ("protocol=static", f"imu.gyro.bias_run_deg_per_h={b}"),
            c["recordings"],
            c["mean_s"],
        )
        for b in c["bias_run_deg_per_h"]
    }


def paper_baseline(report: Report, data: Mapping[str, Dataset], cases: Mapping[str, Case]) -> None:
    """Medians of the plain mean's error over sixteen recordings, against the five published."""
    c = CASES["paper"]
    rng = np.random.default_rng(CASES["seed"])
    published = paper.MEDIAN_DEG["baseline"]
    report.line()
    report.line("the paper's baseline: 95% range of the median over 16 recordings, deg")
    report.line(
        "run bias   " + "".join(f"{w:g} s".rjust(15) for w in paper.WINDOWS_S) + "   inside"
    )
    report.line("published  " + "".join(f"{m:.2f}".rjust(15) for m in published))
    inside = {}
    for name, case in cases.items():
        picks = rng.integers(case.recordings, size=(c["sixteens"], 16))
        cells, hits = [], 0
        for window, median in zip(paper.WINDOWS_S, published, strict=True):
            windows = first_windows(data[name], window)
            own = scored(windows, named("mean"), case.imu, against="reference")["mean"]
            medians = np.median(np.abs(np.rad2deg(own.errors))[picks], axis=1)
            low, high = np.percentile(medians, [2.5, 97.5])
            hits += low <= median <= high
            cells.append(f"{low:.2f} to {high:.2f}".rjust(15))
        inside[float(name.split("_")[1])] = int(hits)
        report.line(f"{name[6:]:>4s} deg/h " + "".join(cells) + f"   {hits} of 5")
    accepted = [b for b, hits in inside.items() if hits == 5]
    report.line(f"run biases that the paper's figures accept: {accepted} deg/h")
    report.summary["paper_baseline_medians_inside"] = inside[1.0]
    report.summary["paper_baseline_accepts_deg_per_h"] = accepted


def sway_windows(
    resonance: tuple[float, float] | None, part: int, turn: float = 0.0, from_rest: bool = False
) -> Labelled:
    """Bodies at rest on average, or turning about z (rad/s), whose site's velocity is white, or
    white through a resonator; from_rest : and zero where a window starts."""
    c = CASES["sway"]
    rng = np.random.default_rng((CASES["seed"], part))
    n, lead, count = round(c["duration_s"] * c["rate_hz"]), 1000, c["windows"] // 4
    velocity = c["velocity_m_per_s"] * rng.standard_normal((count, n + lead + 1, 3))
    if resonance is not None:
        w0 = 2 * np.pi * resonance[0] / c["rate_hz"]
        r = np.exp(-resonance[1] * w0)
        velocity = lfilter([1], [1, -2 * r * np.cos(w0), r * r], velocity, axis=1)
    velocity = velocity[:, lead:]
    if from_rest:
        velocity[:, 0] = 0.0
    lean = (0.0, 0.0) if turn else (2.0, -3.0)
    return swaying(count, c["duration_s"], c["rate_hz"], 34.0, lean, velocity, seed=part, turn=turn)


def biased_windows(imu: ImuModel, turn: float, part: int) -> Labelled:
    """The same with a run's bias on each gyro."""
    own = sway_windows(None, part, turn)
    rng = np.random.default_rng((CASES["seed"], 1000 + part))
    bias = rng.standard_normal((len(own), 1, 3)) * imu.gyro.bias("run")
    return replace(own, windows=replace(own.windows, gyro=own.windows.gyro + bias))


def own_sways(report: Report) -> None:
    """Of the forms that assume more: a start at rest, and gyros with constant biases."""
    c = CASES["sway"]
    size = c["bias_run_deg_per_h"]
    imu = default_config("imu=ideal", f"imu.gyro.bias_run_deg_per_h={size}").imu.model(c["rate_hz"])
    rest = (sway_windows(None, part, from_rest=True) for part in range(4))
    of_textbook = "white velocity from rest", scored(rest, named("oba_textbook"), None)
    of_bias = (
        (f"{size} deg/h, {label}",
         scored((biased_windows(imu, np.deg2rad(turn), part) for part in range(4)),
                named("oba_bias"), imu))
        for label, turn in c["bias_turns_deg_per_s"].items()
    )  # fmt: skip
    for name, found in (of_textbook, *of_bias):
        for estimator, own in found.items():
            report.line(f"{name:24s} {estimator:14s} {own.rmse_deg:8.3f}  {own.nse:.3f}")
            _note_nees(f"{estimator}, {name}", own)


def sway(report: Report, vehicle: Dataset, case: Case) -> None:
    c = CASES["sway"]
    names = ["oba", "oba_interval", "oba_textbook"]
    report.line()
    report.line(f"swaying bases: RMSE, deg, and NSE; {c['windows']} windows of {c['duration_s']} s")
    for name, resonance in c["resonances"].items():
        found = scored((sway_windows(resonance, part) for part in range(4)), named(*names), None)
        for estimator, own in found.items():
            report.line(f"{name:24s} {estimator:14s} {own.rmse_deg:8.3f}  {own.nse:.3f}")
            if estimator != "oba_textbook":  # its zero initial velocity is not so here
                _note_nees(f"{estimator}, {name}", own)
    own_sways(report)
    for window in c["vehicle_windows_s"]:
        every = named(*names, "oba_bias", "ekf", "mean")
        found = scored(first_windows(vehicle, window, 50), every, case.imu)
        for estimator, own in found.items():
            label = f"vehicle scene, {window} s"
            report.line(f"{label:24s} {estimator:14s} {own.rmse_deg:8.3f}  {own.nse:.3f}")


def vehicle_case() -> Case:
    c = CASES["sway"]
    return Case("vehicle", tuple(c["vehicle"]), c["vehicle_recordings"], 0.0)


def real_log(report: Report) -> None:
    c = CASES["real_log"]
    config = composed(EvaluateConfig, "evaluate", "log=lasergyro", "imu=lasergyro")
    assert config.log is not None
    assert config.imu is not None
    record = next(iter(logs.read(config.log)))
    imu = config.imu.model(record.rate_hz)
    names = ["mean", "oba_textbook", "oba_interval", "oba", "oba_bias", "ekf"]
    report.line()
    report.line("lasergyro, whole log, against its reference: RMSE, deg; NSE")
    curves: dict[str, tuple[list[float], list[float]]] = {n: ([], []) for n in names}
    for window in c["windows_s"]:
        found = scored(iter([labelled(record, window)]), named(*names), imu)
        for name, own in found.items():
            report.line(f"{window:5g} s  {name:14s} {own.rmse_deg:8.3f}  {own.nse:8.3g}")
            curves[name][0].append(window)
            curves[name][1].append(own.rmse_deg)
        report.summary[f"lasergyro_{window}s_rmse_deg"] = found["oba"].rmse_deg
    (DIRECTORY / "lasergyro.png").write_bytes(png(error_against_window(curves)))
    whole = labelled(record, c["turned_windows_s"])
    windows = whole.windows
    own = scored(iter([whole]), named("oba"), imu)["oba"]
    order, half = np.argsort(own.sigma), len(own.sigma) // 2
    halves = [np.sqrt(np.mean(own.errors[part] ** 2)) for part in (order[:half], order[half:])]
    report.summary["lasergyro_sigma_halves_ratio"] = float(halves[0] / halves[1])
    straight, worst = CLASSICAL["oba"](windows, imu).heading, 0.0
    for degrees in tqdm(range(0, 360, c["angles_deg"]), "turning", leave=False):
        R = rotation_z(np.deg2rad(degrees))
        turned = replace(windows, gyro=windows.gyro @ R, accel=windows.accel @ R)
        off = wrap(CLASSICAL["oba"](turned, imu).heading - straight - np.deg2rad(degrees))
        worst = max(worst, float(np.abs(np.rad2deg(off)).max()))
    report.line(f"the half with the smaller sigma over the other half, {c['turned_windows_s']} s: "
                f"{halves[0] / halves[1]:.3f}; turned about z, worst {worst:.4f} deg")  # fmt: skip
    report.summary["lasergyro_turned_worst_deg"] = worst


def stated_sigmas(report: Report) -> None:
    report.line()
    report.line(
        "stated sigma: mean normalised squared error on data of the estimator's assumptions"
    )
    for name, (value, error, count) in _NEES.items():
        outside = "" if 0.9 <= value <= 1.1 else "   OUTSIDE 0.9 to 1.1"
        report.line(f"{name:36s} {value:.3f} +- {error:.3f}  {count}{outside}")
    report.summary["nees_min"] = min(value for value, _, _ in _NEES.values())
    report.summary["nees_max"] = max(value for value, _, _ in _NEES.values())


@dataclass(frozen=True)
class Part:
    cases: Mapping[str, Case]
    run: Callable[[Report, Mapping[str, Dataset], Mapping[str, Case]], None]


def parts() -> dict[str, Part]:
    def general(report: Report, data: Mapping[str, Dataset], _: Mapping[str, Case]) -> None:
        general_form(report, data["general_form"])

    def bounds(report: Report, data: Mapping[str, Dataset], own: Mapping[str, Case]) -> None:
        gaussian(report, data, own)
        brute_force(report, data["bias_1"], own["bias_1"])

    def moving(report: Report, data: Mapping[str, Dataset], own: Mapping[str, Case]) -> None:
        sway(report, data["vehicle"], own["vehicle"])

    def log(report: Report, _: Mapping[str, Dataset], __: Mapping[str, Case]) -> None:
        if (REAL_LOGS / "lasergyro.imu").exists():
            real_log(report)
        else:
            report.line("lasergyro is left out: no recording under $LBGC_REAL_LOGS")

    return {
        "white": Part(white_cases(), white),
        "general_form": Part({"general_form": general_form_case()}, general),
        "gaussian": Part(gaussian_cases(), bounds),
        "protocols": Part(protocol_cases(), protocols),
        "paper": Part(paper_cases(), paper_baseline),
        "sway": Part({"vehicle": vehicle_case()}, moving),
        "real_log": Part({}, log),
    }


def main(names: Sequence[str]) -> None:
    asked = {name: part for name, part in parts().items() if name in names}
    cases = {name: case for part in asked.values() for name, case in part.cases.items()}
    with Report("studies/estimators") as report:
        with ProcessPoolExecutor(2, get_context("spawn")) as pool:
            done = pool.map(generated, cases.values())
            data = dict(zip(cases, tqdm(done, "datasets", len(cases)), strict=True))
        for part in asked.values():
            part.run(report, data, part.cases)
        if _NEES:
            stated_sigmas(report)
    shutil.rmtree(DIRECTORY / "data", ignore_errors=True)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        require_choice("part", name, CASES["parts"])
    main(sys.argv[1:] or CASES["parts"])
