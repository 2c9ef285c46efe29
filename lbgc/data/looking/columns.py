"""Which of a sheet's columns are gyros, accelerometers, time, temperature and plate angle: by their
names where these tell it, and by their values otherwise.

A resting accelerometer is known by its length: three neighbours whose mean vector has 1 g. The
gyros are then the other three columns, where there is only one way to take them.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from lbgc.data.logconfig import NONE
from lbgc.data.looking.guess import Guess
from lbgc.data.readers.column_names import Described, described, is_gyro, seconds_and_nanoseconds
from lbgc.data.readers.sheets import Sheet, shown
from lbgc.units import FORCE_UNITS, STANDARD_GRAVITY

_MOST = 40
"""Columns that are looked at."""
_NEAR_G = 0.05
"""The relative difference from 1 g up to which three columns may be accelerometers: with a bias of
50 mg, far from Earth's poles."""
_ALIKE = 5.0
"""The most that the noise of a triad's axes differs, as a ratio."""
_ONE_MAKE = 1.5
"""The most that it usually does."""
_OTHERS = {
    "temperature": re.compile(r"(^|[^a-z])(temp|temperature|temperatur|tmp|degc|kelvin)", re.I),
    "plate": re.compile(r"(^|[^a-z])(plate|table|turntable|stage|encoder|resolver|azimuth|angle)",
                        re.I),
    "heading": re.compile(r"(^|[^a-z])((true|ref|reference)[\s_.-]*(heading|hdg|azimuth|yaw)"
                          r"|(heading|hdg|azimuth|yaw)[\s_.-]*(true|ref|reference))", re.I),
}  # fmt: skip
"""Names of columns beside the sensors'."""
_WARM = (-90.0, 150.0), (183.0, 423.0)
"""Temperatures that a sensor may have, degrees Celsius and kelvin."""


@dataclass(frozen=True)
class Columns:
    """The columns of a sheet by what they hold, counted from zero; None or empty where they are not
    found."""

    gyro: tuple[int, ...]
    accel: tuple[int, ...]
    time: tuple[int, ...]
    plate: int | None
    """The one whose name is that of a plate's angle"""
    others: tuple[int, ...]
    """Numeric ones that are nothing of all this"""
    guesses: tuple[Guess, ...]
    """The keys of `LogConfig` that name them"""

    @property
    def alone(self) -> bool:
        """Whether they are of one triad."""
        return bool(self.gyro) != bool(self.accel)


@dataclass(frozen=True)
class _Column:
    """What the values of one numeric column look like."""

    at: int
    mean: float
    noise: float
    """1 sigma from row to row"""
    rises: bool
    """Whether it never falls, and rises"""
    counts: bool
    """Whether it rises by one each row"""


def find(sheet: Sheet) -> Columns:
    """Find a sheet's columns. What is not found has a guess without a value, which says why."""
    says = [described(*own) for own in zip_longest(sheet.names, sheet.units, fillvalue="")]
    numeric = list(_numeric(sheet))
    time, when = _time(sheet, says, numeric)
    others = {name: _named(sheet, name) for name in _OTHERS}
    if others["plate"] == others["heading"]:
        others["plate"] = None
    taken = {*time, *(at for at in others.values() if at is not None)}
    six, which = _by_name(says), None
    gyros = 3
    if six is None:
        left_over = [c for c in numeric if c.at not in taken]
        few = _few_axes(sheet, left_over, says)
        if few is not None:
            gyro, own = few
            own += [when] if when is not None else []
            rest = tuple(c.at for c in left_over if c.at not in gyro and not c.counts)
            more = tuple(_beside(sheet, numeric, others))
            return Columns(gyro, (), time, others["plate"], rest, (*own, *more))
        one = _one_triad(sheet, left_over, says)
        six, which = _by_value(sheet, left_over, says) if one is None else one
        gyros = 0 if which.key == "gyro_columns" else 3
    guesses = [which] if which is not None else []
    guesses += [when] if when is not None else []
    guesses += _beside(sheet, numeric, others)
    left = tuple(c.at for c in numeric if c.at not in taken and c.at not in six and not c.counts)
    return Columns(
        tuple(six[:gyros]), tuple(six[gyros:]), time, others["plate"], left, tuple(guesses)
    )


