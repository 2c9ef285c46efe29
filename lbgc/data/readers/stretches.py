"""The stretches of a log that are read: between the times that its description states."""

import math
from collections.abc import Sequence

from lbgc.data.logconfig import LogConfig
from lbgc.data.readers.timing import SHARE, EvenPieces
from lbgc.errors import require


def within(
    clock: EvenPieces, config: LogConfig, name: str, shift_s: float = 0.0, joins: bool = True
) -> tuple[list[slice], list[str]]:
    """The pieces' rows between the times that the configuration has, and a note of what it leaves
    out in between.

    name : the log's, for messages; shift_s : the time, s, from the log's first sample to that from
    which the times count; joins : whether pieces can be joined. Raises InputError where nothing is
    left, or a time is beyond the end.
    """
    rate, end_row = clock.rate_hz, max(piece.stop for piece in clock.pieces)

    def row(at_s: float) -> int:
        """The first row behind a time."""
        return max(0, round((at_s + shift_s) * rate))

    first = row(config.from_s) if config.from_s else 0
    last = math.inf if config.to_s is None else row(config.to_s)
    cut = [slice(max(p.start, first), int(min(p.stop, last))) for p in clock.pieces]
    end = f"which ends at {end_row / rate - shift_s:g} s"
    for own in config.leave_out:
        require(row(own[0]) < end_row, "log.leave_out", own, f"is not within {name}, {end}")
        cut = [part for piece in cut for part in _without(piece, row(own[0]), row(own[1]))]
    kept = [piece for piece in cut if piece.stop - piece.start > 1]
    key, value = ("leave_out", config.leave_out) if config.leave_out else ("from_s", config.from_s)
    require(bool(kept), f"log.{key}", value, f"leaves nothing of {name}, {end}")
    if not config.leave_out:
        return kept, []
    return _by_choice(kept, config, name, rate, joins)


def _without(piece: slice, first: int, last: int) -> list[slice]:
    """What is left of a piece without the rows from `first` up to `last`."""
    return [slice(piece.start, min(first, piece.stop)), slice(max(last, piece.start), piece.stop)]


def _by_choice(
    kept: Sequence[slice], config: LogConfig, name: str, rate_hz: float, joins: bool
) -> tuple[list[slice], list[str]]:
    """The pieces between what is left out, as the choice for gaps has them, and a note."""
    longest = max(kept, key=lambda piece: piece.stop - piece.start)
    most = longest.stop - longest.start
    gone = sum(to - since for since, to in config.leave_out)
    said = f"left out: {gone:.4g} s of {name} (log.leave_out)"
    if config.gaps == "join" and joins:
        about = f"{said}; the {len(kept)} pieces were joined as if nothing were missing"
        return list(kept), [f"{about} (log.gaps=join)"]
    if config.gaps != "split":
        about = f"{said}; of the {len(kept)} pieces the longest was read, {most / rate_hz:.6g} s "
        return [longest], [f"{about}(log.gaps=split reads each as a recording)"]
    long = [piece for piece in kept if piece.stop - piece.start >= max(rate_hz, SHARE * most)]
    require(bool(long), "log.leave_out", config.leave_out, f"leaves no second of {name}")
    about = f"{said}; the {len(long)} pieces that last a second and a tenth of the longest were "
    return long, [f"{about}read as recordings (log.gaps=split)"]
