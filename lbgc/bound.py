"""The least heading error that any estimator can have with this sensor, and the error budget.

python lbgc/bound.py imu=stim300 protocol=two_position latitude=60

Two bounds, `crlb` and the expected floor: see lbgc.estimators.floor.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from tqdm import tqdm

from lbgc import labelling, ways
from lbgc.commands import run_main
from lbgc.data import unit_file
from lbgc.data.configuration import require_height
from lbgc.earth import heading_exists, normal_gravity
from lbgc.errors import InputError, require, require_choice, require_not_negative, require_positive
from lbgc.estimators.block_means import Course, Site
from lbgc.estimators.floor import (
    DRAWS,
    HEADINGS,
    SETTLE_S,
    course_of,
    expected_floor,
    small_errors,
)
from lbgc.estimators.information import Information, budget, information
from lbgc.estimators.least_squares import LEANS
from lbgc.estimators.posterior import AS_LENGTHS
from lbgc.estimators.reduced_order import When, like_north
from lbgc.estimators.unit_posterior import Reference
from lbgc.outputs import as_json, fingerprint, mark_latest, task_directory, write_atomically
from lbgc.protocol import ProtocolConfig
from lbgc.report.figures import bound_against_time, error_by_labelled, png
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.dither import unstated, warnings
from lbgc.sensor.errors import FIELD, LIFETIMES
from lbgc.sensor.imu import ImuModel

MOST_LEAN = float(np.rad2deg(LEANS))
"""Largest lean of the base, degrees."""


@dataclass(frozen=True)
class BoundConfig:
    """The keys of `conf/bound.yaml`."""

    latitude: float = 32.76
    """degrees, north positive"""
    height_m: float = 0.0
    """Height above the ellipsoid."""
    rate_hz: float = 600.0
    """Samples a second of the IMU, on which the noise of counts depends."""
    windows_s: list[float] = field(default_factory=lambda: [10.0, 20.0, 30.0, 60.0, 120.0, 240.0])
    """Window lengths; the budget is of the longest."""
    start_s: float = 0.0
    """Start of the windows in the recording: a random walk and warming up begin before it."""
    known: list[str] = field(default_factory=list)
    """Lifetimes whose errors are known: unit, session, run."""
    calibration: str | None = None
    """What is known of the unit already, a file that `calibrate` wrote."""
    labelled: list[int] = field(default_factory=list)
    """Numbers of further labelled recordings, for which the error after them is told: at headings
    evenly round the circle, on a level base."""
    labelled_protocol: str = "static"
    """What the plate does in them: static, or the same as in `protocol`."""
    labelled_s: float | None = None
    """Length of each; null: the longest window's."""
    labelled_power_ups: int | None = None
    """Over how many power-ups they are spread; null: each has its own."""
    labelled_error_deg: float = 0.1
    """1 sigma of their headings' error, new in each."""
    labelled_offset_deg: float = 0.0
    """1 sigma of a constant offset of their headings."""
    tumble: list[int] = field(default_factory=list)
    """Numbers of poses, in which the sensor is held at rest instead, for which the error is told,
    beside those of other ways to spend the same minutes."""
    tumble_dwell_s: float = 120.0
    """Time in each pose."""
    tumble_handling_s: float = 10.0
    """Time between two poses."""
    reference_error_deg: float = 0.0
    """1 sigma of the reference that errors are relative to; 0: they are relative to the truth."""
    lean_deg: float = 0.0
    """Angle by which the base leans; the bounds are for the worst direction of leaning."""
    level_error_deg: float = 0.0
    """1 sigma of a further roll and pitch that levelling the base leaves, new every time."""
    settle_s: float = SETTLE_S
    """Time in which the servo brings the plate to rest after a slew, as on the bench of sim/."""
    imu: ImuConfig = field(default_factory=ImuConfig)
    protocol: ProtocolConfig = field(default_factory=ProtocolConfig)

    def __post_init__(self) -> None:
        require(
            abs(self.latitude) <= 90 and bool(heading_exists(np.deg2rad(self.latitude))),
            "latitude",
            self.latitude,
            "must be between the poles (-90 to 90 degrees, both left out)",
        )
        require_height(self.height_m)
        require_positive("rate_hz", self.rate_hz)
        require(len(self.windows_s) > 0, "windows_s", self.windows_s, "must name a length")
        for window in self.windows_s:
            require_positive("windows_s", window)
            whole = f"must be a sample or more: {1 / self.rate_hz:g} s at {self.rate_hz:g} Hz"
            require(window * self.rate_hz >= 1, "windows_s", window, whole)
        require_not_negative(self, "start_s", "reference_error_deg", "lean_deg")
        require_not_negative(self, "level_error_deg", "settle_s")
        lean = self.lean_deg + 2 * self.level_error_deg
        require(
            lean <= MOST_LEAN,
            "lean_deg",
            self.lean_deg,
            "must be up to 10, twice level_error_deg added",
        )
        for name in self.known:
            require_choice("known", name, LIFETIMES)
        about = "and calibration are two things that are known of the unit: give one"
        require(not (self.known and self.calibration), "known", self.known, about)
        for count in self.labelled:
            good = 0 <= count <= labelling.MOST
            require(good, "labelled", count, f"must be from 0 to {labelling.MOST}")
        for count in self.tumble:
            good = 1 <= count <= ways.MOST_POSES
            require(good, "tumble", count, f"must be from 1 to {ways.MOST_POSES}")
        require_positive("tumble_dwell_s", self.tumble_dwell_s)
        require_not_negative(self, "tumble_handling_s")
        require_choice("labelled_protocol", self.labelled_protocol, ("static", "same"))
        require_positive("labelled_s", self.labelled_s)
        require_positive("labelled_power_ups", self.labelled_power_ups)
        require_not_negative(self, "labelled_error_deg", "labelled_offset_deg")

    @property
    def site(self) -> Site:
        """The place at this latitude and height."""
        latitude = float(np.deg2rad(self.latitude))
        return Site(latitude, normal_gravity(latitude, self.height_m))

    @cached_property
    def model(self) -> ImuModel:
        """The sensor's error model without the errors that are known."""
        law = self.imu.model(self.rate_hz)
        if self.calibration is not None:
            return unit_file.load(self.calibration, self.imu).told(law)
        return law.without(*self.known)


