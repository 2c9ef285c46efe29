"""Files of the kinds that public reports are about: is each read right, or refused?

A file is judged as its user meets it: with the options that he would type, and where that is
refused, with the option that the message names. Silent and wrong is what must not be.
"""

import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from cases import CASES as GENERATORS
from common import Report
from tqdm import tqdm

from lbgc.units import DEG, HOUR
from real.clean import called

EARTH_DEG_H = 15.041067
RATE_HZ = 100.0
SIGMAS = 4.0
"""Of its sampling error, what a right figure may be off."""


@dataclass(frozen=True)
class Case:
    """A file, what is typed and what is right."""

    kind: str
    file: str
    program: str
    """fit or evaluate"""
    options: tuple[str, ...]
    right: Mapping[str, object]
    """arw_deg_per_sqrt_h, vrw_m_per_s_per_sqrt_h, lines (Hz: deg/h), no_walk (axes), error_arw
    (what the heading's error comes from), heading_deg, left_out (an estimator)."""
    option: tuple[str, ...] | None = None
    """What the refusal must name and then gives the right answer; None where there is none."""
    names: tuple[str, ...] = ()
    """Words of which a refusal holds one at the least: the true cause."""
    must_refuse: bool = False
    """As typed the file cannot be answered rightly."""


@dataclass(frozen=True)
class Outcome:
    refused: str | None
    result: dict = field(default_factory=dict)
    said: str = ""


def cases(config: Mapping) -> list[Case]:
    """As the study's configuration lists them."""
    found = []
    for kind, own in config.items():
        for entry in own["files"]:
            merged = {**{k: v for k, v in own.items() if k != "files"}, **entry}
            for program in merged["programs"]:
                found.append(
                    Case(
                        kind,
                        merged["file"],
                        program,
                        tuple(merged.get("options", ())),
                        merged["right"][program],
                        tuple(merged["option"]) if "option" in merged else None,
                        tuple(merged.get("names", ())),
                        merged.get("must_refuse", False) is True
                        or merged.get("must_refuse") == program,
                    )
                )
    return found


def ask(case: Case, home: Path, extra: Sequence[str] = ()) -> Outcome:
    """What the program answers; run in a directory of its own."""
    path = (home / case.kind / case.file).resolve()
    heading = case.right.get("heading_deg", 90)
    told = ["log.latitude=48.1", f"log.heading_deg={heading}"]
    own = [o for o in case.options if case.program == "evaluate" or not o.startswith("windows_s")]
    options = ["log=csv", f"log.path='{path}'", *told, *own, *extra]
    return Outcome(*called(case.program, options))


def is_right(case: Case, outcome: Outcome) -> list[str]:
    """What is wrong with an answer; nothing where it is right."""
    wrong: list[str] = []
    right, result = case.right, outcome.result
    if case.program == "evaluate":
        if "left_out" in right:
            answered = {row["estimator"] for row in result["rows"]}
            return [f"{right['left_out']} answers"] if right["left_out"] in answered else []
        row = [r for r in result["rows"] if r["estimator"] == "mean"][-1]  # the longest window
        seconds = float(row["window_s"])
        north = EARTH_DEG_H * np.cos(np.deg2rad(float(right.get("latitude", 48.1))))
        sigma = np.rad2deg(float(right["error_arw"]) / np.sqrt(seconds / 3600) / north)
        if row.get("rmse_deg") is None or not row["rmse_deg"] <= SIGMAS * sigma:
            wrong.append(f"heading error {row.get('rmse_deg')} deg where sigma is {sigma:.2g}")
        return wrong
    scale = {"gyro": DEG / np.sqrt(HOUR), "accel": 1 / np.sqrt(HOUR)}
    for part, key in (("gyro", "arw_deg_per_sqrt_h"), ("accel", "vrw_m_per_s_per_sqrt_h")):
        if key in right:
            for axis, fitted in zip("xyz", result[part], strict=True):
                wrong += _white(f"{part} {axis}", fitted, float(right[key]) * scale[part])
    for hz, rms in dict(right.get("lines", {})).items():
        for axis, fitted in zip("xyz", result["gyro"], strict=True):
            # A sample is a mean over its interval, which takes something off a fast line.
            own = float(rms) * DEG / HOUR / np.sinc(float(hz) / RATE_HZ)
            wrong += _line(axis, fitted["estimates"], float(hz), own)
    for part, axis in right.get("no_walk", ()):
        estimates = result[part]["xyz".index(axis)]["estimates"]
        told = [k for k in ("K", "ramp") if k in estimates and estimates[k]["low"] > 0]
        if told:
            wrong.append(f"{part} {axis}: a warm-up is told as {told}")
    return wrong


