"""The IMU error model: what a sensor prints when the truth is this (the paper's eqs. 1-2).

    measured = counts((I + M) truth + b_unit + b_session + b_run + noise + tone)

M holds scale factor errors (diagonal) and misalignments (off it). What stays for how long is the
point: `unit` errors belong to the serial number, `session` to a power-up, `run` to one recording;
the noise terms evolve within it. Rounding to counts, clipping to the range and losing samples are
not linear and stand outside the exact law of block means.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np

from lbgc.sensor import gaussian, noise
from lbgc.sensor.low_pass import low_pass

Triple = tuple[float, float, float]
_SHORT = 4096
"""Up to so many values of an axis, all three axes of one law are drawn at once."""


@dataclass(frozen=True)
class UnitErrors:
    """What was drawn for a serial number."""

    bias_unit: np.ndarray  # (3,)
    matrix: np.ndarray  # (3, 3), M
    g_sensitivity: np.ndarray  # (3, 3), output per specific force: zero for accelerometers
    bias_per_k: np.ndarray  # (3,)
    scale_per_k: np.ndarray  # (3,)

    @classmethod
    def none(cls) -> "UnitErrors":
        return cls(np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3))

    def rows(self, pick: np.ndarray | slice | int) -> Self:
        """Those of several units' (or recordings') errors that `pick` selects."""
        return type(self)(**{name: values[pick] for name, values in vars(self).items()})


@dataclass(frozen=True)
class TriadErrors(UnitErrors):
    """What was drawn for a triad and a recording: nothing about a recording is a mystery. Of
    several recordings, each array has one more axis in front."""

    bias_session: np.ndarray  # (3,)
    bias_run: np.ndarray  # (3,)
    tone_phase: np.ndarray  # (3,), rad
    ramp_sign: np.ndarray  # (3,), +-1

    @property
    def bias(self) -> np.ndarray:
        return self.bias_unit + self.bias_session + self.bias_run


@dataclass(frozen=True)
class Disturbance:
    """What acts on a triad beside what it measures."""

    force: np.ndarray | None = None
    """(3, n) or (3, 1), m/s^2: the specific force that gyros are sensitive to"""
    rise_k: float = 0.0
    """Temperature at the end of warming up, less that at power-up"""
    time_s: float = 600.0
    """Time constant of warming up"""
    since_power_up_s: float = 0.0

    def rise(self, n: int, dt: float) -> np.ndarray:
        """Means over (t_k - dt, t_k] of the temperature's rise since power-up, (n,), K."""
        start = (self.since_power_up_s + np.arange(n) * dt) / self.time_s
        u = dt / self.time_s
        return self.rise_k * (1 - np.exp(-start) * -np.expm1(-u) / u)


