"""Published Allan curves as points of averaging time and deviation, in any format of tables."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.stats

from lbgc.data.logconfig import LogConfig
from lbgc.data.readers.clock import TIME_UNITS
from lbgc.data.readers.column_names import unit
from lbgc.data.readers.formats import files
from lbgc.data.readers.raw import require_finite
from lbgc.data.readers.sheets import Sheet, shown
from lbgc.errors import InputError, reading, require, require_choice, require_positive
from lbgc.sensor.fitting.allan_fit import AllanCurve
from lbgc.units import FORCE_UNITS, RATE_UNITS, factor

GYRO_CURVE_UNITS = RATE_UNITS
"""Units of a gyro's Allan deviation, and their values in SI."""
ACCEL_CURVE_UNITS = FORCE_UNITS | {"ug": factor("ug")}
"""Units of an accelerometer's Allan deviation, and their values in SI."""
_FEWEST = 6
"""Points that a curve has at the least: five coefficients may be asked of it."""
_MOST = 100_000
"""Points that a curve has at most."""
_SHORTEST_RECORD = 2.0
"""A recording's length over its longest averaging time, at the least."""


@dataclass(frozen=True)
class CurveConfig:
    """The keys of `curve` in `conf/fit.yaml`: a published Allan curve, where there is no log."""

    gyro: str | list[str] | None = None
    """A gyro's curve: a file of any format with the columns `tau` (s) and `deviation`, and with
    `sigma`, or `low` and `high`, where errors are stated; or three files, forward, right, down."""
    accel: str | list[str] | None = None
    """An accelerometer's curve, likewise."""
    gyro_unit: str | None = None
    """Unit of the gyro's deviations; null: as the column's name says in brackets."""
    accel_unit: str | None = None
    """Unit of the accelerometer's deviations, likewise."""
    record_s: float | None = None
    """Length of the recording that the curve is of; null: not known, so that all points weigh
    equally."""
    rate_hz: float | None = None
    """Sample rate of that recording; null: the shortest averaging time is one sample."""
    reading_percent: float = 1.0
    """Error of each deviation from reading it off a figure, 1 sigma."""
    confidence_percent: float | None = None
    """Confidence of the interval from `low` to `high`, where the file has these."""

    def __post_init__(self) -> None:
        for name in ("gyro", "accel"):
            given = getattr(self, name)
            good = not isinstance(given, list) or len(given) == 3
            require(good, name, given, "must be one file, or three: forward, right, down")
            every = given if isinstance(given, list) else [given]
            require("" not in every, name, given, "must name a file")
        for name, units in (("gyro_unit", GYRO_CURVE_UNITS), ("accel_unit", ACCEL_CURVE_UNITS)):
            if getattr(self, name) is not None:
                require_choice(name, getattr(self, name), list(units))
        for name in ("record_s", "rate_hz"):
            require_positive(name, getattr(self, name))
        good = 0 <= self.reading_percent <= 50
        require(good, "reading_percent", self.reading_percent, "must be from 0 to 50")
        level = self.confidence_percent
        good = level is None or 0 < level < 100
        require(good, "confidence_percent", level, "must be above 0 and below 100")

    @property
    def is_given(self) -> bool:
        """Whether a curve is named."""
        return self.gyro is not None or self.accel is not None


def read(config: CurveConfig, part: str) -> list[AllanCurve]:
    """The curves of a triad, gyro or accel, in SI: one for all axes, or one each; none where the
    configuration names none. Raises InputError where a file cannot be read or is no curve."""
    given = getattr(config, part)
    files = given if isinstance(given, list) else [given] if given is not None else []
    return [_curve(config, part, file) for file in files]


def _curve(config: CurveConfig, part: str, file: str) -> AllanCurve:
    """One curve of a triad."""
    key, path = f"curve.{part}", Path(file).expanduser()
    with reading(key, file):
        require(path.is_file(), key, file, "is no file")
    with _opened(path, key, file) as own:
        places = _places(own, key, file)
        columns, _ = own.columns(list(places.values()))
    for name, column in zip(places, columns, strict=True):
        require(column.dtype.kind in "fi", key, file, f"has a column {name} that is not of numbers")
    rows = np.stack([column.astype(np.float64) for column in columns], axis=1)
    require_finite(own.file, rows, list(places))
    require(len(rows) <= _MOST, key, file, f"has {len(rows)} points, and {_MOST} are the most")
    few = f"has {len(rows)} points, and a curve is fitted to {_FEWEST} at the least"
    require(len(rows) >= _FEWEST, key, file, few)
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    values = dict(zip(places, rows.T, strict=True))
    units = GYRO_CURVE_UNITS if part == "gyro" else ACCEL_CURVE_UNITS
    seconds = TIME_UNITS[_unit(own, key, places["tau"], TIME_UNITS) or "s"]
    scale = units[_unit_of_deviation(config, part, own, places["deviation"], units)]
    taus, deviation = seconds * values["tau"], scale * values["deviation"]
    for name, one in (("tau", taus), ("deviation", deviation)):
        require(bool((one > 0).all()), key, file, f"has a {name} that is not above zero")
    distinct = bool((np.diff(taus) > 1e-9 * taus[1:]).all())
    require(distinct, key, file, "has an averaging time twice: give one curve a file")
    sigma = _sigma(config, key, file, values)
    _require_recording(config, taus)
    return AllanCurve(
        taus,
        deviation,
        None if sigma is None else scale * sigma,
        config.record_s,
        None if config.rate_hz is None else 1 / config.rate_hz,
        config.reading_percent / 100,
    )


