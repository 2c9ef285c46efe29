"""Motion of the floor under the bench: vibration, knocks, slow tilt, a moored platform.

Each disturbance is off unless asked for. From a configured [low, high] each recording draws its own
value, uniformly, which is stored with it. Every motion is a closed form of time, so that it can be
evaluated at any instants: the floor's rotation vector, rad, and the velocity of the base's origin,
m/s, in the frame A of `sim.kinematics` (North-East-Down turned by the base's azimuth: forward,
right, down).
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from lbgc.errors import Spread, require, require_not_negative, require_positive, require_spread
from lbgc.sensor import streams
from lbgc.units import factor

_WAVES = 32
"""Sinusoids of which a sea is the sum, which is Gaussian to a percent of its kurtosis."""


def pick(rng: np.random.Generator, value: Spread) -> float:
    """A recording's own value: the configured one, or one drawn uniformly from [low, high]. One
    random number is drawn in either case."""
    share = rng.random()
    low, high = value if isinstance(value, tuple) else (value, value)
    return float(low + (high - low) * share)


def _si(name: str, value: float | tuple[float, ...]) -> np.ndarray:
    """A value in SI, by the unit in which its field's name ends."""
    return np.asarray(value, dtype=float) * factor(name)


@dataclass(frozen=True)
class Vibration:
    """A steady vibration whose frequency swings, f = hz + drift_hz sin(2 pi t/drift_s + phase); its
    phase is the integral of that.

    About each axis the amplitude of the rate is `rate` at the frequency hz (the angle's amplitude
    is constant, rate/(2 pi hz)); along each axis that of the acceleration is `force`.
    """

    level: float  # factor on both amplitudes
    hz: float  # mean frequency, Hz
    drift_hz: float  # amplitude of the frequency's swing, Hz
    drift_s: float  # period of the frequency's swing, s
    rate: np.ndarray  # (3,), rad/s, amplitudes of the rates
    force: np.ndarray  # (3,), m/s^2, amplitudes of the accelerations
    phase: np.ndarray
    """(7,), rad: three of the rotation, three of the translation, and that of the swing"""

    def motion(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rotation vector, rad, and the velocity, m/s, (m, 3) each, at times t (m,), s."""
        slow = 2 * np.pi / self.drift_s
        wander = self.drift_hz / slow * (np.cos(self.phase[6]) - np.cos(slow * t + self.phase[6]))
        phase = 2 * np.pi * (self.hz * t + wander)[:, None]
        size = self.level / (2 * np.pi * self.hz)
        return (
            -size * self.rate * np.cos(phase + self.phase[:3]),
            -size * self.force * np.cos(phase + self.phase[3:6]),
        )


@dataclass(frozen=True)
class VibrationConfig:
    """Vibration by a machine in the building. Amplitudes are about, or along, the base's forward,
    right and down axes."""

    level: Spread = 1.0
    """Factor on both amplitudes."""
    rate_deg_per_h: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Amplitudes of the rates."""
    force_ug: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Amplitudes of the accelerations."""
    hz: Spread = 48.0
    """Frequency of the vibration."""
    drift_hz: Spread = 0.0
    """Amplitude of the frequency's swing to either side."""
    drift_s: float = 60.0
    """Period of the frequency's swing."""

    def __post_init__(self) -> None:
        require_spread(self, "level", "drift_hz")
        require_spread(self, "hz", least=1e-3)
        require_not_negative(self, "rate_deg_per_h", "force_ug")
        for name in ("rate_deg_per_h", "force_ug"):
            value = getattr(self, name)
            require(len(value) == 3, name, value, "must be three figures: forward, right, down")
        require_positive("drift_s", self.drift_s)

    @property
    def is_on(self) -> bool:
        """Whether there is any vibration."""
        return bool(np.any(self.rate_deg_per_h) or np.any(self.force_ug)) and self.level != 0.0

    def draw(self, rng: np.random.Generator, duration_s: float) -> Vibration:
        """Draw one recording's vibration."""
        level, hz, drift = (pick(rng, v) for v in (self.level, self.hz, self.drift_hz))
        rate, force = (_si(n, getattr(self, n)) for n in ("rate_deg_per_h", "force_ug"))
        return Vibration(level, hz, drift, self.drift_s, rate, force, rng.uniform(0, 2 * np.pi, 7))


@dataclass(frozen=True)
class Knocks:
    """Knocks by footsteps and doors. Each is a damped swing x e^(-damping x) sin x, x =
    2 pi hz (t - t0), which starts from rest; its translation is scaled to a peak acceleration, and
    its tilt to a peak angle."""

    per_s: float  # mean number of knocks a second
    peak: float  # 1 sigma of the peak accelerations, m/s^2
    lean: float  # 1 sigma of the peak tilts, rad
    at: np.ndarray  # (k,), s, times of the knocks
    force: np.ndarray  # (k, 3), m/s^2, their peak accelerations
    tilt: np.ndarray  # (k, 3), rad, their peak tilts
    hz: float  # frequency of the swing, Hz
    damping: float  # damping of the swing, per radian of its phase

    def motion(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rotation vector, rad, and the velocity, m/s, (m, 3) each, at times t (m,), s."""
        w = 2 * np.pi * self.hz
        rotation, velocity = np.zeros((len(t), 3)), np.zeros((len(t), 3))
        x = np.linspace(0, 40, 20_001)
        shape, slope = self._swing(x)
        peak, hardest = np.abs(shape).max(), np.abs(np.gradient(slope, x)).max()
        lasts = 40 / self.damping / w / 2  # until it has fallen to e^-20
        for at, force, tilt in zip(self.at, self.force, self.tilt, strict=True):
            on = slice(*np.searchsorted(t, (at, at + lasts)))
            shape, slope = self._swing(w * (t[on] - at))
            rotation[on] += shape[:, None] / peak * tilt
            velocity[on] += slope[:, None] / (hardest * w) * force
        return rotation, velocity

    def _swing(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The swing and its derivative by its phase x."""
        fading, sine, cosine = np.exp(-self.damping * x), np.sin(x), np.cos(x)
        return x * fading * sine, fading * (sine + x * cosine - self.damping * x * sine)


@dataclass(frozen=True)
class KnocksConfig:
    """Footsteps and door slams, at random times."""

    per_minute: Spread = 0.0
    """Mean number of knocks a minute."""
    peak_mg: Spread = 2.0
    """1 sigma of a knock's peak acceleration along each axis."""
    tilt_arcsec: Spread = 1.0
    """1 sigma of a knock's peak tilt about each horizontal axis."""
    hz: Spread = 15.0
    """Frequency of the floor's swinging."""
    damping: float = 0.1
    """Damping of the floor's swinging, per radian of its phase."""

    def __post_init__(self) -> None:
        require_spread(self, "per_minute", "peak_mg", "tilt_arcsec")
        require_spread(self, "hz", least=1e-3)
        good = 0.01 <= self.damping < 1
        require(good, "damping", self.damping, "must be from 0.01 to below 1")

    @property
    def is_on(self) -> bool:
        """Whether there are any knocks."""
        return self.per_minute != 0.0

    def draw(self, rng: np.random.Generator, duration_s: float) -> Knocks:
        """Draw one recording's knocks, of which the number is Poisson's."""
        per_minute, peak, tilt, hz = (
            pick(rng, v) for v in (self.per_minute, self.peak_mg, self.tilt_arcsec, self.hz)
        )
        count = rng.poisson(per_minute * duration_s / 60)
        at = np.sort(rng.uniform(0, duration_s, count))
        peak, lean = (float(_si(n, v)) for n, v in (("peak_mg", peak), ("tilt_arcsec", tilt)))
        force = peak * rng.standard_normal((count, 3))
        leans = lean * rng.standard_normal((count, 3)) * [1, 1, 0]
        return Knocks(per_minute / 60, peak, lean, at, force, leans, hz, self.damping)


@dataclass(frozen=True)
class Tilting:
    """A slow tilt of the floor, at a steady rate from the recording's start."""

    rate: float  # rate of the tilt, rad/s
    direction: float  # direction of the axis about which it tilts, rad, from forward to the right

    def motion(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rotation vector, rad, and the velocity, m/s, (m, 3) each, at times t (m,), s. The
        velocity is zero."""
        axis = np.array([np.cos(self.direction), np.sin(self.direction), 0.0])
        return self.rate * t[:, None] * axis, np.zeros((len(t), 3))


@dataclass(frozen=True)
class TiltingConfig:
    """Slow tilt of the floor, as it settles or as the sun warms a wall."""

    arcsec_per_h: Spread = 0.0
    """Rate of the tilt; its direction is drawn from the whole circle."""

    def __post_init__(self) -> None:
        require_spread(self, "arcsec_per_h")

    @property
    def is_on(self) -> bool:
        """Whether the floor tilts."""
        return self.arcsec_per_h != 0.0

    def draw(self, rng: np.random.Generator, duration_s: float) -> Tilting:
        """Draw one recording's tilt."""
        rate = _si("arcsec_per_h", pick(rng, self.arcsec_per_h))
        return Tilting(float(rate), rng.uniform(0, 2 * np.pi))


@dataclass(frozen=True)
class Moored:
    """Motion of a platform afloat: roll, pitch and heave, each a sum of sinusoids of random phase
    whose frequencies are normal about 1/period."""

    roll: float  # rms roll, rad
    pitch: float  # rms pitch, rad
    heave: float  # rms heave, m
    period: float  # period of the waves at their mean frequency, s
    hz: np.ndarray  # (3, waves), Hz, frequencies of roll, pitch and heave
    phase: np.ndarray  # (3, waves), rad, their phases

    def motion(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rotation vector, rad, and the velocity, m/s, (m, 3) each, at times t (m,), s."""
        w = 2 * np.pi * self.hz
        each = np.sqrt(2 / self.hz.shape[1])
        rotation, velocity = np.zeros((len(t), 3)), np.zeros((len(t), 3))
        for axis, size in enumerate((self.roll, self.pitch)):
            rotation[:, axis] = size * each * _sines(t, w[axis], self.phase[axis])
        up = self.heave * each * _sines(t, w[2], self.phase[2] + np.pi / 2, w[2])
        velocity[:, 2] = -up
        return rotation, velocity


def _sines(
    t: np.ndarray, w: np.ndarray, phase: np.ndarray, size: np.ndarray | float = 1.0
) -> np.ndarray:
    """The sum of k waves size sin(w t + phase) at times t (m,), s: (m,). w : (k,), rad/s; phase :
    (k,), rad; size : (k,) or one for all."""
    total = np.zeros(len(t))
    for own, start, amplitude in zip(w, phase, np.broadcast_to(size, w.shape), strict=True):
        total += amplitude * np.sin(own * t + start)
    return total


@dataclass(frozen=True)
class MooredConfig:
    """Motion of a vessel at its moorings, as in the paper's dynamic settings."""

    roll_deg: Spread = 0.0
    """Rms roll."""
    pitch_deg: Spread = 0.0
    """Rms pitch."""
    heave_m: Spread = 0.0
    """Rms heave."""
    period_s: Spread = 8.0
    """Period of the waves, at their mean frequency."""
    width: float = 0.15
    """1 sigma of the waves' frequencies, over their mean."""

    def __post_init__(self) -> None:
        require_spread(self, "roll_deg", "pitch_deg", "heave_m")
        require_spread(self, "period_s", least=0.1)
        good = 0 < self.width <= 0.3
        require(good, "width", self.width, "must be above 0, up to 0.3")

    @property
    def is_on(self) -> bool:
        """Whether the platform moves."""
        return any(v != 0.0 for v in (self.roll_deg, self.pitch_deg, self.heave_m))

    def draw(self, rng: np.random.Generator, duration_s: float) -> Moored:
        """Draw one recording's motion of the platform."""
        roll, pitch, heave, period = (
            pick(rng, v) for v in (self.roll_deg, self.pitch_deg, self.heave_m, self.period_s)
        )
        spread = np.clip(rng.standard_normal((3, _WAVES)), -3, 3)
        return Moored(
            float(_si("roll_deg", roll)),
            float(_si("pitch_deg", pitch)),
            heave,
            period,
            (1 + self.width * spread) / period,
            rng.uniform(0, 2 * np.pi, (3, _WAVES)),
        )


@dataclass(frozen=True)
class FloorConfig:
    """The disturbances that can move the floor, one field each."""

    vibration: VibrationConfig = field(default_factory=VibrationConfig)
    knocks: KnocksConfig = field(default_factory=KnocksConfig)
    tilting: TiltingConfig = field(default_factory=TiltingConfig)
    moored: MooredConfig = field(default_factory=MooredConfig)

    @cached_property
    def moves(self) -> bool:
        """Whether any disturbance is on."""
        return any(part.is_on for part in self._parts)

    def draw(self, rng: np.random.Generator, duration_s: float) -> "Floor":
        """Draw one recording's floor, each disturbance from a random stream of its own, so that one
        does not change the others' numbers."""
        one, two, three, four = rng.spawn(4)
        return Floor(
            self.vibration.draw(one, duration_s),
            self.knocks.draw(two, duration_s),
            self.tilting.draw(three, duration_s),
            self.moored.draw(four, duration_s),
            moving=tuple(part.is_on for part in self._parts),
        )

    @property
    def _parts(self) -> tuple[VibrationConfig, KnocksConfig, TiltingConfig, MooredConfig]:
        return self.vibration, self.knocks, self.tilting, self.moored

    @cached_property
    def still(self) -> "Floor":
        """A floor for a configuration in which nothing moves it; its drawn numbers are not used."""
        return self.draw(streams.figures(), 1.0)


@dataclass(frozen=True)
class Floor:
    """The floor's motion in one recording, as drawn for each disturbance."""

    vibration: Vibration
    knocks: Knocks
    tilting: Tilting
    moored: Moored
    moving: tuple[bool, ...]
    """Which of the four are on."""

    def motion(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The floor's rotation vector, rad, and the base's velocity, m/s, (m, 3) each, at times t
        (m,), s.

        Rotation vectors are added, since the rotations are small, those of a moored platform (a few
        degrees) included.
        """
        rotation, velocity = np.zeros((len(t), 3)), np.zeros((len(t), 3))
        motions = (part.motion for part in self.parts)
        for motion, is_on in zip(motions, self.moving, strict=True):
            if is_on:
                turned, carried = motion(t)
                rotation += turned
                velocity += carried
        return rotation, velocity

    @property
    def parts(self) -> tuple[Vibration, Knocks, Tilting, Moored]:
        """The disturbances, in the order of `moving`."""
        return self.vibration, self.knocks, self.tilting, self.moored

    def values(self) -> dict[str, float | np.ndarray | int]:
        """The drawn values by the names under which the dataset stores them, SI; zero for a
        disturbance that is off."""
        return self._values

    @cached_property
    def _values(self) -> dict[str, float | np.ndarray | int]:
        v, k, t, m = self.parts
        on = dict(zip(("vibration", "knocks", "tilting", "moored"), self.moving, strict=True))
        values: dict[str, tuple[str, float | np.ndarray | int]] = {
            "vibration_level": ("vibration", v.level),
            "vibration_frequency": ("vibration", v.hz),
            "vibration_drift": ("vibration", v.drift_hz),
            "vibration_phase": ("vibration", v.phase[:3]),
            "vibration_force_phase": ("vibration", v.phase[3:6]),
            "vibration_drift_phase": ("vibration", float(v.phase[6])),
            "knock_rate": ("knocks", k.per_s),
            "knock_count": ("knocks", len(k.at)),
            "knock_peak": ("knocks", k.peak),
            "knock_tilt": ("knocks", k.lean),
            "knock_frequency": ("knocks", k.hz),
            "floor_tilt_rate": ("tilting", t.rate),
            "floor_tilt_direction": ("tilting", t.direction),
            "moored_roll": ("moored", m.roll),
            "moored_pitch": ("moored", m.pitch),
            "moored_heave": ("moored", m.heave),
            "moored_period": ("moored", m.period),
        }
        return {name: value if on[part] else 0 * value for name, (part, value) in values.items()}
