"""The examination of one file: from its first line to a description with which it is read, and what
of that is a guess."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lbgc import outputs
from lbgc.data import logs
from lbgc.data.checks.moved import PLATE
from lbgc.data.checks.plausible import PER_HOUR
from lbgc.data.logconfig import LogConfig
from lbgc.data.logs import Recording
from lbgc.data.looking import carousel, columns, layout, pair, sensor, stretch, turned
from lbgc.data.looking.case import Case
from lbgc.data.looking.clocked import timed
from lbgc.data.looking.guess import Guess
from lbgc.data.looking.sensor import Means
from lbgc.data.readers import raw as readers
from lbgc.data.readers.formats import files
from lbgc.data.readers.picked import picked
from lbgc.data.readers.raw import plate_unit
from lbgc.data.readers.sheets import Sheet
from lbgc.data.record import Record, TriadRecord
from lbgc.data.rests import longest_rest
from lbgc.data.two_clocks import interleaved
from lbgc.earth import EARTH_RATE
from lbgc.errors import InputError
from lbgc.frames import AXES, DOWN
from lbgc.units import DEG

_PLATE = ("plate_column", "positions", "angles_deg")
"""Keys that state a plate's angle."""
_TUMBLED = "evaluate estimator=tumble finds the heading of each, from the whole log (README)"
"""What the commands do with a log of several attitudes."""
_TO_OPEN = ("table", "dtype", "skip_bytes")
"""Keys without which some files have no columns."""


@dataclass(frozen=True)
class Look:
    """What the doctor found of one file."""

    path: Path
    name: str
    """A name that a log may have"""
    facts: tuple[str, ...]
    """What the file is, plain sentences"""
    guesses: tuple[Guess, ...]
    """The keys of its description, those that were said left out"""
    keys: Mapping[str, Any]
    """The description: keys of `LogConfig` with their values, said or guessed"""
    record: Record | None = None
    """The recording (the longest, where there are several); None where it cannot be read so"""
    notes: tuple[str, ...] = ()
    """What reading it noted"""
    refusal: InputError | None = None
    """Why it cannot be evaluated so; None where it can"""
    alone: TriadRecord | None = None
    """The recording of the only triad, where there is one; the longest, likewise"""

    @cached_property
    def still(self) -> Record | None:
        """The recording where it rests: all of it, or the longest rest of one whose plate turns"""
        turns = self.record is not None and np.ptp(self.record.plate_angle) > PLATE
        return longest_rest(self.record) if self.record is not None and turns else self.record

    @property
    def rest(self) -> Record | TriadRecord | None:
        """What rests of both triads, or of the only one; None where nothing can be read."""
        return self.alone if self.still is None else self.still

    @property
    def asks(self) -> list[Guess]:
        """The guesses that the user is asked about."""
        return [guess for guess in self.guesses if not guess.sure]

    @property
    def is_described(self) -> bool:
        """Whether all but a heading can be had from the description: a fit of its noise."""
        read = self.rest is not None
        return read and all(guess.heading_only for guess in self.asks)

    @property
    def is_sure(self) -> bool:
        """Whether a result may rest on the description."""
        return not self.asks and self.refusal is None


def looked(path: Path, said: Mapping[str, Any], heading: bool = True) -> Look:
    """Examine a file. said : keys of `LogConfig` that the user states, with their values; heading :
    whether one is asked for. Where it is not, the file is described by its longest rest, and not
    read by that description.

    Raises InputError where it is no file that any reader takes.
    """
    case = Case(said, heading, keys={"path": str(path), **said})
    name = outputs.shown(path.stem)
    case.keys.setdefault("name", name)
    special = _special(path)
    if special is not None:
        case.keys["reader"], what = special
        case.facts.append(what)
        if special[0] == "psins":
            case.note(Guess("axes", ["y", "x", "-z"], "PSINS files are right, forward, up"))
    else:
        case.keys["reader"] = "table"
        ready = _examined(path, case)
        if not ready:
            return Look(path, name, tuple(case.facts), tuple(case.guesses), case.keys)
    if not heading:
        return Look(path, name, tuple(case.facts), tuple(case.guesses), case.keys)
    return _read(path, name, case)


