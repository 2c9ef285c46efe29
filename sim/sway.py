"""What makes a parked vehicle sway: its suspension's figures, and the forces of people and wind.

Three forces act on each of the vehicle's six joints:

    F(t) = level (L(t) + a(t) n(t) + w(t)),    L(t) = X(u(t)),    du = a dt.

a is the activity, zero in the quiet and about one in spells. L is the people's load: an
Ornstein-Uhlenbeck process X on a clock u that goes only while people move, so that the load stays
put in the quiet. n is their agitation, noise that comes and goes with them, and w the wind, always
there. The suspension then answers as a suspension does: with tilts that stay, and ringing.
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.signal

from lbgc.errors import require, require_not_negative, require_positive

JOINTS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
"""The vehicle's joints and motors by name: moves forward, right, down and turns about these."""

_BURN_IN = 8  # cycles of quiet and spell before the recording starts


@dataclass(frozen=True)
class SwayConfig:
    """A vehicle on its suspension. Lists of six go by joint: surge, sway, heave (a frequency; a
    force in N), roll, pitch, yaw (a moment in N m)."""

    level: float | list[float] = 0.0
    """Scales every force; 0: nothing sways, and the joints are not there. [low, high]: drawn
    uniformly for each recording."""
    mass_kg: float = 2000.0
    """Of the vehicle, without the table."""
    inertia_kg_m2: list[float] = field(default_factory=lambda: [1200.0, 3800.0, 4700.0])
    """About its centre of mass: roll, pitch, yaw."""
    com_height_m: float = 0.43
    """Of that centre above the floor that the table stands on."""
    roll_axis_height_m: float = -0.33
    """Of the axis about which the suspension rolls, above that floor, below the table."""
    pitch_axis_height_m: float = -0.52
    """Of the axis about which it pitches."""
    roll_axis_slope_deg: float = 4.6
    """How far the roll axis points down in front."""
    frequency_hz: list[float] = field(default_factory=lambda: [2.29, 3.4, 3.19, 2.23, 2.61, 2.94])
    """Natural, of each joint with the others held."""
    damping_ratio: list[float] = field(
        default_factory=lambda: [0.37, 0.0038, 0.062, 0.19, 0.014, 0.12]
    )
    """Likewise."""
    load_n: float = 460.0
    """The people's weight as it moves, 1 sigma over a long time: what presses on the springs."""
    load_nm: list[float] = field(default_factory=lambda: [791.0, 634.0])
    """Its moments about the roll and the pitch axis, likewise."""
    load_s: float = 6.0
    """Time, while people move, in which the load forgets where it was."""
    move_s: float = 0.12
    """Time constant, twice, with which the load follows."""
    agitation_n: float = 18.0
    """Rms of the forces that shake surge, sway and heave while people move."""
    agitation_nm: float = 26.0
    """Rms of the moments that shake roll, pitch and yaw."""
    agitation_hz: float = 2.3
    """Above it agitation falls off, as f^-2."""
    wind_n: float = 3.0
    """Rms of the wind's forces on surge, sway and heave."""
    wind_nm: float = 4.0
    """Rms of its moments on roll, pitch and yaw."""
    wind_hz: float = 1.5
    """Above it wind falls off, as f^-1."""
    quiet_s: float = 65.0
    """Mean time between spells."""
    spell_s: float = 15.0
    """Mean length of a spell."""
    regularity: float = 3.0
    """Of both: shape of their gamma distributions; 1: as irregular as rain, large: a clock."""
    spell_spread: float = 0.7
    """Of a spell's activity about 1: 1 sigma of its logarithm."""

    def __post_init__(self) -> None:
        low, high = self.level_range
        good = len(np.ravel(self.level)) <= 2 and 0 <= low <= high
        require(good, "level", self.level, "must be 0 or more, or [low, high]")
        for name, value in vars(self).items():
            if name != "level" and isinstance(value, list):
                n = {"inertia_kg_m2": 3, "load_nm": 2}.get(name, len(JOINTS))
                require(len(value) == n, name, value, f"must be {n} numbers")
        require_not_negative(self, "damping_ratio", "load_n", "load_nm", "quiet_s", "spell_spread")
        require_not_negative(self, "agitation_n", "agitation_nm", "wind_n", "wind_nm")
        x, y, z = sorted(self.inertia_kg_m2)
        require(x + y >= z, "inertia_kg_m2", self.inertia_kg_m2, "must not exceed the others' sum")
        for name in ("inertia_kg_m2", "frequency_hz"):
            require_positive(name, min(getattr(self, name)))
        for name in ("mass_kg", "load_s", "move_s", "agitation_hz", "wind_hz", "spell_s"):
            require_positive(name, getattr(self, name))
        require_positive("regularity", self.regularity)

    def __hash__(self) -> int:  # lists have none; models are kept by their configuration
        return hash(repr(self))

    @property
    def level_range(self) -> tuple[float, float]:
        values = np.ravel(self.level)
        return float(values[0]), float(values[-1])

    @property
    def present(self) -> bool:
        """Whether anything sways."""
        return self.level_range[1] > 0


