"""What finished fits have found: the estimates in their `fit.json`."""

import json
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from lbgc.data.static import PARTS
from lbgc.errors import InputError, reading, require
from lbgc.outputs import read_file, shown
from lbgc.sensor.fitting.profile import FittedParameter

Found: TypeAlias = dict[str, list[dict[str, FittedParameter]]]
"""Each axis's estimates, SI, by triad and by the parameter's name"""
_MOST = 20 * 2**20
"""Bytes of a file that is read, at most."""
_LARGEST = 1e30


def estimates(directory: str, key: str = "units") -> Found:
    """The estimates of a finished fit, of the triads that it has. Raises InputError, naming the
    directory by `key`, where it holds none."""
    path = Path(directory).expanduser() / "fit.json"
    about = f"holds no {path.name} of a finished fit"
    with reading(key, directory, about):
        content = json.loads(read_file(path, _MOST))
        parts = [part for part in PARTS if part in content]
        found = {part: [_of_axis(axis) for axis in content[part]] for part in parts}
    good = bool(found) and all(1 <= len(axes) <= 3 for axes in found.values())
    require(good, key, directory, about)
    return found


def _of_axis(axis: dict[str, Any]) -> dict[str, FittedParameter]:
    """One axis's estimates. Raises an error where they are none."""
    return {shown(name): _estimate(name, values) for name, values in axis["estimates"].items()}


def _estimate(name: str, values: dict[str, float | None]) -> FittedParameter:
    """One estimate, in which null is an end that is not finite. Raises InputError where the numbers
    are none of an interval."""
    own = [values[key] for key in ("value", "low", "high", "upper")]
    ends = [np.inf if v is None else float(v) for v in own]
    good = ends[0] < _LARGEST and 0 <= ends[1] <= ends[2] and ends[0] >= 0 and ends[1] < _LARGEST
    if not good or np.isnan(ends).any():
        raise InputError(name, ends, "", "is no estimate with its interval")
    return FittedParameter(*ends)
