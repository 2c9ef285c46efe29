"""The evenly sampled pieces of a file, by its clock."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbgc.data.readers.raw import Raw, require_finite
from lbgc.data.readers.repeats import sampled, without_printed_twice
from lbgc.data.readers.stretches import within
from lbgc.data.readers.timing import EvenPieces, timing
from lbgc.errors import InputError, require


@dataclass(frozen=True)
class Piece:
    """An evenly sampled piece of a file."""

    raw: Raw
    """Its samples, without time stamps"""
    rate_hz: float
    """Samples a second"""
    rows: slice
    """The file's rows"""
    notes: tuple[str, ...]
    """What was assumed of its clock and its samples"""


def timed(raw: Raw) -> tuple[Raw, EvenPieces]:
    """A file without rows that are printed twice, and its clock."""
    rows = max(len(raw.gyro), len(raw.accel))
    require(rows > 1, raw.name, f"{rows} samples", "is no recording")
    raw = without_printed_twice(raw)
    return raw, clock_of(raw)


def pieces_of(
    raw: Raw, clock: EvenPieces, shift_s: float = 0.0, joins: bool = True
) -> Iterator[Piece]:
    """The pieces of a file that are read. shift_s : the time, s, from the file's first sample to
    that from which the configuration's times count; joins : whether what is left between times that
    are left out can be one piece, where the configuration joins gaps."""
    raw = replace(raw, stamps=None)
    pieces, cut = within(clock, raw.config, raw.name, shift_s, joins)
    for key, values in (("gyro", raw.gyro), ("accel", raw.accel)):
        require_finite(raw.name, values, [f"{key} {axis}" for axis in "xyz"], pieces)
    for key in ("positions", "poses"):
        listed = getattr(raw.config, key)
        whole = listed is None or pieces == [slice(0, len(raw.gyro))]
        about = f"is for {raw.name} from its first sample to its last, in one piece"
        require(whole, f"log.{key}", listed, about)
    if joins and raw.config.gaps == "join" and len(pieces) > 1:
        raw, pieces = _joined(raw, pieces)
    for number, piece in enumerate(pieces, start=1):
        name = raw.name if len(pieces) == 1 else f"{raw.name} part {number}"
        gyro, accel, rate, notes = sampled(
            name, raw.gyro[piece], raw.accel[piece], clock.rate_hz, raw.config.repeats
        )
        samples = max(len(gyro), len(accel))
        own = replace(
            raw,
            name=name,
            gyro=gyro,
            accel=accel,
            plate=_beside(raw.plate, piece, samples),
            heading=_beside(raw.heading, piece, samples),
            temperature=_beside(raw.temperature, piece, samples),
        )
        yield Piece(own, rate, piece, (*raw.notes, *clock.notes, *cut, *notes))


def _joined(raw: Raw, pieces: list[slice]) -> tuple[Raw, list[slice]]:
    """A file with the rows of its pieces alone, one after the other, which are then one piece."""
    rows = np.concatenate([np.arange(own.start, own.stop) for own in pieces])
    beside: dict[str, Any] = {
        key: None if (own := getattr(raw, key)) is None else own[rows]
        for key in ("plate", "heading", "temperature")
    }
    joined = replace(raw, gyro=raw.gyro[rows], accel=raw.accel[rows], **beside)
    return joined, [slice(0, len(rows))]


def _beside(column: np.ndarray | None, piece: slice, samples: int) -> np.ndarray | None:
    """The values, (samples,), of a column beside the sensors' at the ends of a piece's samples,
    which may be held for several rows."""
    if column is None:
        return None
    own = column[piece]
    if len(own) == samples:
        return own
    ends = np.round(np.arange(1, samples + 1) * (len(own) / samples)).astype(int) - 1
    return np.asarray(own[np.clip(ends, 0, len(own) - 1)])


def clock_of(raw: Raw) -> EvenPieces:
    """The log's rate and pieces by its time stamps, or by the stated rate where it has none."""
    stated = raw.config.rate_hz
    if raw.stamps is None:
        require(
            stated is not None, "log.rate_hz", None, "must be given: the log has no time, or no "
            "column that its name tells (log.time_column)"
        )  # fmt: skip
        assert stated is not None
        return EvenPieces(stated, (slice(0, len(raw.gyro)),))
    try:
        return timing(raw.name, raw.stamps, raw.said, stated, raw.config.gaps)
    except InputError as error:
        if raw.time_is_said or stated is None or error.name != "log.time_unit":
            raise
        whole = (slice(0, len(raw.gyro)),)
        return EvenPieces(stated, whole, (f"time: not used, since {error.choices}",))
