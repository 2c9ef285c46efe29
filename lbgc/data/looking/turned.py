"""Whether a log was turned about one axis, from rest to rest; and which column is the plate's
angle, by what the gyros felt of its turns."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbgc.data.checks.felt import agrees
from lbgc.data.looking.guess import Guess
from lbgc.data.looking.sensor import Means
from lbgc.data.looking.stretch import Stretch
from lbgc.data.readers.axes import matrix_of
from lbgc.frames import AXES, DOWN, wrap
from lbgc.units import DEG, rate_factor

_EDGE_S, _SHORTEST_S = 1.0, 5.0
"""Time that is left out at either end of a rest, s, in which the plate may not rest quite; and the
shortest rest without that."""
_TURN, _TILT = 10.0 * DEG, 0.1
"""The least turn from one rest to another, rad; and the share of a turn that may be about other
axes, where it was turned on a plate and not by hand."""
LEVEL = 3.0 * DEG
"""Angle, rad, up to which a turn about other axes does not matter."""
_ROUND_DEG, _NEAR, _NEAR_DEG = 15.0, 0.01, 1.0
"""Angles that plates are turned to are multiples of this; and the relative and absolute difference,
degrees, of a felt turn up to which it is one."""
_EVENLY, _RAMP = 0.25, 60.0 * DEG
"""The relative difference of an even turn without rests, which nothing parts from the gyro's bias,
and the least such turn, rad."""
_SAMPLED_HZ = 20.0
"""Rate at which an angle's column is followed over whole turns, Hz."""
_LEVEL_AXES = (0, 1)
"""The body's axes that are level where it is."""
_HEADING = "or is it a heading that an instrument measured (log.heading_column)?"
_UNITS = {"deg": 1.0, "rad": 1 / DEG}
_COUNTS = [360 / 2**bits for bits in range(8, 27)] + [10.0**-k for k in range(1, 8)]
_COUNTS += [360.0 / n for n in (3600, 4000, 5000, 7200, 8000, 10_000, 20_000, 40_000, 100_000)]
"""Degrees in a count of usual encoders."""


@dataclass(frozen=True)
class Course:
    """How a log turned about one axis of its body, as its gyros felt it."""

    rests: tuple[tuple[int, int], ...]
    """Where it rests: the first row and the row after the last, of K rests"""
    turns: np.ndarray
    """(K - 1,), rad, by the right-hand rule, so clockwise seen from above about the vertical, from
    each rest to the next"""
    axis: int = DOWN
    """The number of that axis: forward, right or down"""
    first: float = 0.0
    """rad, about a level axis the angle from level at the first rest"""

    @property
    def about(self) -> str:
        """The axis, in words."""
        return "the vertical" if self.axis == DOWN else f"its level {AXES[self.axis]} axis"

    @property
    def is_turned(self) -> bool:
        """Whether any turn is more than a knock."""
        return bool(len(self.turns)) and float(np.abs(self.turns).max()) > _TURN

    def positions(self, rate_hz: float) -> list[list[float]]:
        """The rests as `log.positions` has them: from, to, s, and the angle in degrees: from zero
        at the first one, or about a level axis from where the body is level."""
        angles = [_rounded(self.first)]
        for turn in self.turns:
            angles.append(angles[-1] + _rounded(turn))
        return [
            [float(np.ceil(first / rate_hz * 10) / 10), float(np.floor(last / rate_hz * 10) / 10),
             round(angle, 1)]
            for (first, last), angle in zip(self.rests, angles, strict=True)
        ]  # fmt: skip


def _rounded(angle: float) -> float:
    """An angle, rad, in degrees: the multiple that plates are turned to where it is near one."""
    found = angle / DEG
    near = float(_ROUND_DEG * np.round(found / _ROUND_DEG))
    is_near = abs(found - near) < max(_NEAR_DEG, _NEAR * abs(found))
    return (near if is_near else float(np.round(found, 1))) + 0.0  # which is no -0


def course(
    means: Means, still: Stretch, unit: str, axes: Sequence[str], accel_axes: Sequence[str]
) -> Course:
    """How a log turned: about the vertical, or else about a level axis. unit : of the gyros; axes,
    accel_axes : forward, right and down, in the file's notation."""
    every = [_about(axis, means, still, unit, axes) for axis in (DOWN, *_LEVEL_AXES)]
    found = next((own for own in every if own.is_turned), every[0])
    if found.axis == DOWN:
        return found
    first, last = found.rests[0]
    force = matrix_of(list(accel_axes)) @ means.accel[first:last].mean(axis=0)
    side = -force[1] if found.axis == 0 else force[0]
    return replace(found, first=float(np.arctan2(side, -force[2])))


def _about(axis: int, means: Means, still: Stretch, unit: str, axes: Sequence[str]) -> Course:
    """How a log turned about one axis of its body."""
    edge, shortest = (round(s * means.rate_hz) for s in (_EDGE_S, _SHORTEST_S))
    inner = [(first + edge * (first > 0), last - edge * (last < len(means.gyro)))
             for first, last in still.rests]  # fmt: skip
    inner = [(first, last) for first, last in inner if last - first >= shortest]
    factor, down = rate_factor(unit, means.rate_hz), matrix_of(list(axes))[axis]
    groups: list[tuple[list[tuple[int, int]], list[float]]] = []
    biases = [means.gyro[first:last].mean(axis=0) for first, last in inner]
    for k, this in enumerate(inner):
        if k:
            part = means.gyro[inner[k - 1][1] : this[0]]
            bias = (biases[k - 1] + biases[k]) / 2
            turned = (part.sum(axis=0) - len(part) * bias) * factor / means.rate_hz
            along = float(turned @ down)
            across = float(np.linalg.norm(turned - along * down))
            if across < max(LEVEL, _TILT * abs(along)):
                groups[-1][0].append(this)
                groups[-1][1].append(along)
                continue
        groups.append(([this], []))
    if not groups:
        return Course((), np.zeros(0), axis)
    rests, turns = max(groups, key=lambda own: sum(last - first for first, last in own[0]))
    return Course(tuple(rests), np.array(turns), axis)


