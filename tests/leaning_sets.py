"""Sets of resting recordings on a base that leans, as calibration gets them; and datasheets' Allan
minima as presets simulate them. For tests and the study `realworld`."""

from collections.abc import Iterator

import numpy as np
from helpers import default_config

from lbgc import calibrate
from lbgc.data.record import Record
from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.errors import InputError
from lbgc.frames import euler_to_matrix, matrix_to_euler
from lbgc.sensor.allan import overlapping_deviation
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.errors import Drawn
from lbgc.sensor.imu import ImuModel, Triad
from lbgc.units import factor

MEAN_S = 5.0


def recordings(
    imu: ImuModel,
    rng: np.random.Generator,
    roll_deg: float,
    pitch_deg: float,
    heading: np.ndarray,
    *,
    latitude_deg: float = 48.1,
    duration_s: float = 240.0,
    session: np.ndarray | None = None,
    turned: bool = True,
) -> list[Record]:
    """Means of 5 s of one unit, at these headings (R,), rad, on a base with this roll and pitch.

    turned : the base stays and a plate turns the sensor on it, so that the lean is Earth-fixed and
    roll and pitch differ from heading to heading; else the sensor leans likewise at each.
    """
    latitude, count = float(np.deg2rad(latitude_deg)), len(heading)
    roll, pitch = np.deg2rad([roll_deg, pitch_deg])
    if turned:
        base = euler_to_matrix(roll, pitch, 0.0)
        c_nb = base @ euler_to_matrix(0.0, 0.0, heading)
    else:
        c_nb = euler_to_matrix(roll, pitch, heading)
    reference = matrix_to_euler(c_nb)[2]
    labels = np.zeros(count, int) if session is None else np.unique(session, return_inverse=True)[1]
    n, block = round(duration_s / MEAN_S), round(MEAN_S / imu.dt)
    printed = []
    for triad, vector in (
        (imu.gyro, earth_rate_ned(latitude)),
        (imu.accel, np.array([0.0, 0.0, -normal_gravity(latitude)])),
    ):
        truth = np.einsum("rij,i->rj", c_nb, vector)[..., None]
        drawn = triad.draw_run(rng, _lasting(triad, rng, labels))
        means = triad.measure_means(rng, truth, drawn, n, imu.dt, block)
        printed.append(np.moveaxis(means, 1, 2))
    return [
        Record(
            name=f"recording {i}",
            gyro=gyro,
            accel=accel,
            plate_angle=np.zeros(n),
            rate_hz=1 / MEAN_S,
            latitude=latitude,
            heading_reference=float(psi),
        )
        for i, (gyro, accel, psi) in enumerate(zip(*printed, reference, strict=True))
    ]


def _lasting(triad: Triad, rng: np.random.Generator, session: np.ndarray) -> Drawn:
    """One unit's errors, and each session's, one row a recording."""
    unit = triad.draw_unit(rng)
    own = [triad.draw_session(rng)["bias_session"] for _ in range(int(session.max()) + 1)]
    each = {name: np.repeat(c[None], len(session), axis=0) for name, c in unit.items()}
    return each | {"bias_session": np.stack(own)[session]}


def without_gain(preset: str, rate_hz: float = 100.0) -> ImuModel:
    """This sensor, its scale and misalignment errors zero and its biases as they are."""
    keys = [f"imu.{t}.{k}=0" for t in ("gyro", "accel")
            for k in ("scale_unit_ppm", "misalignment_unit_mrad")]  # fmt: skip
    return default_config(f"imu={preset}", *keys).imu.model(rate_hz)


def outcomes(
    sets: int,
    roll_deg: float,
    pitch_deg: float,
    *,
    presets: tuple[str, ...] = ("sdc500", "stim300"),
    count: int = 24,
    seed: int = 16,
) -> Iterator[np.ndarray | None]:
    """Of each simulated set whose scale and misalignment are zero: whether the 95% intervals hold
    it, bool (2, 2); None where the set is refused. Sensors and both ways of leaning take turns."""
    models = [without_gain(preset) for preset in presets]
    for i in range(sets):
        rng = np.random.default_rng([seed, i])
        heading = rng.uniform(0, 2 * np.pi) + np.arange(count) * 2 * np.pi / count
        imu, turned = models[i % len(models)], bool(i // len(models) % 2)
        try:
            drawn = recordings(imu, rng, roll_deg, pitch_deg, heading, turned=turned)
            found = calibrated(drawn)
        except InputError:
            yield None
            continue
        low, high = found.matrix_interval
        yield (low <= 0) & (high >= 0)


def calibrated(records: list[Record], session: np.ndarray | None = None):
    """As the command does it, with its checks."""
    given = calibrate.given_of(records, "simulated", session)
    calibrate.require_sound(given)
    means = given.means
    return calibrate.calibrate(means.rates, means.heading, means.latitude, session, given.tilt)


def leaning_coverage_percent(sets: int, roll_deg: float, pitch_deg: float) -> tuple[float, int]:
    """Share of the 95% intervals of scale and misalignment that hold the truth, percent, and how
    many sets were refused."""
    every = list(outcomes(sets, roll_deg, pitch_deg))
    held = [each for each in every if each is not None]
    return 100 * float(np.mean(held)), len(every) - len(held)


MINIMA = {
    "allan_minimum_deg_per_h": "gyro",
    "allan_minimum_ug": "accel",
    "allan_minimum_mg": "accel",
}


def preset_minima(preset: str, recordings: int = 1000, hours: float = 4.0) -> dict[str, np.ndarray]:
    """Each printed Allan minimum of a preset against that of simulated recordings, percent off,
    (3,) a key: pooled overlapping Allan deviations of means of 10 s, between 10 s and an hour."""
    config: ImuConfig = default_config(f"imu={preset}").imu
    imu, off = config.model(100.0), {}
    rng = np.random.default_rng(952)
    for key, part in MINIMA.items():
        sheet = getattr(getattr(config, part), key, None)
        if sheet is None:
            continue
        triad: Triad = getattr(imu, part)
        interval = 10.0
        n = round(hours * 3600 / interval)
        drawn = triad.sample_noise(rng, recordings, n, interval)
        taus = np.unique(np.round(np.geomspace(1, 360, 25))) * interval
        lowest = overlapping_deviation(drawn, interval, taus).min(axis=1) / factor(key)
        off[key] = 100 * (lowest / np.broadcast_to(sheet, 3) - 1)
    return off
