"""What of a recording's mean rates and forces turns with its plate, and what does not.

Over the positions theta_k of a plate the means across its axis, in the body's axes, are

    mean_k = C(theta_k)' h + b,    C(theta) a turn about the axis

with h Earth's rate (or gravity) across the axis in the base's axes and b the bias. About down h is
as large as Earth's horizontal rate, and gravity's is small; about a level axis h has Earth's
vertical rate, and all of gravity. Angles of the wrong sign or unit leave residuals, or another h,
wherever the positions are not just half turns apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.checks.plausible import PER_HOUR, Resting, mean_noise
from lbgc.data.logconfig import LogConfig
from lbgc.data.record import Record
from lbgc.data.rests import Rest
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.frames import AXES, DOWN, across, turned
from lbgc.sensor.imu import ImuModel
from lbgc.units import ANGLE_UNITS, DEG, RATE_UNITS, rate_factor

_FEWEST_DEG = 1.0
"""Degrees that the plate must turn for its rates to be compared: a quarter turn in radians that is
read in degrees is more."""
_EVIDENCE, _RATIO = 25.0, 4.0
"""Difference and ratio of two chi-squares from which on the smaller one is preferred, 5 sigma."""
_OFF = 0.2
"""The relative difference from Earth's horizontal rate up to which a rate that turns is hers."""
_FIVE = 5.0
"""Sigmas of such a difference."""
_BLOCKS = 64
"""Blocks that a recording without rests is cut into."""
_TILTS = 1.0 * DEG
"""Disagreement of the vertical between positions, rad, that is refused: something was moved."""
_LEANS, _MUCH = 0.2 * DEG, 5.0
"""The lean, rad, that angles of the wrong sign must leave to be told by it, and its least ratio to
what right ones leave."""
_STRAY = 5.0 * DEG
"""Angle, rad, by which accelerometers' biases may have two positions about a level axis differ."""
_FALLS = 20.0 * DEG
"""Angle of the vertical between positions, rad, from which on they are about another axis."""
_DRIFTS = 0.05
"""Share of Earth's horizontal rate that a gyro's drift from position to position may be."""


