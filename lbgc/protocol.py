"""The plan of what the plate is commanded to do; `sim/motion.py` executes it with physics."""

from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np

from lbgc.errors import InputError, require, require_choice, require_name, require_positive
from lbgc.frames import AXES, DOWN

KINDS = ("static", "heading_scan", "indexed", "carousel")
STAGES = ("rest", "slew", "settle")
"""What the plate is doing at a sample: resting; driven; no longer driven, and not at rest yet."""
REST, SLEW, SETTLE = range(len(STAGES))


@dataclass(frozen=True)
class ProtocolConfig:
    """The keys of `conf/protocol/*.yaml`. Angles are positive by the right-hand rule: about down,
    clockwise seen from above."""

    name: str = "heading_scan"
    """Its name in reports."""
    kind: str = "heading_scan"
    """static: the plate stays where it is. heading_scan: index through the circle and rest, one
    recording a rest (the paper's experiment). indexed: go through angles within each recording,
    resting at each. carousel: turn all the time."""
    axis: str = "down"
    """indexed, carousel: the body's axis about which the plate turns, forward, right or down; all
    start from a level plate, at angle zero where the axis is horizontal."""
    step_deg: float = 5.0
    """heading_scan: angle between its headings."""
    angles_deg: tuple[float, ...] = (0.0, 180.0)
    """indexed: the plate's angles, in their order."""
    dwell_s: float | tuple[float, ...] | None = None
    """indexed: rest at each angle, settling included, one figure or one an angle; null: equal parts
    of what slewing leaves of the recording. Time that is left over is spent at the last angle."""
    carousel_deg_per_s: float = 6.0
    """carousel: its rate; a negative one turns counter-clockwise."""
    turns: float | None = None
    """carousel: stop after this many turns; null: turn until the recording ends."""
    slew_deg_per_s: float = 30.0
    """Largest rate while indexing."""
    slew_deg_per_s2: float = 60.0
    """Acceleration of every slew, the carousel's start and stop included."""

    def __post_init__(self) -> None:
        require_name("name", self.name)
        require_choice("kind", self.kind, KINDS)
        require_positive("slew_deg_per_s", self.slew_deg_per_s)
        require_positive("slew_deg_per_s2", self.slew_deg_per_s2)
        require_choice("axis", self.axis, AXES)
        fixed = self.axis != AXES[DOWN] and self.kind in ("static", "heading_scan")
        about = f"must be down: kind={self.kind} stands still, or goes through headings"
        require(not fixed, "axis", self.axis, about)
        step = self.step_deg
        require(0 < step <= 360, "step_deg", step, "must be above 0, up to 360")
        require(len(self.angles_deg) > 0, "angles_deg", self.angles_deg, "must name an angle")
        level = self.axis == AXES[DOWN] or self.angles_deg[0] == 0 or self.kind != "indexed"
        about = f"must begin with 0, at which the body is level, about axis={self.axis}"
        require(level, "angles_deg", self.angles_deg, about)
        dwells = self.dwell_s if isinstance(self.dwell_s, tuple) else (self.dwell_s,)
        good = isinstance(self.dwell_s, tuple) <= (len(dwells) == len(self.angles_deg))
        require(good, "dwell_s", self.dwell_s, f"must be one figure, or {len(self.angles_deg)}")
        for dwell in dwells:
            require(dwell is None or dwell > 0, "dwell_s", self.dwell_s, "must be above zero")
        rate = self.carousel_deg_per_s
        require(rate != 0, "carousel_deg_per_s", rate, "must not be zero")
        require_positive("turns", self.turns)


