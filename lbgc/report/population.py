"""The spread of coefficients between units in the user's words and units: table and JSON."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from lbgc.data.finished_fits import Found
from lbgc.data.static import PARTS
from lbgc.errors import require
from lbgc.frames import axis_names
from lbgc.report.fitted import KEYS, WORDS, scale_of
from lbgc.sensor.fitting.population import Population, population
from lbgc.sensor.fitting.profile import FittedParameter
from lbgc.units import unit_of

_ASKED = ("N", "B", "K", "Q", "GM_sigma", "GM_T")
"""Parameters of which a spread is told, where every unit has them."""

Told = dict[str, list[dict[str, Population | None]]]
"""Each axis's populations, by triad and by the parameter's name; None where a unit has a limit"""


def populations(units: Sequence[Found]) -> Told:
    """The populations of every coefficient that all units have, of every axis."""
    parts = [part for part in PARTS if all(part in unit for unit in units)]
    out: Told = {}
    for part in parts:
        out[part] = []
        few = {len(unit[part]) for unit in units}
        require(
            len(few) == 1, "units", few, f"have fits of so many axes of their {part}s: one kind"
        )
        for axis in range(few.pop()):
            every = [unit[part][axis] for unit in units]
            names = [name for name in _ASKED if all(name in own for own in every)]
            out[part].append({name: population([own[name] for own in every]) for name in names})
    return out


def report(told: Told, units: int) -> str:
    """The populations as text. units : their number."""
    lines = [f"{units} units; a median unit, and the spread between units (1 sigma of ln)"]
    for which, part in enumerate(PARTS):
        own = told.get(part, [])
        for axis, found in zip(axis_names(len(own)), own, strict=len(own) > 0):
            lines.append(f"{part} {axis}")
            for name, one in found.items():
                lines.append(f"  {WORDS[name]:30s} {_said(one, KEYS[name][which])}")
    return "\n".join(lines)


def _said(one: Population | None, key: str) -> str:
    """One coefficient's population in words."""
    if one is None:
        return "cannot be told: some unit's log has only a limit; give longer logs"
    scale, m = scale_of(key), one.median
    median = (
        f"{m.value / scale:.4g} {unit_of(key)}, 95% {m.low / scale:.4g} to {m.high / scale:.4g}"
    )
    return f"{median}; between units {_spread(one)}"


def _spread(one: Population) -> str:
    """The spread in percent, with its interval or limit, in words."""
    e = one.spread
    if e.is_withheld:
        return "no spread: they are closer together than their own errors make likely"
    if e.is_limit:
        return f"below {100 * e.upper:.3g}% (95%); they may be alike (p = {one.p_alike:.2g})"
    return f"{100 * e.value:.3g}%, 95% {100 * e.low:.3g} to {100 * e.high:.3g}%"


def as_content(told: Told) -> dict:
    """The populations as JSON, in SI; null for an end that is not finite."""
    return {
        part: [{n: None if p is None else _plain(p) for n, p in own.items()} for own in axes]
        for part, axes in told.items()
    }


def _plain(one: Population) -> dict:
    """One population as JSON."""

    def ends(e: FittedParameter) -> dict:
        """An estimate's numbers, null where not finite."""
        return {key: v if np.isfinite(v) else None for key, v in asdict(e).items()}

    return {
        "median": ends(one.median),
        "spread": ends(one.spread),
        "units": one.units,
        "p_alike": one.p_alike,
    }
