"""What the plate is asked to do: a pure plan. `sim/motion.py` executes it with physics."""

from dataclasses import dataclass

import numpy as np

from lbgc.errors import require, require_choice

NAMES = ("heading_scan", "static")


@dataclass(frozen=True)
class ProtocolConfig:
    """What `conf/protocol/*.yaml` holds."""

    name: str = "heading_scan"
    """heading_scan: index through the circle and rest, one recording a rest (the paper's
    experiment). static: the plate stays where it is."""
    step_deg: float = 5.0
    """Between the headings of a scan."""

    def __post_init__(self) -> None:
        require_choice("name", self.name, NAMES)
        if self.name == "heading_scan":
            require(
                0 < self.step_deg <= 360, "step_deg", self.step_deg, "must be above 0, up to 360"
            )


@dataclass(frozen=True)
class Plan:
    """What happens in, and just before, one recording."""

    start: float
    """rad, the plate's angle before it is driven."""
    target: float
    """rad, where it is driven, and where it rests while the recording lasts."""
    azimuth_range: float
    """rad: the base's azimuth is drawn uniformly from an interval of this width about zero."""


def plan(config: ProtocolConfig, recording: int) -> Plan:
    """The plan of a recording, which depends on its own index alone.

    A scan goes round the circle in steps; base azimuths fill the gaps between its headings, so
    that headings cover the circle evenly and the encoder says nothing of them.
    """
    if config.name == "static":
        return Plan(0.0, 0.0, 2 * np.pi)
    step = float(np.deg2rad(config.step_deg))
    steps = max(1, round(2 * np.pi / step))
    at = recording % steps
    return Plan((at - 1) * step, at * step, step)
