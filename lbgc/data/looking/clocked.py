"""The clock of a log that nobody described: its rate, its unit of time, and its longest piece."""

from dataclasses import replace

from lbgc.data.looking.case import Case
from lbgc.data.looking.guess import Guess
from lbgc.data.looking.sensor import Means
from lbgc.data.readers.clock import TIME_UNITS
from lbgc.data.readers.pieces import clock_of
from lbgc.data.readers.raw import Raw
from lbgc.errors import InputError

_USUAL_HZ = 100.0
"""The rate that is taken to go on with, where none is found, Hz."""
_RATES, _SHORTEST_S, _USUAL = (1.0, 5000.0), 10.0, ("s", "ms", "us", "ns")
"""Rates, Hz, least duration and units of clocks as people have them."""


def timed(raw: Raw, case: Case) -> Means:
    """The values with their rate. Where the clock is not clear that is asked for, and a usual rate
    taken to go on with."""
    if raw.stamps is None and raw.config.rate_hz is None:
        doubt = "how many samples a second?"
        case.note(Guess("rate_hz", None, "it has no time column", doubt, sure=False))
        return Means(raw.name, raw.gyro, raw.accel, _USUAL_HZ)
    try:
        clock = clock_of(raw)
    except InputError as error:
        if (unit := _usual_unit(raw, error, case)) is not None:
            config = replace(raw.config, time_unit=unit)
            said = replace(raw.said, unit=unit)
            return timed(replace(raw, config=config, said=said), case)
        if "log.gaps=" not in str(error) or "gaps" in case.said:
            case.ask(error, ("time_unit", "rate_hz"))
            return Means(raw.name, raw.gyro, raw.accel, _USUAL_HZ)
        case.note(Guess("gaps", "longest", f"its longest piece is read, since {error}"))
        try:
            clock = clock_of(replace(raw, config=replace(raw.config, gaps="longest")))
        except InputError as other:
            case.ask(other, ("gaps",))
            return Means(raw.name, raw.gyro, raw.accel, _USUAL_HZ)
    case.facts += [*raw.notes, *clock.notes]
    longest = max(clock.pieces, key=lambda piece: piece.stop - piece.start)
    count = longest.stop - longest.start
    case.facts.append(f"{count} samples at {clock.rate_hz:.6g} Hz, {count / clock.rate_hz:.6g} s")
    return Means(raw.name, raw.gyro[longest], raw.accel[longest], clock.rate_hz, longest.start)


def _usual_unit(raw: Raw, error: InputError, case: Case) -> str | None:
    """The one unit of time, where a refusal is of several, that makes a usual rate and more than a
    few seconds, which is noted; None where there is none, or several."""
    if error.name != "log.time_unit" or case.said.get("time_unit") or "time_unit" in case.keys:
        return None
    assert raw.stamps is not None
    span = float(raw.stamps[-1] - raw.stamps[0])
    fits = {}
    for unit, seconds in TIME_UNITS.items():
        rate = (len(raw.stamps) - 1) / (span * seconds) if span > 0 else 0.0
        if _RATES[0] <= rate <= _RATES[1] and span * seconds >= _SHORTEST_S and unit in _USUAL:
            fits[unit] = rate
    if len(fits) != 1:
        return None
    ((unit, rate),) = fits.items()
    why = f"it makes it {rate:.5g} Hz and {span * TIME_UNITS[unit]:.4g} s, as no other does"
    case.note(Guess("time_unit", unit, why))
    return unit
