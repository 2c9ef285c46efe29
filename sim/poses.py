"""The result of the physics: the test module's poses, by stretches of a recording, and the motion
and encoder readings that follow from them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from lbgc.frames import DOWN, NED_FROM_NWU, across, rotation_matrix
from lbgc.units import factor

from . import kinematics
from .kinematics import Felt
from .turntable import SceneConfig

_BLOCK_S = 5.0
"""Length of the parts in which attitudes are held as matrices, s."""


@dataclass(frozen=True)
class Bench:
    """A scene, with the rate and the number of samples of a recording on it."""

    scene: SceneConfig
    """The bench's configuration"""
    rate_hz: float
    """Samples a second"""
    samples: int
    """Samples in a recording"""
    axis: int = DOWN
    """The test module's axis about which the plate turns"""

    @property
    def step(self) -> float:
        """The length of a physics step, s."""
        return 1 / self.scene.physics_hz

    @property
    def steps(self) -> int:
        """The number of physics steps in a sample."""
        return round(self.scene.physics_hz / self.rate_hz)


@dataclass(frozen=True)
class Poses:
    """Poses of the test module at m physics instants, in the axes of the base at rest."""

    quaternion: np.ndarray  # (m, 4), body to North-West-Up
    place: np.ndarray  # (m, 3), m, North-West-Up
    angle: np.ndarray  # (m,), rad, the plate's angle

    def __getitem__(self, part: slice) -> "Poses":
        return Poses(*(values[part] for values in vars(self).values()))

    def __len__(self) -> int:
        return len(self.angle)

    def repeated(self, count: int) -> "Poses":
        """One pose repeated `count` times."""
        return Poses(*(np.broadcast_to(v, (count, *v.shape[1:])) for v in vars(self).values()))


@dataclass(frozen=True)
class Stretch:
    """Consecutive samples in which the plate is at rest, so that one pose stands for all of them,
    or in which something moves."""

    first: int
    """The first sample's number"""
    samples: int
    """Number of samples"""
    poses: Poses
    """One pose at rest; otherwise poses at every physics instant from the first sample's start to
    the last one's end, and at one more on either side"""
    stage: np.ndarray
    """(samples,), int8, the stage of each sample"""

    @property
    def moves(self) -> bool:
        """Whether anything moves in this stretch."""
        return len(self.poses) > 1