@dataclass(frozen=True)
class Turning:
    """The means of a recording over K positions of its plate, or parts of an even turn."""

    name: str
    """The recording's name"""
    latitude: float
    """Latitude, rad"""
    angle: np.ndarray
    """(K,), rad, the plate's mean angle"""
    rate: np.ndarray
    """(K, 3), rad/s"""
    noise: np.ndarray
    """(K, 3), rad/s, 1 sigma of `rate`"""
    force: np.ndarray
    """(K, 3), m/s^2"""
    axis: int = DOWN
    """The body's axis about which the plate turns"""

    @property
    def north(self) -> float:
        """Earth's horizontal rate, rad/s."""
        return EARTH_RATE * float(np.cos(self.latitude))

    @property
    def across(self) -> list[int]:
        """The two axes across the plate's."""
        return list(across(self.axis))

    @property
    def told(self) -> str:
        """Which part of Earth's rate is known to turn with the plate."""
        return "horizontal" if self.axis == DOWN else "vertical"

    def seen(self, fit: "_Fit") -> tuple[float, float, float]:
        """That part by a fit of rates, Earth's own, and 1 sigma, rad/s."""
        if self.axis == DOWN:
            return fit.size, self.north, float(np.hypot(*fit.sigma[:2]))
        at = self.across.index(DOWN)
        return float(fit.found[at]), -EARTH_RATE * float(np.sin(self.latitude)), fit.sigma[at]

    def chi_about(self, axis: int) -> float:
        """The chi-square of rates that turn by the stated angles about this axis, along which they
        stay."""
        own = replace(self, axis=axis)
        rate, sigma = self.rate[:, axis], self.noise[:, axis]
        return own.chi(1.0) + float(np.sum(((rate - rate.mean()) / sigma) ** 2))

    @property
    def tolerance(self) -> float:
        """The difference of that part from Earth's own, rad/s, which scale factors and a lean may
        cause."""
        return _OFF * (self.north if self.axis == DOWN else EARTH_RATE)

    def falls(self, axis: int, by: float = 1.0) -> float:
        """The largest angle, rad, between the measured verticals of two positions, turned back by
        the plate's angles, times `by`, about this axis."""
        down = turned(self.force, by * self.angle, axis)
        down /= np.linalg.norm(down, axis=1, keepdims=True)
        return float(np.arccos(np.clip((down @ down.T).min(), -1, 1)))

    @property
    def spread(self) -> float:
        """The largest angle between two positions on the circle, rad."""
        apart = np.angle(np.exp(1j * (self.angle[:, None] - self.angle)))
        return float(np.abs(apart).max())

    def fitted(self, values: np.ndarray, sigma: np.ndarray, by: float = 1.0) -> "_Fit":
        """The fit of means across the axis, (K, 2), with sigmas (K, 2) where the angles are `by`
        times the stated ones."""
        angle = by * self.angle
        columns = [turned(np.tile(unit, (len(angle), 1)), -angle) for unit in np.eye(2)]
        columns += [np.tile(unit, (len(angle), 1)) for unit in np.eye(2)]
        design = np.stack(columns, axis=-1) / sigma[..., None]  # (K, 2, 4)
        design, data = design.reshape(-1, 4), (values / sigma).reshape(-1)
        cov = np.linalg.pinv(design.T @ design, hermitian=True)
        found = cov @ (design.T @ data)
        left = data - design @ found
        return _Fit(found, np.sqrt(np.abs(cov.diagonal())), float(left @ left))

    @cached_property
    def of_rate(self) -> "_Fit":
        """The fit of the rates."""
        return self._rates(1.0)

    @cached_property
    def of_force(self) -> "_Fit":
        """The fit of the forces, all positions alike."""
        return self._forces(1.0)

    def _rates(self, by: float) -> "_Fit":
        """The fit of the rates where the angles are `by` times the stated ones."""
        return self.fitted(self.rate[:, self.across], self.noise[:, self.across], by)

    def _forces(self, by: float) -> "_Fit":
        """The fit of the forces, likewise."""
        return self.fitted(self.force[:, self.across], np.ones((len(self.angle), 2)), by)

    def lean_left(self, by: float) -> float:
        """The lean, rad, RMS over positions, that the forces' fit leaves where the angles are `by`
        times the stated ones; where there are too few positions to leave any, zero about down, and
        about a level axis what gravity itself leaves, the accelerometers' bias included."""
        freedom = 2 * len(self.angle) - 4
        if freedom <= 0:
            return 0.0 if self.axis == DOWN else self.falls(self.axis, by) / 2
        return float(np.sqrt(self._forces(by).chi / freedom)) / normal_gravity(self.latitude)

    def chi(self, by: float) -> float:
        """The chi-square of rates whose turning part is as large as Earth's own, where the angles
        are `by` times the stated ones."""
        found = self._rates(by)
        size, earth, sigma = self.seen(found)
        sigma += 1e-5 * self.north
        if self.axis != DOWN:  # a lean takes of the horizontal rate
            sigma = float(np.hypot(sigma, self.tolerance / _FIVE))
        return found.chi + ((size - earth) / sigma) ** 2

    def resting(self, rest: Resting) -> Resting:
        """The means that a resting sensor without horizontal bias would have where the plate's
        angle is zero. rest : of the recording, for what is not of its horizontal means."""
        along = np.arange(3) == self.axis
        rate, noise, force = (v.mean(axis=0) for v in (self.rate, self.noise, self.force))
        rate[self.across] = self.of_rate.found[:2]
        force[self.across] = self.of_force.found[:2]
        noise /= np.sqrt(len(self.angle))
        noise[self.across] = self.of_rate.sigma[:2]
        stated = None if rest.stated is None else np.where(along, rest.stated, 0.0)
        return replace(rest, name=self.name, rate=rate, noise=noise, force=force, stated=stated)


@dataclass(frozen=True)
class _Fit:
    """A fit of means across the plate's axis over positions."""

    found: np.ndarray
    """(4,): the part that turns with the plate, along both axes across, and the part that does not
    """
    sigma: np.ndarray
    """(4,), 1 sigma of each"""
    chi: float
    """The sum of squared residuals in sigmas"""

    @property
    def size(self) -> float:
        """The length of the part that turns."""
        return float(np.hypot(*self.found[:2]))


