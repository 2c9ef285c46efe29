"""Checks for samples that were spoiled on their way into the file: channels that are stuck, spikes,
values that stand for missing ones, stretches pasted twice."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lbgc.data.checks.findings import Finding
from lbgc.data.checks.pasted import pasted
from lbgc.data.checks.printed import Channel, listed
from lbgc.data.readers.blocks import blocks, some
from lbgc.data.record import Record, TriadRecord

_FEWEST = 200
"""Samples below which nothing is checked."""
_SPIKE, _LOCAL = 8.0, 2.5
"""A spike's least size, in sigma of the channel and in ranges of its eight neighbours."""
_NEIGHBOURS = np.array([-5, -4, -3, -2, 2, 3, 4, 5])
"""Those neighbours, relative to the sample."""
_MOST_CANDIDATES = 20_000
"""Samples that may be spikes, at most; where there are more, none is."""
_ALONE = 50.0
"""Least distance of a value that stands for a missing one from all others, in sigma."""
_OF_NOISE, _OF_MEAN = 0.05, 0.5
"""The share of the noise's variance, and the shift of the mean in its sigma, above which spikes are
refused."""
_LONGEST_PERSISTENCE = 0.9
"""Probability that a value is repeated above which no run of equal values is too long."""


def stuck_finding(record: Record | TriadRecord, every: Sequence[Channel]) -> Finding | None:
    """The finding that channels print one value throughout, or for longer than their noise allows;
    None where none does."""
    if len(record.plate_angle) < _FEWEST:
        return None
    whole = [c for c in every if _is_dead(c, every)]
    if whole:
        says = f"{listed([c.name for c in whole])} never changes while others do: a dead channel, "
        says += "or a wrong column"
        name = f"{record.name}: {whole[0].name}"
        return Finding("stuck", name, whole[0].shown(whole[0].at(0)), "", says)
    runs = [(c, *_longest_stay(c)) for c in every]
    stuck = [(c, start, length) for c, start, length in runs if length]
    if not stuck:
        return None
    channel, start, length = max(stuck, key=lambda run: run[2])
    begin, end = start / record.rate_hz, (start + length) / record.rate_hz
    says = f"{listed([c.name for c, *_ in stuck])} stays at one value, {channel.name} from "
    says += f"{begin:.5g} to {end:.5g} s, longer than its noise allows; cut the log there"
    value = channel.shown(channel.at(start))
    return Finding("stuck", f"{record.name}: {channel.name}", value, "", says)


def _is_dead(channel: Channel, every: Sequence[Channel]) -> bool:
    """Whether a channel is constant for another reason than coarse counts of its triad, with which
    the triad's other two channels would hardly change either."""
    if channel.levels.number > 1:
        return False
    triad = channel.name.split()[0]
    siblings = [c for c in every if c.name.startswith(triad) and c is not channel]
    return any(c.levels.number > 1 and not _hardly_changes(c) for c in siblings)


def _hardly_changes(channel: Channel) -> bool:
    """Whether a channel has four values or fewer, or coarse counts."""
    return channel.levels.number <= 4 or channel.is_coarse


def _longest_stay(channel: Channel) -> tuple[int, int]:
    """The first sample of the longest run of one value, and its number of samples; 0 samples where
    the run may be chance. In the rest of the channel a value is repeated with the probability q,
    and a repeated one once more with p, so that chance makes n max(p, q)^(L - 1) runs of L
    samples."""
    same = channel.same
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(np.int8)))
    starts, ends = edges[::2], edges[1::2]
    if len(starts) == 0:
        return 0, 0
    longest = int((ends - starts).argmax())
    start, length = int(starts[longest]), int(ends[longest] - starts[longest]) + 1
    rest = np.r_[same[:start], same[start + length - 1 :]]
    if len(rest) < _FEWEST / 2:
        return 0, 0
    equal = float(rest.mean())
    again = float((rest[1:] & rest[:-1]).sum() / max(rest[:-1].sum(), 1))
    persistence = max(equal, again, 0.05)
    if persistence > _LONGEST_PERSISTENCE:
        return 0, 0
    enough = 1 + (np.log(len(same)) + 20) / -np.log(persistence)
    return (start, length) if length > max(10, 1.5 * enough) else (0, 0)


@dataclass(frozen=True)
class _Spikes:
    """The spikes of one channel."""

    channel: Channel
    """The channel"""
    rows: np.ndarray
    """(k,), the spikes' samples"""
    away: np.ndarray
    """(k,), SI, distance of each spike from its neighbours"""

    @property
    def share_of_noise(self) -> float:
        """The power of the spikes over that of the channel's noise."""
        n = self.channel.samples
        noise = max(self.channel.noise, self.channel.count / 4)
        return float(np.sum((self.away / noise) ** 2)) / n if noise > 0 else np.inf

    @property
    def shift(self) -> float:
        """The shift of the channel's mean by the spikes, in sigma of that mean by the noise from
        sample to sample."""
        n = self.channel.samples
        noise = max(self.channel.noise, self.channel.count / 4) / np.sqrt(n)
        return abs(float(np.sum(self.away))) / n / noise if noise > 0 else np.inf


