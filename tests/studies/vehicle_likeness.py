"""Does a simulated swaying vehicle look like the real one? What is compared, from records alone.

Everything here is the same for a real log and a simulated one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.signal

from lbgc.data.record import Record, block_means
from lbgc.data.windows import cut, joined
from lbgc.estimators.static import mean
from lbgc.metrics import heading_errors

BANDS_HZ = np.r_[0.05 * 2.0 ** (np.arange(23) / 3), 10.0]
"""Edges of the third-octave bands."""
SPELL_BAND_HZ, SPELL_BLOCK_S = (0.05, 2.0), 60.0
WINDOWS_S = (30.0, 60.0, 120.0)
FIGURES = ("median", "p75", "p90", "rmse")
EVERY_S = 10.0


def six_axes(record: Record) -> np.ndarray:
    """Rate and specific force side by side, (T, 6)."""
    return np.concatenate([record.gyro, record.accel], axis=1)


def band_psd(record: Record) -> np.ndarray:
    """One-sided PSD, mean over each third-octave band: (bands, 6), (rad/s)^2/Hz, (m/s^2)^2/Hz."""
    f, psd = scipy.signal.periodogram(six_axes(record), record.rate_hz, window="hann", axis=0)
    edges = np.searchsorted(f, BANDS_HZ)
    return np.add.reduceat(psd, edges, axis=0)[:-1] / np.diff(edges)[:, None]


def block_powers(record: Record) -> np.ndarray:
    """Power from 0.05 to 2 Hz in each 60 s: (blocks, 6)."""
    sos = scipy.signal.butter(4, SPELL_BAND_HZ, "band", fs=record.rate_hz, output="sos")
    band = scipy.signal.sosfiltfilt(sos, six_axes(record), axis=0)
    size = round(SPELL_BLOCK_S * record.rate_hz)
    count = len(band) // size
    return (band[: count * size].reshape(count, size, 6) ** 2).mean(axis=1)


def spell_spread(powers: np.ndarray) -> np.ndarray:
    """90th over 10th percentile of block powers (blocks, 6), an axis: (6,)."""
    low, high = np.percentile(powers, [10, 90], axis=0)
    return high / low


def baseline_figures(record: Record, truth: float) -> np.ndarray:
    """Of the plain mean's |heading error|, deg: (windows, figures), by WINDOWS_S and FIGURES.

    truth : rad, heading. Windows start every 10 s. (Turning them about the body's z axis would add
    nothing: the answer turns along, and the error stays.)
    """
    blocks = block_means(record, 1 / EVERY_S)
    table = []
    for window in WINDOWS_S:
        size = round(window / EVERY_S)
        each = [starting_at(blocks, i, size) for i in range(len(blocks.gyro) - size + 1)]
        found = mean(joined([cut(own, window) for own in each])).heading
        error = np.abs(np.rad2deg(heading_errors(found, np.full(len(found), truth))))
        table.append([*np.percentile(error, [50, 75, 90]), np.sqrt(np.mean(error**2))])
    return np.array(table)


def starting_at(record: Record, first: int, samples: int) -> Record:
    """A part of it."""
    part = slice(first, first + samples)
    own = {name: getattr(record, name)[part] for name in ("gyro", "accel", "plate_angle")}
    return replace(record, **own)


@dataclass(frozen=True)
class Likeness:
    """What is asked of the vehicle scene, simulated against real."""

    psd_ratio: np.ndarray  # (bands, 6): mean simulated over real
    spread_ratio: np.ndarray  # (6,): median over simulated logs of the spread, over the real one
    real: np.ndarray  # (windows, figures), deg
    low: np.ndarray  # likewise: 2.5% of the simulated logs
    high: np.ndarray  # 97.5%

    @property
    def within_2_percent(self) -> float:
        return float(100 * np.mean(np.abs(np.log2(self.psd_ratio)) <= 1))

    @property
    def worst_ratio(self) -> float:
        return float(np.exp(np.abs(np.log(self.psd_ratio)).max()))

    @property
    def inside(self) -> np.ndarray:
        """Which real figures lie in the simulated range."""
        return (self.low <= self.real) & (self.real <= self.high)


def likeness(
    real: Record, real_heading: float, simulated: Sequence[Record], headings: Sequence[float]
) -> Likeness:
    """Compare simulated logs with the real one; headings : rad, the truth of each."""
    psd = np.mean([band_psd(r) for r in simulated], axis=0)
    spreads = [spell_spread(block_powers(r)) for r in simulated]
    figures = [baseline_figures(r, h) for r, h in zip(simulated, headings, strict=True)]
    low, high = np.percentile(figures, [2.5, 97.5], axis=0)
    return Likeness(
        psd_ratio=psd / band_psd(real),
        spread_ratio=np.median(spreads, axis=0) / spell_spread(block_powers(real)),
        real=baseline_figures(real, real_heading),
        low=low,
        high=high,
    )
