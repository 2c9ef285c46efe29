"""ArduPilot's dataflash logs, binary (.bin) and text (.log): IMU messages, in rad/s and m/s^2,
forward-right-down, by its log message definitions."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lbgc.data.readers.formats.extras import needed
from lbgc.data.readers.formats.table import AT_ONCE, Pieces, Table, in_memory

MAGIC, TEXT = b"\xa3\x95\x80", b"FMT, "
_KINDS = ("IMU", "IMU2", "IMU3")
_TIMES = {"TimeUS": "us", "TimeMS": "ms"}
_VALUES = {"GyrX": "rad/s", "GyrY": "rad/s", "GyrZ": "rad/s",
           "AccX": "m/s2", "AccY": "m/s2", "AccZ": "m/s2"}  # fmt: skip
_INSTANCE = "I"
_HEAD = 3
"""Bytes of a message before its fields"""
_TYPES = {"b": "i1", "B": "u1", "M": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4",
          "q": "<i8", "Q": "<u8", "g": "<f2", "f": "<f4", "d": "<f8", "n": "S4", "N": "S16",
          "Z": "S64", "a": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4",
          "L": "<i4"}  # fmt: skip
_FRAME = "axes: ArduPilot states rates and forces forward, right, down, which is log.axes=[x,y,z]"


def read(path: Path) -> list[Table]:
    """The tables of a log's IMU messages, one for each sensor. Raises InputError where pymavlink is
    missing."""
    reader = needed("pymavlink.DFReader")
    with path.open("rb") as file:
        is_text = file.read(len(TEXT)) == TEXT
    if is_text:
        return _of_text(reader.DFReader_text(str(path)))
    opened = reader.DFReader_binary(str(path))
    kinds = {opened.formats[kind].name: kind for kind in opened.formats}
    return [
        own for name in _KINDS if name in kinds
        for own in _of_kind(opened, opened.formats[kinds[name]], name)
    ]  # fmt: skip


def _of_kind(opened: Any, told: Any, name: str) -> list[Table]:
    """The tables of one kind of message in a binary log: one for each instance of the sensor."""
    dtype = np.dtype([(own, _TYPES[letter]) for own, letter in
                      zip(told.columns, told.format.rstrip("\0"), strict=True)])  # fmt: skip
    if dtype.itemsize != told.len - _HEAD:
        raise ValueError(f"messages {name} of {told.len} bytes, whose fields have {dtype.itemsize}")
    content = np.frombuffer(opened.data_map, np.uint8)
    places = np.asarray(opened.offsets[told.type], np.int64)
    places = places[places + told.len <= len(content)]
    names = _wanted(told.columns)
    if names is None or not len(places):
        return []
    if _INSTANCE not in told.columns:
        return [_table(name, names, content, dtype, places)]
    numbers = np.concatenate([own[0] for own in _pieces(content, dtype, places, [_INSTANCE])])
    every = np.unique(numbers)
    titles = [name if len(every) == 1 else f"{name}_{number}" for number in every]
    return [
        _table(title, names, content, dtype, places[numbers == number])
        for title, number in zip(titles, every, strict=True)
    ]


def _table(
    title: str, names: dict[str, str], content: np.ndarray, dtype: np.dtype, places: np.ndarray
) -> Table:
    """The table of messages at these places of a log."""
    own = list(names)
    return Table(title, tuple(own), tuple(names.values()), len(places),
                 lambda which: _pieces(content, dtype, places, [own[at] for at in which]),
                 (_FRAME,))  # fmt: skip


def _wanted(columns: Sequence[str]) -> dict[str, str] | None:
    """The time and the six values among a message's fields, each with its unit; None where one of
    them is missing."""
    time = next((own for own in _TIMES if own in columns), None)
    if time is None or not set(_VALUES) <= set(columns):
        return None
    return {time: _TIMES[time], **_VALUES}


def _pieces(
    content: np.ndarray, dtype: np.dtype, places: np.ndarray, names: Sequence[str]
) -> Pieces:
    """Fields of messages at these places, piece by piece."""
    within = np.arange(dtype.itemsize)
    for first in range(0, len(places), AT_ONCE // 4):
        start = places[first : first + AT_ONCE // 4, None] + _HEAD
        rows = np.ascontiguousarray(content[start + within]).view(dtype)[:, 0]
        yield [rows[name] for name in names]


def _of_text(opened: Any) -> list[Table]:
    """The tables of a text log's IMU messages."""
    found: dict[str, list[list[float]]] = {}
    units: dict[str, dict[str, str]] = {}
    while (message := opened.recv_match(type=list(_KINDS))) is not None:
        fields = message.get_fieldnames()
        title = message.get_type()
        if _INSTANCE in fields:
            title += f"_{int(getattr(message, _INSTANCE))}"
        names = _wanted(fields)
        if names is not None:
            units[title] = names
            found.setdefault(title, []).append([getattr(message, own) for own in names])
    tables = []
    for title, rows in found.items():
        name = title.partition("_")[0] if len(found) == 1 else title
        values = map(np.array, zip(*rows, strict=True))
        columns = dict(zip(units[title], values, strict=True))
        tables.append(in_memory(name, columns, units[title], (_FRAME,)))
    return tables
