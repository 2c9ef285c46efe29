"""An IMU in datasheet units: what `conf/imu/*.yaml` holds, and its one conversion to SI."""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field
from typing import Any

import numpy as np

from lbgc.errors import Axes, require, require_name, require_not_negative
from lbgc.outputs import LONGEST, shown
from lbgc.sensor import kalibr, noise
from lbgc.sensor.conversion import to_si
from lbgc.sensor.counting import CarriedCounts, RateCounts
from lbgc.sensor.deterministic import Ramp, Sinusoid
from lbgc.sensor.errors import FIELD, FORCE, ONE, TRUTH, Surroundings, Triple
from lbgc.sensor.imu import ImuModel, Timing, Triad
from lbgc.sensor.low_pass import LowPass
from lbgc.sensor.rows import alternatives, bias, counts, drawn, limit, minimum, named, several, term
from lbgc.units import GAUSS

_GAIN, _WARMS = "scale and misalignment", "warming up"


@dataclass(frozen=True)
class GyroLine:
    """A line that wanders about its frequency; an axis without it has a size of zero."""

    deg_per_h: Axes = term(noise.Line, "sigma", MISSING)
    """The line's rms."""
    hz: Axes = term(noise.Line, "f0", MISSING)
    """The line's centre."""
    width_hz: Axes = term(noise.Line, "width", MISSING)
    """The line's full width at half power."""
    poles: Axes = term(noise.Line, "poles", 2)
    """2: steep flanks, a frequency that wanders; 1: a damped resonance's gentle ones."""

    def __post_init__(self) -> None:
        _check_line(self, "deg_per_h")


@dataclass(frozen=True)
class AccelLine:
    """A line in the accelerometers' noise that wanders about its frequency, as a gyro's does."""

    ug: Axes = term(noise.Line, "sigma", MISSING)
    """The line's rms."""
    hz: Axes = term(noise.Line, "f0", MISSING)
    """The line's centre."""
    width_hz: Axes = term(noise.Line, "width", MISSING)
    """The line's full width at half power."""
    poles: Axes = term(noise.Line, "poles", 2)
    """2: steep flanks, a frequency that wanders; 1: a damped resonance's gentle ones."""

    def __post_init__(self) -> None:
        _check_line(self, "ug")


def _check_line(line: GyroLine | AccelLine, size: str) -> None:
    _check_three(line)
    for name in ("hz", "width_hz"):
        given = np.broadcast_to(getattr(line, name), 3) > 0
        asked = np.broadcast_to(getattr(line, size), 3) > 0
        about = f"must be above zero where {size} = {getattr(line, size)} is"
        require(bool((given | ~asked).all()), name, getattr(line, name), about)
    good = bool(np.isin(np.broadcast_to(line.poles, 3), (1, 2)).all())
    require(good, "poles", line.poles, "must be 1 (a damped resonance) or 2 (steep flanks)")


def _check_three(config: object) -> None:
    """Every figure is one number or three, and none is negative."""
    for name, value in vars(config).items():
        if isinstance(value, list):
            require(len(value) == 3, name, value, "must be one number or three: [x, y, z]")
        if value is not None and not isinstance(value, str | tuple):
            require_not_negative(config, name)


