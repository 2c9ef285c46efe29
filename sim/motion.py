"""What the test module really feels, sample by sample or in means over blocks of samples.

`sim.physics` moves the plate (and the vehicle under it, where there is one) and gives the module's
poses; `sim.kinematics` makes increments of them. MuJoCo's world neither rotates nor has an azimuth:
Earth's rate, gravity and the Coriolis force are applied here, exactly, so that one execution of a
plan serves every recording. A floor that moves is a closed form, laid under the poses.

What is felt is linear in the motion, so its means are taken of the motion, once a plan, and not of
each recording's samples.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby, islice

import numpy as np

from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.frames import (
    DOWN,
    euler_to_matrix,
    matrix_to_euler,
    rotation,
    rotation_matrix,
    rotation_z,
    wrap,
)
from lbgc.protocol import REST, SETTLE, SLEW, Plan
from lbgc.sensor import streams
from lbgc.sensor.errors import Triple

from . import held, kinematics, physics, sway
from .disturbance import Floor, pick
from .kinematics import Felt
from .physics import execute_resting, execute_swaying, lead_steps
from .poses import Bench, Executed
from .turntable import SceneConfig

_POSES_BYTES = 1e8  # of a batch of swaying recordings, at the most
_TOGETHER_VALUES = 1e5  # of each axis, of recordings on plates that move: worked out at once


@dataclass(frozen=True)
class Draw:
    """What a recording's bench drew."""

    azimuth: float
    """rad, of the base"""
    roll: float
    """rad, of the base"""
    pitch: float
    """rad, of the base"""
    floor: Floor
    sway_level: float
    sway: np.random.Generator | None
    """Random generator of the forces that sway the base, if any do"""

    @property
    def level(self) -> np.ndarray:
        """Rotation from the base's axes to A, North-East-Down turned by the azimuth: (3, 3)."""
        return euler_to_matrix(self.roll, self.pitch, 0.0)


def draw(
    scene: SceneConfig,
    azimuth: float,
    stream: Callable[[], np.random.Generator],
    duration_s: float,
) -> Draw:
    """A bench's draw from the recording's own stream, which nothing else draws from, and which is
    only begun where anything is drawn. azimuth : rad, of the base where the scene does not fix
    it."""

    def own(number: int) -> np.random.Generator:
        return streams.child(stream(), number)

    roll = pitch = 0.0
    if scene.level_error_deg > 0:
        roll, pitch = scene.level_error_deg * own(0).standard_normal(2)
    fixed = scene.base_azimuth_deg
    return Draw(
        azimuth=azimuth if fixed is None else float(np.deg2rad(fixed)),
        roll=float(np.deg2rad(scene.base_roll_deg + roll)),
        pitch=float(np.deg2rad(scene.base_pitch_deg + pitch)),
        floor=scene.floor.draw(own(1), duration_s) if scene.floor.moves else scene.floor.still,
        sway_level=pick(own(2), scene.sway.level) if scene.sway.present else 0.0,
        sway=own(3) if scene.sway.present else None,
    )


@dataclass(frozen=True)
class Truth:
    """True motion of the test module, over a recording of n blocks; a block may be one sample. For
    several recordings, each array has one more axis in front."""

    omega_ib_b: np.ndarray
    """(3, n), or (3, 1) where it is constant; rad/s, means over the block; of each of its samples,
    (3, n block), where they were asked for"""
    f_ib_b: np.ndarray
    """m/s^2, likewise"""
    field: np.ndarray | None
    """T, likewise: the magnetic field, where it is asked for"""
    plate_angle: np.ndarray
    """(n,), rad, as the encoder reads it at the samples' ends, mean over the block"""
    stage: np.ndarray
    """(n,), int8, see lbgc.protocol.STAGES: a block with any slew slews, else settles"""
    attitude: np.ndarray
    """(n, 3) or (1, 3), rad, true at the samples' ends, mean over the block: roll, pitch, and the
    heading less `heading` and the plate's true angle: how far the base and the axis turned it.
    About a level axis they are those of the body turned back by the plate's angle"""
    heading: np.ndarray
    """(), rad, at the recording's start"""
    heading_control: np.ndarray
    """(), rad, of the control module, likewise"""
    roll: np.ndarray
    """(), rad, at the recording's start"""
    pitch: np.ndarray
    """(), rad, likewise"""
    settling_s: np.ndarray
    """(), physics that it took the plate to come to rest before the recording"""

    def __len__(self) -> int:
        """How many recordings' it is."""
        return len(self.heading)

    def __getitem__(self, rows: int | slice) -> "Truth":
        """One recording's, or some ones'."""
        own = ((name, values) for name, values in vars(self).items() if values is not None)
        return Truth(**{"field": None, **{name: values[rows] for name, values in own}})