def outliers_finding(record: Record | TriadRecord, every: Sequence[Channel]) -> Finding | None:
    """The finding that single samples are far from their neighbours, or that values stand for
    missing ones (-999, 0, 32767); None where there are no such samples."""
    if len(record.plate_angle) < _FEWEST:
        return None
    found = [spikes for c in every if len((spikes := _spikes(c)).rows)]
    if not found:
        return None
    worst = max(found, key=lambda s: s.share_of_noise)
    row = int(worst.rows[np.abs(worst.away).argmax()])
    channel = worst.channel
    total = sum(len(s.rows) for s in found)
    says = f"{total} samples of {listed([s.channel.name for s in found])} are far from their "
    says += f"neighbours, the farthest in row {row} ({row / record.rate_hz:.5g} s)"
    alike = int(np.sum(channel.at(worst.rows) == channel.at(row)))
    if alike > 2:
        says += f"; {alike} are exactly this: it may stand for a missing one"
    refuses = any(s.share_of_noise > _OF_NOISE or s.shift > _OF_MEAN for s in found)
    says += "; take them out" if refuses else "; too few to matter"
    name = f"{record.name}: {channel.name}"
    return Finding("outliers", name, channel.shown(channel.at(row)), "", says, refuses)


def _spikes(channel: Channel) -> _Spikes:
    """The spikes of a channel, or its values that stand for missing ones, where there are any."""
    none = _Spikes(channel, np.empty(0, int), np.empty(0))
    if channel.levels.number < 2:
        return none
    sentinel = _apart(channel)
    if len(sentinel):
        centre = float(np.median(some(channel.column))) * channel.sign
        return _Spikes(channel, sentinel, channel.at(sentinel) - centre)
    bend = _bends(channel.column)
    sigma = float(np.median(some(bend))) / 0.6745 / np.sqrt(1.5)
    if channel.is_counted:
        sigma = max(sigma, channel.count)
    sigma = max(sigma, channel.noise)
    if sigma == 0:
        return none
    rows = np.flatnonzero(bend > _SPIKE * sigma)
    if len(rows) == 0 or len(rows) > _MOST_CANDIDATES:
        return none
    near = np.clip(rows[:, None] + _NEIGHBOURS, 0, channel.samples - 1)
    beside = channel.at(near)
    away = channel.at(rows) - np.median(beside, axis=1)
    far = (np.abs(away) > _SPIKE * sigma) & (np.abs(away) > _LOCAL * np.ptp(beside, axis=1))
    return _Spikes(channel, rows[far], away[far])


def _bends(x: np.ndarray) -> np.ndarray:
    """The distance of each of the values (T,) from the middle of those three samples before and
    behind it."""
    bend = np.empty(len(x))
    for own in blocks(len(x) - 6):
        a, b = own.start, own.stop
        bend[a + 3 : b + 3] = x[a + 3 : b + 3] - (x[a:b] + x[a + 6 : b + 6]) / 2
    bend[:3], bend[-3:] = x[:3] - x[3:6], x[-3:] - x[-6:-3]
    return np.abs(bend, out=bend)


def _apart(channel: Channel) -> np.ndarray:
    """The rows of a smallest or largest value that is printed several times and is far from all
    other values."""
    if channel.levels.number < 3 or channel.is_coarse:
        return np.empty(0, int)
    (low, low_counts), (high, high_counts) = channel.levels.lowest, channel.levels.highest
    rows = []
    for value, count, gap, inner in (
        (low[0], low_counts[0], low[1] - low[0], high[0] - low[1]),
        (high[0], high_counts[0], high[0] - high[1], high[1] - low[0]),
    ):
        far = gap > max(_ALONE * channel.noise, 2 * inner, 4 * channel.count)
        if far and 1 < count < channel.samples / 2:
            rows.append(np.flatnonzero(channel.column == channel.sign * value))
    return np.concatenate(rows) if rows else np.empty(0, int)


def pasted_finding(record: Record | TriadRecord) -> Finding | None:
    """The finding that stretches of all channels occur in the recording twice; None where there
    are none."""
    if len(record.plate_angle) < _FEWEST:
        return None
    found = pasted(*record.triads.values())
    if not found:
        return None
    rows = sum(stretch.rows for stretch in found)
    said = []
    for one in found[:3]:
        a, b, length = (k / record.rate_hz for k in (one.first, one.again, one.rows))
        said.append(f"{length:.4g} s from {a:.5g} s stand again from {b:.5g} s")
    says = "; ".join(said) + (f"; and {len(found) - 3} more" if len(found) > 3 else "")
    channels = "six" if len(record.triads) > 1 else "three"
    says += f", to the last digit in all {channels} channels: samples that were never measured"
    return Finding("pasted", f"{record.name}: rows that stand twice", rows, "", says)