def plate(
    name: str, key: str | int, values: np.ndarray, means: Means, felt: Course, unit: str,
    axes: Sequence[str], stated: str | None,
) -> list[Guess] | None:  # fmt: skip
    """The keys of the column of a plate's angle; None where the gyros felt other turns.

    name, key : the column's in messages and in the description; values : (T,), as printed; felt :
    how the log turned; unit, axes : of the gyros; stated : the unit that the column's name states.
    """
    if not np.isfinite(values).all():
        return None
    step = max(1, int(means.rate_hz / _SAMPLED_HZ))
    thin = np.append(values[::step], values[-1])
    turns, tolerance = felt.turns, 0.0
    rests = [(first // step, max(last // step, first // step + 1)) for first, last in felt.rests]
    if not felt.is_turned:  # an even turn
        down = matrix_of(list(axes))[2] * rate_factor(unit, means.rate_hz)
        turns = np.array([float(means.gyro.sum(axis=0) @ down) / means.rate_hz])
        if abs(turns[0]) < _RAMP:
            return None
        rests, tolerance = [(0, 1), (len(thin) - 1, len(thin))], _EVENLY
    for own in _UNITS if stated is None else [stated]:
        angle = np.unwrap(thin * (_UNITS[own] * DEG))
        for sign in (1.0, -1.0):
            if _agree(sign * _steps(angle, rests), turns, tolerance):
                how = "even turn" if tolerance else "turns from rest to rest"
                why = f"{name} turns as the gyros do about {felt.about}: {_degrees(turns)} {how}"
                found = [Guess("plate_column", key, why, _HEADING if _of_heading(name) else "")]
                if stated is None:
                    found.append(Guess("plate_unit", own, "in it the turns are as large"))
                if sign < 0:
                    found.append(Guess("plate_scale", -1.0, "it counts counter-clockwise"))
                return found + _of_level(felt)
    steps = _steps(thin, rests)
    if stated is not None or tolerance or not steps.any():
        return None
    scale = float(steps @ turns / (steps @ steps)) / DEG
    near = min(_COUNTS, key=lambda own: abs(np.log(abs(scale) / own)))
    if not _agree(scale * DEG * steps, turns, 0.0):
        return None
    why = f"{name} turns as the gyros do about {felt.about}, {_degrees(turns)}, in counts"
    column = Guess("plate_column", key, why)
    is_near = abs(abs(scale) / near - 1) < 2 * _NEAR
    value = float(np.copysign(near, scale))
    told = f"{scale:.6g} deg by the gyros"
    if is_near:
        why = f"a count is {told}, as of a usual encoder of {360 / near:.7g} a turn"
        scaled = Guess("plate_scale", value, why, "has its encoder so many?")
        unit_of = Guess("plate_unit", "deg", "so that the scale is in it")
        return [column, unit_of, scaled, *_of_level(felt)]
    doubt = "how many degrees are in one of its counts?"
    return [column, Guess("plate_scale", None, f"it is {told}", doubt, sure=False,
                          heading_only=True)]  # fmt: skip


def _of_heading(name: str) -> bool:
    """Whether a column's name is that of a heading as much as of a plate's angle."""
    return re.search("azimuth|heading|hdg|yaw", name, re.I) is not None


def _of_level(felt: Course) -> list[Guess]:
    """The guess at the axis, where that is level."""
    if felt.axis == DOWN:
        return []
    why = "its gyros felt the turns about it, and gravity turned with them"
    return [Guess("plate_axis", AXES[felt.axis], why)]


def off_level(angle: np.ndarray, felt: Course) -> float:
    """How far, rad, a column's angle, (T,), rad, is at the first rest from that which gravity has
    about a level axis; zero about the vertical."""
    if felt.axis == DOWN:
        return 0.0
    first, last = felt.rests[0]
    return float(np.abs(wrap(float(np.median(angle[first:last])) - felt.first)))


def _steps(angle: np.ndarray, rests: Sequence[tuple[int, int]]) -> np.ndarray:
    """The steps from rest to rest, (K - 1,), by the rests' medians."""
    return np.diff([float(np.median(angle[first:last])) for first, last in rests])


def _agree(steps: np.ndarray, turns: np.ndarray, share: float) -> bool:
    """Whether steps (K - 1,), rad, are those that were felt, or differ by a share that is given."""
    if share:
        return bool(np.all(np.abs(steps - turns) < share * np.abs(turns)))
    return all(agrees(float(one), float(own)) for one, own in zip(turns, steps, strict=True))


def _degrees(turns: np.ndarray) -> str:
    """Turns as text."""
    some = ", ".join(f"{turn / DEG:+.4g}" for turn in turns[:4])
    return f"{some}{', ...' if len(turns) > 4 else ''} deg"
