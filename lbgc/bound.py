"""How well anyone can find north with this sensor, and what limits it.

python lbgc/bound.py imu=stim300 protocol=two_position latitude=60

Two bounds, both of the Gaussian model that `lbgc.estimators.information` states:

- `crlb`, in closed form: the van Trees bound, errors being small against the circle. It is quoted
  only below 6 degrees; above, angles no longer behave like lengths.
- `floor`: the Bayes-optimal estimator itself (flat prior on the circle, circular mean of the
  posterior). Its RMSE on a set of windows is the least that any estimator can have on windows drawn
  by that model, and "over the floor" means over this, on the same windows.

Both are of blocks at rest or in steady motion. A slew's own blocks tell of north too, to whoever
knows the gyros' misalignment to a part in a hundred thousand: on two positions, in four minutes
of 5 s means, the RMSE would be 1.8% less with them. No estimator here takes them.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from lbgc.data.windows import Windows
from lbgc.earth import EARTH_RATE, heading_exists, normal_gravity
from lbgc.errors import InputError, require, require_choice, require_positive, run_main
from lbgc.estimators.course import MOST_BLOCKS, Course, Levelled, Site
from lbgc.estimators.estimate import Estimate, refusal
from lbgc.estimators.information import (
    AS_LENGTHS,
    LIFETIMES,
    Information,
    across,
    along,
    bayes,
    covariance,
    information,
    known,
    sources,
    turn,
)
from lbgc.estimators.linear import answer, needs_model
from lbgc.frames import wrap
from lbgc.outputs import fingerprint, mark_latest, task_directory, write_atomically
from lbgc.protocol import ProtocolConfig, plan
from lbgc.report.figures import bound_against_time, png
from lbgc.sensor import streams
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.dither import warnings
from lbgc.sensor.imu import ImuModel

_HEADINGS = np.deg2rad(np.arange(0.0, 360.0, 10.0))
_DRAWS = 3000


def white_crlb(N: float, latitude: float, duration_s: float) -> float:
    """1 sigma, rad, of white rate noise alone: N/(Omega cos(lat) sqrt(T)), the paper's case.

    N : rad/sqrt(s); latitude : rad.
    """
    return float(N / (EARTH_RATE * np.cos(latitude) * np.sqrt(duration_s)))


def crlb(told: Information, reference_sigma: float = 0.0) -> float:
    """RMS over headings of the least standard deviation, rad; NaN above 6 degrees.

    reference_sigma : rad, of the reference, where errors are taken from one that errs.
    """
    rms = float(np.sqrt(np.mean(told.sigma(_HEADINGS) ** 2) + reference_sigma**2))
    return rms if rms < AS_LENGTHS else float("nan")


def expected_floor(told: Information, reference_sigma: float = 0.0) -> float:
    """RMSE that the Bayes-optimal estimator is to be expected to have, rad: over headings and over
    the law of h, Normal(J q, J), which is all that the data tell. Seeded, to about 1%.

    Small errors are nearly n'(h - J q)/(n' J n), whose mean square is known: their difference has
    far less spread than they have.
    """
    rng = streams.figures()
    psi = rng.uniform(-np.pi, np.pi, _DRAWS)
    q, n = along(psi), across(psi)
    values, vectors = np.linalg.eigh(told.J)
    noise = rng.standard_normal((_DRAWS, 2)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    square = wrap(bayes(q @ told.J + noise, told.J).heading - psi) ** 2
    sigma = told.sigma(psi)
    if np.median(sigma) < np.deg2rad(20.0):
        linear = np.sum(n * noise, axis=1) * sigma**2
        square = square - linear**2 + np.mean(told.sigma(_HEADINGS) ** 2)
    return float(np.sqrt(np.mean(square) + reference_sigma**2))


def floor(windows: Windows, imu: ImuModel | None = None) -> Estimate:
    """The Bayes-optimal estimate of windows, from the block means of at most 240 blocks at rest or
    in steady motion. What is known of the sensor's errors is taken out of both (see `known`).

    Raises InputError where the data scatter far more than the model says: on a base that sways
    this is the optimum of nothing, and no floor.
    """
    model = needs_model("floor", imu)

    def each(part: Levelled) -> Estimate:
        told = information(model, part.course, part.site)
        h = told.told(part.data)
        _check_fit(part, covariance(model, part.course, part.site))
        return bayes(h, told.J)

    return answer(windows, model, each, "floor")


def _check_fit(part: Levelled, C: np.ndarray) -> None:
    """The sensor's model is right where `misfit` is 1. It may be 2, or ten of its own standard
    deviations more where there are few data."""
    left, most = misfit(part, C), max(2.0, 1 + 10 * np.sqrt(2 / part.data.size))
    if left > most:
        about = "times the scatter that the sensor's model explains: the base moves, or the model "
        raise refusal("floor", f"{left:.3g}", "", about + "is not this sensor's")


def misfit(part: Levelled, C: np.ndarray) -> float:
    """Mean of the normalised squares that the best heading and tilt of each window leave. The tilt
    is fitted with the heading: gyros of navigation grade feel what the level's error makes of
    Earth's vertical rate. C : covariance of the data, (4, n, n)."""
    sides = np.concatenate([turn(part.course, part.site), np.moveaxis(part.data, 0, 2)], axis=2)
    normalised = np.linalg.solve(np.linalg.cholesky(C), sides).reshape(-1, sides.shape[2])
    design, data = normalised[:, :4], normalised[:, 4:]
    residual = data - design @ np.linalg.lstsq(design, data, rcond=None)[0]
    return float(np.sum(residual**2) / max(1, data.size - 4 * data.shape[1]))


