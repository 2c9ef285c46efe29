"""The plan of what the plate is commanded to do, or the hand that holds the IMU; `sim/motion.py`
executes it with physics."""

from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np

from lbgc.errors import (
    InputError,
    require,
    require_choice,
    require_name,
    require_not_negative,
    require_positive,
)
from lbgc.frames import AXES, DOWN

KINDS = ("static", "heading_scan", "indexed", "carousel", "tumble")
OF_A_TUMBLE = ("poses", "downs", "attitudes_deg", "placed_deg", "handling_s")
"""The keys of `ProtocolConfig` that say something of a tumble alone."""
DOWNS = ("sphere", "cube")
STAGES = ("rest", "slew", "settle")
"""What the plate is doing at a sample: resting; driven; no longer driven, and not at rest yet. The
same of an IMU that a hand holds."""
REST, SLEW, SETTLE = range(len(STAGES))
_UPRIGHT_DEG = 89.9
"""Pitch, degrees, from which on the forward axis is taken as vertical: it has no heading then."""
_LEAST_HANDLING_S = 0.5
"""The shortest move of a hand from one attitude to another, s."""
_LEAST_PLACED_DEG = 0.1
"""The least scatter, degrees, of an IMU that is laid on its faces: without any, two of the six have
the forward axis vertical."""
PEAK = 15 / 8
"""Highest rate of a hand's move over its mean rate: it goes as 10 s^3 - 15 s^4 + 6 s^5, the course
of least jerk from rest to rest (Flash and Hogan 1985)."""


@dataclass(frozen=True)
class ProtocolConfig:
    """The keys of `conf/protocol/*.yaml`. Angles are positive by the right-hand rule: about down,
    clockwise seen from above."""

    name: str = "heading_scan"
    """Its name in reports."""
    kind: str = "heading_scan"
    """static: the plate stays where it is. heading_scan: index through the circle and rest, one
    recording a rest (the paper's experiment). indexed: go through angles within each recording,
    resting at each. carousel: turn all the time. tumble: no plate; a hand holds the IMU at rest in
    several attitudes."""
    axis: str = "down"
    """indexed, carousel: the body's axis about which the plate turns, forward, right or down; all
    start from a level plate, at angle zero where the axis is horizontal."""
    step_deg: float = 5.0
    """heading_scan: angle between its headings."""
    angles_deg: tuple[float, ...] = (0.0, 180.0)
    """indexed: the plate's angles, in their order."""
    dwell_s: float | tuple[float, ...] | None = None
    """indexed, tumble: rest at each angle or attitude, settling included, one figure or one for
    each; null: equal parts of what slewing or handling leaves of the recording. Time that is left
    over is spent at the last one."""
    carousel_deg_per_s: float = 6.0
    """carousel: its rate; a negative one turns counter-clockwise."""
    turns: float | None = None
    """carousel: stop after this many turns; null: turn until the recording ends."""
    slew_deg_per_s: float = 30.0
    """Largest rate while indexing."""
    slew_deg_per_s2: float = 60.0
    """Acceleration of every slew, the carousel's start and stop included."""
    poses: int = 12
    """tumble: number of attitudes, drawn anew for each recording."""
    downs: str = "sphere"
    """tumble: how they are drawn. sphere: each direction in the IMU is as probable as any other to
    be down; cube: the IMU lies on its six faces, each once before any again. Headings are drawn
    from the whole circle."""
    attitudes_deg: tuple[tuple[float, ...], ...] | None = None
    """tumble: these instead, [roll, pitch, heading] each, in their order; headings are from the
    base's azimuth."""
    placed_deg: float = 1.0
    """tumble: 1 sigma, about each level axis, of how far from its face or its listed attitude the
    IMU is laid, drawn anew for each recording."""
    handling_s: float = 4.0
    """tumble: duration of each move from one attitude to the next."""

    def __post_init__(self) -> None:
        require_name("name", self.name)
        require_choice("kind", self.kind, KINDS)
        require_positive("slew_deg_per_s", self.slew_deg_per_s)
        require_positive("slew_deg_per_s2", self.slew_deg_per_s2)
        require_choice("axis", self.axis, AXES)
        fixed = self.axis != AXES[DOWN] and self.kind not in ("indexed", "carousel")
        about = f"must be down: kind={self.kind} turns no plate about another axis"
        require(not fixed, "axis", self.axis, about)
        step = self.step_deg
        require(0 < step <= 360, "step_deg", step, "must be above 0, up to 360")
        require(len(self.angles_deg) > 0, "angles_deg", self.angles_deg, "must name an angle")
        level = self.axis == AXES[DOWN] or self.angles_deg[0] == 0 or self.kind != "indexed"
        about = f"must begin with 0, at which the body is level, about axis={self.axis}"
        require(level, "angles_deg", self.angles_deg, about)
        dwells = self.dwell_s if isinstance(self.dwell_s, tuple) else (self.dwell_s,)
        good = isinstance(self.dwell_s, tuple) <= (len(dwells) == self.places)
        require(good, "dwell_s", self.dwell_s, f"must be one figure, or {self.places}")
        for dwell in dwells:
            require(dwell is None or dwell > 0, "dwell_s", self.dwell_s, "must be above zero")
        rate = self.carousel_deg_per_s
        require(rate != 0, "carousel_deg_per_s", rate, "must not be zero")
        require_positive("turns", self.turns)
        self._check_tumble()

    def _check_tumble(self) -> None:
        """Raise InputError unless the keys of a tumble are as they must be."""
        require_choice("downs", self.downs, DOWNS)
        require(2 <= self.poses <= 1000, "poses", self.poses, "must be from 2 to 1000")
        require_not_negative(self, "placed_deg")
        require(self.placed_deg <= 10, "placed_deg", self.placed_deg, "must be up to 10")
        least = f"must be {_LEAST_HANDLING_S:g} or more"
        good = self.handling_s >= _LEAST_HANDLING_S
        require(good, "handling_s", self.handling_s, least)
        listed = self.attitudes_deg
        if listed is None:
            good = self.downs != "cube" or self.placed_deg >= _LEAST_PLACED_DEG
            about = f"must be {_LEAST_PLACED_DEG:g} or more with downs=cube: an IMU exactly on its "
            about += "nose has no heading"
            require(good, "placed_deg", self.placed_deg, about)
            return
        require(len(listed) > 1, "attitudes_deg", listed, "must name two or more")
        for own in listed:
            require(len(own) == 3, "attitudes_deg", own, "must be [roll, pitch, heading] each")
            about = f"has a pitch beyond +-{_UPRIGHT_DEG:g}: the forward axis is vertical and has "
            about += "no heading there; tilt it a little"
            require(abs(own[1]) <= _UPRIGHT_DEG, "attitudes_deg", own, about)

    @property
    def places(self) -> int:
        """Number of angles, or of attitudes, at which it rests."""
        if self.kind != "tumble":
            return len(self.angles_deg)
        return self.poses if self.attitudes_deg is None else len(self.attitudes_deg)


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
class Handling:
    """The moves of a hand from each attitude to the next, all of one duration."""

    starts_s: tuple[float, ...]
    """The moves' starts, s; between them the IMU is held at rest"""
    duration_s: float
    """s, of each"""
    attitudes: tuple[tuple[float, float, float], ...] = ()
    """Roll, pitch and heading, rad, of each attitude, one more than there are moves; none where
    they are still to be drawn (lbgc.attitudes)"""

    @property
    def rate(self) -> float:
        """rad/s, the highest rate of a move: half a turn is the most that it turns by."""
        return PEAK * np.pi / self.duration_s


