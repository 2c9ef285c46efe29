"""The verdict whether north can be found at all, which stands before every table of headings or
errors.

It cannot be found where the floor, the least error to be expected of any estimator with this
sensor, course of the plate and window, is above 60 degrees: a guess has 104, and an answer with
such an error is no heading. The sensor is taken as it is stated. Where nothing is stated of its
bias, or where the log's own rates contradict what is stated, its bias is taken to be as large as
those rates show: with the plate at rest a recording's mean rate differs from Earth's by the bias,
of which a heading can explain one part.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbgc.data.checks.plausible import FIVE_SIGMA, PER_HOUR, mean_noise, residual, stated_errors
from lbgc.data.record import Record
from lbgc.data.windows import cut
from lbgc.earth import EARTH_RATE
from lbgc.errors import InputError
from lbgc.estimators.block_means import Course, Site, levelled
from lbgc.estimators.circle import CHANCE
from lbgc.estimators.floor import expected_floor
from lbgc.estimators.information import apart, budget, information
from lbgc.sensor import gaussian
from lbgc.sensor.datasheet import GyroConfig, ImuConfig
from lbgc.sensor.imu import ImuModel

MOST_DEG = 60.0
"""Largest floor, degrees, at which north can be found."""
_MEDIAN = np.sqrt(2 * np.log(2.0))
"""Median length of a vector of two standard normals: a rate's residual has two components that no
heading explains."""
_HEADINGS = np.deg2rad(np.arange(0.0, 360.0, 30.0))
_SHAKEN = 3.0  # ratio of scatters above which the base is said to move
_LEAST = 1e-5 * EARTH_RATE
"""Least uncertainty of a mean rate, rad/s, also of a rate without any noise."""
_RESTS = np.deg2rad(0.01)  # rad, travel up to which the plate rests


@dataclass(frozen=True)
class Verdict:
    """Whether windows of one length can find north."""

    window_s: float
    floor_deg: float
    """Expected RMSE of the Bayes-optimal estimator."""
    cause: str
    """The cause of errors that contributes most to the floor."""

    @property
    def can(self) -> bool:
        """Whether north can be found."""
        return self.floor_deg <= MOST_DEG


@dataclass(frozen=True)
class Evidence:
    """The evidence on the gyros' bias in the mean rates of resting recordings."""

    mean_rate: float
    """rad/s, length of the mean rate, root mean square over recordings"""
    vertical: float
    """rad/s, difference of the vertical rate from Earth's, likewise"""
    off: float
    """rad/s, difference of the rate from any that Earth could cause, likewise"""
    noise: float
    """rad/s, 1 sigma of the mean rate's own noise, an axis"""
    white: float
    """rad/sqrt(s), white noise by the scatter of means, of the length that shows least of it: a
    shaken base and counts average out faster than white noise, slow errors do not at all"""
    shaken: float
    """Scatter of means over a second or so, over the scatter by the stated noise, or by `white`
    where nothing is stated; 1 where it is explained"""
    chi: float
    """Chi-square of the difference `off` under what is stated of the sensor, mean over recordings;
    0 where nothing is stated"""

    @property
    def bias(self) -> float:
        """Size of one gyro's bias, rad/s, for which a difference `off` or larger has a probability
        of a half; not less than the noise, in which a bias could hide."""
        shown = np.sqrt(max(self.off**2 - 2 * self.noise**2, 0.0)) / _MEDIAN
        return float(max(shown, self.noise))

    @property
    def contradicts(self) -> bool:
        """Whether the difference `off` has a probability of less than one in a million under what
        is stated of the sensor."""
        return self.chi > FIVE_SIGMA


def evidence(records: Sequence[Record], imu: ImuModel | None) -> Evidence | None:
    """The evidence on the gyros' bias in those recordings whose plate rests; None where none does.
    imu : the stated sensor."""
    found = []
    for record in records:
        if np.ptp(record.plate_angle) > _RESTS:
            continue
        stated = None if imu is None else stated_errors(imu.gyro, record.duration_s)
        noise = mean_noise(record.gyro)
        rate, force = record.gyro.mean(axis=0), record.accel.mean(axis=0)
        sigma = np.sqrt(noise**2 + (0.0 if stated is None else stated**2) + _LEAST**2)
        chi, off = residual(rate, force, record.latitude, sigma)
        down = -force / np.linalg.norm(force)
        figures = np.linalg.norm(rate), down @ off, np.linalg.norm(off), np.mean(noise)
        found.append((*figures, *_white_noise(record), 0.0 if stated is None else chi))
    if not found:
        return None
    every = np.array(found, float)
    mean_rate, vertical, off, noise, white, at_once = np.sqrt(
        np.mean(every[:, :6] ** 2, axis=0)
    ).tolist()
    usual = 0.0 if imu is None else _stated_scatter(imu)
    shaken = at_once / (usual or white) if usual or white else 1.0
    return Evidence(mean_rate, vertical, off, noise, white, shaken, float(np.mean(every[:, 6])))