def budget(imu: ImuModel, course: Course, site: Site) -> dict[str, float]:
    """What each source contributes to the most likely heading's error, rad RMS over headings.

    Small errors are n'(h - J q)/(n' J n), n across the heading, and h - J q is the weights times
    the sources' errors: their squares add up to the bound's.
    """
    told = information(imu, course, site)
    n = across(_HEADINGS)
    found = {}
    for name, C in sources(imu, course, site).items():
        spread = np.einsum("ian,anm,jam->ij", told.weights, C, told.weights)
        variance = np.sum((n @ spread) * n, axis=1) * told.sigma(_HEADINGS) ** 4
        found[name] = float(np.sqrt(max(np.mean(variance), 0.0)))
    return {name: size for name, size in found.items() if size > 0}


def course_of(config: ProtocolConfig, duration_s: float, start_s: float = 0.0) -> Course:
    """Of a window that holds the whole protocol. Raises InputError where it is too short for it."""
    planned = plan(config, 0, duration_s)
    fine = 40
    interval = duration_s / MOST_BLOCKS
    middles = (np.arange(MOST_BLOCKS * fine) + 0.5) * interval / fine
    angle = planned.command(middles)[0].reshape(MOST_BLOCKS, fine).mean(axis=1)
    course = Course.planned(angle - planned.start, interval, start_s)
    require(len(course.blocks) > 1, "windows_s", duration_s, "leaves no rest between the slews")
    return course


@dataclass(frozen=True)
class BoundConfig:
    """What `conf/bound.yaml` holds."""

    latitude: float = 32.76
    """degrees, north positive"""
    height_m: float = 0.0
    """Above the ellipsoid."""
    rate_hz: float = 600.0
    """Samples a second of the IMU: counts add noise by it."""
    windows_s: list[float] = field(default_factory=lambda: [10.0, 20.0, 30.0, 60.0, 120.0, 240.0])
    """Window lengths; the budget is of the longest."""
    start_s: float = 0.0
    """Of the windows, since the recording's start: a random walk and warming up go on before."""
    known: list[str] = field(default_factory=list)
    """Lifetimes whose errors are known: unit, session, run."""
    reference_error_deg: float = 0.0
    """1 sigma of the reference that errors are taken from; 0: from the truth."""
    imu: ImuConfig = field(default_factory=ImuConfig)
    protocol: ProtocolConfig = field(default_factory=ProtocolConfig)

    def __post_init__(self) -> None:
        require(
            abs(self.latitude) <= 90 and bool(heading_exists(np.deg2rad(self.latitude))),
            "latitude",
            self.latitude,
            "must be between the poles (-90 to 90 degrees, both left out)",
        )
        require_positive("rate_hz", self.rate_hz)
        require(len(self.windows_s) > 0, "windows_s", self.windows_s, "must name a length")
        for window in self.windows_s:
            require_positive("windows_s", window)
        for name in ("start_s", "reference_error_deg"):
            require(getattr(self, name) >= 0, name, getattr(self, name), "must not be negative")
        for name in self.known:
            require_choice("known", name, LIFETIMES)

    @property
    def site(self) -> Site:
        latitude = float(np.deg2rad(self.latitude))
        return Site(latitude, normal_gravity(latitude, self.height_m))

    @property
    def model(self) -> ImuModel:
        return known(self.imu.model(self.rate_hz), tuple(self.known))


