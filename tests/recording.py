"""What must not change unless the CHANGELOG says so: datasets, answers, help and models as they
were recorded in tests/golden/, and how they are made.

    make golden      record them anew

Answers are told from others to a billionth. Bytes depend on the arithmetic of the processor and of
its libraries, too, so digests of datasets are kept by what a sample of that arithmetic gives: on
another machine there may be none to compare with, and `make golden` adds one.
"""

import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import scipy.fft
from helpers import ROOT, composed

import sim.generate
from lbgc.data.store import Dataset
from lbgc.data.windows import Windows, cut, joined
from lbgc.errors import InputError
from lbgc.evaluate import KNOWN
from lbgc.frames import DOWN
from lbgc.learning import pretrained
from lbgc.learning.description import DESCRIPTION
from sim.generate import GenerateConfig

GOLDEN = ROOT / "tests/golden"
DIGESTS, ANSWERS, MODELS = (GOLDEN / f"{name}.json" for name in ("digests", "answers", "models"))
WINDOWS, HELP = GOLDEN / "windows.npz", GOLDEN / "help"
COMMANDS = {
    path.removesuffix(".py").replace("/", "."): path
    for path in (
        *("sim/generate.py", "sim/scene.py", "lbgc/bound.py", "lbgc/fit.py", "lbgc/calibrate.py"),
        *("lbgc/info.py", "lbgc/look.py", "lbgc/train.py", "lbgc/export.py", "lbgc/compare.py"),
        *("lbgc/evaluate.py", "lbgc/export_imu.py"),
    )
}

_SMALL = ("recordings=6", "duration_s=20", "rate_hz=50", "units=2", "sessions=2", "seed=3")
DATASETS: dict[str, tuple[str, ...]] = {
    "samples": (*_SMALL, "imu=adis16405"),
    "means": (*_SMALL, "output=means", "mean_s=1", "imu=vn100"),
    "two_position": (
        *(*_SMALL, "protocol=two_position", "imu=stim300", "scene.base_roll_deg=2"),
        *("imu.temperature.rise_k=10", "imu.gyro.bias_per_k_deg_per_h_per_k=0.5"),
    ),
    "carousel": (*_SMALL, "protocol=carousel", "imu=kvh1775", "output=means", "mean_s=1"),
    "vibrating_floor": (*_SMALL, "scene=vibrating_floor", "scene.floor.knocks.per_minute=6"),
    "vehicle": (*_SMALL, "scene=vehicle", "imu=lasergyro", "protocol=static"),
}
"""Small ones that every part of a simulation takes part in: configurations of sim/generate.py."""


@dataclass(frozen=True)
class Situation:
    """What stored windows are of: a configuration that drew them, and how they were cut."""

    options: tuple[str, ...]
    window_s: float

    @property
    def config(self) -> GenerateConfig:
        return composed(GenerateConfig, "generate", *self.options)


def _means(protocol: str, imu: str, *more: str) -> Situation:
    size = ("recordings=3", "duration_s=240", "rate_hz=60", "output=means", "mean_s=1", "seed=5")
    return Situation((*size, f"protocol={protocol}", f"imu={imu}", *more), 240.0)


SITUATIONS = {
    "static": _means("static", "sdc500"),
    "blind": _means("static", "bmi160"),
    "two_position": _means("two_position", "sdc500"),
    "leaning": _means(
        "two_position", "stim300", "scene.base_roll_deg=5", "scene.base_pitch_deg=-3"
    ),
    "four_position": _means("four_position", "hg4930"),
    "carousel": _means("carousel", "kvh1775"),
    "warming_up": _means(
        *("two_position", "stim300", "imu.temperature.rise_k=15"),
        *("imu.temperature.time_s=300", "imu.gyro.bias_per_k_deg_per_h_per_k=2"),
    ),
    "vehicle": Situation(
        (
            *("recordings=3", "duration_s=20", "rate_hz=20", "scene.physics_hz=400", "seed=5"),
            *("scene=vehicle", "imu=lasergyro", "protocol=static"),
        ),
        20.0,
    ),
}


