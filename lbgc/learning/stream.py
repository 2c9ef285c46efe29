"""Training recordings drawn afresh at every step, by the sensor model that made the dataset.

The dataset gives the bench (each stored recording's plate course, attitude, latitude, and the
sensors' errors that its unit and session fix); heading, run bias and every in-run term are new.
All windows of a batch begin at the same time in their recordings, which is drawn for the batch:
noise that wanders has a larger variance in a window that begins later.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbgc.data import compensated as draws
from lbgc.data.store import Dataset
from lbgc.data.unit_file import CalibratedUnit
from lbgc.data.windows import Labelled, Windows
from lbgc.earth import earth_rate_ned, normal_gravities, normal_gravity
from lbgc.errors import InputError, build, require
from lbgc.estimators.plate import mean_turn, on_plate, travel_within
from lbgc.frames import euler_to_matrix, unrepeated
from lbgc.sensor import errors
from lbgc.sensor import unit as known_unit
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.dither import check_means
from lbgc.sensor.errors import Drawn
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
    """A source whose windows are drawn afresh: what R stored recordings fix of them, at the model's
    rate."""

    recordings: Labelled
    """The stored recordings, of which the plate's course and the labels are used."""
    attitude: np.ndarray
    """(R, 2), rad, roll and pitch"""
    gyro: Drawn
    """The gyros' errors of unit and session, less what is known of them."""
    accel: Drawn
    """The accelerometers' errors of unit and session, less what is known of them."""
    imu: ImuModel
    arm_m: float
    """Distance from the plate's axis to the IMU, whose forward axis points away from it."""
    height_m: float

    @property
    def fresh(self) -> "Streamed":
        """Itself: no window is drawn twice."""
        return self

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        rows: np.ndarray,
        recordings: Labelled,
        unit: CalibratedUnit | None = None,
    ) -> "Streamed":
        """The source for these rows of a dataset. recordings : the dataset's at `rows`; unit : the
        one whose means are taken off what is drawn. Raises InputError where the dataset's bench
        moves, where it was simulated from another unit's calibration, or where block means cannot
        represent the sensor's counts."""
        configuration = dataset.configuration
        _check_still(dataset, configuration)
        imu = build(ImuConfig, configuration["imu"]).model(float(configuration["rate_hz"]))
        lasting = draws.stored(dataset, rows, "unit", "session")
        if unit is not None:
            means = known_unit.drawn(imu, unit.known, unit.known.mean)
            lasting = _less(lasting[0], means[0]), _less(lasting[1], means[1])
        simulated = configuration.get("calibration")
        if simulated is not None:
            own = unit is not None and unit.checksum == simulated
            about = "must be the one from which this dataset was simulated: stream=true draws on"
            require(own, "calibration", None if unit is None else unit.checksum[:12], about)
            assert unit is not None
            imu = replace(imu, gyro=unit.with_bias(imu.gyro))
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
            *lasting,
            imu,
            float(configuration["scene"]["arm_m"]),
            height,
        )

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Labelled:
        """`count` windows of `steps` steps from freshly drawn recordings, all with the same start.
        Nothing else of those recordings is drawn."""
        known, stored = self.recordings, self.recordings.windows
        rows = rng.integers(len(stored), size=count)
        start = int(rng.integers(stored.gyro.shape[1] - steps + 1))
        heading = rng.uniform(-np.pi, np.pi, count)
        block = round(1 / (stored.rate_hz * self.imu.dt))
        inside = slice(start, start + steps)
        rate, force, field = self._truth(rows, heading, inside)
        still = replace(self.imu.warming, force=None)
        gyro, accel = (
            triad.measure_means(
                rng,
                truth,
                triad.draw_run(rng, errors.rows(lasting, rows)),
                *(steps, self.imu.dt, block),
                around,
                start,
            )
            for triad, truth, lasting, around in (
                (self.imu.gyro, rate, self.gyro, replace(still, force=force, field=field)),
                (self.imu.accel, force, self.accel, still),
            )
        )
        off = known.heading_reference[rows] - known.heading[rows]
        windows = Windows(
            gyro=np.moveaxis(gyro, 1, 2),
            accel=np.moveaxis(accel, 1, 2),
            plate_angle=stored.plate_angle[rows, inside],
            rate_hz=stored.rate_hz,
            latitude=stored.latitude[rows],
            start_s=np.full(count, start / stored.rate_hz),
        )
        return Labelled(windows=windows, heading=heading, heading_reference=heading + off)

    def _truth(
        self, rows: np.ndarray, heading: np.ndarray, inside: slice
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Block means of the rate, rad/s, the specific force, m/s^2, and the magnetic field, T,
        each (W, 3, T), inside recordings on a plate that turns evenly within a block; (W, 3, 1) on
        one that rests."""
        stored = self.recordings.windows
        late = 0.5 * self.imu.dt * stored.rate_hz  # an encoder is read at a sample's end
        reading = unrepeated(stored.plate_angle[rows])
        travel = travel_within(reading)
        turn, turning = mean_turn(reading - late * travel, travel), travel * stored.rate_hz
        if reading.shape[1] > 1:
            turn, turning = turn[:, inside], turning[:, inside]
        roll, pitch = self.attitude[rows].T
        base = euler_to_matrix(roll, pitch, heading)
        earth = np.einsum("wij,wi->wj", base, earth_rate_ned(stored.latitude[rows]))
        down = normal_gravities(stored.latitude[rows], self.height_m)
        felt = (earth, -down[:, None] * base[:, 2], self.imu.field_ned @ base)
        rate, force, field = (on_plate(v[:, None, :], turn) for v in felt)
        rate[..., 2] += turning
        force[..., 0] -= self.arm_m * turning**2  # towards the axis, behind the IMU
        return np.swapaxes(rate, 1, 2), np.swapaxes(force, 1, 2), np.swapaxes(field, 1, 2)


def _less(drawn: Drawn, means: Drawn) -> Drawn:
    """What was drawn less what is known of it: to first order, what is left when that is undone."""
    return {name: values - means[name] for name, values in drawn.items()}


def _check_still(dataset: Dataset, configuration: Mapping[str, Any]) -> None:
    """Raise InputError where the dataset's base moves, or the plate's axis is tilted or wobbles."""
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
