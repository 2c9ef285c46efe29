"""From a triad's datasheet figures to SI, and which of two keys that say one thing counts."""

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from lbgc import units
from lbgc.errors import InputError, require
from lbgc.sensor import rows
from lbgc.sensor.deterministic import STARTED
from lbgc.sensor.errors import FIRST, FORCE, NONE, Proportional, Triple
from lbgc.sensor.gaussian import GaussianTerm
from lbgc.sensor.imu import Triad
from lbgc.sensor.instability import allan_minimum, instability
from lbgc.sensor.low_pass import LowPass
from lbgc.sensor.noise import Flicker, RandomWalk, White

_AGREE = 0.15
"""Two keys for one figure may differ by so much: datasheets round."""


def to_si(config: Any) -> Triad:
    """The triad of a GyroConfig or AccelConfig. Raises InputError."""
    axes = zip(*_terms(config), strict=True)
    every = [[term for term in own if term is not None] for own in axes]
    low_pass = [next((t for t in own if isinstance(t, LowPass)), None) for own in every]
    after = [
        [t if f is None else t.behind(f) for t in own if not isinstance(t, LowPass)]
        for own, f in zip(every, low_pass, strict=True)
    ]
    counts = [kind(_figure(config, key)) for key, kind in rows.named("counts", config).items()
              if getattr(config, key) is not None]  # fmt: skip
    (limit,) = rows.named("limit", config)
    return Triad(
        terms=tuple(tuple(t for t in own if isinstance(t, GaussianTerm)) for own in after),
        started=tuple(
            tuple(t for kind in STARTED for t in own if isinstance(t, kind)) for own in after
        ),
        drawn=_drawn(config),
        low_pass=tuple(f for f in low_pass if f is not None) or None,
        counts=counts[0] if counts else None,
        range=None if getattr(config, limit) is None else _figure(config, limit),
        keys={
            "range": limit,
            **{kind.part: key for key, kind in rows.named("counts", config).items()},
        },
    )


def _terms(config: Any) -> Iterator[list[Any]]:
    """What evolves within a recording and the output filter, in the order of the table: one of a
    kind for each axis, None where its size is zero."""
    for own in rows.terms_of(config):
        if isinstance(own, str):
            for line in getattr(config, own):
                yield from _terms(line)
            continue
        kind, parameters = own
        figures = {name: _parameter(config, keys) for name, keys in parameters.items()}
        size = figures[fields(kind)[0].name]
        yield [
            kind(**{name: values[axis] for name, values in figures.items()}) if x > 0 else None
            for axis, x in enumerate(size)
        ]


def _parameter(config: Any, keys: Sequence[str]) -> Triple:
    """A term's parameter on each axis, from whichever of its keys is given."""
    lowest = [key for key in keys if key in rows.named("minimum", config)]
    return _flicker(config, keys[0], lowest) if lowest else _one_of(config, keys)


def _drawn(config: Any) -> tuple[Proportional, ...]:
    """What is drawn once, in the order of its drawing."""
    found: dict[str, Proportional] = {}
    for key, size, kind in rows.drawn_of(config):
        found[kind.name] = found.get(kind.name, kind).sized(size, _axes(config, key))
    # An accelerometer's, too, is drawn: as it always was.
    found.setdefault("g_sensitivity", Proportional("g_sensitivity", "", "unit", FORCE, cross=NONE))
    later = [n for n, kind in found.items() if n not in FIRST and kind.sigma.any()]
    return tuple(found[name] for name in (*FIRST, *later))


def _figure(config: Any, key: str) -> float:
    """A figure that all axes share, SI."""
    return float(_scale(key) * getattr(config, key))


def _axes(config: Any, key: str) -> Triple:
    """A figure of each axis, SI."""
    value = getattr(config, key)
    x, y, z = value if isinstance(value, list) else [value] * 3
    scale = _scale(key)
    return (scale * x, scale * y, scale * z)


def _scale(key: str) -> float:
    """SI per unit of a key; 1 of a pure number."""
    return units.factor(key) if units.unit_of(key) else 1.0


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


def _flicker(config: Any, own: str, minimum: Sequence[str]) -> Triple:
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
    kinds = dict(one for one in rows.terms_of(config) if not isinstance(one, str))
    white, walk = _one_of(config, kinds[White]["N"]), _one_of(config, kinds[RandomWalk]["K"])
    short, long = (_one_of(config, kinds[Flicker][name])[0] for name in ("T_short", "T_long"))
    corners = (short, long)
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
