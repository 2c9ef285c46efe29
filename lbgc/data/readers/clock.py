"""A log's clock: the unit of its time column, its rate, and whether both are plausible."""

from dataclasses import dataclass

import numpy as np

from lbgc.errors import InputError

TIME_UNITS: dict[str, float] = {
    "s": 1.0,
    "ms": 1e-3,
    "100us": 1e-4,
    "us": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
    "d": 86400.0,
}
"""Units of time, in seconds; 100us are the ticks of some vendors' fine time."""
_TRIED = ("s", "ms", "us", "ns", "min", "h", "d")
"""Units that are tried for a column that does not state its unit."""
_SLOWEST_HZ, _FASTEST_HZ = 0.5, 20_000.0
"""Plausible sample rates."""
_USUAL_HZ = (4.9, 2100.0)
"""Rates between which a column without a unit is taken to be in seconds. With a lower rate it may
be in milliseconds, and with a higher one in minutes."""
_LONGEST_S = 31 * 86400.0
"""The longest plausible duration of a log, s."""
_EPOCHS_S = (946_684_800.0, 4_102_444_800.0)
"""Unix time in the years 2000 to 2100, s."""
_WRAPS = tuple(2.0**bits for bits in (8, 15, 16, 24, 31, 32)) + tuple(
    span * scale for span in (1.0, 60.0, 3600.0, 86400.0, 604800.0) for scale in (1, 1e3, 1e6, 1e9)
)
"""Values at which counters, and times of day or week, wrap round to zero."""


@dataclass(frozen=True)
class Said:
    """What is stated of a log's clock besides its stamps."""

    unit: str
    """Unit of the stamps: auto, or one of TIME_UNITS."""
    column: str | None = None
    """Unit that the column's name states."""
    rate_hz: float | None = None
    """Rate that the user or the file's comments state, Hz."""
    first: float = 0.0
    """The first stamp, in its own unit."""


def since_first(stamps: np.ndarray) -> tuple[np.ndarray, int]:
    """Stamps relative to the first one, unwrapped, and how often they wrapped round to zero, as
    counters and times of day do. stamps : (T,), whole numbers or floats. Returns float64, exact
    where stamps are whole."""
    relative = np.asarray(stamps - stamps[0], dtype=float)
    if not (relative[1:] < relative[:-1]).any():
        return relative, 0
    steps = np.diff(relative)
    back = steps[steps < 0]
    forward = steps[steps > 0]
    if not len(back) or not len(forward):
        return relative, 0
    usual = float(np.median(forward))
    for wrap in _WRAPS:
        over = steps + wrap
        within = float(np.ptp(stamps)) < wrap and np.abs(stamps).max() <= wrap
        if (
            within
            and usual < wrap / 4
            and np.all((over[steps < 0] > 0) & (over[steps < 0] < 10 * usual))
        ):
            return relative + wrap * np.concatenate([[0], np.cumsum(steps < 0)]), len(back)
    return relative, 0


def unit_of_time(name: str, step: float, duration: float, said: Said) -> tuple[str, str | None]:
    """The unit of stamps with this step and duration, and a note where it was inferred.

    name : the log's name, for messages. Raises InputError where the stated unit is not plausible,
    or where several units are.
    """
    if said.unit != "auto" or said.column is not None:
        unit = said.unit if said.unit != "auto" else str(said.column)
        _require_plausible(name, unit, step, duration, said)
        return unit, None
    fits = [unit for unit in _TRIED if _is_plausible(step, duration, unit)]
    dated = [unit for unit in fits if _is_date(said.first * TIME_UNITS[unit])]
    agree = [u for u in fits if _agrees(step, u, said.rate_hz)]
    if len(agree) == 1:
        fits = agree
    elif len(dated) == 1 and dated[0] in ("s", "ms", "us", "ns"):
        fits = dated
    elif "s" in fits and _USUAL_HZ[0] <= 1 / step <= _USUAL_HZ[1]:
        fits = ["s"]
    if len(fits) == 1:
        unit = fits[0]
        return unit, None if unit == "s" else (
            f"time unit: {name}'s time column does not say it and was read in {unit}, which makes "
            f"it {_as(step, duration, unit)}"
        )
    if not fits:
        _require_plausible(name, "s", step, duration, said)
    raise InputError(
        "log.time_unit",
        "auto",
        "",
        f"{name}'s time column makes sense in {_would(fits, step, duration)}: say which, or "
        "log.rate_hz with log.time_column=none where it only counts samples",
    )


def _require_plausible(name: str, unit: str, step: float, duration: float, said: Said) -> None:
    """Raise InputError, naming units that would be plausible, unless this one is."""
    if _is_plausible(step, duration, unit):
        return
    fits = [u for u in _TRIED if u != unit and _is_plausible(step, duration, u)]
    fits = [u for u in fits if _agrees(step, u, said.rate_hz)] or fits
    advice = "no unit of time makes sense of it; give log.rate_hz, and log.time_column=none"
    if fits:
        advice = "it would make sense in " + _would(fits, step, duration)
    raise InputError(
        "log.time_unit",
        unit,
        "",
        f"{name} would be {_as(step, duration, unit)}; {advice}",
    )


def _is_plausible(step: float, duration: float, unit: str) -> bool:
    """Whether this unit makes a plausible sample rate and duration."""
    seconds = step * TIME_UNITS[unit]
    fast = seconds * (1 + 1e-6) >= 1 / _FASTEST_HZ and seconds <= (1 + 1e-6) / _SLOWEST_HZ
    return fast and duration * TIME_UNITS[unit] <= _LONGEST_S


def _agrees(step: float, unit: str, rate_hz: float | None) -> bool:
    """Whether this unit makes the stated rate, within 1%."""
    return rate_hz is not None and abs(1 / step / TIME_UNITS[unit] / rate_hz - 1) < 0.01


def _is_date(seconds: float) -> bool:
    """Whether a time is Unix time of this century."""
    return _EPOCHS_S[0] <= seconds <= _EPOCHS_S[1]


def _would(fits: list[str], step: float, duration: float) -> str:
    """The clause of a message that lists units, each with the rate and duration it would make."""
    return " or ".join(
        f"{unit} (log.time_unit={unit} makes it {_as(step, duration, unit)})" for unit in fits
    )


def _as(step: float, duration: float, unit: str) -> str:
    """The rate and the duration that a unit makes, as text."""
    rate, seconds = 1 / step / TIME_UNITS[unit], duration * TIME_UNITS[unit]
    return f"{rate:.6g} Hz, {seconds:.4g} s"
