"""What can k labelled recordings of one unit teach, and does `calibrate` teach it all?

    make study-unit

1. The curve: the error of one more recording's heading against k, for shares of the bias's variance
   that repeats. Datasets of many units; of each unit k recordings with their references go through
   the unit's file, and one more is answered by `gls`. Beside floor(k), of one dense Gaussian of all
   k + 1 recordings (tests/unit_floor.py).
2. The same where nobody knows how the bias splits: splits are drawn from their prior, the file's
   posterior is over them, and floor(k) is the mixture over them.
3. The published means of one SDC500 unit: the verdict, and headings with a constant and without.

What networks learn from k is trained by make study-unit-learners, for hours; its points are put on
the curve as it left them, with their date.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from common import Report, cases
from helpers import REAL_LOGS, composed, default_config
from matplotlib.figure import Figure
from scoring import Scores
from tqdm import tqdm
from unit_floor import UnitFloor, estimate, simplex
from unit_learners_picture import shown

import sim.generate
from lbgc import calibrate
from lbgc.data.compensated import without_mean
from lbgc.data.record import Record
from lbgc.data.store import Dataset
from lbgc.data.unit_file import CalibratedUnit, load
from lbgc.data.windows import Windows, cut, joined
from lbgc.errors import build
from lbgc.estimators.block_means import levelled
from lbgc.estimators.error_patterns import timeless
from lbgc.estimators.static import gls
from lbgc.estimators.unit_posterior import (
    Evidence,
    Posterior,
    Reference,
    divided,
    evidence,
    posterior,
    undivided,
)
from lbgc.frames import wrap
from lbgc.outputs import fingerprint, write_atomically
from lbgc.own_unit import learned, report
from lbgc.report.figures import png
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.errors import LIFETIMES
from lbgc.sensor.imu import ImuModel

CASES = cases("unit")
MEANS = REAL_LOGS.parent / "reference" / "sdc500_recording_means.csv"


@dataclass(frozen=True)
class Data:
    """Many units' recordings, the last of each unit's to be asked about."""

    sensor: ImuConfig
    imu: ImuModel
    """The sensor's law"""
    records: list[Record]
    windows: Windows
    unit: np.ndarray
    error: float
    """rad, of the labels, new in each"""

    def rows(self, unit: int) -> np.ndarray:
        return np.flatnonzero(self.unit == unit)


def generated(home: Path, name: str, units: int, most: int, *options: str) -> Data:
    """Of each unit `most` recordings to label, and one more."""
    config = default_config(
        *CASES["options"], *options, f"units={units}", f"recordings={units * (most + 1)}",
        f"out={home / name}.zarr",
    )  # fmt: skip
    dataset = Dataset.open_finished(sim.generate.main(config))
    sensor = build(ImuConfig, dataset.configuration["imu"])
    records = list(dataset.records(np.arange(len(dataset))))
    imu = sensor.model(float(dataset.configuration["rate_hz"]))
    windows = joined([cut(own, own.duration_s) for own in records])
    error = float(np.deg2rad(config.scene.reference_error_deg))
    return Data(sensor, imu, records, windows, dataset.label("unit"), error)


def biases(total: float, shares: Sequence[float]) -> list[str]:
    """Options by which a gyro's bias of this variance's root, deg/h, splits."""
    return [
        f"imu.gyro.bias_{life}_deg_per_h={total * float(share) ** 0.5:.9g}"
        for life, share in zip(LIFETIMES, shares, strict=True)
    ]


def asked(data: Data, row: int, unit: CalibratedUnit | None) -> tuple[float, float]:
    """Error of `gls` on a recording, and its sigma, rad."""
    record, imu = data.records[row], data.imu
    if unit is not None:
        record, imu = without_mean(record, imu, unit.known), unit.told(imu)
    found = gls(cut(record, record.duration_s), imu)
    assert record.heading is not None
    return float(wrap(found.heading[0] - record.heading)), float(found.sigma[0])


