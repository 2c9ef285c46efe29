"""The IMU error model: what a sensor prints when the truth is this (the paper's eqs. 1-2).

    measured = counts((I + M) truth + b_unit + b_session + b_run + noise + tone)

M holds scale factor errors (diagonal) and misalignments (off it). What stays for how long is the
point: `unit` errors belong to the serial number, `session` to a power-up, `run` to one recording;
the noise terms evolve within it. Rounding to counts and clipping to the range are not linear and
stand outside the exact law of block means.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from lbgc import units
from lbgc.errors import Axes, InputError, require, require_not_negative, require_positive
from lbgc.sensor import gaussian, noise

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class GyroConfig:
    """A gyro triad in datasheet units. A figure is one number or three: forward, right, down."""

    arw_deg_per_sqrt_h: Axes = 0.0
    """Angle random walk N."""
    bias_instability_deg_per_h: Axes = 0.0
    """B; the Allan floor is 0.664 of it."""
    rrw_deg_per_h_per_sqrt_h: Axes = 0.0
    """Rate random walk K."""
    flicker_short_s: float = 1.0
    """Shortest averaging time of the bias instability's flat floor."""
    flicker_long_s: float = 3600.0
    """Longest averaging time of that floor."""
    bias_unit_deg_per_h: Axes = 0.0
    """1 sigma between units, for a unit's life."""
    bias_session_deg_per_h: Axes = 0.0
    """1 sigma between power-ups."""
    bias_run_deg_per_h: Axes = 0.0
    """1 sigma between recordings."""
    scale_unit_ppm: Axes = 0.0
    """Scale factor error, 1 sigma between units."""
    misalignment_unit_mrad: Axes = 0.0
    """Of each axis towards each other one, 1 sigma between units."""
    tone_hz: float = 0.0
    """Frequency of a vibration line."""
    tone_deg_per_h: Axes = 0.0
    """Its amplitude; its phase is random."""
    rate_lsb_deg_per_s: float | None = None
    """Output count; null: no rounding."""
    range_deg_per_s: float | None = None
    """Output is clipped to +- this; null: no limit."""

    def __post_init__(self) -> None:
        _validate(self)

    def triad(self) -> "Triad":
        return _triad(
            self,
            N="arw_deg_per_sqrt_h",
            B="bias_instability_deg_per_h",
            K="rrw_deg_per_h_per_sqrt_h",
            bias_unit="bias_unit_deg_per_h",
            bias_session="bias_session_deg_per_h",
            bias_run="bias_run_deg_per_h",
            tone="tone_deg_per_h",
            lsb="rate_lsb_deg_per_s",
            range="range_deg_per_s",
        )


@dataclass(frozen=True)
class AccelConfig:
    """An accelerometer triad in datasheet units, as `GyroConfig`."""

    noise_ug_per_sqrt_hz: Axes = 0.0
    """Noise density as datasheets print it, one-sided: N is this over sqrt(2)."""
    bias_instability_ug: Axes = 0.0
    """B; the Allan floor is 0.664 of it."""
    random_walk_ug_per_sqrt_h: Axes = 0.0
    """Acceleration random walk K."""
    flicker_short_s: float = 1.0
    """Shortest averaging time of the bias instability's flat floor."""
    flicker_long_s: float = 3600.0
    """Longest averaging time of that floor."""
    bias_unit_mg: Axes = 0.0
    """1 sigma between units, for a unit's life."""
    bias_session_mg: Axes = 0.0
    """1 sigma between power-ups."""
    bias_run_mg: Axes = 0.0
    """1 sigma between recordings."""
    scale_unit_ppm: Axes = 0.0
    """Scale factor error, 1 sigma between units."""
    misalignment_unit_mrad: Axes = 0.0
    """Of each axis towards each other one, 1 sigma between units."""
    tone_hz: float = 0.0
    """Frequency of a vibration line."""
    tone_ug: Axes = 0.0
    """Its amplitude; its phase is random."""
    lsb_ug: float | None = None
    """Output count; null: no rounding."""
    range_g: float | None = None
    """Output is clipped to +- this; null: no limit."""

    def __post_init__(self) -> None:
        _validate(self)

    def triad(self) -> "Triad":
        return _triad(
            self,
            N="noise_ug_per_sqrt_hz",
            B="bias_instability_ug",
            K="random_walk_ug_per_sqrt_h",
            bias_unit="bias_unit_mg",
            bias_session="bias_session_mg",
            bias_run="bias_run_mg",
            tone="tone_ug",
            lsb="lsb_ug",
            range="range_g",
        )