@dataclass(frozen=True)
class GyroConfig:
    """A gyro triad in datasheet units. A figure is one number or three: forward, right, down."""

    arw_deg_per_sqrt_h: Axes | None = term(noise.White, "N", None)
    """Angle random walk N, the root of the two-sided density, as calibration files (Kalibr) print
    it; null: see the next."""
    noise_deg_per_s_per_sqrt_hz: Axes | None = term(noise.White, "N", None)
    """Or as a one-sided rate noise density, as datasheets print it: N is this over sqrt(2). Null in
    both: none."""
    bias_instability_deg_per_h: Axes | None = term(noise.Flicker, "B", None)
    """B of IEEE Std 952; flicker's Allan floor is 0.664 of it. Null: see the next."""
    allan_minimum_deg_per_h: Axes | None = minimum(noise.Flicker, "B")
    """Or the lowest point of the Allan deviation, which most datasheets print under that name: B is
    what makes it so beside N and K. Null in both: none."""
    rrw_deg_per_h_per_sqrt_h: Axes = term(noise.RandomWalk, "K")
    """Rate random walk K."""
    quantisation_arcsec: Axes = term(noise.AngleQuantisation, "Q")
    """Quantisation of the integrated output, IEEE Std 952's Q: a carried count over sqrt(12)."""
    ramp_deg_per_h_per_h: Axes = term(Ramp, "R")
    """Drift R of the rate, its sign new in every recording."""
    gauss_markov_deg_per_h: Axes = term(noise.GaussMarkov, "sigma")
    """1 sigma of a first-order Gauss-Markov process."""
    gauss_markov_s: Axes = term(noise.GaussMarkov, "T", 100.0, positive=True)
    """Correlation time of the Gauss-Markov process."""
    lines: tuple[GyroLine, ...] = several()
    """Lines that wander, as many as there are."""
    bandwidth_hz: Axes | None = term(LowPass, "bandwidth", None, positive=True)
    """Natural frequency of the second-order low-pass behind which the white noise, the tone and
    what moves come out; null: the mean over the sample's interval alone."""
    filter_damping: Axes = term(LowPass, "damping", 0.707107, positive=True)
    """Damping ratio of the low-pass filter; 0.707 (Butterworth) makes the bandwidth its -3 dB
    point."""
    g_sensitivity_deg_per_h_per_g: Axes = drawn(
        "g_sensitivity", "g-sensitivity", "unit", FORCE, "cross"
    )
    """Sensitivity of each gyro to specific force along each axis, 1 sigma between units."""
    magnetic_deg_per_h_per_gauss: Axes = drawn(
        "magnetic", "magnetic sensitivity", "unit", FIELD, "cross"
    )
    """Sensitivity of each gyro to the magnetic field along each axis, 1 sigma between units."""
    flicker_short_s: float = term(noise.Flicker, "T_short", 1.0, positive=True)
    """Shortest averaging time of the bias instability's flat floor."""
    flicker_long_s: float = term(noise.Flicker, "T_long", 3600.0, positive=True)
    """Longest averaging time of the bias instability's flat floor."""
    bias_unit_deg_per_h: Axes = bias("unit")
    """Bias of a unit for its life, 1 sigma between units."""
    bias_session_deg_per_h: Axes = bias("session")
    """Bias of a power-up, 1 sigma between power-ups."""
    bias_run_deg_per_h: Axes = bias("run")
    """Bias of a recording, 1 sigma between recordings."""
    scale_unit_ppm: Axes = drawn("matrix", _GAIN, "unit", TRUTH)
    """Scale factor error, 1 sigma between units."""
    misalignment_unit_mrad: Axes = drawn("matrix", _GAIN, "unit", TRUTH, "cross")
    """Misalignment of each axis towards each other one, 1 sigma between units."""
    bias_per_k_deg_per_h_per_k: Axes = drawn("bias_per_k", _WARMS, "unit", ONE, warms=True)
    """Bias over temperature rise, 1 sigma between units."""
    scale_per_k_ppm_per_k: Axes = drawn("scale_per_k", _WARMS, "unit", TRUTH, warms=True)
    """Scale factor over temperature rise, 1 sigma between units."""
    tone_hz: Axes = term(Sinusoid, "f")
    """Frequency of a steady vibration."""
    tone_deg_per_h: Axes = term(Sinusoid, "amplitude")
    """Amplitude of that vibration; its phase is random."""
    rate_lsb_deg_per_s: float | None = counts(RateCounts)
    """Output count of a rate output: each sample is rounded; null: it is not."""
    angle_lsb_arcsec: float | None = counts(CarriedCounts)
    """Or the count of an angle output: increments are counted and the rest is carried over."""
    range_deg_per_s: float | None = limit()
    """Output is clipped to +- this; null: no limit."""

    def __post_init__(self) -> None:
        _validate(self)

    def triad(self) -> Triad:
        """The triad in SI units."""
        return to_si(self)


