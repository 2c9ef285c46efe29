"""The Allan figures of a static recording: with the fitted terms, and in the paper's form."""

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lbgc.earth import EARTH_RATE
from lbgc.frames import axis_names
from lbgc.report import fitted_curve
from lbgc.report.figures import AXIS_COLOURS, AXIS_NAMES
from lbgc.report.fitted import explained
from lbgc.sensor import noise
from lbgc.sensor.allan import confidence_band, octave_taus, overlapping_deviation
from lbgc.sensor.fitting.allan_fit import CurveFit
from lbgc.sensor.fitting.noise_fit import Fit
from lbgc.units import DEG, HOUR, STANDARD_GRAVITY

_UNIT = {"gyro": (DEG / HOUR, "deg/h"), "accel": (1e-6 * STANDARD_GRAVITY, "ug")}


@dataclass(frozen=True)
class AllanData:
    """The static recordings of one triad, of which the figures are drawn."""

    part: str
    """gyro or accel"""
    series: np.ndarray
    """(R, n, axes), rad/s or m/s^2, of R recordings"""
    dt: float
    latitude: float


def draw(data: AllanData, fits: Sequence[Fit]) -> dict[str, Figure]:
    """The figures of one triad and of its axes' fits, by file name."""
    taus = octave_taus(data.series.shape[1], data.dt)
    measured = overlapping_deviation(data.series[:16], data.dt, taus)
    drawn = {
        f"allan_{data.part}": _with_terms(data, fits, taus, measured, _settled(data, fits, taus)),
        f"spectrum_{data.part}": _spectra(data.part, fits),
    }
    if data.part == "gyro":
        drawn["allan_paper"] = _as_the_paper(data, fits, taus, measured)
    return drawn


def draw_curve(part: str, found: Sequence[CurveFit]) -> Figure:
    """The points of a triad's published Allan curves, with the fitted curve and each term's. part :
    gyro or accel; found : one for all axes, or one each."""
    scale, unit = _UNIT[part]
    figure = Figure(figsize=(12 if len(found) > 1 else 5.5, 4.4), layout="constrained")
    names = AXIS_NAMES if len(found) > 1 else ("forward, right, down",)
    for k, (one, name) in enumerate(zip(found, names, strict=True)):
        axes = figure.add_subplot(1, len(found), k + 1)
        taus, deviation = one.curve.taus, one.curve.deviation / scale
        fine = np.geomspace(taus[0], taus[-1], 500)
        axes.loglog(taus, deviation, "o", color=AXIS_COLOURS[k], markersize=3.5, label="as printed")
        _lines(axes, one.fit, fine, scale)
        axes.set_ylim(deviation.min() / 5, deviation.max() * 3)
        axes.set(title=f"{part} {name}", xlabel="averaging time, s", ylabel=unit)
        _write_below(axes, f"goodness of fit {fitted_curve.explained(one)}", one.fails)
        axes.grid(True, which="both", color="0.92", linewidth=0.5)
        axes.legend(fontsize="x-small")
    return figure


def _lines(axes: Axes, fit: Fit, fine: np.ndarray, scale: float) -> None:
    """Draw the fitted Allan deviation and each term's at these averaging times. scale : SI per unit
    of the figure."""
    curve = np.sqrt(noise.allan_variance(fit.everything, fine))
    axes.loglog(fine, curve / scale, color="black", linewidth=1.2, label="fit")
    for term in fit.everything:
        deviation = np.sqrt(term.allan_variance(fine)) / scale
        axes.loglog(fine, deviation, "--", linewidth=0.8, label=term.cause)


def _settled(data: AllanData, fits: Sequence[Fit], taus: np.ndarray) -> np.ndarray | None:
    """Allan deviation, (3, S), of the data that the noise was fitted to: one recording less its
    warm-ups and steps. None where it has none, or where there are several recordings."""
    courses = [[c for c in fit.courses if c.kind != "ramp"] for fit in fits]
    if len(data.series) > 1 or not any(courses):
        return None
    edges = data.dt * np.arange(data.series.shape[1] + 1)
    found = []
    for axis, own in enumerate(courses):
        rest = np.array(data.series[:, :, axis, None])
        for course in own:
            rest -= course.means(edges)[:, None]
        found.append(overlapping_deviation(rest, data.dt, taus)[0])
    return np.array(found)


def _with_terms(
    data: AllanData,
    fits: Sequence[Fit],
    taus: np.ndarray,
    recorded: np.ndarray,
    settled: np.ndarray | None,
) -> Figure:
    """Measured Allan deviation with its 95% band, the fitted curve, and each term's, by axis.
    settled : the deviation after warm-ups and steps were taken out, where there were any."""
    measured = recorded if settled is None else settled
    scale, unit = _UNIT[data.part]
    figure = Figure(figsize=(4 * max(len(fits), 1.4), 4.4), layout="constrained")
    fine = np.geomspace(taus[0], taus[-1], 2000)
    for axis, (fit, name) in enumerate(zip(fits, axis_names(len(fits)), strict=True)):
        axes = figure.add_subplot(1, len(fits), axis + 1)
        curve = np.sqrt(noise.allan_variance(fit.everything, fine))
        slopes = np.interp(taus, fine, np.gradient(np.log(curve), np.log(fine)))
        band = confidence_band(measured[axis], taus, data.series.shape[1], data.dt, slopes)
        axes.fill_between(
            taus, band[0] / scale, band[1] / scale, color=AXIS_COLOURS[axis], alpha=0.2
        )
        axes.loglog(taus, measured[axis] / scale, "o", color=AXIS_COLOURS[axis], markersize=3.5,
                    label="measured, 95%")  # fmt: skip
        if settled is not None and any(c.kind != "ramp" for c in fit.courses):
            axes.loglog(taus, recorded[axis] / scale, "o", color="0.5", markersize=3.5,
                        fillstyle="none", label="with what was taken out")  # fmt: skip
        _lines(axes, fit, fine, scale)
        lowest = measured[axis].min() / scale
        axes.set_ylim(lowest / 5, recorded[axis].max() / scale * 3)
        axes.set(title=f"{data.part} {name}", xlabel="averaging time, s", ylabel=unit)
        _say_how_good(axes, fit)
        axes.grid(True, which="both", color="0.92", linewidth=0.5)
        axes.legend(fontsize="x-small")
    return figure


