"""What do networks learn of a unit from k labelled recordings, against floor(k)?

    make study-unit-learners

1. In context: one network a population, trained once on simulated units; k labelled recordings of a
   new unit are its context. Where the bias is Gaussian and its split told, on simulated recordings,
   against the dense floor(k) of tests/unit_floor.py; where the split is unknown, or a population
   is not Gaussian, against the exact sum over the population's nodes, and against the best linear
   estimate.
2. Networks of one unit: the published one and ours, trained on its k recordings alone, and ours
   trained on a population and tuned on the k (unit_learners_own.py).

What is trained and what is answered is kept by the hash of its configuration below
outputs/studies/unit_learners, so that a run that was stopped goes on. `make study-unit` reads
results.json.
"""

import datetime
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from common import Report, cases
from helpers import default_config
from scoring import Scores
from tqdm import tqdm
from unit import CASES as UNIT
from unit import biases, generated
from unit_floor import UnitFloor, estimate, simplex
from unit_learners_own import own_learners
from unit_learners_picture import RESULTS, picture

from lbgc.estimators import populations
from lbgc.estimators.block_means import Site, levelled
from lbgc.estimators.error_patterns import timeless
from lbgc.estimators.populations import Bench, Population, in_parts
from lbgc.frames import wrap
from lbgc.learning import in_context, tensors
from lbgc.learning.in_context import Asking, InContextNet, InContextPlan, answered
from lbgc.metrics import rmse_ratio
from lbgc.outputs import as_json, fingerprint, write_atomically
from lbgc.units import DEG, HOUR

CASES = cases("unit_learners")
HERE = Path("outputs/studies/unit_learners")
_DPH = DEG / HOUR
_PART = 250  # units at once


def bench() -> Bench:
    """The recordings of study-unit's static case."""
    config = default_config(*UNIT["options"], "protocol=static")
    site = Site.at(float(np.deg2rad(config.latitude)))
    count = round(config.duration_s / config.mean_s)
    return Bench(config.imu.model(config.rate_hz), site, count, config.mean_s)


def population(name: str, of: Bench) -> Population:
    """A population of this study."""
    bias, share = CASES["bias_deg_per_h"] * _DPH, CASES["share"]
    if name == "split told":
        return populations.splits(of, bias, np.array([[share, 0.0, 1 - share]]), name)
    if name == "split unknown":
        return populations.splits(of, bias, simplex(), name)
    said = CASES["populations"][name]
    unscaled = ("share", "time_s", "latest_s", "width")
    values = {k: v if k in unscaled else v * _DPH for k, v in said.items()}
    kinds = {"good and bad units": populations.good_and_bad, "warm-up": populations.warm_ups,
             "step in temperature": populations.steps_in_temperature}  # fmt: skip
    return kinds[name](of, **values)


def plan_of(name: str) -> InContextPlan:
    """The training of a population's network."""
    said = CASES["plan"] | {"seed": CASES["seed"]}
    return InContextPlan(**said | {"steps": CASES["steps"].get(name, said["steps"])})


def network_key(name: str, of: Population) -> str:
    """What a population's network is kept by: its training, and the population's law."""
    law = [of.columns, of.one, of.weight, of.run / _DPH**2, of.conditions]
    sizes = [[f"{np.abs(own).sum():.9g}", f"{np.square(own).sum():.9g}"] for own in law]
    return fingerprint({"plan": asdict(plan_of(name)), "name": name, "law": sizes})


def network(name: str, of: Population) -> InContextNet:
    """The in-context network of a population, trained once."""
    plan = plan_of(name)
    file = HERE / "networks" / f"{network_key(name, of)}.safetensors"
    net = in_context.make(plan, of)
    if file.exists():
        net.load_state_dict(tensors.parse(file.read_bytes()))
        return net.eval()
    net = in_context.train(plan, of)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, tensors.composed(net.state_dict()))
    return net


def rows_of(
    name: str, k: int, answers: Mapping[str, Scores], shared: float = 1.0
) -> dict[str, object]:
    """What errors amount to, of the network and of what it is held against."""
    net, floor, linear = (answers[n] for n in ("in context", "floor", "linear"))
    over, beside = net.over(floor), net.over(linear)
    return {
        "population": name, "labelled": k, "units": len(net.errors), "nodes_that_share": shared,
        "floor_deg": floor.rmse_deg, "linear_deg": linear.rmse_deg, "context_deg": net.rmse_deg,
        "nse": net.nse, "over_floor": [over.value, over.low, over.high],
        "over_linear": [beside.value, beside.low, beside.high],
        "floor_over_linear": floor.over(linear).value,
    }  # fmt: skip


