"""The results of an evaluation: its rows, their comparison, and the document that holds them."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from lbgc.answers import Answers, Evaluation
from lbgc.metrics import Ratio, Reach, rmse_interval, rmse_ratio, times_to_reach
from lbgc.report.page import Result, Subject
from lbgc.verdict import Verdict

_FAR_OFF = 16.0
"""Normalised squared error, four sigma, beyond which the stated heading is doubted."""


def doubts(result: Result) -> list[str]:
    """Questions about a log whose estimates are far from its stated headings: axes, sensor, base.
    Empty where they are not."""
    own = [(name, w) for name, w in result.rows if name in ("gls", "mean")]
    if not own:
        return []
    name, window = max(own, key=lambda each: (each[0] == "gls", each[1]))
    row = result.rows[name, window]
    nse = row.mean_normalised_squared_error
    if row.sigma_is_at_least or nse is None or nse < _FAR_OFF:
        return []
    return [
        f"{name} is {np.sqrt(nse):.2g} of its sigmas off the told heading at {window:g} s: is "
        "log.heading_deg (clockwise from true north) the forward axis's, is an axis mirrored "
        "(log.axes), are the sensor's biases larger than imu= says, or does the base move?"
    ]


def outcome_of(
    subject: Subject,
    evaluation: Evaluation,
    keys: Sequence[tuple[str, float]],
    notes: Sequence[str],
    reach_deg: Sequence[float],
    verdicts: Sequence[str] = (),
) -> Result:
    """The results of an evaluation: of errors, or of headings where the true ones are not known.

    keys : the estimators and window lengths that have answers, in order; notes : remarks;
    reach_deg : errors whose window lengths are sought; verdicts : whether north can be found.
    """
    if subject.against is None:
        found = {key: evaluation.answers[key].headings(evaluation.recordings) for key in keys}
        return Result(subject, {}, {}, list(notes), {}, {}, {}, found, verdicts)
    rows = {key: evaluation.answers[key].summary() for key in keys}
    absolute = {key: np.abs(np.rad2deg(evaluation.answers[key].all_of("errors"))) for key in keys}
    by_heading = {key: _per_heading(evaluation.answers[key]) for key in keys}
    over = _over_floor(evaluation, keys)
    reach = _reach(evaluation, keys, reach_deg)
    return Result(subject, rows, absolute, list(notes), reach, over, by_heading, verdicts=verdicts)


def _over_floor(
    evaluation: Evaluation, keys: Sequence[tuple[str, float]]
) -> dict[tuple[str, float], Ratio]:
    """RMSE over the floor's on the same windows, by estimator and window length, where the floor
    has answers."""
    found = {}
    for name, window in keys:
        least = evaluation.answers.get(("floor", window))
        if least is not None and name != "floor":
            own = evaluation.answers[name, window]
            errors = own.all_of("errors"), least.all_of("errors")
            found[name, window] = rmse_ratio(*errors, own.all_of("recording"))
    return found


def _reach(
    evaluation: Evaluation, keys: Sequence[tuple[str, float]], reach_deg: Sequence[float]
) -> dict[str, dict[float, Reach]]:
    """The window length that each error takes: estimator -> error in degrees -> length."""
    found = {}
    for name in dict.fromkeys(name for name, _ in keys):
        own = {w: evaluation.answers[n, w] for n, w in keys if n == name}
        errors = {w: (a.all_of("errors"), a.all_of("recording")) for w, a in own.items()}
        found[name] = times_to_reach(errors, reach_deg)
    return found


def _per_heading(answers: Answers) -> list[dict]:
    """RMSE by true heading, in sectors of 30 degrees about 0, 30, 60... degrees, and its 95%
    interval."""
    sector = np.round(np.rad2deg(answers.all_of("heading")) / 30).astype(int) % 12
    errors, recording = np.rad2deg(answers.all_of("errors")), answers.all_of("recording")
    return [
        {
            "heading_deg": 30.0 * s,
            "windows": int(np.sum(sector == s)),
            "rmse_deg": float(np.sqrt(np.mean(errors[sector == s] ** 2))),
            "interval": rmse_interval(errors[sector == s], recording[sector == s]),
        }
        for s in np.unique(sector)
    ]


def document_of(
    run: str | None, result: Result, evaluation: Evaluation, verdicts: Sequence[Verdict] = ()
) -> dict:
    """The content of `results.json`. run : the training run that was evaluated, if one was."""
    over = {key: asdict(ratio) for key, ratio in result.over_floor.items()}
    return {
        "subject": result.subject.name,
        "against": result.subject.against,
        "run": run,
        "verdicts": [{**asdict(verdict), "can": verdict.can} for verdict in verdicts],
        "verdict": list(result.verdicts),
        "rows": [
            {
                "estimator": name,
                "window_s": window,
                **asdict(summary),
                "over_floor": over.get((name, window)),
                "by_heading": result.by_heading[name, window],
            }
            for (name, window), summary in result.rows.items()
        ],
        "headings": [
            {
                "estimator": name,
                "window_s": window,
                "recordings": [own.as_json() for own in each],
            }
            for (name, window), each in result.headings.items()
        ],
        "time_to_reach": {
            name: {f"{error:g} deg": asdict(said) for error, said in by_error.items()}
            for name, by_error in result.reach.items()
        },
        "left_out": [
            {"estimator": name, "window_s": window, "why": why}
            for (name, window), why in evaluation.refused.items()
        ],
        "notes": result.notes,
    }
