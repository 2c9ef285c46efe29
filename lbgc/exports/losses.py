"""What of a sensor a file of another tool tells otherwise, or not at all: by the sensor's own keys.

Whatever is stated of the sensor and is not in a format's list of what it tells is lost, so that a
key that comes new is said to be lost until a format tells it.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from lbgc.exports.subject import PARTS, Subject
from lbgc.outputs import shown
from lbgc.units import unit_of

WHITE = frozenset({
    "arw_deg_per_sqrt_h", "noise_deg_per_s_per_sqrt_hz",
    "noise_ug_per_sqrt_hz", "vrw_m_per_s_per_sqrt_h",
})  # fmt: skip
WALK = frozenset({"rrw_deg_per_h_per_sqrt_h", "random_walk_ug_per_sqrt_h"})
SLOW = frozenset({
    "bias_instability_deg_per_h", "allan_minimum_deg_per_h", "gauss_markov_deg_per_h",
    "bias_instability_ug", "allan_minimum_ug", "allan_minimum_mg", "gauss_markov_ug",
    "gauss_markov_s", "flicker_short_s", "flicker_long_s",
})  # fmt: skip
"""Bias instability and Gauss-Markov process, with the times that belong to them."""
COUNTS = frozenset({"rate_lsb_deg_per_s", "lsb_ug"})
RANGE = frozenset({"range_deg_per_s", "range_g"})
BIAS = frozenset(
    f"bias_{lifetime}_{unit}"
    for lifetime in ("unit", "session", "run")
    for unit in ("deg_per_h", "mg")
)
_SAID_ELSEWHERE = ("name", "assumed")
_LONGEST_VALUE = 400


@dataclass(frozen=True)
class Scope:
    """What a format does with a sensor's keys."""

    told: Collection[str]
    """Keys that it tells as they are."""
    replaced: Mapping[str, str] = field(default_factory=dict)
    """Keys that something else stands for, alone or with their triad, and what that is."""


def lines(subject: Subject, scope: Scope, without: Collection[str] = ()) -> list[str]:
    """A sentence for each stated key that this format replaces or has no figure for, with its
    value. without : the triads in which nothing is replaced."""
    replaced, lost = [], []
    for key, value in _stated(subject):
        name = key.rsplit(".", 1)[-1]
        said = f"{key} = {shown(_spelled(value), _LONGEST_VALUE)} {unit_of(name)}".rstrip()
        by = scope.replaced.get(key, scope.replaced.get(name))
        if by is not None and key.split(".")[0] not in without:
            replaced.append(f"replaced by {by}: {said}")
        elif name not in scope.told:
            lost.append(f"lost: {said}")
    return replaced + lost


def _stated(subject: Subject) -> Iterator[tuple[str, Any]]:
    """Every key of the sensor that is stated otherwise than by default, and is not zero: its name
    and value."""
    for row in fields(subject.config):
        group: Any = getattr(subject.config, row.name)
        if row.name in _SAID_ELSEWHERE:
            continue
        plain = vars(type(group)())
        for own, value in vars(group).items():
            if value != plain[own] and _is_some(value):
                yield f"{row.name}.{own}", value


def _spelled(value: Any) -> Any:
    """A key's value in words, a list of narrow-band lines by their own keys."""
    if not isinstance(value, tuple):
        return value
    return "; ".join(", ".join(f"{k} {v}" for k, v in vars(own).items()) for own in value)


def _is_some(value: Any) -> bool:
    """Whether a key's value is anything but nothing, zero or zeros."""
    return any(value) if isinstance(value, list | tuple) else bool(value)


def whites(subject: Subject, parts: Sequence[str] = PARTS) -> list[str]:
    """The sentence that rounding to counts is told as white noise, of each of these triads that
    rounds."""
    return [
        f"{part}: rounding to counts is among the white noise, as LSB^2/12 a sample"
        for part in parts
        if subject.triad(part).rounding(subject.dt) and not _carried(subject, part)
    ]


def walked(subject: Subject, each: bool) -> list[str]:
    """The triads that are told with a random walk of their own, which then stands for nothing.
    each : whether every axis has a figure, so that all of them must have one; else any will do."""
    enough = all if each else any
    return [part for part in PARTS if enough(axis.K > 0 for axis in subject.slow(part))]


def _carried(subject: Subject, part: str) -> bool:
    counts = subject.triad(part).counts
    return counts is not None and counts.is_carried