def _special(path: Path) -> tuple[str, str] | None:
    """The reader of a file or directory that is no table, and what it is; None for a table."""
    if path.is_dir() and not files.is_bag_directory(path):
        every = outputs.listed(path, "*.csv")
        return "recordings", f"a directory of {len(every)} CSV files, a recording each"
    if path.suffix.lower() == ".imu":
        return "psins", "a PSINS file, whose header has rate, latitude, heading and counts"
    return None


def _examined(path: Path, case: Case) -> bool:
    """Find a table's keys; whether there are enough to read it."""
    if pair.said_apart(case.said):
        return _examined_pair(case)
    place = path if files.is_bag_directory(path) else readers.only_file(path, path)
    kept = {key: case.said[key] for key in _TO_OPEN if key in case.said}
    try:
        with files.opened(place, LogConfig(path=str(path), **kept)) as own:
            return _found(own, case)
    except InputError as error:
        if error.name != "log.table":
            raise
        case.ask(error, ("table",))
        return False


def _examined_pair(case: Case) -> bool:
    """Find the keys of gyros and accelerometers that are apart; whether there are enough to read
    them."""
    try:
        with pair.opened(case) as own:
            means = None if own is None else pair.on_one_clock(own, case)
            if own is None or means is None:
                return False
            found = own.found
            if len(means.gyro) != len(own.raws[0].gyro):
                found = replace(found, plate=None, others=())  # which are of the gyros' samples
            stated = own.picked[0].gyro_unit, own.picked[1].accel_unit
            _described(means, own.gyro, found, stated, ("gyro", "accel"), case)
            return _can_be_read(case)
    except InputError as error:
        if error.name not in ("log.table", "log.accel_table"):
            raise
        case.ask(error, ("table",))
        return False


def _can_be_read(case: Case) -> bool:
    """Whether there are enough keys to read a table."""
    return all(guess.value is not None or guess.heading_only for guess in case.guesses)


def _found(own: Sheet, case: Case) -> bool:
    """Find the keys of an opened table; whether there are enough to read it."""
    case.facts.append(layout.kind(own))
    found = columns.find(own)
    named = "columns" in case.said or {"gyro_columns", "accel_columns"} <= case.said.keys()
    for guess in found.guesses:
        if not (named and guess.key == "columns"):
            case.note(guess)
    if not (found.gyro or found.accel or named):
        return False
    if not named:
        case.facts.append(layout.which(own, found))
    try:
        raw = readers.of_sheet(own, case.keys["name"], case.trial())
    except InputError as error:
        case.ask(error, ("columns",))
        return False
    says = picked(own, raw.config)
    apart = interleaved(raw)
    means = timed(pair.counted(raw), case) if apart is None else pair.of_rows(apart, case)
    if means is None:
        return False
    if len(means.gyro) != len(raw.gyro) and apart is not None:
        found = replace(found, plate=None, others=())  # which are of the gyros' samples
    stated = says.gyro_unit, says.accel_unit
    _described(means, own, found, stated, raw.config.recorded, case)
    return _can_be_read(case)


