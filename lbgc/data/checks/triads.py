"""Whether a log's description has gyros and accelerometers in one frame, by the two measured
vectors together.

At rest Earth's rate along the measured vertical is -Omega sin(latitude) at any heading, which shows
a wrong sign or swapped axes of one triad relative to the other. At rest a frame that is mirrored
for both triads cannot be told from a right one. Where the base leans or sways, slow motion obeys
df/dt = -w x f, which shows that, too.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations, product

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.checks.plausible import FIVE_SIGMA, PER_HOUR, Resting, down_of, residual
from lbgc.data.logconfig import LogConfig
from lbgc.data.readers.axes import matrix_of, spelled
from lbgc.data.readers.blocks import ROWS, blocks
from lbgc.data.record import Record
from lbgc.earth import EARTH_RATE
from lbgc.units import DEG

_EVIDENCE = 25.0
"""Chi-square by which another frame must be better, 5 sigma: twice a log-likelihood ratio."""
_THREE_SIGMA = 14.2
"""The chi-square with three degrees of freedom that is exceeded as seldom as 3 sigma, from which on
there is a note."""
_RUINOUS = 0.5
"""A bias, as a share of Earth's horizontal rate, that turns north by 30 degrees."""
_NOTED = 0.1
"""A bias, as a share of Earth's horizontal rate, that turns north by 6 degrees."""
_TEN_TIMES = 10.0
"""Factor by which the misfit must be smaller in a frame that explains the means."""
_FORWARD_DEG = 10.0
"""Angle between forward axis and vertical below which there is no heading, degrees."""
_BLOCKS_S = (2.0, 5.0)
"""Lengths of the blocks whose means show motion, s. They are longer than the periods of sway, in
which the acceleration of a lever arm may exceed the change of gravity's direction."""
_FEWEST_BLOCKS = 48
"""Blocks of a recording, at least."""
_EXPLAINED = 0.2
"""Share of the vertical's change that the gyros must explain for motion to be used."""

_ONE = np.eye(3)
_LEFT_UP = np.diag([1.0, -1.0, -1.0])
_RIGHT_FORWARD_UP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class Frame:
    """A possible frame of the log's triads: the matrices from the axes of the description to the
    body."""

    gyro: np.ndarray
    """(3, 3), a signed permutation, for the gyros"""
    accel: np.ndarray
    """(3, 3), a signed permutation, for the accelerometers"""
    south: bool = False
    """Whether the latitude has the wrong sign"""
    words: str = ""
    """What the frame is, in words"""

    def option(self, config: LogConfig) -> str:
        """The options that a user types for this frame, and in brackets what it is."""
        gyro = self.gyro @ matrix_of(config.axes)
        accel = self.accel @ matrix_of(config.axes_of_accel)
        parts = []
        if not np.array_equal(self.gyro, _ONE):
            parts.append(f"log.axes={spelled(gyro)}")
        if not np.array_equal(gyro, accel) or config.accel_axes is not None:
            parts.append(f"log.accel_axes={spelled(accel)}")
        if self.south:
            parts = [f"log.latitude={-(config.latitude or 0.0):g}"]
        return " ".join(parts) + (f" ({self.words})" if self.words else "")


def _signed_permutations() -> list[np.ndarray]:
    """All 48 signed permutation matrices, (3, 3)."""
    signs = [np.diag(s) for s in product((1.0, -1.0), repeat=3)]
    return [sign @ np.eye(3)[list(p)] for p in permutations(range(3)) for sign in signs]


