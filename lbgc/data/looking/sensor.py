"""The units and axes of a resting log, by what its means must be: 1 g, and Earth's rate.

Every description that a log may have is held against the same two vectors as the checks hold it
(`lbgc.data.checks`); what they leave open is a doubt, and what a result hangs on is asked for.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lbgc.data.checks.plausible import (
    PER_HOUR,
    Resting,
    density,
    mean_noise,
    residual,
    unsteady,
)
from lbgc.data.looking.columns import unit_of_force
from lbgc.data.looking.guess import Guess
from lbgc.data.readers.axes import matrix_of, spelled
from lbgc.data.readers.blocks import some
from lbgc.data.readers.formats.table import Frame
from lbgc.earth import EARTH_RATE
from lbgc.units import DEG, force_factor, rate_factor

_GYRO_UNITS = {"deg/s": 1.0, "rad/s": 1.0, "deg/h": 0.05, "mrad/s": 0.003}
"""The units of rates in which files without units are written, and how often, the usual ones 1."""
_BRIEF_S = 10.0
"""A rest in a log that moves below which no unit is told by it, s."""
_CERTAIN = 100.0
"""The odds from which on a unit needs no asking."""
_ARW, _USUAL_ARW = (2e-4, 10.0), 3.0
"""Angle random walk that a gyro may have, deg/sqrt(h), from the best ring lasers to the worst that
are sold; and up to which gyros are usual. Above it they become as rare as the cube of their noise.
"""
_MOST_BIAS = 20.0
"""Bias that a gyro may have, deg/s."""
_LEANS_DEG = 35.0
"""Angle between the vertical and the axis nearest to it, above which that axis is a doubt."""
_LEVEL_DEG = 1.0
"""Tilt up to which a sign of both horizontal accelerometers does not matter."""
_DOWN, _TOLD = 0.2, 10.0
"""How often accelerometers print +1 g down, for each that prints it up; and the odds from which on
which of the two needs no asking."""
_USUALLY = "accelerometers usually print +1 g up"
_UNTOLD = "do they print +1 g up (log.axes) or down (log.accel_axes as well)? That is not told"


@dataclass(frozen=True)
class Means:
    """What is measured at rest, along the file's own axes."""

    name: str
    gyro: np.ndarray
    """(T, 3), as printed"""
    accel: np.ndarray
    """(T, 3), as printed"""
    rate_hz: float
    first: int = 0
    """The file's row that these begin with"""

    def part(self, first: int, last: int) -> "Means":
        """Those of some rows alone."""
        return Means(self.name, self.gyro[first:last], self.accel[first:last], self.rate_hz,
                     self.first + first)  # fmt: skip

    @cached_property
    def rate(self) -> tuple[np.ndarray, np.ndarray, float]:
        """The gyros' mean and its noise, (3,) each, and how far it wanders, as printed."""
        return self.gyro.mean(axis=0), mean_noise(self.gyro), unsteady(self.gyro)

    @cached_property
    def noise(self) -> float:
        """1 sigma of the noisiest gyro's noise from sample to sample, as printed."""
        values, noise = some(self.gyro), 0.0
        for steps in np.abs(np.diff(values, axis=0)).T:
            moved = steps[steps > 0]  # a sample may be printed several times
            noise = max(noise, float(np.median(moved)) / 0.6745 / np.sqrt(2) if len(moved) else 0.0)
        return noise


def gyro_unit(log: Means, stated: str | None, latitude: float | None, moves: bool) -> Guess:
    """The gyros' unit: as the columns' names state it, or as Earth's rate, noise and bias allow.

    stated : by the names, or None; latitude : rad, None where it is not known; moves : whether the
    log moves beside this rest. A moment without much motion in a log that moves all the time is no
    rest that tells a unit.
    """
    if stated is not None:
        return Guess("gyro_unit", stated, "the columns' names say so")
    seconds = len(log.gyro) / log.rate_hz
    if moves and seconds < _BRIEF_S:
        why = f"it moves, and rests for {seconds:.3g} s at most, which tells no unit"
        return Guess("gyro_unit", None, why, "which is it?", sure=False)
    fits = [unit for unit in _GYRO_UNITS if _may_be(log, unit)]
    if not fits:
        why = "in no unit are its noise and its mean rate a gyro's at rest"
        return Guess("gyro_unit", None, why, "which is it?", sure=False)
    odds = _odds(log, fits, latitude)
    best = max(odds, key=lambda unit: odds[unit])
    second = max((odds[u] for u in odds if u != best), default=0.0)
    mean = float(np.linalg.norm(log.gyro.mean(axis=0))) * rate_factor(best, log.rate_hz) * PER_HOUR
    why = f"it rests at {mean:.4g} deg/h so, where Earth's rate is {EARTH_RATE * PER_HOUR:.4g}"
    if second == 0:
        why += "; in no other unit are noise and mean a gyro's"
    if second == 0 or odds[best] > _CERTAIN * second:
        return Guess("gyro_unit", best, why)
    others = " or ".join(u for u in odds if odds[best] <= _CERTAIN * odds[u])
    why = f"a bias hides Earth's rate in {others} alike"
    return Guess("gyro_unit", None, why, f"is it {others}?", sure=False)