def _described(
    means: Means,
    own: Sheet,
    found: columns.Columns,
    stated: tuple[str | None, str | None],
    recorded: Sequence[str],
    case: Case,
) -> None:
    """Find where it rests, its units, its axes, and how a plate turned it. stated : the units of
    gyros and accelerometers by the columns' names; recorded : the triads that there are."""
    means = _as_said(means, case.said)
    still = stretch.rest(means.gyro, means.accel, means.rate_hz)
    rest = means.part(still.first, still.last)
    latitude = None if (given := case.said.get("latitude")) is None else given * DEG
    accel = gyro = None
    if "accel" in recorded:
        accel = _one(case, "accel_unit", lambda: sensor.accel_unit(rest, stated[1]))
    if "gyro" in recorded:
        moves = still.last - still.first < len(means.gyro)
        gyro = _one(
            case,
            "gyro_unit",
            lambda: sensor.gyro_unit(rest, stated[0], latitude, moves),
        )
    if "latitude" not in case.said and len(recorded) == 2:
        why = "" if gyro is None else sensor.latitude(rest, gyro)
        doubt = "where was it recorded?"
        case.note(Guess("latitude", None, why, doubt, sure=False, heading_only=True))
    if accel is not None and gyro is not None:
        if "axes" not in case.said:
            stated_frame = layout.frame(own)
            for guess in (
                sensor.axes(rest, gyro, latitude)
                if stated_frame is None
                else sensor.stated_axes(rest, gyro, latitude, stated_frame)
            ):
                case.note(guess)
        if _is_wanted(case, still, means) and _turned(means, still, own, found, gyro, case):
            return
    _cut(still, means, case)


def _is_wanted(case: Case, still: stretch.Stretch, means: Means) -> bool:
    """Whether turns are looked for: for a heading, and where all of it may be an even turn, since
    that is no rest."""
    return case.heading or still.last - still.first == len(means.gyro)


def _as_said(means: Means, said: Mapping[str, Any]) -> Means:
    """The values between the times that the user states."""
    first = max(0, round(said.get("from_s", 0.0) * means.rate_hz) - means.first)
    last = len(means.gyro)
    if (to_s := said.get("to_s")) is not None:
        last = min(last, round(to_s * means.rate_hz) - means.first)
    return means.part(first, last) if last - first > 1 else means


def _cut(still: stretch.Stretch, means: Means, case: Case) -> None:
    """Describe where it rests: its longest stretch."""
    first, last = ((means.first + row) / means.rate_hz for row in (still.first, still.last))
    if still.last - still.first < len(means.gyro):
        if still.first:
            case.note(Guess("from_s", round(first, 3), f"it moves until {first:.6g} s"))
        if still.last < len(means.gyro):
            case.note(Guess("to_s", round(last, 3), f"it moves from {last:.6g} s on"))
        case.facts.append(f"it rests from {first:.6g} to {last:.6g} s, its longest stretch")
        if means.accel.shape[1] and (count := stretch.attitudes(means.accel, still)) > 1:
            case.facts.append(f"it was laid in {count} attitudes: {_TUMBLED}")
    elif still.moving_s:
        case.facts.append(f"it rests but for {still.moving_s:.3g} s of knocks or motion")


def _turned(
    means: Means, still: stretch.Stretch, own: Sheet, found: columns.Columns, unit: str, case: Case
) -> bool:
    """Find how a plate turned it: whether a column or the user states the angles, so that it is
    read whole. Turns that no column has are asked about. unit : of the gyros."""
    if any(case.said.get(key) is not None for key in _PLATE):
        return True
    axes = case.keys["axes"]
    felt = turned.course(means, still, unit, axes, case.keys.get("accel_axes", axes))
    rows = slice(means.first, means.first + len(means.gyro))
    by_name = found.plate is not None
    for at in [found.plate] if by_name else found.others if felt.is_turned else ():
        assert at is not None
        (values,), _ = own.columns([at])
        name, key = columns.named(own, at), columns.key(own, at)
        plate = None
        if values.dtype.kind in "fi":
            stated = plate_unit(own, at)
            plate = turned.plate(name, key, values[rows], means, felt, unit, axes, stated)
        off = 0.0 if plate is None else turned.off_level(_angle(values[rows], plate), felt)
        if plate is not None and off < turned.LEVEL:
            for guess in plate:
                case.note(guess)
            return True
        if plate is not None:
            said = f"{name} turns as the gyros do, but is {off / DEG:.3g} deg off at its first rest"
            case.facts.append(f"{said}, by gravity: it is not used")
        elif by_name and np.ptp(values[rows]) > 0:
            case.facts.append(f"{name} does not turn as the gyros do: it is not used")
    if not felt.is_turned:
        if "plate_column" not in case.keys and (even := carousel.guess(means, unit, axes)):
            case.note(even)
        return False
    where = means.first / means.rate_hz
    list_of = [[a + where, b + where, c] for a, b, c in felt.positions(means.rate_hz)]
    written = ",".join("[" + ",".join(f"{v:.10g}" for v in each) + "]" for each in list_of)
    turns = ", ".join(f"{turn / DEG:+.1f}" for turn in felt.turns)
    why = (
        f"its gyros felt turns of {turns} deg about {felt.about} from rest to rest, and no column "
    )
    why += "has them"
    level = felt.axis != DOWN
    how = "by the right-hand rule" if level else "clockwise from above"
    key = f"log.plate_axis={AXES[felt.axis]} " if level else ""
    doubt = f"if a plate turned it so, {how}: {key}log.positions=[{written}]; or "
    doubt += f"log.from_s={list_of[0][0]:g} log.to_s={list_of[0][1]:g} for its first rest alone."
    case.note(Guess("positions", None, why, doubt, sure=False, heading_only=True))
    return False


