"""What several test files call: configurations as entry points compose them, small datasets, and
windows of records whose headings are known."""

import os
import subprocess
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from programs import ran

import sim.generate
from lbgc.commands import CONF, store_defaults
from lbgc.data.record import Record
from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled, cut
from lbgc.errors import build
from lbgc.sensor.gaussian import GaussianTerm
from lbgc.sensor.imu import Triad
from sim.generate import GenerateConfig

ROOT = Path(__file__).parents[1]
REAL_LOGS = Path(os.environ.get("LBGC_REAL_LOGS", "no such directory")).resolve()
os.environ["LBGC_REAL_LOGS"] = str(REAL_LOGS)  # tests change directory


def needs_recording(name: str) -> pytest.MarkDecorator:
    """Skip, by name, where a recording that is not part of the project is absent."""
    return pytest.mark.skipif(
        not (REAL_LOGS / name).exists(), reason=f"needs the recording {name} under $LBGC_REAL_LOGS"
    )


@cache
def composed(config_class: type, name: str, *overrides: str):
    """The configuration that an entry point would be called with."""
    store_defaults(config_class)
    with initialize_config_dir(CONF, version_base="1.3"):
        raw = OmegaConf.to_container(compose(name, list(overrides)), resolve=True)
    return build(config_class, raw)


def default_config(*overrides: str) -> GenerateConfig:
    """As `python sim/generate.py` composes it."""
    return composed(GenerateConfig, "generate", *overrides)


def figures(triad: Triad, kind: type, name: str) -> tuple[float, ...]:
    """A parameter of a triad's term of this kind, of each axis; zero of an axis without one."""
    every = [(*own, *started) for own, started in zip(triad.terms, triad.started, strict=True)]
    each = [[getattr(t, name) for t in own if isinstance(t, kind)] for own in every]
    return tuple(sum(own) for own in each)


def with_noise(triad: Triad, *terms: GaussianTerm) -> Triad:
    """A triad with these terms on each axis, and no tone or ramp."""
    return replace(triad, terms=(terms,) * 3, started=((), (), ()))


def fields_of(config: Any) -> dict[str, Any]:
    """What a configuration was made with, by name."""
    return {own.name: getattr(config, own.name) for own in fields(config)}


def generate(path: Path, **changes: object) -> Dataset:
    """A dataset at `path`; the default experiment but for the changes, and no picture."""
    config = replace(default_config(), out=str(path), **changes)
    with patch.object(sim.generate, "try_picture", lambda *_: "not in tests"):
        return Dataset.open_finished(sim.generate.main(config))


def labelled(record: Record, window_s: float) -> Labelled:
    """A record's windows, and what it knows of where they looked."""
    windows = cut(record, window_s)
    return Labelled(
        windows=windows,
        heading=np.full(len(windows), record.heading, float),  # None: NaN
        heading_reference=np.full(len(windows), record.heading_reference, float),
    )


def ran_small(script: Path, where: Path) -> subprocess.CompletedProcess:
    """A study or the bench, run in a directory at its size for the tests: see small.yaml."""
    parts = (ROOT, ROOT / "tests", ROOT / "tests/studies")
    path = os.pathsep.join(map(str, parts))
    done = ran(script, cwd=where, LBGC_STUDY="small", PYTHONPATH=path)
    assert done.returncode == 0, done.stderr[-3000:]
    return done