def filed(home: Path, data: Data, found: Posterior, imu: ImuModel, count: int) -> CalibratedUnit:
    """A unit as its file gives it back. imu : whose biases by lifetime it has."""
    unit, power, run = ((float(x), float(y), float(z)) for x, y, z in map(imu.gyro.bias, LIFETIMES))
    own = CalibratedUnit(
        data.sensor.name, fingerprint(asdict(data.sensor)), (unit, power, run), found.known, count,
        ("",),
    )  # fmt: skip
    own.save(home / "unit.json")
    return load(str(home / "unit.json"), data.sensor)


def told(data: Data, imu: ImuModel, rows: np.ndarray) -> tuple[Evidence, np.ndarray]:
    """What recordings tell of their unit, and their labels, rad."""
    label = np.array([data.records[row].heading_reference for row in rows], float)
    reference = Reference(np.full(len(rows), data.error))
    return evidence(imu, [data.windows.rows(rows)], label, reference), label


def some(of: Evidence, count: int) -> Evidence:
    return replace(of, h=of.h[:count], J=of.J[:count])


def scored(found: Sequence[tuple[float, float]]) -> Scores:
    errors, sigma = np.array(found).T
    return Scores(errors, sigma)


def curve(study: Report, home: Path) -> Iterator[tuple[str, float, int, Scores, Scores]]:
    """Protocol, share, k, `gls` by files, floor(k)."""
    counts = CASES["labelled"]
    for protocol, share in ((p, s) for p in CASES["protocols"] for s in CASES["shares"]):
        units = CASES["units"] if share == CASES["headline_share"] else CASES["units_beside"]
        most = max(counts) if share == CASES["headline_share"] else CASES["most_beside"]
        split = biases(CASES["bias_deg_per_h"], (share, 0.0, 1 - share))
        name = f"{protocol} {share:g}"
        data = generated(home, name, units, most, f"protocol={protocol}", *split)
        (part,) = levelled(data.windows, data.imu.dt, timeless(data.imu))
        exact = UnitFloor(data.imu, part.course, part.site)
        y = np.empty((len(data.unit), int(exact.felt.sum())))
        y[part.rows] = exact.reduced(part.body)
        own = [k for k in counts if k <= most]
        ours = {k: list[tuple[float, float]]() for k in own}
        best = {k: list[tuple[float, float]]() for k in own}
        for unit in tqdm(range(units), name, leave=False):
            *labelled, last = data.rows(unit)
            rows = np.array(labelled, int)
            of, label = told(data, data.imu, rows)
            truth = data.records[last].heading
            assert truth is not None
            for k in own:
                session = np.arange(k)
                file = None
                if k:
                    found = posterior(data.imu, some(of, k), session)
                    file = filed(home, data, found, data.imu, k)
                ours[k].append(asked(data, last, file))
                log = exact.log_posterior(y[[*rows[:k], last]], label[:k], session, k, data.error)
                heading, sigma = estimate(log)
                best[k].append((float(wrap(heading - truth)), sigma))
        for k in own:
            yield protocol, share, k, scored(ours[k]), scored(best[k])


def curves(study: Report, home: Path) -> None:
    study.line("RMSE of one more heading after k labelled recordings, each in its own power-up")
    study.line(f"{'':26s}{'k':>5s}{'units':>7s}{'gls, file':>11s}{'floor(k)':>10s}"
               f"{'over floor(k) [95%]':>26s}{'NSE':>7s}")  # fmt: skip
    rows = []
    for protocol, share, k, ours, best in curve(study, home):
        ratio = ours.over(best)
        rows.append(
            {"protocol": protocol, "share": share, "labelled": k, "units": len(ours.errors),
             "gls_deg": ours.rmse_deg, "floor_deg": best.rmse_deg, "over_floor": ratio.value,
             "nse": ours.nse, "nse_error": ours.nse_error}
        )  # fmt: skip
        study.line(
            f"{protocol:14s} share {share:4g}{k:7d}{len(ours.errors):7d}{ours.rmse_deg:11.3f}"
            f"{best.rmse_deg:10.3f}{ratio.value:11.4f} ({ratio.low:.4f} to {ratio.high:.4f})"
            f"{ours.nse:7.3f}"
        )
    sharp = [row for row in rows if row["share"] == CASES["headline_share"]]
    study.summary |= {
        "error_by_labelled": rows,
        "gls_over_floor_k_max": max(row["over_floor"] for row in rows),
        "nees_k_min": min(row["nse"] for row in sharp),
        "nees_k_max": max(row["nse"] for row in sharp),
    }
    write_atomically(study.directory / "error_by_labelled.png", png(drawn(rows)))
    lines = {
        share: [(int(row["labelled"]), float(row["floor_deg"])) for row in rows
                if (row["protocol"], row["share"]) == ("static", share)]
        for share in CASES["shares"]
    }  # fmt: skip
    shown(study, lines)


