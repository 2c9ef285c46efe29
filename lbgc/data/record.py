"""A recording: what simulated data and real logs both become."""

from dataclasses import dataclass, replace

import numpy as np

from lbgc.errors import InputError, require


@dataclass(frozen=True)
class Record:
    """One recording of one IMU, and what is known of it.

    A real record may lack the truth (`heading` None) and even the reference.
    """

    name: str
    gyro: np.ndarray
    """(T, 3), rad/s, means over (t_k - dt, t_k], body axes forward-right-down."""
    accel: np.ndarray
    """(T, 3), m/s^2, specific force."""
    plate_angle: np.ndarray
    """(T,), rad, as the encoder reads it: zero at the recording's start."""
    rate_hz: float
    latitude: float
    """rad"""
    heading: float | None = None
    """rad, the true heading when the encoder reads zero."""
    heading_reference: float | None = None
    """rad, what the reference instrument says it is."""
    notes: tuple[str, ...] = ()
    """What whoever reads its results must know: how its clock was read, what of its frame could not
    be checked. Plain sentences."""

    def __post_init__(self) -> None:
        n = len(self.gyro)
        for name, shape in (("gyro", (n, 3)), ("accel", (n, 3)), ("plate_angle", (n,))):
            got = getattr(self, name).shape
            require(got == shape, f"{self.name}: {name}'s shape", got, f"must be {shape}")

    @property
    def duration_s(self) -> float:
        return len(self.gyro) / self.rate_hz


def whole_multiple(rate_hz: float, target_hz: float) -> int | None:
    """How many samples of one rate make one of the other; None where that is no whole number."""
    ratio = rate_hz / target_hz
    whole = round(ratio)
    return whole if whole >= 1 and abs(ratio - whole) < 1e-6 * ratio else None


def block_means(record: Record, rate_hz: float) -> Record:
    """The record at a lower rate: means over whole blocks; what is left over at the end is cut.

    Raises InputError where the record's rate is no whole multiple of `rate_hz`.
    """
    block = whole_multiple(record.rate_hz, rate_hz)
    if block is None:
        raise InputError(
            f"{record.name}: its rate",
            f"{record.rate_hz:g}",
            "Hz",
            f"must be a whole multiple of the {rate_hz:g} Hz asked for",
        )
    n = len(record.gyro) // block
    if block == 1:
        return record

    def mean(values: np.ndarray) -> np.ndarray:
        whole = values[: n * block]
        return whole.reshape(n, block, *values.shape[1:]).mean(axis=1, dtype=np.float64)

    return replace(
        record,
        gyro=mean(record.gyro),
        accel=mean(record.accel),
        plate_angle=mean(record.plate_angle),
        rate_hz=rate_hz,
    )


def mock_record(**changes: object) -> Record:
    """A small level record at rest, heading 40 degrees at 32.76 N, for tests; any field changed."""
    from lbgc.earth import earth_rate_ned, normal_gravity
    from lbgc.frames import rotation_z

    latitude, heading, n = np.deg2rad(32.76), np.deg2rad(40.0), 250
    values: dict = {
        "name": "mock",
        "gyro": np.tile(earth_rate_ned(latitude) @ rotation_z(heading), (n, 1)),
        "accel": np.tile([0.0, 0.0, -normal_gravity(float(latitude))], (n, 1)),
        "plate_angle": np.zeros(n),
        "rate_hz": 10.0,
        "latitude": float(latitude),
        "heading": float(heading),
        "heading_reference": float(heading) + np.deg2rad(0.1),
    }
    return Record(**(values | changes))
