"""What the log doctor says of a file: on the terminal, and as a description for `--config-dir`."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TypeAlias

import numpy as np

from lbgc.data.checks.plausible import PER_HOUR
from lbgc.data.logconfig import LogConfig
from lbgc.data.looking.doctor import Look
from lbgc.data.looking.sensor import least_bias
from lbgc.data.record import Record, TriadRecord
from lbgc.data.rests import rests
from lbgc.earth import EARTH_RATE
from lbgc.outputs import as_json, shown
from lbgc.sensor.allan import octave_taus, overlapping_deviation
from lbgc.units import DEG, HOUR, STANDARD_GRAVITY

_FILES = ("path", "accel_path")
"""Keys whose values are files."""
_WINDOW_S = 240.0
_CANNOT_DEG = 60.0
"""Expected error, degrees, above which north is not found; by chance it is 104."""
_NOISELESS = 1e-9
"""Allan deviation, as a share of the largest value, up to which it is rounding and no noise."""
_ROWS = 3_600_000
"""Means of samples by which Allan deviations are computed, at most."""
_WALKS = ("gyro", "angle", DEG, "deg/sqrt(h)"), ("accel", "velocity", 1.0, "m/s/sqrt(h)")
"""How the white noise of each triad is called, and its unit."""
_LEAST = (
    ("gyro", "gyros", PER_HOUR, "deg/h"),
    ("accel", "accelerometers", 1e6 / STANDARD_GRAVITY, "ug"),
)
"""How the least Allan deviation of each triad is told."""
Deviations: TypeAlias = tuple[np.ndarray, Mapping[str, np.ndarray]]
"""Averaging times (K,), s, and each triad's Allan deviations, (3, K), SI"""


def report(look: Look, found: Deviations | None) -> str:
    """What the file is, the guesses with their reasons and doubts, and what its sensor is worth.
    found : its Allan deviations, where it could be read."""
    other = look.keys.get("accel_path")
    lines = [shown(look.path) + (f" and {shown(other)}" if other else "")]
    lines += [f"  {fact}" for fact in dict.fromkeys(look.facts)]
    for guess in look.guesses:
        if guess.value is not None:
            lines.append(f"  log.{guess.key}={guess.written}: {guess.why}")
            lines += [f"    but: {guess.doubt}"] if guess.doubt else []
    lines += [f"  {note}" for note in look.notes if note not in look.facts]
    if look.rest is not None and found is not None:
        if look.record is not None and look.still is not None and look.still is not look.record:
            start = f"its plate turns over {np.ptp(look.record.plate_angle) / DEG:.4g} deg; "
            lines.append(f"  {start}what follows is of its longest rest, {look.still.name}")
        lines += [f"  {line}" for line in worth(look.rest, found)]
    if look.refusal is not None:
        lines.append(f"  for a heading it would be refused: {look.refusal}")
    return "\n".join(lines)


