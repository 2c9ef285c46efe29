"""Means of resting recordings, and the test that they are at rest.

Motion within a recording is told from noise by the other recordings: all recordings of one sensor
at rest have the same law, whatever its flicker, drift or warm-up, so a recording whose halves
differ by far more than those of the others has moved. The statistic is exactly Student's t where
the differences are Gaussian; one set at rest in 10,000 is refused.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from lbgc.data.record import Record, require_on_plate
from lbgc.data.static import AXES
from lbgc.errors import InputError

_TURNS = 1e-4
"""The change of an encoder's reading up to which a plate is at rest, rad."""
_TILTS = np.deg2rad(1.0)
"""The angle, rad, by which the vertical may move within a recording, whatever the others do. No
drift of an accelerometer is so large."""
_SHORTEST = 16
"""Samples of a recording below which its halves are not compared."""
_ALIKE = 1.2
"""Ratio of durations up to which recordings are taken to have the same law."""
_FALSE_ALARMS = 1e-4
"""Chance that a set of recordings at rest is refused."""
_ROUNDING = np.repeat([1e-11, 1e-8], 3)
"""Scatter of the halves' differences, rad/s and m/s^2, that is taken as rounding: far below what
any sensor resolves."""


@dataclass(frozen=True)
class Means:
    """The means of R resting recordings at known headings."""

    rates: np.ndarray
    """(R, 3), rad/s"""
    force: np.ndarray
    """(R, 3), m/s^2"""
    heading: np.ndarray
    """(R,), rad, reference headings"""
    latitude: np.ndarray
    """(R,), rad"""
    names: tuple[str, ...]
    """The recordings' names"""
    notes: tuple[str, ...]
    """The recordings' notes, each once"""


def means(records: Iterable[Record]) -> Means:
    """The means of recordings, which are read one by one. Raises InputError where a recording's
    heading is unknown, or where one is not at rest."""
    rates, force, halves, lengths = [], [], [], []
    heading, latitude, names = [], [], []
    notes: dict[str, None] = {}
    for record in records:
        require_on_plate(record)
        if record.heading_reference is None:
            raise InputError(
                record.name, "(unknown)", "", "has no heading: give labelled recordings"
            )
        if not np.isfinite(record.latitude):
            raise InputError("log.latitude", None, "", "must be given: biases are against Earth's "
                             "rate")  # fmt: skip
        if np.ptp(record.plate_angle) > _TURNS:
            turned = np.rad2deg(np.ptp(record.plate_angle))
            raise InputError(
                record.name,
                f"{turned:.4g}",
                "deg",
                "is how far its plate turns: calibration takes resting recordings, such as those "
                "of protocol=heading_scan or static, one heading each",
            )
        both = np.concatenate([record.gyro, record.accel], axis=1)
        rates.append(record.gyro.mean(axis=0))
        force.append(record.accel.mean(axis=0))
        middle = len(both) // 2
        if middle:
            halves.append(both[-middle:].mean(axis=0) - both[:middle].mean(axis=0))
        lengths.append((len(both), record.duration_s))
        heading.append(float(record.heading_reference))
        latitude.append(record.latitude)
        names.append(record.name)
        notes |= dict.fromkeys(record.notes)
    if not names:
        raise InputError("recordings", 0, "", "are none to calibrate from")
    counts, seconds = np.array(lengths).T
    if counts.min() >= _SHORTEST:
        alike = seconds.max() <= _ALIKE * seconds.min()
        _require_rest(np.array(halves), np.array(force), names, compare=bool(alike))
    return Means(
        np.array(rates),
        np.array(force),
        np.array(heading),
        np.array(latitude),
        tuple(names),
        tuple(notes),
    )


def _require_rest(
    halves: np.ndarray, force: np.ndarray, names: list[str], *, compare: bool
) -> None:
    """Raise InputError where a recording is not at rest.

    halves : (R, 6), mean of the second half less that of the first, rad/s and m/s^2; force :
    (R, 3), m/s^2; compare : whether the recordings have the same law, so that they can be compared.
    """
    down = force / np.linalg.norm(force, axis=1, keepdims=True)
    change = halves[:, 3:]
    level = change - np.sum(change * down, axis=1, keepdims=True) * down
    tilts = np.linalg.norm(level, axis=1) / np.linalg.norm(force, axis=1)
    worst = int(np.argmax(tilts))
    if tilts[worst] > _TILTS:
        _refuse(names[worst], f"{np.rad2deg(tilts[worst]):.3g}", "deg", "is how far the vertical "
                "moves from its first half to its second")  # fmt: skip
    if not compare or len(names) < 4:
        return
    at, axis, t = studentised(halves, _ROUNDING)
    if t > stats.t.ppf(1 - _FALSE_ALARMS / (2 * halves.size), len(names) - 2):
        scale, unit = (np.rad2deg(3600.0), "deg/h") if axis < 3 else (1.0, "m/s2")
        part = "rate" if axis < 3 else "force"
        _refuse(
            names[at],
            f"{halves[at, axis] * scale:.4g}",
            unit,
            f"is how much its {AXES[axis % 3]} {part} changes from its first half to its second, "
            f"{t:.3g} times the other recordings' spread",
        )


def _refuse(name: str, value: str, unit: str, what: str) -> None:
    """Raise the InputError for a recording that is not at rest."""
    raise InputError(name, value, unit, f"{what}: it was not at rest; cut or leave it out")


def studentised(values: np.ndarray, floor: np.ndarray) -> tuple[int, int, float]:
    """The row and the column of the value that is furthest from the other rows of its column, and
    its externally studentised distance, Student's t with R - 2 degrees of freedom.

    values : (R, C); floor : (C,), the least standard deviation, which stands for rounding.
    """
    count = len(values)
    rest = values - values.mean(axis=0)
    square = rest**2 * count / (count - 1)
    others = np.maximum(np.sum(rest**2, axis=0) - square, 0.0) / (count - 2)
    t = np.sqrt(square / np.maximum(others, floor**2))
    row, column = np.unravel_index(int(np.argmax(t)), t.shape)
    return int(row), int(column), float(t[row, column])
