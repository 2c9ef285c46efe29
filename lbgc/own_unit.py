"""What labelled recordings teach of one unit: what `calibrate` writes to the unit's file, and says
of it."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from lbgc.data.compensated import without_mean
from lbgc.data.record import Record, block_means
from lbgc.data.unit_file import CalibratedUnit
from lbgc.data.windows import Windows, cut, joined
from lbgc.earth import normal_gravity
from lbgc.errors import require
from lbgc.estimators.block_means import MOST_BLOCKS, Course, Site
from lbgc.estimators.floor import expected_floor
from lbgc.estimators.information import information
from lbgc.estimators.static import gls
from lbgc.estimators.unit_posterior import (
    Posterior,
    Reference,
    evidence,
    posterior,
    undivided,
)
from lbgc.estimators.unit_verdict import UnitVerdict, Way, verdict, ways
from lbgc.frames import wrap
from lbgc.outputs import fingerprint
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.errors import LIFETIMES
from lbgc.sensor.imu import ImuModel
from lbgc.sensor.known import Known
from lbgc.sensor.unit import lasting
from lbgc.units import DEG, HOUR

SPLITS = ("estimated", "stated")
_DPH = DEG / HOUR


@dataclass
class Labels:
    """Recordings with known headings as they pass by, of each its means over 240 blocks at most."""

    new: float | None = None
    """rad, 1 sigma of the headings' error, new in each; None: as the recordings state it"""
    windows: list[Windows] = field(default_factory=list)
    heading: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    sessions: list[str | None] = field(default_factory=list)

    def passing(self, records: Iterable[Record]) -> Iterator[Record]:
        """The recordings, each kept as it passes."""
        for record in records:
            self.add(record)
            yield record

    def add(self, record: Record) -> None:
        """Keep a recording whose heading is known; others are left to those who read on."""
        if record.heading_reference is None:
            return
        size = -(-len(record.gyro) // MOST_BLOCKS)
        means = record if size == 1 else block_means(record, record.rate_hz / size)
        self.windows.append(cut(means, means.duration_s))
        self.heading.append(record.heading_reference)
        self.errors.append((record.reference_sigma or 0.0) if self.new is None else self.new)
        self.sessions.append(record.session)

    @property
    def session(self) -> np.ndarray:
        """The power-up of each, (R,), texts: one, where none is named."""
        return np.array(["" if own is None else own for own in self.sessions])

    def alike(self) -> list[Windows]:
        """The same windows in order, those of one length together."""
        found: list[list[Windows]] = []
        for own in self.windows:
            last = found[-1][-1] if found else None
            if last is not None and (last.gyro.shape, last.rate_hz) == (
                own.gyro.shape,
                own.rate_hz,
            ):
                found[-1].append(own)
            else:
                found.append([own])
        return [joined(several) for several in found]


@dataclass(frozen=True, eq=False)
class Learned:
    """A unit, and how it was learned."""

    unit: CalibratedUnit
    posterior: Posterior
    prior: ImuModel
    """The sensor's model before"""
    verdict: UnitVerdict | None
    """Whether it shows a constant; None where the split of the bias is stated"""
    sigma: tuple[float, float]
    """rad, the expected error of a heading from one more recording like these, before and now"""
    foretold: "Foretold | None" = None
    """What a constant is worth for headings; None where the split of the bias is stated"""


@dataclass(frozen=True, eq=False)
class Foretold:
    """Headings of recordings by what the others tell of the unit, with a constant and without."""

    rmse: tuple[float, float]
    """rad, with a constant and without"""
    gains: np.ndarray
    """Of each power-up (of each recording, where there is one power-up): the mean logarithm of the
    headings' probability density with a constant, less that without"""

    @property
    def gain(self) -> float:
        """The mean of the gains."""
        return float(self.gains.mean())

    @property
    def gain_sigma(self) -> float:
        """Its standard error; infinite of one."""
        n = len(self.gains)
        return float(self.gains.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")


def learned(
    imu: ImuConfig,
    rate_hz: float,
    labels: Labels,
    offset: float,
    split: str,
    now: str | None,
    before: CalibratedUnit | None = None,
) -> Learned:
    """Learn a unit of this sensor by its labelled recordings.

    offset : rad, 1 sigma of the headings' constant offset; split : see `CalibrateConfig.split`;
    now : the power-up that is still on; before : what was known of it already, of which that of a
    power-up is not taken over. Raises InputError where `now` is none of these recordings', or where
    `before` holds recordings of a power-up that these are from too: they share its errors.
    """
    prior, session = imu.model(rate_hz), labels.session
    powered = list(dict.fromkeys(session.tolist()))
    require(now is None or now in powered, "now", now, powered)
    if before is not None:
        again = [own or "(unnamed)" for own in powered if own in before.sessions]
        about = "are of power-ups of which the file has recordings already: calibrate by all, "
        about += "or name the power-ups (log.session, or a column session)"
        require(not again, "calibration", ", ".join(again), about)
        before = replace(before, known=lasting(prior, before.known), now=None)
        prior = before.told(prior)
    estimated = split == "estimated" and before is None and bool(prior.gyro.bias().any())
    base = undivided(prior) if estimated else prior
    windows = labels.alike()
    if before is not None:
        windows = [_without(own, imu.model(rate_hz), before.known) for own in windows]
    heading = np.array(labels.heading)
    told = evidence(base, windows, heading, Reference(np.array(labels.errors), offset))
    if estimated:
        part, both = ways(base, told, session)
        found = posterior(base, told, session, now, both[0].shares, both[0].mass)
        said: UnitVerdict | None = verdict(both)
        others = _foretold(base, part, both, windows, labels, offset)
    else:
        found, said, others = posterior(base, told, session, now), None, None
    old = () if before is None else before.sessions
    unit, power, run = (_three(found.imu.gyro.bias(life)) for life in LIFETIMES)
    if before is not None or not estimated:
        unit = _three(imu.gyro.triad().bias("unit"))
    own = CalibratedUnit(
        imu.name,
        fingerprint(asdict(imu)),
        (unit, power, run),
        found.known,
        len(heading) + (0 if before is None else before.recordings),
        (*old, *powered),
        now,
    )
    last = windows[-1]
    sizes = tuple(_expected(model, last) for model in (prior, own.told(imu.model(rate_hz))))
    return Learned(own, found, prior, said, (sizes[0], sizes[1]), others)


def _foretold(
    base: ImuModel,
    part: np.ndarray,
    both: Sequence[Way],
    windows: list[Windows],
    labels: Labels,
    offset: float,
) -> Foretold:
    """Each power-up's headings by what the others tell; each recording's by what the others of its
    power-up do, where there is one. base : undivided; part, both : see `ways`."""
    rows = [own.rows(slice(k, k + 1)) for own in windows for k in range(len(own))]
    errors, scores = np.empty((2, len(rows))), np.empty((2, len(rows)))
    for way, own in enumerate(both):
        for k, window in enumerate(rows):
            found = own.others[part[k]]
            answer = gls(_without(window, base, found.known), found.imu, checked=False)
            off = float(wrap(answer.heading[0] - labels.heading[k]))
            variance = float(answer.sigma[0]) ** 2 + labels.errors[k] ** 2 + offset**2
            errors[way, k] = off
            scores[way, k] = -off * off / (2 * variance) - np.log(variance) / 2
    gains = np.bincount(part, scores[0] - scores[1]) / np.bincount(part)
    with_it, without = np.sqrt(np.mean(errors**2, axis=1)).tolist()
    return Foretold((with_it, without), gains)


def _three(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _without(windows: Windows, imu: ImuModel, known: Known) -> Windows:
    """Windows with the means of what is known of the unit taken off what its sensor printed."""
    rows = [without_mean(_record(windows, k), imu, known) for k in range(len(windows))]
    return joined([cut(own, own.duration_s) for own in rows])


def _record(windows: Windows, k: int) -> Record:
    """One window as a recording."""
    return Record(
        "window",
        windows.gyro[k],
        windows.accel[k],
        windows.plate_angle[k],
        windows.rate_hz,
        float(windows.latitude[k]),
    )


def _expected(imu: ImuModel, windows: Windows) -> float:
    """The floor, rad, of one more recording at rest that is as long as these."""
    latitude = float(windows.latitude[0])
    site = Site(latitude, normal_gravity(latitude))
    blocks = max(2, windows.gyro.shape[1])
    course = Course.planned(np.zeros(blocks), windows.duration_s / blocks)
    return expected_floor(information(imu, course, site))


def report(found: Learned) -> list[str]:
    """What was learned, in sentences."""
    unit, known = found.unit, found.posterior.known
    count = len(unit.sessions)
    lines = [
        f"what is known of this {unit.sensor} now, by {unit.recordings} labelled recordings of "
        f"{count} power-up{'s' * (count != 1)}:"
    ]
    for k, c in enumerate(known.coefficients):
        if c.triad == "gyro" and c.error in ("bias_unit", "bias_session"):
            whose = "this unit" if c.error == "bias_unit" else f"power-up {unit.now}"
            lines.append(
                f"  bias {['forward', 'right', 'down'][c.i]:8s} of {whose} "
                f"{known.mean[k] / _DPH:+.4g} deg/h, 1 sigma {known.sigma[k] / _DPH:.3g}"
            )
    before, now = (np.rad2deg(own) for own in found.sigma)
    lines.append(
        f"one more recording like these, in a power-up of its own: {before:.3g} deg before, "
        f"{now:.3g} deg now"
        if unit.now is None
        else f"one more recording like these, in this power-up: {before:.3g} deg before, "
        f"{now:.3g} deg now"
    )
    if found.verdict is not None:
        lines += _of_split(found, count)
    else:
        lines.append("how its bias splits is taken as stated, by the sensor or the file before")
    return lines


def _of_split(found: Learned, sessions: int) -> list[str]:
    """What the recordings say of how the bias splits, and of a constant."""
    assert found.verdict is not None
    weight, shares = found.posterior.weight, found.posterior.shares
    whole = float(np.sqrt(np.mean(np.square(found.prior.gyro.bias())))) / _DPH
    parts = []
    for own, who in zip(
        shares.T, ("a unit keeps", "a power-up adds", "a recording adds"), strict=True
    ):
        low, high = (whole * np.sqrt(end) for end in _interval(own, weight))
        parts.append(f"{who} {whole * np.sqrt(weight @ own):.3g} ({low:.2g} to {high:.2g})")
    lines = [f"of its bias, {whole:.3g} deg/h as described, {', '.join(parts)}: 1 sigma, 95%"]
    if sessions < 2:
        lines.append("one power-up: a unit's constant and this power-up's cannot be told apart")
    factor = found.verdict.log_bayes_factor / np.log(10)
    whose = "this unit" if sessions > 1 else "this unit or its power-up"
    said = f"log10 of the Bayes factor of a constant of {whose} against none: {factor:+.2f}"
    if len(found.verdict.gains) > 1:
        gain, sigma = found.verdict.gain, found.verdict.gain_sigma
        each = "power-up" if sessions > 1 else "recording"
        said += (
            f"; data of one {each} by the others', log predictive score {gain:+.2f} (standard "
            f"error {sigma:.2f})"
        )
    lines.append(said)
    if found.foretold is not None:
        lines.append(_of_headings(found.foretold, sessions))
    if factor < 0:
        lines.append(f"these recordings show no constant of {whose}; expect no gain")
    elif found.foretold is not None and found.foretold.gain < 0:
        lines.append(
            "whatever constant these recordings show, it makes no heading better; expect no gain"
        )
    return lines


def _of_headings(found: Foretold, sessions: int) -> str:
    """What a constant is worth for headings, in a sentence."""
    with_it, without = np.rad2deg(found.rmse)
    whose = "each power-up's headings by what the others tell"
    if sessions < 2:
        whose = "each heading by what the power-up's other recordings tell"
    return (
        f"{whose}: {with_it:.3g} deg RMS with a constant, {without:.3g} without; log predictive "
        f"score {found.gain:+.3f} (standard error {found.gain_sigma:.3f}) a heading"
    )


def _interval(values: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """The 95% interval of a weighted sample."""
    order = np.argsort(values)
    below = np.cumsum(weight[order])
    low, high = (int(np.searchsorted(below, p)) for p in (0.025, 0.975))
    own: Sequence[float] = values[order].tolist()
    return own[low], own[min(high, len(own) - 1)]
