"""A sensor that is to be written in another tool's terms, and what is said of it in every file."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lbgc.errors import require, require_positive
from lbgc.frames import AXES as AXES
from lbgc.outputs import LONGEST, shown
from lbgc.sensor import stand_in
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.dither import warnings
from lbgc.sensor.imu import ImuModel, Triad
from lbgc.sensor.stand_in import Figures, Slow

PARTS = ("gyro", "accel")
LONGEST_S = 3600.0
"""Averaging time, s, up to which stand-ins are chosen and compared, unless another is said."""
_LEAST_OCTAVES = 4
_FINE = 4
"""Averaging times an octave at which stand-ins are chosen."""


@dataclass(frozen=True)
class Subject:
    """A sensor, how fast it samples, and up to which averaging time, s, its curve matters. Raises
    InputError where these do not go together."""

    config: ImuConfig
    rate_hz: float
    longest_s: float = LONGEST_S
    doubts: tuple[str, ...] = ()
    """How surely its figures are known, a line each."""

    def __post_init__(self) -> None:
        require_positive("rate_hz", self.rate_hz)
        require_positive("longest_s", self.longest_s)
        least = 2**_LEAST_OCTAVES / self.rate_hz
        require(
            self.longest_s >= least,
            "longest_s",
            self.longest_s,
            f"must be {least:g} s or more, {2**_LEAST_OCTAVES} samples at {self.rate_hz:g} Hz",
        )

    @cached_property
    def model(self) -> ImuModel:
        """The sensor in SI units."""
        return self.config.model(self.rate_hz)

    @property
    def dt(self) -> float:
        """The interval of samples, s."""
        return 1 / self.rate_hz

    @cached_property
    def octaves(self) -> np.ndarray:
        """Averaging times at which files say whether they agree with the sensor, (L,), s."""
        return stand_in.octaves(self.dt, self.longest_s)

    @cached_property
    def fine(self) -> np.ndarray:
        """Averaging times at which stand-ins are chosen, s."""
        return stand_in.octaves(self.dt, self.longest_s, _FINE)

    def triad(self, part: str) -> Triad:
        """The gyros or the accelerometers."""
        found: Triad = getattr(self.model, part)
        return found

    def slow(self, part: str, rounding: bool = True) -> list[Slow]:
        """What is white or slow of each axis. rounding : whether rounding to counts is among it."""
        return stand_in.slow(self.triad(part), self.dt, rounding)

    def walking(self, part: str) -> Figures:
        """White noise and a random walk for all three axes together."""
        return stand_in.walking(self.slow(part), self.fine)

    def walking_each(self, part: str) -> list[Figures]:
        """White noise and a random walk for each axis."""
        every = self.slow(part)
        found = {axis: stand_in.walking([axis], self.fine) for axis in dict.fromkeys(every)}
        return [found[axis] for axis in every]

    def reverting_each(self, part: str, rounding: bool = True) -> list[Figures]:
        """White noise and one Gauss-Markov process for each axis."""
        every = self.slow(part, rounding)
        found = {axis: stand_in.reverting([axis], self.fine)[0] for axis in dict.fromkeys(every)}
        return [found[axis] for axis in every]

    def title(self, tool: str) -> list[str]:
        """Whose figures these are, for which tool, what is assumed, and how surely it is known."""
        lines = [
            f"{shown(self.config.name)}, by lbgc, for {tool}; samples at {self.rate_hz:g} Hz, SI "
            "units; x, y, z are forward, right, down"
        ]
        quiet = [
            f"{part}: stated without noise, as if it had none: its zeros are no measurement"
            for part in PARTS
            if not self.triad(part).allan_variance(self.octaves, self.dt).any()
        ]
        more = (*warnings(self.model, self.dt), *quiet, *self.doubts)
        return lines + [shown(line, 4 * LONGEST) for line in more]

    def agreement(self, part: str, figures: Sequence[Figures] | Figures) -> list[str]:
        """Where the Allan deviation of these figures is within 5% of the sensor's: a sentence for
        each axis, or one where all agree alike. One set of figures is held against the largest of
        the axes' deviations."""
        ours = self.triad(part).allan_variance(self.octaves, self.dt)  # (3, L)
        if isinstance(figures, Figures):
            variance = figures.allan_variance(self.octaves, self.dt)
            return [self._agreement(part, variance, ours.max(axis=0))]
        variances = [own.allan_variance(self.octaves, self.dt) for own in figures]
        pairs = list(zip(variances, ours, strict=True))
        if len({tuple(stand_in.agrees(*pair).tolist()) for pair in pairs}) == 1:
            return [self._agreement(part, *pairs[0])]
        return [
            self._agreement(f"{part} {axis}", *pair) for axis, pair in zip(AXES, pairs, strict=True)
        ]

    def _agreement(self, of: str, variance: np.ndarray, ours: np.ndarray) -> str:
        """The sentence for one Allan variance and the sensor's, (L,) both."""
        said = f"{of}: Allan deviation within 5% of the sensor's"
        first, last = (f"{tau:.9g}" for tau in self.octaves[[0, -1]])
        agreed = stand_in.agrees(variance, ours)
        where = stretches(self.octaves, agreed)
        if where == f"{first} to {last} s" or not ours.any():
            return f"{said} at all octaves of {first} to {last} s"
        held = f"at octaves of {where} and at no other" if where else "at no octave"
        off = ~agreed & (ours > 0)
        if not off.any():
            return f"{said} {held} of {first} to {last} s"
        ratios = np.sqrt(variance[off] / ours[off])
        beyond = f"elsewhere {ratios.min():.2g} to {ratios.max():.2g} times that"
        return f"{said} {held} of {first} to {last} s; {beyond}"


def stretches(tau: np.ndarray, held: np.ndarray) -> str:
    """Runs of averaging times (L,), s, at which something holds, bool (L,), in words: `0.01 to
    1.28 s and 5.12 s`; empty where it never holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(int), [0]])))
    runs = [
        f"{tau[first]:.9g} s" if first == last - 1 else f"{tau[first]:.9g} to {tau[last - 1]:.9g} s"
        for first, last in edges.reshape(-1, 2)
    ]
    return " and ".join(runs)


def worst(subject: Subject, part: str) -> str:
    """The sentence on which axis one figure for all three is of."""
    every = [axis.N for axis in subject.slow(part)]
    alike = np.ptp(every) <= 1e-9 * max(every)
    whose = "all axes have it alike" if alike else f"that is the {AXES[int(np.argmax(every))]} one"
    return (
        f"{part}: one figure for three axes: the worst axis's is meant, at each averaging time; of "
        f"white noise {whose}"
    )


def number(value: float) -> str:
    """A figure as every one of these tools reads it as a number: with a point and an exponent."""
    return f"{value:.8e}"


def diagonal(values: Sequence[float]) -> list[list[float]]:
    """A 3 x 3 matrix with these on its diagonal."""
    return [[float(v) if i == j else 0.0 for j in range(3)] for i, v in enumerate(values)]
