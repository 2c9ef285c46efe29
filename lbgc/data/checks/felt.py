"""Whether the plate's stated angle turns as the gyros felt it."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.logconfig import LogConfig
from lbgc.data.record import Record
from lbgc.data.rests import Rest
from lbgc.earth import EARTH_RATE
from lbgc.frames import AXES, DOWN
from lbgc.units import DEG

_SHARE, _LEAST = 0.05, 2.0 * DEG
"""The relative and the least absolute difference, rad, of a turn by the gyros from the plate's: no
scale factor is wrong by more, and a tilted sensor feels the cosine."""
_NEAR = 0.1
"""The relative difference up to which a wrong sign or unit explains the ratio of two turns."""
_CAROUSEL = 0.25
"""The relative difference up to which an even turn agrees, which no rest parts from the gyro's
bias."""
_TELLS = 20.0 * DEG
"""A turn, rad, from which on its sense is felt."""
_LATE_S = 0.05
"""The least time, s, by which the angle's column must be late to be said to be."""


def turned_by(rate: np.ndarray, at_rest: np.ndarray, rate_hz: float) -> np.ndarray:
    """The angles, rad, (n, 3), by which the gyros have turned since a stretch's start, each about
    its axis alone, at its samples' ends. rate : (n, 3), rad/s; at_rest : (3,), rad/s, what they
    read at rest."""
    return np.asarray(np.cumsum(rate - at_rest, axis=0) / rate_hz)


def agrees(felt: float, stated: float) -> bool:
    """Whether a turn that the gyros felt is the stated one; both rad."""
    return abs(felt - stated) <= max(_LEAST, _SHARE * abs(stated))


def contradiction(
    record: Record,
    key: str,
    value: Any,
    when: tuple[float, float],
    turns: np.ndarray,
    stated: float,
    turns_back: str,
    other_unit: str = "",
) -> Finding:
    """The finding that the gyros felt another turn than the stated one.

    key, value : what states the angle; when : s, the turn's start and end; turns : (3,), rad, about
    each axis; stated : rad; turns_back : what to do where the plate turned the other way;
    other_unit : where its angle is in the other unit.
    """
    felt, axis = float(turns[record.axis]), AXES[record.axis]
    says = f"{record.name}: between {when[0]:.4g} and {when[1]:.4g} s the gyros turned by "
    says += f"{felt / DEG:.4g} deg about the {axis} axis, where the plate's angle says "
    says += f"{stated / DEG:.4g}"
    ratio = felt / stated if stated else 0.0
    others = [k for k in range(3) if agrees(abs(turns[k]), abs(stated)) and abs(stated) > _TELLS]
    if abs(ratio + 1) < _NEAR:
        back = "up" if record.axis == DOWN else "back"
        says += f": the plate turned the other way, or the {axis} axis points {back}; {turns_back}"
    elif abs(felt) < abs(stated) / 2 and len(others) == 1:
        own = AXES[others[0]]
        says += f": it turned about the {own} axis; log.plate_axis={own}"
    elif other_unit and min(abs(ratio * DEG - 1), abs(ratio / DEG - 1)) < _NEAR:
        says += f": the angle's unit is another; {other_unit}"
    elif abs(felt) < _LEAST:
        says += ": another recording's angles, or the turn itself is not in the log"
    else:
        says += ": the angle is another one's, its times are wrong, or the gyros were at their rail"
    return Finding("turned", key, value, "", says)


def is_felt(record: Record, found: Sequence[Rest], config: LogConfig) -> bool:
    """Whether the gyros have felt the plate turn, and in which sense, so that their axis is known
    to be its. found : the recording's rests."""
    if config.plate_column is None and config.positions is None:
        return False
    for before, after in pairwise(found):
        between = slice(before.samples.stop, after.samples.start)
        turn = after.angle - before.angle
        # A list's half turn may be either; the gyros said which.
        told = config.plate_column is not None or abs(np.angle(np.exp(2j * turn))) > _TELLS
        if told and abs(turn) > _TELLS and np.isfinite(record.gyro[between]).all():
            return True
    return not found and config.plate_column is not None


def felt_finding(
    record: Record, found: Sequence[Rest], config: LogConfig, bias: float
) -> Finding | None:
    """The finding that the angles of the plate's column contradict what the gyros felt between
    rests, or over an even turn without rests; None where they do not, or where there is no column.
    found : the recording's rests; bias : rad/s, the largest that is thought possible, which an even
    turn without rests does not tell from a turn."""
    if config.plate_column is None:
        return None
    turns = []
    for before, after in pairwise(found):
        first, last = before.samples.stop, after.samples.start
        felt = np.sum(record.gyro[first:last] - _at_rest(record, before, after), axis=0)
        turns.append((first, last, felt / record.rate_hz, after.angle - before.angle))
    if not found:
        vertical = EARTH_RATE * np.sin(record.latitude) if np.isfinite(record.latitude) else 0.0
        earth = np.array([0.0, 0.0, -vertical])
        felt = np.sum(record.gyro[1:] - earth, axis=0) / record.rate_hz
        stated = float(record.plate_angle[-1] - record.plate_angle[0])
        allowed = max(_CAROUSEL * abs(stated), bias * record.duration_s)
        if abs(felt[record.axis] - stated) <= allowed:
            return None
        turns = [(0, len(record.gyro), felt, stated)]
    own = record.axis
    wrong = [turn for turn in turns if not agrees(float(turn[2][own]), turn[3])]
    if not wrong:
        return None
    first, last, felt, stated = max(wrong, key=lambda turn: abs(turn[2][own] - turn[3]))
    when = first / record.rate_hz, last / record.rate_hz
    other = "deg" if config.plate_unit == "rad" else "rad"
    return contradiction(
        record, "log.plate_column", config.plate_column, when, felt, stated,
        f"log.plate_scale={-config.plate_scale:g}", f"log.plate_unit={other}",
    )  # fmt: skip


def _at_rest(record: Record, before: Rest, after: Rest) -> np.ndarray:
    """What the gyros read at rest before and after a turn, (3,), rad/s."""
    each = (record.gyro[rest.samples].mean(axis=0) for rest in (before, after))
    return np.asarray(sum(each) / 2)


def late_note(record: Record, found: Sequence[Rest], config: LogConfig) -> str | None:
    """The note of a plate's column that is late, or early, against the gyros; None where it is
    not. In a slew from rest to rest the delay is the integral of the gyros' angle less the
    column's, over the angle of the slew."""
    if config.plate_column is None:
        return None
    area, weight = 0.0, 0.0
    for before, after in pairwise(found):
        between = slice(before.samples.stop, after.samples.start)
        by, rest = after.angle - before.angle, _at_rest(record, before, after)
        course = turned_by(record.gyro[between], rest, record.rate_hz)[:, record.axis]
        if len(course) == 0 or not course[-1] or not agrees(float(course[-1]), by):
            continue
        apart = course * (by / course[-1]) - (record.plate_angle[between] - before.angle)
        area += float(np.sum(apart)) / record.rate_hz * by
        weight += by**2
    delay = area / weight if weight else 0.0
    if abs(delay) < max(_LATE_S, 2 / record.rate_hz):
        return None
    word = "late" if delay > 0 else "early"
    return (
        f"plate: the angle of {record.name} is {abs(delay):.2g} s {word} against its gyros: what "
        "is at rest by the angle may turn still, or not yet rest"
    )