def _angle(values: np.ndarray, guesses: Sequence[Guess]) -> np.ndarray:
    """A plate's column, (T,), as the description has it, rad."""
    keys = {guess.key: guess.value for guess in guesses}
    unit = 1.0 if keys.get("plate_unit") == "rad" else DEG
    return np.asarray(values * (keys.get("plate_scale") or 1.0) * unit)


def _one(case: Case, key: str, guess: Callable[[], Guess]) -> str | None:
    """The value of a unit's key: as said, or as guessed, which is noted."""
    if case.said.get(key, "auto") != "auto":
        return str(case.said[key])
    found = guess()
    case.note(found)
    return str(found.value) if found.sure else None


def _read(path: Path, name: str, case: Case, found: list[Recording] | None = None) -> Look:
    """Read the file by what was found, as every command would. found : what was read so already."""
    keys = {k: v for k, v in case.keys.items() if v is not None}
    look = Look(path, name, tuple(case.facts), tuple(case.guesses), keys)
    config = LogConfig(**keys)
    try:
        alone = logs.read_noise(config) if len(config.recorded) == 1 else []
        said = tuple(dict.fromkeys(note for own in alone for one in own for note in one.notes))
        every = [one for own in alone for one in own if isinstance(one, TriadRecord)]
        longest = max(every, key=lambda one: len(one.values), default=None)
        look = replace(look, alone=longest, notes=said)
        read = logs.unchecked(config) if found is None else found
    except InputError as error:
        return replace(look, refusal=error.with_traceback(None))
    north = all(np.isfinite(own.record.latitude) for own in read)
    refusal = None
    for asked in (True, False) if north else (False,):
        try:
            records = logs.checked(read, config, north=asked)
        except InputError as error:
            if error.name == "log.most_bias_deg_per_h" and "most_bias_deg_per_h" not in case.keys:
                return _read(path, name, case, _biased(read, config, case))
            refusal = refusal or error.with_traceback(None)  # which would hold the recordings
            continue
        record = max(records, key=lambda own: len(own.gyro))
        return replace(look, record=record, notes=record.notes, refusal=refusal)
    return replace(look, refusal=refusal)


def _biased(found: list[Recording], config: LogConfig, case: Case) -> list[Recording]:
    """The recordings of a file whose bias exceeds what is taken as possible: the description says
    how large it may be, and the doubt what that means."""
    record = logs.checked(found, config, north=False)[0]
    off = sensor.least_bias(record.gyro.mean(0), record.accel.mean(0), record.latitude)
    most = float(f"{1.5 * off * PER_HOUR:.1g}")
    horizontal = EARTH_RATE * np.cos(record.latitude) * PER_HOUR
    why = f"its bias is {off * PER_HOUR:.4g} deg/h at the least, beside Earth's horizontal "
    why += f"{horizontal:.3g}: at rest it hides north, a turn of the plate takes it out"
    case.note(Guess("most_bias_deg_per_h", most, why))
    return [replace(own, config=replace(own.config, most_bias_deg_per_h=most)) for own in found]