def turning(record: Record, found: Sequence[Rest], imu: ImuModel | None) -> Turning | None:
    """The means of a recording over its rests, found, or over parts of an even turn where it has
    none; None where the plate turns by less than a degree. imu : the sensor's model, where it is
    known, for its drift from position to position."""
    spans = [rest.samples for rest in found]
    if not spans:
        edges = np.linspace(0, len(record.gyro), _BLOCKS + 1).astype(int)
        spans = [slice(a, b) for a, b in pairwise(edges[1:-1].tolist()) if b - a > 1]
    drift = np.full(3, _DRIFTS * EARTH_RATE * np.cos(record.latitude))
    if imu is not None:
        drift = np.sqrt(drift**2 + imu.gyro.slow_variance(record.duration_s))
    means = [
        (
            record.plate_angle[own].mean(),
            record.gyro[own].mean(axis=0),
            np.hypot(mean_noise(record.gyro[own]), drift if found else 0 * drift),
            record.accel[own].mean(axis=0),
        )
        for own in spans
    ]
    if not means:
        return None
    angle, rate, noise, force = map(np.array, zip(*means, strict=True))
    whole = Turning(record.name, record.latitude, angle, rate, noise, force, record.axis)
    if whole.spread < _FEWEST_DEG * DEG or not np.isfinite(rate).all():
        return None
    return whole


_OTHERS = {
    -1.0: "the other way: the angles' sign is wrong, or y points the other way",
    1 / DEG: "as if these angles were radians",
    DEG: "as if these angles were degrees",
}
"""Factors of the stated angles that are tried, and what each means."""


def sense_finding(own: Turning, config: LogConfig) -> Finding | None:
    """The finding that Earth's rate, or gravity on a base that leans, turns otherwise than the
    plate's angles say: the other way, or as if they were of the other unit; None where neither
    does, or where it cannot be told."""
    key, value = _stated(own, config)
    chi = own.chi(1.0)
    best, by = min(_OTHERS, key=own.chi), "the rates turn"
    least = own.chi(best)
    if chi < _RATIO * least + _EVIDENCE or least > _EVIDENCE + 4 * len(own.angle):
        best, by = min(_OTHERS, key=own.lean_left), "the lean turns"
        if not own.lean_left(1.0) > max(_LEANS, _MUCH * own.lean_left(best)):
            return None
    says = f"{own.name}: over these positions {by} {_OTHERS[best]}"
    if best == -1.0:
        flip = f"log.plate_scale={-config.plate_scale:g}"
        says += f"; {flip if config.plate_column is not None else 'negate the angles'}"
    elif config.plate_column is not None:
        says += "; log.plate_unit says which"
    return Finding("turned", key, value, "", says)


def axis_finding(own: Turning, config: LogConfig) -> Finding | None:
    """The finding that the plate turned about another axis than the stated one: by gravity, or by
    Earth's rate where gravity turns alike about both level axes; None where neither says so."""
    others = [k for k in range(3) if own.falls(k) < _STRAY]
    apart = own.falls(own.axis)
    if apart > _FALLS and others:
        says = "deg between positions"
        says += "" if own.axis == DOWN else ", turned back by the plate's angles"
        says += f": the sensor was turned about another axis than its {AXES[own.axis]} one; "
        says += f"log.plate_axis={' or '.join(AXES[k] for k in others)} would make sense"
        name = f"{own.name}: the vertical turns"
        return Finding("vertical", name, f"{apart / DEG:.3g}", "", says)
    level = [k for k in others if k != DOWN]
    axis = min(level, key=own.chi_about, default=own.axis)
    if own.axis == DOWN or own.chi_about(own.axis) < _RATIO * own.chi_about(axis) + _EVIDENCE:
        return None
    says = f"{own.name}: over these positions the rates turn about the {AXES[axis]} axis, and not "
    says += f"about {AXES[own.axis]}; log.plate_axis={AXES[axis]}"
    return Finding("turned", *_stated(own, config), "", says)


def is_told(own: Turning) -> bool:
    """Whether the rates, or the lean, tell in which sense the plate turns."""
    by_rates = own.chi(-1.0) > _RATIO * own.chi(1.0) + _EVIDENCE
    return by_rates or own.lean_left(-1.0) > max(_LEANS, _MUCH * own.lean_left(1.0))


