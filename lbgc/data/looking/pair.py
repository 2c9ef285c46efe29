"""Gyros and accelerometers in two files or tables: which has which, and both as one recording."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lbgc.data import logs, two_clocks
from lbgc.data.logconfig import NONE, LogConfig
from lbgc.data.looking import columns, layout
from lbgc.data.looking.case import Case
from lbgc.data.looking.clocked import timed
from lbgc.data.looking.sensor import Means
from lbgc.data.readers import raw as readers
from lbgc.data.readers.formats import files
from lbgc.data.readers.picked import Picked, picked
from lbgc.data.readers.raw import Raw
from lbgc.data.readers.sheets import Sheet
from lbgc.errors import InputError, require

KEYS = ("accel_path", "accel_table", "accel_rows")
"""Keys of which each says that the accelerometers are apart from the gyros."""
_MOST = 12
"""Files among which two that are of one sensor are looked for."""
_GYRO_FILE = re.compile(r"gyr|angular|rotation|turn.?rate|drehrate", re.I)
"""Names of files of gyros."""


@dataclass(frozen=True)
class Pair:
    """The two triads as their tables have them."""

    gyro: Sheet
    """The gyros' table"""
    found: columns.Columns
    """Its columns"""
    picked: tuple[Picked, Picked]
    """What is read of either table, with the units that its names state"""
    raws: tuple[Raw, Raw]
    """What was read"""


def of_files(paths: Sequence[str], said: Mapping[str, Any]) -> tuple[str, str] | None:
    """The file of gyros and that of accelerometers, where there is one of each among several files,
    with no other triad in it; None where that is not so, or columns are said.

    said : keys of `LogConfig` that the user states of them.
    """
    keys = (*KEYS, "columns", "gyro_columns", "accel_columns")
    if not 2 <= len(paths) <= _MOST or any(key in said for key in keys):
        return None
    parts = [_part(path, said) for path in paths]
    if parts.count("gyro") != 1 or parts.count("accel") != 1:
        return None
    return paths[parts.index("gyro")], paths[parts.index("accel")]


def _part(path: str, said: Mapping[str, Any]) -> str | None:
    """The one triad that a file has, gyro or accel; None where it has both, or it is not clear. A
    triad without a name is the accelerometers' where it rests at 1 g; that it is the gyros', and no
    magnetometer's, the file's name must say."""
    place = readers.find(path)
    if not place.is_file():
        return None
    kept = {key: said[key] for key in ("table", "dtype", "skip_bytes") if key in said}
    try:
        with files.opened(place, LogConfig(path=path, **kept), _alone) as own:
            part, is_named = _alone(own)
    except InputError:
        return None
    clear = is_named or part == "accel" or _GYRO_FILE.search(place.stem) is not None
    return part if clear else None


def _alone(own: Sheet) -> tuple[str, bool]:
    """The one triad of a table, and whether its columns' names say which it is. Raises InputError
    where it has none, or two."""
    by_name = columns.named_triads(own)
    if len(by_name) == 1:
        return by_name[0], True
    at = [] if by_name else columns.find_one(own, "accel").accel
    require(bool(at), "log.columns", own.file, "has no three columns that are one triad alone")
    return "accel" if columns.is_at_one_g(own, at) else "gyro", False


@contextmanager
def opened(case: Case) -> Iterator[Pair | None]:
    """The two triads of a log whose accelerometers are said to be apart, within the `with` block;
    None where a key is asked for without which they cannot be read."""
    configs = readers.each_triad(case.trial())
    with _sheet(configs[0]) as gyro, _sheet(configs[1]) as accel:
        found = [
            _found(own, config, part, case)
            for own, config, part in zip((gyro, accel), configs, ("gyro", "accel"), strict=True)
        ]
        if not all(guess.sure for guess in case.guesses if guess.key.endswith("_columns")):
            yield None
            return
        try:
            raws = readers.triads_apart(case.trial())
            configs = readers.each_triad(case.trial())
            which = picked(gyro, configs[0]), picked(accel, configs[1])
        except InputError as error:
            case.ask(error, ("accel_path",))
            yield None
            return
        yield Pair(gyro, found[0], which, raws)


def _sheet(config: LogConfig) -> Any:
    """The table of one triad, opened."""
    path = readers.find(str(config.path))
    place = path if files.is_bag_directory(path) else readers.only_file(path, config.path)
    return files.opened(place, config)


def _found(own: Sheet, config: LogConfig, part: str, case: Case) -> columns.Columns:
    """Find the columns of one triad's table."""
    found = columns.find_one(own, part)
    what = "gyros" if part == "gyro" else "accelerometers"
    case.facts.append(f"{what} of {Path(str(config.path)).name}: {layout.kind(own)}")
    for guess in found.guesses:
        if guess.key != "time_column" or part == "gyro":
            case.note(guess)
        elif guess.value != config.time_column:
            case.note(replace(guess, key="accel_time_column"))
    case.facts.append(f"{layout.which(own, found)}")
    return found


def on_one_clock(own: Pair, case: Case) -> Means | None:
    """The two triads as one recording, as they are printed; None where they cannot be, and a key is
    asked for."""
    gyro, accel = own.raws
    try:
        whole = two_clocks.in_rows(gyro, accel)
    except InputError as error:
        case.ask(error, ("accel_path",))
        return None
    if whole is not None:
        return timed(counted(whole), case)
    return _of_two_clocks(gyro, accel, case)


def counted(raw: Raw) -> Raw:
    """A recording with its counts scaled, along the file's own axes and in its own units."""
    return replace(raw, gyro=raw.config.counted("gyro", raw.gyro),
                   accel=raw.config.counted("accel", raw.accel))  # fmt: skip


def _of_two_clocks(gyro: Raw, accel: Raw, case: Case) -> Means | None:
    """The two triads on the slower one's samples, by the reading of every log of two clocks."""
    for raw in (gyro, accel):
        timed(raw, case)
    keys = {key: case.keys[key] for key in ("time_unit", "gaps") if case.keys.get(key)}
    plain = {"gyro_unit": "rad/s", "accel_unit": "m/s2", **keys}
    one, other = (replace(raw, config=replace(raw.config, **plain)) for raw in (gyro, accel))
    try:
        recordings = list(logs.of_two_clocks(one, other))
    except InputError as error:
        case.ask(error, ("accel_path",))
        return None
    best = max(recordings, key=lambda recording: recording.record.duration_s)
    record = best.record
    case.facts += [note for note in record.notes if note not in case.facts]
    first = round(best.start_s * record.rate_hz)
    return Means(record.name, record.gyro, record.accel, record.rate_hz, first)


def of_rows(pair: tuple[Raw, Raw], case: Case) -> Means | None:
    """The two triads of a table of which each row has one."""
    case.facts.append("each of its rows has one triad, and empty cells for the other")
    return _of_two_clocks(*pair, case)


def said_apart(said: Mapping[str, Any]) -> bool:
    """Whether the accelerometers are said to be apart from the gyros."""
    both = NONE not in (said.get("gyro_columns"), said.get("accel_columns"))
    return both and any(said.get(key) is not None for key in KEYS)