@dataclass(frozen=True)
class Move:
    """A slew as it is commanded: speeding up, turning evenly, and slowing down as it sped up."""

    start_s: float
    by: float
    """rad, angle that it turns by, clockwise positive"""
    rate: float
    """rad/s, its largest rate"""
    acceleration: float
    """rad/s^2"""

    @property
    def duration_s(self) -> float:
        """Time from its start to its end."""
        peak = self._peak
        return abs(self.by) / peak + peak / self.acceleration

    @property
    def end_s(self) -> float:
        """Time of its end."""
        return self.start_s + self.duration_s

    @property
    def _peak(self) -> float:
        """The rate that it reaches, rad/s: a short slew slows down before it reaches `rate`."""
        return min(self.rate, float(np.sqrt(abs(self.by) * self.acceleration)))

    def command(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle (rad) since the move's start and rate (rad/s), both (*S), at times t (*S) in s."""
        peak, end = self._peak, self.duration_s
        up = peak / self.acceleration
        since = np.clip(t - self.start_s, 0.0, end)
        a, b = np.minimum(since, up), np.maximum(since - (end - up), 0.0)
        angle = peak * (since - a) + self.acceleration * (a**2 - b**2) / 2
        rate = np.where(since < end, self.acceleration * (a - b), 0.0)
        return np.sign(self.by) * angle, np.sign(self.by) * rate


@dataclass(frozen=True)
class Plan:
    """What the plate is commanded to do in one recording, and just before."""

    start: float
    """rad, the plate's angle at the recording's start, where it rests"""
    before: float
    """rad, the slew by which it came there"""
    azimuth_range: float
    """rad, width of the interval about zero from which the base's azimuth is drawn uniformly"""
    rate: float
    """rad/s, of the slew before"""
    acceleration: float
    """rad/s^2"""
    moves: tuple[Move, ...] = ()
    """The slews within the recording, in order of time."""

    def command(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The plate's angle (rad) and rate (rad/s) as commanded, (*S), at times t (*S) in s."""
        angle, rate = np.full(np.shape(t), self.start), np.zeros(np.shape(t))
        for move in self.moves:
            travelled, turning = move.command(t)
            angle += travelled
            rate += turning
        return angle, rate


def plan(config: ProtocolConfig, recording: int, duration_s: float) -> Plan:
    """The plan of a recording, which depends on the configuration and on its own index alone.

    A scan goes round the circle in steps. The base's azimuths fill the gaps between its headings,
    so that headings cover the circle evenly and the encoder tells nothing of them.

    Raises InputError where the protocol takes longer than the recording.
    """
    steps = 1
    if config.kind == "heading_scan":
        steps = max(1, round(2 * np.pi / float(np.deg2rad(config.step_deg))))
    return _plan(config, recording % steps, duration_s)


@lru_cache(maxsize=4096)
def _plan(config: ProtocolConfig, place: int, duration_s: float) -> Plan:
    """The plan of a recording. place : number of steps that a scan has made before it."""
    rate, acceleration = np.deg2rad(config.slew_deg_per_s), np.deg2rad(config.slew_deg_per_s2)
    limits = (float(rate), float(acceleration))
    whole = 2 * np.pi
    if config.kind == "heading_scan":
        step = float(np.deg2rad(config.step_deg))
        return Plan(place * step, step, step, *limits)
    if config.kind == "static":
        return Plan(0.0, 0.0, whole, *limits)
    if config.kind == "carousel":
        return Plan(0.0, 0.0, whole, *limits, (_carousel(config, duration_s),))
    angles = np.deg2rad(config.angles_deg)
    return Plan(float(angles[0]), 0.0, whole, *limits, _indexed(config, limits, duration_s))


def _carousel(config: ProtocolConfig, duration_s: float) -> Move:
    """The one move of a carousel, which outlasts the recording unless its turns are given."""
    rate = float(np.deg2rad(config.carousel_deg_per_s))
    by = rate * duration_s  # at full rate until after the end
    if config.turns is not None:
        by = float(np.copysign(2 * np.pi * config.turns, rate))
    move = Move(0.0, by, abs(rate), float(np.deg2rad(config.slew_deg_per_s2)))
    if config.turns is not None:
        _check_duration("turns", config.turns, move.duration_s, duration_s)
    return move


def _indexed(
    config: ProtocolConfig, limits: tuple[float, float], duration_s: float
) -> tuple[Move, ...]:
    """The moves from angle to angle. limits : rate and acceleration of a slew, rad/s, rad/s^2."""
    angles = np.deg2rad(config.angles_deg)
    steps = [float(by) for by in np.diff(angles)]
    slewing = sum(Move(0.0, by, *limits).duration_s for by in steps if by)
    count = len(angles)
    if config.dwell_s is None:
        _check_duration("angles_deg", list(config.angles_deg), slewing, duration_s)
        dwells = [(duration_s - slewing) / count] * count
    else:
        dwells = list(cast(tuple[float, ...], np.broadcast_to(config.dwell_s, count).tolist()))
        taken = slewing + sum(dwells)
        given = config.dwell_s
        _check_duration("dwell_s", list(given) if isinstance(given, tuple) else given, taken,
                        duration_s)  # fmt: skip
    moves, at = [], 0.0
    for dwell, by in zip(dwells, steps, strict=False):
        at += dwell
        if by:
            moves.append(Move(at, by, *limits))
            at = moves[-1].end_s
    return tuple(moves)


def _check_duration(name: str, value: object, taken: float, duration_s: float) -> None:
    """Raise InputError on this parameter where a protocol takes longer than the recording, s."""
    if taken > duration_s * (1 + 1e-9):
        raise InputError(
            f"protocol.{name}", value, "s" if name == "dwell_s" else "", "takes "
            f"{taken:.4g} s with its slews, and a recording lasts {duration_s:g} s; record longer, "
            "or slew faster (protocol.slew_deg_per_s)"
        )  # fmt: skip
