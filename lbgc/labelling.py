"""What labelled recordings of one unit would buy, before any is made."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lbgc.estimators.block_means import Course, Levelled, Site
from lbgc.estimators.unit_posterior import Reference, evidence_of, posterior
from lbgc.sensor import unit
from lbgc.sensor.imu import ImuModel

MOST = 1000
"""More labelled recordings than anybody makes, which stand for any number of them."""
_LADDER = (
    *(0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30),
    *(40, 50, 70, 100, 150, 200, 300, 500, MOST),
)
_NEAR = 1.05
"""The error over that after any number of recordings, at which there are enough."""


def after(
    imu: ImuModel,
    course: Course,
    site: Site,
    count: int,
    power_ups: int | None,
    reference: Reference,
) -> ImuModel:
    """The sensor's model as it will be known, on average over what they will show, after so many
    labelled recordings of one unit, at headings evenly round the circle, on a level base.

    course : of each; power_ups : over how many they are spread evenly; None: each has its own;
    reference : the error of their headings, `new` the same for all, (1,).
    """
    if count == 0:
        return imu
    heading = 2 * np.pi * np.arange(count) / count
    base = np.broadcast_to(np.eye(3), (count, 3, 3))
    body = np.zeros((count, 6, len(course.blocks)))
    part = Levelled(course, site, np.arange(count), body, base)
    new = np.broadcast_to(reference.new, count)
    told = evidence_of(imu, [part], heading, Reference(new, reference.offset))
    session = np.arange(count) % (count if power_ups is None else power_ups)
    known = posterior(imu, told, session).known
    return unit.told(imu, replace(known, mean=0 * known.mean))


def enough(floor: Callable[[int], float]) -> str:
    """How many labelled recordings to make, in a sentence. floor : the expected error, rad, after
    so many."""
    none, any_number = floor(0), floor(MOST)
    if any_number * _NEAR > none:
        return (
            f"labelled recordings buy nothing here: {np.rad2deg(none):.3g} deg without, "
            f"{np.rad2deg(any_number):.3g} after any number of them"
        )
    most = _NEAR * any_number
    count, size = next((k, size) for k in _LADDER if (size := floor(k)) <= most)
    return (
        f"{count} labelled recording{'s' * (count != 1)}: {np.rad2deg(none):.3g} deg becomes "
        f"{np.rad2deg(size):.3g}, within {_NEAR - 1:.0%} of the {np.rad2deg(any_number):.3g} "
        "after any number of them"
    )