@contextmanager
def _opened(path: Path, key: str, file: str) -> Iterator[Sheet]:
    """The table of a file of any format that has a curve's columns, read within the `with` block.
    Refusals name the file by `key`."""
    try:
        with files.opened(path, LogConfig(path=file), lambda own: _places(own, key, file)) as own:
            yield own
    except InputError as error:
        if not error.name.startswith("log."):
            raise
        about = error.choices if error.name == "log.path" else f"holds no one curve: {error}"
        raise InputError(key, file, "", about) from None


def _places(own: Sheet, key: str, file: str) -> dict[str, int]:
    """The positions of the columns tau and deviation, and of sigma or of low and high where there
    are such. Of a file without a header the first two, and a third as sigma."""
    if not own.has_header:
        good = own.width in (2, 3)
        about = "no header: its columns must be tau, deviation and, if known, sigma"
        require(good, key, file, f"has {own.width} columns and {about}")
        return {name: at for at, name in enumerate(("tau", "deviation", "sigma")[: own.width])}
    bare = [_bare(name) for name in own.names]
    found: dict[str, int] = {}
    for name in ("tau", "deviation", "sigma", "low", "high"):
        require(bare.count(name) < 2, key, file, f"has the column {name} twice")
        if name in bare:
            found[name] = bare.index(name)
    for name in ("tau", "deviation"):
        has = ", ".join(shown(one) or "(unnamed)" for one in own.names[:20])
        about = f"has no column {name}; it has {has}. A curve has the columns tau and deviation"
        require(name in found, key, file, about)
    both = ("low" in found) == ("high" in found)
    require(both, key, file, "has one of the columns low and high: give both, or neither")
    one = not {"sigma", "low"} <= found.keys()
    require(one, key, file, "has sigma as well as low and high: give one of them")
    return found


def _bare(name: str) -> str:
    """A column's name without a unit in brackets, in small letters."""
    for bracket in "([":
        name = name.split(bracket)[0] or name
    return name.strip().lower()


def _unit(own: Sheet, key: str, at: int, units: dict[str, float]) -> str | None:
    """The unit in brackets in a column's name, or beneath it in a row of units; None where there is
    none that is known."""
    name = own.names[at]
    beneath = own.units[at] if own.units else ""
    bracket = min((name.find(one) for one in "([" if one in name), default=len(name))
    texts = [text for text in (name[bracket:], beneath) if text.strip()]
    said = {_known(text, units) for text in texts}
    about = f"has a column {shown(name)}, whose unit is none of {', '.join(units)}"
    require(None not in said and len(said) < 2, key, own.file, about)
    return said.pop() if said else None


def _known(text: str, units: dict[str, float]) -> str | None:
    """The unit that a text writes, if it is one of these."""
    plain = text.strip().strip("()[]").strip().replace("\N{MICRO SIGN}", "u")
    plain = plain.replace("\N{GREEK SMALL LETTER MU}", "u")
    if plain in units:
        return plain
    found = unit(text)
    return found if found in units else None


def _unit_of_deviation(
    config: CurveConfig, part: str, own: Sheet, at: int, units: dict[str, float]
) -> str:
    """The unit of the deviations. Raises InputError where nothing states it, or where the key and
    the column's name contradict each other."""
    key = f"{part}_unit"
    given, said = getattr(config, key), _unit(own, f"curve.{part}", at, units)
    if given is None and said is None:
        raise InputError(f"curve.{key}", None, "", list(units))
    about = f"but {own.file}'s column says {said}"
    require(None in (given, said) or given == said, f"curve.{key}", given, about)
    return str(given or said)


def _sigma(
    config: CurveConfig, key: str, file: str, values: dict[str, np.ndarray]
) -> np.ndarray | None:
    """The standard errors that a file states, in the deviations' unit."""
    if "sigma" in values:
        require(bool((values["sigma"] > 0).all()), key, file, "has a sigma that is not above zero")
        return values["sigma"]
    if "low" not in values:
        return None
    level = config.confidence_percent
    about = f"must be given: {Path(file).name} has the ends of an interval, low and high"
    require(level is not None, "curve.confidence_percent", level, about)
    assert level is not None
    low, high = values["low"], values["high"]
    good = bool(((low < values["deviation"]) & (values["deviation"] < high)).all())
    require(good, key, file, "has a deviation that is not between low and high")
    return np.asarray((high - low) / (2 * scipy.stats.norm.isf((1 - level / 100) / 2)))


def _require_recording(config: CurveConfig, taus: np.ndarray) -> None:
    """Raise InputError where the recording is too short for a curve of these averaging times, s, or
    its samples are too long."""
    record, rate = config.record_s, config.rate_hz
    least = _SHORTEST_RECORD * float(taus[-1])
    about = f"must be {least:g} or more, twice the longest averaging time"
    require(record is None or record >= 0.999 * least, "curve.record_s", record, about)
    about = f"must be {1 / taus[0]:.6g} or more: the shortest averaging time is {taus[0]:g} s"
    require(rate is None or rate * taus[0] >= 0.99, "curve.rate_hz", rate, about)