def main(config: BoundConfig) -> Path:
    """Print the bounds and the budget, draw error against time; return the directory."""
    rows = bounds(config, config.protocol)
    if not rows:
        course_of(config.protocol, max(config.windows_s))  # says why
    longest = max(rows, key=lambda row: row["window_s"])
    course = course_of(config.protocol, longest["window_s"], config.start_s, config.settle_s)
    worst = (
        float(np.deg2rad(longest["worst_roll_deg"])),
        float(np.deg2rad(longest["worst_pitch_deg"])),
    )
    parts = budget(config.model, course, config.site, HEADINGS, worst)
    short = sorted(set(config.windows_s) - {r["window_s"] for r in rows})
    if short:
        lengths = ", ".join(f"{w:g}" for w in short)
        print(f"windows of {lengths} s are too short for {config.protocol.name}")
    shortest = min(r["window_s"] for r in rows)
    said = unstated(config.imu.model(config.rate_hz)), warnings(config.model, shortest)
    for line in (*said[0], *said[1], *_mimicking(config)):
        print(line)
    print(table(config, rows))
    print(budget_table(parts, longest["window_s"]))
    learning = labelled(config, course, worst)
    tumbles = tumbled(config)
    directory = task_directory("bound", fingerprint(asdict(config)))
    budget_deg = {k: float(np.rad2deg(v)) for k, v in parts.items()}
    result = {"bounds": rows, "budget_deg": budget_deg, "labelled": learning, "tumble": tumbles}
    write_atomically(directory / "bound.json", as_json(result))
    figure = bound_against_time(_curves(config), f"{config.imu.name}, {config.latitude:g}°")
    write_atomically(directory / "bound.png", png(figure))
    if learning:
        picture = error_by_labelled(learning, f"{config.imu.name}, {config.protocol.name}")
        write_atomically(directory / "labelled.png", png(picture))
    mark_latest(directory)
    return directory