def draw_level(config: SwayConfig, rng: np.random.Generator) -> float:
    """A recording's level."""
    return float(rng.uniform(*config.level_range))


def forces(config: SwayConfig, rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """At level 1, on the joints in the order of `JOINTS`: (steps, 6), N and N m; dt : s."""
    activity = spells(config, rng, steps, dt)
    agitation = activity * _low_pass_noise(rng, steps, dt, config.agitation_hz, order=2)
    wind = _low_pass_noise(rng, steps, dt, config.wind_hz, order=1)
    shaking = [config.agitation_n] * 3 + [config.agitation_nm] * 3
    blowing = [config.wind_n] * 3 + [config.wind_nm] * 3
    total = agitation * np.array(shaking)[:, None] + wind * np.array(blowing)[:, None]
    total[2:5] += _load(config, rng, activity, dt) * np.array(
        [[config.load_n], *np.c_[config.load_nm]]
    )
    return total.T


def spells(config: SwayConfig, rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """The activity, (steps,): quiet and spells in turn, of gamma-distributed lengths."""
    cycle = config.quiet_s + config.spell_s
    duration = steps * dt
    # As many cycles as last for certain: gamma sums hardly fall below half of their mean.
    count = 2 * int(np.ceil(duration / cycle)) + 2 * _BURN_IN
    k = config.regularity
    quiet = rng.gamma(k, config.quiet_s / k, count)
    active = rng.gamma(k, config.spell_s / k, count)
    size = rng.lognormal(-(config.spell_spread**2) / 2, config.spell_spread, count)
    # The recording starts anywhere in a cycle, long after the first.
    start = (
        np.cumsum(quiet) + np.r_[0.0, np.cumsum(active)[:-1]] - (_BURN_IN + rng.uniform()) * cycle
    )
    edges = np.clip(np.rint(np.stack([start, start + active]) / dt), 0, steps).astype(int)
    change = np.zeros(steps + 1)
    np.add.at(change, edges, np.stack([size, -size]))
    activity = np.cumsum(change)[:steps]
    return np.maximum(activity, 0.0)  # rounding


def _load(
    config: SwayConfig, rng: np.random.Generator, activity: np.ndarray, dt: float
) -> np.ndarray:
    """Unit Ornstein-Uhlenbeck processes on the clock of activity, as smooth as people move."""
    clock = np.cumsum(activity)
    keep = np.exp(-dt / config.load_s)
    steps = rng.standard_normal((3, int(clock[-1]) + 2))
    steps[:, 1:] *= np.sqrt(1 - keep**2)  # the first is the stationary start
    x = scipy.signal.lfilter([1.0], [1.0, -keep], steps)
    i = clock.astype(int)
    load = x[:, i] + (clock - i) * (x[:, i + 1] - x[:, i])
    follow = np.exp(-dt / config.move_s)
    for _ in range(2):
        still = follow * load[:, :1]
        load, _ = scipy.signal.lfilter([1 - follow], [1.0, -follow], load, zi=still)
    return load


def _low_pass_noise(
    rng: np.random.Generator, steps: int, dt: float, corner_hz: float, order: int
) -> np.ndarray:
    """Unit variance, white below the corner (Butterworth): (6, steps)."""
    warm_up = int(np.ceil(2 / (corner_hz * dt)))  # a dozen time constants
    sos = scipy.signal.butter(order, corner_hz, fs=1 / dt, output="sos")
    response = scipy.signal.sosfilt(sos, np.r_[1.0, np.zeros(4 * warm_up)])
    noise = rng.standard_normal((len(JOINTS), warm_up + steps))
    return scipy.signal.sosfilt(sos, noise)[:, warm_up:] / np.sqrt(np.sum(response**2))