def size_finding(own: Turning, config: LogConfig, rate_hz: float) -> Finding | None:
    """The finding that the part of the rates that turns with the plate is not as large as Earth's
    own; None where it is."""
    size, earth, sigma = own.seen(own.of_rate)
    if abs(size - earth) < max(_FIVE * sigma, own.tolerance):
        return None
    stated = rate_factor(config.gyro_unit, rate_hz)
    other = {u: rate_factor(u, rate_hz) / stated for u in (*RATE_UNITS, *ANGLE_UNITS)}
    fitting = [
        u for u, f in other.items()
        if u != config.gyro_unit
        and abs(size * f - earth) < max(_FIVE * sigma * f, own.tolerance)
        and _FIVE * sigma * f < abs(earth)
    ]  # fmt: skip
    level = "" if own.axis == DOWN else f"{own.told} "
    says = f"{own.name}: the {level}part of the rates that turns with the plate is "
    says += f"{size * PER_HOUR:.4g} deg/h where Earth's {own.told} rate is {earth * PER_HOUR:.4g}"
    if fitting:
        says += f"; in {' or '.join(fitting)} it would make sense"
        return Finding("unit", "log.gyro_unit", config.gyro_unit, "", says)
    says += ": the angles, the latitude or the gyros' scale are wrong, or the bias changed between "
    says += "the positions"
    return Finding("turned", *_stated(own, config), "", says)


def level_finding(own: Turning) -> Finding | None:
    """The finding that the vertical is not where it was in other positions, as it is where the
    sensor or its base was moved; None where it is."""
    apart = own.falls(own.axis)
    if apart > _FALLS:
        says = "deg between positions, turned back by the plate's angles about its "
        says += f"{AXES[own.axis]} axis: these, or the axis (log.plate_axis), are wrong"
        name = f"{own.name}: the vertical turns"
        return Finding("vertical", name, f"{apart / DEG:.3g}", "", says)
    off = own.lean_left(1.0)
    if off < (_TILTS if len(own.angle) > 2 or own.axis == DOWN else _STRAY / 2):
        return None
    says = f"deg from the lean of one base (RMS over {len(own.angle)} positions): the sensor or "
    says += "its base was moved between them"
    return Finding("moved", f"{own.name}: the vertical", f"{off / DEG:.3g}", "", says)


def bias_note(own: Turning) -> str:
    """The note of what does not turn with the plate: the gyros' and the accelerometers' bias."""
    rate, force = own.of_rate, own.of_force
    size, earth, _ = own.seen(rate)
    shown = ", ".join(f"{value * PER_HOUR:+.3g}" for value in rate.found[2:])
    sigma = float(np.hypot(*rate.sigma[2:]) / np.sqrt(2)) * PER_HOUR
    mg = ", ".join(
        f"{value / normal_gravity(own.latitude) * 1e3:+.3g}" for value in force.found[2:]
    )
    says = f"positions: {own.name}'s rates turn with the plate by {size * PER_HOUR:.4g} deg/h "
    if own.axis != DOWN:
        says = f"positions: the vertical part of {own.name}'s rates turns with the plate by "
        says += f"{size * PER_HOUR:.4g} deg/h "
    says += f"(Earth's {own.told} rate is {earth * PER_HOUR:.4g}); what does not turn, the bias "
    names = " and ".join(AXES[k] for k in own.across)
    says += f"{names}, is {shown} deg/h (1 sigma {sigma:.2g}) and {mg} mg"
    if own.axis != DOWN:
        says += "; the vertical, turned back by the plate's angles, stays within "
        says += f"{own.falls(own.axis) / DEG:.2g} deg, the accelerometers' bias included; "
        says += f"the bias {AXES[own.axis]}, along the axis, stays in north"
    return says


def _stated(own: Turning, config: LogConfig) -> tuple[str, object]:
    """The key that states the plate's angles, and its value."""
    for key in ("plate_column", "positions"):
        if getattr(config, key) is not None:
            return f"log.{key}", getattr(config, key)
    return "log.angles_deg", [round(float(a), 3) for a in own.angle / DEG]
