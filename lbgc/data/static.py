"""A static recording to which noise is fitted: several recordings of a resting IMU, or of one of
its triads, cut to one length, and the test that they are one steady state."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from lbgc.data import course
from lbgc.data.record import Record, TriadRecord, require_on_plate, require_one_rate
from lbgc.errors import InputError
from lbgc.frames import AXES as AXES
from lbgc.frames import axis_names
from lbgc.sensor.fitting.counts import ENOUGH, count_size
from lbgc.sensor.fitting.goodness import bartlett

PARTS = ("gyro", "accel")
SHORTEST_S = 60.0
"""Length of a recording, s, to which noise is fitted, at least."""
_EIGHTHS = 8
"""Stretches of a recording whose powers are compared."""
_MATTERS = 3.0
"""Ratio of powers from which on a recording is not steady."""
_CHANCE = 5.7e-7 / 18
"""Chance of five sigma, divided among three axes of two sensors at three time scales."""


@dataclass(frozen=True)
class Static:
    """R resting recordings of one length and one clock."""

    name: str
    """The log's name in messages"""
    gyro: np.ndarray | None
    """(R, n, 3), rad/s, or of fewer axes alone; None where no gyros were recorded on this clock"""
    accel: np.ndarray | None
    """(R, n, 3), m/s^2, likewise"""
    dt: float
    """The samples' interval, s"""
    latitude: float
    """Latitude, rad; NaN where it is not known"""
    heading: np.ndarray | None
    """(R,), rad, headings; None unless all are known"""
    session: np.ndarray | None
    """(R,), the power-up that each recording is from; None where that is not known"""
    temperature: np.ndarray | None = None
    """(R, n), of the sensor, K or degrees Celsius; None unless all recordings have one"""
    turned: bool = False
    """Whether an even turn was taken off, whose scale errors look like a bias"""

    @property
    def triads(self) -> dict[str, np.ndarray]:
        """The samples of the triads that were recorded, (R, n, 3) each."""
        return {part: own for part in PARTS if (own := getattr(self, part)) is not None}

    @property
    def shape(self) -> tuple[int, int]:
        """The number of recordings, R, and of the samples of each, n."""
        first = next(iter(self.triads.values()))
        return first.shape[0], first.shape[1]

    def with_triads(self, values: Mapping[str, np.ndarray]) -> "Static":
        """These recordings with other samples."""
        return replace(self, gyro=values.get("gyro"), accel=values.get("accel"))


def at_rest(
    name: str,
    recorded: Sequence[Record] | Sequence[TriadRecord],
    session: np.ndarray | None,
    skip_s: float,
) -> tuple[Static, list[str]]:
    """Recordings of one clock, cut to one length, and what is noted of them.

    name : in messages; session : (R,), the power-up of each, or None; skip_s : s, left out at the
    start of each. Raises InputError where their rates differ, they are shorter than a minute, or of
    an IMU that was held in several attitudes.
    """
    require_one_rate(recorded)
    for own in recorded:
        if isinstance(own, Record):
            require_on_plate(own)
    turned = any(isinstance(own, Record) and course.turns_evenly(own) for own in recorded)
    parts = [course.resting_parts(own) if isinstance(own, Record) else [own] for own in recorded]
    records: list[Record | TriadRecord] = [one for own in parts for one in own]
    if session is not None:
        session = np.repeat(session, [len(own) for own in parts])
    notes = list(dict.fromkeys(note for record in records for note in record.notes))
    rate = records[0].rate_hz
    first = round(skip_s * rate)
    n, longest = (f(len(record.plate_angle) for record in records) for f in (min, max))
    if n < longest:
        notes.append(
            f"lengths: recordings have {n / rate:g} to {longest / rate:g} s, and the first "
            f"{n / rate:g} s of each are used; their biases are free"
        )
    seconds = max(0, n - first) / rate
    if seconds < SHORTEST_S:
        raise InputError(
            name, f"{seconds:g}", "s", f"is too short to tell noise from bias; {SHORTEST_S:g} s "
            "at the least, and an hour to see a bias instability"
        )  # fmt: skip
    warmth = [own.temperature[first:n] for own in records if own.temperature is not None]
    triads = {
        part: _stacked([own.triads[part][first:n] for own in records]) for part in records[0].triads
    }
    headings = [own.heading_reference for own in records]
    static = Static(
        name,
        triads.get("gyro"),
        triads.get("accel"),
        1 / rate,
        records[0].latitude,
        None if any(h is None for h in headings) else np.array(headings, dtype=float),
        session,
        np.stack(warmth) if len(warmth) == len(records) else None,
        turned,
    )
    return static, notes


