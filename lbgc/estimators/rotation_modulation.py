"""North from an IMU that a plate turns: biases turn with the body, Earth's rate does not.

Each has a plain form (least squares, every block alike, biases free) and a weighted one (the same
unknowns, weighted by the covariance of the sensor's errors). All work in both hemispheres, and on a
base that leans by up to 10 degrees. The plain ones need no latitude for the heading, and pay for
it: on a lean they level the vertical gyro's errors into the horizontal rates, where no turn of the
plate tells them from north. The weighted ones know Earth's vertical rate by the latitude, and take
each slew's mean as well, where it fits the sensor's model. About a level axis both take the gyro
along it as it is, by the size of its bias (see lbgc.estimators.level_axis).
"""

from collections.abc import Callable

import numpy as np

from lbgc.data.windows import Windows
from lbgc.estimators.block_means import Course, Levelled
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.estimators.least_squares import answer, needs_model, weighted
from lbgc.estimators.level_axis import plain
from lbgc.frames import AXES, DOWN, wrap
from lbgc.sensor.imu import ImuModel

_SAME = np.deg2rad(1.0)
"""Angle, rad, within which two rests count as one position."""
Choose = Callable[[str, Course], np.ndarray]
"""A function of the estimator's name and a course: which parts of the course the estimator uses,
bool (n,). Raises InputError at a course that the estimator cannot use."""


def two_positions(name: str, course: Course) -> np.ndarray:
    """The rests of a course at two angles half a turn apart, bool (n,). Raises InputError at any
    other course."""
    dwells = _dwells(course)
    if len(dwells) != 2 or abs(abs(wrap(dwells[1] - dwells[0])) - np.pi) > _SAME:
        raise refusal(name, np.rad2deg(dwells).round(1).tolist(), "deg",
                      "are the plate's rests; it takes two, half a turn apart")  # fmt: skip
    return course.resting


def positions(name: str, course: Course) -> np.ndarray:
    """The rests of a course at three or more angles, bool (n,). Raises InputError where it has
    fewer."""
    dwells = _dwells(course)
    if len(dwells) < 3:
        raise refusal(name, np.rad2deg(dwells).round(1).tolist(), "deg",
                      "are the plate's rests; it takes three or more")  # fmt: skip
    return course.resting


def turning(name: str, course: Course) -> np.ndarray:
    """The even turns of a course, bool (n,). Raises InputError where the plate travels less than
    half a turn, or turns evenly in fewer than five blocks."""
    travel = float(np.ptp(course.angle)) if course.angle else 0.0
    steady = ~course.resting & ~course.slewing
    if travel < np.pi or steady.sum() < 5:
        about = "of plate travel; it takes half a turn or more, at a steady rate"
        raise refusal(name, f"{np.rad2deg(travel):.3g}", "deg", about)
    return np.asarray(steady)


def _dwells(course: Course) -> np.ndarray:
    """Angles at which the plate rests, rad, ascending."""
    angles = np.array(course.angle)[course.resting]
    if len(angles) == 0:
        return np.asarray(angles)
    new = np.abs(np.diff(angles, prepend=angles[0] + 1)) > _SAME
    return np.unique(angles[new].round(3))


def _estimator(
    name: str,
    choose: Choose,
    windows: Windows,
    imu: ImuModel | None,
    weigh: bool,
    checked: bool = True,
) -> Estimate:
    """The answers of an estimator that uses the parts that `choose` gives; weigh : whether they are
    weighted by the sensor's covariance, and slews used too; checked : see `weighted`."""

    def each(part: Levelled) -> Estimate:
        chosen = choose(name, part.course)
        if weigh:
            own = part.only(chosen | part.course.slewing)
            return weighted(name, own, needs_model(name, imu), True, checked)
        level = part.course.axis != DOWN
        if level and imu is None:
            what = f"is not known: the gyro {AXES[part.course.axis]}, about which the plate turns, "
            what += "keeps its bias, and only the bias's size tells how far to trust it; give one "
            raise refusal(name, "imu", "", what + "of conf/imu, or fit yours (python lbgc/fit.py)")
        return plain(part.only(chosen), True, imu)

    return answer(windows, imu, each, name)


def two_position(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """Maytagging: north by half the difference of the mean rates at two rests half a turn apart,
    which is free of bias (Prikhodko et al. 2013, "What is MEMS gyrocompassing?")."""
    return _estimator("two_position", two_positions, windows, imu, False)


def two_position_weighted(
    windows: Windows, imu: ImuModel | None = None, *, checked: bool = True
) -> Estimate:
    """Maytagging weighted by the noise model, with the unknowns of `two_position`. Neighbouring
    blocks share their drift, so those next to the slew weigh most."""
    return _estimator("two_position_weighted", two_positions, windows, imu, True, checked)


def cosine_fit(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """North by a cosine's amplitude, phase and bias, fitted to the rates at three or more rests
    (Tian et al. 2020)."""
    return _estimator("cosine_fit", positions, windows, imu, False)


def cosine_fit_weighted(
    windows: Windows, imu: ImuModel | None = None, *, checked: bool = True
) -> Estimate:
    """The cosine fit weighted by the noise model, with the unknowns of `cosine_fit`."""
    return _estimator("cosine_fit_weighted", positions, windows, imu, True, checked)


def carousel(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """North by a sine, a cosine and a bias, fitted to the rates on a carousel at its frequency
    (Renkoski 2008; Johnson et al. 2010). It takes whole turns or parts of one, in either sense."""
    return _estimator("carousel", turning, windows, imu, False)


def carousel_weighted(
    windows: Windows, imu: ImuModel | None = None, *, checked: bool = True
) -> Estimate:
    """The carousel's fit weighted by the noise model, with the unknowns of `carousel`."""
    return _estimator("carousel_weighted", turning, windows, imu, True, checked)