@dataclass(frozen=True)
class Timing:
    """What happens to samples between the sensor and the file."""

    jitter_s: float = 0.0
    """1 sigma of a timestamp about the true time"""
    dropped_share: float = 0.0
    """Share of the samples that are lost, independently of each other"""

    @property
    def is_exact(self) -> bool:
        """Every sample comes, and is printed as of its own time."""
        return self.jitter_s == 0 and self.dropped_share == 0

    def draw(self, rng: np.random.Generator, n: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """What is printed as each sample's time less the true time, (n,) in s, and which samples
        are lost, bool (n,). Samples are printed in order, so that timestamps never decrease; the
        first one always arrives."""
        time = np.arange(1, n + 1) * dt
        printed = time
        if self.jitter_s > 0:
            printed = np.maximum.accumulate(time + self.jitter_s * rng.standard_normal(n))
        lost = rng.random(n) < self.dropped_share
        lost[0] = False
        return printed - time, lost

    @staticmethod
    def held(printed: np.ndarray, lost: np.ndarray) -> np.ndarray:
        """A lost sample repeats the last one that arrived, as drivers do. printed : (3, n)."""
        return printed[:, np.maximum.accumulate(np.where(lost, 0, np.arange(len(lost))))]


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
    Q: Triple
    R: Triple
    gauss_markov: Triple
    gauss_markov_time: Triple
    lines: tuple[tuple[Triple, Triple, Triple, Triple], ...]
    """Each line's rms, centre (Hz) and width (Hz)."""
    bandwidth_hz: Triple | None
    damping: Triple
    bias_unit: Triple
    bias_session: Triple
    bias_run: Triple
    scale_unit: Triple
    misalignment_unit: Triple
    g_sensitivity: Triple
    bias_per_k: Triple
    scale_per_k: Triple
    tone_hz: Triple
    tone: Triple
    lsb: float | None
    carried_lsb: float | None
    """Count of the integrated output (rad, m/s)."""
    range: float | None
    keys: dict[str, str] = field(compare=False)
    """The configured names of `lsb`, `carried_lsb` and `range`, for messages."""

    @cached_property
    def terms(self) -> tuple[gaussian.Gaussians, ...]:
        """The in-run Gaussian terms of each axis; a coefficient of zero is no term."""
        return tuple(self._terms_of(axis) for axis in (0, 1, 2))

    def terms_of_means(self, dt: float) -> tuple[gaussian.Gaussians, ...]:
        """Gaussian terms of each axis's block means of samples at dt: rounding to counts is a term
        like others."""
        if self.carried_lsb is not None:
            rounding = (noise.AngleQuantisation(self.carried_lsb / np.sqrt(12)),)
            return tuple((*own, *rounding) for own in self.terms)
        if self.lsb is None:
            return self.terms
        return tuple((*own, noise.White(self.lsb * np.sqrt(dt / 12))) for own in self.terms)

    def _terms_of(self, i: int) -> gaussian.Gaussians:
        white: gaussian.GaussianTerm = noise.White(self.N[i])
        if self.bandwidth_hz is not None:
            white = noise.BandLimited(self.N[i], self.bandwidth_hz[i], self.damping[i])
        every = (
            (self.N[i], white),
            (self.B[i], noise.Flicker(self.B[i], *self.flicker_corners)),
            (self.K[i], noise.RandomWalk(self.K[i])),
            (self.Q[i], noise.AngleQuantisation(self.Q[i])),
            (
                self.gauss_markov[i],
                noise.GaussMarkov(self.gauss_markov[i], self.gauss_markov_time[i]),
            ),
            *(
                (size[i], noise.Line(size[i], f0[i], width[i], int(poles[i])))
                for size, f0, width, poles in self.lines
            ),
        )
        return tuple(term for coefficient, term in every if coefficient > 0)

    def tone_of(self, i: int) -> noise.Sinusoid:
        """An axis's tone as it comes out, behind the filter if there is one."""
        amplitude, f = self.tone[i], self.tone_hz[i]
        if self.bandwidth_hz is not None:
            low_pass = noise.BandLimited(1.0, self.bandwidth_hz[i], self.damping[i])
            amplitude *= np.sqrt(low_pass.gain_squared(f))
        return noise.Sinusoid(float(amplitude), f)

    def allan_variance(self, tau: np.ndarray, dt: float) -> np.ndarray:
        """The model's own Allan variance, tau (*S) in s -> (3, *S): every in-run term, the tone
        and rounding; not what warming up adds."""
        rounding: noise.White | noise.AngleQuantisation
        rounding = noise.White(0.0 if self.lsb is None else self.lsb * np.sqrt(dt / 12))
        if self.carried_lsb is not None:
            rounding = noise.AngleQuantisation(self.carried_lsb / np.sqrt(12))
        return np.stack(
            [
                noise.allan_variance(
                    (*terms, rounding, noise.Ramp(self.R[i]), self.tone_of(i)), tau
                )
                for i, terms in enumerate(self.terms)
            ]
        )

    def draw_unit(self, rng: np.random.Generator) -> UnitErrors:
        """A serial number's own errors."""
        bias = rng.standard_normal(3) * self.bias_unit
        off_diagonal = rng.standard_normal((3, 3)) * np.array(self.misalignment_unit)[:, None]
        scale = rng.standard_normal(3) * self.scale_unit
        g_sensitivity = rng.standard_normal((3, 3)) * np.array(self.g_sensitivity)[:, None]
        matrix = np.where(np.eye(3, dtype=bool), np.diag(scale), off_diagonal)
        bias_per_k = rng.standard_normal(3) * self.bias_per_k
        scale_per_k = rng.standard_normal(3) * self.scale_per_k
        return UnitErrors(bias, matrix, g_sensitivity, bias_per_k, scale_per_k)

    def draw_session(self, rng: np.random.Generator) -> np.ndarray:
        """A power-up's bias, (3,)."""
        return rng.standard_normal(3) * self.bias_session

    def draw_run(
        self, rng: gaussian.Source, of_unit: UnitErrors, of_session: np.ndarray
    ) -> TriadErrors:
        """What is drawn before a recording starts, joined to what its unit and session fixed; of
        several recordings, each has its own generator and all else one more axis in front."""
        rngs = [rng] if isinstance(rng, np.random.Generator) else rng
        normal, phase, sign = np.empty((3, len(rngs), 3))
        for own, bias, *others in zip(rngs, normal, phase, sign, strict=True):
            own.standard_normal(out=bias)
            for uniform in others:
                own.random(out=uniform)
        shape = of_session.shape
        return TriadErrors(
            **vars(of_unit),
            bias_session=of_session,
            bias_run=normal.reshape(shape) * self.bias_run,
            tone_phase=2 * np.pi * phase.reshape(shape),
            ramp_sign=np.where(sign.reshape(shape) < 0.5, -1.0, 1.0),
        )

    def sample_noise(
        self, rng: np.random.Generator, count: int, n: int, interval: float
    ) -> np.ndarray:
        """The Gaussian in-run noise alone, of interval means: float32 (count, n, 3)."""
        return gaussian.sample_axes(self.terms, rng, count, n, interval)

    def output_scale(self, dt: float) -> float | None:
        """SI per stored count of a rate: the count, or the carried one over the interval."""
        return self.lsb if self.carried_lsb is None else self.carried_lsb / dt

    def measure(
        self,
        rng: np.random.Generator,
        truth: np.ndarray,
        errors: TriadErrors,
        n: int,
        dt: float,
        disturbance: "Disturbance | None" = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The n samples the sensor prints, (3, n): int32 counts of `output_scale`, or float32
        where there are none; and whether any axis was at its range, bool (n,).

        truth : (3, n), or (3, 1) where it is constant; means over (t_k - dt, t_k].
        """
        signal = self._noise(self.terms, rng, errors, n, dt)
        signal += self._response(truth, errors, n, dt, disturbance).astype(np.float32)
        saturated = np.broadcast_to(False, n)
        if self.range is not None and max(signal.max(), -signal.min()) > self.range:
            saturated = (np.abs(signal) > self.range).any(axis=0)
            np.clip(signal, -self.range, self.range, out=signal)
        if self.carried_lsb is not None:
            total = np.cumsum(signal, axis=1, dtype=np.float64) * (dt / self.carried_lsb)
            counts = np.diff(np.rint(total), axis=1, prepend=0.0)
            return counts.astype(np.int32), saturated
        if self.lsb is None:
            return signal, saturated
        np.divide(signal, np.float32(self.lsb), out=signal)
        counts = signal.view(np.int32)  # in the same memory, for fresh memory is not free
        return np.rint(signal, out=counts, casting="unsafe"), saturated

    def measure_means(
        self,
        rng: gaussian.Source,
        truth: np.ndarray,
        errors: TriadErrors,
        n: int,
        dt: float,
        block: int,
        disturbance: "Disturbance | None" = None,
    ) -> np.ndarray:
        """n means over `block` samples each, float32 (3, n), with the law of averaging `measure`.

        truth : (3, 1) where it is constant; else the samples' own, (3, n block), or where
        `ImuModel.averages_motion` their means, (3, n). The disturbance's force, likewise. Of
        several recordings at once each of these, and what is in `errors`, has one more axis in
        front, and each recording its own generator: float32 (R, 3, n).

        Rounding enters as the white noise that it is while the samples' noise exceeds half a count
        (`lbgc.sensor.dither` refuses where it does not, and where the range would clip); carried
        counts as angle quantisation of a twelfth of their square.
        """
        means = self._noise(self.terms_of_means(dt), rng, errors, n, dt * block)
        if truth.shape[-1] in (1, n):
            response = self._response(truth, errors, n, dt * block, disturbance)
        else:
            fine = self._response(truth, errors, n * block, dt, disturbance)
            response = fine.reshape(*fine.shape[:-1], n, block).mean(axis=-1)
        means += response.astype(np.float32)
        return means

    def _noise(
        self,
        terms: tuple[gaussian.Gaussians, ...],
        rng: gaussian.Source,
        errors: TriadErrors,
        n: int,
        dt: float,
    ) -> np.ndarray:
        """Noise by these terms of each axis, tone and ramp: float32 (*R, 3, n). Its means over dt
        have the law of its samples' averages."""
        recordings = errors.bias_run.shape[:-1]
        signal = np.empty((*recordings, 3, n), np.float32)
        together = n <= _SHORT and len(set(terms)) == 1
        if together:  # fewer and larger products
            gaussian.sample(terms[0], rng, signal.shape, dt, out=signal)
        for axis, own in enumerate(terms):
            drawn = signal[..., axis, :]
            if not together:
                gaussian.sample(own, rng, drawn.shape, dt, out=drawn)
            if self.tone[axis] > 0:
                phase = errors.tone_phase[..., axis]
                drawn += self.tone_of(axis).at_phase(phase, n, dt, np.float32)
            if self.R[axis] > 0:
                drawn += noise.Ramp(self.R[axis]).with_sign(errors.ramp_sign[..., axis], n, dt)
        return signal

    def _response(
        self,
        truth: np.ndarray,
        errors: TriadErrors,
        n: int,
        dt: float,
        disturbance: "Disturbance | None",
    ) -> np.ndarray:
        """What the truth alone would give, (*R, 3, n) or (*R, 3, 1): scale, misalignment, biases,
        g-sensitivity, warming up, and the output filter on what moves."""
        signal = (np.eye(3) + errors.matrix) @ truth + errors.bias[..., None]
        if disturbance is not None and disturbance.force is not None:
            signal = signal + errors.g_sensitivity @ disturbance.force
        if disturbance is not None and disturbance.rise_k != 0:
            warmth = disturbance.rise(n, dt)
            signal = signal + errors.bias_per_k[..., None] * warmth
            signal = signal + errors.scale_per_k[..., None] * truth * warmth
        if truth.shape[-1] > 1 and self.bandwidth_hz is not None:
            for axis, shape in enumerate(zip(self.bandwidth_hz, self.damping, strict=True)):
                signal[..., axis, :] = low_pass(signal[..., axis, :], *shape, dt)
        return signal


@dataclass(frozen=True)
class ImuModel:
    """What is known of a sensor before it is read: the laws that its errors are drawn from."""

    gyro: Triad
    accel: Triad
    dt: float
    """s: interval of the sensor's own samples, by which counts are read"""
    warming: Disturbance = field(default_factory=Disturbance)
    assumed: str = ""
    """What of it is assumed and was never measured, for whoever reads figures that hang on it."""

    @property
    def is_noiseless(self) -> bool:
        """Whether it is stated without noise, tone or counts, as `imu=ideal` is."""
        return not any(
            any(t.terms) or any(t.tone) or t.lsb is not None or t.carried_lsb is not None
            for t in (self.gyro, self.accel)
        )

    @property
    def averages_motion(self) -> bool:
        """Whether means of what it prints follow from means of the motion: no output filter, and
        no scale factor that changes in a recording."""
        triads = (self.gyro, self.accel)
        warms = self.warming.rise_k != 0 and any(any(t.scale_per_k) for t in triads)
        return not warms and all(t.bandwidth_hz is None for t in triads)
