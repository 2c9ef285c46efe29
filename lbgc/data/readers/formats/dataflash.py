"""ArduPilot's dataflash logs, binary (.bin) and text (.log): IMU messages, in rad/s and m/s^2,
forward-right-down, by its log message definitions.

A log describes its own messages: FMT says of each kind its number, length, name, types and fields.
A binary message is 0xA3 0x95, its kind, and its fields, little-endian.
"""

import mmap
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lbgc.data.readers.formats.table import AT_ONCE, Frame, Pieces, Table, cut_short, in_memory

MAGIC, TEXT = b"\xa3\x95\x80", b"FMT, "
_KINDS = ("IMU", "IMU2", "IMU3")
_TIMES = {"TimeUS": "us", "TimeMS": "ms"}
_VALUES = {"GyrX": "rad/s", "GyrY": "rad/s", "GyrZ": "rad/s",
           "AccX": "m/s2", "AccY": "m/s2", "AccZ": "m/s2"}  # fmt: skip
_INSTANCE = "I"
_MARK, _HEAD = b"\xa3\x95", 3
"""What a message begins with, and the bytes before its fields"""
_FMT, _FMT_TYPE = 128, np.dtype([("kind", "u1"), ("length", "u1"), ("name", "S4"),
                                 ("types", "S16"), ("fields", "S64")])  # fmt: skip
_TYPES = {"b": "i1", "B": "u1", "M": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4",
          "q": "<i8", "Q": "<u8", "g": "<f2", "f": "<f4", "d": "<f8", "n": "S4", "N": "S16",
          "Z": "S64", "a": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4",
          "L": "<i4"}  # fmt: skip
_FRAME = Frame(("x", "y", "z"), "ArduPilot states rates and forces forward, right, down")


@dataclass(frozen=True)
class _Kind:
    """A kind of message, as a log describes it."""

    name: str
    types: str
    fields: tuple[str, ...]

    @property
    def dtype(self) -> np.dtype:
        """The type of its fields. Raises ValueError where they have types that nobody knows."""
        if len(self.types) != len(self.fields) or not set(self.types) <= _TYPES.keys():
            raise ValueError(f"says of {self.name} that its types are {self.types}")
        return np.dtype([(own, _TYPES[letter]) for own, letter in
                         zip(self.fields, self.types, strict=True)])  # fmt: skip

    @property
    def wanted(self) -> dict[str, str] | None:
        """The time and the six values among its fields, each with its unit; None where one of them
        is missing."""
        time = next((own for own in _TIMES if own in self.fields), None)
        if self.name not in _KINDS or time is None or not set(_VALUES) <= set(self.fields):
            return None
        return {time: _TIMES[time], **_VALUES}


def read(path: Path) -> list[Table]:
    """The tables of a log's IMU messages, one for each sensor. Raises ValueError where the log
    contradicts itself."""
    with path.open("rb") as file:
        if file.read(len(TEXT)) == TEXT:
            return _of_text(path)
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    kinds, places, passed_over, left = _index(content)
    notes = [_FRAME.note]
    if passed_over:
        notes.append(f"damage: {passed_over} bytes of {path.name} are no messages and were passed "
                     "over")  # fmt: skip
    if left:
        notes.append(cut_short(path.name, f"the last {left} bytes are no whole message"))
    found = np.frombuffer(content, np.uint8)
    return [
        own for kind, at in places.items()
        for own in _of_kind(kinds[kind], found, np.frombuffer(at, np.int64), tuple(notes))
    ]  # fmt: skip


def _index(content: mmap.mmap) -> tuple[dict[int, _Kind], dict[int, "array[int]"], int, int]:
    """The kinds of a log's messages, the places of those of IMUs, how many bytes before the last
    message are none, and how many there are after it."""
    kinds: dict[int, _Kind] = {}
    lengths = [0] * 256
    lengths[_FMT] = _HEAD + _FMT_TYPE.itemsize
    places: dict[int, array[int]] = {}
    at = end = passed_over = lost = 0
    size = len(content)
    while at + _HEAD <= size:
        kind = content[at + 2]
        length = lengths[kind]
        if content[at : at + 2] != _MARK or not length:
            after = content.find(_MARK, at + 1)
            after = size if after < 0 else after
            lost += after - at
            at = after
            continue
        if at + length > size:
            break
        passed_over, lost = passed_over + lost, 0
        if kind in places:
            places[kind].append(at)
        elif kind == _FMT:
            number, length_of, own = _described(content[at + _HEAD : at + length])
            if own.wanted is not None and own.dtype.itemsize + _HEAD != length_of:
                raise ValueError(f"says of {own.name} that it has {length_of} bytes")
            if number in kinds and own != kinds[number]:
                raise ValueError(f"describes messages of the number {number} in two ways")
            kinds[number], lengths[number] = own, max(length_of, _HEAD)
            if own.wanted is not None:
                places[number] = array("q")
        at = end = at + length
    return kinds, places, passed_over, size - end


