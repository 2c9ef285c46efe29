"""Part of `make study-unit-learners`: networks of one unit, trained or tuned on its k labelled
recordings, each asked about further ones of it, against floor(k)."""

import contextlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import Report
from helpers import composed, default_config
from tqdm import tqdm
from unit import CASES as UNIT
from unit import biases
from unit_floor import UnitFloor, estimate

import lbgc.train
import sim.generate
from lbgc.data.store import Dataset
from lbgc.data.windows import Windows, cut, joined
from lbgc.errors import build
from lbgc.estimators import populations
from lbgc.estimators.block_means import levelled
from lbgc.estimators.error_patterns import timeless
from lbgc.estimators.populations import Bench
from lbgc.frames import wrap
from lbgc.learning.estimator import Learned, compute_torch, load_net
from lbgc.learning.in_context import Asking, InContextNet, answered
from lbgc.metrics import rmse_ratio
from lbgc.outputs import as_json, fingerprint, write_atomically
from lbgc.sensor.datasheet import ImuConfig
from lbgc.train import TrainConfig
from lbgc.units import DEG, HOUR


class Unit:
    """A unit's recordings: labelled ones, then those that are asked about."""

    def __init__(self, case: Mapping[str, Any], home: Path, number: int):
        own = case["own"]
        count = own["most"] + own["queries"]
        split = biases(case["bias_deg_per_h"], (case["share"], 0.0, 1 - case["share"]))
        options = (
            *UNIT["options"], *split, "protocol=static", f"recordings={count}",
            f"sessions={count}", f"unit_seed={own['unit_seed'] + number}", f"seed={number}",
            f"split=[{own['most']},0,{own['queries']}]",
        )  # fmt: skip
        key = fingerprint({"options": options})
        config = default_config(*options, f"out={home}/data/{key}.zarr")
        self.data = Dataset.open_finished(sim.generate.main(config))
        sensor = build(ImuConfig, self.data.configuration["imu"])
        self.imu = sensor.model(float(self.data.configuration["rate_hz"]))
        rows = [self.data.in_split(name) for name in ("train", "test")]
        self.labelled, self.asked = (list(self.data.records(own)) for own in rows)
        self.heading = np.array([record.heading for record in self.asked], float)
        self.label = np.array([record.heading_reference for record in self.labelled], float)
        self.error = float(np.deg2rad(config.scene.reference_error_deg))

    @property
    def queries(self) -> Windows:
        return joined([cut(record, record.duration_s) for record in self.asked])

    @property
    def windows(self) -> Windows:
        """Those of the labelled recordings, then the queries."""
        every = [*self.labelled, *self.asked]
        return joined([cut(record, record.duration_s) for record in every])

    def floor(self, counts: Sequence[int]) -> dict[int, np.ndarray]:
        """Errors of the dense floor(k), (Q,)."""
        (part,) = levelled(self.windows, self.imu.dt, timeless(self.imu))
        dense = UnitFloor(self.imu, part.course, part.site)
        y = np.empty((len(part.rows), int(dense.felt.sum())))
        y[part.rows] = dense.reduced(part.body)
        first, found = len(self.labelled), {}
        for k in counts:
            angles = [
                estimate(dense.log_posterior(
                    y[[*range(k), first + q]], self.label[:k], np.arange(k), k, self.error
                ))[0]
                for q in range(len(self.asked))
            ]  # fmt: skip
            found[k] = wrap(np.array(angles) - self.heading)
        return found


def finished(config: TrainConfig) -> Path:
    """The run of a training; what it prints of its prospects is not this table's."""
    with contextlib.redirect_stdout(io.StringIO()):
        return lbgc.train.main(config)


def trained(unit: Unit, k: int, case: Mapping[str, Any], options: Sequence[str]) -> np.ndarray:
    """Errors of a network that is trained on k recordings of the unit, (Q,)."""
    given = (f"data={unit.data.place}", f"labelled={k}", *case["own"]["training"], *options)
    run = finished(composed(TrainConfig, "train", *given))
    return wrap(Learned.load(run)(unit.queries).heading - unit.heading)


def tuned(unit: Unit, k: int, case: Mapping[str, Any], home: Path) -> np.ndarray:
    """Errors of a network that was trained on a population, and then on k recordings, (Q,)."""
    own = case["own"]
    config = composed(
        TrainConfig, "train", f"data={unit.data.place}", f"labelled={k}", *own["training"],
        *own["tuned"],
    )  # fmt: skip
    trainer = lbgc.train.trainer_of(config, [unit.data])
    start = pretrained(case, home)
    net, said = load_net(start)
    trainer.net.load_state_dict(net.state_dict())
    trainer.run(home / "tuned.safetensors", lambda _: None)
    trainer.net.load_state_dict(trainer.best)
    trainer.net.eval()
    (home / "tuned.safetensors").unlink(missing_ok=True)
    learned = Learned.described(trainer.net.config, lambda x: compute_torch(trainer.net, x), said)
    return wrap(learned(unit.queries).heading - unit.heading)


