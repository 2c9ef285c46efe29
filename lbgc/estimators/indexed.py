"""North from an IMU that a plate turns: what turns with the body is its bias, what does not, north.

Each has a plain form (least squares, every block alike, biases free) and a weighted one (the same
unknowns, weighted by the covariance of the sensor's errors). They need no latitude for the heading,
work in both hemispheres, and take a base that leans by up to 10 degrees; beyond that a vertical
gyro's errors, which their sigma does not have, turn the heading.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from lbgc.data.windows import Windows
from lbgc.earth import heading_exists, normal_gravity
from lbgc.estimators.course import Course, Levelled, levelled
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.estimators.information import Site, covariance, information, likeliest, turn
from lbgc.frames import wrap
from lbgc.sensor.imu import ImuModel

LEANS = np.deg2rad(10.0)
_SAME = np.deg2rad(1.0)
Choose = Callable[[str, Course], np.ndarray]
"""Which blocks of a course an estimator takes, bool (n,). Raises InputError at one that it cannot
use; it is told its own name."""


def answer(
    windows: Windows,
    imu: ImuModel | None,
    each: Callable[[Levelled, Site], Estimate],
    name: str,
) -> Estimate:
    """What `each` makes of the windows, course by course, in the windows' order."""
    check(name, windows)
    heading, sigma = np.empty(len(windows)), np.empty(len(windows))
    for part in levelled(windows, None if imu is None else imu.dt):
        if not part.course.blocks:
            raise refusal(name, "the plate", "", "never rests or turns steadily in a window")
        if part.tilt.max() > LEANS:
            about = f"of lean; it takes a base within {np.rad2deg(LEANS):g} degrees of level"
            raise refusal(name, f"{np.rad2deg(part.tilt.max()):.3g}", "deg", about)
        latitude = float(windows.latitude[part.rows[0]])
        found = each(part, Site(latitude, normal_gravity(latitude)))
        heading[part.rows], sigma[part.rows] = found.heading, found.sigma
    return Estimate(heading, sigma)


def check(name: str, windows: Windows) -> None:
    """Raise InputError where a window has no heading to find, or no accelerometer to level by."""
    if not heading_exists(windows.latitude).all():
        raise refusal(name, "a pole", "", "has no north: Earth's rate is vertical there")
    if not np.abs(windows.accel).max(initial=0.0) > 0:
        raise refusal(name, "accel", "", "is zero throughout: without accelerometers nothing is "
                      "level")  # fmt: skip


def needs_model(name: str, imu: ImuModel | None) -> ImuModel:
    if imu is None:
        raise refusal(name, "imu", "", "is not known: weighting needs the sensor's noise model; "
                      "give one of conf/imu, or fit yours (python lbgc/fit.py)")  # fmt: skip
    return imu


@lru_cache(maxsize=64)
def plain_weights(course: Course, site: Site, bias: bool) -> np.ndarray:
    """Least squares: (2, 4, n), weights that make (cos psi, sin psi) of the data.

    The rates are levelled by the mean force in the base's axes, rate - force Omega sin(lat)/g,
    and fitted by amplitudes along and across (Tian 2020's cosine) and, if asked for, a bias an
    axis. An amplitude that is free takes the scale factor out of the heading.
    """
    design = turn(course, site)
    n = design.shape[1]
    columns = 4 if bias else 2
    full = np.zeros((2, n, columns))
    full[..., :2] = design[:2, :, :2]
    if bias:
        full[0, :, 2] = full[1, :, 3] = 1.0
    fit = np.linalg.pinv(full.reshape(2 * n, columns))[:2].reshape(2, 2, n)
    weights = np.zeros((2, 4, n))
    weights[:, :2] = fit
    tilts = design[2:, :, 2:]  # force = tilts x t, whose least squares is the mean in base axes
    tilt = np.linalg.pinv(tilts.reshape(2 * n, 2)).reshape(2, 2, n)
    of_tilt = np.einsum("ian,anj->ij", fit, design[:2, :, 2:])
    weights[:, 2:] = -np.einsum("ij,jan->ian", of_tilt, tilt)
    return weights