def main(config: BoundConfig) -> Path:
    """Print the bounds and the budget, draw error against time; return the directory."""
    rows = bounds(config, config.protocol)
    if not rows:
        course_of(config.protocol, max(config.windows_s))  # says why
    longest = max(r["window_s"] for r in rows)
    course = course_of(config.protocol, longest, config.start_s)
    parts = budget(config.model, course, config.site)
    short = sorted(set(config.windows_s) - {r["window_s"] for r in rows})
    if short:
        lengths = ", ".join(f"{w:g}" for w in short)
        print(f"windows of {lengths} s are too short for {config.protocol.name}")
    for line in warnings(config.model, min(r["window_s"] for r in rows)):
        print(line)
    print(table(config, rows))
    print(budget_table(parts, longest))
    directory = task_directory("bound", fingerprint(asdict(config)))
    result = {"bounds": rows, "budget_deg": {k: float(np.rad2deg(v)) for k, v in parts.items()}}
    write_atomically(directory / "bound.json", json.dumps(result, indent=2))
    figure = bound_against_time(_curves(config), f"{config.imu.name}, {config.latitude:g}°")
    write_atomically(directory / "bound.png", png(figure))
    mark_latest(directory)
    return directory


def bounds(config: BoundConfig, protocol: ProtocolConfig) -> list[dict[str, float]]:
    """crlb and expected floor, degrees, at each window that is long enough for the protocol."""
    rows = []
    for window in sorted(config.windows_s):
        try:
            course = course_of(protocol, window, config.start_s)
            told = information(config.model, course, config.site)
        except InputError:
            continue
        reference = float(np.deg2rad(config.reference_error_deg))
        rows.append(
            {
                "window_s": window,
                "crlb_deg": float(np.rad2deg(crlb(told, reference))),
                "floor_deg": float(np.rad2deg(expected_floor(told, reference))),
            }
        )
    return rows


def table(config: BoundConfig, rows: Sequence[dict[str, float]]) -> str:
    lines = [
        f"{config.imu.name}, {config.protocol.name}, latitude {config.latitude:g}: degrees",
        f"{'window':>9s} {'floor':>8s} {'crlb':>8s} {'floor·cos(lat)':>15s} {'95%':>8s}",
    ]
    cos = np.cos(np.deg2rad(config.latitude))
    for row in rows:
        closed, rms = row["crlb_deg"], row["floor_deg"]
        small = not np.isnan(closed)
        said = f"{closed:8.3f}" if small else f"{'-':>8s}"
        wide = f"{1.96 * rms:8.3f}" if small else f"{'-':>8s}"
        lines.append(f"{row['window_s']:7g} s {rms:8.3f} {said} {rms * cos:15.3f} {wide}")
    return "\n".join(lines)


def budget_table(parts: dict[str, float], window_s: float) -> str:
    total = float(np.sqrt(sum(v**2 for v in parts.values())))
    lines = [f"what makes it up, {window_s:g} s, errors small: degrees and share of the variance"]
    for name, size in sorted(parts.items(), key=lambda item: -item[1]):
        lines.append(f"  {name:36s} {np.rad2deg(size):9.4f}  {(size / total) ** 2:6.1%}")
    return "\n".join([*lines, f"  {'together':36s} {np.rad2deg(total):9.4f}"])


def _curves(config: BoundConfig) -> dict[str, tuple[list[float], list[float]]]:
    """Expected floor against time of the chosen protocol, and of one of each kind beside it."""
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
    protocols = {p.name: p for p in [*others, own]}
    longest = max(config.windows_s)
    times = np.geomspace(min(10.0, longest / 4), longest, 9).round(3).tolist()
    curves = {}
    at = replace(config, windows_s=times)
    for name, protocol in tqdm(protocols.items(), "drawing", leave=False):
        rows = bounds(at, protocol)
        curves[name] = [r["window_s"] for r in rows], [r["floor_deg"] for r in rows]
    return curves


if __name__ == "__main__":
    run_main(main, BoundConfig, "bound")