_EVERY = _signed_permutations()
_RIGHT_HANDED = [m for m in _EVERY if np.linalg.det(m) > 0]
_NAMED = (
    Frame(_ONE, -_ONE, words="accelerometers that print +g down"),
    Frame(_LEFT_UP, _ONE, words="gyros forward-left-up beside these accelerometers"),
    Frame(_ONE, _ONE, south=True, words="the southern or northern half of Earth"),
    Frame(_ONE, _LEFT_UP, words="accelerometers forward-left-up beside these gyros"),
    Frame(_RIGHT_FORWARD_UP, _ONE, words="gyros right-forward-up beside these accelerometers"),
    Frame(_ONE, _RIGHT_FORWARD_UP, words="accelerometers right-forward-up beside these gyros"),
    Frame(_LEFT_UP, -_LEFT_UP, words="forward-left-up, accelerometers that print -g up"),
    Frame(np.diag([1.0, -1.0, 1.0]), np.diag([1.0, -1.0, 1.0]), words="y points the other way"),
    Frame(np.diag([-1.0, 1.0, 1.0]), np.diag([-1.0, 1.0, 1.0]), words="x points the other way"),
    Frame(-_ONE, _ONE, words="the gyros' signs reversed"),
)
_SWAPS = tuple(
    Frame(m, _ONE, words="the gyros' columns")
    for m in sorted(_EVERY, key=lambda m: ((m < 0).sum(), (np.diag(m) == 0).sum()))
)
"""Frames with permuted and reversed gyro columns, those without changed signs first."""


@dataclass(frozen=True)
class Motion:
    """The slow motion of one recording, by block means in the axes of the description: rotations
    from the gyros, and changes of the measured force."""

    turned: np.ndarray
    """(K, 3), rad, rotations from one block's middle to the next one's"""
    force: np.ndarray
    """(K, 3), m/s^2, mean force of the two blocks"""
    change: np.ndarray
    """(K, 3), m/s^2, change of the force from one block to the next"""

    def left(self, frame: Frame) -> np.ndarray:
        """(K,), m^2/s^4, squares of the changes of force that the gyros do not explain in this
        frame."""
        turned, force, change = (
            self.turned @ frame.gyro.T,
            self.force @ frame.accel.T,
            self.change @ frame.accel.T,
        )
        return np.asarray(np.sum((change + np.cross(turned, force)) ** 2, axis=1))

    def explained(self, frame: Frame) -> float:
        """The share of the changes that the gyros explain in this frame: 1 is all, 0 none."""
        every = float(np.sum(self.change**2))
        return 1 - float(self.left(frame).sum()) / every if every > 0 else 0.0

    def speaks(self, better: Frame, worse: Frame) -> bool:
        """Whether the motion prefers one frame to the other by more than 5 sigma, and fits it.

        The statistic is taken from the quarter of the steps with the largest motion by the gyros:
        the difference of the two misfits over their sum. It is within +-1 for each step, so that no
        knock or bad stretch outweighs the rest.
        """
        if self.explained(better) < _EXPLAINED or self.explained(worse) > 0:
            return False
        asked = np.sum(np.cross(self.turned, self.force) ** 2, axis=1)
        moves = asked >= np.quantile(asked, 0.75)
        a, b = self.left(better)[moves], self.left(worse)[moves]
        total = a + b
        share = np.divide(b - a, total, out=np.zeros_like(total), where=total > 0)
        error = share.std(ddof=1) / np.sqrt(len(share) / 2)  # neighbours share a block
        return bool(share.mean() > max(5 * error, 0.2))


def motions(record: Record) -> list[Motion]:
    """The recording's motion, by blocks of each length for which it is long enough."""
    found = []
    for length in _BLOCKS_S:
        size = round(length * record.rate_hz)
        count = len(record.gyro) // size if size else 0
        if count < _FEWEST_BLOCKS:
            continue
        force = _means(record.accel, size, count)
        turned = np.diff(_mean_angles(record, size, count), axis=0)
        found.append(Motion(turned, (force[1:] + force[:-1]) / 2, np.diff(force, axis=0)))
    return found