def pretrained(case: Mapping[str, Any], home: Path) -> Path:
    """The run of a network that is trained on many units, none of them one of these."""
    said = case["own"]["population"]
    split = biases(case["bias_deg_per_h"], (case["share"], 0.0, 1 - case["share"]))
    count = said["units"]
    options = (
        *UNIT["options"], *split, "protocol=static", f"units={count}", f"recordings={count}",
        "unit_seed=9", "seed=9", "split=[90,10,0]",
    )  # fmt: skip
    config = default_config(*options, f"out={home}/data/{fingerprint({'options': options})}.zarr")
    data = Dataset.open_finished(sim.generate.main(config))
    given = (f"data={data.place}", *case["own"]["training"], *said["options"])
    return finished(composed(TrainConfig, "train", *given))


def in_context(
    unit: Unit, counts: Sequence[int], case: Mapping[str, Any], of: Bench, net: InContextNet
) -> dict[int, np.ndarray]:
    """Errors of the in-context network that is told the split, (Q,) each."""
    bias = case["bias_deg_per_h"] * DEG / HOUR
    shares = np.array([[case["share"], 0.0, 1 - case["share"]]])
    law = populations.splits(replace(of, imu=unit.imu), bias, shares)
    asking = Asking(law)
    (part,) = levelled(unit.windows, unit.imu.dt, timeless(unit.imu))
    figures, first = np.empty((len(part.rows), 3, law.size)), len(unit.labelled)
    figures[part.rows] = law.level(part)
    context = figures[:first] - law.signal(unit.label)
    found, q = {}, len(unit.asked)
    for k in counts:
        given = np.repeat(context[None, :k], q, axis=0)
        put = asking(given, np.zeros((q, k), int), figures[first:], np.zeros(q, int))
        found[k] = wrap(answered(net, put, asking.axes).heading - unit.heading)
    return found


def own_learners(
    study: Report, case: Mapping[str, Any], home: Path, of: Bench, net: InContextNet
) -> list[dict]:
    """The learners of one unit, as a table; a row each of learner and k."""
    rows: list[dict] = []
    study.line()
    study.line(
        f"networks of one unit on {case['own']['queries']} more recordings of it, RMSE in deg"
    )
    study.line(
        f"{'':12s}{'k':>4s}{'units':>7s}{'learned':>9s}{'floor(k)':>9s}   over floor(k) [95%]"
    )
    for learner, said in case["own"]["learners"].items():
        errors: dict[int, list[np.ndarray]] = {k: [] for k in said["labelled"]}
        floors: dict[int, list[np.ndarray]] = {k: [] for k in said["labelled"]}
        for number in tqdm(range(said["units"]), learner, leave=False):
            found = answers(case, home, of, net, learner, said, number)
            for k in said["labelled"]:
                errors[k].append(np.array(found[str(k)]["errors"]))
                floors[k].append(np.array(found[str(k)]["floor"]))
        for k in said["labelled"]:
            own, best = np.concatenate(errors[k]), np.concatenate(floors[k])
            unit = np.repeat(np.arange(said["units"]), case["own"]["queries"])
            ratio = rmse_ratio(own, best, unit)
            rmse, floor = (float(np.rad2deg(np.sqrt(np.mean(e**2)))) for e in (own, best))
            rows.append(
                {"learner": learner, "labelled": k, "units": said["units"], "rmse_deg": rmse,
                 "floor_deg": floor, "over_floor": [ratio.value, ratio.low, ratio.high]}
            )  # fmt: skip
            study.line(
                f"{learner:12s}{k:4d}{said['units']:7d}{rmse:9.3f}{floor:9.3f}   "
                f"{ratio.value:.3f} ({ratio.low:.3f} to {ratio.high:.3f})"
            )
    return rows


def answers(
    case: Mapping[str, Any], home: Path, of: Bench, net: InContextNet, learner: str,
    said: Mapping[str, Any], number: int,
) -> dict[str, dict[str, list[float]]]:  # fmt: skip
    """A unit's errors at each k, of a learner and of floor(k), rad; kept once they are known."""
    own = {k: v for k, v in case["own"].items() if k != "learners"}
    weights = {} if learner != "in context" else {
        name: float(value.double().abs().sum()) for name, value in net.state_dict().items()
    }  # fmt: skip
    content = {
        "own": own, "said": {k: v for k, v in said.items() if k != "units"}, "learner": learner,
        "number": number, "bias": [case["bias_deg_per_h"], case["share"]], "net": weights,
    }  # fmt: skip
    file = home / "answers" / f"{fingerprint(content)}.json"
    if file.exists():
        return json.loads(file.read_text())
    unit, counts = Unit(case, home, number), said["labelled"]
    floor = unit.floor(counts)
    if learner == "in context":
        found = in_context(unit, counts, case, of, net)
    elif learner == "tuned":
        found = {k: tuned(unit, k, case, home) for k in counts}
    else:
        found = {k: trained(unit, k, case, said["options"]) for k in counts}
    file.parent.mkdir(parents=True, exist_ok=True)
    both = {str(k): {"errors": found[k].tolist(), "floor": floor[k].tolist()} for k in counts}
    write_atomically(file, as_json(both) + "\n")
    return both
