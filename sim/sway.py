"""Sway of a parked vehicle: the parameters of its suspension, and the forces of people and wind.

On each of the vehicle's six joints acts the force (or moment)

    F(t) = level (L(t) + a(t) n(t) + w(t)),    L(t) = h * X(u(t)),    du = a dt.

a is the activity: about one in spells, and almost zero in the quiet between them. L is the load of
the people, an Ornstein-Uhlenbeck process X on a clock u that advances only while they move,
smoothed (h) over the time that a move takes. In the quiet it stays at the value that it has
reached. n is agitation, noise that comes and goes with the activity, and w is the wind, which is
always there. The suspension responds with tilts that stay, and with ringing.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.errors import Spread, require, require_not_negative, require_positive, require_spread

JOINTS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
"""The names of the vehicle's joints and motors: translations along, and rotations about, forward,
right and down."""

_SIZES = {"inertia_kg_m2": 3, "load_nm": 2, "load_s": 3, "move_s": 3}
"""Lengths of the configuration's lists; others have six numbers."""
_BURN_IN = 8
"""Cycles of quiet and spell before the recording starts."""


@dataclass(frozen=True)
class SwayConfig:
    """A vehicle on its suspension. Lists of six numbers go by joint: surge, sway, heave (forces in
    N), roll, pitch, yaw (moments in N m)."""

    level: Spread = 0.0
    """Factor on every force; 0: nothing sways, and the joints are left out. [low, high]: drawn
    uniformly for each recording."""
    mass_kg: float = 2000.0
    """Mass of the vehicle, without the table."""
    inertia_kg_m2: tuple[float, ...] = (740.0, 2600.0, 3200.0)
    """Moments of inertia about its centre of mass: roll, pitch, yaw."""
    com_height_m: float = 0.19
    """Height of the centre of mass above the floor that the table stands on."""
    roll_axis_height_m: float = -0.41
    """Height above the table's floor, beneath the table, of the axis about which the suspension
    rolls."""
    pitch_axis_height_m: float = -0.6
    """Height of the axis about which the suspension pitches, above the same floor."""
    roll_axis_slope_deg: float = 3.7
    """Angle by which the roll axis points down at the front."""
    frequency_hz: tuple[float, ...] = (2.3, 3.26, 3.6, 2.29, 2.62, 2.97)
    """Natural frequency of each joint with the others held."""
    damping_ratio: tuple[float, ...] = (0.35, 0.008, 0.068, 0.2, 0.02, 0.15)
    """Damping ratio of each joint with the others held."""
    load_n: float = 614.0
    """1 sigma over a long time of the people's weight on the springs, which changes as they come
    and go."""
    load_nm: tuple[float, ...] = (491.0, 981.0)
    """1 sigma of the weight's moments about the roll and the pitch axis, as people move about."""
    load_forward_m: float = 0.66
    """Distance of the people's mean place in front of the springs' middle, by which their weight
    also pitches the vehicle."""
    load_s: tuple[float, ...] = (5.0, 4.0, 7.0)
    """Correlation times of the weight and of the two moments, while people move."""
    move_s: tuple[float, ...] = (0.11, 0.15, 3.1)
    """Time constants of one move, for the weight and the two moments; each smooths twice. People
    come in, and cross the vehicle, in one step, and walk along it more slowly."""
    agitation_n: float = 16.0
    """Rms of the forces that shake surge, sway and heave while people move."""
    agitation_nm: float = 30.0
    """Rms of the moments that shake roll, pitch and yaw."""
    agitation_hz: float = 2.0
    """Frequency above which agitation falls off, as f^-2."""
    wind_n: float = 3.0
    """Rms of the wind's forces on surge, sway and heave."""
    wind_nm: float = 3.0
    """Rms of the wind's moments on roll, pitch and yaw."""
    wind_hz: float = 1.5
    """Frequency above which wind falls off, as f^-1."""
    restlessness: float = 0.006
    """Activity of the people in the quiet; in spells it is about 1."""
    quiet_s: float = 80.0
    """Mean length of the quiet between spells."""
    spell_s: float = 17.0
    """Mean length of a spell."""
    regularity: float = 12.0
    """Shape of the gamma distributions of the lengths of quiet and spells; 1: exponential, as
    irregular as rain; large: regular as a clock."""
    spell_spread: float = 0.35
    """1 sigma of the logarithm of a spell's activity."""

    def __post_init__(self) -> None:
        require_spread(self, "level")
        for name, value in vars(self).items():
            if name != "level" and isinstance(value, tuple):
                n = _SIZES.get(name, len(JOINTS))
                require(len(value) == n, name, value, f"must be {n} numbers")
        for name in ("inertia_kg_m2", "frequency_hz", "load_s", "move_s"):
            require_positive(name, min(getattr(self, name)))
        for name in ("mass_kg", "agitation_hz", "wind_hz", "spell_s", "regularity"):
            require_positive(name, getattr(self, name))
        require_not_negative(self, "damping_ratio", "load_n", "load_nm", "agitation_n")
        require_not_negative(self, "agitation_nm", "wind_n", "wind_nm", "restlessness")
        require_not_negative(self, "quiet_s", "spell_spread")
        *others, largest = sorted(self.inertia_kg_m2)
        bodily = sum(others) >= largest
        require(bodily, "inertia_kg_m2", self.inertia_kg_m2, "has one above the others' sum")

    @property
    def present(self) -> bool:
        """Whether the vehicle sways."""
        return self.level != 0.0


