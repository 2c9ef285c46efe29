"""Forged datasets and models: every checksum right, and one value that nobody wrote; and what each
command makes of them. Used by test_forged.py, a few, and by `make study-fuzz`, many."""

import copy
import json
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from helpers import composed, default_config, generate
from safetensors.numpy import load, save

from lbgc import calibrate, compare, evaluate, export, info, train
from lbgc.data import store
from lbgc.errors import InputError
from lbgc.learning import description
from lbgc.learning.estimator import WEIGHTS

NASTY: tuple[Any, ...] = (
    None, True, False, "", "x", "stim300", [], {}, [1, 2], [[]], {"a": {"b": 1}}, -1, 0, 1, 3, 0.5,
    -0.5, 90, 91, 1e30, -1e30, 1e-30, 1e15, 1e308, 5e-324, float("nan"), float("inf"),
    float("-inf"), 2**31, 2**31 - 1, 2**63, -(2**63), 10**400, "9" * 400, "\x1b[2J",
    "${oc.env:HOME}",
)  # fmt: skip
"""What may stand where a value of a configuration stood; beside, a key may go, or come."""
VALUES = (
    np.nan,
    np.inf,
    -np.inf,
    1e300,
    -1e30,
    1e15,
    7.0,
    -1.0,
    2**31 - 1,
    -(2**31),
    127,
    3,
    1e-300,
)
"""What may stand where a label, a sample or a weight stood."""


