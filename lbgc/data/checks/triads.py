"""Whether gyros and accelerometers are described in one frame: two vectors checked together.

At rest Earth's rate along the measured vertical is -Omega sin(latitude), whatever the heading: that
tells a sign or a swap of one triad against the other. A mirrored frame of both looks at rest like a
right one. Where the base leans or sways, d(f)/dt = -w x f holds for slow motion and tells that too.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations, product

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.checks.plausible import FIVE_SIGMA, PER_HOUR, Resting, down_of, residual
from lbgc.data.logconfig import LogConfig
from lbgc.data.readers.axes import matrix_of, spelled
from lbgc.data.record import Record
from lbgc.earth import EARTH_RATE
from lbgc.units import DEG

_EVIDENCE = 25.0
"""Chi-square by which another frame must be better, 5 sigma: twice a log likelihood ratio."""
_THREE_SIGMA = 14.2
"""Chi-square of three degrees of freedom that is exceeded as seldom as 3 sigma: worth a note."""
_RUINOUS = 0.5
"""Share of Earth's horizontal rate: a bias that turns north by 30 degrees."""
_NOTED = 0.1
"""Share of Earth's horizontal rate: a bias that turns north by 6 degrees."""
_TEN_TIMES = 10.0
_FORWARD_DEG = 10.0
_BLOCKS_S = (2.0, 5.0)
"""Lengths of the blocks by which motion is seen: longer than what shakes a sensor about, within
which a swaying lever arm's own acceleration may exceed gravity's."""
_FEWEST_BLOCKS = 48
_EXPLAINED = 0.2
"""Share of what the vertical does that the gyros must explain before motion says anything."""

_ONE = np.eye(3)
_LEFT_UP = np.diag([1.0, -1.0, -1.0])
_RIGHT_FORWARD_UP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class Frame:
    """What the log's frames might be instead: it turns each triad, as described, into the body."""

    gyro: np.ndarray  # (3, 3), a signed permutation
    accel: np.ndarray  # (3, 3), likewise
    south: bool = False
    """Whether the latitude's sign is the wrong one."""
    words: str = ""

    def option(self, config: LogConfig) -> str:
        """What to type for it, and what it means."""
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
"""Plain exchanges of columns first."""


@dataclass(frozen=True)
class Motion:
    """Slow motion of one recording: what the gyros say that the force's direction should do, and
    what it does, as described."""

    turned: np.ndarray
    """(K, 3), rad: rotations from one block's middle to the next."""
    force: np.ndarray
    """(K, 3), m/s^2: the mean of the two blocks."""
    change: np.ndarray
    """(K, 3), m/s^2: of the force from one to the next."""

    def left(self, frame: Frame) -> np.ndarray:
        """(K,): the square of what the gyros do not explain, in this frame."""
        turned, force, change = (
            self.turned @ frame.gyro.T,
            self.force @ frame.accel.T,
            self.change @ frame.accel.T,
        )
        return np.asarray(np.sum((change + np.cross(turned, force)) ** 2, axis=1))

    def explained(self, frame: Frame) -> float:
        """The share of the change that the gyros explain in this frame: 1 is all, 0 none."""
        every = float(np.sum(self.change**2))
        return 1 - float(self.left(frame).sum()) / every if every > 0 else 0.0

    def speaks(self, better: Frame, worse: Frame) -> bool:
        """Whether the motion tells the two apart by more than 5 sigma, and fits the better one.

        Where the gyros say that most happened, each step's difference of the two misfits over
        their sum, within +-1: so no knock or bad stretch outweighs the rest.
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
    """The recording's motion by blocks of each length that it is long enough for."""
    angle = np.cumsum(record.gyro - record.gyro.mean(axis=0), axis=0) / record.rate_hz
    found = []
    for length in _BLOCKS_S:
        size = round(length * record.rate_hz)
        count = len(record.gyro) // size if size else 0
        if count < _FEWEST_BLOCKS:
            continue
        force = _means(record.accel, size, count)
        turned = np.diff(_means(angle, size, count), axis=0)
        found.append(Motion(turned, (force[1:] + force[:-1]) / 2, np.diff(force, axis=0)))
    return found