def _stacked(values: list[np.ndarray]) -> np.ndarray:
    """Arrays of one shape as one, (R, *shape); of a single one no copy is made."""
    return values[0][None] if len(values) == 1 else np.stack(values)


def require_steady(static: Static) -> None:
    """Raise InputError where a recording is not one steady state, or where a channel never changes.

    For a resting IMU the differences between neighbouring samples, means over 0.1 s and means over
    1 s have the same power throughout. A recording is refused where the powers of eight stretches
    differ by a factor of three, and by more than five sigma of what as many differences may have by
    chance.
    """
    for part, values in static.triads.items():
        still = np.ptp(values, axis=1).min(axis=0)
        if not still.all():
            dead = axis_names(len(still))[int(np.argmin(still))]
            raise InputError(
                static.name,
                f"{part} {dead}",
                "",
                "never changes: a dead channel, or counts far coarser than its noise; there is "
                "none to fit",
            )
    for part, axis in ((part, k) for part, v in static.triads.items() for k in range(v.shape[2])):
        one = static.triads[part][:, :, axis]
        if _is_coarse(one):
            continue  # how often a count changes depends on where the mean lies within it
        for seconds in (static.dt, 0.1, 1.0):
            block = max(1, round(seconds / static.dt))
            count = one.shape[1] // block
            if count < _EIGHTHS * 10:
                continue
            means = one[:, : count * block].reshape(len(one), count, block).mean(axis=2)
            ratio, p = _unsteadiness(np.diff(means, axis=1))
            if ratio > _MATTERS and p < _CHANCE:
                name = axis_names(static.triads[part].shape[2])[axis]
                raise InputError(
                    static.name, f"{ratio:.3g}", "", f"times as much {part} noise in one eighth of "
                    f"the log as in another, on the {name} axis: something moved, or shook "
                    "it; noise is fitted to a resting IMU, so cut the log to a quiet stretch"
                )  # fmt: skip


def _is_coarse(series: np.ndarray) -> bool:
    """Whether samples (R, n) have counts that the noise from sample to sample does not dither."""
    lsb = count_size(series[0])
    noise = np.mean(np.diff(series, axis=1) ** 2) / 2
    return lsb is not None and noise < (ENOUGH**2 + 1 / 12) * lsb**2


def _unsteadiness(differences: np.ndarray) -> tuple[float, float]:
    """The largest power of an eighth over the least, and the p-value that eighths differ as much.

    differences : (R, n), unit. The number of independent ones among them is (sum of S)^2/(sum of
    S^2) over the frequencies, with S their spectrum, the mean over the eighths; the squares of a
    raw periodogram are twice as large as those of S.
    """
    size = scipy.fft.prev_fast_len(differences.shape[1] // _EIGHTHS, real=True)
    eighths = np.array_split(differences, _EIGHTHS, axis=1)
    power = np.array([np.mean(e**2) for e in eighths])
    periodogram = np.zeros(size // 2 + 1)
    for one in eighths:
        periodogram += np.sum(np.abs(np.fft.rfft(one[:, :size], axis=1)) ** 2, axis=0)
    series = _EIGHTHS * len(differences)
    spread = 1 + 1 / series  # mean square of the mean periodogram over S^2
    freedom = 2 * spread * np.sum(periodogram) ** 2 / np.sum(periodogram**2) * series
    ratio = float(power.max() / max(power.min(), 1e-300))
    return ratio, bartlett(np.maximum(power, 1e-300), freedom / _EIGHTHS)
