"""What of a recording's mean rates and forces turns with its plate, and what does not.

Over the positions theta_k of a plate the horizontal means in the body's axes are

    mean_k = C(theta_k)' h + b,    C(theta) a turn about the down axis

with h Earth's rate (or gravity's horizontal part, where the base leans) in the base's axes and b
the bias. Angles of the wrong sign or unit leave residuals, or an h that is not as large as Earth's
horizontal rate, wherever the positions are not just half turns apart.
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
from lbgc.frames import turned
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

    @property
    def north(self) -> float:
        """Earth's horizontal rate, rad/s."""
        return EARTH_RATE * float(np.cos(self.latitude))

    @property
    def spread(self) -> float:
        """The largest angle between two positions on the circle, rad."""
        apart = np.angle(np.exp(1j * (self.angle[:, None] - self.angle)))
        return float(np.abs(apart).max())

    def fitted(self, values: np.ndarray, sigma: np.ndarray, by: float = 1.0) -> "_Fit":
        """The fit of horizontal means (K, 2) with sigmas (K, 2) where the angles are `by` times the
        stated ones."""
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
        return self.fitted(self.rate[:, :2], self.noise[:, :2])

    @cached_property
    def of_force(self) -> "_Fit":
        """The fit of the forces, all positions alike."""
        return self.fitted(self.force[:, :2], np.ones((len(self.angle), 2)))

    def lean_left(self, by: float) -> float:
        """The lean, rad, RMS over positions, that the forces' fit leaves where the angles are `by`
        times the stated ones; zero where there are too few positions to leave any."""
        freedom = 2 * len(self.angle) - 4
        if freedom <= 0:
            return 0.0
        found = self.fitted(self.force[:, :2], np.ones((len(self.angle), 2)), by)
        return float(np.sqrt(found.chi / freedom)) / normal_gravity(self.latitude)

    def chi(self, by: float) -> float:
        """The chi-square of rates whose turning part is as large as Earth's horizontal one, where
        the angles are `by` times the stated ones."""
        found = self.fitted(self.rate[:, :2], self.noise[:, :2], by)
        sigma = float(np.hypot(*found.sigma[:2])) + 1e-5 * self.north
        return found.chi + ((found.size - self.north) / sigma) ** 2

    def resting(self, rest: Resting) -> Resting:
        """The means that a resting sensor without horizontal bias would have where the plate's
        angle is zero. rest : of the recording, for what is not of its horizontal means."""
        rate, force = self.of_rate, self.of_force
        vertical = self.noise[:, 2].mean() / np.sqrt(len(self.angle))
        stated = None if rest.stated is None else np.array([0.0, 0.0, rest.stated[2]])
        return replace(
            rest,
            name=self.name,
            rate=np.array([*rate.found[:2], self.rate[:, 2].mean()]),
            noise=np.array([*rate.sigma[:2], vertical]),
            force=np.array([*force.found[:2], self.force[:, 2].mean()]),
            stated=stated,
        )


@dataclass(frozen=True)
class _Fit:
    """A fit of horizontal means over positions."""

    found: np.ndarray
    """(4,): the part that turns with the base, forward and right, and the part that does not"""
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
    whole = Turning(record.name, record.latitude, angle, rate, noise, force)
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
    chi = own.chi(1.0)
    best, by = min(_OTHERS, key=own.chi), "the rates turn"
    least = own.chi(best)
    if chi < _RATIO * least + _EVIDENCE or least > _EVIDENCE + 4 * len(own.angle):
        best, by = min(_OTHERS, key=own.lean_left), "the lean turns"
        if not own.lean_left(1.0) > max(_LEANS, _MUCH * own.lean_left(best)):
            return None
    key, value = _stated(own, config)
    says = f"{own.name}: over these positions {by} {_OTHERS[best]}"
    if best == -1.0:
        flip = f"log.plate_scale={-config.plate_scale:g}"
        says += f"; {flip if config.plate_column is not None else 'negate the angles'}"
    elif config.plate_column is not None:
        says += "; log.plate_unit says which"
    return Finding("turned", key, value, "", says)