@dataclass(frozen=True, eq=False)
class Executed:
    """The motion of a recording as the physics executed its plan. Two are equal only if they are
    the same object, so that derived arrays can be cached."""

    bench: Bench
    """The scene and the recording's samples"""
    stretches: tuple[Stretch, ...]
    """The recording's stretches, one after the other"""
    control: np.ndarray
    """(3, 3), attitude of the control module at the recording's start"""
    settling_s: float
    """Time that the plate took to come to rest before the recording, s"""
    held: bool = False
    """Whether a hand moves the module, and no plate"""

    def pose(self, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
        """The attitude C (m, 3, 3) and the place (m, 3), m, of poses in the forward-right-down axes
        of the resting base, with the tilt and wobble of the hinge axis, which rotate the plate
        about the foot of the axis."""
        attitude = NED_FROM_NWU @ Rotation.from_quat(poses.quaternion[:, [1, 2, 3, 0]]).as_matrix()
        place = poses.place @ NED_FROM_NWU
        scene = self.bench.scene
        if scene.axis_tilt_deg or scene.axis_wobble_arcsec:
            lean = lean_of_axis(scene, poses.angle, self.bench.axis)
            attitude, place = lean @ attitude, np.einsum("mij,mj->mi", lean, place)
        return attitude, place

    @cached_property
    def start(self) -> np.ndarray:
        """The attitude in the base's axes at the recording's start, when the encoder is zeroed,
        (3, 3)."""
        first = self.stretches[0]
        return self.pose(first.poses[1:2] if first.moves else first.poses)[0][0]

    def blocks(self) -> Iterator[Poses]:
        """The recording's poses in parts, each with the instants of some samples and one more on
        either side."""
        size = max(1, round(_BLOCK_S * self.bench.rate_hz)) * self.bench.steps
        for stretch in self.stretches:
            poses = stretch.poses
            if not stretch.moves:
                poses = poses.repeated(stretch.samples * self.bench.steps + 3)
            for first in range(0, len(poses) - 3, size):
                yield poses[first : min(first + size + 3, len(poses))]

    @cached_property
    def felt(self) -> Felt:
        """The recording's motion in the base's axes; one sample where nothing moves."""
        if not self.moves:
            return kinematics.resting(self.pose(self.stretches[0].poses)[0][0])
        parts = []
        for stretch in self.stretches:
            if stretch.moves:
                own = replace(self, stretches=(stretch,))
                parts += [self._felt_in(block) for block in own.blocks()]
            else:
                resting = kinematics.resting(self.pose(stretch.poses)[0][0])
                parts.append(resting.repeated(stretch.samples))
        return kinematics.joined(parts)

    def _felt_in(self, poses: Poses) -> Felt:
        """The motion of a part of the recording."""
        return kinematics.felt(*self.pose(poses), self.bench.step, self.bench.steps)

    @cached_property
    def ends(self) -> np.ndarray:
        """The attitude in the base's axes at the samples' ends, (n, 3, 3), or (1, 3, 3) where
        nothing moves."""
        if not self.moves:
            return self.pose(self.stretches[0].poses)[0]
        steps, parts = self.bench.steps, []
        for s in self.stretches:
            poses = s.poses[1 + steps : -1 : steps] if s.moves else s.poses
            parts.append(np.repeat(self.pose(poses)[0], 1 if s.moves else s.samples, axis=0))
        return np.concatenate(parts)

    def angle_at(self, t: np.ndarray) -> np.ndarray:
        """The plate's angle, rad, at times t, s; before the recording it was constant."""
        return np.interp(t, *self._knots)

    def pose_at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """The quaternion (4,) and the place (3,), m, North-West-Up, at a time of the recording, s,
        or just before."""
        rate = self.bench.rate_hz
        own = max((s for s in self.stretches if s.first <= t * rate + 1e-6), key=lambda s: s.first)
        step = 1 + int((t - own.first / rate) / self.bench.step) if own.moves else 0
        return own.poses.quaternion[step], own.poses.place[step]

    @property
    def moves(self) -> bool:
        """Whether anything moves in the recording."""
        return any(s.moves for s in self.stretches)

    @cached_property
    def turned(self) -> np.ndarray:
        """The plate's angle since the recording's start, at the samples' ends: (samples,), rad."""
        t = np.arange(1, self.bench.samples + 1) / self.bench.rate_hz
        return self.angle_at(t) - self.angle_at(np.zeros(1))

    @cached_property
    def encoder(self) -> np.ndarray:
        """The encoder's readings at the samples' ends, (samples,), rad, zeroed at the recording's
        start: delayed by its latency, with the error of its eccentric disc, in counts."""
        if not self.moves:
            return np.zeros(self.bench.samples)
        scene = self.bench.scene

        def reads(t: np.ndarray) -> np.ndarray:
            angle = self.angle_at(t - scene.encoder_latency_s)
            error = scene.encoder_error_arcsec * factor("encoder_error_arcsec")
            angle = angle + error * np.sin(angle)
            if scene.encoder_lsb_arcsec is None:
                return angle
            lsb = scene.encoder_lsb_arcsec * factor("encoder_lsb_arcsec")
            return np.rint(angle / lsb) * lsb

        t = np.arange(1, self.bench.samples + 1) / self.bench.rate_hz
        return reads(t) - reads(np.zeros(1))

    @cached_property
    def _knots(self) -> tuple[np.ndarray, np.ndarray]:
        """Instants, s, between which the plate's angle is taken as linear, and the angles there,
        rad."""
        times, angles = [], []
        for s in self.stretches:
            inner = s.poses.angle[1:-1] if s.moves else np.repeat(s.poses.angle, 2)
            lasts = s.samples / self.bench.rate_hz
            times.append(s.first / self.bench.rate_hz + np.linspace(0, lasts, len(inner)))
            angles.append(inner)
        return np.concatenate(times), np.concatenate(angles)

    @cached_property
    def stage(self) -> np.ndarray:
        """The stage of each sample, (samples,), int8; see lbgc.protocol.STAGES."""
        return np.concatenate([s.stage for s in self.stretches])


def lean_of_axis(scene: SceneConfig, angle: np.ndarray, axis: int) -> np.ndarray:
    """The rotation by which the hinge axis leans at the plate's angles (m,), rad: (m, 3, 3).

    It is a constant tilt about the first axis across (forward, where it is down), and a cone that
    the axis goes round twice a turn.
    """
    wobble = scene.axis_wobble_arcsec * factor("axis_wobble_arcsec")
    vector, (i, j) = np.zeros((len(angle), 3)), across(axis)
    vector[:, i], vector[:, j] = wobble * np.cos(2 * angle), wobble * np.sin(2 * angle)
    vector[:, i] += np.deg2rad(scene.axis_tilt_deg)
    return rotation_matrix(vector)
