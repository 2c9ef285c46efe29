"""Windows drawn many at once, for the tests of estimators and bounds: block means of full sensors
on an ideal bench, and perfect sensors on a base that sways. Nothing here uses the bound's own
covariance."""

import numpy as np

from lbgc.data.windows import Labelled, Windows
from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.frames import euler_to_matrix, rotation_z
from lbgc.protocol import ProtocolConfig, plan
from lbgc.sensor.imu import ImuModel

PROTOCOLS = {
    "static": ProtocolConfig("static", "static"),
    "two_position": ProtocolConfig("two_position", "indexed"),
    "four_position": ProtocolConfig(
        "four_position", "indexed", angles_deg=(0.0, 90.0, 180.0, 270.0)
    ),
    "carousel": ProtocolConfig("carousel", "carousel"),
}


def windows(
    imu: ImuModel,
    protocol: str,
    latitude_deg: float,
    duration_s: float,
    count: int,
    seed: int,
    *,
    interval: float = 1.0,
    tilt_deg: tuple[float, float] = (0.0, 0.0),
    heading: np.ndarray | None = None,
) -> Labelled:
    """Each of its own unit, session and run. The plate's angle is that at blocks' middles."""
    rng = np.random.default_rng(seed)
    n, fine = round(duration_s / interval), 20
    latitude = float(np.deg2rad(latitude_deg))
    middles = (np.arange(n * fine) + 0.5) * interval / fine
    angle, rate = plan(PROTOCOLS[protocol], 0, duration_s).command(middles)
    psi = rng.uniform(-np.pi, np.pi, count) if heading is None else heading
    base = euler_to_matrix(*np.deg2rad(tilt_deg), psi)  # (count, 3, 3)
    plate = euler_to_matrix(0.0, 0.0, angle).reshape(n, fine, 3, 3).mean(axis=1)
    turning = rate.reshape(n, fine).mean(axis=1)
    c_nb = np.einsum("wij,njk->wnik", base, plate)
    omega = np.einsum("wnij,i->wjn", c_nb, earth_rate_ned(latitude))
    omega[:, 2] += turning
    force = np.einsum("wnij,i->wjn", c_nb, [0.0, 0.0, -normal_gravity(latitude)])
    measured = []
    for triad, truth in ((imu.gyro, omega), (imu.accel, force)):
        rows = np.empty((count, n, 3))
        for w in range(count):
            errors = triad.draw_run(rng, triad.draw_unit(rng) | triad.draw_session(rng))
            block = round(interval / imu.dt)
            repeated = np.repeat(truth[w], block, axis=1)
            rows[w] = triad.measure_means(rng, repeated, errors, n, imu.dt, block).T
        measured.append(rows)
    angles = np.tile(angle.reshape(n, fine).mean(axis=1), (count, 1))
    late = 0.5 * imu.dt * turning  # an encoder is read at a sample's end
    gyro, accel = measured
    sensed = {"gyro": gyro, "accel": accel, "plate_angle": angles + late, "rate_hz": 1 / interval}
    return _labelled(psi, latitude, **sensed)


def swaying(
    count, duration_s, rate_hz, latitude_deg, tilt_deg, velocity, seed=0, turn=0.0
) -> Labelled:
    """A body of fixed attitude (or turning about its z axis) whose site moves at `velocity`,
    (count, n + 1, 3) in n."""
    rng = np.random.default_rng(seed)
    n, latitude = round(duration_s * rate_hz), np.deg2rad(latitude_deg)
    psi = rng.uniform(-np.pi, np.pi, count)
    base = euler_to_matrix(*np.deg2rad(tilt_deg), psi)
    angle = turn * (np.arange(n) + 0.5) / rate_hz
    c_nb = np.einsum("wij,njk->wnik", base, rotation_z(angle))
    omega = np.einsum("wnij,i->wnj", c_nb, earth_rate_ned(latitude))
    omega[..., 2] += turn
    force = np.diff(velocity, axis=1) * rate_hz - [0.0, 0.0, normal_gravity(latitude)]
    felt = np.einsum("wnij,wni->wnj", c_nb, force)
    plate = np.tile(turn * (np.arange(n) + 1.0) / rate_hz, (count, 1))
    return _labelled(psi, latitude, gyro=omega, accel=felt, plate_angle=plate, rate_hz=rate_hz)


def _labelled(heading, latitude, **sensed) -> Labelled:
    where, start_s = np.full(len(heading), latitude), np.zeros(len(heading))
    windows = Windows(**sensed, latitude=where, start_s=start_s)
    return Labelled(windows=windows, heading=heading, heading_reference=heading)
