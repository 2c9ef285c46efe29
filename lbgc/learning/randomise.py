"""Domain randomisation: training windows of sensors and places that differ from the dataset's, so
that a network does not rely on properties that its user's own sensor and place may not have.

Only training windows are varied; validation, and all evaluation, use the dataset as it is.
"""

from dataclasses import dataclass, replace

import numpy as np

from lbgc.data.windows import Labelled, Windows
from lbgc.earth import normal_gravities
from lbgc.errors import require, require_not_negative
from lbgc.learning.augment import earth_in_body
from lbgc.learning.batches import Source
from lbgc.sensor.deterministic import vibration
from lbgc.sensor.imu import ImuModel
from lbgc.units import factor


@dataclass(frozen=True)
class RandomiseConfig:
    """How far training windows may differ from the dataset; by default they do not."""

    latitude: tuple[float, ...] | None = None
    """[low, high] in degrees, from which each batch draws its own; null: the dataset's."""
    noise: float = 0.0
    """Most in-run noise added to a window, as a share of the sensor's own (1 sigma)."""
    run_bias: float = 0.0
    """Most run bias added to a window, as a share of the sensor's own (1 sigma)."""
    vibration_deg_per_h: float = 0.0
    """Largest amplitude of a vibration about each axis; each window draws its own."""
    vibration_hz: tuple[float, ...] = (45.0, 51.0)
    """[low, high] of the vibration's frequency."""

    def __post_init__(self) -> None:
        require_not_negative(self, "noise", "run_bias", "vibration_deg_per_h")
        for name, most in (("latitude", 89.0), ("vibration_hz", np.inf)):
            ends = getattr(self, name)
            if ends is not None:
                good = len(ends) == 2 and -most <= ends[0] <= ends[1] <= most
                require(good, name, ends, f"must be [low, high], within {most:g}")
        require_not_negative(self, "vibration_hz")

    @property
    def is_on(self) -> bool:
        """Whether anything is varied."""
        return self.latitude is not None or any((self.noise, self.run_bias,
                                                 self.vibration_deg_per_h))  # fmt: skip


@dataclass(frozen=True)
class Randomised:
    """A source whose windows are those of another source, each varied."""

    source: Source
    config: RandomiseConfig
    imu: ImuModel

    @property
    def fresh(self) -> Source | None:
        """The underlying source's fresh windows, which are not varied."""
        return self.source.fresh

    def draw(self, rng: np.random.Generator, count: int, steps: int) -> Labelled:
        """`count` windows of `steps` samples from the underlying source, varied. A batch has one
        latitude."""
        drawn = self.source.draw(rng, count, steps)
        if self.config.latitude is not None:
            low, high = self.config.latitude
            drawn = moved(drawn, float(np.deg2rad(rng.uniform(low, high))))
        own = drawn.windows
        return replace(drawn, windows=replace(own, gyro=own.gyro + self._more(rng, own)))

    def _more(self, rng: np.random.Generator, windows: Windows) -> np.ndarray:
        """Errors that are added to the gyros' own, (W, T, 3), rad/s: run bias, noise, vibration."""
        count, steps, _ = windows.gyro.shape
        interval, gyro = 1 / windows.rate_hz, self.imu.gyro
        share = rng.uniform(0, 1, (3, count, 1, 1))
        bias = rng.standard_normal((count, 1, 3)) * gyro.bias("run")
        more = self.config.run_bias * share[0] * bias
        more = np.broadcast_to(more, windows.gyro.shape).copy()
        if self.config.noise > 0:
            more += self.config.noise * share[1] * gyro.sample_noise(rng, count, steps, interval)
        if self.config.vibration_deg_per_h > 0:
            size = self.config.vibration_deg_per_h * factor("vibration_deg_per_h")
            low, high = self.config.vibration_hz
            hz = rng.uniform(low, high)  # one frequency a batch
            for axis in range(3):
                phase = rng.uniform(0, 2 * np.pi, (count,))
                tone = vibration(size, float(hz), phase, steps, interval)
                more[..., axis] += share[2, :, :, 0] * tone
        return more


def moved(labelled: Labelled, latitude: float) -> Labelled:
    """Windows as they would be at another latitude, rad, with Earth's rate and gravity of that
    latitude.

    The accelerometers' bias tilts the level by as much as before, and thereby turns the heading by
    as much as it did at the windows' own latitude.
    """
    windows, psi = labelled.windows, labelled.heading_reference
    there = replace(windows, latitude=np.full(len(windows), latitude))
    change = earth_in_body(there, psi) - earth_in_body(windows, psi)
    weight = normal_gravities(there.latitude) / normal_gravities(windows.latitude)
    accel = windows.accel * weight[:, None, None]
    return replace(labelled, windows=replace(there, gyro=windows.gyro + change, accel=accel))