def _described(content: bytes) -> tuple[int, int, _Kind]:
    """The number, the length and the description of a kind of message, from a FMT message."""
    (own,) = np.frombuffer(content, _FMT_TYPE)
    name, types, fields = (own[key].decode("latin-1") for key in ("name", "types", "fields"))
    return int(own["kind"]), int(own["length"]), _Kind(name, types, tuple(fields.split(",")))


def _of_kind(
    kind: _Kind, content: np.ndarray, places: np.ndarray, notes: tuple[str, ...]
) -> Iterator[Table]:
    """The tables of one kind of message: one for each instance of the sensor."""
    if not len(places):
        return
    numbers = np.zeros(len(places), int)
    if _INSTANCE in kind.fields:
        every = _pieces(content, kind.dtype, places, [_INSTANCE])
        numbers = np.concatenate([own for (own,) in every])
    present = np.unique(numbers)
    for number in present:
        title = kind.name if len(present) == 1 else f"{kind.name}_{number}"
        own = places if len(present) == 1 else places[numbers == number]
        yield _table(title, kind, content, own, notes)


def _table(
    title: str, kind: _Kind, content: np.ndarray, places: np.ndarray, notes: tuple[str, ...]
) -> Table:
    """The table of messages at these places of a log."""
    units = kind.wanted or {}
    names = tuple(units)

    def pieces(which: Sequence[int]) -> Pieces:
        return _pieces(content, kind.dtype, places, [names[at] for at in which])

    return Table(title, names, tuple(units.values()), len(places), pieces, notes, _FRAME)


def _pieces(
    content: np.ndarray, dtype: np.dtype, places: np.ndarray, names: Sequence[str]
) -> Pieces:
    """Fields of messages at these places, piece by piece."""
    within = np.arange(dtype.itemsize)
    for first in range(0, len(places), AT_ONCE // 8):
        start = places[first : first + AT_ONCE // 8, None] + _HEAD
        rows = np.ascontiguousarray(content[start + within]).view(dtype)[:, 0]
        yield [rows[name] for name in names]


def _of_text(path: Path) -> list[Table]:
    """The tables of a text log's IMU messages, each a line of its name and its fields. Raises
    ValueError where a line has other fields than were described."""
    kinds: dict[str, _Kind] = {}
    found: dict[str, list[array[float]]] = {}
    units: dict[str, dict[str, str]] = {}
    notes = [_FRAME.note]
    with path.open(encoding="latin-1") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith("\n"):
                notes.append(cut_short(path.name, f"the last line, number {number}, has no end"))
                break
            name, *fields = [own.strip() for own in line.split(",")]
            if name == "FMT" and len(fields) > 4:
                kinds[fields[2]] = _Kind(fields[2], fields[3], tuple(fields[4:]))
            kind = kinds.get(name)
            wanted = None if kind is None else kind.wanted
            if kind is None or wanted is None:
                continue
            if len(fields) != len(kind.fields):
                raise ValueError(f"line {number} has {len(fields)} fields")
            row = dict(zip(kind.fields, fields, strict=True))
            title = f"{name}_{int(row[_INSTANCE])}" if _INSTANCE in row else name
            units[title] = wanted
            columns = found.setdefault(title, [array("d") for _ in wanted])
            for own, key in zip(columns, wanted, strict=True):
                own.append(float(row[key]))
    names = [title.partition("_")[0] for title in found]
    return [
        in_memory(
            title if names.count(name) > 1 else name,
            dict(zip(units[title], map(np.array, values), strict=True)),
            units[title],
            tuple(notes),
            _FRAME,
        )
        for name, (title, values) in zip(names, found.items(), strict=True)
    ]
