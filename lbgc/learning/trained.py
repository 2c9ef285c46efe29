"""A trained model that answers what it was trained for and refuses all else: another latitude,
window length, course of the plate, sensor, or unit than the one whose bias it learned.

A network does not know where its training data end: a model of one unit, asked about another,
subtracts a bias that is not there, and states a sigma as if it were.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from lbgc.data.checks.plausible import mean_noise, residual, stated_errors
from lbgc.data.record import Record
from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE
from lbgc.errors import InputError, build
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.estimators.plate import usable
from lbgc.learning import description
from lbgc.learning.estimator import Learned
from lbgc.sensor import streams
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.errors import NONE
from lbgc.sensor.imu import ImuModel

_TURNS = np.deg2rad(1.0)
"""Travel of the plate in a window, rad, up to which it counts as resting."""
_RESTS = np.deg2rad(0.01)
"""Largest travel of the plate in a recording, rad, whose mean rate is compared with the units'."""
_NEAR_DEG = 0.5
"""Degrees of latitude beyond the training's range that are still answered."""
_FEW = 3
"""Largest number of units whose biases a model can learn by heart."""
_ANOTHER = 18.4
"""Chi-square of two degrees of freedom (a heading takes one of three) that a log of the unit's own
exceeds once in 10,000 times."""
_RESTING = ("static", "heading_scan")
_TURNING = ("carousel",)
_APART_DEG = {"two_position": 180.0, "four_position": 90.0}
"""Degrees of which the angles between a protocol's positions are whole multiples."""
_NEAR_POSITION = np.deg2rad(1.0)
"""rad, from a position within which a plate is there."""


@dataclass(frozen=True)
class Setting:
    """What is known, beside the windows, of the recordings that a model is asked about."""

    sensor: ImuConfig | None
    protocol: str | None = None
    units: tuple[int, int] | None = None
    """A dataset's unit_seed and its number of units; None for a real log."""
    records: Sequence[Record] = ()
    """A log's recordings, whose mean rates can show that they are of another unit."""
    calibration: str | None = None
    """The checksum of what is known of the unit, whose means were taken off the recordings"""


