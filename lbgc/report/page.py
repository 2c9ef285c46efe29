"""An evaluation's results for people: the table on the screen, and one self-contained HTML page."""

import base64
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path

import jinja2
import numpy as np
from matplotlib.figure import Figure

from lbgc.data import picture
from lbgc.data.record import Record
from lbgc.data.rests import longest_rest
from lbgc.earth import EARTH_RATE
from lbgc.errors import InputError, build
from lbgc.headings import Table, one_by_one, spelled
from lbgc.headings import rows as headings_as_rows
from lbgc.metrics import Ratio, Reach, Summary, is_untrue
from lbgc.outputs import printable, write_atomically
from lbgc.report import figures, history, paper
from lbgc.sensor.allan import octave_taus, overlapping_deviation
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.imu import ImuModel
from lbgc.units import DEG, HOUR

_COLUMNS = (
    *("estimator", "window, s", "windows", "RMSE", "its 95% interval", "median", "IQR", "95%"),
    *("RMSE·cos(lat)", "over the floor", "sigma", "NSE", "us"),
)
KINDS = {
    "lstm": "Bi-LSTM",
    "gru": "bidirectional GRU",
    "rnn": "bidirectional RNN",
    "pool": "layers over moments in time",
    "filter": "layers that weigh filtered moments",
}
"""The kinds of networks, by cell, in words."""
_MOST_RECORDINGS = 8
"""Largest number of recordings whose headings are drawn."""


@dataclass(frozen=True)
class Subject:
    """What an evaluation is of: a dataset's split or a log, and what is known of its sensor."""

    name: str
    against: str | None
    """truth or reference, which errors are relative to; None where the headings are not known"""
    notes: list[str]
    records: Callable[[], Iterable[Record]] = field(repr=False)
    """Reads a few recordings for the Allan figure when it is drawn; `samples` or more each."""
    samples: int
    rate_hz: float
    latitude: float
    """rad"""
    identity: str
    imu: ImuModel | None = None
    """The sensor's error model, where it is known."""
    sensor: str | None = None
    """The sensor's name."""
    configuration: Mapping | None = None
    """The dataset's; None for a real log."""
    picture: Path | None = None
    calibration: str | None = None
    """The checksum of what is known of its unit, where that is taken off."""


@dataclass(frozen=True)
class Result:
    """An evaluation's results: all that the table and the page show."""

    subject: Subject
    rows: Mapping[tuple[str, float], Summary]
    """Summaries by estimator and window length."""
    sizes: Mapping[tuple[str, float], np.ndarray] = field(repr=False)
    """|error| in degrees, by estimator and window length."""
    notes: list[str]
    reach: Mapping[str, Mapping[float, Reach]]
    """Estimator -> error in degrees -> the window length that it takes."""
    over_floor: Mapping[tuple[str, float], Ratio]
    """RMSE over the floor's on the same windows, where the floor was asked for."""
    by_heading: Mapping[tuple[str, float], list[dict]]
    """By estimator and window length: heading_deg, windows, rmse_deg and its interval (low and
    high, or None) of each sector."""
    headings: Table = field(default_factory=dict, repr=False)
    """The estimators' answers where the headings are not known; the fields above are then empty."""
    verdicts: Sequence[str] = ()
    """Whether north can be found at all, in plain sentences."""
    learned: tuple[str, ...] = ()
    """Names of the estimators that were trained."""

    @property
    def estimators(self) -> list[str]:
        """Names of the estimators, in their order."""
        return list(dict.fromkeys(name for name, _ in self.rows))


def cells(result: Result) -> list[list[str]]:
    """The table's rows as text, in the columns' order; angles in degrees."""
    return [_cells(*key, s, result.over_floor.get(key)) for key, s in result.rows.items()]


def _cells(name: str, window: float, s: Summary, over: Ratio | None) -> list[str]:
    """One row of the table as text."""
    low, high = (s.intervals or {}).get("rmse_deg", (np.nan, np.nan))
    nse, us = s.mean_normalised_squared_error, s.microseconds_a_window
    return [
        name,
        f"{window:g}",
        str(s.windows),
        f"{s.rmse_deg:.2f}",
        "-" if np.isnan(low) else f"{low:.2f} to {high:.2f}",
        *(f"{v:.2f}" for v in (s.median_deg, s.iqr_deg, s.p95_deg, s.rmse_cos_latitude_deg)),
        "-" if over is None else f"{over.value:.3f} ({over.low:.3f} to {over.high:.3f})",
        "-" if s.sigma_deg is None else spelled(s.sigma_deg, s.sigma_is_at_least),
        "-" if nse is None else f"{nse:.3g}",
        "-" if us is None else f"{us:.0f}",
    ]