def _mean_angles(record: Record, size: int, count: int) -> np.ndarray:
    """Means of the angles by which the gyros turned since the start, less those of a steady turn,
    over `count` blocks of `size` samples: (count, 3), rad."""
    mean, at, found = record.gyro.mean(axis=0), np.zeros(3), []
    for own in blocks(count, max(1, ROWS // size)):
        rate = record.gyro[own.start * size : own.stop * size] - mean
        rate[0] += at
        np.cumsum(rate, axis=0, out=rate)
        at = rate[-1].copy()
        found.append(_means(rate / record.rate_hz, size, own.stop - own.start))
    return np.concatenate(found)


def _means(values: np.ndarray, size: int, count: int) -> np.ndarray:
    """Means of values (T, 3) over `count` blocks of `size` samples, (count, 3)."""
    return np.asarray(values[: size * count].reshape(count, size, 3).mean(axis=1))


@dataclass(frozen=True)
class Frames:
    """A recording's means and motion, by which possible frames are compared."""

    rest: Resting
    """The means at rest"""
    motions: list[Motion]
    """The slow motion, by blocks of several lengths"""

    @cached_property
    def described(self) -> tuple[float, float]:
        """The misfit of the frames as the log describes them."""
        return self.misfit(Frame(_ONE, _ONE))

    def misfit(self, frame: Frame) -> tuple[float, float]:
        """The chi-square and the size (rad/s) of the mean rate's difference from Earth's rate in
        this frame."""
        rest, turn = self.rest, np.abs(frame.gyro)
        latitude = -rest.latitude if frame.south else rest.latitude
        rate, force = frame.gyro @ rest.rate, frame.accel @ rest.force
        chi, _ = residual(rate, force, latitude, turn @ rest.sigma)
        _, off = residual(rate, force, latitude, np.ones(3))
        return chi, float(np.linalg.norm(off))

    @property
    def contradicted(self) -> bool:
        """Whether the means contradict the frames as described, so that another frame is looked
        for; a bias may be the reason, too."""
        chi, off = self.described
        if self.rest.stated is not None:
            return chi > _THREE_SIGMA
        return off > max(5 * float(self.rest.noise.max()), _NOTED * self.rest.horizontal)

    @property
    def refutes(self) -> bool:
        """Whether the means contradict the frames as described by 5 sigma or, where no errors are
        stated, by more than a bias that would turn north by 30 degrees, with which a refusal loses
        nothing."""
        chi, off = self.described
        if self.rest.stated is not None:
            return chi > FIVE_SIGMA
        return off > _RUINOUS * self.rest.horizontal

    def explains(self, frame: Frame) -> bool:
        """Whether this frame explains means that contradict the frames as described."""
        chi, off = self.misfit(frame)
        if self.rest.stated is not None:
            better = _EVIDENCE if self.refutes else _THREE_SIGMA - 1
            return chi < min(FIVE_SIGMA, self.described[0] - better)
        noise = float(self.rest.noise.max())
        least = max(self.described[1] / _TEN_TIMES, min(3 * noise, self.described[1] / 3))
        return off <= least

    def moved(self, better: Frame, worse: Frame) -> bool:
        """Whether the motion at every time scale prefers the first frame to the second."""
        return bool(self.motions) and all(m.speaks(better, worse) for m in self.motions)

    def upright(self, frame: Frame) -> bool:
        """Whether the down axis does not point up in this frame."""
        return float(down_of(frame.accel @ self.rest.force)[2]) > -0.05

    def compared(self) -> bool:
        """Whether a wrong sign of one triad relative to the other would show in this recording."""
        if self.moved(Frame(_ONE, _ONE), Frame(-_ONE, _ONE)):
            return True
        chi, off = self.described
        other, far = self.misfit(Frame(_LEFT_UP, _ONE))
        if self.rest.stated is not None:
            return other - chi > _EVIDENCE
        noise = float(self.rest.noise.max())
        return off < far / 3 and far > max(9 * noise, _RUINOUS * self.rest.horizontal)


def frames_finding(frames: Frames, config: LogConfig, north: bool) -> Finding | None:
    """The finding that the means, or slow motion by more than 5 sigma, contradict the frames in
    which gyros and accelerometers are described; None where they do not, or where no other frame
    explains them."""
    own = Frame(_ONE, _ONE)
    upright = [f for f in (*_NAMED, *_SWAPS) if frames.upright(f)]
    moving = [f for f in upright if frames.moved(f, own)]
    still = [f for f in upright if frames.explains(f)] if frames.contradicted else []
    if not moving and not still:
        return None
    # A frame that motion prefers must also be one that the means allow, and the other way round.
    both = [f for f in moving if not frames.contradicted or frames.explains(f)]
    allowed = both or moving or still
    options = list(dict.fromkeys(f.option(config) for f in allowed))[:3]
    rate = float(down_of(frames.rest.force) @ frames.rest.rate) * PER_HOUR
    asked = -EARTH_RATE * np.sin(frames.rest.latitude) * PER_HOUR
    what = f"the rate along the measured vertical is {rate:+.1f} deg/h where "
    what += f"{frames.rest.latitude / DEG:.4g} degrees ask {asked:+.1f}"
    if not still:
        what = "the gyros do not turn the accelerometers' vertical as it turns"
    elif abs(rate - asked) < 0.5 * frames.described[1] * PER_HOUR:
        what = f"{what}, and the horizontal one is not Earth's"
    says = f"{frames.rest.name}: {what}, a bias of {frames.described[1] * PER_HOUR:.3g} deg/h or a "
    says += f"wrong frame: {'; or '.join(options)} would make sense"
    shown = spelled(matrix_of(config.axes))
    sure = bool(moving) or frames.refutes
    return Finding("frames", "log.axes", shown, "", says, refuses=north and sure)


def geometry_finding(frames: Frames, config: LogConfig, north: bool) -> Finding | None:
    """The finding that the forward axis is near the vertical, or that the down axis does not point
    down; None where both are as they should be."""
    down = down_of(frames.rest.force)
    name, shown = frames.rest.name, spelled(matrix_of(config.axes))
    forward = float(np.rad2deg(np.arccos(min(1.0, abs(down[0])))))
    lean = float(np.rad2deg(np.arccos(np.clip(down[2], -1, 1))))
    if forward < _FORWARD_DEG:
        best = [m for m in _RIGHT_HANDED if (m @ down)[2] > np.cos(np.pi / 4)]
        options = "; ".join(Frame(m, m).option(config) for m in best)
        says = f"{name}: the forward axis is {forward:.2g} degrees from the vertical and has no "
        says += f"heading; these have one, by which axis shall be forward: {options}"
        return Finding("forward", "log.axes", shown, "", says, refuses=north)
    if lean > 90:
        options = "; ".join(f.option(config) for f in _turned_over(frames))
        says = f"{name}: the down axis points up, {lean:.0f} degrees from the measured vertical: "
        return Finding("vertical", "log.axes", shown, "", says + options, refuses=north)
    if lean > 45:
        says = f"the down axis is {lean:.0f} degrees from the measured vertical; headings are of "
        says += "the forward axis's horizontal part"
        return Finding("vertical", "log.axes", shown, "", says, refuses=False)
    return None


def _turned_over(frames: Frames) -> list[Frame]:
    """The frames that a log may have whose down axis points up."""
    found = [
        Frame(_LEFT_UP, _LEFT_UP, words="if the file is forward-left-up"),
        Frame(_RIGHT_FORWARD_UP, _RIGHT_FORWARD_UP, words="if it is right-forward-up"),
    ]
    if not frames.compared():
        found.append(Frame(_ONE, -_ONE, words="if its accelerometers print +g down"))
    return found


def mirrored_finding(frames: Frames, config: LogConfig) -> Finding | None:
    """The note of what cannot be checked of the frames from this log; None where motion tells all
    of it."""
    if frames.moved(Frame(_ONE, _ONE), Frame(-_ONE, _ONE)):
        return None
    what = "the sign of y cannot be checked from this log: at rest a mirrored y, or x and y in "
    what += "each other's place, look the same"
    if not frames.compared():
        small = 2 * abs(np.sin(frames.rest.latitude)) < 0.5
        why = "so near to the equator" if small else "beside a bias as large as may be here"
        what = "neither the sign of y nor those of the gyros against the accelerometers can be "
        what += f"checked from this log, which rests, {why}"
    return Finding("mirrored", "log.axes", spelled(matrix_of(config.axes)), "", what, refuses=False)