def deviations(record: Record | TriadRecord) -> Deviations:
    """The Allan deviations of a recording. Those of a long one are of its block means, which have
    the same at longer times."""
    samples = len(record.plate_angle)
    size = -(-samples // _ROWS)
    dt, count = size / record.rate_hz, samples // size
    taus = octave_taus(count, dt)
    return taus, {
        part: overlapping_deviation(
            v[: size * count].reshape(count, size, v.shape[1]).mean(axis=1)[None], dt, taus
        )
        for part, v in record.triads.items()
    }


def worth(record: Record | TriadRecord, found: Deviations) -> list[str]:
    """Sentences on the sensor's noise and bias, and on whether north can be seen with them. found :
    the recording's Allan deviations."""
    taus, each = found
    largest = {part: float(np.abs(values).max()) for part, values in record.triads.items()}
    quiet = [part for part, own in each.items() if own.max() <= _NOISELESS * largest[part]]
    each = {part: own for part, own in each.items() if part not in quiet}
    said = [f"the {name} have no noise in this log, as none that was measured: it tells nothing "
            "of them" for part, name, *_ in _LEAST if part in quiet]  # fmt: skip
    if not each:
        return said
    at = int(np.argmin(np.abs(taus - 1.0)))
    walk = {part: own[:, at] * np.sqrt(taus[at]) for part, own in each.items()}
    noise = [
        f"{name} random walk {_three(walk[part] * 60 / unit)} {what}"
        for part, name, unit, what in _WALKS
        if part in walk
    ]
    lines = [*said, f"noise at {taus[at]:.3g} s: {', '.join(noise)}"]
    for part, name, unit, what in _LEAST:
        if part in each and (part == "gyro" or len(each) == 1):
            own = each[part]
            where = taus[own.argmin(axis=1)]
            lines.append(
                f"{name}' Allan deviation falls to {_three(own.min(axis=1) * unit)} {what} at "
                f"{_three(where)} s"
            )
    own = each["gyro"] if "gyro" in each else each["accel"]
    least = own.argmin(axis=1)
    longest = float(taus[least].max())
    if least.max() >= len(taus) - 2:
        lines.append(
            f"it falls to the end: a bias instability does not show in {record.duration_s:.4g} s; "
            f"a fit of it needs {10 * longest / HOUR:.2g} hours or more"
        )
    elif longest * 10 > record.duration_s:
        lines.append(
            f"a fit of the bias instability needs ten times its {longest:.3g} s: "
            f"{10 * longest / HOUR:.2g} hours, and better more"
        )
    if not np.isfinite(record.latitude) or "gyro" not in each:
        return lines
    if not isinstance(record, Record):
        return lines
    gyro = each["gyro"]
    horizontal = EARTH_RATE * np.cos(record.latitude)
    seconds = min(_WINDOW_S, record.duration_s)
    sigma = float(walk["gyro"].max()) / np.sqrt(seconds) / horizontal
    floor = float(gyro.min(axis=1).max()) / horizontal
    off = least_bias(record.gyro.mean(0), record.accel.mean(0), record.latitude)
    lines.append(
        f"north: by noise alone {_degrees(sigma)} in {seconds:.0f} s, by the slow part of it "
        f"{_degrees(floor)}; a horizontal bias of 1 deg/h turns it by "
        f"{1 / (horizontal * PER_HOUR) / DEG:.3g} deg, and here it is "
        f"{off * PER_HOUR:.3g} deg/h at the least"
    )
    if np.hypot(sigma, off / horizontal) > _CANNOT_DEG * DEG:
        lines.append("north cannot be found with it at rest")
    return lines


def _degrees(sigma: float) -> str:
    """An error of heading as text."""
    return f"{sigma / DEG:.3g} deg" if sigma < 1 else "more than 60 deg"


def _three(values: np.ndarray) -> str:
    """The values of three axes as text."""
    return ", ".join(f"{value:.3g}" for value in values)


def asked(look: Look, given: Sequence[str]) -> str:
    """The questions, each with the command that answers it. given : the log's files."""
    what = "for a heading, " if look.is_described else ""
    lines = [f"not told by the file, so {what}give it:"]
    for guess in look.asks:
        lines.append(f"  log.{guess.key}: {guess.doubt} {guess.why}")
    said = " ".join(f"log.{guess.key}=..." for guess in look.asks)
    lines.append(f"python lbgc/look.py {shlex.join(given)} {said}")
    return "\n".join(lines)


def description(look: Look, first: str) -> str:
    """The description as a YAML file. Its values are JSON, which YAML holds, so that no text of the
    file's gets out of its quotes. first : its first line's beginning."""
    why = {guess.key: guess for guess in look.guesses}
    lines = [f"{first} from {shown(look.path.name)}: what is no guess was said, or is in the file."]
    for key, value in look.keys.items():
        about = why.get(key)
        if about is not None:
            told = f"{about.why}; {about.doubt}" if about.doubt else about.why
            lines.append(f"# {key}: {shown(told)}")
        own = str(Path(str(value)).absolute()) if key in _FILES and value else value
        lines.append(f"{key}: {as_json(own, indent=None)}")
    lines.append("# as usual")
    usual = asdict(LogConfig(path="x"))
    more = {key: usual[key] for key in usual if key not in look.keys}
    lines += [f"{key}: {as_json(value, indent=None)}" for key, value in more.items()]
    return "\n".join(lines) + "\n"


def commands(look: Look, out: str, name: str) -> str:
    """The commands that use the description."""
    options = f"--config-dir {shlex.quote(out)} log={name}"
    still, record = "", look.record
    if record is not None and look.still is not record:  # noise is fitted to a rest
        own = max(rests(record), key=lambda rest: rest.samples.stop - rest.samples.start)
        first, last = (row / record.rate_hz for row in (own.samples.start, own.samples.stop))
        gone = " ".join(f"log.{key}=null" for key in ("plate_column", "positions")
                        if look.keys.get(key) is not None)  # fmt: skip
        still = f" {gone} log.from_s={first:.10g} log.to_s={last:.10g}"
    lines = ["use it:", f"python lbgc/fit.py {options}{still} name={name}_sensor"]
    if look.is_sure:
        lines.append(f"python lbgc/evaluate.py {options}")
    return "\n".join(lines)
