"""A remark on windows whose means are too long for what the plate does within them."""

import numpy as np

from lbgc.data.windows import Windows
from lbgc.estimators.block_means import levelled

_MOST = 0.15  # share of the time that may tell nothing of north without a remark
_ENOUGH = 16  # windows that are looked at


def note(windows: Windows, sample_s: float | None = None) -> str | None:
    """The remark on windows in which 15% or more of the time tells nothing of north, because it
    lies in means during which the plate starts, stops or slews; None for other windows.
    sample_s : the sensor's own interval, where the windows hold means."""
    if not len(windows) or windows.gyro.shape[1] < 2:
        return None
    share, interval = [], 0.0
    for part in levelled(windows.rows(slice(0, _ENOUGH)), sample_s):
        interval = part.course.interval
        used = sum(part.course.lengths) * interval / windows.duration_s
        share += len(part.rows) * [1 - used]
    lost = float(np.mean(share))
    if lost < _MOST:
        return None
    return (
        f"windows of {windows.duration_s:g} s: means of {interval:.3g} s are coarse for what the "
        f"plate does; those in which it starts, stops or slews are {lost:.0%} of the time and tell "
        "nothing of north: give shorter means"
    )