@dataclass(frozen=True)
class Trained:
    """An estimator that refuses what its model was not trained for.

    beside : the reasons to refuse that hold whatever the windows are; untrained : whether it
    answers all the same; overridden : the refusals that it then passed over, collected as it
    answers.
    """

    name: str
    learned: Learned
    said: dict[str, Any]
    beside: tuple[InputError, ...] = ()
    untrained: bool = False
    overridden: dict[str, None] = field(default_factory=dict, compare=False)

    @classmethod
    def load(cls, run: str | Path, name: str | None = None) -> "Trained":
        """The model in a run's directory, under its own name or this one. Raises InputError where
        it is damaged or of another format."""
        learned, said = Learned.load(run), description.read(run)
        return cls(learned.name if name is None else name, learned, said)

    @property
    def sensor(self) -> ImuConfig:
        """The sensor that it was trained on."""
        return build(ImuConfig, self.said["units"]["imu"])

    @property
    def meant_for(self) -> str:
        """The sensor, protocol, window lengths and latitudes that it was trained for, in words."""
        low, high = self.said["latitude_deg"]
        windows = self.said["training"]["windows_s"]
        lengths = f"{min(windows):g} s" + (f" to {max(windows):g} s" if len(windows) > 1 else "")
        place = f"latitudes {low:g} to {high:g} degrees"
        if low == high:
            place = f"latitude {low:g} degrees"
        return f"{self.sensor.name}, protocol {self.said['protocol']}, {lengths}, {place}"

    def asked(self, setting: Setting, untrained: bool) -> "Trained":
        """This network for use in a setting; untrained : whether it answers what it would refuse
        there."""
        beside = tuple(self._refusals_of_setting(setting))
        name = f"{self.name} (untrained)" if untrained else self.name
        return replace(self, name=name, beside=beside, untrained=untrained, overridden={})

    def __call__(self, windows: Windows, imu: ImuModel | None = None) -> Estimate:
        """The network's answers. Raises InputError where the setting, the latitude, the windows'
        length or the plate's motion differ from training's, unless `untrained`."""
        wrong = [*self.beside, *self._refusals_of_windows(windows)]
        if wrong and not self.untrained:
            raise wrong[0]
        self.overridden.update(dict.fromkeys(map(str, wrong)))
        return self.learned(windows, imu)

    def _refusal(self, value: object, unit: str, why: str) -> InputError:
        """The InputError that says why it refuses, and what it is meant for."""
        about = f"; it is meant for {self.meant_for} (untrained=true uses it all the same)"
        return refusal(self.name, value, unit, why + about)

    def _refusals_of_windows(self, windows: Windows) -> list[InputError]:
        """Reasons to refuse that the windows give: latitude, length, motion of the plate."""
        low, high = self.said["latitude_deg"]
        at = np.rad2deg(windows.latitude)
        lengths = self.said["training"]["windows_s"]
        found = []
        far = at[(at < low - _NEAR_DEG) | (at > high + _NEAR_DEG)]
        if len(far):
            found.append(self._refusal(f"{far[0]:.4g}", "deg", "is no latitude of its"))
        if not min(lengths) - 1e-6 <= windows.duration_s <= max(lengths) + 1e-6:
            found.append(self._refusal(f"{windows.duration_s:g}", "s", "is no length of its"))
        does = _motion(windows)
        if not self._is_course(does):
            found.append(self._refusal("a plate", "", f"that {does} is none of its"))
        apart = _APART_DEG.get(self.said["protocol"])
        if apart is not None and does == "turns and rests":
            off = _off_positions(windows, np.deg2rad(apart))
            if off > _NEAR_POSITION:
                what = f"from any of its positions, which are {apart:g} degrees apart, is a plate's"
                found.append(self._refusal(f"{np.rad2deg(off):.3g}", "deg", what))
        return found

    def _is_course(self, does: str) -> bool:
        """Whether what a plate does, in the words of `_motion`, is what it did in training."""
        protocol = self.said["protocol"]
        if protocol in _RESTING or does == "rests":
            return protocol in _RESTING and does == "rests"
        if protocol in _TURNING:
            return does == "turns"
        return protocol not in _APART_DEG or does == "turns and rests"

    def _refusals_of_setting(self, setting: Setting) -> list[InputError]:
        """Reasons to refuse that the setting gives: sensor, protocol, unit."""
        found = []
        own = self.said["units"]
        if setting.sensor is not None and setting.sensor != self.sensor:
            named = setting.sensor.name
            what = "is not its sensor"
            if named == self.sensor.name:
                what += ", although of the same name: figures differ"
            found.append(self._refusal(named, "", what))
        rests = {setting.protocol, self.said["protocol"]} <= set(_RESTING)
        if setting.protocol not in (None, self.said["protocol"]) and not rests:
            found.append(self._refusal(setting.protocol, "", "is not its protocol"))
        known = (self.said.get("calibration") or {}).get("sha256")
        if setting.calibration != known:
            told = "none" if setting.calibration is None else setting.calibration[:12]
            own_file = "without one" if known is None else f"with that of checksum {known[:12]}"
            found.append(
                self._refusal("calibration", told, f"is not its: it was trained {own_file}")
            )
        if known is not None or not self._knows_units:
            return found
        if setting.units is not None and setting.units != (own["unit_seed"], own["units"]):
            what = f"is another sensor than unit_seed={own['unit_seed']}, whose bias it learned"
            found.append(self._refusal(f"unit_seed={setting.units[0]}", "", what))
        for record in setting.records:
            sigmas = self._off(record)
            if sigmas is not None:
                what = f"differs by {sigmas:.1f} sigma from all of the unit's whose bias it learned"
                found.append(self._refusal(f"{record.name}'s mean rate", "", what))
                break
        return found

    @property
    def _knows_units(self) -> bool:
        """Whether it was trained on so few units that it learned the bias of each."""
        gyro = self.sensor.gyro.triad()
        return bool(self.said["units"]["units"] <= _FEW and gyro.bias("unit").any())

    def _off(self, record: Record) -> float | None:
        """Number of sigmas by which a resting recording's mean rate differs from every rate that
        the units of training can have; None where they do not differ by enough, or cannot be
        compared."""
        if np.ptp(record.plate_angle) > _RESTS:
            return None
        own = self.said["units"]
        gyro = self.sensor.gyro.triad()
        rate, force = record.gyro.mean(axis=0), record.accel.mean(axis=0)
        aside = stated_errors(gyro.with_bias(unit=NONE), record.duration_s)
        allowed = mean_noise(record.gyro) ** 2 + (1e-3 * EARTH_RATE) ** 2
        if aside is not None:
            allowed = allowed + aside**2
        else:  # without other biases only slow noise remains
            allowed = allowed + gyro.slow_variance(record.duration_s)
        chis = []
        for unit in range(own["units"]):
            drawn = gyro.draw_unit(streams.unit(own["unit_seed"], unit))
            chis.append(
                residual(rate - drawn["bias_unit"], force, record.latitude, np.sqrt(allowed))[0]
            )
        return float(np.sqrt(min(chis))) if min(chis) > _ANOTHER else None


def _off_positions(windows: Windows, apart: float) -> float:
    """The largest angle, rad, of a plate at rest from the nearest whole multiple of `apart`, rad,
    after its first rest in the window."""
    resting = usable(windows.plate_angle)[1] & ~windows.unrecorded
    worst = 0.0
    for angle, own in zip(windows.plate_angle, resting, strict=True):
        since = (angle[own] - angle[own][:1]) / apart
        worst = max(worst, float(np.abs(since - np.round(since)).max(initial=0.0)) * apart)
    return worst


def _motion(windows: Windows) -> str:
    """What the plate does in windows, in the words of a refusal."""
    if np.ptp(windows.plate_angle, axis=1).max(initial=0.0) <= _TURNS:
        return "rests"
    _, resting = usable(windows.plate_angle)
    return "turns and rests" if resting.mean() > 0.5 else "turns"