def _white_noise(record: Record) -> tuple[float, float]:
    """White noise, rad/sqrt(s), by the differences of neighbouring means: the least over several
    lengths of means, and that of the shortest length, a second or so."""
    shortest = max(1, min(round(record.rate_hz), len(record.gyro) // 32))
    found: list[float] = []
    while shortest * 2 ** len(found) * 16 <= len(record.gyro):
        size = shortest * 2 ** len(found)
        count = len(record.gyro) // size
        means = record.gyro[: count * size].reshape(count, size, 3).mean(axis=1)
        found.append(float(np.mean(np.diff(means, axis=0) ** 2) / 2 * size / record.rate_hz))
    return (float(np.sqrt(min(found))), float(np.sqrt(found[0]))) if found else (0.0, 0.0)


def _stated_scatter(imu: ImuModel) -> float:
    """The white noise, rad/sqrt(s), that `_white_noise` would find with this sensor by means over a
    second, root mean square over its axes."""
    every = [gaussian.covariance_of_means(t, 2, 1.0) for t in imu.gyro.terms_of_means(imu.dt) if t]
    return float(np.sqrt(sum(C[0, 0] - C[0, 1] for C in every) / 3))


def judged(
    imu: ImuModel,
    course: Course,
    site: Site,
    window_s: float,
    lean: tuple[float, float] = (0.0, 0.0),
) -> Verdict:
    """The verdict on windows of this length and course of the plate, for a sensor of this model, on
    a base that leans by roll and pitch, rad."""
    told = information(imu, course, site, lean=lean)
    floor = float(np.rad2deg(min(expected_floor(told), CHANCE)))
    parts = budget(imu, course, site, _HEADINGS, lean)
    return Verdict(window_s, floor, max(parts, key=lambda name: parts[name], default="nothing"))


def verdicts(imu: ImuModel, record: Record, windows_s: Sequence[float]) -> list[Verdict]:
    """The verdicts on the recording's first window of each length, s. Lengths are left out for
    which it is too short, or in whose window the plate never rests or turns evenly."""
    found = []
    for window_s in sorted(windows_s):
        try:
            windows = cut(record, window_s)
            if not len(windows):
                continue
            part = levelled(windows.rows(slice(0, 1)), imu.dt)[0]
            if part.course.blocks:
                roll, pitch = apart(part.base)[0][0].tolist()
                found.append(judged(imu, part.course, part.site, window_s, (roll, pitch)))
        except InputError:
            continue
    return found


def assumed(seen: Evidence, bias: float | None) -> ImuModel:
    """The model that is assumed for a sensor of which nothing is stated: white noise by the log's
    scatter, and this bias, rad/s, or where it is None the one by the log's own rates."""
    own = seen.bias if bias is None else bias
    gyro = GyroConfig(
        arw_deg_per_sqrt_h=float(np.rad2deg(seen.white) * 60),
        bias_run_deg_per_h=float(own * PER_HOUR),
    )
    return ImuConfig(name="assumed", gyro=gyro).model(100.0)


def as_seen(imu: ImuModel, seen: Evidence) -> ImuModel:
    """The sensor with its run bias raised to the size that the log's own rates show, where less is
    stated."""
    size = np.maximum(imu.gyro.bias("run"), np.abs(seen.bias))
    return replace(imu, gyro=imu.gyro.with_bias(run=tuple(size.tolist())))


def said(
    name: str, sensor: str | None, found: Sequence[Verdict], seen: Evidence | None
) -> list[str]:
    """The verdicts in plain sentences. name : of the dataset or log; sensor : its name, where it is
    known; found : by window length."""
    lines = []
    whose = name if sensor is None else f"{name} with {sensor}"
    for can in (False, True):
        own = [v for v in found if v.can == can]
        if not own:
            continue
        lengths = ", ".join(f"{v.window_s:g}" for v in own)
        floors = ", ".join(f"{v.floor_deg:.3g}" for v in own)
        least = f"the least RMSE to be expected on a base that is still is {floors} degrees"
        if can:
            lines.append(f"North can be found: {whose}, windows of {lengths} s: {least}")
            continue
        causes = " and ".join(dict.fromkeys(v.cause for v in own)).replace(
            "bias of", "gyros' bias of"
        )
        lines.append(
            f"North CANNOT be found: {whose}, windows of {lengths} s: {least}, by chance it is "
            f"{np.rad2deg(CHANCE):.0f}, and above {MOST_DEG:g} there is no heading. What makes "
            f"most of it: {causes}" + (f"; {_rates(seen)}" if seen is not None else "")
        )
    return lines


def _rates(seen: Evidence) -> str:
    """The log's mean rate beside Earth's, in words."""
    return (
        f"mean rate {seen.mean_rate * PER_HOUR:.4g} deg/h where {EARTH_RATE * PER_HOUR:.4g} is "
        "Earth's"
    )


def about(
    seen: Evidence | None, imu: ImuModel | None, sensor: str | None, limit: float | None
) -> list[str]:
    """Sentences on the sensor that the verdict assumes, where it is not simply the stated one, and
    on a base that moves. limit : rad/s, 1 sigma of the bias by the user's limit."""
    if seen is None:
        return []
    lines = []
    if seen.shaken > _SHAKEN:
        than = "longer ones explain" if imu is None else f"is stated of {sensor}"
        lines.append(
            f"The base moves, or the sensor is shaken or another one: means over a second scatter "
            f"{seen.shaken:.3g} times more than {than}. mean and triad take a base for "
            "resting: their sigmas are as wide as the motion that each window shows; oba and ekf "
            "are made for one that sways"
        )
    return lines + _about_bias(seen, imu, sensor, limit)


def _about_bias(
    seen: Evidence, imu: ImuModel | None, sensor: str | None, limit: float | None
) -> list[str]:
    """The sentence on the bias that the verdict assumes, where it is not the stated one."""
    off = (
        f"the mean rate differs from any that Earth could cause by {seen.off * PER_HOUR:.3g} deg/h "
        f"(the vertical one by {seen.vertical * PER_HOUR:.3g})"
    )
    if imu is None:
        bias = (
            f"a bias of {seen.bias * PER_HOUR:.3g} deg/h an axis, for {off}; what of a bias lies "
            "along the heading no log at rest shows"
            if limit is None
            else f"a bias of {limit * PER_HOUR:.3g} deg/h an axis, log.bias_limit_deg_per_h over "
            "sqrt(3)"
        )
        noise = f"{np.rad2deg(seen.white) * 60:.3g} deg/sqrt(h), as this log scatters"
        return [f"no sensor is named (imu=NAME): the verdict assumes white noise of {noise}, "
                f"and {bias}"]  # fmt: skip
    if stated_errors(imu.gyro, 1.0) is None:
        return [
            f"NO BIAS IS STATED of {sensor}: floor, gls and every sigma take it as zero, and are "
            f"too small by whatever it is. The verdict assumes {seen.bias * PER_HOUR:.3g} deg/h an "
            f"axis, for {off}"
        ]
    if seen.contradicts:
        return [
            f"THIS LOG SPEAKS AGAINST what is stated of {sensor}: {off}, "
            f"{np.sqrt(seen.chi):.1f} sigma of what is stated. Sigmas and floor in the table are "
            f"too small; the verdict takes a bias of {seen.bias * PER_HOUR:.3g} deg/h an axis"
        ]
    return []


def reached(
    name: str,
    sensor: str | None,
    imu: ImuModel | None,
    records: Sequence[Record],
    windows_s: Sequence[float],
    doubted: bool,
    limit: float | None = None,
) -> tuple[list[Verdict], list[str]]:
    """The verdicts on windows of these recordings, and the sentences that state them.

    name : of the dataset or log; sensor, imu : the stated sensor's name and model, where one is
    stated; records : some of the recordings, of which the longest gives the plate's course;
    doubted : whether the statement may be wrong, as it may for every sensor but a simulation's own;
    limit : rad/s, 1 sigma of the bias by the user's limit where no sensor is named.
    """
    seen = evidence(records, imu) if doubted else None
    notes = about(seen, imu, sensor, limit)
    law = imu
    if seen is not None:
        if imu is None:
            law = assumed(seen, limit)
        elif seen.contradicts or stated_errors(imu.gyro, 1.0) is None:
            law = as_seen(imu, seen)
    if law is None:
        return [], notes
    longest = max(records, key=lambda record: record.duration_s)
    found = verdicts(law, longest, windows_s)
    return found, [*said(name, sensor, found, seen), *notes]