def find_one(sheet: Sheet, part: str) -> Columns:
    """Find a sheet's columns as `find` does, where only one triad, gyro or accel, is read of it."""
    says = [described(*own) for own in zip_longest(sheet.names, sheet.units, fillvalue="")]
    numeric = list(_numeric(sheet))
    time, when = _time(sheet, says, numeric)
    others = {name: _named(sheet, name) for name in _OTHERS}
    if others["plate"] == others["heading"]:
        others["plate"] = None
    taken = {*time, *(at for at in others.values() if at is not None)}
    at = _of_kind(says, part) or ([sheet.names.index(axis) for axis in "xyz"]
                                  if set("xyz") <= set(sheet.names) else [])  # fmt: skip
    guesses = [when] if when is not None else []
    if not at:
        left = [c for c in numeric if c.at not in taken and not (c.rises or c.counts)]
        left = [c for c in left if says[c.at].kind in (None, part)]
        at = [c.at for c in left] if len(left) == 3 else []
        value, why = [own + 1 for own in at], "they alone can be its three"
        doubt = "" if at else "which three are they?"
        why = why if at else f"{len(left)} columns may be it, where three are looked for"
        guesses.append(Guess(f"{part}_columns", value or None, why, doubt, sure=bool(at)))
    guesses += _beside(sheet, numeric, others) if part == "gyro" else ()
    rest = tuple(c.at for c in numeric if c.at not in taken and c.at not in at and not c.counts)
    gyro, accel = (tuple(at) if part == own else () for own in ("gyro", "accel"))
    return Columns(gyro, accel, time, others["plate"], rest, tuple(guesses))


def named_triads(sheet: Sheet) -> list[str]:
    """The triads, gyro and accel, of a sheet whose columns' names say so."""
    says = [described(*own) for own in zip_longest(sheet.names, sheet.units, fillvalue="")]
    return [part for part in ("gyro", "accel") if _of_kind(says, part)]


def is_at_one_g(sheet: Sheet, at: Sequence[int]) -> bool:
    """Whether the means of three columns, by position, are together 1 g in some unit."""
    values, _ = sheet.head().columns(at)
    return unit_of_force([float(own.mean()) for own in values]) is not None


def _beside(
    sheet: Sheet, numeric: Sequence[_Column], others: dict[str, int | None]
) -> Iterator[Guess]:
    """The columns of a temperature and of a reference heading, by their names, where their values
    may be it."""
    warm, heading = others["temperature"], others["heading"]
    if warm is not None:
        (values,), _ = sheet.head().columns([warm])
        known = values[np.isfinite(values)] if values.dtype.kind == "f" else values
        if values.dtype.kind in "fi" and len(known) > 1:
            low, high = float(known.min()), float(known.max())
            if any(least <= low and high <= most for least, most in _WARM):
                why = f"its name says so, and it is from {low:.4g} to {high:.4g}"
                yield Guess("temperature_column", key(sheet, warm), why)
    if heading is not None and heading in {c.at for c in numeric}:
        doubt = "is it true north's, and the forward axis's?"
        yield Guess("heading_column", key(sheet, heading), "its name says so", doubt)


def key(sheet: Sheet, at: int) -> str | int:
    """A column as a description has it: its name, or its position where that does not tell it."""
    name = sheet.names[at]
    plain = bool(name) and shown(name) == name and not name.isdigit()
    return name if plain and sheet.names.count(name) == 1 else at + 1


def named(sheet: Sheet, at: int) -> str:
    """A column as messages call it."""
    return shown(sheet.names[at]) or f"number {at + 1}"


def _numeric(sheet: Sheet) -> Iterator[_Column]:
    """The columns that hold numbers, with what their values look like."""
    which = range(min(sheet.width, _MOST))
    every, _ = sheet.head().columns(which)
    for at, values in zip(which, every, strict=True):
        if values.dtype.kind not in "fiu":
            continue
        own = values.astype(float)
        steps = np.diff(own)
        if not np.isfinite(own).all() or not len(steps):
            continue
        noise = float(np.median(np.abs(steps - np.median(steps)))) / 0.6745 / np.sqrt(2)
        if noise == 0:
            noise = float(steps.std()) / np.sqrt(2)
        rises = bool(np.all(steps >= 0) and steps.any())
        yield _Column(at, float(own.mean()), noise, rises, bool(np.all(steps == 1)))