@dataclass(frozen=True)
class AccelConfig:
    """An accelerometer triad in datasheet units. A figure is one number or three, as a gyro's."""

    noise_ug_per_sqrt_hz: Axes | None = term(noise.White, "N", None)
    """Noise density as datasheets print it, one-sided: N is this over sqrt(2)."""
    vrw_m_per_s_per_sqrt_h: Axes | None = term(noise.White, "N", None)
    """Or as velocity random walk N, the root of the two-sided density, as calibration files
    (Kalibr) print it. Null in both: no white noise."""
    bias_instability_ug: Axes | None = term(noise.Flicker, "B", None)
    """B of IEEE Std 952; flicker's Allan floor is 0.664 of it. Null: see the next two."""
    allan_minimum_ug: Axes | None = minimum(noise.Flicker, "B")
    """Or the lowest point of the Allan deviation, which most datasheets print under that name: B is
    what makes it so beside N and K."""
    allan_minimum_mg: Axes | None = minimum(noise.Flicker, "B")
    """Or the Allan deviation's lowest point in mg. Null in all three: none."""
    random_walk_ug_per_sqrt_h: Axes = term(noise.RandomWalk, "K")
    """Acceleration random walk K."""
    quantisation_ug_s: Axes = term(noise.AngleQuantisation, "Q")
    """Quantisation of the integrated output, IEEE Std 952's Q: a carried count over sqrt(12)."""
    ramp_ug_per_h: Axes = term(Ramp, "R")
    """Drift R of the output, its sign new in every recording."""
    gauss_markov_ug: Axes = term(noise.GaussMarkov, "sigma")
    """1 sigma of a first-order Gauss-Markov process."""
    gauss_markov_s: Axes = term(noise.GaussMarkov, "T", 100.0, positive=True)
    """Correlation time of the Gauss-Markov process."""
    lines: tuple[AccelLine, ...] = several()
    """Lines that wander, as many as there are."""
    bandwidth_hz: Axes | None = term(LowPass, "bandwidth", None, positive=True)
    """Natural frequency of the second-order low-pass behind which the white noise, the tone and
    what moves come out; null: the mean over the sample's interval alone."""
    filter_damping: Axes = term(LowPass, "damping", 0.707107, positive=True)
    """Damping ratio of the low-pass filter; 0.707 (Butterworth) makes the bandwidth its -3 dB
    point."""
    flicker_short_s: float = term(noise.Flicker, "T_short", 1.0, positive=True)
    """Shortest averaging time of the bias instability's flat floor."""
    flicker_long_s: float = term(noise.Flicker, "T_long", 3600.0, positive=True)
    """Longest averaging time of the bias instability's flat floor."""
    bias_unit_mg: Axes = bias("unit")
    """Bias of a unit for its life, 1 sigma between units."""
    bias_session_mg: Axes = bias("session")
    """Bias of a power-up, 1 sigma between power-ups."""
    bias_run_mg: Axes = bias("run")
    """Bias of a recording, 1 sigma between recordings."""
    scale_unit_ppm: Axes = drawn("matrix", _GAIN, "unit", TRUTH)
    """Scale factor error, 1 sigma between units."""
    misalignment_unit_mrad: Axes = drawn("matrix", _GAIN, "unit", TRUTH, "cross")
    """Misalignment of each axis towards each other one, 1 sigma between units."""
    bias_per_k_ug_per_k: Axes = drawn("bias_per_k", _WARMS, "unit", ONE, warms=True)
    """Bias over temperature rise, 1 sigma between units."""
    scale_per_k_ppm_per_k: Axes = drawn("scale_per_k", _WARMS, "unit", TRUTH, warms=True)
    """Scale factor over temperature rise, 1 sigma between units."""
    tone_hz: Axes = term(Sinusoid, "f")
    """Frequency of a steady vibration."""
    tone_ug: Axes = term(Sinusoid, "amplitude")
    """Amplitude of that vibration; its phase is random."""
    lsb_ug: float | None = counts(RateCounts)
    """Output count of a force output: each sample is rounded; null: it is not."""
    velocity_lsb_m_per_s: float | None = counts(CarriedCounts)
    """Or the count of a velocity output: increments are counted and the rest is carried over."""
    range_g: float | None = limit()
    """Output is clipped to +- this; null: no limit."""

    def __post_init__(self) -> None:
        _validate(self)

    def triad(self) -> Triad:
        """The triad in SI units."""
        return to_si(self)


@dataclass(frozen=True)
class TemperatureConfig:
    """How the sensor warms up: rise (1 - e^(-t/time)) above where it was switched on."""

    rise_k: float = 0.0
    """Temperature rise in the end."""
    time_s: float = 600.0
    """Time constant of the rise."""
    since_power_up_s: float = 0.0
    """Time from power-up to a recording's start."""

    def __post_init__(self) -> None:
        require(self.time_s > 0, "time_s", self.time_s, "must be greater than zero")
        require_not_negative(self, "since_power_up_s")