def truth(bench: Bench, plan: Plan, latitude: float, drawn: Draw) -> Truth:
    """What the test module feels. latitude : rad.

    Raises InputError where the servo cannot do the plan, or the plate does not come to rest.
    """
    return next(truths(bench, [plan], latitude, [drawn]))[0]


def truths(
    bench: Bench,
    plans: Sequence[Plan],
    latitude: float,
    draws: Sequence[Draw],
    threads: int = 1,
    height: float = 0.0,
    block: int = 1,
    every_sample: bool = False,
    field: Triple | None = None,
) -> Iterator[Truth]:
    """The truth of several recordings, some at a time; they share so many threads where the base
    sways. Each is worked out by itself, to the bit, whatever others there are.

    height : m, above the ellipsoid; block : samples, to take means over; every_sample : of rate and
    force take none, since the sensor is not linear; field : north, east and down, T: the magnetic
    field, where it is felt."""
    for planned in dict.fromkeys(plans):
        held.check(bench.scene, planned)
    gravity = normal_gravity(latitude, height)
    felt_block = 1 if every_sample else block
    if not bench.scene.sway.present and not bench.scene.floor.moves:
        yield from _rigid(bench, gravity, plans, latitude, draws, block, felt_block, field)
        return
    for drawn, executed in _executed(bench, gravity, plans, draws, threads):
        start, control = _at_start(executed, drawn)
        every, ends = _on_moving_floor(executed, drawn)
        felt = every.averaged(felt_block)
        to_n = rotation_z(drawn.azimuth)
        earth, down = to_n.T @ earth_rate_ned(latitude), np.array([0.0, 0.0, gravity])
        roll, pitch, heading = matrix_to_euler((to_n @ start)[None])
        plate_angle, stage = _course(executed, block)
        yield Truth(
            omega_ib_b=felt.omega(earth)[None],
            f_ib_b=felt.force(earth, down)[None],
            field=None if field is None else felt.in_body(to_n.T @ field).T[None],
            plate_angle=plate_angle[None],
            stage=stage[None],
            attitude=_attitude(ends, start, executed, block)[None],
            heading=heading,
            heading_control=matrix_to_euler((to_n @ control)[None])[2],
            roll=roll,
            pitch=pitch,
            settling_s=np.array([executed.settling_s]),
        )