@dataclass(frozen=True)
class Plan:
    """What the plate is commanded to do in one recording, and just before; or the hand."""

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
    handling: Handling | None = None
    """The moves of a hand; there is no plate then."""

    @property
    def moving(self) -> bool:
        """Whether anything is commanded to move in the recording."""
        return bool(self.moves) or self.handling is not None

    @property
    def fastest(self) -> float:
        """rad/s, the highest rate that is commanded in the recording."""
        slewing = max((move.rate for move in self.moves), default=0.0)
        return slewing if self.handling is None else self.handling.rate

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
    if config.kind == "tumble":
        return Plan(0.0, 0.0, whole, *limits, handling=_handling(config, duration_s))
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
    steps = [float(by) for by in np.diff(np.deg2rad(config.angles_deg))]
    slews = [Move(0.0, by, *limits).duration_s if by else 0.0 for by in steps]
    starts = _starts(config, "angles_deg", list(config.angles_deg), slews, duration_s)
    return tuple(Move(at, by, *limits) for at, by in zip(starts, steps, strict=True) if by)


def _handling(config: ProtocolConfig, duration_s: float) -> Handling:
    """The moves of a hand from attitude to attitude."""
    moves = [config.handling_s] * (config.places - 1)
    starts = _starts(config, "poses", config.places, moves, duration_s)
    return Handling(tuple(starts), config.handling_s)


def _starts(
    config: ProtocolConfig, name: str, value: object, moves: list[float], duration_s: float
) -> list[float]:
    """The starts, s, of moves that last so long each, s, with a rest before each and behind the
    last. name, value : the parameter that asks for the moves."""
    count, handled = len(moves) + 1, config.kind == "tumble"
    if config.dwell_s is None:
        _check_duration(name, value, sum(moves), duration_s, handled)
        dwells = [(duration_s - sum(moves)) / count] * count
    else:
        dwells = list(cast(tuple[float, ...], np.broadcast_to(config.dwell_s, count).tolist()))
        given = config.dwell_s
        taken = sum(moves) + sum(dwells)
        _check_duration("dwell_s", list(given) if isinstance(given, tuple) else given, taken,
                        duration_s, handled)  # fmt: skip
    starts, at = [], 0.0
    for dwell, lasts in zip(dwells, moves, strict=False):
        at += dwell
        starts.append(at)
        at += lasts
    return starts


def _check_duration(
    name: str, value: object, taken: float, duration_s: float, handled: bool = False
) -> None:
    """Raise InputError on this parameter where a protocol takes longer than the recording, s.
    handled : by a hand."""
    if taken > duration_s * (1 + 1e-9):
        moves, faster = "slews", "slew faster (protocol.slew_deg_per_s)"
        if handled:
            moves, faster = "handling", "handle faster (protocol.handling_s)"
        raise InputError(
            f"protocol.{name}", value, "s" if name == "dwell_s" else "", "takes "
            f"{taken:.4g} s with its {moves}, and a recording lasts {duration_s:g} s; record "
            f"longer, or {faster}"
        )  # fmt: skip