def _say_how_good(axes: Axes, fit: Fit) -> None:
    """Write the goodness of fit below the curves, in red where the fit fails."""
    bad = fit.goodness is not None and fit.goodness.fails
    _write_below(axes, f"goodness of fit {explained(fit)}", bad)


def _write_below(axes: Axes, text: str, bad: bool) -> None:
    """Write a text below the curves, in red where it is bad news."""
    text = "\n".join(wrap(text, 60))
    drawn = axes.text(
        0.5, 0.01, text, transform=axes.transAxes, color="firebrick" if bad else "0.3"
    )
    drawn.set(ha="center", va="bottom", fontsize="x-small")


def _spectra(part: str, fits: Sequence[Fit]) -> Figure:
    """The recorded spectral density, two-sided, in bins, and the fitted model's, by axis."""
    scale, unit = _UNIT[part]
    figure = Figure(figsize=(4 * max(len(fits), 1.4), 4.4), layout="constrained")
    for axis, (fit, name) in enumerate(zip(fits, axis_names(len(fits)), strict=True)):
        axes = figure.add_subplot(1, len(fits), axis + 1)
        if fit.spectrum is None:
            continue
        s = fit.spectrum
        recorded, model = (np.sqrt(np.maximum(d, 0)) / scale for d in (s.recorded, s.model))
        axes.loglog(s.f, recorded, ".", color=AXIS_COLOURS[axis], markersize=2, label="recorded")
        axes.loglog(s.f, model, color="black", linewidth=1.2, label="fit")
        axes.set(title=f"{part} {name}", xlabel="frequency, Hz", ylabel=f"{unit}/sqrt(Hz)")
        axes.set_ylim(model.min() / 4, model.max() * 3)
        _say_how_good(axes, fit)
        axes.grid(True, which="both", color="0.92", linewidth=0.5)
        axes.legend(fontsize="x-small", loc="upper right")
    return figure


def _as_the_paper(
    data: AllanData, fits: Sequence[Fit], taus: np.ndarray, measured: np.ndarray
) -> Figure:
    """The paper's three figures: the Allan deviation with Earth's rate and the square root of the
    CRLB (white noise alone, N/sqrt(tau)), SNR = 20 log10(Omega/sigma(tau)), and the running mean's
    norm."""
    scale, _ = _UNIT["gyro"]
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    allan, snr, running = (figure.add_subplot(1, 3, i) for i in (1, 2, 3))
    for axis, name in enumerate(axis_names(len(fits))):
        colour = AXIS_COLOURS[axis]
        allan.loglog(taus, measured[axis] / scale, "o-", color=colour, markersize=3, label=name)
        snr.semilogx(taus, 20 * np.log10(EARTH_RATE / measured[axis]), color=colour, label=name)
    white = float(np.mean([fit.estimates["N"].value for fit in fits]))
    allan.axhline(EARTH_RATE / scale, color="green", linestyle="--", label="Earth's rate")
    allan.loglog(taus, white / np.sqrt(taus) / scale, color="brown", linestyle="--", label="√CRLB")
    allan.set(title="Allan deviation", xlabel="averaging time, s", ylabel="deg/h")
    snr.axhline(0, color="0.5", linewidth=0.8)
    snr.set(title="SNR of the sample mean", xlabel="averaging time, s", ylabel="dB")
    series = data.series[0]
    at = np.unique(np.geomspace(1, len(series), 400).astype(int))
    sums = np.add.reduceat(series[: at[-1]], np.append(0, at[:-1]), axis=0)
    means = np.cumsum(sums, axis=0) / at[:, None]
    norm = np.linalg.norm(means, axis=1) / scale
    spread = np.sqrt(len(fits)) * white / np.sqrt(at * data.dt) / scale
    running.fill_between(at * data.dt, norm - spread, norm + spread, alpha=0.2)
    running.semilogx(at * data.dt, norm, label="norm of the mean")
    running.axhline(EARTH_RATE / scale, color="green", linestyle="--", label="Earth's rate")
    running.set(title="Sensitivity to Earth's rate", xlabel="averaging time, s", ylabel="deg/h")
    running.set_ylim(0, max(3 * EARTH_RATE / scale, 1.5 * norm[-1]))
    for axes in (allan, snr, running):
        axes.grid(True, which="both", color="0.92", linewidth=0.5)
        axes.legend(fontsize="x-small")
    return figure