def _means(values: np.ndarray, size: int, count: int) -> np.ndarray:
    return np.asarray(values[: size * count].reshape(count, size, 3).mean(axis=1))


@dataclass(frozen=True)
class Frames:
    """A recording's two triads, held against each other in any frame."""

    rest: Resting
    motions: list[Motion]

    @cached_property
    def described(self) -> tuple[float, float]:
        return self.misfit(Frame(_ONE, _ONE))

    def misfit(self, frame: Frame) -> tuple[float, float]:
        """Chi-square and size (rad/s) of what Earth's rate leaves in this frame."""
        rest, turn = self.rest, np.abs(frame.gyro)
        latitude = -rest.latitude if frame.south else rest.latitude
        rate, force = frame.gyro @ rest.rate, frame.accel @ rest.force
        chi, _ = residual(rate, force, latitude, turn @ rest.sigma)
        _, off = residual(rate, force, latitude, np.ones(3))
        return chi, float(np.linalg.norm(off))

    @property
    def contradicted(self) -> bool:
        """Whether the means speak against the frames as described, if nothing but a frame does."""
        chi, off = self.described
        if self.rest.stated is not None:
            return chi > _THREE_SIGMA
        return off > max(5 * float(self.rest.noise.max()), _NOTED * self.rest.horizontal)

    @property
    def refutes(self) -> bool:
        """Whether the means contradict by more than a bias that nobody stated may do: where one
        that would turn north by 30 degrees were at work, nothing is lost by a refusal."""
        chi, off = self.described
        if self.rest.stated is not None:
            return chi > FIVE_SIGMA
        return off > _RUINOUS * self.rest.horizontal

    def explains(self, frame: Frame) -> bool:
        """Whether this frame makes sense of means that contradict the one described."""
        chi, off = self.misfit(frame)
        if self.rest.stated is not None:
            better = _EVIDENCE if self.refutes else _THREE_SIGMA - 1
            return chi < min(FIVE_SIGMA, self.described[0] - better)
        noise = float(self.rest.noise.max())
        least = max(self.described[1] / _TEN_TIMES, min(3 * noise, self.described[1] / 3))
        return off <= least

    def moved(self, better: Frame, worse: Frame) -> bool:
        """Whether motion at every time scale prefers one frame to the other."""
        return bool(self.motions) and all(m.speaks(better, worse) for m in self.motions)

    def upright(self, frame: Frame) -> bool:
        return float(down_of(frame.accel @ self.rest.force)[2]) > -0.05

    def compared(self) -> bool:
        """Whether a wrong sign of one triad against the other would have been seen."""
        if self.moved(Frame(_ONE, _ONE), Frame(-_ONE, _ONE)):
            return True
        chi, off = self.described
        other, far = self.misfit(Frame(_LEFT_UP, _ONE))
        if self.rest.stated is not None:
            return other - chi > _EVIDENCE
        noise = float(self.rest.noise.max())
        return off < far / 3 and far > max(9 * noise, _RUINOUS * self.rest.horizontal)


def frames_finding(frames: Frames, config: LogConfig, north: bool) -> Finding | None:
    """Gyros against accelerometers: what the means or slow motion contradict by over 5 sigma."""
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
    """Where the described axes point: forward is near the vertical, or down is not down."""
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
    """What a log whose down axis points up may be."""
    found = [
        Frame(_LEFT_UP, _LEFT_UP, words="if the file is forward-left-up"),
        Frame(_RIGHT_FORWARD_UP, _RIGHT_FORWARD_UP, words="if it is right-forward-up"),
    ]
    if not frames.compared():
        found.append(Frame(_ONE, -_ONE, words="if its accelerometers print +g down"))
    return found


def mirrored_finding(frames: Frames, config: LogConfig) -> Finding | None:
    """What of the frames this log cannot say: a note."""
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