def forces(config: SwayConfig, rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """Draw the forces at level 1 on the joints, in the order of `JOINTS`: (steps, 6), N and N m;
    dt : s.

    The process is stationary: a recording starts with a load of people, and in any part of quiet or
    a spell. Raises InputError where a corner frequency is too high for the steps.
    """
    for name in ("agitation_hz", "wind_hz"):
        corner = getattr(config, name)
        require(2 * corner * dt < 1, name, corner, f"must be below {0.5 / dt:g}, half the steps'")
    activity = spells(config, rng, steps, dt)
    total = _low_pass_noise(rng, steps, dt, config.agitation_hz, order=2)
    wind = _low_pass_noise(rng, steps, dt, config.wind_hz, order=1)
    shaking = [config.agitation_n] * 3 + [config.agitation_nm] * 3
    blowing = [config.wind_n] * 3 + [config.wind_nm] * 3
    # The sums are made in place, since these arrays are tens of megabytes.
    total *= activity
    total *= np.array(shaking)[:, None]
    wind *= np.array(blowing)[:, None]
    total += wind
    weight, rolling, pitching = _load(config, rng, activity, dt)
    total[2] += config.load_n * weight
    total[3] += config.load_nm[0] * rolling
    total[4] += config.load_nm[1] * pitching - config.load_forward_m * config.load_n * weight
    return total.T


def spells(config: SwayConfig, rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """Draw the activity, (steps,): quiet and spells in turn, with gamma-distributed lengths; dt :
    s."""
    cycle = config.quiet_s + config.spell_s
    # Twice the mean number of cycles, and more: their sum hardly ever falls below half of its mean.
    count = 2 * int(np.ceil(steps * dt / cycle)) + 2 * _BURN_IN
    k = config.regularity
    quiet, spell = rng.gamma(k, [[config.quiet_s / k], [config.spell_s / k]], (2, count))
    size = rng.lognormal(-(config.spell_spread**2) / 2, config.spell_spread, count)  # of mean 1
    # The recording starts at any time in a cycle, long after the first one.
    ends = np.cumsum(quiet + spell) - (_BURN_IN + rng.uniform()) * cycle
    time = np.arange(steps) * dt
    current = np.searchsorted(ends, time, side="right")
    in_spell = time >= (ends - spell)[current]
    return np.where(in_spell, size[current], config.restlessness)


def _load(
    config: SwayConfig, rng: np.random.Generator, activity: np.ndarray, dt: float
) -> np.ndarray:
    """The people's weight and its two moments, (3, steps), before scaling: Ornstein-Uhlenbeck
    processes of unit variance on the clock of the activity, smoothed over the time of a move."""
    from scipy.signal import lfilter  # its import takes half a second, and few scenes sway

    clock = np.cumsum(activity) * dt
    load = np.empty((3, len(clock)))
    for row, forget_s, move_s in zip(load, config.load_s, config.move_s, strict=True):
        row[:] = _ornstein_uhlenbeck(rng, clock / forget_s)
        follow = np.exp(-dt / move_s)
        for _ in range(2):
            still = follow * row[:1]
            row[:], _ = lfilter([1 - follow], [1.0, -follow], row, zi=still)
    return load


def _ornstein_uhlenbeck(rng: np.random.Generator, u: np.ndarray) -> np.ndarray:
    """Draw an Ornstein-Uhlenbeck process of unit variance, exactly, at instants u (n,), which are
    in correlation times and never decrease: (n,).

    x[k] = e^-d x[k-1] + sqrt(1 - e^-2d) e[k] with d = u[k] - u[k-1]. It is solved as the running
    sum of e^u times the noise, in stretches, so that e^u does not overflow.
    """
    d = np.diff(u, prepend=u[0])
    noise = rng.standard_normal(len(u))
    noise[1:] *= np.sqrt(-np.expm1(-2 * d[1:]))  # the first is the stationary start
    x, start, before = np.empty(len(u)), 0, 0.0
    while start < len(u):
        stop = int(np.searchsorted(u, u[start] + 30.0, side="right"))
        grown = np.exp(u[start:stop] - u[start])
        sums = np.cumsum(grown * noise[start:stop])
        x[start:stop] = (before * np.exp(-d[start]) + sums) / grown
        start, before = stop, x[stop - 1]
    return x


def _low_pass_noise(
    rng: np.random.Generator, steps: int, dt: float, corner_hz: float, order: int
) -> np.ndarray:
    """Draw noise of unit variance that is white below a corner frequency (Butterworth low-pass of
    this order): (6, steps), one row a joint."""
    from scipy.signal import butter, sosfilt

    warm_up = int(np.ceil(2 / (corner_hz * dt)))  # a dozen time constants
    sos = butter(order, corner_hz, fs=1 / dt, output="sos")
    response = sosfilt(sos, np.r_[1.0, np.zeros(4 * warm_up)])
    sos[0, :3] /= np.sqrt(np.sum(response**2))
    filtered = np.empty((len(JOINTS), steps))
    for row in filtered:  # one row at a time stays in the processor's cache
        row[:] = sosfilt(sos, rng.standard_normal(warm_up + steps, dtype=np.float32))[warm_up:]
    return filtered