def _named(sheet: Sheet, name: str) -> int | None:
    """The one column whose name says that it is a temperature or a plate's angle."""
    found = [at for at, own in enumerate(sheet.names) if _OTHERS[name].search(own[:200])]
    return found[0] if len(found) == 1 else None


def _by_name(says: Sequence[Described]) -> list[int] | None:
    """Gyro and accelerometer columns by their names; None where not all six are named once."""
    both = [_of_kind(says, kind) for kind in ("gyro", "accel")]
    return both[0] + both[1] if all(both) else None


def _of_kind(says: Sequence[Described], kind: str) -> list[int]:
    """A triad's columns by their names; none where not all three are named once."""
    found = [
        [at for at, own in enumerate(says) if (own.kind, own.axis) == (kind, axis)]
        for axis in "xyz"
    ]
    return [own[0] for own in found] if all(len(own) == 1 for own in found) else []


def _one_triad(
    sheet: Sheet, columns: Sequence[_Column], says: Sequence[Described]
) -> tuple[list[int], Guess] | None:
    """The columns of the only triad, and the guess that there is no other: names tell one and none
    of the other, and no columns without a name, or that have together 1 g, may be it. None where
    that is not so."""
    for kind, other, name in (
        ("gyro", "accel", "accelerometers"),
        ("accel", "gyro", "gyros"),
    ):
        at = _of_kind(says, kind)
        if not at or any(said.kind == other for said in says):
            continue
        nameless = [c for c in columns if c.at not in at and not sheet.names[c.at]]
        rest = [c for c in columns if c.at not in at]
        hidden = kind == "gyro" and any(
            _is_one_g(triad) for triad in zip(rest, rest[1:], rest[2:], strict=False)
        )
        if not nameless and not hidden:
            why = f"no column is called one of {name}: noise of the other triad alone is fitted"
            return at, Guess(f"{other}_columns", NONE, why)
    return None


def _few_axes(
    sheet: Sheet, columns: Sequence[_Column], says: Sequence[Described]
) -> tuple[tuple[int, ...], list[Guess]] | None:
    """The columns of a gyro of one or two axes, by their names, and the guesses that it is one;
    None where they are not, or something is called an accelerometer."""
    own = [c.at for c in columns if c.noise > 0 and says[c.at].kind == "gyro"]
    if not own:
        alone = [c.at for c in columns if c.noise > 0 and _is_gyro(sheet, c.at)]
        own = alone if len(alone) == 1 else []
    distinct = len({says[at].axis for at in own}) == len(own)
    if not 1 <= len(own) <= 2 or not distinct or any(said.kind == "accel" for said in says):
        return None
    which = ", ".join(named(sheet, at) for at in own)
    why = f"{which} alone {'is' if len(own) == 1 else 'are'} called so: a gyro of {len(own)} "
    why += "axis" if len(own) == 1 else "axes"
    none = "no column is called one of accelerometers: noise of the gyro alone is fitted"
    guesses = [
        Guess("gyro_columns", [key(sheet, at) for at in own], why),
        Guess("accel_columns", NONE, none),
    ]
    return tuple(own), guesses


def _is_gyro(sheet: Sheet, at: int) -> bool:
    """Whether a column's name is that of a gyro without an axis."""
    return is_gyro(sheet.names[at], sheet.units[at] if at < len(sheet.units) else "")


