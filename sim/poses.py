"""What the physics gives back: the module's poses, stretch by stretch of a recording."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from lbgc.frames import NED_FROM_NWU, rotation_matrix
from lbgc.units import factor

from . import kinematics
from .kinematics import Felt
from .turntable import SceneConfig

_BLOCK_S = 5.0  # of attitudes held at once as matrices


@dataclass(frozen=True)
class Bench:
    """A scene, and the samples of a recording that are taken on it."""

    scene: SceneConfig
    rate_hz: float
    samples: int

    @property
    def step(self) -> float:
        """s, of the physics"""
        return 1 / self.scene.physics_hz

    @property
    def steps(self) -> int:
        """Steps of the physics in a sample."""
        return round(self.scene.physics_hz / self.rate_hz)


@dataclass(frozen=True)
class Poses:
    """Poses of the test module at m physics instants, in the base's axes as it stands at rest."""

    quaternion: np.ndarray  # (m, 4), body to North-West-Up
    place: np.ndarray  # (m, 3), m, North-West-Up
    angle: np.ndarray  # (m,), rad, of the plate

    def __getitem__(self, part: slice) -> "Poses":
        return Poses(*(values[part] for values in vars(self).values()))

    def __len__(self) -> int:
        return len(self.angle)

    def repeated(self, count: int) -> "Poses":
        """One pose as `count` of them."""
        return Poses(*(np.broadcast_to(v, (count, *v.shape[1:])) for v in vars(self).values()))


@dataclass(frozen=True)
class Stretch:
    """Samples in which the plate rests (one pose stands for all of them), or in which something
    moves: poses at every instant from the first sample's start to the last one's end, and at one
    more on either side."""

    first: int
    samples: int
    poses: Poses
    stage: np.ndarray  # (samples,), int8

    @property
    def moves(self) -> bool:
        return len(self.poses) > 1


@dataclass(frozen=True, eq=False)
class Executed:
    """A recording's plan as the physics did it. Each is itself alone, so that what follows from it
    can be kept."""

    bench: Bench
    stretches: tuple[Stretch, ...]
    control: np.ndarray  # (3, 3), of the control module at the recording's start
    settling_s: float
    """Physics that it took the plate to come to rest before the recording"""

    def pose(self, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
        """Attitude C (m, 3, 3) and place (m, 3) in forward-right-down axes of the resting base,
        the hinge axis leaning and wobbling: it turns what stands on it about its own foot."""
        attitude = NED_FROM_NWU @ Rotation.from_quat(poses.quaternion[:, [1, 2, 3, 0]]).as_matrix()
        place = poses.place @ NED_FROM_NWU
        scene = self.bench.scene
        if scene.axis_tilt_deg or scene.axis_wobble_arcsec:
            lean = lean_of_axis(scene, poses.angle)
            attitude, place = lean @ attitude, np.einsum("mij,mj->mi", lean, place)
        return attitude, place

    @cached_property
    def start(self) -> np.ndarray:
        """Attitude in the base's axes when the encoder is zeroed, (3, 3)."""
        first = self.stretches[0]
        return self.pose(first.poses[1:2] if first.moves else first.poses)[0][0]

    def blocks(self) -> Iterator[Poses]:
        """The recording in parts: the instants of some samples, and one more on either side."""
        size = max(1, round(_BLOCK_S * self.bench.rate_hz)) * self.bench.steps
        for stretch in self.stretches:
            poses = stretch.poses
            if not stretch.moves:
                poses = poses.repeated(stretch.samples * self.bench.steps + 3)
            for first in range(0, len(poses) - 3, size):
                yield poses[first : min(first + size + 3, len(poses))]

    @cached_property
    def felt(self) -> Felt:
        """What is felt in the base's axes, over the recording; one sample where nothing moves."""
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
        return kinematics.felt(*self.pose(poses), self.bench.step, self.bench.steps)

    @cached_property
    def ends(self) -> np.ndarray:
        """Attitude in the base's axes at the samples' ends, (n, 3, 3), or (1, 3, 3)."""
        if not self.moves:
            return self.pose(self.stretches[0].poses)[0]
        steps, parts = self.bench.steps, []
        for s in self.stretches:
            poses = s.poses[1 + steps : -1 : steps] if s.moves else s.poses
            parts.append(np.repeat(self.pose(poses)[0], 1 if s.moves else s.samples, axis=0))
        return np.concatenate(parts)

    def angle_at(self, t: np.ndarray) -> np.ndarray:
        """The plate's angle at times t (s), rad; before the recording it stood still."""
        return np.interp(t, *self._knots)

    @property
    def moves(self) -> bool:
        """Whether anything moves."""
        return any(s.moves for s in self.stretches)

    @cached_property
    def turned(self) -> np.ndarray:
        """The plate's angle since the recording's start, at the samples' ends: (samples,), rad."""
        t = np.arange(1, self.bench.samples + 1) / self.bench.rate_hz
        return self.angle_at(t) - self.angle_at(np.zeros(1))

    @cached_property
    def encoder(self) -> np.ndarray:
        """What it reads at the samples' ends, zeroed at the recording's start: late, off by its
        eccentric disc, in counts. (samples,), rad."""
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
        """Instants (s) between which the angle (rad) is linear."""
        times, angles = [], []
        for s in self.stretches:
            inner = s.poses.angle[1:-1] if s.moves else np.repeat(s.poses.angle, 2)
            lasts = s.samples / self.bench.rate_hz
            times.append(s.first / self.bench.rate_hz + np.linspace(0, lasts, len(inner)))
            angles.append(inner)
        return np.concatenate(times), np.concatenate(angles)

    @cached_property
    def stage(self) -> np.ndarray:
        """(samples,), int8, see lbgc.protocol.STAGES"""
        return np.concatenate([s.stage for s in self.stretches])


def lean_of_axis(scene: SceneConfig, angle: np.ndarray) -> np.ndarray:
    """How the hinge axis leans at the plate's angles: (m,), rad -> (m, 3, 3).

    A tilt about the forward axis, and a cone that it goes round twice a turn.
    """
    wobble = scene.axis_wobble_arcsec * factor("axis_wobble_arcsec")
    around = [np.cos(2 * angle), np.sin(2 * angle), np.zeros_like(angle)]
    vector = wobble * np.stack(around, axis=-1)
    vector[:, 0] += np.deg2rad(scene.axis_tilt_deg)
    return rotation_matrix(vector)