def labelled(
    config: BoundConfig, course: Course, lean: tuple[float, float]
) -> list[dict[str, float]]:
    """Print and return the expected floor, degrees, in a course after each number of labelled
    recordings, on a base that leans by roll and pitch, rad. Nothing where none is asked for."""
    if not config.labelled:
        return []
    seconds = config.labelled_s or max(config.windows_s)
    static = ProtocolConfig("static", "static")
    protocol = static if config.labelled_protocol == "static" else config.protocol
    of_labels = course_of(protocol, seconds, config.start_s, config.settle_s)
    error, offset = np.deg2rad([config.labelled_error_deg, config.labelled_offset_deg])
    reference, power_ups = Reference(np.array([error]), float(offset)), config.labelled_power_ups

    def floor(count: int) -> float:
        site = config.site
        known = labelling.after(config.model, of_labels, site, count, power_ups, reference)
        return expected_floor(information(known, course, site, lean=lean))

    rows = [
        {"labelled": count, "floor_deg": float(np.rad2deg(floor(count)))}
        for count in sorted(set(config.labelled))
    ]
    over = "each in a power-up of its own" if power_ups is None else f"in {power_ups} power-ups"
    print(
        f"after labelled recordings of this unit, {protocol.name}, {seconds:g} s, {over}, headings "
        f"to {config.labelled_error_deg:g} deg; north is sought in a new power-up:"
    )
    for row in rows:
        print(f"{row['labelled']:7.0f}   {row['floor_deg']:8.3f}")
    print(labelling.enough(floor))
    return rows


def tumbled(config: BoundConfig) -> list[dict[str, float]]:
    """Print and return the expected errors, degrees, after a tumble through each number of poses,
    and in other ways that take as long. Nothing where none is asked for."""
    if not config.tumble:
        return []
    of_labels = Reference(
        np.array([np.deg2rad(config.labelled_error_deg)]),
        float(np.deg2rad(config.labelled_offset_deg)),
    )
    times = config.tumble_dwell_s, config.tumble_handling_s
    rows = ways.ways(config.model, config.site, config.tumble, *times, of_labels)
    print(ways.table(rows, *times))
    return rows


def bounds(config: BoundConfig, protocol: ProtocolConfig) -> list[dict[str, float]]:
    """crlb and expected floor, degrees, at each window length that holds the protocol, and the lean
    that is worst."""
    reference = float(np.deg2rad(config.reference_error_deg))
    rows = []
    for window in sorted(config.windows_s):
        try:
            course = course_of(protocol, window, config.start_s, config.settle_s)
        except InputError:
            continue
        lean = max(
            _leans(config), key=lambda lean: small_errors(_information(config, course, lean))
        )
        nearby = [
            (p, _information(config, course, n))
            for p, n in _spread_about(lean, config.level_error_deg)
        ]
        closed = float(np.sqrt(sum(p * small_errors(told) for p, told in nearby) + reference**2))
        draws = DRAWS // len(nearby)
        errors = [p * expected_floor(told, draws=draws) ** 2 for p, told in nearby]
        rows.append(
            {
                "window_s": window,
                "crlb_deg": float(np.rad2deg(closed)) if closed < AS_LENGTHS else float("nan"),
                "floor_deg": float(np.rad2deg(np.sqrt(sum(errors) + reference**2))),
                "worst_roll_deg": float(np.rad2deg(lean[0])),
                "worst_pitch_deg": float(np.rad2deg(lean[1])),
            }
        )
    return rows


def _mimicking(config: BoundConfig) -> list[str]:
    """What to say of a magnetic sensitivity."""
    model, one = config.model, np.ones(1)
    if not model.feels_field:
        return []
    gyro = replace(model.gyro, drawn=tuple(e for e in model.gyro.drawn if e.follows == FIELD))
    when = When(0.0, 0 * one, config.site.latitude * one, config.site.gravity * one)
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)[None]
    rate = np.sqrt(like_north(replace(model, gyro=gyro), when, turn)[0]) / config.site.north
    return [
        f"MIMICS NORTH: {np.rad2deg(rate):.3g} deg (1 sigma) of what the gyros make of the "
        "magnetic field turns as Earth's rate does: no schedule about the vertical takes it out"
    ]


def _information(config: BoundConfig, course: Course, lean: tuple[float, float]) -> Information:
    """The information on the heading in a course on a base that leans by roll and pitch, rad."""
    return information(config.model, course, config.site, lean=lean)


