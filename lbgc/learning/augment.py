"""The paper's Algorithm 2: new headings from old recordings.

The sensor's errors live in the body. Turning a recording by d about the vertical changes Earth's
rate in the body by omega(psi + d) - omega(psi) and nothing else, so that is what is added; bias,
noise and vibration stay as they were. The paper's literal form turns them along with the signal
(form "literal"): a repeatable body-frame bias then averages out over d and cannot be learned.
"""

from dataclasses import dataclass, replace

import numpy as np

from lbgc.data.windows import Windows
from lbgc.earth import earth_rate_ned
from lbgc.errors import require_choice, require_not_negative
from lbgc.estimators.level import level
from lbgc.frames import euler_to_matrix, rotation_z
from lbgc.sensor.imu import Triad


@dataclass(frozen=True)
class AugmentConfig:
    """How training windows are varied; every copy draws afresh."""

    rotate: bool = True
    """Turn each copy to a heading drawn from the whole circle."""
    form: str = "earth"
    """earth: turn Earth's rate only. literal: turn the gyro's reading, errors and all."""
    noise: float = 1.0
    """Fresh in-run noise added to each copy, as a share of the sensor's own (1 sigma)."""
    run_bias: float = 1.0
    """Fresh run bias added to each copy, as a share of the sensor's own (1 sigma)."""

    def __post_init__(self) -> None:
        require_choice("form", self.form, ("earth", "literal"))
        require_not_negative(self, "noise", "run_bias")


def augment(
    config: AugmentConfig, windows: Windows, gyro: Triad, rng: np.random.Generator
) -> Windows:
    """Copies of the windows (one each), labels turned with them; the originals are left alone.

    gyro : the model of the sensor that recorded them, for the added noise and bias.
    """
    rates = np.array(windows.gyro)
    reference, truth = windows.heading_reference, windows.heading
    if config.rotate:
        d = rng.uniform(-np.pi, np.pi, len(windows))
        if config.form == "literal":
            rates = rates @ rotation_z(d)  # row vectors: C_nb(d)' applied to each
        else:
            rates += _earth_rate_change(windows, d)[:, None, :]
        reference, truth = reference + d, truth + d
    if config.run_bias > 0:
        bias = rng.standard_normal((len(windows), 1, 3)) * gyro.bias_run
        rates += config.run_bias * bias
    if config.noise > 0:
        count, steps, _ = rates.shape
        fresh = gyro.sample_noise(rng, count, steps, 1 / windows.rate_hz)
        rates = rates + config.noise * fresh
    return replace(windows, gyro=rates, heading=truth, heading_reference=reference)


def _earth_rate_change(windows: Windows, d: np.ndarray) -> np.ndarray:
    """C_nb(psi + d)' omega_ie - C_nb(psi)' omega_ie, (W, 3), with the level that the
    accelerometers tell and the heading that training may know: the reference."""
    roll, pitch = level(windows.accel.mean(axis=1))
    earth = earth_rate_ned(windows.latitude)[:, None, :]
    psi = windows.heading_reference

    def in_body(heading: np.ndarray) -> np.ndarray:
        return (earth @ euler_to_matrix(roll, pitch, heading))[:, 0, :]

    return in_body(psi + d) - in_body(psi)