def plain(part: Levelled, site: Site, bias: bool, imu: ImuModel | None) -> Estimate:
    """The heading by `plain_weights`, and its sigma: of this linear form under the sensor's
    covariance where that is known; else of white noise as large as what the fit leaves."""
    weights = plain_weights(part.course, site, bias)
    z = np.einsum("ian,van->vi", weights, part.data)
    heading = np.arctan2(z[:, 1], z[:, 0])
    across = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    if imu is not None:
        C = covariance(imu, part.course, site)
        spread = np.einsum("ian,anm,jam->ij", weights, C, weights)
        variance = np.einsum("vi,ij,vj->v", across, spread, across)
    else:
        variance = _white_variance(part, site, bias, weights, z, across)
    size = np.linalg.norm(z, axis=1)
    return Estimate(wrap(heading), np.sqrt(variance) / size)


def _white_variance(
    part: Levelled, site: Site, bias: bool, weights: np.ndarray, z: np.ndarray, across: np.ndarray
) -> np.ndarray:
    """Variance across, (V,), if every block's rate had an independent error."""
    n = part.data.shape[2]
    left = part.data[:, :2] - np.einsum("ani,vi->van", turn(part.course, site)[:2, :, :2], z)
    if bias:
        left = left - left.mean(axis=2, keepdims=True)
    free = 2 * n - 2 - 2 * bias
    white = np.sum(left**2, axis=(1, 2)) / free if free > 0 else np.full(len(z), np.nan)
    return np.asarray(white * np.sum(np.einsum("vi,ian->van", across, weights[:, :2]) ** 2, (1, 2)))


def weighted(part: Levelled, site: Site, imu: ImuModel, free_bias: bool) -> Estimate:
    told = information(imu, part.course, site, free_bias)
    return likeliest(told.told(part.data), told.J, told)


def two_positions(name: str, course: Course) -> np.ndarray:
    dwells = _dwells(course)
    if len(dwells) != 2 or abs(abs(wrap(dwells[1] - dwells[0])) - np.pi) > _SAME:
        raise refusal(name, np.rad2deg(dwells).round(1).tolist(), "deg",
                      "are the plate's rests; it takes two, half a turn apart")  # fmt: skip
    return course.resting


def positions(name: str, course: Course) -> np.ndarray:
    dwells = _dwells(course)
    if len(dwells) < 3:
        raise refusal(name, np.rad2deg(dwells).round(1).tolist(), "deg",
                      "are the plate's rests; it takes three or more")  # fmt: skip
    return course.resting


def turning(name: str, course: Course) -> np.ndarray:
    travel = float(np.ptp(course.angle)) if course.angle else 0.0
    steady = ~course.resting
    if travel < np.pi or steady.sum() < 5:
        about = "of plate travel; it takes half a turn or more, at a steady rate"
        raise refusal(name, f"{np.rad2deg(travel):.3g}", "deg", about)
    return steady


def _dwells(course: Course) -> np.ndarray:
    """Angles at which the plate rests, in their order, rad."""
    angles = np.array(course.angle)[course.resting]
    if len(angles) == 0:
        return angles
    new = np.abs(np.diff(angles, prepend=angles[0] + 1)) > _SAME
    return np.unique(angles[new].round(3))


def _estimator(
    name: str, choose: Choose, windows: Windows, imu: ImuModel | None, weigh: bool
) -> Estimate:
    def each(part: Levelled, site: Site) -> Estimate:
        chosen = choose(name, part.course)
        own = Levelled(part.course.only(chosen), part.rows, part.data[:, :, chosen], part.tilt)
        if weigh:
            return weighted(own, site, needs_model(name, imu), free_bias=True)
        return plain(own, site, True, imu)

    return answer(windows, imu, each, name)


def two_position(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Maytagging: half the difference of the mean rates at two rests half a turn apart has no bias
    (Prikhodko et al. 2013, "What is MEMS gyrocompassing?")."""
    return _estimator("two_position", two_positions, windows, imu, False)


def two_position_weighted(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """The same unknowns, weighted by the noise model: near blocks share their drift, so those
    about the slew tell most."""
    return _estimator("two_position_weighted", two_positions, windows, imu, True)


def cosine_fit(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Amplitude, phase and bias of the rates at three or more rests (Tian et al. 2020)."""
    return _estimator("cosine_fit", positions, windows, imu, False)


def cosine_fit_weighted(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    return _estimator("cosine_fit_weighted", positions, windows, imu, True)


def carousel(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """The rates' sine and cosine at the carousel's frequency, and a bias (Renkoski 2008; Johnson et
    al. 2010). It takes whole turns or not, either way."""
    return _estimator("carousel", turning, windows, imu, False)


def carousel_weighted(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    return _estimator("carousel_weighted", turning, windows, imu, True)