def _white(axis: str, fitted: Mapping, truth: float) -> list[str]:
    """Whether N's interval is where the truth is; one withheld or a limit is no wrong answer."""
    e = fitted["estimates"].get("N")
    if e is None or e.get("low") is None or e["low"] == 0:
        return []
    sigma = (np.log(e["high"]) - np.log(e["low"])) / (2 * 1.96)
    off = abs(np.log(e["value"] / truth))
    if off > SIGMAS * max(sigma, 1e-9) or off > 0.25:
        return [f"{axis}: N is {e['value'] / truth:.4f} of the truth, sigma {sigma:.4f}"]
    return []


def _line(axis: str, estimates: Mapping, hz: float, rms: float) -> list[str]:
    lines = [k for k in estimates if k.startswith("line_f0")]
    near = [k for k in lines if abs(estimates[k]["value"] - hz) < 0.05 * hz]
    if not near:
        return [f"{axis}: no line at {hz:g} Hz"]
    power = sum(estimates[k.replace("line_f0", "line_sigma")]["value"] ** 2 for k in near)
    off = abs(np.sqrt(power) / rms - 1)
    return [f"{axis}: the line at {hz:g} Hz is {off:.0%} off"] if off > 0.15 else []


@dataclass(frozen=True)
class Verdict:
    right_or_refused: bool
    answered: bool
    """Rightly, as typed or by the option that the message names."""
    text: str


def judge(case: Case, home: Path) -> Verdict:
    """First as typed; then, where refused, by the option."""
    first = ask(case, home)
    if first.refused is None:
        wrong = is_right(case, first)
        if not wrong:
            return Verdict(True, True, "answered")
        # An answer that the table itself says cannot be had is none in silence.
        aloud = [word for word in case.names if word in first.said]
        if aloud:
            return Verdict(True, False, f"answered, and said: {aloud[0]}")
        return Verdict(False, False, "SILENT AND WRONG: " + "; ".join(wrong))
    if case.names and not any(word in first.refused for word in case.names):
        return Verdict(False, False, f"REFUSED FOR A WRONG CAUSE: {first.refused}")
    if case.option is None:
        return Verdict(True, False, f"refused: {first.refused}")
    second = ask(case, home, case.option)
    if second.refused is not None:
        return Verdict(True, False, f"refused twice: {first.refused} THEN {second.refused}")
    wrong = is_right(case, second)
    if wrong:
        return Verdict(False, False, "SILENT AND WRONG by its option: " + "; ".join(wrong))
    return Verdict(True, True, "answered by " + " ".join(case.option))


def written(home: Path, kinds: Sequence[str]) -> None:
    for generator in GENERATORS:
        if generator.__name__ in kinds:
            generator(home / generator.__name__)


def run(report: Report, config: Mapping) -> None:
    """Every file of the kinds listed; the summary's first figures."""
    own = cases(config["cases"])
    with tempfile.TemporaryDirectory() as scratch:
        home = Path(scratch)
        written(home, list(config["cases"]))
        with ProcessPoolExecutor(2, get_context("spawn")) as pool:
            done = pool.map(judge, own, [home] * len(own))
            verdicts = list(tqdm(done, "cases", len(own), leave=False))
    for case, verdict in zip(own, verdicts, strict=True):
        report.line(f"{case.kind}/{case.file:34s} {case.program:9s} {verdict.text}")
    by_file: dict[tuple[str, str], list[tuple[Case, Verdict]]] = {}
    for case, verdict in zip(own, verdicts, strict=True):
        by_file.setdefault((case.kind, case.file), []).append((case, verdict))
    good = [all(v.right_or_refused for _, v in each) for each in by_file.values()]
    answerable = [v for c, v in zip(own, verdicts, strict=True) if c.right.get("had", True)]
    report.summary |= {
        "cases": len(by_file),
        "cases_right_or_refused": int(np.sum(good)),
        "silent_wrong": int(np.sum([not g for g in good])),
        "answerable_cases_answered_percent": 100 * float(np.mean([v.answered for v in answerable])),
        "cases_by_file": {
            f"{kind}/{file}": [f"{c.program}: {v.text}"[:200] for c, v in each]
            for (kind, file), each in by_file.items()
        },
    }