def _by_value(
    sheet: Sheet, columns: Sequence[_Column], says: Sequence[Described]
) -> tuple[list[int], Guess]:
    """Gyro and accelerometer columns by their values, and the guess that says so; none, and the
    guess without a value, where they are not found in one way only."""
    triads = [
        own
        for own in zip(columns, columns[1:], columns[2:], strict=False)
        if own[2].at - own[0].at == 2 and _alike(own) and not any(c.rises for c in own)
    ]
    found = [
        (gyro, accel)
        for accel in triads
        for gyro in triads
        if _is_one_g(accel) and not _is_one_g(gyro)
        if abs(gyro[0].at - accel[0].at) >= 3 and _fit_names(gyro, accel, says)
    ]
    if len(found) > 1:  # a triad's axes are of one make, and what stands beside it is not
        one_make = [pair for pair in found if all(_spread(triad) < _ONE_MAKE for triad in pair)]
        others = [pair for pair in found if pair not in one_make]
        if all(max(map(_spread, pair)) > 2 * _ONE_MAKE for pair in others):
            found = one_make or found
    ways = [[c.at for c in (*gyro, *accel)] for gyro, accel in found]
    if len(ways) == 1:
        (six,) = ways
        one = [at + 1 for at in six]
        why = f"{named(sheet, six[3])} to {named(sheet, six[5])} have together 1 g, and "
        why += f"{named(sheet, six[0])} to {named(sheet, six[2])} alone can be the gyros"
        return six, Guess("columns", one, why)
    if not ways:
        none = "no three columns side by side have together 1 g beside three that may be gyros"
        doubt = (
            "which six are they, or which one to three are of gyros alone (log.gyro_columns with "
        )
        doubt += "log.accel_columns=none)?"
        return [], Guess("columns", None, none, doubt, sure=False)
    several = "; or ".join("[" + ",".join(str(at + 1) for at in six) + "]" for six in ways[:4])
    why = f"several may be: {several}"
    return [], Guess("columns", None, why, "which six are they?", sure=False)


def _fit_names(
    gyro: Sequence[_Column], accel: Sequence[_Column], says: Sequence[Described]
) -> bool:
    """Whether no name contradicts that these are the triads."""
    return all(
        says[column.at].kind in (None, kind)
        for kind, triad in (("gyro", gyro), ("accel", accel))
        for column in triad
    )


def _alike(triad: Sequence[_Column]) -> bool:
    """Whether three columns have noise of about one size."""
    return _spread(triad) < _ALIKE


def _spread(triad: Sequence[_Column]) -> float:
    """The noise of a triad's noisiest column over that of its quietest."""
    noise = [c.noise for c in triad]
    return max(noise) / min(noise) if min(noise) > 0 else np.inf


def _is_one_g(triad: Sequence[_Column]) -> bool:
    """Whether the means of three columns are together 1 g in some unit."""
    return unit_of_force([c.mean for c in triad]) is not None


def unit_of_force(mean: Sequence[float] | np.ndarray) -> str | None:
    """The unit in which a mean force (3,) is 1 g; None where it is in none."""
    norm = float(np.linalg.norm(mean))
    for unit, factor in FORCE_UNITS.items():
        if abs(norm * factor / STANDARD_GRAVITY - 1) < _NEAR_G:
            return unit
    return None


def _time(
    sheet: Sheet, says: Sequence[Described], numeric: Sequence[_Column]
) -> tuple[tuple[int, ...], Guess | None]:
    """The time column or columns, and the guess that names it where its name does not."""
    pair = seconds_and_nanoseconds(sheet.names)
    if pair is not None:
        return pair, None
    found = [at for at, own in enumerate(says) if own.kind == "time"]
    with_unit = [at for at in found if says[at].unit is not None]
    if len(found) == 1 or len(with_unit) == 1:
        return ((found if len(found) == 1 else with_unit)[0],), None
    among = found or [c.at for c in numeric if c.rises and says[c.at].kind is None]
    steady = [c.at for c in numeric if c.at in among and c.rises and not c.counts]
    if len(steady) == 1:
        only = "alone never falls" if not found else "alone of those so named rises evenly"
        value = sheet.names[steady[0]] if found else steady[0] + 1
        return (steady[0],), Guess("time_column", value, f"{named(sheet, steady[0])} {only}")
    if len(steady) > 1:
        which = " or ".join(named(sheet, at) for at in steady)
        doubt = f"is it {which}?"
        return (), Guess("time_column", None, "several columns rise", doubt, sure=False)
    return (), None