def table(result: Result) -> str:
    """The table for the screen, in degrees: of errors, or of headings where errors are unknown."""
    if result.headings:
        title = f"Headings in degrees, which nothing is there to check: {result.subject.name}"
        head, lines, more = one_by_one(result.headings)
        parts = [title, *_lined_up(*headings_as_rows(result.headings)), "", *_lined_up(head, lines)]
        return "\n".join(parts + ([f"... and {more} more, in windows.csv"] if more else []))
    title = f"Heading error in degrees against the {result.subject.against}: {result.subject.name}"
    return "\n".join([title, *_lined_up(list(_COLUMNS), cells(result))])


def _lined_up(head: list[str], lines: Sequence[Sequence[str]]) -> list[str]:
    """A header, a rule and rows as aligned text: the first column to the left, others to the
    right."""
    every = [head, *lines]
    widths = [max(len(row[i]) for row in every) for i in range(len(head))]
    found = [
        "  ".join(
            c.ljust(w) if i == 0 else c.rjust(w)
            for i, (c, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in every
    ]
    return [found[0], "  ".join("-" * w for w in widths), *found[1:]]


def page_environment() -> jinja2.Environment:
    """What fills a page's places: any text there is a text, and no tag nor a mark that acts."""
    return jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=lambda value: printable(value) if isinstance(value, str) else value,
    )


def write_page(
    path: Path, result: Result, run: str | None, description: Mapping | None = None
) -> Path:
    """Write the report as an HTML page and return its path. run : the training run that was
    evaluated, if one was; description : what its `model.json` says."""
    template = page_environment().from_string(
        (files("lbgc.report") / "page.html.j2").read_text(encoding="utf-8")
    )
    pictures, notes = _pictures(result, run, description)
    page = template.render(
        subject=result.subject,
        columns=_COLUMNS,
        headings=headings_as_rows(result.headings) if result.headings else None,
        verdicts=result.verdicts,
        rows=list(zip(cells(result), map(is_untrue, result.rows.values()), strict=True)),
        reach=result.reach,
        notes=[*result.notes, *notes],
        bias=_bias_split(result.subject.configuration, description),
        paper_rows=_beside_the_paper(result),
        model=description,
        kind=description and KINDS[description["model"]["cell"]],
        parameters=_published_parameters(description),
        pictures=pictures,
    )
    write_atomically(path, page)
    return path


def _beside_the_paper(result: Result) -> list[dict]:
    """Median and IQR of the plain mean, which is the paper's baseline, and of learned estimators,
    beside the paper's figures. The paper has no other estimators."""
    return [
        {
            "estimator": name,
            "window": f"{window:g}",
            "median": f"{s.median_deg:.2f}",
            "iqr": f"{s.iqr_deg:.2f}",
            "paper_row": row,
            "paper_median": paper.published(paper.MEDIAN_DEG, row, window),
            "paper_iqr": paper.published(paper.IQR_DEG, row, window),
        }
        for (name, window), s in result.rows.items()
        for row in ["baseline"] * (name == "mean") + ["learned"] * (name in result.learned)
        if window in paper.WINDOWS_S
    ]


def _bias_split(configuration: Mapping | None, run: Mapping | None) -> dict | None:
    """Sizes of the gyro's bias by lifetime, deg/h, and the share that repeats: all that a learner
    can ever remove. None for a real log."""
    if configuration is None:
        return None
    gyro = build(ImuConfig, configuration["imu"]).gyro.triad()
    across = {
        part: float(np.mean(np.square(gyro.bias(part)[:2]))) ** 0.5 / DEG * HOUR
        for part in ("unit", "session", "run")
    }
    total = sum(v**2 for v in across.values())
    return {
        **{part: f"{v:.3g}" for part, v in across.items()},
        "repeats": f"{across['unit'] ** 2 / total:.0%}" if total else "none",
        "same_unit": run is not None
        and all(configuration[k] == v for k, v in run["units"].items()),
        "trained": run is not None,
    }


def _published_parameters(run: Mapping | None) -> int | None:
    """The paper's number of parameters for a network like this run's, or None."""
    if run is None or run["model"]["cell"] != "lstm":
        return None
    return paper.PARAMETERS.get((run["model"]["layers"], run["model"]["hidden"]))


def _pictures(
    result: Result, run: str | None, description: Mapping | None
) -> tuple[list[dict], list[str]]:
    """Titles and PNG data of the figures, in the page's order; and what is left out, and why."""
    drawn = _error_pictures(result) if result.rows else _heading_pictures(result)
    drawn.append(("Allan deviation of the data", figures.png(_allan(result.subject))))
    notes = []
    if run is not None and os.path.lexists(Path(run) / history.FILE):
        own = (description or {}).get("history")
        try:
            rows = history.read(Path(run) / history.FILE, own)
            drawn.append(("Loss curve", figures.png(figures.loss_curve(rows))))
        except InputError:
            notes.append(f"no loss curve: {history.FILE} is damaged; {history.AGAIN}")
    bench = None if result.subject.picture is None else picture.read(result.subject.picture)
    if bench is not None:
        drawn.append(("The bench", bench))
    return [{"title": t, "data": base64.b64encode(png).decode()} for t, png in drawn], notes


def _heading_pictures(result: Result) -> list[tuple[str, bytes]]:
    """Titles and PNGs where headings are not known: the longest windows' headings against time, one
    figure for each of the first recordings."""
    longest = max(window for _, window in result.headings)
    drawn = []
    by_recording: dict[str, dict[str, tuple[np.ndarray, ...]]] = {}
    for (name, window), each in result.headings.items():
        for own in each if window == longest else ():
            answers = own.start_s + window / 2, own.heading_deg, own.sigma_deg
            by_recording.setdefault(own.recording, {})[name] = answers
    for recording, own_rows in list(by_recording.items())[:_MOST_RECORDINGS]:
        title = f"{recording}, windows of {longest:g} s"
        drawn.append((title, figures.png(figures.headings_against_time(own_rows, title))))
    return drawn


def _error_pictures(result: Result) -> list[tuple[str, bytes]]:
    """Titles and PNGs where headings are known: errors by window length, by heading, box plots."""
    by_name = {n: {w: v for (m, w), v in result.sizes.items() if m == n} for n in result.estimators}
    rmse = {
        n: (
            [w for m, w in result.rows if m == n],
            [s.rmse_deg for (m, _), s in result.rows.items() if m == n],
        )
        for n in result.estimators
    }
    return [
        ("Error against window length", figures.png(figures.error_against_window(rmse))),
        ("Error by heading", figures.png(_by_heading(result))),
        ("Box plots of the errors", figures.png(figures.box_plots(by_name))),
    ]


def _by_heading(result: Result) -> Figure:
    """The figure of errors by heading, of the longest windows that every estimator answered, or
    else of the longest windows."""
    lengths = {w for _, w in result.rows}
    common = {w for w in lengths if all((n, w) in result.rows for n in result.estimators)}
    longest = max(common or lengths)
    rows = {
        name: [(s["heading_deg"], s["rmse_deg"], s["interval"]) for s in sectors]
        for (name, window), sectors in result.by_heading.items()
        if window == longest
    }
    return figures.error_by_heading(rows, longest)


def _allan(subject: Subject) -> Figure:
    """The figure of the gyros' Allan deviation: that of the data, each recording's longest rest,
    and of a dataset's own model."""
    resting = [longest_rest(record).gyro for record in subject.records()]
    n, dt = min(map(len, resting)), 1 / subject.rate_hz
    taus = octave_taus(n, dt)
    measured = overlapping_deviation((gyro[:n] for gyro in resting), dt, taus)
    model = None
    if subject.configuration is not None:
        gyro = build(ImuConfig, subject.configuration["imu"]).gyro.triad()
        fine = np.geomspace(taus[0], taus[-1], 5000)
        sampling = 1 / float(subject.configuration["rate_hz"])
        model = fine, np.sqrt(gyro.allan_variance(fine, sampling)) / DEG * HOUR
    earth = EARTH_RATE * np.cos(subject.latitude) / DEG * HOUR
    return figures.allan_deviation(taus, measured / DEG * HOUR, model, earth)