@dataclass(frozen=True)
class ImuConfig:
    """An IMU: what `conf/imu/*.yaml` holds."""

    name: str = "custom"
    """How reports call it."""
    gyro: GyroConfig = field(default_factory=GyroConfig)
    accel: AccelConfig = field(default_factory=AccelConfig)


def _validate(config: GyroConfig | AccelConfig) -> None:
    for name, value in vars(config).items():
        if isinstance(value, list):
            require(len(value) == 3, name, value, "must be one number or three: [x, y, z]")
        if value is not None:
            require_not_negative(config, name)
            if "lsb" in name or "range" in name or "flicker" in name:
                require_positive(name, value)
    require(
        config.flicker_long_s > config.flicker_short_s,
        "flicker_long_s",
        config.flicker_long_s,
        f"must be above flicker_short_s = {config.flicker_short_s}",
    )
    tone = next(name for name in vars(config) if name.startswith("tone_") and name != "tone_hz")
    require(
        config.tone_hz > 0 or not np.any(getattr(config, tone)),
        "tone_hz",
        config.tone_hz,
        f"must be given for a tone of {tone} = {getattr(config, tone)}",
    )


def _triad(config: GyroConfig | AccelConfig, *, lsb: str, range: str, **keys: str) -> "Triad":
    """The triad in SI; `keys` says which configured key plays which part."""

    def axes(key: str) -> Triple:
        value = getattr(config, key)
        x, y, z = value if isinstance(value, list) else [value] * 3
        scale = units.factor(key)
        return (scale * x, scale * y, scale * z)

    def optional(key: str) -> float | None:
        value = getattr(config, key)
        return None if value is None else units.factor(key) * value

    return Triad(
        flicker_corners=(config.flicker_short_s, config.flicker_long_s),
        scale_unit=axes("scale_unit_ppm"),
        misalignment_unit=axes("misalignment_unit_mrad"),
        tone_hz=config.tone_hz,
        lsb=optional(lsb),
        range=optional(range),
        keys={"lsb": lsb, "range": range},
        **{part: axes(key) for part, key in keys.items()},
    )


@dataclass(frozen=True)
class TriadErrors:
    """What was drawn for a triad and a recording: nothing about a recording is a mystery."""

    bias_unit: np.ndarray  # (3,)
    matrix: np.ndarray  # (3, 3), M
    bias_session: np.ndarray  # (3,)
    bias_run: np.ndarray  # (3,)
    tone_phase: np.ndarray  # (3,), rad

    @property
    def bias(self) -> np.ndarray:
        return self.bias_unit + self.bias_session + self.bias_run