def _rigid(
    bench: Bench,
    gravity: float,
    plans: Sequence[Plan],
    latitude: float,
    draws: Sequence[Draw],
    block: int,
    felt_block: int,
    field: Triple | None,
) -> Iterator[Truth]:
    """Truth on bases that do not move: all that rest together, or that one execution of a plan
    serves."""
    resting = {p: execute_resting(bench, gravity, p) for p in dict.fromkeys(plans) if not p.moving}
    together = max(1, int(_TOGETHER_VALUES // (bench.samples // felt_block)))
    each = zip(plans, draws, strict=True)
    for moving, alike in groupby(each, lambda pair: pair[0] if pair[0].moving else None):
        while some := list(islice(alike, together if moving else None)):
            planned, own = zip(*some, strict=True)
            one = [execute(bench, gravity, moving)] if moving else [resting[p] for p in planned]
            yield _rigid_truth(one, own, latitude, gravity, block, felt_block, field)


def _rigid_truth(
    executed: Sequence[Executed],
    draws: Sequence[Draw],
    latitude: float,
    gravity: float,
    block: int,
    felt_block: int,
    field: Triple | None,
) -> Truth:
    """executed : one for all, or of plates that rest, each its own."""
    moves = executed[0].moves
    felt = [_felt(e, felt_block) if moves else e.felt for e in executed]
    lean = np.array([(d.roll, d.pitch) for d in draws])
    level = euler_to_matrix(lean[:, 0], lean[:, 1], 0.0)  # (R, 3, 3), as all that follows
    to_n = rotation_z(np.array([d.azimuth for d in draws]))
    earth, down = earth_rate_ned(latitude) @ (to_n @ level), gravity * level[:, 2]  # (R, 3), in A
    omega = np.stack([f.rate.T for f in felt]) + _in_body(felt, earth)
    force = np.stack([f.acceleration.T for f in felt]) - _in_body(felt, down)
    if moves:
        coriolis = np.ascontiguousarray(felt[0].coriolis.transpose(1, 0, 2))  # (3, n, 3), for BLAS
        force += (coriolis @ earth[:, None, :, None])[..., 0]
    start = np.stack([e.start for e in executed])
    angles = np.stack(matrix_to_euler(to_n @ level @ start), axis=-1)
    control = to_n @ level @ np.stack([e.control for e in executed])
    plate_angle, stage = (_alike(part, len(draws)) for part in _course(executed[0], block))
    attitude = angles[:, None] * [1.0, 1.0, 0.0]  # at rest it stays as it was
    return Truth(
        omega_ib_b=omega,
        f_ib_b=force,
        field=None if field is None else _in_body(felt, field @ (to_n @ level)),
        plate_angle=plate_angle,
        stage=stage,
        attitude=_rigid_attitudes(executed[0], lean, block) if moves else attitude,
        heading=angles[:, 2],
        heading_control=matrix_to_euler(control)[2],
        roll=angles[:, 0],
        pitch=angles[:, 1],
        settling_s=np.broadcast_to([e.settling_s for e in executed], len(draws)),
    )


def execute(bench: Bench, gravity: float, plan: Plan) -> Executed:
    """Execute a plan on a rigid base: by the turntable's servo, or by a hand."""
    how = physics.execute if plan.handling is None else held.execute
    return how(bench, gravity, plan)


def _alike(values: np.ndarray, count: int) -> np.ndarray:
    """One recording's as that of so many."""
    return np.broadcast_to(values, (count, *values.shape))


def _in_body(felt: Sequence[Felt], vectors: np.ndarray) -> np.ndarray:
    """Vectors (R, 3) of A in the body that turns in it: (R, 3, n)."""
    turned = np.stack([f.attitude.transpose(2, 0, 1) for f in felt])  # (R or 1, 3, n, 3)
    return (turned @ vectors[:, None, :, None])[..., 0]


@lru_cache(maxsize=4)
def _felt(executed: Executed, block: int) -> Felt:
    """What is felt on a rigid base."""
    return executed.felt.averaged(block)


def _course(executed: Executed, block: int) -> tuple[np.ndarray, np.ndarray]:
    """The plate's angle as it is read, rad, and the stage, of blocks, (n,) each."""
    if not executed.moves:
        n = executed.bench.samples // block
        return np.broadcast_to(0.0, n), np.broadcast_to(np.int8(REST), n)
    return _moving_course(executed, block)


@lru_cache(maxsize=4)
def _moving_course(executed: Executed, block: int) -> tuple[np.ndarray, np.ndarray]:
    angle = executed.encoder.reshape(-1, block).mean(axis=1)
    return angle, _stage(executed.stage.reshape(-1, block))


def _stage(samples: np.ndarray) -> np.ndarray:
    """Stages of blocks, (n,), from their samples' (n, block)."""
    driven, settling = (samples == SLEW).any(axis=1), (samples == SETTLE).any(axis=1)
    return np.where(driven, SLEW, np.where(settling, SETTLE, REST)).astype(np.int8)


def _executed(
    bench: Bench, gravity: float, plans: Sequence[Plan], draws: Sequence[Draw], threads: int
) -> Iterator[tuple[Draw, Executed]]:
    if not bench.scene.sway.present:
        for planned, drawn in zip(plans, draws, strict=True):
            yield drawn, execute(bench, gravity, planned)
        return
    steps = lead_steps(bench) + bench.samples * bench.steps + 2
    fits = int(_POSES_BYTES // (steps * 8 * 8))
    batch = max(1, min(threads, fits))
    for first in range(0, len(plans), batch):
        own = draws[first : first + batch]
        forces = [
            d.sway_level * sway.forces(bench.scene.sway, d.sway, steps, bench.step)
            for d in own
            if d.sway is not None
        ]
        some, levels = plans[first : first + batch], [d.level for d in own]
        executed = execute_swaying(bench, gravity, some, levels, forces, threads)
        yield from zip(own, executed, strict=True)


def _on_moving_floor(executed: Executed, drawn: Draw) -> tuple[Felt, np.ndarray]:
    """What is felt in A, and the attitude (n, 3, 3) in A at the samples' ends."""
    bench = executed.bench
    parts, ends, at = [], [], -1
    for block in executed.blocks():
        t = (at + np.arange(len(block))) * bench.step
        attitude, place = executed.pose(block)
        floor, carried = _level(bench, drawn), None
        if any(drawn.floor.moving):
            rotation, carried = drawn.floor.motion(t)
            floor = rotation_matrix(rotation) @ floor
        if any(drawn.floor.moving) or not bench.scene.sway.present:
            attitude, place = floor @ attitude, (floor @ place[..., None])[..., 0]
        parts.append(kinematics.felt(attitude, place, bench.step, bench.steps, carried))
        ends.append(attitude[1 + bench.steps : -1 : bench.steps])
        at += len(block) - 3
    return kinematics.joined(parts), np.concatenate(ends)


def _level(bench: Bench, drawn: Draw) -> np.ndarray:
    """How the base stands on the floor, (3, 3): in a vehicle the physics has that already."""
    return np.eye(3) if bench.scene.sway.present else drawn.level


def _at_start(executed: Executed, drawn: Draw) -> tuple[np.ndarray, np.ndarray]:
    """Attitudes (3, 3) of the test and the control module in A when the encoder is zeroed."""
    turned = rotation_matrix(drawn.floor.motion(np.zeros(1))[0][0])
    floor = turned @ _level(executed.bench, drawn)
    return floor @ executed.start, floor @ executed.control


def _rigid_attitudes(executed: Executed, lean: np.ndarray, block: int) -> np.ndarray:
    """See Truth, (R, n, 3); mostly all bases lean alike. lean : (R, 2), roll and pitch in rad."""
    each = [_rigid_attitude(executed, own, block) for own in map(tuple, lean.tolist())]
    return _alike(each[0], len(each)) if len(set(map(id, each))) == 1 else np.stack(each)


@lru_cache(maxsize=4)
def _rigid_attitude(executed: Executed, lean: tuple[float, float], block: int) -> np.ndarray:
    """The attitude (see Truth) on a base that leans by so much, roll and pitch in rad, and does not
    move."""
    level = euler_to_matrix(*lean, 0.0)
    ends = level @ executed.ends
    return _attitude(ends, level @ executed.start, executed, block)


def _attitude(ends: np.ndarray, start: np.ndarray, executed: Executed, block: int) -> np.ndarray:
    """See Truth. ends : (n, 3, 3) or (1, 3, 3), start : (3, 3), in A: an azimuth adds to both
    headings alike."""
    turned = executed.turned if executed.moves else np.zeros(1)
    if executed.bench.axis != DOWN:
        ends, turned = ends @ rotation(-turned, executed.bench.axis), np.zeros(1)
    roll, pitch, yaw = matrix_to_euler(ends)
    off = wrap(yaw - matrix_to_euler(start)[2] - turned)
    found = np.stack([roll, pitch, off], axis=-1)
    return found if len(found) == 1 else found.reshape(-1, block, 3).mean(axis=1)
