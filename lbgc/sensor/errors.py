"""Errors whose size is drawn once, and which then follow something that the sensor feels.

A bias follows nothing, a scale factor error and a misalignment follow what is measured, a gyro's
g-sensitivity follows the specific force and its magnetic sensitivity the field; each may grow with
the temperature besides. Of all of them
the output on axis i is

    e_i(t) = u(t) sum_j c_ij x_j(t),    c_ij ~ Normal(0, sigma_ij^2)

with x what is felt, u either 1 or the temperature's rise since power-up, and c drawn once for a
unit's life, a power-up or a recording. What they do together is linear in what is felt, and so is
its inverse, which a calibrated record has.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

Triple = tuple[float, float, float]
Drawn = dict[str, np.ndarray]
"""What was drawn of a triad, by name: each (3,) or (3, 3); of several recordings with one more axis
in front."""
FIRST = (
    *("bias_unit", "matrix", "g_sensitivity", "bias_per_k", "scale_per_k"),
    *("bias_session", "bias_run"),
)
"""What is drawn first, in this order: changing it changes every dataset's bytes. What was added
since is drawn after these of its lifetime, and only of a sensor that has it."""
LIFETIMES = ("unit", "session", "run")
ONE, TRUTH, FORCE, FIELD = "nothing", "truth", "force", "field"
"""What an error may follow: nothing, what its sensor measures, the specific force, or the magnetic
field."""
NONE: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Proportional:
    """One kind of error that is drawn once.

    own, cross : 1 sigma of c_ii and of c_ij, of each axis i. With `own` alone c is diagonal and
    drawn as a vector; with `cross` alone all of a row has that size.
    """

    name: str
    """What datasets call it"""
    cause: str
    """What an error budget calls it"""
    lifetime: str
    follows: str
    own: Triple | None = None
    cross: Triple | None = None
    warms: bool = False
    """Whether it grows with the temperature's rise since power-up"""
    left: tuple[Triple, Triple, Triple] | None = None
    """1 sigma of what is left of each c_ij, where a unit's own are known (lbgc.sensor.unit)"""

    @cached_property
    def sigma(self) -> np.ndarray:
        """1 sigma of c, (3, 3)."""
        if self.left is not None:
            return np.array(self.left)
        if self.cross is None:
            return np.diag(self.own or NONE)
        rows = np.repeat(np.array(self.cross)[:, None], 3, axis=1)
        return rows if self.own is None else np.where(np.eye(3) > 0, np.diag(self.own), rows)

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...] = ()) -> np.ndarray:
        """c, (*S, 3, 3), or its diagonal, (*S, 3), of so many sensors (or recordings)."""
        if self.cross is None:
            return rng.standard_normal((*shape, 3)) * (self.own or NONE)
        rows = rng.standard_normal((*shape, 3, 3)) * np.array(self.cross)[:, None]
        if self.own is None:
            return np.asarray(rows)
        own = rng.standard_normal((*shape, 3)) * self.own
        return np.where(np.eye(3) > 0, own[..., None], rows)

    def draw_each(self, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        """c of several sensors (or recordings), each by its own generator, as `draw` does it."""
        if self.cross is not None or self.name not in FIRST:
            return np.stack([self.draw(rng) for rng in rngs])
        normal = np.empty((len(rngs), 3))
        for rng, row in zip(rngs, normal, strict=True):
            rng.standard_normal(out=row)
        return np.asarray(normal * (self.own or NONE))

    def none(self) -> np.ndarray:
        """c of a sensor that has no such error, (3, 3) or (3,)."""
        return np.zeros(3 if self.cross is None else (3, 3))

    def along(self, felt: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
        """What 1 sigma of each coefficient c_ij makes of what is followed, felt (G, 3, *S): i, the
        axis that prints it, j, and (G, *S)."""
        for i, j, sigma in self.sizes:
            yield i, j, sigma * felt[:, j]

    @cached_property
    def sizes(self) -> list[tuple[int, int, float]]:
        """Which coefficients there are, and 1 sigma of each."""
        return [(int(i), int(j), float(self.sigma[i, j])) for i, j in np.argwhere(self.sigma > 0)]

    def sized(self, which: str, size: Triple) -> "Proportional":
        """This kind of error with its `own` or its `cross` of another size."""
        return replace(self, own=size) if which == "own" else replace(self, cross=size)

    def gone(self) -> "Proportional":
        """This kind of error where a sensor has none, or where it is known and taken out."""
        own, cross = (None if size is None else NONE for size in (self.own, self.cross))
        return replace(self, own=own, cross=cross, left=None)


@dataclass(frozen=True)
class Surroundings:
    """What acts on a triad beside what it measures."""

    force: np.ndarray | None = None
    """(*S, 3, n) or (*S, 3, 1), m/s^2: the specific force that gyros are sensitive to"""
    field: np.ndarray | None = None
    """(*S, 3, n) or (*S, 3, 1), T: the magnetic field in the body's axes"""
    rise_k: float = 0.0
    """Temperature at the end of warming up, less that at power-up"""
    time_s: float = 600.0
    """Time constant of warming up"""
    since_power_up_s: float = 0.0

    def only(self, recording: int) -> "Surroundings":
        """What acts in one of several recordings."""
        force, field = (None if x is None else x[recording] for x in (self.force, self.field))
        return replace(self, force=force, field=field)

    def felt(self, kind: str) -> np.ndarray | None:
        """What errors of a kind follow, (*S, 3, n or 1), where it acts at all."""
        return {FORCE: self.force, FIELD: self.field}.get(kind)

    def rise_at(self, time_s: np.ndarray) -> np.ndarray:
        """The temperature's rise since power-up, K, at times (*S) since the recording's start."""
        since = (self.since_power_up_s + time_s) / self.time_s
        return np.asarray(self.rise_k * -np.expm1(-since))

    def rise(self, n: int, dt: float, start: int = 0) -> np.ndarray:
        """Means over (t_k - dt, t_k] of the temperature's rise since power-up, (n,), K, from so
        many intervals after the recording's start on."""
        since = (self.since_power_up_s + np.arange(start, start + n) * dt) / self.time_s
        u = dt / self.time_s
        return np.asarray(self.rise_k * (1 - np.exp(-since) * -np.expm1(-u) / u))


def printed(
    errors: Iterable[Proportional],
    drawn: Drawn,
    truth: np.ndarray,
    around: Surroundings,
    warmth: np.ndarray | None,
) -> np.ndarray:
    """What a sensor with these errors makes of the truth, (*S, 3, n or 1), both.

    warmth : (n,), K, the temperature's rise since power-up; None where there is none."""
    steady, warm = _sums(errors, drawn)
    signal = (np.eye(3) + steady.pop(TRUTH)) @ truth
    for aside in _aside(steady, around):
        signal = signal + aside
    if warmth is not None:
        gain = warm.pop(TRUTH)
        for aside in _aside(warm, around):
            signal = signal + aside * warmth
        signal = signal + gain @ truth * warmth
    return np.asarray(signal)


def undone(
    errors: Iterable[Proportional],
    drawn: Drawn,
    printed: np.ndarray,
    around: Surroundings,
    warmth: np.ndarray | None,
) -> np.ndarray:
    """The truth, (3, n), of which a sensor with these errors alone has printed this, (3, n)."""
    steady, warm = _sums(errors, drawn)
    none = np.zeros((3, 3))
    gain, by_warmth, left = np.eye(3) + steady.pop(TRUTH, none), warm.pop(TRUTH, none), printed
    for aside in _aside(steady, around):
        left = left - aside
    for aside in _aside(warm, around) if warmth is not None else ():
        left = left - aside * warmth
    if warmth is None or not by_warmth.any():
        return np.linalg.solve(gain, left)
    gains = gain + warmth[:, None, None] * by_warmth
    return np.linalg.solve(gains, left.T[..., None])[..., 0].T


def _aside(sums: Drawn, around: Surroundings) -> Iterator[np.ndarray]:
    """What errors print that follow anything but the truth, (*S, 3, n or 1) each."""
    for kind, c in sums.items():
        x = around.felt(kind)
        if kind == ONE:
            yield c[..., None]
        elif x is not None:
            yield c @ x


def _sums(errors: Iterable[Proportional], drawn: Drawn) -> tuple[Drawn, Drawn]:
    """The sum of what was drawn of errors that follow the same, by what they follow: (*S, 3) of
    what follows nothing, (*S, 3, 3) else; of errors that are steady, and of those that grow with
    the temperature."""
    steady: Drawn = {}
    warm: Drawn = {}
    for error in errors:
        sums, c = warm if error.warms else steady, drawn[error.name]
        if error.cross is None and error.follows != ONE:
            c = c[..., None] * np.eye(3)
        sums[error.follows] = sums[error.follows] + c if error.follows in sums else c
    return steady, warm


def rows(drawn: Drawn, pick: np.ndarray | slice | int) -> Drawn:
    """What was drawn of some of several units (or recordings)."""
    return {name: values[pick] for name, values in drawn.items()}