@dataclass(frozen=True)
class Triad:
    """Three like sensors on the body's axes, in SI units; each figure one an axis.

    N, B, K : the noise coefficients (IEEE Std 952); bias_*, scale_unit, misalignment_unit : 1 sigma
    by lifetime; tone : amplitudes; lsb, range : of the output, or None.
    """

    N: Triple
    B: Triple
    K: Triple
    flicker_corners: tuple[float, float]
    bias_unit: Triple
    bias_session: Triple
    bias_run: Triple
    scale_unit: Triple
    misalignment_unit: Triple
    tone_hz: float
    tone: Triple
    lsb: float | None
    range: float | None
    keys: dict[str, str] = field(compare=False)
    """The configured names of `lsb` and `range`, for messages."""

    @cached_property
    def terms(self) -> tuple[gaussian.Gaussians, ...]:
        """The in-run Gaussian terms of each axis; a coefficient of zero is no term."""
        return tuple(
            tuple(
                term
                for coefficient, term in (
                    (n, noise.White(n)),
                    (b, noise.Flicker(b, *self.flicker_corners)),
                    (k, noise.RandomWalk(k)),
                )
                if coefficient > 0
            )
            for n, b, k in zip(self.N, self.B, self.K, strict=True)
        )

    def allan_variance(self, tau: np.ndarray, dt: float) -> np.ndarray:
        """The model's own Allan variance, tau (*S) in s -> (3, *S): terms, tone and rounding."""
        rounding = noise.White(0.0 if self.lsb is None else self.lsb * np.sqrt(dt / 12))
        return np.stack(
            [
                noise.allan_variance((*terms, rounding, noise.Sinusoid(tone, self.tone_hz)), tau)
                for terms, tone in zip(self.terms, self.tone, strict=True)
            ]
        )

    def draw_unit(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """A serial number's bias (3,) and matrix M (3, 3)."""
        bias = rng.standard_normal(3) * self.bias_unit
        off_diagonal = rng.standard_normal((3, 3)) * np.array(self.misalignment_unit)[:, None]
        scale = rng.standard_normal(3) * self.scale_unit
        return bias, np.where(np.eye(3, dtype=bool), np.diag(scale), off_diagonal)

    def draw_session(self, rng: np.random.Generator) -> np.ndarray:
        """A power-up's bias, (3,)."""
        return rng.standard_normal(3) * self.bias_session

    def draw_run(
        self,
        rng: np.random.Generator,
        of_unit: tuple[np.ndarray, np.ndarray],
        of_session: np.ndarray,
    ) -> TriadErrors:
        """What is drawn before a recording starts, joined to what its unit and session fixed."""
        bias = rng.standard_normal(3) * self.bias_run
        phase = rng.uniform(0, 2 * np.pi, 3)
        return TriadErrors(*of_unit, of_session, bias, phase)

    def sample_noise(
        self, rng: np.random.Generator, count: int, n: int, interval: float
    ) -> np.ndarray:
        """The Gaussian in-run noise alone, of interval means: float32 (count, n, 3)."""
        axes = [gaussian.sample(terms, rng, (count, n), interval) for terms in self.terms]
        return np.stack(axes, axis=-1)

    def measure(
        self, rng: np.random.Generator, truth: np.ndarray, errors: TriadErrors, n: int, dt: float
    ) -> np.ndarray:
        """The n samples the sensor prints, (3, n): int32 counts of `lsb`, or float32 without one.

        truth : (3, n), or (3, 1) where it is constant; means over (t_k - dt, t_k].
        """
        signal = self._linear(rng, truth, errors, n, dt)
        if self.range is not None:
            np.clip(signal, -self.range, self.range, out=signal)
        if self.lsb is None:
            return signal
        return np.rint(signal / np.float32(self.lsb)).astype(np.int32)

    def measure_means(
        self,
        rng: np.random.Generator,
        truth: np.ndarray,
        errors: TriadErrors,
        n: int,
        dt: float,
        block: int,
    ) -> np.ndarray:
        """n means over `block` samples each, float32 (3, n), with the law of averaging `measure`.

        Rounding enters as the white noise that it is while the samples' noise exceeds half a count;
        `check_means` refuses where it does not, and where the range would clip.
        """
        means = self._linear(rng, truth, errors, n, dt * block)
        if self.lsb is not None:
            rounding = self.lsb / np.sqrt(12 * block)
            means += rng.standard_normal((3, n), dtype=np.float32) * np.float32(rounding)
        return means

    def _linear(
        self, rng: np.random.Generator, truth: np.ndarray, errors: TriadErrors, n: int, dt: float
    ) -> np.ndarray:
        constant = (np.eye(3) + errors.matrix) @ truth + errors.bias[:, None]
        signal = np.empty((3, n), np.float32)
        for axis, terms in enumerate(self.terms):
            signal[axis] = gaussian.sample(terms, rng, (n,), dt)
            if self.tone[axis] > 0:
                tone = noise.Sinusoid(self.tone[axis], self.tone_hz)
                signal[axis] += tone.at_phase(errors.tone_phase[axis], n, dt)
        signal += constant
        return signal

    def check_means(self, name: str, dt: float, largest_truth: float) -> None:
        """Raise InputError where block means cannot have the law of averaged samples.

        name : the triad's key, for the message; largest_truth : of its rate or force, SI.
        """
        quietest = min(self.N) / np.sqrt(dt)
        if self.lsb is not None and quietest < self.lsb / 2:
            self._refuse_means(name, "lsb", quietest, "the samples' noise is", "has a dead band")
        loudest = largest_truth + 6 * max(self.N) / np.sqrt(dt) + max(self.tone)
        if self.range is not None and loudest > self.range:
            self._refuse_means(name, "range", loudest, "signal and noise reach", "clips")

    def _refuse_means(self, name: str, part: str, value: float, what: str, why: str) -> None:
        key = self.keys[part]
        unit, scale = units.unit_of(key), units.factor(key)
        raise InputError(
            f"{name}.{key}",
            round(getattr(self, part) / scale, 9),
            unit,
            f"{what} {value / scale:.3g} {unit}, so this {why}, which means cannot represent; "
            "use output=samples, or null for this key",
        )