def is_told(own: Turning) -> bool:
    """Whether the rates, or the lean, tell in which sense the plate turns."""
    by_rates = own.chi(-1.0) > _RATIO * own.chi(1.0) + _EVIDENCE
    return by_rates or own.lean_left(-1.0) > max(_LEANS, _MUCH * own.lean_left(1.0))


def size_finding(own: Turning, config: LogConfig, rate_hz: float) -> Finding | None:
    """The finding that the part of the rates that turns with the plate is not as large as Earth's
    horizontal rate; None where it is."""
    fit = own.of_rate
    sigma = float(np.hypot(*fit.sigma[:2]))
    off = abs(fit.size - own.north)
    if off < max(_FIVE * sigma, _OFF * own.north):
        return None
    stated = rate_factor(config.gyro_unit, rate_hz)
    other = {u: rate_factor(u, rate_hz) / stated for u in (*RATE_UNITS, *ANGLE_UNITS)}
    fitting = [
        u for u, f in other.items()
        if u != config.gyro_unit
        and abs(fit.size * f - own.north) < max(_FIVE * sigma * f, _OFF * own.north)
        and _FIVE * sigma * f < own.north
    ]  # fmt: skip
    says = f"{own.name}: the part of the rates that turns with the plate is "
    says += f"{fit.size * PER_HOUR:.4g} deg/h where Earth's horizontal rate is "
    says += f"{own.north * PER_HOUR:.4g}"
    if fitting:
        says += f"; in {' or '.join(fitting)} it would make sense"
        return Finding("unit", "log.gyro_unit", config.gyro_unit, "", says)
    says += ": the angles, the latitude or the gyros' scale are wrong, or the bias changed between "
    says += "the positions"
    return Finding("turned", *_stated(own, config), "", says)


def level_finding(own: Turning) -> Finding | None:
    """The finding that the vertical is not where it was in other positions, as it is where the
    sensor or its base was moved; None where it is."""
    down = own.force / np.linalg.norm(own.force, axis=1, keepdims=True)
    apart = float(np.arccos(np.clip((down @ down.T).min(), -1, 1)))
    if apart > _FALLS:
        says = "deg between positions: the sensor was turned about an axis that is not its down "
        says += "one, of which alone angles are told here"
        return Finding(
            "vertical", f"{own.name}: the vertical turns", f"{apart / DEG:.3g}", "", says
        )
    off = own.lean_left(1.0)
    if off < _TILTS:
        return None
    says = f"deg from the lean of one base (RMS over {len(own.angle)} positions): the sensor or "
    says += "its base was moved between them"
    return Finding("moved", f"{own.name}: the vertical", f"{off / DEG:.3g}", "", says)


def bias_note(own: Turning) -> str:
    """The note of what does not turn with the plate: the gyros' and the accelerometers' bias."""
    rate, force = own.of_rate, own.of_force
    shown = ", ".join(f"{value * PER_HOUR:+.3g}" for value in rate.found[2:])
    sigma = float(np.hypot(*rate.sigma[2:]) / np.sqrt(2)) * PER_HOUR
    mg = ", ".join(
        f"{value / normal_gravity(own.latitude) * 1e3:+.3g}" for value in force.found[2:]
    )
    return (
        f"positions: {own.name}'s rates turn with the plate by {rate.size * PER_HOUR:.4g} deg/h "
        f"(Earth's horizontal rate is {own.north * PER_HOUR:.4g}); what does not turn, the bias "
        f"forward and right, is {shown} deg/h (1 sigma {sigma:.2g}) and {mg} mg"
    )


def _stated(own: Turning, config: LogConfig) -> tuple[str, object]:
    """The key that states the plate's angles, and its value."""
    for key in ("plate_column", "positions"):
        if getattr(config, key) is not None:
            return f"log.{key}", getattr(config, key)
    return "log.angles_deg", [round(float(a), 3) for a in own.angle / DEG]
