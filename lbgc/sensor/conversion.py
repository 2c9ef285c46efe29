"""From a triad's datasheet figures to SI, and which of two keys that say one thing counts."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lbgc import units
from lbgc.errors import InputError, require
from lbgc.sensor import rows
from lbgc.sensor.errors import FIRST, FORCE, NONE, Proportional, Triple
from lbgc.sensor.imu import Triad
from lbgc.sensor.instability import allan_minimum, instability

_AGREE = 0.15
"""Two keys for one figure may differ by so much: datasheets round."""


def to_si(config: Any) -> Triad:
    """The triad of a GyroConfig or AccelConfig. Raises InputError."""
    keys = rows.keys_of(config)

    def axes(part: str) -> Triple:
        return _axes(config, keys[part][0])

    def optional(part: str) -> float | None:
        (key,) = keys[part]
        value = getattr(config, key)
        return None if value is None else units.factor(key) * value

    corners = (config.flicker_short_s, config.flicker_long_s)
    white, walk = _one_of(config, keys["N"]), axes("K")
    return Triad(
        N=white,
        B=_flicker(config, keys["B"][0], keys["minimum"], white, walk, corners),
        K=walk,
        flicker_corners=corners,
        gauss_markov_time=_axes(config, "gauss_markov_s"),
        lines=tuple(_line(line) for line in config.lines),
        bandwidth_hz=None if config.bandwidth_hz is None else _axes(config, "bandwidth_hz"),
        damping=_plain(config, "filter_damping"),
        drawn=_drawn(config),
        Q=axes("Q"),
        R=axes("R"),
        gauss_markov=axes("gauss_markov"),
        tone_hz=axes("tone_hz"),
        tone=axes("tone"),
        lsb=optional("lsb"),
        carried_lsb=optional("carried_lsb"),
        range=optional("range"),
        keys={part: keys[part][0] for part in ("lsb", "carried_lsb", "range")},
    )


def _drawn(config: Any) -> tuple[Proportional, ...]:
    """What is drawn once, in the order of its drawing."""
    found: dict[str, Proportional] = {}
    for key, size, kind in rows.drawn_of(config):
        found[kind.name] = found.get(kind.name, kind).sized(size, _axes(config, key))
    # An accelerometer's, too, is drawn: as it always was.
    found.setdefault("g_sensitivity", Proportional("g_sensitivity", "", "unit", FORCE, cross=NONE))
    later = [name for name in found if name not in FIRST]
    return tuple(found[name] for name in (*FIRST, *later))


def _line(line: Any) -> tuple[Triple, Triple, Triple, Triple]:
    """Rms, centre, width and number of poles of each axis, SI."""
    size, centre, width = (_axes(line, key) for key in vars(line) if key != "poles")
    return size, centre, width, _plain(line, "poles")


def _plain(config: Any, key: str) -> Triple:
    """A figure without a unit."""
    x, y, z = np.broadcast_to(getattr(config, key), 3).tolist()
    return (x, y, z)


def _axes(config: Any, key: str) -> Triple:
    value = getattr(config, key)
    x, y, z = value if isinstance(value, list) else [value] * 3
    scale = units.factor(key)
    return (scale * x, scale * y, scale * z)


def _one_of(config: Any, keys: Sequence[str]) -> Triple:
    """The figure from whichever of its keys is given; those given must agree within 15%."""
    given = {key: _axes(config, key) for key in keys if getattr(config, key) is not None}
    if not given:
        return (0.0, 0.0, 0.0)
    (first_key, first), *rest = given.items()
    for key, other in rest:
        in_its_unit = np.divide(first, units.factor(key)).round(9).tolist()
        require(
            bool(np.allclose(first, other, rtol=_AGREE, atol=0.0)),
            key,
            getattr(config, key),
            f"disagrees by over 15% with {first_key} = {getattr(config, first_key)}, which is "
            f"{in_its_unit} in this unit; give one of them",
        )
    return first


def _flicker(
    config: Any,
    own: str,
    minimum: Sequence[str],
    white: Triple,
    walk: Triple,
    corners: tuple[float, float],
) -> Triple:
    """B of each axis, as given or from the Allan deviation's minimum; an axis whose minimum is zero
    has none."""
    named = next((key for key in minimum if getattr(config, key) is not None), None)
    if getattr(config, own) is not None:
        if named is not None:
            raise InputError(
                named,
                getattr(config, named),
                units.unit_of(named),
                f"and {own} = {getattr(config, own)} are two statements of one thing; give one",
            )
        return _axes(config, own)
    found = []
    for lowest, N, K in zip(_one_of(config, minimum), white, walk, strict=True):
        least, _ = allan_minimum(N, 0.0, K, corners)
        if named is not None:
            require(
                lowest == 0 or lowest >= least,
                named,
                getattr(config, named),
                f"is below {least / units.factor(named):.3g}, which white noise and random walk "
                "alone come to between flicker_short_s and flicker_long_s",
            )
        found.append(instability(lowest, N, K, corners) if lowest > 0 else 0.0)
    x, y, z = found
    return (x, y, z)
