"""North from poses: an IMU held at rest in several attitudes, headings unknown, no turntable.

In each pose gravity gives the attitude but for the heading, and Earth's rate gives its vertical
part and the size of its horizontal part. What errs is the same in all poses, so that together they
tell the gyros' bias, and where the latitude is not known, that too. See
lbgc.estimators.pose_information for the model, and lbgc.estimators.torus for its posterior.
"""

from dataclasses import dataclass

import numpy as np

from lbgc.data.poses import Poses
from lbgc.errors import InputError
from lbgc.estimators.held import Held, anew, held
from lbgc.estimators.pose_information import Form, form
from lbgc.estimators.torus import PARTICLES, Mixture, Torus, mixture, particles
from lbgc.estimators.untold import untold
from lbgc.frames import about_vertical, rotation_matrix, rotation_z, wrap
from lbgc.sensor import streams
from lbgc.sensor.imu import ImuModel

_NOTHING = 0.6
"""Share of the circle that 95% of a heading's probability takes, above which it is not known."""
_ANYWHERE = 2.0
"""rad, width of a latitude's interval above which it is not known. Near a pole it is told, and
headings are not."""
_ROUNDS, _LEVEL = 5, 1e-4
"""Most times that the model is made anew, and the levels' change, rad, that ends it."""
_LEAST_WEIGHT = 0.005
"""Of a way to hold the headings that is reported."""


@dataclass(frozen=True, eq=False)
class Mode:
    """One way to hold the headings."""

    heading: np.ndarray
    """(P,), rad, the likeliest"""
    latitude: float | None
    """rad; None where it was known"""
    weight: float
    """Its share of the probability"""


@dataclass(frozen=True, eq=False)
class Tumbled:
    """What P poses tell."""

    heading: np.ndarray
    """(P,), rad in (-pi, pi], yaw of the z-y-x Euler angles; of a body whose forward axis is
    vertical it depends on roll, and `attitude` is what counts"""
    sigma: np.ndarray
    """(P,), rad, of each heading, or of the attitude's turn about the vertical"""
    attitude: np.ndarray
    """(P, 3, 3), C_nb"""
    modes: tuple[Mode, ...]
    """Ways to hold the headings, the likeliest first"""
    bias: np.ndarray
    """(3,), rad/s, the gyros' constant bias, beyond what was known of the unit"""
    bias_covariance: np.ndarray
    """(3, 3), (rad/s)^2"""
    latitude: float | None
    """rad, posterior mean; None where it was known"""
    latitude_interval: tuple[float, float] | None
    """rad, 95%, with equal tails"""
    notes: tuple[str, ...]
    """What cannot be told, and which poses would tell it"""


def tumble(
    poses: Poses, imu: ImuModel, hemisphere: str = "either", count: int = PARTICLES
) -> Tumbled:
    """The posterior of poses' headings, and of what is constant in the session.

    imu : the sensor's model; where it is told of a unit (lbgc.sensor.unit) the means are off the
    log already. hemisphere : either, north or south: where an unknown latitude is. count : number
    of draws that stand for the posterior.

    Raises InputError where the poses tell no heading, by the name of what cannot be told apart.
    """
    return answered(held(poses, imu), imu, hemisphere, count)


def solved(of: Held, imu: ImuModel, hemisphere: str) -> tuple[Held, Form, Mixture]:
    """Poses with their levels as all data tell them, what they tell, and the maxima of it.

    The model is linear about levels and headings: it is made anew about what was found until the
    levels stay where they are, at least once, turns by what is known of the sensor by then. Sensors
    that err by percents need that.
    """
    own = form(of, imu)
    first = Torus(own, hemisphere)
    found = mixture(first, first.starts(streams.figures()))
    for _ in range(_ROUNDS):
        best = found.modes[0]
        v = found.torus.v(best)
        tilt = own.tilt - own.tilt_by @ v
        about = rotation_matrix(np.pad(tilt, ((0, 0), (0, 1))))
        of = anew(of, imu, about @ of.base, own.errors(v))
        own = form(of, imu, best[: of.count], float(best[-1]) if first.free else None)
        found = mixture(Torus(own, hemisphere), found.modes)
        if np.abs(tilt).max() < _LEVEL:
            break
    return of, own, found


def answered(
    of: Held, imu: ImuModel, hemisphere: str = "either", count: int = PARTICLES
) -> Tumbled:
    """The same of poses as lbgc.estimators.held has them."""
    of, own, about = solved(of, imu, hemisphere)
    found = particles(about, count)
    heading, sigma = found.mean_and_spread(of.count)
    notes = untold(of, imu, sigma)
    wide = bool((found.covered(of.count) > _NOTHING).all())
    latitude, interval = None, None
    if about.torus.free:
        latitude = float(found.weight @ found.theta[:, -1])
        interval = _interval(found.theta[:, -1], found.weight)
    if wide and (interval is None or interval[1] - interval[0] > _ANYWHERE):
        why = "; ".join(notes) or "this sensor's errors are too large for it"
        raise InputError("poses", of.count, "", f"tell no heading: {why}")
    nearest = about.distance(found.theta).argmin(axis=1)
    share = np.bincount(nearest, found.weight, len(about.modes))
    modes = tuple(
        Mode(
            wrap(about.modes[k, : of.count]),
            float(about.modes[k, -1]) if about.torus.free else None,
            float(share[k]),
        )
        for k in np.argsort(-share)
        if share[k] > _LEAST_WEIGHT
    )
    each = own.lasting[:3] - about.torus.v(found.theta) @ own.lasting_by[:3].T
    bias = found.weight @ each
    off = each - bias
    covariance = own.bias_covariance + (found.weight[:, None] * off).T @ off
    return Tumbled(
        wrap(heading), sigma, rotation_z(heading) @ of.base, modes, bias, covariance,
        latitude, interval, (*notes, *(() if wide else _several(modes))),
    )  # fmt: skip


def _interval(values: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """The 95% interval of weighted draws."""
    order = np.argsort(values)
    middle = np.cumsum(weight[order]) - weight[order] / 2
    low, high = np.interp([0.025, 0.975], middle, values[order])
    return float(low), float(high)


def _several(modes: tuple[Mode, ...]) -> list[str]:
    """What to say where the headings can be held in several ways."""
    if len(modes) < 2:
        return []
    return [
        f"{len(modes)} ways to hold the headings fit: a pose at another heading, or on another "
        "side, would tell which"
    ]


def turned_by(attitude: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Errors of attitudes about the vertical, rad, (P,). attitude, truth : (P, 3, 3), C_nb."""
    return about_vertical(attitude @ np.swapaxes(truth, 1, 2))
