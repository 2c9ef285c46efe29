"""Estimated headings where the true ones are not known: headings and sigmas, without errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lbgc.frames import wrap

MOST_LINES = 24
"""Largest number of windows of one length that the screen shows one by one."""
_COLUMNS = ("estimator", "window, s", "windows", "heading", "sigma of one", "scatter")


@dataclass(frozen=True)
class Headings:
    """One estimator's answers to the W windows of one recording, degrees."""

    recording: str
    start_s: np.ndarray = field(repr=False)
    """(W,), start of each window since the recording's start"""
    heading_deg: np.ndarray = field(repr=False)
    """(W,), from 0 to 360"""
    sigma_deg: np.ndarray = field(repr=False)
    """(W,), NaN where none is stated"""
    at_least: bool
    """Whether sigmas are lower bounds."""

    @property
    def mean_deg(self) -> float:
        """The circular mean of the windows' headings, from 0 to 360."""
        return float(np.rad2deg(np.angle(np.mean(np.exp(1j * np.deg2rad(self.heading_deg)))))) % 360

    @property
    def scatter_deg(self) -> float:
        """Standard deviation of the windows' headings about their mean; NaN for one window."""
        if len(self.heading_deg) < 2:
            return float("nan")
        off = wrap(np.deg2rad(self.heading_deg - self.mean_deg))
        return float(np.rad2deg(np.sqrt(np.sum(off**2) / (len(off) - 1))))

    @property
    def one_sigma_deg(self) -> float:
        """Root mean square of the windows' sigmas."""
        return float(np.sqrt(np.mean(self.sigma_deg**2)))

    def as_json(self) -> dict:
        """The headings and their figures, with None for values that are not finite."""
        each = zip(self.start_s, self.heading_deg, self.sigma_deg, strict=True)
        return {
            "recording": self.recording,
            "windows": len(self.start_s),
            "heading_deg": self.mean_deg,
            "scatter_deg": _number(self.scatter_deg),
            "sigma_deg": _number(self.one_sigma_deg),
            "sigma_is_at_least": self.at_least,
            "each": [
                {"start_s": float(t), "heading_deg": round(float(h), 6), "sigma_deg": _number(s)}
                for t, h, s in each
            ],
        }


Table = Mapping[tuple[str, float], Sequence[Headings]]
"""Headings by estimator and window length: one for each recording."""


def _number(value: float) -> float | None:
    """A number for JSON, to six decimals; None where it is not finite."""
    return round(float(value), 6) if np.isfinite(value) else None


def spelled(sigma_deg: float, at_least: bool) -> str:
    """A sigma as text, with ">=" where it is a lower bound."""
    if not np.isfinite(sigma_deg):
        return "-"
    return (">= " if at_least else "") + f"{sigma_deg:.2f}"


def rows(found: Table) -> tuple[list[str], list[list[str]]]:
    """A table's header, and a row for each estimator, window length and recording."""
    several = len({own.recording for each in found.values() for own in each}) > 1
    lines = [
        [
            name,
            f"{window:g}",
            *([own.recording] if several else []),
            str(len(own.start_s)),
            f"{own.mean_deg:.2f}",
            spelled(own.one_sigma_deg, own.at_least),
            "-" if np.isnan(own.scatter_deg) else f"{own.scatter_deg:.2f}",
        ]
        for (name, window), each in found.items()
        for own in each
    ]
    head = list(_COLUMNS)
    return [*head[:2], *(["recording"] if several else []), *head[2:]], lines


def one_by_one(found: Table) -> tuple[list[str], list[list[str]], int]:
    """A table's header, a row for each of the longest windows with every estimator's heading and
    sigma, and the number of windows left out because the table would be too long."""
    longest = max(window for _, window in found)
    names = [name for name, window in found if window == longest]
    lines = []
    recordings = dict.fromkeys(own.recording for name in names for own in found[name, longest])
    for recording in recordings:
        own = {n: h for n in names for h in found[n, longest] if h.recording == recording}
        for row, start in enumerate(next(iter(own.values())).start_s):
            answers = [
                f"{h.heading_deg[row]:.2f} ({spelled(h.sigma_deg[row], h.at_least)})"
                for h in own.values()
            ]
            lines.append([recording, f"{start:g}", *answers])
    head = [f"windows of {longest:g} s", "from, s", *(f"{name} (sigma)" for name in names)]
    return head, lines[:MOST_LINES], max(0, len(lines) - MOST_LINES)