def asked(
    of: Population, net: InContextNet, asking: Asking, figures: np.ndarray, condition: np.ndarray,
    query: np.ndarray, heading: np.ndarray, k: int, exact: bool,
) -> tuple[dict[str, Scores], float]:  # fmt: skip
    """Errors after the first k of the figures, (U, R, 3, d), of which the last's condition is the
    query's: of the network, the linear estimate and, where it is asked for, the exact optimum."""
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    shared = []
    for own in in_parts(len(query), _PART):
        at = condition[own, -1]
        given = figures[own, :k], condition[own, :k]
        put = asking(*given, query[own], at)
        of_net = answered(net, put, asking.axes)
        each = {"in context": (of_net.heading, of_net.sigma), "linear": (put.base, put.sigma)}
        if exact:
            best, nodes = of.optimal(of.context(*given), query[own], at)
            each["floor"] = best.heading, best.sigma
            shared.append(nodes)
        for who, (angle, sigma) in each.items():
            found.setdefault(who, []).append((wrap(angle - heading[own]), sigma))
    scores = {who: Scores(*map(np.concatenate, zip(*p, strict=True))) for who, p in found.items()}
    return scores, float(np.mean(np.concatenate(shared))) if shared else 1.0


def kept(name: str, of: Bench, compute: Callable[[str, Bench], list[dict]]) -> list[dict]:
    """Rows of a population, computed once."""
    law = population(name, of)
    content = {"network": network_key(name, law), "how": compute.__name__, "seed": CASES["seed"],
               "units": CASES["units"], "labelled": CASES["labelled"]}  # fmt: skip
    file = HERE / "answers" / f"{fingerprint(content)}.json"
    if not file.exists():
        rows = compute(name, of)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(file, as_json(rows) + "\n")
    return json.loads(file.read_text())


def of_population(name: str, of: Bench) -> list[dict]:
    """In context on a population's own draws, whose in-run noise is the sensor's samples; the
    ratio of all k together is with the last."""
    law = population(name, of)
    net, asking, units = network(name, law), Asking(law), CASES["units"]
    rng = np.random.default_rng([CASES["seed"], 77])
    figures, condition, _ = law.draw(rng, units, max(CASES["labelled"]) + 1, sampled=True)
    heading = rng.uniform(-np.pi, np.pi, units)
    query = figures[:, -1] + law.signal(heading)
    rows: list[dict] = []
    errors: dict[str, list[np.ndarray]] = {}
    for k in tqdm(CASES["labelled"], name, leave=False):
        own, shared = asked(law, net, asking, figures, condition, query, heading, k, True)
        rows.append(rows_of(name, k, own, shared))
        for who, each in own.items():
            errors.setdefault(who, []).append(each.errors)
    every = {who: np.concatenate(each) for who, each in errors.items()}
    unit = np.tile(np.arange(units), len(rows))
    ratio = rmse_ratio(every["in context"], every["linear"], unit)
    rows[-1]["all_over_linear"] = [ratio.value, ratio.low, ratio.high]
    return rows


def simulated(name: str, of: Bench) -> list[dict]:
    """In context where the split is told, on recordings of the bench, against floor(k)."""
    counts, units = CASES["labelled"], CASES["units"]
    law, most = population(name, of), max(counts)
    net, asking = network(name, law), Asking(law)
    with tempfile.TemporaryDirectory() as temporary:
        share = biases(CASES["bias_deg_per_h"], (CASES["share"], 0.0, 1 - CASES["share"]))
        options = ("protocol=static", f"seed={CASES['seed'] + 50}", "unit_seed=50", *share)
        data = generated(Path(temporary), "told", units, most, *options)
        (part,) = levelled(data.windows, data.imu.dt, timeless(data.imu))
        dense = UnitFloor(data.imu, part.course, part.site)
        y = np.empty((len(data.unit), int(dense.felt.sum())))
        y[part.rows] = dense.reduced(part.body)
        figures = np.empty((len(data.unit), 3, law.size))
        figures[part.rows] = law.level(part)
        every = np.array([data.rows(unit) for unit in range(units)])
        label = np.array([record.heading_reference for record in data.records], float)
        left = (figures - law.signal(label))[every]
        heading = np.array([data.records[row].heading for row in every[:, -1]], float)
    query = figures[every[:, -1]]
    none = np.zeros(every.shape, int)
    rows = []
    for k in tqdm(counts, "floor(k)", leave=False):
        own, _ = asked(law, net, asking, left, none, query, heading, k, False)
        best = []
        for unit in range(units):
            first = every[unit, :k]
            log = dense.log_posterior(
                y[[*first, every[unit, -1]]], label[first], np.arange(k), k, data.error
            )
            found, sigma = estimate(log)
            best.append((float(wrap(found - heading[unit])), sigma))
        own["floor"] = Scores(*np.array(best).T)
        rows.append(rows_of(name, k, own))
    return rows