def altered(said: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """A copy with one value replaced, taken away, or added, at any depth."""
    changed = copy.deepcopy(said)
    places = list(_places(changed))
    inside, key = places[rng.integers(len(places))]
    way = rng.uniform()
    if way < 0.1:
        del inside[key]
    elif way < 0.15 and isinstance(inside, dict):
        inside[str(key) + "_"] = inside[key]
    elif way < 0.3 and isinstance(inside[key], int | float) and not isinstance(inside[key], bool):
        inside[key] = inside[key] * float(rng.choice([-1, 0.37, 1e3, 1e-3, 1e9, 1e-9]))
    else:
        inside[key] = NASTY[rng.integers(len(NASTY))]
    return changed


def _places(said: Any) -> Iterator[tuple[Any, Any]]:
    """Every place in a document: what holds it, and its key or number there."""
    for key, value in list(said.items() if isinstance(said, dict) else enumerate(said)):
        yield said, key
        if isinstance(value, dict | list):
            yield from _places(value)


@dataclass
class Forger:
    """A dataset and a model of it, of which forgeries are made, below `home`."""

    home: Path
    configuration: dict[str, Any]
    layout: store.Layout
    arrays: dict[str, np.ndarray]
    said: dict[str, Any]
    weights: bytes

    @classmethod
    def at(cls, home: Path) -> "Forger":
        """The valid ones, made anew."""
        with _inside(home):
            own = {"output": "means", "mean_s": 5.0, "duration_s": 40.0, "recordings": 24,
                   "units": 1, "sessions": 2, "split": [2, 1, 1]}  # fmt: skip
            imu = default_config("imu=stim300").imu
            dataset = generate(home / "valid.zarr", imu=imu, **own)
            options = ("steps=4", "batch=4", "validate_every=2", "model.hidden=2", "model.layers=1",
                       "windows_s=[20]")  # fmt: skip
            run = train.main(composed(train.TrainConfig, "train", f"data={dataset.path}", *options))
            said = json.loads((run / description.DESCRIPTION).read_text())
            for key in ("format", "weights", "checksum"):
                del said[key]
            arrays = {n: dataset._read(n, 0, 24) for n in dataset.layout.variables}
            weights = (run / WEIGHTS).read_bytes()
        return cls(home, dataset.configuration, dataset.layout, arrays, said, weights)

    def dataset(self, rng: np.random.Generator) -> Path:
        """A finished dataset of which the configuration or some values of a variable are forged."""
        path = self.home / "forged.zarr"
        content, arrays = self.configuration, dict(self.arrays)
        if rng.uniform() < 0.6:
            content = altered(content, rng)
        else:
            names = list(self.layout.variables)
            name = names[rng.integers(len(names))]
            arrays[name] = self._spoilt(arrays[name], rng)
        with np.errstate(all="ignore"):
            made = store.create(path, self.layout, content, {})
            made.write_shard(0, arrays)
        return path

    @staticmethod
    def _spoilt(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """The values with another one in one place, or everywhere."""
        changed = values.copy()
        value = np.float64(VALUES[rng.integers(len(VALUES))])
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            cast = value.astype(values.dtype)
        if rng.uniform() < 0.5:
            changed[...] = cast
        else:
            changed.flat[rng.integers(changed.size)] = cast
        return changed

    def model(self, rng: np.random.Generator) -> Path:
        """A finished run whose description or weights are forged."""
        run = self.home / "runs/forged"
        run.mkdir(parents=True, exist_ok=True)
        said, weights = self.said, self.weights
        if rng.uniform() < 0.8:
            said = altered(said, rng)
        else:
            tensors = dict(load(weights))
            name = sorted(tensors)[rng.integers(len(tensors))]
            tensors[name] = self._spoilt(tensors[name], rng)
            weights = save(tensors)
        (run / WEIGHTS).write_bytes(weights)
        content = _composed(said, weights)
        (run / description.DESCRIPTION).write_bytes(content)
        return run


def _composed(said: dict[str, Any], weights: bytes) -> bytes:
    """As `description.compose`, with numbers that standard JSON has not."""
    with_nan = partial(json.dumps, indent=2)
    before, description.as_json = description.as_json, with_nan
    try:
        return description.compose(said, weights)
    finally:
        description.as_json = before


def commands(path: Path, run: Path, valid: Path) -> dict[str, Callable[[], object]]:
    """Every command that reads a dataset (at `path`) or a model (in `run`), by name. valid : a
    dataset that is none of the forger's."""
    asked = (f"data={path}", "windows_s=[20,40]")
    of_run = (f"data={valid}", "windows_s=[20]", f"run={run}", "untrained=true", "estimator=mean")
    small = (f"data={path}", "steps=2", "batch=2", "validate_every=1", "model.hidden=2",
             "model.layers=1", "windows_s=[20]")  # fmt: skip
    return {
        "info": lambda: info.main(info.InfoConfig(data=str(path))),
        "evaluate": lambda: _evaluated(*asked, "estimator=all"),
        "evaluate known": lambda: _evaluated(*asked, "estimator=floor", "known=[unit,session,run]"),
        "evaluate reference": lambda: _evaluated(*asked, "estimators=[mean]", "against=reference"),
        "calibrate": lambda: calibrate.main(calibrate.CalibrateConfig(data=str(path))),
        "train": lambda: train.main(composed(train.TrainConfig, "train", *small)),
        "train stream": lambda: train.main(
            composed(train.TrainConfig, "train", *small, "stream=true", "tempering=10")
        ),
        "evaluate run": lambda: _evaluated(*of_run),
        "compare": lambda: compare.main(compare.CompareConfig(runs=str(run.parent))),
        "export": lambda: export.main(export.ExportConfig(run=str(run))),
    }


_DEAR = 10
"""Exports take as long as this many other commands."""
OF_MODELS = ("evaluate run", "compare", "export")


def _evaluated(*options: str) -> None:
    """Evaluate; every RMSE must be a number."""
    page = evaluate.main(composed(evaluate.EvaluateConfig, "evaluate", *options))
    rows = json.loads((page.parent / "results.json").read_text())["rows"]
    assert rows, "no row, and no error"
    assert all(row["rmse_deg"] is not None for row in rows), "an RMSE that is no number"


def tried(forger: Forger, seed: int, number: int) -> tuple[str, str | None]:
    """One forgery in one command: the command, and what went wrong; None where it was refused or
    answered."""
    rng = np.random.default_rng([seed, number])
    run = forger.home / "runs/forged"
    every = commands(forger.home / "forged.zarr", run, forger.home / "valid.zarr")
    name = list(every)[number % len(every)]
    if name == "export" and number % (_DEAR * len(every)) != number % len(every):
        name = "compare"
    with _inside(forger.home), open(os.devnull, "w") as silent:
        clear(forger.home / "forged.zarr")
        try:
            forger.model(rng) if name in OF_MODELS else forger.dataset(rng)
        except (InputError, OverflowError, ValueError):
            return name, None  # what JSON or our own writer will not hold
        with redirect_stdout(silent), redirect_stderr(silent), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an overflow on the way to a refusal
            try:
                every[name]()
            except InputError:
                return name, None
            except Exception as error:
                return name, f"{type(error).__name__}: {error}"[:300]
    return name, None


def clear(path: Path) -> None:
    """Take a forged dataset away."""
    for file in sorted(path.rglob("*"), reverse=True) if path.exists() else ():
        file.rmdir() if file.is_dir() else file.unlink()


@contextmanager
def _inside(home: Path) -> Iterator[None]:
    before = os.getcwd()
    os.chdir(home)
    try:
        yield
    finally:
        os.chdir(before)
