"""The best that physics allows: the Bayes-optimal estimate of windows, and what to expect of it.

Two bounds, both of the Gaussian model that `lbgc.estimators.posterior` states:

- `crlb`, in closed form: the van Trees bound, errors being small against the circle. It is quoted
  only below 6 degrees; above, angles no longer behave like lengths.
- `floor`: the Bayes-optimal estimator itself (flat prior on the circle, circular mean of the
  posterior). Its RMSE on a set of windows is the least that any estimator can have on windows drawn
  by that model, and "over the floor" means over this, on the same windows.

Both use everything that gyros and accelerometers say: rests, steady motion, and each slew from rest
to rest, whose known angle shows the effect of misalignment and scale factor. The base may lean: the
latitude and the vertical gyro tell how much of Earth's vertical rate that adds to the horizontal
gyros.
"""

import numpy as np

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE
from lbgc.errors import require
from lbgc.estimators.block_means import MOST_BLOCKS, Course, Levelled
from lbgc.estimators.estimate import Estimate
from lbgc.estimators.information import Information, check_fit, fitted
from lbgc.estimators.least_squares import answer, needs_model
from lbgc.estimators.posterior import AS_LENGTHS, across, along, bayes
from lbgc.frames import AXES, wrap
from lbgc.protocol import ProtocolConfig, plan
from lbgc.sensor import streams
from lbgc.sensor.imu import ImuModel

HEADINGS = np.deg2rad(np.arange(0.0, 360.0, 10.0))
"""rad, over which errors are averaged."""
DRAWS = 3000
"""Number of draws of a heading and its data in `expected_floor`."""
_LINEAR = np.deg2rad(20.0)
"""Standard deviation of a heading, rad, below which errors are close to linear ones."""
SETTLE_S = 1.6
"""Time that the servo of sim/ takes to bring the plate to rest after a slew, s."""


def white_crlb(N: float, latitude: float, duration_s: float) -> float:
    """Least standard deviation of the heading, rad, under white rate noise alone:
    N/(Omega cos(lat) sqrt(T)), the paper's case.

    N : rad/sqrt(s); latitude : rad.
    """
    return float(N / (EARTH_RATE * np.cos(latitude) * np.sqrt(duration_s)))


def crlb(told: Information) -> float:
    """The van Trees bound: RMS over headings of the least standard deviation, rad; NaN above 6
    degrees, or where errors are not linear."""
    rms = float(np.sqrt(small_errors(told)))
    return rms if rms < AS_LENGTHS and is_linear(told) else float("nan")


def is_linear(told: Information) -> bool:
    """Whether a heading's errors are linear in the data's. At headings along which J is least, what
    J tells across them bends log p by its own share, of order sqrt(largest)/smallest eigenvalue:
    the heading's standard deviation where both are equal, and more about a level axis, along which
    a bias stays."""
    least, most = np.linalg.eigvalsh(told.J[0])
    return bool(np.sqrt(most) < AS_LENGTHS * least)


def expected_floor(told: Information, draws: int = DRAWS) -> float:
    """Expected RMSE of the Bayes-optimal estimator, rad, over headings and over the law of h,
    Normal(J q, J), which is all that the data tell. By seeded draws, to about 1%.

    Small errors are nearly n'(h - J q)/(n' J n), whose mean square is known. So only the difference
    between the two is averaged over draws, which scatters far less.
    """
    rng = streams.figures()
    psi = rng.uniform(-np.pi, np.pi, draws)
    q, n = along(psi), across(psi)
    J = told.J[0]
    values, vectors = np.linalg.eigh(J)
    noise = rng.standard_normal((draws, 2)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    square = wrap(bayes(q @ J + noise, J).heading - psi) ** 2
    sigma = told.sigma(psi)
    if np.max(sigma) < _LINEAR:
        linear = np.sum(n * noise, axis=1) * sigma**2
        square = square - linear**2 + small_errors(told)
    else:  # about a horizontal axis north is sharp at some headings, and hidden at others
        near = sigma < _LINEAR
        linear = np.sum(n[near] * noise[near], axis=1) * sigma[near] ** 2
        square[near] += sigma[near] ** 2 - linear**2
    return float(np.sqrt(np.mean(square)))


def floor(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """The Bayes-optimal estimate of windows, from the means of at most 240 blocks at rest or in
    steady motion. What is known of the sensor is taken out of both (`ImuModel.without`).

    Slews enter by their means from rest to rest, where these fit the sensor's model. The plate's
    axis is taken as true: one that wobbles by some arcseconds turns the slews' rates by less than
    the check of that fit catches, and costs a tenth of the accuracy where there are many slews.

    Raises InputError where a window's data scatter far more than the model says: on a base that
    sways this estimate is not optimal, and no floor.
    """
    model = needs_model("floor", imu)

    def each(part: Levelled) -> Estimate:
        found = fitted(model, part)
        check_fit("floor", part.course, found.misfit)
        return bayes(found.h, found.J)

    return answer(windows, model, each, "floor")


def course_of(
    config: ProtocolConfig, duration_s: float, start_s: float = 0.0, settle_s: float = 0.0
) -> Course:
    """The course of a window that holds the whole protocol.

    duration_s, start_s : s, the window's length, and its start in the recording; settle_s : s, what
    the servo takes to bring the plate to rest after each slew. Raises InputError where the window
    is too short to leave a rest between slews.
    """
    about = "has no plate, and this is the bound of a plate's course; tumble=[6] has that of poses"
    require(config.kind != "tumble", "protocol.kind", config.kind, about)
    planned = plan(config, 0, duration_s)
    fine = 40
    interval = duration_s / MOST_BLOCKS
    middles = (np.arange(MOST_BLOCKS * fine) + 0.5) * interval / fine
    angle = planned.command(middles)[0]
    ends = np.array([move.end_s for move in planned.moves])[:, None]
    begin = np.arange(MOST_BLOCKS) * interval
    over = (begin + interval > ends) & (begin < ends + settle_s)
    settling = np.asarray(over.any(axis=0))
    course = Course.planned(angle - planned.start, interval, start_s, fine, settling,
                            axis=AXES.index(config.axis))  # fmt: skip
    require(len(course.blocks) > 1, "windows_s", duration_s, "leaves no rest between the slews")
    return course


def small_errors(told: Information) -> float:
    """Mean square over headings of the heading's error, rad^2, in the limit of errors that are
    small against the circle."""
    return float(np.mean(told.sigma(HEADINGS) ** 2))