def table(study: Report, rows: Sequence[Mapping]) -> None:
    """A population's lines."""
    for row in rows:
        over, beside = row["over_floor"], row["over_linear"]
        study.line(
            f"{row['population']:20s}{row['labelled']:4d}{row['floor_deg']:9.3f}"
            f"{row['linear_deg']:9.3f}{row['context_deg']:9.3f}   "
            f"{over[0]:.4f} ({over[1]:.4f} to {over[2]:.4f})   "
            f"{beside[0]:.4f} ({beside[1]:.4f} to {beside[2]:.4f}){row['nse']:7.3f}"
            f"{row['nodes_that_share']:7.1f}"
        )


def lines(of: Bench) -> dict[float, list[tuple[int, float]]]:
    """floor(k) of the picture's shares, deg; the linear estimate is the optimum."""
    found = {}
    for share in UNIT["shares"]:
        bias = CASES["bias_deg_per_h"] * _DPH
        law = populations.splits(of, bias, np.array([[share, 0.0, 1 - share]]))
        rng = np.random.default_rng([CASES["seed"], 88])
        figures, condition, _ = law.draw(rng, CASES["units"], max(CASES["labelled"]) + 1)
        heading = rng.uniform(-np.pi, np.pi, CASES["units"])
        query, at = figures[:, -1] + law.signal(heading), condition[:, -1]
        points = []
        for k in CASES["labelled"]:
            best, _ = law.best_linear(law.context(figures[:, :k], condition[:, :k]), query, at)
            off = wrap(best.heading - heading)
            points.append((k, float(np.rad2deg(np.sqrt(np.mean(off**2))))))
        found[share] = points
    return found


def main() -> None:
    torch.set_num_threads(1)
    with Report("studies/unit_learners") as study:
        of = bench()
        study.line(f"in context: RMSE in degrees, {CASES['units']} units each, 240 s at rest")
        study.line(f"{'':20s}{'k':>4s}{'floor(k)':>9s}{'linear':>9s}{'network':>9s}   "
                   f"{'over floor(k) [95%]':26s}   {'over linear [95%]':26s}{'NSE':>7s}"
                   f"{'nodes':>7s}")  # fmt: skip
        rows = []
        for name in (*CASES["gaussian"], *CASES["populations"]):
            own = kept(name, of, simulated if name == "split told" else of_population)
            table(study, own)
            rows += own
        gaussian = [row for row in rows if row["population"] in CASES["gaussian"]]
        pooled = {
            row["population"]: row["all_over_linear"]
            for row in rows
            if row["population"] in CASES["populations"] and "all_over_linear" in row
        }
        for name, (value, low, high) in pooled.items():
            study.line(
                f"{name}: over linear, all k together, {value:.4f} ({low:.4f} to {high:.4f})"
            )
        study.line(
            "nodes: values of what is not Gaussian that share a unit's posterior, 1/sum p^2;"
        )
        study.line("floor(k) sums over all of them: exact, no sampling")
        told = network("split told", population("split told", of))
        learners = own_learners(study, CASES, HERE, of, told)
        worst = max(gaussian, key=lambda row: row["over_floor"][0])
        at56 = [r for r in learners if (r["learner"], r["labelled"]) == ("published", 56)]
        study.summary |= {
            "context_over_floor_k_max": worst["over_floor"][0],
            "context_over_floor_k_max_upper": max(row["over_floor"][2] for row in gaussian),
            "context_over_linear_nongaussian_upper": min(r[2] for r in pooled.values()),
            "context_over_linear_nongaussian": pooled,
            "published_over_floor_56": at56[0]["over_floor"][0] if at56 else None,
            "published_over_floor_56_interval": at56[0]["over_floor"][1:] if at56 else None,
            "published_units": at56[0]["units"] if at56 else 0,
            "hours_stated": CASES["hours"],
        }
        said = {
            "date": datetime.datetime.now(datetime.UTC).date().isoformat(), "share": CASES["share"],
            "summary": study.summary, "in_context": rows, "learners": learners,
        }  # fmt: skip
        write_atomically(RESULTS, as_json(said) + "\n")
        picture(study, lines(of), learners, CASES["share"])


if __name__ == "__main__":
    main()