@dataclass(frozen=True)
class FieldConfig:
    """The magnetic field around the sensor: Earth's, as a magnetic model or a chart has it, or what
    the building makes of it. Felt by gyros with a magnetic sensitivity alone."""

    horizontal_gauss: float = 0.0
    """Strength of its horizontal part: 0.2 to 0.3 in the middle latitudes."""
    vertical_gauss: float = 0.0
    """Its vertical part, down: positive in the north."""
    declination_deg: float = 0.0
    """Angle of its horizontal part from true north, to the east."""

    def __post_init__(self) -> None:
        require_not_negative(self, "horizontal_gauss")

    @property
    def ned(self) -> Triple:
        """North, east and down, T."""
        size, angle = GAUSS * self.horizontal_gauss, np.deg2rad(self.declination_deg)
        north, east = float(size * np.cos(angle)), float(size * np.sin(angle))
        return (north, east, GAUSS * self.vertical_gauss)


@dataclass(frozen=True)
class TimingConfig:
    """What happens to samples between the sensor and the file."""

    jitter_s: float = 0.0
    """1 sigma of a timestamp about the true time."""
    dropped_share: float = 0.0
    """Share of the samples that are lost, at random; the file repeats the last one that came, and
    flags it."""

    def __post_init__(self) -> None:
        require_not_negative(self, "jitter_s", "dropped_share")
        require(self.dropped_share < 1, "dropped_share", self.dropped_share, "must be below 1")

    def timing(self) -> Timing:
        """The same, as it acts on samples."""
        return Timing(self.jitter_s, self.dropped_share)


@dataclass(frozen=True)
class ImuConfig:
    """An IMU: what `conf/imu/*.yaml` holds; or an IMU file of Kalibr's (`lbgc.sensor.kalibr`)."""

    name: str = "custom"
    """How reports call it."""
    assumed: str = ""
    """What of it is assumed and was never measured: `evaluate` and `bound` name it."""
    timing: TimingConfig = field(default_factory=TimingConfig)
    temperature: TemperatureConfig = field(default_factory=TemperatureConfig)
    magnetic_field: FieldConfig = field(default_factory=FieldConfig)
    gyro: GyroConfig = field(default_factory=GyroConfig)
    accel: AccelConfig = field(default_factory=AccelConfig)

    def __post_init__(self) -> None:
        require_name("name", self.name)
        size = self.gyro.magnetic_deg_per_h_per_gauss
        require(
            any(self.magnetic_field.ned) or not np.any(size),
            "gyro.magnetic_deg_per_h_per_gauss",
            size,
            "takes a field: say magnetic_field.horizontal_gauss and vertical_gauss, or 0 here",
        )

    @staticmethod
    def adopted(given: Mapping[str, Any]) -> Mapping[str, Any]:
        """What was given, in this configuration's own keys."""
        return kalibr.adopted(given)

    def model(self, rate_hz: float) -> ImuModel:
        """The sensor in SI units, where it samples at this rate (Hz)."""
        return ImuModel(
            self.gyro.triad(),
            self.accel.triad(),
            1 / rate_hz,
            Surroundings(**vars(self.temperature)),
            self.magnetic_field.ned,
            shown(self.assumed, 3 * LONGEST),
        )


def _validate(config: GyroConfig | AccelConfig) -> None:
    _check_three(config)
    for name in named("positive", config):
        value = getattr(config, name)
        if value is not None:
            lowest = min(value) if isinstance(value, list) else value
            require(lowest > 0, name, value, "must be greater than zero")
    require(
        config.flicker_long_s > config.flicker_short_s,
        "flicker_long_s",
        config.flicker_long_s,
        f"must be above flicker_short_s = {config.flicker_short_s}",
    )
    size = next(n for n in vars(config) if n.startswith("tone_") and n != "tone_hz")
    given = np.broadcast_to(config.tone_hz, 3) > 0
    asked = np.broadcast_to(getattr(config, size), 3) > 0
    about = f"must be given for {size} = {getattr(config, size)}"
    require(bool((given | ~asked).all()), "tone_hz", config.tone_hz, about)
    (one, other) = named("counts", config)
    both = getattr(config, one) is not None and getattr(config, other) is not None
    about = f"and {one} are two outputs; give one, null the other"
    require(not both, other, getattr(config, other), about)


ALTERNATIVES = (*alternatives(GyroConfig), *alternatives(AccelConfig))
"""Keys that say one thing in different units or words."""
