"""The sampling of a log by its time stamps: its rate, its evenly sampled pieces, and notes."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lbgc.data.readers.clock import TIME_UNITS, Said, since_first, unit_of_time
from lbgc.data.readers.dates import nanoseconds
from lbgc.data.readers.instants import Hole, Instants, instants
from lbgc.errors import InputError, require

_SHORT = 10
"""Samples that may be missing in one place without the log being refused."""
_FEW = 0.01
"""The share of all samples that may be missing in such places."""
SHARE = 0.1
"""The least length of a piece that becomes a recording, as a share of the longest piece."""
_AGREE = 0.01
"""The relative difference up to which a stated rate and that of the stamps agree."""
_SCATTER = 0.1
"""Scatter of stamps, as a share of a step, from which on there is a note of it."""


@dataclass(frozen=True)
class EvenPieces:
    """The pieces of a log that are evenly sampled."""

    rate_hz: float
    """Samples a second"""
    pieces: tuple[slice, ...]
    """The rows of each piece"""
    notes: tuple[str, ...] = ()
    """What was assumed of the clock, plain sentences"""
    unit_s: float | None = None
    """The unit of the stamps, s; None where the clock is not by stamps"""


def stamps_of(name: str, columns: Sequence[np.ndarray]) -> np.ndarray:
    """One column of stamps, or two of whole seconds and nanoseconds, as one array (T,): int64 where
    it is exact, float64 otherwise; dates in nanoseconds. Raises InputError for text that is no
    date. name : of the column, for messages."""
    if len(columns) == 2:
        seconds, rest = columns
        exact = all(np.all(np.mod(np.asarray(c, float), 1) == 0) for c in columns)
        require(exact, "log.time_column", name, "must hold whole seconds and whole nanoseconds")
        return seconds.astype(np.int64) * 10**9 + rest.astype(np.int64)
    (stamps,) = columns
    if stamps.dtype == object:
        written = nanoseconds(stamps)
        if written is not None:
            return written
        raise InputError(
            "log.time_column", name, "", "holds text that is no date (such as "
            "2026-11-26T12:00:00.010) and no number; give log.rate_hz, and log.time_column=none"
        )  # fmt: skip
    if stamps.dtype.kind in "mM":
        require(not np.isnat(stamps).any(), "log.time_column", name, "lacks some dates")
        return stamps.astype(np.int64)
    return stamps


def timing(
    name: str, stamps: np.ndarray, said: Said, stated_hz: float | None, gaps: str
) -> EvenPieces:
    """The rate and the pieces of a log with these time stamps, (T,), T > 1.

    name : the log's name, for messages; said : what is stated of the clock; stated_hz : the rate
    that the user states, Hz; gaps : refuse, join, longest or split. Raises InputError where the
    clock is not plausible, contradicts the stated rate, or has gaps that are refused.
    """
    relative, wraps = since_first(stamps)
    found = instants(relative)
    if not found.step > 0:
        raise InputError(
            f"{name}: time", f"{len(stamps)} rows", "",
            "take no time; give log.rate_hz, and log.time_column=none"
            if np.ptp(relative) == 0 else "do not increase"
        )  # fmt: skip
    span = len(stamps) * found.step
    unit, note = unit_of_time(name, found.step, span, said)
    notes = [] if note is None else [note]
    if wraps:
        notes.append(f"counter: {name}'s time column began again {wraps} times, and was carried on")
    seconds = TIME_UNITS[unit]
    rate = 1 / (found.step * seconds)
    pieces, more = _pieces(name, relative, seconds, found, rate, gaps)
    notes += more + _stamp_notes(name, found, rate)
    if stated_hz is None:
        return EvenPieces(rate, pieces, tuple(notes), seconds)
    agrees = abs(rate / stated_hz - 1) < _AGREE
    about = f"but {name}'s time says {rate:.5g} Hz; log.time_column=none takes no notice of it"
    require(agrees, "log.rate_hz", stated_hz, about)
    return EvenPieces(stated_hz, pieces, tuple(notes), seconds)


def _stamp_notes(name: str, found: Instants, rate: float) -> list[str]:
    """Notes of stamps that repeat, or that scatter about the even clock."""
    notes = []
    if found.repeated:
        notes.append(
            f"repeated stamps: {found.repeated} of {name}'s stand there again, with new samples: "
            f"these were taken as evenly spaced, at {rate:.6g} Hz"
        )
    if found.scatter > _SCATTER:
        notes.append(
            f"jitter: {name}'s time stamps scatter by {found.scatter / rate * 1e3:.2g} ms about an "
            f"even clock of {rate:.6g} Hz: its samples were taken as evenly spaced"
        )
    return notes


def _pieces(
    name: str, stamps: np.ndarray, unit: float, found: Instants, rate: float, gaps: str
) -> tuple[tuple[slice, ...], list[str]]:
    """The log's pieces, as the choice for gaps has them, and notes. The log is not cut at short
    holes. stamps : (T,), in this unit, s."""
    n = len(stamps)
    long = [hole for hole in found.holes if not 0 < hole.missing <= _SHORT]
    short = [hole for hole in found.holes if 0 < hole.missing <= _SHORT]
    missing = sum(hole.missing for hole in short)
    many = missing > _FEW * n
    if gaps == "refuse" and long:
        row = long[0].row
        _refuse(name, stamps[row : row + 2] * unit, long, rate)
    if gaps == "refuse" and many:
        raise InputError(
            f"{name}: time",
            f"{missing} of {n + missing} samples",
            "",
            f"are missing, in {len(short)} places: log.gaps=join reads on as if nothing were",
        )
    notes = []
    if short:
        most = max(hole.missing for hole in short)
        notes.append(
            f"lost samples: {missing} of {n + missing} in {name}, at most {most} in a row: it "
            f"was read on as if its {n} samples followed one another at {rate:.6g} Hz"
        )
    if not long:
        return (slice(0, n),), notes
    if gaps == "join":
        gone = sum(hole.missing for hole in long) / rate
        notes.append(f"gaps: {len(long)} in {name}, {gone:.4g} s, were joined (log.gaps=join)")
        return (slice(0, n),), notes
    edges = [0, *(hole.row + 1 for hole in long), n]
    every = [slice(a, b) for a, b in pairwise(edges) if b - a > 1]
    if gaps == "longest":
        longest = max(every, key=lambda piece: piece.stop - piece.start)
        notes.append(
            f"gaps: the longest of {name}'s {len(edges) - 1} pieces was read (log.gaps=longest), "
            f"rows {longest.start} to {longest.stop - 1}"
        )
        return (longest,), notes
    most = max(piece.stop - piece.start for piece in every)
    kept = [piece for piece in every if piece.stop - piece.start >= max(rate, SHARE * most)]
    left_out = len(edges) - 1 - len(kept)
    notes.append(
        f"gaps: {name} was read in {len(kept)} pieces (log.gaps=split); {left_out} of less than a "
        "second or a tenth of the longest were left out"
    )
    require(bool(kept), "log.gaps", gaps, f"leaves no piece of {name} that lasts a second")
    return tuple(kept), notes


def _refuse(name: str, seconds: np.ndarray, long: list[Hole], rate: float) -> None:
    """Raise the InputError for the first of a log's long holes. seconds : (2,), the stamps before
    and behind it, s."""
    row = long[0].row
    options = (
        "log.gaps=longest reads the longest piece, split each as a recording, join all as if "
        "nothing were missing"
    )
    if long[0].missing < 0:
        raise InputError(
            f"{name}: time in row {row + 1}",
            f"{seconds[1]:.9g}",
            "s",
            f"does not increase: {seconds[0]:.9g} s stands before it; {options}",
        )
    raise InputError(
        f"{name}: time after row {row}",
        f"{seconds[0]:.9g}",
        "s",
        f"a gap of {seconds[1] - seconds[0]:.4g} s where samples are {1 / rate:.4g} s apart"
        f" ({len(long)} gaps); {options}",
    )
