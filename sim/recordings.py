"""Recordings: what moves, what the sensors print of it, and what was drawn; some at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import gcd

import numpy as np

from lbgc.attitudes import with_attitudes
from lbgc.frames import wrap
from lbgc.protocol import Plan, plan
from lbgc.sensor import errors, streams, unit
from lbgc.sensor.errors import Drawn, Surroundings
from lbgc.sensor.imu import Timing, Triad
from lbgc.sensor.known import Known
from lbgc.sensor.streams import Purpose

from . import motion
from .configuration import GenerateConfig
from .motion import Draw, Truth

_TOGETHER, _TOGETHER_VALUES = 64, 100_000
"""Recordings worked out at once, and values of each axis: they stay in the processor's cache."""


@dataclass(frozen=True)
class Sensor:
    """Both triads, and which kind of values the dataset stores."""

    gyro: Triad
    accel: Triad
    timing: Timing
    config: GenerateConfig
    known: Known | None = None
    """What is known of its units, which have coefficients of this law in place of the triads' own
    """

    @classmethod
    def of(cls, config: GenerateConfig) -> "Sensor":
        """The sensor that a configuration states."""
        imu, own = config.imu, config.calibrated
        gyro, known = imu.gyro.triad(), None
        if own is not None:
            gyro, known = own.with_bias(gyro), own.known
        return cls(gyro, imu.accel.triad(), imu.timing.timing(), config, known)

    def triads(self) -> tuple[tuple[str, Triad, Purpose], ...]:
        """Both triads, with their names in the dataset and the purposes of their random numbers."""
        return ("gyro", self.gyro, Purpose.GYRO), ("accel", self.accel, Purpose.ACCEL)

    def lasting(self, rows: Sequence[int]) -> dict[Purpose, Drawn]:
        """Errors of each triad that last, drawn once a unit and session: one row a recording."""
        seed, units = self.config.unit_seed, self.config.units
        serial, session = _lifetimes(self.config, rows)
        own, row = np.unique(session * units + serial, return_inverse=True)
        drawn: dict[Purpose, list[Drawn]] = {purpose: [] for _, _, purpose in self.triads()}
        for of_session, of_unit in (divmod(k, units) for k in own.tolist()):
            rngs = streams.unit(seed, of_unit), streams.session(seed, of_unit, of_session)
            both = [
                triad.draw_unit(rngs[0]) | triad.draw_session(rngs[1])
                for _, triad, _ in self.triads()
            ]
            if self.known is not None:
                unit.redraw(self.known, rngs[0], *both)
            for (_, _, purpose), one in zip(self.triads(), both, strict=True):
                drawn[purpose].append(one)
        return {purpose: _rows(each, row) for purpose, each in drawn.items()}

    def drawn(
        self, triad: Triad, purpose: Purpose, rows: Sequence[int], lasting: Drawn
    ) -> tuple[list[np.random.Generator], Drawn]:
        """What is drawn of a triad before each of these recordings, and where its noise is from."""
        rngs = streams.recordings(self.config.seed, rows, purpose)
        return rngs, triad.draw_run(rngs, lasting)

    def timed(self, rows: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """What is printed as each sample's time less the true time, (R, n) in s, and which samples
        are lost, bool (R, n)."""
        n, dt = self.config.samples // self.config.block, 1 / self.config.rate_hz
        if self.timing.is_exact:
            return np.broadcast_to(0.0, (len(rows), n)), np.broadcast_to(False, (len(rows), n))
        rngs = streams.recordings(self.config.seed, rows, Purpose.TIMING)
        error, lost = zip(*(self.timing.draw(rng, n, dt) for rng in rngs), strict=True)
        return _stacked(error), _stacked(lost)

    def measure(
        self,
        triad: Triad,
        rngs: Sequence[np.random.Generator],
        truth: np.ndarray,
        drawn: Drawn,
        around: Surroundings,
    ) -> tuple[np.ndarray, np.ndarray]:
        """What is stored of some recordings, (R, 3, n), and which of it was at its range, (R, n).
        truth, and what acts in `around` : (R, 3, 1) or (R, 3, n)."""
        n, dt = self.config.samples // self.config.block, 1 / self.config.rate_hz
        if self.config.output == "means":
            means = triad.measure_means(rngs, truth, drawn, n, dt, self.config.block, around)
            return means, np.broadcast_to(False, (len(rngs), n))
        each = []
        for at, rng in enumerate(rngs):
            own = errors.rows(drawn, at)
            each.append(triad.measure(rng, truth[at], own, n, dt, around.only(at)))
        printed, saturated = zip(*each, strict=True)
        return _stacked(printed), _stacked(saturated)


def _rows(each: Sequence[Drawn], pick: np.ndarray | slice) -> Drawn:
    """Those of several recordings' lasting errors that `pick` selects."""
    return errors.rows({name: np.stack([one[name] for one in each]) for name in each[0]}, pick)


def recordings(
    config: GenerateConfig, sensor: Sensor, rows: Sequence[int]
) -> Iterator[dict[str, np.ndarray]]:
    """All variables of these recordings, one after the other."""
    for part in batches(config, sensor, rows):
        for at in range(len(part["heading"])):
            yield {name: values[at] for name, values in part.items()}


def batches(
    config: GenerateConfig, sensor: Sensor, rows: Sequence[int]
) -> Iterator[dict[str, np.ndarray]]:
    """All variables of these recordings, some at a time, each of which depends on the configuration
    and on its own number alone."""
    latitude = float(np.deg2rad(config.latitude))
    plans = _plans(config, rows)
    share, misread = _labels(config, rows)
    draws = [
        motion.draw(
            config.scene,
            planned.azimuth_range * own,
            partial(streams.recording, config.seed, i, Purpose.MOTION),
            config.duration_s,
        )
        for i, planned, own in zip(rows, plans, share, strict=True)
    ]
    imu = config.imu.model(config.rate_hz)
    threads, height, block = config.cluster.threads, config.height_m, config.block
    truths = motion.truths(
        *(config.bench, plans, latitude, draws, threads, height, block),
        every_sample=not imu.averages_motion,
        field=imu.field_ned if imu.feels_field else None,
    )
    lasting, split = sensor.lasting(rows), _split(config, rows)
    together, at = max(1, min(_TOGETHER, _TOGETHER_VALUES // (config.samples // block))), 0
    for truth in (t[k : k + together] for t in truths for k in range(0, len(t), together)):
        some = slice(at, at + len(truth))
        own = {purpose: errors.rows(each, some) for purpose, each in lasting.items()}
        values = _measured(config, sensor, rows[some], truth, own)
        values |= _moved(truth, draws[some])
        values |= {
            "heading_reference": wrap(truth.heading_control + misread[some] - np.pi),
            "latitude": np.full(len(truth), latitude),
            "split": split[some],
        }
        yield values
        at = some.stop


def _plans(config: GenerateConfig, rows: Sequence[int]) -> list[Plan]:
    """The recordings' plans, those of a tumble with attitudes of their own."""
    found = [plan(config.protocol, i, config.duration_s) for i in rows]
    if config.protocol.kind != "tumble":
        return found
    rngs = streams.recordings(config.seed, rows, Purpose.ATTITUDES)
    return [with_attitudes(p, config.protocol, r) for p, r in zip(found, rngs, strict=True)]


def _labels(config: GenerateConfig, rows: Sequence[int]) -> tuple[list[float], np.ndarray]:
    """Where the bases point in their ranges, -0.5 to 0.5, and what the control module's headings
    are off by, (R,), rad."""
    rngs = streams.recordings(config.seed, rows, Purpose.LABELS)
    share = [rng.uniform() - 0.5 for rng in rngs]
    sigma = np.deg2rad(config.scene.reference_error_deg)
    return share, sigma * np.array([rng.standard_normal() for rng in rngs])


def _lifetimes(config: GenerateConfig, rows: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Unit and session of each recording."""
    session, unit = np.divmod(np.array(rows), config.units)
    return unit, session % config.sessions


def _measured(
    config: GenerateConfig,
    sensor: Sensor,
    rows: Sequence[int],
    truth: Truth,
    lasting: dict[Purpose, Drawn],
) -> dict[str, np.ndarray]:
    """What the sensors print of these recordings, and what was drawn of their errors."""
    time_error, lost = sensor.timed(rows)
    unit, session = _lifetimes(config, rows)
    warming = Surroundings(**vars(config.imu.temperature))
    values = {"time_error": time_error, "lost": lost, "unit": unit, "session": session}
    for name, triad, purpose in sensor.triads():
        feels, around = truth.f_ib_b, warming
        if purpose == Purpose.GYRO:
            feels = truth.omega_ib_b
            around = replace(warming, force=truth.f_ib_b, field=truth.field)
        rngs, drawn = sensor.drawn(triad, purpose, rows, lasting[purpose])
        printed, saturated = sensor.measure(triad, rngs, feels, drawn, around)
        if lost.any():
            printed = _stacked([Timing.held(*own) for own in zip(printed, lost, strict=True)])
        # Kept axis by axis in memory, as the store keeps it; logically (time, axis).
        values[name], values[f"{name}_saturated"] = printed.swapaxes(1, 2), saturated
        values |= {f"{name}_{part}": value for part, value in drawn.items()}
    return values


def _moved(truth: Truth, draws: Sequence[Draw]) -> dict[str, np.ndarray]:
    """What the bench did in these recordings, and what was drawn of it."""
    floors = [drawn.floor.values() for drawn in draws]
    return {
        "plate_angle": truth.plate_angle,
        "stage": truth.stage,
        "attitude": np.broadcast_to(truth.attitude, (*truth.stage.shape, 3)),
        "heading": truth.heading,
        "roll": truth.roll,
        "pitch": truth.pitch,
        "settling_time": truth.settling_s,
        "base_azimuth": np.array([d.azimuth for d in draws]),
        "base_roll": np.array([d.roll for d in draws]),
        "base_pitch": np.array([d.pitch for d in draws]),
        "sway_level": np.array([d.sway_level for d in draws]),
        **{name: np.array([floor[name] for floor in floors]) for name in floors[0]},
    }


def _stacked(values: Sequence[np.ndarray]) -> np.ndarray:
    """The values with one more axis in front; one alone is not copied."""
    return np.asarray(values[0])[None] if len(values) == 1 else np.stack(values)


def _split(config: GenerateConfig, rows: Sequence[int]) -> np.ndarray:
    """Which part each recording belongs to, whatever else is in the dataset.

    What is split by is dealt in blocks whose size is the sum of the shares (10 for 70:10:20), each
    block in an order of its own, so that whole blocks hold the shares exactly.
    """
    unit, session = _lifetimes(config, rows)
    index = {
        "recording": np.array(rows),
        "session": session * config.units + unit,
        "unit": unit,
    }[config.split_by]
    shares = np.array(config.split) // gcd(*config.split)
    size = int(shares.sum())
    dealt = [_order(config.seed, i // size, size)[i % size] for i in index.tolist()]
    return np.searchsorted(np.cumsum(shares), dealt, side="right")


@lru_cache(maxsize=64)
def _order(seed: int, block: int, size: int) -> tuple[int, ...]:
    return tuple(streams.split(seed, block).permutation(size).tolist())