def drawn(rows: Sequence[dict]) -> Figure:
    """floor(k) as lines, `gls` by the unit's file as points."""
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    every = figure.subplots(1, len(CASES["protocols"]), squeeze=False)[0]
    for axes, protocol in zip(every, CASES["protocols"], strict=True):
        for number, share in enumerate(CASES["shares"]):
            own = [r for r in rows if (r["protocol"], r["share"]) == (protocol, share)]
            k = [r["labelled"] for r in own]
            axes.plot(k, [r["floor_deg"] for r in own], "-", color=f"C{number}",
                      label=f"{share:.0%} of the variance repeats")  # fmt: skip
            axes.plot(k, [r["gls_deg"] for r in own], "o", color=f"C{number}", markersize=4)
        axes.set_xscale("symlog", linthresh=1)
        axes.set_ylim(bottom=0)
        axes.set_title(f"{protocol}: lines floor(k), points gls with the unit's file", fontsize=9)
        axes.set_xlabel("labelled recordings k")
        axes.grid(alpha=0.3)
    every[0].set_ylabel("RMSE of one more heading, deg")
    every[0].legend(fontsize=7)
    return figure


def unknown_split(study: Report, home: Path) -> None:
    """The split of the bias drawn from its prior, and not told."""
    case, cells, total = CASES["unknown"], simplex(), CASES["bias_deg_per_h"]
    drawn_cells = np.random.default_rng(CASES["seed"]).permutation(len(cells))[: case["splits"]]
    ours: dict[int, list[tuple[float, float]]] = {k: [] for k in case["labelled"]}
    best: dict[int, list[tuple[float, float]]] = {k: [] for k in case["labelled"]}
    for cell in tqdm(drawn_cells.tolist(), "splits", leave=False):
        units, most = case["units"], max(case["labelled"])
        # The law that is known has the sum of the bias alone: a file is of the undivided sensor.
        options = ("protocol=static", f"sessions={most + 1}", f"seed={cell + 1}")
        split = biases(total, cells[cell])
        data = generated(home, f"split {cell}", units, most, *options, f"unit_seed={cell}", *split)
        base = undivided(data.imu)
        (part,) = levelled(data.windows, data.imu.dt, timeless(data.imu))
        floors = [UnitFloor(divided(base, own), part.course, part.site) for own in cells]
        y = np.empty((len(data.unit), int(floors[0].felt.sum())))
        y[part.rows] = floors[0].reduced(part.body)
        for unit in range(units):
            *labelled, last = data.rows(unit)
            rows = np.array(labelled, int)
            of, label = told(data, base, rows)
            truth = data.records[last].heading
            assert truth is not None
            for k in case["labelled"]:
                session = np.arange(k)
                found = posterior(base, some(of, k), session, shares=cells)
                ours[k].append(asked(data, last, filed(home, data, found, found.imu, k)))
                given = y[[*rows[:k], last]], label[:k], session, k, data.error
                heading, sigma = estimate(np.array([own.log_posterior(*given) for own in floors]))
                best[k].append((float(wrap(heading - truth)), sigma))
    study.line()
    study.line("how the bias splits is drawn from its prior, and not told; floor(k) is a mixture")
    for k in case["labelled"]:
        a, b = scored(ours[k]), scored(best[k])
        ratio = a.over(b)
        study.line(
            f"k {k:4d}, {len(a.errors)} units: gls, file {a.rmse_deg:.3f}, floor(k) "
            f"{b.rmse_deg:.3f}, over it {ratio.value:.4f} ({ratio.low:.4f} to {ratio.high:.4f}), "
            f"NSE {a.nse:.3f} +- {1.96 * a.nse_error:.3f}"
        )
        study.summary[f"unknown_split_over_floor_{k}"] = ratio.value
        study.summary[f"unknown_split_nse_{k}"] = a.nse


