"""Classical north-finders. Each takes windows and answers each from its own rows."""

from functools import partial

from lbgc.estimators import inertial, kalman, rotation_modulation, static, tumble
from lbgc.estimators.estimate import Estimator, TellsPoses

FROM_POSES: dict[str, TellsPoses] = {"tumble": tumble.tumble}
"""Estimators of an IMU that is held in several attitudes, each answering a recording's poses."""
CLASSICAL: dict[str, Estimator] = {
    "mean": static.mean,
    "triad": static.triad,
    "gls": static.gls,
    "two_position": rotation_modulation.two_position,
    "two_position_weighted": rotation_modulation.two_position_weighted,
    "cosine_fit": rotation_modulation.cosine_fit,
    "cosine_fit_weighted": rotation_modulation.cosine_fit_weighted,
    "carousel": rotation_modulation.carousel,
    "carousel_weighted": rotation_modulation.carousel_weighted,
    "oba": inertial.oba,
    "oba_textbook": inertial.oba_textbook,
    "oba_interval": inertial.oba_interval,
    "oba_bias": inertial.oba_bias,
    "ekf": kalman.ekf,
}

_WEIGHED = {
    "gls": static.gls,
    "two_position_weighted": rotation_modulation.two_position_weighted,
    "cosine_fit_weighted": rotation_modulation.cosine_fit_weighted,
    "carousel_weighted": rotation_modulation.carousel_weighted,
}
BASES: dict[str, Estimator] = CLASSICAL | {
    name: partial(estimate, checked=False) for name, estimate in _WEIGHED.items()
}
"""Classical estimators as bases of a network, which corrects a heading whatever the sensor is like,
and states a sigma of its own: they do not refuse windows that contradict the sensor's model."""
