"""Classical north-finders. Each takes windows and answers each from its own rows."""

from lbgc.estimators import static
from lbgc.estimators.estimate import Estimator

CLASSICAL: dict[str, Estimator] = {"mean": static.mean}