def fixed_split(study: Report, home: Path) -> None:
    """Splits that are what they are, and not told: the stated sigmas hold on average over the
    prior, and not for each of them."""
    case, cells = CASES["unknown"], simplex()
    study.line()
    study.line("the same at fixed shares that a unit keeps, the rest a recording's: NSE")
    found: dict[tuple[float, int], float] = {}
    most = max(case["labelled"])
    for share in CASES["shares"]:
        split = biases(CASES["bias_deg_per_h"], (share, 0.0, 1 - share))
        options = ("protocol=static", f"sessions={most + 1}", f"seed={CASES['seed'] + 100}")
        data = generated(home, f"fixed {share:g}", case["fixed_units"], most, *options, *split)
        base = undivided(data.imu)
        ours: dict[int, list[tuple[float, float]]] = {k: [] for k in case["labelled"]}
        for unit in tqdm(range(case["fixed_units"]), f"share {share:g}", leave=False):
            *labelled, last = data.rows(unit)
            of, _ = told(data, base, np.array(labelled, int))
            for k in case["labelled"]:
                own = posterior(base, some(of, k), np.arange(k), shares=cells)
                ours[k].append(asked(data, last, filed(home, data, own, own.imu, k)))
        found |= {(share, k): scored(own).nse for k, own in ours.items()}
        each = "  ".join(f"k {k}: {found[share, k]:.3f}" for k in case["labelled"])
        study.line(f"share {share:4g}, {case['fixed_units']} units: {each}")
    (share, k), nse = max(found.items(), key=lambda own: abs(np.log(own[1])))
    study.line(f"worst: share {share:g}, k {k}: NSE {nse:.3f}")
    study.summary["fixed_share_nse_worst"] = {"share": share, "labelled": k, "nse": nse}


def published(study: Report) -> None:
    """The published means: what calibrate says of them."""
    if not MEANS.exists():
        study.line("the published means are not here")
        return
    config = composed(
        calibrate.CalibrateConfig, "calibrate", f"means={MEANS}", "latitude=32.76", "imu=sdc500",
        f"mean_s={CASES['published_mean_s']}",
    )  # fmt: skip
    labels = calibrate.Labels()
    given, _ = calibrate._read(config, labels)
    found = calibrate.calibrate(given.means.rates, given.means.heading, given.means.latitude)
    study.line()
    plain, without = np.rad2deg([found.heading_rmse, found.without_bias.heading_rmse])
    study.line(
        f"published means, {found.recordings} recordings: heading RMSE {plain:.3f} deg as they "
        f"are, {without:.3f} with the others' mean error taken off"
    )
    for name, sessions in (
        ("one_power_up", [None] * found.recordings),
        ("each_its_own", [str(k) for k in range(found.recordings)]),
    ):
        own = learned(
            config.imu, given.rate_hz, replace(labels, sessions=sessions), 0.0, "estimated", None
        )
        study.line(f"taken as {name.replace('_', ' ')}:")
        for line in report(own):
            study.line(f"  {line}")
        assert own.verdict is not None
        assert own.foretold is not None
        study.summary |= {
            f"published_{name}_log10_bayes_factor": own.verdict.log_bayes_factor / np.log(10),
            f"published_{name}_rmse_deg": np.rad2deg(own.foretold.rmse).tolist(),
            f"published_{name}_score": [own.foretold.gain, own.foretold.gain_sigma],
        }


def main() -> None:
    with Report("studies/unit") as study, tempfile.TemporaryDirectory() as temporary:
        home = Path(temporary)
        curves(study, home)
        unknown_split(study, home)
        fixed_split(study, home)
        published(study)


if __name__ == "__main__":
    main()
