"""The figures. Each function takes plain numbers and returns a matplotlib figure, without showing
it."""

import io
from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from lbgc.outputs import shown

T = TypeVar("T")
_LONGEST_LABEL = 100
"""Largest number of characters of a title or a label."""
AXIS_COLOURS = ("#c0392b", "#27895a", "#2c5d9b")
AXIS_NAMES = ("forward", "right", "down")
ESTIMATOR_COLOURS = (
    *("#7f7f7f", "#d1691f", "#2c5d9b", "#27895a", "#8e44ad", "#c0392b", "#b8860b", "#17becf"),
    *("#e377c2", "#556b2f", "#4b3f72", "#a0522d", "#000000", "#1f9e89", "#9acd32", "#ff9896"),
    *("#6baed6", "#c49c94"),
)


def _figure(title: str, x: str, y: str) -> tuple[Figure, Axes]:
    """A figure with one pair of axes, these labels, and a grid."""
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.add_subplot()
    axes.set(title=_plain(title), xlabel=x, ylabel=y)
    axes.grid(True, which="both", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    return figure, axes


def _coloured(rows: Mapping[str, T]) -> Iterator[tuple[tuple[str, T], str]]:
    """The row of each estimator or protocol, with its name as a label and its colour."""
    labelled = ((_plain(name), row) for name, row in rows.items())
    return zip(labelled, cycle(ESTIMATOR_COLOURS), strict=False)


def _plain(text: str) -> str:
    """A text from outside as matplotlib draws it letter by letter: a dollar begins no formula, and
    a line at the start hides no label."""
    said = shown(text, _LONGEST_LABEL).replace("$", r"\$")
    return f" {said}" if said.startswith("_") else said


def loss_curve(history: Sequence[Mapping[str, float]]) -> Figure:
    """Validation RMSE of each window length against the step."""
    figure, axes = _figure("Training", "optimiser step", "validation RMSE, deg")
    steps = [row["step"] for row in history]
    names = [name for name in history[0] if name.startswith("validation_")]
    for i, name in enumerate(names):
        shade = 0.25 + 0.65 * i / max(len(names) - 1, 1)
        label = _plain(name.removeprefix("validation_").removesuffix("_deg"))
        axes.plot(steps, [r[name] for r in history], color=(0.1, 0.3, 0.55, shade), label=label)
    best = min(history, key=lambda row: row["score"])
    axes.axvline(best["step"], color="#d1691f", linewidth=1, label="kept")
    axes.set_yscale("log")
    _plain_y_ticks(axes)
    axes.legend(title="window", fontsize="small")
    return figure


def allan_deviation(
    taus: np.ndarray,
    measured: np.ndarray,
    model: tuple[np.ndarray, np.ndarray] | None,
    earth_deg_per_h: float,
) -> Figure:
    """Allan deviation of the gyros against averaging time, and Earth's horizontal rate.

    taus : (K,), s; measured : (3, K), deg/h; model : its own averaging times, (L,), and deviations,
    (3, L), or None.
    """
    figure, axes = _figure("Allan deviation of the gyro", "averaging time, s", "deg/h")
    measured = np.where(measured > 0, measured, np.nan)  # zero, of a perfect sensor, has no log
    for axis, (name, colour) in enumerate(zip(AXIS_NAMES, AXIS_COLOURS, strict=True)):
        axes.loglog(taus, measured[axis], "o", color=colour, markersize=4, label=name)
        if model is not None and model[1][axis].any():
            axes.loglog(model[0], model[1][axis], color=colour, linewidth=1)
    axes.axhline(earth_deg_per_h, color="0.4", linestyle="--", linewidth=1)
    axes.annotate("Earth's horizontal rate", (taus[0], earth_deg_per_h), va="bottom", size="small")
    axes.legend(title="points: data" + ("; lines: model" if model else ""), fontsize="small")
    return figure


def error_against_window(rows: Mapping[str, tuple[Sequence[float], Sequence[float]]]) -> Figure:
    """RMSE against window length. rows : estimator -> (window lengths in s, RMSE in deg)."""
    figure, axes = _figure("Error against window length", "window, s", "heading RMSE, deg")
    for (name, (windows, errors)), colour in _coloured(rows):
        axes.loglog(windows, errors, "o-", color=colour, label=name)
    ticks = sorted({w for windows, _ in rows.values() for w in windows})
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()
    _plain_y_ticks(axes)
    axes.legend(fontsize="small")
    return figure


def error_by_heading(
    rows: Mapping[str, Sequence[tuple[float, float, tuple[float, float] | None]]], window_s: float
) -> Figure:
    """RMSE against true heading. rows : estimator -> for each sector of true heading its middle,
    its RMSE, and the 95% interval of that, or None; deg."""
    title = f"Error by heading, windows of {window_s:g} s"
    figure, axes = _figure(title, "true heading, deg", "heading RMSE, deg")
    for (name, sectors), colour in _coloured(rows):
        headings, errors, intervals = zip(*sectors, strict=True)
        axes.plot(headings, errors, "o-", color=colour, label=name)
        ends = [(e, e) if own is None else own for e, own in zip(errors, intervals, strict=True)]
        axes.vlines(headings, *zip(*ends, strict=True), color=colour, linewidth=1)
    axes.set_xticks(range(0, 360, 30))
    axes.set_ylim(bottom=0)
    axes.legend(fontsize="small")
    return figure


def headings_against_time(rows: Mapping[str, tuple[np.ndarray, ...]], title: str) -> Figure:
    """Estimated headings against time. rows : estimator -> times in s, headings in deg and their
    sigmas in deg, (W,) each."""
    figure, axes = _figure(title, "middle of the window, s", "heading, deg; bars: 1 sigma")
    for (name, (t, heading, sigma)), colour in _coloured(rows):
        bars = np.where(np.isfinite(sigma), sigma, 0.0)
        axes.errorbar(t, heading, bars, fmt="o", color=colour, markersize=3, capsize=2, label=name)
    axes.legend(fontsize="small")
    return figure


def bound_against_time(
    curves: Mapping[str, tuple[Sequence[float], Sequence[float]]], title: str
) -> Figure:
    """The floor against window length. curves : protocol -> (window lengths in s, the floor in
    deg)."""
    figure, axes = _figure(f"The best that physics allows: {title}", "window, s", "RMSE, deg")
    for (name, (windows, floor)), colour in _coloured(curves):
        axes.loglog(windows, floor, "o-", color=colour, markersize=3.5, label=name)
    _plain_y_ticks(axes)
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.legend(fontsize="small")
    return figure


def error_by_labelled(rows: Sequence[Mapping[str, float]], title: str) -> Figure:
    """The floor against the number of labelled recordings. rows : labelled, floor_deg."""
    figure, axes = _figure(
        f"What labelled recordings buy: {title}", "labelled recordings of this unit", "RMSE, deg"
    )
    counts, floor = ([row[name] for row in rows] for name in ("labelled", "floor_deg"))
    axes.plot(counts, floor, "o-", color="C0", markersize=3.5)
    axes.set_xscale("symlog", linthresh=1)
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_ylim(bottom=0)
    return figure


def png(figure: Figure, dpi: int = 130) -> bytes:
    """A figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def box_plots(sizes: Mapping[str, Mapping[float, np.ndarray]]) -> Figure:
    """Box plots of the errors. sizes : estimator -> window length in s -> absolute errors in
    deg."""
    figure, axes = _figure("Distribution of the errors", "window, s", "|heading error|, deg")
    windows = sorted({w for by_window in sizes.values() for w in by_window})
    width = 0.8 / len(sizes)
    for i, ((name, by_window), colour) in enumerate(_coloured(sizes)):
        places = [windows.index(w) + (i - (len(sizes) - 1) / 2) * width for w in by_window]
        drawn = axes.boxplot(
            list(by_window.values()),
            positions=places,
            widths=width * 0.85,
            patch_artist=True,
            manage_ticks=False,
            flierprops={"marker": ".", "markersize": 2, "markeredgecolor": colour, "alpha": 0.4},
            medianprops={"color": "black"},
        )
        for box in drawn["boxes"]:
            box.set(facecolor=colour, alpha=0.6)
        axes.plot([], [], "s", color=colour, label=name)
    axes.set_xticks(range(len(windows)), [f"{w:g}" for w in windows])
    axes.set_ylim(bottom=0)
    axes.legend(fontsize="small")
    return figure


def strips(
    t: np.ndarray, omega: np.ndarray, force: np.ndarray, angle: np.ndarray, width: int
) -> tuple[Figure, list[Axes]]:
    """Rate, specific force and plate angle against time, to stand below a film of this width in
    pixels. Returns the figure and its three axes.

    t : (n,), s; omega : (3, n), rad/s; force : (3, n), m/s^2; angle : (n,), rad.
    """
    figure = Figure(figsize=(width / 100, 3.0), dpi=100, layout="constrained")
    rows = figure.subplots(3, 1, sharex=True)
    horizontal, vertical = np.rad2deg(omega[:2]) * 3600, np.rad2deg(omega[2])
    rate, slew = rows[0], rows[0].twinx()
    slew.plot(t, vertical, color=AXIS_COLOURS[2], linewidth=1)
    for axis in (0, 1):
        rate.plot(
            t, horizontal[axis], color=AXIS_COLOURS[axis], linewidth=1, label=AXIS_NAMES[axis]
        )
        rows[1].plot(t, force[axis], color=AXIS_COLOURS[axis], linewidth=1)
    rate.plot([], [], color=AXIS_COLOURS[2], linewidth=1, label=f"{AXIS_NAMES[2]} (deg/s)")
    rate.legend(fontsize="xx-small", loc="upper left", ncols=3)
    rows[2].plot(t, np.rad2deg(angle), color="black", linewidth=1)
    for axes, name in zip(rows, ("rate, deg/h", "force, m/s\u00b2", "plate, deg"), strict=True):
        axes.set_ylabel(name, fontsize="x-small")
        axes.tick_params(labelsize="x-small")
        axes.grid(True, color="0.92", linewidth=0.5)
    slew.tick_params(labelsize="x-small")
    rows[2].set_xlabel("time, s", fontsize="x-small")
    rows[2].set_xlim(t[0], t[-1])
    return figure, list(rows)


def dataset_overview(
    headings: np.ndarray, t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, angle: np.ndarray
) -> Figure:
    """A dataset's headings round the circle, and the course of one recording.

    headings : (R,), rad; of the recording t : (T,), s; gyro : (T, 3), rad/s; accel : (T, 3), m/s^2;
    angle : (T,), rad.
    """
    figure = Figure(figsize=(10, 6), layout="constrained")
    north_up = {"theta_direction": -1, "theta_offset": np.pi / 2}
    circle = figure.add_subplot(2, 2, 1, projection="polar", **north_up)
    counts, edges = np.histogram(np.mod(headings, 2 * np.pi), 36, (0, 2 * np.pi))
    circle.bar(edges[:-1], counts, width=np.pi / 18, align="edge", color=AXIS_COLOURS[2])
    circle.set_title("recordings by heading")
    every = max(1, len(t) // 2000)
    for place, (name, values) in enumerate(
        (
            ("gyro, deg/h", np.rad2deg(gyro) * 3600),
            ("accelerometer, m/s\u00b2", accel),
            ("plate, deg", np.rad2deg(angle)[:, None]),
        )
    ):
        axes = figure.add_subplot(2, 2, place + 2)
        for axis, colour in enumerate(AXIS_COLOURS[: values.shape[1]]):
            axes.plot(t[::every], values[::every, axis], color=colour, linewidth=0.8)
        axes.set(title=f"first recording: {name}", xlabel="s")
        axes.grid(True, color="0.92", linewidth=0.5)
    return figure


def _plain_y_ticks(axes: Axes) -> None:
    """Label a logarithmic y axis at 1, 2 and 5 of each decade, in plain numbers."""
    axis = axes.yaxis
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())