def _may_be(log: Means, unit: str) -> bool:
    """Whether noise and mean of the gyros are possible in this unit."""
    bias = float(np.abs(log.gyro.mean(axis=0)).max()) * rate_factor(unit, log.rate_hz) / DEG
    walk = _walk(log, unit)
    return bias < _MOST_BIAS and (walk == 0 or _ARW[0] <= walk <= _ARW[1])


def _walk(log: Means, unit: str) -> float:
    """The angle random walk, deg/sqrt(h), that the gyros' noise from sample to sample would be, of
    the noisiest axis."""
    return log.noise * rate_factor(unit, log.rate_hz) / DEG * 60 / float(np.sqrt(log.rate_hz))


def _odds(log: Means, units: list[str], latitude: float | None) -> dict[str, float]:
    """The odds of these units, averaged over latitudes where that is not known."""
    found = dict.fromkeys(units, 0.0)
    for phi in [latitude] if latitude is not None else np.deg2rad(np.arange(-80.0, 81.0, 10.0)):
        rest = resting(log, "rad/s", phi)
        turned = replace(rest, force=-rest.force)  # accelerometers may print +1 g down
        for unit in units:
            factor = rate_factor(unit, log.rate_hz)
            usual = _GYRO_UNITS[unit] * min(1.0, _USUAL_ARW / max(_walk(log, unit), 1e-9)) ** 3
            found[unit] += usual * (density(rest, factor) + density(turned, factor))
    return found


def resting(log: Means, unit: str, latitude: float) -> Resting:
    """The means as the checks take them, in this unit, along the file's axes. Every bias that a
    gyro may have is possible."""
    factor = rate_factor(unit, log.rate_hz)
    rate, noise, wanders = log.rate
    return Resting(
        *(log.name, factor * rate, factor * noise, None, log.accel.mean(axis=0), latitude),
        factor * wanders,
        limit=_MOST_BIAS * DEG,
    )


def accel_unit(log: Means, stated: str | None) -> Guess:
    """The accelerometers' unit: that in which they rest at 1 g."""
    found = unit_of_force(log.accel.mean(axis=0))
    norm = float(np.linalg.norm(log.accel.mean(axis=0)))
    if stated is not None:
        shown = norm * force_factor(stated, log.rate_hz)
        doubt = ""
        if found != stated and abs(shown / 9.8 - 1) > 0.2:
            doubt = f"it would rest at {shown:.4g} m/s2"
        return Guess("accel_unit", stated, "the columns' names say so", doubt, sure=not doubt)
    if found is None:
        why = f"its mean force of {norm:.4g} is 1 g in no unit"
        return Guess("accel_unit", None, why, "which is it, or log.accel_scale?", sure=False)
    return Guess("accel_unit", found, f"it rests at {norm:.4g} {found}")


