"""Recordings: what moves, what the sensors print of it, and what was drawn; some at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import islice
from math import gcd
from typing import TYPE_CHECKING

import numpy as np

from lbgc.frames import wrap
from lbgc.protocol import plan
from lbgc.sensor import streams
from lbgc.sensor.imu import Disturbance, Timing, Triad, TriadErrors, UnitErrors
from lbgc.sensor.streams import Purpose
from sim import motion
from sim.motion import Draw, Truth

if TYPE_CHECKING:
    from sim.generate import GenerateConfig

Lasting = dict[Purpose, tuple[UnitErrors, np.ndarray]]
"""What a triad's unit and session fixed of its errors."""
_TOGETHER = 64
"""Recordings of means that are worked out at once."""


@dataclass(frozen=True)
class Sensor:
    """Both triads, and which kind of values the dataset stores."""

    gyro: Triad
    accel: Triad
    timing: Timing
    config: "GenerateConfig"

    @classmethod
    def of(cls, config: "GenerateConfig") -> "Sensor":
        imu = config.imu
        return cls(imu.gyro.triad(), imu.accel.triad(), imu.timing.timing(), config)

    def triads(self) -> tuple[tuple[str, Triad, Purpose], ...]:
        return ("gyro", self.gyro, Purpose.GYRO), ("accel", self.accel, Purpose.ACCEL)

    def drawn(
        self, triad: Triad, purpose: Purpose, rows: Sequence[int], lasting: Sequence[Lasting]
    ) -> tuple[list[np.random.Generator], TriadErrors]:
        """What is drawn of a triad before each of these recordings, and where its noise is from."""
        rngs = [streams.recording(self.config.seed, i, purpose) for i in rows]
        each = [
            triad.draw_run(rng, *kept[purpose]) for rng, kept in zip(rngs, lasting, strict=True)
        ]
        return rngs, TriadErrors.of(each)

    def measure(
        self,
        triad: Triad,
        rngs: Sequence[np.random.Generator],
        truth: Sequence[np.ndarray],
        errors: TriadErrors,
        force: Sequence[np.ndarray] | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """What is stored, (R, 3, n), and which of it was at its range, (R, n): of several
        recordings where these are means, else of one."""
        n, dt = self.config.samples // self.config.block, 1 / self.config.rate_hz
        warming = vars(self.config.imu.temperature)
        if self.config.output == "means":
            block = self.config.block
            disturbance = Disturbance(None if force is None else np.stack(force), **warming)
            means = triad.measure_means(rngs, np.stack(truth), errors, n, dt, block, disturbance)
            return means, np.zeros((len(rngs), n), bool)
        (rng,), (only,) = rngs, truth
        disturbance = Disturbance(None if force is None else force[0], **warming)
        own = TriadErrors(**{name: value[0] for name, value in vars(errors).items()})
        printed, saturated = triad.measure(rng, only, own, n, dt, disturbance)
        return printed[None], saturated[None]


def recordings(
    config: "GenerateConfig", sensor: Sensor, rows: Sequence[int]
) -> Iterator[dict[str, np.ndarray]]:
    """All variables of these recordings, one after the other."""
    for part in batches(config, sensor, rows):
        for at in range(len(part["heading"])):
            yield {name: values[at] for name, values in part.items()}


def batches(
    config: "GenerateConfig", sensor: Sensor, rows: Sequence[int]
) -> Iterator[dict[str, np.ndarray]]:
    """All variables of these recordings, some at a time, each of which depends on the configuration
    and on its own number alone."""
    latitude = float(np.deg2rad(config.latitude))
    plans = [plan(config.protocol, i, config.duration_s) for i in rows]
    labels = [streams.recording(config.seed, i, Purpose.LABELS) for i in rows]
    draws = [
        motion.draw(
            config.scene,
            planned.azimuth_range * (own.uniform() - 0.5),
            partial(streams.recording, config.seed, i, Purpose.MOTION),
            config.duration_s,
        )
        for i, planned, own in zip(rows, plans, labels, strict=True)
    ]
    threads = config.cluster.threads
    means = config.imu.model(config.rate_hz).averages_motion
    truths = motion.truths(
        config.bench, plans, latitude, draws, threads, config.height_m, config.block, not means
    )
    sigma = np.deg2rad(config.scene.reference_error_deg)
    lasting: dict[tuple[int, int], Lasting] = {}
    size = _TOGETHER if config.output == "means" else 1
    for first in range(0, len(rows), size):
        some = slice(first, first + size)
        felt = list(islice(truths, size))
        reference = [t.heading_control + sigma * own.standard_normal() - np.pi
                     for t, own in zip(felt, labels[some], strict=True)]  # fmt: skip
        values = _measured(config, sensor, rows[some], felt, lasting)
        values |= _moved(config, felt, draws[some])
        values |= {
            "heading_reference": wrap(np.array(reference)),
            "latitude": np.full(len(felt), latitude),
            "split": np.array([_split(config, i, *_lifetimes(config, i)) for i in rows[some]]),
        }
        yield values


def _lifetimes(config: "GenerateConfig", i: int) -> tuple[int, int]:
    """Unit and session of a recording."""
    return i % config.units, (i // config.units) % config.sessions


def _lasting(config: "GenerateConfig", sensor: Sensor, unit: int, session: int) -> Lasting:
    """What a unit and a session of it fixed of each triad's errors."""
    of_unit = streams.unit(config.unit_seed, unit)
    of_session = streams.session(config.unit_seed, unit, session)
    return {
        purpose: (triad.draw_unit(of_unit), triad.draw_session(of_session))
        for _, triad, purpose in sensor.triads()
    }


def _measured(
    config: "GenerateConfig",
    sensor: Sensor,
    rows: Sequence[int],
    truths: Sequence[Truth],
    lasting: dict[tuple[int, int], Lasting],
) -> dict[str, np.ndarray]:
    """What the sensors print of these recordings, and what was drawn of their errors."""
    lifetimes = [_lifetimes(config, i) for i in rows]
    for own in lifetimes:
        if own not in lasting:
            lasting[own] = _lasting(config, sensor, *own)
    n = config.samples // config.block
    timing = [
        sensor.timing.draw(
            partial(streams.recording, config.seed, i, Purpose.TIMING), n, 1 / config.rate_hz
        )
        for i in rows
    ]
    time_error, lost = (_stacked(part) for part in zip(*timing, strict=True))
    unit, session = np.array(lifetimes).T
    values = {"time_error": time_error, "lost": lost, "unit": unit, "session": session}
    forces = [t.f_ib_b for t in truths]
    for name, triad, purpose in sensor.triads():
        gyro = purpose == Purpose.GYRO
        feels = [t.omega_ib_b for t in truths] if gyro else forces
        rngs, errors = sensor.drawn(triad, purpose, rows, [lasting[own] for own in lifetimes])
        printed, saturated = sensor.measure(triad, rngs, feels, errors, forces if gyro else None)
        if len(rows) == 1:  # of means none is lost
            printed = Timing.held(printed[0], lost[0])[None]
        # Kept axis by axis in memory, as the store keeps it; logically (time, axis).
        values[name], values[f"{name}_saturated"] = printed.swapaxes(1, 2), saturated
        values |= {f"{name}_{part}": value for part, value in vars(errors).items()}
    return values


def _moved(
    config: "GenerateConfig", truths: Sequence[Truth], draws: Sequence[Draw]
) -> dict[str, np.ndarray]:
    """What the bench did in these recordings, and what was drawn of it."""
    n = config.samples // config.block
    floors = [drawn.floor.values() for drawn in draws]
    attitude = _stacked([t.attitude for t in truths])
    return {
        "plate_angle": _stacked([t.plate_angle for t in truths]),
        "stage": _stacked([t.stage for t in truths]),
        "attitude": np.broadcast_to(attitude, (len(truths), n, 3)),
        "heading": np.array([t.heading for t in truths]),
        "roll": np.array([t.roll for t in truths]),
        "pitch": np.array([t.pitch for t in truths]),
        "settling_time": np.array([t.settling_s for t in truths]),
        "base_azimuth": np.array([d.azimuth for d in draws]),
        "base_roll": np.array([d.roll for d in draws]),
        "base_pitch": np.array([d.pitch for d in draws]),
        "sway_level": np.array([d.sway_level for d in draws]),
        **{name: np.array([floor[name] for floor in floors]) for name in floors[0]},
    }


def _stacked(values: Sequence[np.ndarray]) -> np.ndarray:
    """With one more axis in front; one alone is not copied."""
    return np.asarray(values[0])[None] if len(values) == 1 else np.stack(values)


def _split(config: "GenerateConfig", recording: int, unit: int, session: int) -> int:
    """Which part a recording belongs to, whatever else is in the dataset.

    What is split by is dealt in blocks whose size is the sum of the shares (10 for 70:10:20), each
    block in an order of its own, so that whole blocks hold the shares exactly.
    """
    index = {
        "recording": recording,
        "session": session * config.units + unit,
        "unit": unit,
    }[config.split_by]
    shares = np.array(config.split) // gcd(*config.split)
    block, place = divmod(index, int(shares.sum()))
    order = _order(config.seed, block, int(shares.sum()))
    return int(np.searchsorted(np.cumsum(shares), order[place], side="right"))


@lru_cache(maxsize=64)
def _order(seed: int, block: int, size: int) -> tuple[int, ...]:
    return tuple(streams.split(seed, block).permutation(size).tolist())
