"""Classical north-finders. Each takes windows and answers each from its own rows."""

from collections.abc import Callable

import numpy as np

from lbgc.data.windows import Windows
from lbgc.estimators import static

Estimator = Callable[[Windows], np.ndarray]
"""Windows (W) -> heading (W,), rad, when the encoder reads zero. Raises InputError where the
windows are none that it can answer."""

CLASSICAL: dict[str, Estimator] = {"mean": static.mean}