def axes(log: Means, unit: str, latitude: float | None) -> list[Guess]:
    """The axes forward, right and down in the file's notation, and those of the accelerometers
    where they differ.

    The vertical is the axis nearest to the measured one. Accelerometers print +1 g up, as specific
    force is, or +1 g down: then the rate along the vertical has the wrong sign for this latitude.
    """
    force = log.accel.mean(axis=0)
    vertical = int(np.abs(force).argmax())
    lean = float(np.rad2deg(np.arccos(np.abs(force[vertical]) / np.linalg.norm(force))))
    printed = np.sign(force[vertical])
    frames = {sign: _frame(vertical, -sign * printed) for sign in (1.0, -1.0)}
    name = "xyz"[vertical]
    sign, told, doubt = 1.0, _USUALLY, _UNTOLD
    if latitude is not None:
        sign, told, doubt = _printed(log, unit, latitude, vertical)
    matrix = frames[sign]
    own = [str(axis) for axis in spelled(matrix)[1:-1].split(",")]
    accel = own if sign > 0 else spelled(-matrix)[1:-1].split(",")
    up = "up" if printed * sign > 0 else "down"
    why = f"{name} points {up}: it rests at {force[vertical]:+.4g}, and {told}"
    sure = not doubt
    if lean > _LEANS_DEG:
        sure, doubt = (
            False,
            f"the vertical is {lean:.0f} degrees from {name}" + (f"; {doubt}" if doubt else ""),
        )
    which = own[0].removeprefix("-")
    forward = f"{which} is taken as forward: headings are of that axis"
    found = [Guess("axes", own, why, doubt or forward, sure, heading_only=True)]
    if accel != own:
        why = "the rate along the vertical has the sign that Earth's has here only if the "
        why += "accelerometers print +1 g down"
        doubt = "or the gyros' axes are others than the accelerometers', which differs by the tilt"
        found.append(Guess("accel_axes", accel, why, doubt, lean < _LEVEL_DEG, heading_only=True))
    return found


def stated_axes(log: Means, unit: str, latitude: float | None, stated: Frame) -> list[Guess]:
    """The axes that the file's format states, where it rests on that frame's down side; otherwise
    those that its rest tells, which is asked about."""
    down = -matrix_of(list(stated.axes)) @ log.accel.mean(axis=0)
    lean = float(np.rad2deg(np.arccos(np.clip(down[2] / np.linalg.norm(down), -1.0, 1.0))))
    if lean < _LEANS_DEG:
        why = f"{stated.why}; it rests with that down {lean:.2g} deg from the vertical"
        return [Guess("axes", list(stated.axes), why, stated.doubt, heading_only=True)]
    said = f"{stated.why} ([{','.join(stated.axes)}]), but that down is {lean:.0f} deg from the "
    said += "vertical: did it lie so, or has it other axes?"
    return [
        replace(own, doubt=said, sure=False) if own.key == "axes" else own
        for own in axes(log, unit, latitude)
    ]


def _frame(vertical: int, down: float) -> np.ndarray:
    """The right-handed matrix (3, 3) from the file's axes to forward-right-down whose down axis is
    the vertical one with this sign, and whose forward axis is x or, where that is vertical, z."""
    matrix = np.zeros((3, 3))
    matrix[2, vertical] = down
    matrix[0, 0 if vertical != 0 else 2] = 1.0
    matrix[1] = np.cross(matrix[2], matrix[0])
    return matrix


def _printed(log: Means, unit: str, latitude: float, vertical: int) -> tuple[float, str, str]:
    """The sign of the accelerometers' convention (1: +1 g up, -1: +1 g down), why, and the
    doubt."""
    rest = resting(log, unit, latitude)
    up, down = rest, replace(rest, force=-rest.force)
    odds = _DOWN * density(down, 1.0) / density(up, 1.0)
    sign = -1.0 if odds > 1 else 1.0
    bias = least_bias(rest.rate, sign * rest.force, latitude) * PER_HOUR
    if 1 / _TOLD < odds < _TOLD:
        bias = least_bias(rest.rate, rest.force, latitude) * PER_HOUR
        return 1.0, _USUALLY, f"{_UNTOLD} beside a bias of {bias:.3g} deg/h"
    told = f"the rate along it agrees within {bias:.2g} deg/h with {latitude / DEG:.4g} degrees of "
    told += "latitude" + (", where the accelerometers print +1 g down" if sign < 0 else "")
    return sign, told, ""


def least_bias(rate: np.ndarray, force: np.ndarray, latitude: float) -> float:
    """The least bias, rad/s, that explains a mean rate (3,), rad/s, at any heading. force : (3,);
    latitude : rad."""
    _, off = residual(rate, force, latitude, np.ones(3))
    return float(np.linalg.norm(off))


def latitude(log: Means, unit: str) -> str:
    """What the mean rate says of the latitude: a clause."""
    rate = log.gyro.mean(axis=0) * rate_factor(unit, log.rate_hz)
    force = log.accel.mean(axis=0)
    size = float(np.linalg.norm(rate))
    if size == 0:
        return ""
    along = abs(float(rate @ force)) / float(np.linalg.norm(force))
    found = float(np.rad2deg(np.arcsin(min(1.0, along / size))))
    return (
        f"Earth's rate would be that of {found:.1f} degrees, north or south, if the bias is small "
        f"(its rate is {size / EARTH_RATE:.3g} times Earth's)"
    )