def _leans(config: BoundConfig) -> list[tuple[float, float]]:
    """Roll and pitch, rad, of a base that leans by `lean_deg`, every thirty degrees round."""
    if config.lean_deg == 0:
        return [(0.0, 0.0)]
    at, size = np.deg2rad(np.arange(0, 360, 30.0)), np.deg2rad(config.lean_deg)
    return [(float(size * np.cos(a)), float(size * np.sin(a))) for a in at]


def _spread_about(
    lean: tuple[float, float], error_deg: float
) -> list[tuple[float, tuple[float, float]]]:
    """Leans about this one, and their weights, by which means over a normally distributed error of
    levelling are taken: Gauss and Hermite's three points in roll and in pitch."""
    if error_deg == 0:
        return [(1.0, lean)]
    points = [(1 / 6, -np.sqrt(3.0)), (2 / 3, 0.0), (1 / 6, np.sqrt(3.0))]
    step = np.deg2rad(error_deg)
    return [
        (p * q, (float(lean[0] + step * x), float(lean[1] + step * y)))
        for p, x in points
        for q, y in points
    ]


def table(config: BoundConfig, rows: Sequence[dict[str, float]]) -> str:
    """The bounds as text, degrees. rows : see `bounds`."""
    lines = [
        f"{config.imu.name}, {config.protocol.name}, latitude {config.latitude:g}: degrees",
        f"{'window':>9s} {'floor':>8s} {'crlb':>8s} {'floor·cos(lat)':>15s} {'95%':>8s}",
    ]
    if config.lean_deg > 0 and rows:
        worst = rows[-1]
        lines[0] += (
            f"; base leaning by {config.lean_deg:g}, at worst roll {worst['worst_roll_deg']:.3g} "
            f"and pitch {worst['worst_pitch_deg']:.3g}"
        )
    cos = np.cos(np.deg2rad(config.latitude))
    for row in rows:
        closed, rms = row["crlb_deg"], row["floor_deg"]
        small = not np.isnan(closed)
        said = f"{closed:8.3f}" if small else f"{'-':>8s}"
        wide = f"{1.96 * rms:8.3f}" if small else f"{'-':>8s}"
        lines.append(f"{row['window_s']:7g} s {rms:8.3f} {said} {rms * cos:15.3f} {wide}")
    return "\n".join(lines)


def budget_table(parts: dict[str, float], window_s: float) -> str:
    """The error budget as text. parts : cause -> its share of the error, rad RMS."""
    total = float(np.sqrt(sum(v**2 for v in parts.values())))
    lines = [f"what makes it up, {window_s:g} s, errors small: degrees and share of the variance"]
    for name, size in sorted(parts.items(), key=lambda item: -item[1]):
        lines.append(f"  {name:36s} {np.rad2deg(size):9.4f}  {(size / total) ** 2:6.1%}")
    return "\n".join([*lines, f"  {'together':36s} {np.rad2deg(total):9.4f}"])


def _curves(config: BoundConfig) -> dict[str, tuple[list[float], list[float]]]:
    """Window lengths, s, and expected floors, degrees, of the chosen protocol, and for comparison
    of a static, a two-position, a four-position and a carousel one, by name."""
    own = config.protocol
    kinds: list[tuple[str, str, tuple[float, ...]]] = [
        ("static", "static", (0.0,)),
        ("two_position", "indexed", (0.0, 180.0)),
        ("four_position", "indexed", (0.0, 90.0, 180.0, 270.0)),
        ("carousel", "carousel", (0.0,)),
    ]
    others = [
        replace(own, name=name, kind=kind, angles_deg=angles, dwell_s=None)
        for name, kind, angles in kinds
    ]
    protocols = {p.name: p for p in others}
    taken = protocols.get(own.name, own)
    alike = own.kind == taken.kind and (own.kind != "indexed" or own.angles_deg == taken.angles_deg)
    protocols[own.name if alike else f"{own.name} (chosen)"] = own
    longest = max(config.windows_s)
    shortest = max(min(10.0, longest / 4), 1 / config.rate_hz)
    times = [float(f"{t:.6g}") for t in np.geomspace(shortest, longest, 9)]
    curves = {}
    at = replace(config, windows_s=times)
    for name, protocol in tqdm(protocols.items(), "drawing", leave=False):
        rows = bounds(at, protocol)
        curves[name] = [r["window_s"] for r in rows], [r["floor_deg"] for r in rows]
    return curves


if __name__ == "__main__":
    run_main(main, BoundConfig, "bound")
