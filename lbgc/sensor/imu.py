"""The IMU error model: what a sensor prints when the truth is this (the paper's eqs. 1-2).

    measured = counts((I + M) truth + b_unit + b_session + b_run + noise + tone)

M holds scale factor errors (diagonal) and misalignments (off it). What stays for how long is the
point: `unit` errors belong to the serial number, `session` to a power-up, `run` to one recording;
the noise terms evolve within it. Rounding to counts, clipping to the range and losing samples are
not linear and stand outside the exact law of block means.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from lbgc.sensor import errors, gaussian, noise
from lbgc.sensor.counting import Counts
from lbgc.sensor.deterministic import STARTED, InRun, Started
from lbgc.sensor.errors import FIELD, ONE, Drawn, Proportional, Surroundings, Triple
from lbgc.sensor.known import Known
from lbgc.sensor.low_pass import LowPass

ALONE = Surroundings()
"""Nothing acts on a triad, and it has warmed up."""
_SHORT = 4096
"""Up to so many values of an axis, all three axes of one law are drawn at once."""


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
    """Three like sensors on the body's axes, in SI units: what errs in them, and their range."""

    terms: tuple[gaussian.Gaussians, ...]
    """The Gaussian terms that evolve within a recording, of each axis, as they come out of the
    output filter."""
    started: tuple[tuple[Started, ...], ...]
    """What evolves from a number that is drawn at a recording's start, of each axis, likewise."""
    drawn: tuple[Proportional, ...]
    """What is drawn once, in the order of its drawing."""
    low_pass: tuple[LowPass, ...] | None
    """The output filter of each axis."""
    counts: Counts | None
    range: float | None
    keys: dict[str, str] = field(compare=False)
    """The configured names of the count (by how it is counted) and the range, for messages."""

    def terms_of_means(self, dt: float) -> tuple[gaussian.Gaussians, ...]:
        """Gaussian terms of each axis's block means of samples at dt: rounding to counts is a term
        like others."""
        return tuple((*own, *self.rounding(dt)) for own in self.terms)

    def rounding(self, dt: float) -> gaussian.Gaussians:
        """What counting adds to samples at dt, where their noise shakes them across counts."""
        return () if self.counts is None else (self.counts.noise(dt),)

    def in_run(self, i: int, dt: float) -> tuple[InRun, ...]:
        """All that evolves within a recording of an axis's samples at dt, rounding included."""
        return (*self.terms[i], *self.rounding(dt), *self.started[i])

    @cached_property
    def N(self) -> np.ndarray:
        """The root of the density of all that is white, of each axis: (3,), SI."""
        return np.array([np.sqrt(sum(term.density for term in own)) for own in self.terms])

    def slow_variance(self, duration_s: float) -> np.ndarray:
        """Variance of what evolves within a recording, all but white noise, in the mean over so
        many seconds from its start, (3,)."""
        each = (
            [t.covariance_of_means(1, duration_s)[0, 0] for t in (*own, *started)]
            for own, started in zip(self.terms, self.started, strict=True)
        )
        return np.asarray(np.maximum([sum(own) for own in each] - self.N**2 / duration_s, 0.0))

    def allan_variance(self, tau: np.ndarray, dt: float) -> np.ndarray:
        """The model's own Allan variance, tau (*S) in s -> (3, *S): every in-run term, the tone
        and rounding; not what warming up adds."""
        every = [noise.allan_variance(self.in_run(i, dt), tau) for i in (0, 1, 2)]
        return np.stack(every)

    def lasting(self, *lifetimes: str) -> tuple[Proportional, ...]:
        """The errors that are drawn once for these lifetimes."""
        return tuple(error for error in self.drawn if error.lifetime in lifetimes)

    def without(self, *lifetimes: str) -> "Triad":
        """The triad when everything that lasts that long is known and taken out."""
        drawn = (e.gone() if e.lifetime in lifetimes else e for e in self.drawn)
        return replace(self, drawn=tuple(drawn))

    def with_bias(self, **sizes: Triple) -> "Triad":
        """The triad with biases of other sizes (1 sigma), by lifetime."""
        drawn = (
            replace(e, own=sizes[e.lifetime])
            if e.follows == ONE and not e.warms and e.lifetime in sizes
            else e
            for e in self.drawn
        )
        return replace(self, drawn=tuple(drawn))

    def variance(
        self, follows: str, warms: bool = False, lifetimes: Sequence[str] = errors.LIFETIMES
    ) -> np.ndarray:
        """Variance of all that is drawn to follow something, (3, 3): see lbgc.sensor.errors."""
        own = (e for e in self.lasting(*lifetimes) if (e.follows, e.warms) == (follows, warms))
        return sum((e.sigma**2 for e in own), np.zeros((3, 3)))

    def bias(self, *lifetimes: str) -> np.ndarray:
        """1 sigma of the bias that lasts that long (of all of it, where none is named), (3,)."""
        return np.sqrt(np.diag(self.variance(ONE, lifetimes=lifetimes or errors.LIFETIMES)))

    def draw_unit(self, rng: np.random.Generator) -> Drawn:
        """A serial number's own errors."""
        return {error.name: error.draw(rng) for error in self.lasting("unit")}

    def draw_session(self, rng: np.random.Generator) -> Drawn:
        """A power-up's own errors."""
        return {error.name: error.draw(rng) for error in self.lasting("session")}

    def draw_run(self, rng: gaussian.Generators, lasting: Drawn) -> Drawn:
        """What is drawn before a recording starts, joined to what its unit and session fixed; of
        several recordings all of that has one more axis in front. rng : one for all of them, or one
        each."""
        own = self.lasting("run")
        if isinstance(rng, np.random.Generator):
            shape = lasting["bias_session"].shape[:-1]
            found = {error.name: error.draw(rng, shape) for error in own}
            uniform = np.stack([rng.random((*shape, 3)) for _ in STARTED])
        else:
            found = {error.name: error.draw_each(rng) for error in own}
            uniform = np.empty((len(STARTED), len(rng), 3))
            for one, *rows in zip(rng, *uniform, strict=True):
                for row in rows:
                    one.random(out=row)
        start = {k.drawn_as: k.of_uniform(own) for k, own in zip(STARTED, uniform, strict=True)}
        return {**lasting, **found, **start}

    def none_drawn(self) -> Drawn:
        """What is drawn of a unit and a session that have no errors of their own."""
        return {error.name: error.none() for error in self.lasting("unit", "session")}

    def sample_noise(
        self, rng: np.random.Generator, count: int, n: int, interval: float
    ) -> np.ndarray:
        """The Gaussian in-run noise alone, of interval means: float32 (count, n, 3)."""
        return gaussian.sample_axes(self.terms, rng, count, n, interval)

    def output_scale(self, dt: float) -> float | None:
        """SI units of a rate per stored count; None where the output is not counted."""
        return None if self.counts is None else self.counts.scale(dt)

    def measure(
        self,
        rng: np.random.Generator,
        truth: np.ndarray,
        drawn: Drawn,
        n: int,
        dt: float,
        around: Surroundings = ALONE,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The n samples the sensor prints, (3, n): int32 counts of `output_scale`, or float32
        where there are none; and whether any axis was at its range, bool (n,).

        truth : (3, n), or (3, 1) where it is constant; means over (t_k - dt, t_k].
        """
        signal = self._noise(self.terms, rng, drawn, n, dt)
        signal += self._response(truth, drawn, n, dt, around).astype(np.float32)
        saturated = np.broadcast_to(False, n)
        if self.range is not None and max(signal.max(), -signal.min()) > self.range:
            saturated = (np.abs(signal) > self.range).any(axis=0)
            np.clip(signal, -self.range, self.range, out=signal)
        return (signal if self.counts is None else self.counts.counted(signal, dt)), saturated

    def measure_means(
        self,
        rng: gaussian.Generators,
        truth: np.ndarray,
        drawn: Drawn,
        n: int,
        dt: float,
        block: int,
        around: Surroundings = ALONE,
        start: int = 0,
    ) -> np.ndarray:
        """n means over `block` samples each, float32 (3, n), with the law of averaging `measure`.

        truth : (3, 1) where it is constant; else the samples' own, (3, n block), or where
        `ImuModel.averages_motion` their means, (3, n). What acts around it, likewise. Of several
        recordings at once each of these, and what was drawn, has one more axis in front:
        float32 (R, 3, n); rng : one for all of them, or one each. start : how many blocks lie
        between the recording's start and the first; noise that wanders has come so far.

        Rounding enters as the white noise that it is while the samples' noise exceeds half a count
        (`lbgc.sensor.dither` refuses where it does not, and where the range would clip); carried
        counts as angle quantisation of a twelfth of their square.
        """
        h = dt * block
        means = self._noise(self.terms_of_means(dt), rng, drawn, n, h, start)
        if truth.shape[-1] in (1, n):
            response = self._response(truth, drawn, n, h, around, start)
        else:
            fine = self._response(truth, drawn, n * block, dt, around, start * block)
            response = fine.reshape(*fine.shape[:-1], n, block).mean(axis=-1)
        means += response.astype(np.float32)
        return means

    def _noise(
        self,
        terms: tuple[gaussian.Gaussians, ...],
        rng: gaussian.Generators,
        drawn: Drawn,
        n: int,
        dt: float,
        start: int = 0,
    ) -> np.ndarray:
        """Noise by these terms of each axis, tone and ramp: float32 (*R, 3, n). Its means over dt
        have the law of its samples' averages."""
        recordings = drawn["bias_run"].shape[:-1]
        signal = np.empty((*recordings, 3, n), np.float32)
        together = n <= _SHORT and len(set(terms)) == 1
        if together:  # fewer and larger products
            gaussian.sample(terms[0], rng, signal.shape, dt, signal, start)
        for axis, own in enumerate(terms):
            one = signal[..., axis, :]
            if not together:
                gaussian.sample(own, rng, one.shape, dt, one, start)
            for term in self.started[axis]:
                one += term.at(drawn[term.drawn_as][..., axis], n, dt, start, np.float32)
        return signal

    def _response(
        self,
        truth: np.ndarray,
        drawn: Drawn,
        n: int,
        dt: float,
        around: Surroundings,
        start: int = 0,
    ) -> np.ndarray:
        """What the truth alone would give, (*R, 3, n) or (*R, 3, 1): the drawn errors, and the
        output filter on what moves."""
        warmth = around.rise(n, dt, start) if around.rise_k != 0 else None
        signal = errors.printed(self.drawn, drawn, truth, around, warmth)
        if truth.shape[-1] > 1 and self.low_pass is not None:
            for axis, low_pass in enumerate(self.low_pass):
                signal[..., axis, :] = low_pass.filtered(signal[..., axis, :], dt)
        return signal


@dataclass(frozen=True)
class ImuModel:
    """What is known of a sensor before it is read: the laws that its errors are drawn from."""

    gyro: Triad
    accel: Triad
    dt: float
    """s: interval of the sensor's own samples, by which counts are read"""
    warming: Surroundings = field(default_factory=Surroundings)
    field_ned: Triple = errors.NONE
    """The magnetic field around it, north, east and down, T"""
    assumed: str = ""
    """What of it is assumed and was never measured, for whoever reads figures that hang on it."""
    known: Known | None = None
    """What is known of the unit, its means taken off; `gyro` and `accel` then have what is left"""

    @property
    def is_noiseless(self) -> bool:
        """Whether it is stated without noise, tone or counts, as `imu=ideal` is."""
        return not any(
            any(t.terms) or any(t.started) or t.counts is not None for t in (self.gyro, self.accel)
        )

    @property
    def feels_field(self) -> bool:
        """Whether a magnetic field changes what it prints."""
        return any(self.field_ned) and bool(self.gyro.variance(FIELD).any())

    @property
    def averages_motion(self) -> bool:
        """Whether means of what it prints follow from means of the motion: no output filter, and
        nothing that follows what moves and changes with the temperature."""
        triads = (self.gyro, self.accel)
        warms = self.warming.rise_k != 0 and any(
            error.warms and error.follows != ONE and error.sigma.any()
            for triad in triads
            for error in triad.drawn
        )
        return not warms and all(t.low_pass is None for t in triads)

    def without(self, *lifetimes: str) -> "ImuModel":
        """The sensor when everything that lasts that long is known and taken out."""
        triads = (self.gyro.without(*lifetimes), self.accel.without(*lifetimes))
        return replace(self, gyro=triads[0], accel=triads[1])
