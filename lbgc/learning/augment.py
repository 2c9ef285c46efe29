"""Augmentation: new recordings from old ones, with errors of the same law, by turning (the paper's
Algorithm 2) and by mixing.

The sensor's errors are fixed in the body. Turning a recording by d about the vertical changes
Earth's rate in the body by omega(psi + d) - omega(psi) and nothing else, so that difference is
added; bias, noise and vibration stay as they were. The paper's literal form turns them along with
the signal (form "literal"): a repeatable body-frame bias then averages out over d and cannot be
learned.

Mixing: recording i of three of one unit, less Earth's rate, is u + n_i, the unit's errors u and a
noise of its own. Weights c with sum 1 and sum of squares 1 (there is a circle of them) make
u + sum c_i n_i, which has the same u and the same covariance as u + n_i, whatever the sensor is: a
fresh draw where noise is Gaussian and tilts are small. Noise that is added instead would come on
top of the noise already there: a network would learn a sensor noisier than the one it will meet.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbgc.data.windows import Labelled, Windows
from lbgc.earth import earth_rate_ned
from lbgc.errors import require, require_choice, require_not_negative
from lbgc.estimators.plate import mean_turn, on_plate, travel_within
from lbgc.frames import euler_to_matrix, level, rotation_z, turned
from lbgc.sensor.imu import ImuModel, Triad

MIXED = 3
"""Number of recordings of one unit that are mixed to a new one."""


@dataclass(frozen=True)
class AugmentConfig:
    """How training windows are augmented; every copy is drawn afresh."""

    rotate: bool = True
    """Turn each copy to a heading drawn from the whole circle."""
    form: str = "earth"
    """earth: turn Earth's rate only. literal: turn the gyro's reading, errors and all."""
    mix: bool = True
    """Noise and run errors of three recordings of the unit, mixed to new ones of the same law."""
    noise: float = 0.0
    """In-run noise added on top of what is there, as a share of the sensor's own (1 sigma)."""
    run_bias: float = 0.0
    """Run bias added on top of what is there, as a share of the sensor's own (1 sigma)."""

    def __post_init__(self) -> None:
        require_choice("form", self.form, ("earth", "literal"))
        require_not_negative(self, "noise", "run_bias")


def check_field(config: AugmentConfig, imu: ImuModel) -> None:
    """Raise InputError where recordings may not be turned or mixed, since what the gyros make of
    the magnetic field turns with them, and only Earth's rate is known."""
    for name in ("rotate", "mix"):
        about = "the gyros feel a magnetic field, whose part in a recording is not known; use "
        require(
            not (getattr(config, name) and imu.feels_field),
            f"augment.{name}",
            True,
            f"{about}stream=true, or false here",
        )


def augment(
    config: AugmentConfig, labelled: Labelled, gyro: Triad, rng: np.random.Generator
) -> Labelled:
    """One varied copy of each window, its labels turned with it; the originals stay unchanged.

    gyro : the model of the gyros that recorded them, for the added noise and bias.
    """
    windows, rates = labelled.windows, np.array(labelled.windows.gyro)
    reference, truth = labelled.heading_reference, labelled.heading
    if config.rotate:
        d = rng.uniform(-np.pi, np.pi, len(windows))
        if config.form == "literal":
            rates = rates @ rotation_z(d)  # row vectors: C_nb(d)' applied to each
        else:
            rates += earth_in_body(windows, reference + d) - earth_in_body(windows, reference)
        reference, truth = reference + d, truth + d
    if config.run_bias > 0:
        bias = rng.standard_normal((len(windows), 1, 3)) * gyro.bias("run")
        rates += config.run_bias * bias
    if config.noise > 0:
        count, steps, _ = rates.shape
        fresh = gyro.sample_noise(rng, count, steps, 1 / windows.rate_hz)
        rates = rates + config.noise * fresh
    turned = replace(windows, gyro=rates)
    return Labelled(windows=turned, heading=truth, heading_reference=reference)


def mix(several: Sequence[Labelled], rng: np.random.Generator) -> Windows:
    """Mix three sets of windows, row by row of one unit and one course of the plate, to one set
    with the headings of the first and errors of the same law as in each."""
    first, reference = several[0].windows, several[0].heading_reference
    share = rng.uniform(-np.pi, np.pi, len(first)) + 2 * np.pi / MIXED * np.arange(MIXED)[:, None]
    weights = (1 + 2 * np.cos(share)) / MIXED  # (3, W): sum 1, sum of squares 1
    left = [own.windows.gyro - earth_in_body(own.windows, own.heading_reference) for own in several]
    mixed = replace(first, accel=_sum(weights, [own.windows.accel for own in several]))
    return replace(mixed, gyro=_sum(weights, left) + earth_in_body(mixed, reference))


def _sum(weights: np.ndarray, values: Sequence[np.ndarray]) -> np.ndarray:
    """Weighted sum, (W, T, 3), of three arrays (W, T, 3). weights : (3, W)."""
    return np.asarray(sum(w[:, None, None] * v for w, v in zip(weights, values, strict=True)))


def earth_in_body(windows: Windows, heading: np.ndarray) -> np.ndarray:
    """Earth's rate in the body's axes at these headings, (W, T, 3), rad/s, levelled by the
    accelerometers. Their errors cancel in the difference of two headings; in a mixture they are
    those of the mixed accelerometers."""
    angle = windows.plate_angle
    if np.abs(angle - angle[:, :1]).max(initial=0.0) < _MOVES:
        roll, pitch = level(windows.accel.mean(axis=1))
        base = euler_to_matrix(roll, pitch, heading + angle[:, 0])
        still = np.einsum("wij,wi->wj", base, earth_rate_ned(windows.latitude))
        return np.broadcast_to(still[:, None, :], (*angle.shape, 3))
    roll, pitch = level(turned(windows.accel, angle).mean(axis=1))
    base = euler_to_matrix(roll, pitch, heading)
    earth = np.einsum("wij,wi->wj", base, earth_rate_ned(windows.latitude))
    return on_plate(earth[:, None, :], mean_turn(angle, travel_within(angle)))


_MOVES = np.deg2rad(1e-4)
