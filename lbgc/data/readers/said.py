"""The forms in which a log's description names columns, files, times and the fields of rows."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from lbgc.errors import require

_ROW_TYPES = ("f4", "f8", *(f"{kind}{size}" for kind in "iu" for size in (1, 2, 4, 8)))
_PASSED_OVER = re.compile(r"V[1-9]\d{0,4}")


def row_type(fields: list[str], key: str = "log.dtype") -> np.dtype:
    """The NumPy type of a row whose fields are name:type each. Raises InputError, naming `key`,
    where they are not."""
    found: list[tuple[str, str]] = []
    for own in fields:
        name, _, kind = own.rpartition(":")
        order, bare = ("<", kind) if kind[:1] not in ("<", ">") else (kind[0], kind[1:])
        good = bare in _ROW_TYPES or _PASSED_OVER.fullmatch(bare) is not None
        about = "is no name:type, such as w_x:f4; the types are f4, f8, i or u with 1, 2, 4 or 8, "
        about += "after > where they are big-endian, and V with bytes that are passed over"
        require(bool(name.strip()) and good, key, own, about)
        found.append((name.strip(), bare if bare[0] == "V" else order + bare))
    names = [name for name, _ in found]
    twice = len(set(names)) < len(names)
    require(bool(names) and not twice, key, fields, "must be fields of different names")
    return np.dtype(found)


def require_columns(columns: list[Any] | None, time: Any, time_key: str = "time_column") -> None:
    """Raise InputError unless columns are names, or positions counted from one."""
    if columns is not None:
        six = len(columns) == 6 and len(set(map(str, columns))) == 6
        require(six, "columns", columns, "must be six: gyro x, y, z, accelerometer x, y, z")
    times = time if isinstance(time, list) else [] if time is None else [time]
    good = isinstance(time, list) is (len(times) == 2)
    require(good, time_key, time, "must be one column, or [seconds, nanoseconds]")
    for key, given in (("columns", columns or []), (time_key, times)):
        for name in given:
            require_column(key, name)


def require_column(key: str, name: Any) -> None:
    """Raise InputError unless a column is a name, a position counted from one, or not given."""
    known = name is None or isinstance(name, str) or (type(name) is int and name > 0)
    require(known, key, name, "must be a name, or a position counted from one")


def require_paths(files: list[str], angles: list[float] | None) -> None:
    """Raise InputError unless files are named, once each and with an angle each where there are
    any."""
    require(bool(files) and all(files), "path", files, "must name a file")
    require(len(set(files)) == len(files), "path", files, "names a file twice")
    about = f"must be {len(files)}, one for each file of path"
    require(angles is None or len(angles) == len(files), "angles_deg", angles, about)


def require_spans(key: str, spans: Sequence[Sequence[float]], form: str) -> None:
    """Raise InputError unless spans of time, each of the numbers that `form` names, begin with a
    start and an end, s, in order of time and without overlap."""
    last = 0.0
    for own in spans:
        good = len(own) == form.count(",") + 1 and last <= own[0] < own[1] < np.inf
        about = f"must be {form} each, in order of time, without overlap"
        require(good, key, own, about)
        last = own[1]


def require_rows(rows: Sequence[Any] | None) -> None:
    """Raise InputError unless rows are a first and a last one, counted from one, or none given."""
    if rows is None:
        return
    first, last = (*rows, None, None)[:2]
    good = len(rows) == 2 and type(first) is int and first > 0
    good = good and (last is None or (type(last) is int and first < last))
    require(good, "rows", rows, "must be [first, last], counted from one, or [first, null]")