def arithmetic() -> str:
    """What this machine's arithmetic is: a digest of a sample of what simulations are made of."""
    x = np.linspace(0.01, 9.0, 4001)
    normal = np.random.Generator(np.random.SFC64(1)).standard_normal(4096)
    square = normal.reshape(64, 64)
    found = [f(x) for f in (np.exp, np.log, np.sin, np.cos, np.tan, np.arctan, np.cbrt)]
    found += [f(x.astype(np.float32)) for f in (np.exp, np.sin, np.cos)]
    found += [normal, square @ square, np.linalg.inv(square), scipy.fft.rfft(normal)]
    return hashlib.sha256(b"".join(a.tobytes() for a in found)).hexdigest()[:16]


def made(options: tuple[str, ...], path: Path) -> Dataset:
    config = composed(GenerateConfig, "generate", *options, f"out={path}")
    with patch.object(sim.generate, "try_picture", lambda *_: "no picture"):
        return Dataset.open_finished(sim.generate.main(config))


def digest(name: str, directory: Path) -> str:
    return made(DATASETS[name], directory / f"{name}.zarr").digest()


def drawn(situation: Situation, directory: Path) -> Windows:
    """The situation's windows, simulated anew."""
    dataset = made(situation.options, directory / "d.zarr")
    records = dataset.records(np.arange(len(dataset.label("heading"))))
    return joined([cut(record, situation.window_s) for record in records])


def stored(name: str) -> Windows:
    """A situation's windows as they were recorded."""
    with np.load(WINDOWS) as file:
        arrays = {k.partition("/")[2]: file[k] for k in file.files if k.startswith(f"{name}/")}
    axis = int(arrays.get("axis", DOWN))
    return Windows(**arrays | {"rate_hz": float(arrays["rate_hz"]), "axis": axis})


def answers(name: str) -> dict[str, dict[str, list[float | None]] | str]:
    """What every estimator, the floor and every pretrained model answers to stored windows, rad,
    None for NaN; or why it does not."""
    windows = stored(name)
    config = SITUATIONS[name].config
    imu = config.imu.model(config.rate_hz)
    models = {m.name: m for m in pretrained.every() if m.sensor == config.imu}
    found: dict[str, dict[str, list[float | None]] | str] = {}
    for who, estimate in {**KNOWN, **models}.items():
        try:
            own = estimate(windows, imu)
        except InputError as error:
            found[who] = str(error)
        else:
            found[who] = {
                key: [None if np.isnan(v) else float(v) for v in getattr(own, key)]
                for key in ("heading", "sigma")
            }
    return found


def help_of(command: str, directory: Path) -> str:
    """What a command prints for --help, in a process of its own."""
    done = subprocess.run(
        [sys.executable, str(ROOT / COMMANDS[command]), "--help"],
        cwd=directory,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


def models() -> dict[str, str]:
    """SHA-256 of every pretrained model's description."""
    return {
        file.parent.name: hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(pretrained.DIRECTORY.glob(f"*/{DESCRIPTION}"))
    }


def _arrays(name: str, windows: Windows) -> Iterator[tuple[str, np.ndarray]]:
    for key, value in vars(windows).items():
        yield f"{name}/{key}", np.asarray(value)


def _write(file: Path, what: Mapping) -> None:
    file.write_text(json.dumps(what, indent=1, sort_keys=True, allow_nan=False) + "\n")


def main() -> None:
    """Record everything anew; windows only where there are none, since answers hang on them."""
    HELP.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as scratch:
        directory = Path(scratch)
        by_arithmetic = json.loads(DIGESTS.read_text()) if DIGESTS.exists() else {}
        by_arithmetic[arithmetic()] = {name: digest(name, directory) for name in DATASETS}
        _write(DIGESTS, by_arithmetic)
        if not WINDOWS.exists():
            arrays: dict[str, np.ndarray] = {}
            for name, situation in SITUATIONS.items():
                (directory / name).mkdir()
                arrays |= dict(_arrays(name, drawn(situation, directory / name)))
            np.savez_compressed(WINDOWS, **arrays)
        _write(ANSWERS, {name: answers(name) for name in SITUATIONS})
        _write(MODELS, models())
        with ThreadPoolExecutor(2) as pool:
            texts = pool.map(lambda command: help_of(command, directory), COMMANDS)
            for command, text in zip(COMMANDS, texts, strict=True):
                (HELP / f"{command}.txt").write_text(text)


if __name__ == "__main__":
    main()
