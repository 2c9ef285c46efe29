"""Classical north-finders. Each takes windows and answers each from its own rows."""

from lbgc.estimators import indexed, inertial, kalman, static
from lbgc.estimators.estimate import Estimator

CLASSICAL: dict[str, Estimator] = {
    "mean": static.mean,
    "triad": static.triad,
    "gls": static.gls,
    "two_position": indexed.two_position,
    "two_position_weighted": indexed.two_position_weighted,
    "cosine_fit": indexed.cosine_fit,
    "cosine_fit_weighted": indexed.cosine_fit_weighted,
    "carousel": indexed.carousel,
    "carousel_weighted": indexed.carousel_weighted,
    "oba": inertial.oba,
    "oba_textbook": inertial.oba_textbook,
    "oba_interval": inertial.oba_interval,
    "oba_bias": inertial.oba_bias,
    "ekf": kalman.ekf,
}
