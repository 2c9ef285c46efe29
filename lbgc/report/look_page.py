"""The log doctor's picture of a recording: its course, its spectra and its Allan deviations."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import welch

from lbgc.data.looking.doctor import Look
from lbgc.data.readers.blocks import blocks
from lbgc.data.record import Record, TriadRecord
from lbgc.earth import EARTH_RATE
from lbgc.outputs import shown
from lbgc.report.figures import AXIS_COLOURS, AXIS_NAMES
from lbgc.report.look_text import Deviations
from lbgc.units import DEG, HOUR, STANDARD_GRAVITY

_POINTS = 1500
"""Means along the time axis, at most."""
_ROOM = 1.5
"""The height of a picture of what rests, over what it holds."""
_MEANS, _BELOW = 2**20, 0.1
"""Values of which a spectrum is taken at once; and the share of the rate of block means up to which
they show the density of what they are means of."""
_TRIADS = (
    ("gyro", HOUR / DEG, "deg/h"),
    ("accel", 1e3 / STANDARD_GRAVITY, "mg"),
)


def draw(look: Look, found: Deviations) -> Figure:
    """The picture of a file's recording. found : its Allan deviations."""
    still = look.rest
    record = still if look.record is None else look.record
    assert record is not None
    assert still is not None
    taus, allan = found
    figure = Figure(figsize=(11.0, 3.3 * len(allan)), layout="constrained")
    figure.suptitle(shown(look.path.name).replace("$", r"\$"))
    axes = figure.subplots(len(allan), 3, squeeze=False)
    rows = {part: at for at, part in enumerate(allan)}
    for part, scale, unit in _TRIADS:
        if part not in allan:
            continue
        row, deviation = rows[part], allan[part]
        _course(axes[row, 0], record, still, part, scale)
        axes[row, 0].set(ylabel=f"{part}, {unit}", title="less its mean at rest")
        _spectrum(axes[row, 1], still.triads[part], scale, still.rate_hz)
        axes[row, 1].set(ylabel=f"{unit}/sqrt(Hz)", title="spectral density, one-sided")
        for axis in range(len(deviation)):
            axes[row, 2].loglog(taus, deviation[axis] * scale, color=AXIS_COLOURS[axis])
        axes[row, 2].set(xlabel="averaging time, s", ylabel=unit, title="Allan deviation")
    if "gyro" in rows:
        _earth(axes[rows["gyro"], 2], record.latitude, float(taus[0]))
    for own in axes.flat:
        own.grid(True, which="both", color="0.92", linewidth=0.5)
        own.title.set_fontsize("small")
    if still is not record:
        _beside(axes[0, 0], record, record.plate_angle / DEG, "plate, deg")
    if record.temperature is not None:
        _beside(axes[-1, 0], record, record.temperature, "temperature")
    axes[0, 0].legend(fontsize="x-small", loc="upper left")
    return figure


def _earth(axes: Axes, latitude: float, tau: float) -> None:
    """Draw Earth's rate among the Allan deviations: its horizontal part at a latitude, rad, that is
    known, beginning at an averaging time, s."""
    placed = np.isfinite(latitude)
    earth = EARTH_RATE * HOUR / DEG * (np.cos(latitude) if placed else 1.0)
    axes.axhline(earth, color="0.6", linewidth=0.8, dashes=(4, 3))
    said = "Earth's horizontal rate" if placed else "Earth's rate"
    axes.annotate(said, (tau, earth), color="0.4", fontsize="x-small", va="bottom")


def _course(
    axes: Axes, record: Record | TriadRecord, still: Record | TriadRecord, part: str, scale: float
) -> None:
    """Block means of a triad, less their mean at rest, over time, on the scale of what rests. scale
    : units of the figure in SI's."""
    t, means = _means(record, record.triads[part])
    _, rest = _means(still, still.triads[part])
    middle = rest.mean(axis=0)
    for axis, name in enumerate(AXIS_NAMES[: means.shape[1]]):
        axes.plot(t, (means[:, axis] - middle[axis]) * scale, color=AXIS_COLOURS[axis],
                  linewidth=0.7, label=name)  # fmt: skip
    if still is not record:
        most = _ROOM * float(np.abs(rest - middle).max()) * scale
        if part == "gyro":  # which turns with the plate
            most += 2 * EARTH_RATE * scale
        axes.set_ylim(-most, most)
    axes.set(xlabel=f"t, s (means of {len(record.plate_angle) / record.rate_hz / len(t):.3g} s)")


def _means(record: Record | TriadRecord, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times, s, and means of values (T, ...) over blocks of a recording."""
    size = max(1, len(values) // _POINTS)
    count = len(values) // size
    means = values[: size * count].reshape(count, size, *values.shape[1:]).mean(axis=1)
    return (np.arange(count) + 0.5) * size / record.rate_hz, means


def _beside(axes: Axes, record: Record | TriadRecord, values: np.ndarray, label: str) -> None:
    """Draw what was recorded beside the sensors, (T,), on an axis of its own."""
    own = axes.twinx()
    own.plot(*_means(record, values), color="0.6", linewidth=0.8, zorder=0)
    own.set_ylabel(label, color="0.4")


def _spectrum(axes: Axes, values: np.ndarray, scale: float, rate_hz: float) -> None:
    """The square root of the one-sided spectral density of values (T, 3): of a long recording that
    of its block means below the frequencies that these show rightly, and its own above. scale :
    units of the figure in one of the values."""
    size = -(-len(values) // _MEANS)
    above = 0.0
    if size > 1:
        count = len(values) // size
        means = values[: size * count].reshape(count, size, values.shape[1]).mean(axis=1)
        above = _BELOW * rate_hz / size
        _density(axes, means, scale, rate_hz / size, (0.0, above))
    _density(axes, values, scale, rate_hz, (above, np.inf))
    axes.set(xlabel="Hz")


def _density(
    axes: Axes, values: np.ndarray, scale: float, rate_hz: float, within: tuple[float, float]
) -> None:
    """Draw the root density of values (T, 3) in a band of frequencies, Hz, by the mean over parts
    of them."""
    longest = min(len(values), 2 ** int(np.log2(max(min(len(values), _MEANS) // 8, 8))))
    parts = [values[own] for own in blocks(len(values), _MEANS) if own.stop - own.start >= longest]
    found = [welch(part, rate_hz, nperseg=longest, axis=0) for part in parts]
    frequency, density = found[0][0], np.mean([own[1] for own in found], axis=0)
    shown = (frequency > within[0]) & (frequency <= within[1])
    for axis in range(density.shape[1]):
        axes.loglog(frequency[shown], np.sqrt(density[shown, axis]) * scale,
                    color=AXIS_COLOURS[axis], linewidth=0.7)  # fmt: skip
