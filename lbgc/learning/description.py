"""The description of a finished training run, `model.json`, with checksums that reveal damage."""

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lbgc.errors import (
    InputError,
    build,
    reading,
    require,
    require_not_negative,
    require_positive,
)
from lbgc.learning.model import ModelConfig
from lbgc.outputs import UNSEALED, as_json, is_sealed, read_file, seal
from lbgc.sensor.datasheet import ImuConfig

DESCRIPTION = "model.json"
FORMAT = 5
"""Version of the format; it changes whenever another version would misread a run."""
AGAIN = "train it again: python lbgc/train.py data=PATH"
_DEEPEST = 6
"""Groups and lists in each other that a training's configuration has at most."""
_MOST_BYTES = 2**20
_OWN = re.compile(r'"checksum": "([0-9a-f]{64})"')


@dataclass(frozen=True)
class _Units:
    """The units that a network was trained on: their seed, their number, and their sensor."""

    unit_seed: int
    units: int
    imu: ImuConfig

    def __post_init__(self) -> None:
        require_not_negative(self, "unit_seed")
        require_positive("units", self.units)


@dataclass(frozen=True)
class Description:
    """Every key of `model.json`, for checking the file when it is read."""

    format: int
    model: ModelConfig
    rate_hz: float
    sensor: str
    parameters: int
    best_validation_deg: float
    steps: int
    training: Any
    dataset: str | list[str]
    protocol: str
    latitude_deg: list[float]
    """[low, high], the latitudes that it was trained at."""
    imu_rate_hz: float
    units: _Units
    seconds: float
    weights: str
    """SHA-256 of the file of weights."""
    checksum: str
    """SHA-256 of this file with zeros in its place."""
    calibration: Any = None
    """The content of the file of the one unit that it is for (lbgc.data.unit_file)."""
    history: str | None = None
    """SHA-256 of `history.csv`; runs of earlier versions have none."""

    def __post_init__(self) -> None:
        require(self.format == FORMAT, "format", self.format, f"must be {FORMAT}")
        for name in ("rate_hz", "imu_rate_hz", "parameters", "steps"):
            require_positive(name, getattr(self, name))
        require_not_negative(self, "best_validation_deg", "seconds")
        places = self.latitude_deg
        good = len(places) == 2 and -90 <= places[0] <= places[1] <= 90
        require(good, "latitude_deg", places, "must be [low, high], from -90 to 90")
        _plain(self.training, "training", _DEEPEST)
        _plain(self.calibration, "calibration", _DEEPEST)
        windows = self.training.get("windows_s") if isinstance(self.training, dict) else None
        require(
            bool(windows) and isinstance(windows, list), "windows_s", windows, "must be lengths"
        )
        for window in build(_Lengths, {"windows_s": windows}).windows_s:
            require_positive("windows_s", window)


@dataclass(frozen=True)
class _Lengths:
    """What is used of a training's configuration beside being shown."""

    windows_s: list[float]


def _plain(said: Any, name: str, depth: int) -> None:
    """Raise InputError unless a value is made of groups, lists, texts and finite numbers, not
    nested deeper than this."""
    if isinstance(said, dict | list):
        require(depth > 0, name, "...", f"is nested more than {_DEEPEST} deep")
        for own in said.values() if isinstance(said, dict) else said:
            _plain(own, name, depth - 1)
    elif isinstance(said, float):
        require(math.isfinite(said), name, said, "must be a finite number")


def compose(said: Mapping[str, Any], weights: bytes) -> bytes:
    """The content of `model.json`. said : its keys but for the format and checksums; weights : the
    content of the file of weights."""
    own = {"weights": hashlib.sha256(weights).hexdigest(), "checksum": UNSEALED}
    return seal(as_json({"format": FORMAT, **said, **own}).encode() + b"\n")


def parse(content: bytes, name: str, where: object) -> dict[str, Any]:
    """The keys of `model.json`, format and checksums included, from its content; what it does not
    say of its network is as the network's kinds are by default.

    Raises InputError, naming the parameter `name`, where it is of another format or damaged.
    where : the file as an error names it.
    """
    with reading(name, where, "holds a damaged model"):
        said = json.loads(content)
        format_ = said["format"] if isinstance(said, dict) else None
        if isinstance(format_, int) and format_ != FORMAT:
            what = f"is of format {format_}, this version reads {FORMAT}; {AGAIN}"
            raise InputError(name, where, "", what)
        own = _OWN.search(content.decode())
        if own is None or not is_sealed(content, own[1]):
            raise ValueError("its description is not as it was written")
        return {**said, "model": vars(whole(said).model)}


def whole(said: Any) -> Description:
    """The description. Raises ValueError unless it has every key, each of a possible value."""
    try:
        return build(Description, said)
    except InputError as error:  # named by the file, not by a parameter that nobody set
        raise ValueError(str(error)) from error


def read(run: str | Path) -> dict[str, Any]:
    """The description in a run's directory. Raises InputError where there is no finished one."""
    file = Path(run) / DESCRIPTION
    what = "is no finished training run; `python lbgc/train.py data=PATH` prints one's path"
    require(file.is_file(), "run", run, what)
    with reading("run", run, "holds a damaged model"):
        content = read_file(file, _MOST_BYTES)
    return parse(content, "run", run)
