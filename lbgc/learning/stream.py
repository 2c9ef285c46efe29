"""Training recordings drawn afresh at every step, by the sensor model that made the dataset.

The dataset gives the bench (each stored recording's plate course, attitude, latitude, and what its
unit and session fixed of the sensors' errors); heading, run bias and every in-run term are new.
Windows of a batch begin at one time, drawn for it, since noise that wanders has come further in a
window that begins later.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lbgc.data.store import Dataset
from lbgc.data.windows import Labelled, Windows
from lbgc.earth import earth_rate_ned, normal_gravities, normal_gravity
from lbgc.errors import InputError, build
from lbgc.estimators.course import travel_within
from lbgc.frames import euler_to_matrix, unrepeated
from lbgc.learning.augment import on_plate
from lbgc.sensor.batch import Lasting, measure_means
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.dither import check_means
from lbgc.sensor.imu import ImuModel

_MOVING = {
    "sway_level": "sways",
    "vibration_level": "vibrates",
    "knock_rate": "is knocked",
    "floor_tilt_rate": "leans over time",
    "moored_roll": "floats",
    "moored_pitch": "floats",
    "moored_heave": "floats",
}


@dataclass(frozen=True)
class Streamed:
    """Rows of everything that a recording begins with, at the model's rate."""

    recordings: Labelled
    """The stored ones, of which the plate's course and the labels are used."""
    attitude: np.ndarray
    """(R, 2), rad, roll and pitch"""
    gyro: Lasting
    accel: Lasting
    imu: ImuModel
    arm_m: float
    """Distance from the plate's axis to the IMU, which looks away from it."""
    height_m: float

    @property
    def fresh(self) -> "Streamed":
        return self

    @classmethod
    def of(cls, dataset: Dataset, rows: np.ndarray, recordings: Labelled) -> "Streamed":
        """recordings : the dataset's at `rows`. Raises InputError where the dataset's bench moves,
        or where block means cannot represent its counts."""
        configuration = dataset.configuration
        _check_still(dataset, configuration)
        imu = build(ImuConfig, configuration["imu"]).model(float(configuration["rate_hz"]))
        stored = recordings.windows
        turning = float(np.abs(np.diff(stored.plate_angle, axis=1)).max(initial=0.0))
        fastest = turning * stored.rate_hz + 1e-4
        height = float(configuration["height_m"])
        gravity = normal_gravity(float(stored.latitude[0]), height)
        mean_s = 1 / stored.rate_hz
        check_means(imu.gyro, "imu.gyro", imu.dt, mean_s, fastest)
        check_means(imu.accel, "imu.accel", imu.dt, mean_s, gravity)
        angles = [dataset.label(name)[rows] for name in ("roll", "pitch")]
        return cls(
            recordings,
            np.stack(angles, axis=-1),
            _lasting(dataset, "gyro", rows),
            _lasting(dataset, "accel", rows),
            imu,
            float(configuration["scene"]["arm_m"]),
            height,
        )

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Labelled:
        """Windows of one start, of recordings of which nothing else is drawn."""
        known, stored = self.recordings, self.recordings.windows
        rows = rng.integers(len(stored), size=count)
        start = int(rng.integers(stored.gyro.shape[1] - steps + 1))
        heading = rng.uniform(-np.pi, np.pi, count)
        block = round(1 / (stored.rate_hz * self.imu.dt))
        inside = slice(start, start + steps)
        rate, force = self._truth(rows, heading, inside)
        common = (steps, self.imu.dt, block)
        gyro = measure_means(self.imu.gyro, rng, rate, self.gyro.rows(rows), *common,
                             force, self.imu.warming, start)  # fmt: skip
        accel = measure_means(self.imu.accel, rng, force, self.accel.rows(rows), *common,
                              None, self.imu.warming, start)  # fmt: skip
        off = known.heading_reference[rows] - known.heading[rows]
        windows = Windows(
            gyro=gyro,
            accel=accel,
            plate_angle=stored.plate_angle[rows, inside],
            rate_hz=stored.rate_hz,
            latitude=stored.latitude[rows],
            start_s=np.full(count, start / stored.rate_hz),
        )
        return Labelled(windows=windows, heading=heading, heading_reference=heading + off)

    def _truth(
        self, rows: np.ndarray, heading: np.ndarray, inside: slice
    ) -> tuple[np.ndarray, np.ndarray]:
        """Block means of the rate, rad/s, and the specific force, m/s^2, each (W, T, 3), inside
        recordings on a plate that turns evenly within a block; (W, 1, 3) on one that rests."""
        stored = self.recordings.windows
        late = 0.5 * self.imu.dt * stored.rate_hz  # an encoder is read at a sample's end
        reading = unrepeated(stored.plate_angle[rows])
        travel = travel_within(reading)
        angle, turning = reading - late * travel, travel * stored.rate_hz
        short = np.sinc(travel / (2 * np.pi))
        if reading.shape[1] > 1:
            angle, turning, short = angle[:, inside], turning[:, inside], short[:, inside]
        roll, pitch = self.attitude[rows].T
        base = euler_to_matrix(roll, pitch, heading)
        earth = np.einsum("wij,wi->wj", base, earth_rate_ned(stored.latitude[rows]))
        down = normal_gravities(stored.latitude[rows], self.height_m)
        rate, force = (
            on_plate(v[:, None, :], angle, short) for v in (earth, -down[:, None] * base[:, 2])
        )
        rate[..., 2] += turning
        force[..., 0] -= self.arm_m * turning**2  # towards the axis, behind the IMU
        return rate, force


def _lasting(dataset: Dataset, triad: str, rows: np.ndarray) -> Lasting:
    def of(name: str) -> np.ndarray:
        return dataset.label(f"{triad}_{name}")[rows]

    bias = of("bias_unit") + of("bias_session")
    return Lasting(bias, *(of(n) for n in ("matrix", "g_sensitivity", "bias_per_k", "scale_per_k")))


def _check_still(dataset: Dataset, configuration: Mapping[str, Any]) -> None:
    for name, does in _MOVING.items():
        if np.abs(dataset.label(name)).max(initial=0.0) > 0:
            raise InputError(
                "stream", True, "", f"draws a bench that stands still, and this dataset's {does} "
                f"({name}); train on what is stored (stream=false)"
            )  # fmt: skip
    scene = configuration["scene"]
    for name in ("axis_tilt_deg", "axis_wobble_arcsec"):
        if scene[name] != 0:
            raise InputError(f"scene.{name}", scene[name], "", "is more than stream=true can draw")
