"""The evaluation of an IMU that is held in several attitudes, without a plate: the heading of each
pose is an answer, from the whole recording."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from tqdm import tqdm

from lbgc.answers import Evaluation, Own
from lbgc.data.poses import Poses, described, headings_of, poses_of
from lbgc.data.record import Record
from lbgc.earth import heading_exists
from lbgc.errors import InputError, require, require_choice
from lbgc.estimators.estimate import Estimate, FromPoses, TellsPoses
from lbgc.estimators.torus import HEMISPHERES
from lbgc.frames import rotation_z
from lbgc.report.page import Subject
from lbgc.sensor.imu import ImuModel
from lbgc.subjects import Measured
from lbgc.units import DEG

_DESCRIBED = 4
"""Most recordings whose poses are described one by one."""


@dataclass(frozen=True)
class TumbleConfig:
    """What is asked of an estimator of poses, the keys `tumble` of `conf/evaluate.yaml`."""

    integrated: bool = False
    """Whether the gyros tell the turns between poses too, from a log that goes on while it is
    handled."""
    find_latitude: bool = False
    """Whether the latitude is to be found, and not told."""
    hemisphere: str = "either"
    """either, north or south: where a latitude that is to be found is."""

    def __post_init__(self) -> None:
        require_choice("hemisphere", self.hemisphere, HEMISPHERES)


@dataclass
class Tumbles:
    """An estimator's answers to recordings of poses."""

    evaluation: Evaluation = field(default_factory=Evaluation)
    notes: list[str] = field(default_factory=list)
    each: list[dict] = field(default_factory=list)
    """For JSON: of each recording its poses, the ways to hold their headings, and the latitude"""


def asked(
    config: TumbleConfig,
    name: str,
    estimate: TellsPoses,
    subject: Subject,
    records: Iterator[Measured],
    count: int,
) -> Tumbles:
    """Ask an estimator of poses for the headings of every recording. Raises InputError where a
    recording has no poses, or where it answers none."""
    imu = subject.imu
    if imu is None:
        about = "must be given: what poses tell of a bias hangs on the sensor's noise and drift"
        raise InputError("imu", None, "", about)
    found, said = Tumbles(), Counter[str]()
    for number, own in enumerate(tqdm(records, "evaluating", count, unit="rec", leave=False)):
        record = own.record
        if not config.find_latitude:
            _require_latitude(record)
        poses = poses_of(record, config.integrated, not config.find_latitude)
        found.evaluation.recordings.append(record.name)
        if number < _DESCRIBED:
            found.notes.append(described(poses, record.name))
        answers: list[FromPoses] = []
        facts = Own(
            np.full(len(poses), np.nan),
            np.full(len(poses), number),
            np.full(len(poses), record.latitude),
            poses.start_s,
            np.full(len(poses), record.reference_sigma or 0.0),
        )

        def answer(
            poses: Poses = poses, own: Measured = own, facts: Own = facts, to: list = answers
        ) -> Estimate:
            told = _told(estimate, poses, imu, config)
            to.append(told)
            if told.latitude is not None and np.isnan(own.record.latitude):
                facts.latitude[:] = told.latitude
            if subject.against is not None:
                levels = rotation_z(-told.heading) @ told.attitude
                facts.heading[:] = headings_of(poses, own.record, levels)
                facts.heading[:] += _misread(own, subject.against)
            return Estimate(told.heading, told.sigma)

        found.evaluation.ask((name, record.duration_s), answer, facts)
        for told in answers:
            found.each.append(_as_json(record.name, poses, told))
            said.update(told.notes)
    if count > _DESCRIBED:
        found.notes.append(f"{count - _DESCRIBED} more recordings had their poses found likewise")
    if not found.evaluation.answers:
        raise InputError("estimator", name, "", "; ".join(found.evaluation.why_not()))
    found.notes += [
        n if k == count else f"{n} ({k} of {count} recordings)" for n, k in said.items()
    ]
    return found


def _require_latitude(record: Record) -> None:
    """Raise InputError where the latitude is not known, or is a pole's."""
    known = bool(np.isfinite(record.latitude))
    about = f"must be given for {record.name}; tumble.find_latitude=true finds it from the poses"
    require(known, "log.latitude", None, about)
    require(
        bool(heading_exists(record.latitude)),
        "latitude",
        round(float(np.rad2deg(record.latitude)), 6),
        f"{record.name} was taken at a pole, where heading does not exist",
    )


def _told(estimate: TellsPoses, poses: Poses, imu: ImuModel, config: TumbleConfig) -> FromPoses:
    """The estimator's answer to one recording's poses."""
    if config.find_latitude:
        return estimate(poses, imu, hemisphere=config.hemisphere)
    return estimate(poses, imu)


def _misread(own: Measured, against: str) -> float:
    """What the reference that errors are relative to is off by, rad: of a dataset's, in every pose
    the same."""
    record = own.record
    if against == "truth" or record.heading is None or record.heading_reference is None:
        return 0.0
    return record.heading_reference - record.heading


def _as_json(name: str, poses: Poses, told: FromPoses) -> dict:
    """What was found of one recording, degrees."""
    interval = told.latitude_interval
    return {
        "recording": name,
        "poses": [
            {"start_s": float(start), "lasts_s": float(lasts), "heading_deg": _degrees(heading),
             "sigma_deg": float(sigma / DEG)}
            for start, lasts, heading, sigma in zip(
                poses.start_s, poses.lasts_s, told.heading, told.sigma, strict=True)
        ],
        "modes": [
            {"weight": float(mode.weight), "heading_deg": [_degrees(own) for own in mode.heading]}
            for mode in told.modes
        ],
        "latitude_deg": None if told.latitude is None else told.latitude / DEG,
        "latitude_interval_deg": None if interval is None else [own / DEG for own in interval],
    }  # fmt: skip


def _degrees(heading: float) -> float:
    """A heading from 0 to 360 degrees."""
    return float(np.mod(np.rad2deg(heading), 360))


def ways(each: Sequence[dict]) -> list[str]:
    """Sentences on the ways to hold the headings where there are several, the likeliest first; of
    the first few recordings."""
    return [
        f"{own['recording']}, {mode['weight']:.1%} probable: headings "
        f"{', '.join(f'{heading:.1f}' for heading in mode['heading_deg'])} deg"
        for own in each[:_DESCRIBED]
        if len(own["modes"]) > 1
        for mode in own["modes"]
    ]


def latitudes(each: Sequence[dict]) -> list[str]:
    """Sentences on the latitudes that were found, with their 95% intervals; of the first few."""
    return [
        f"{own['recording']}: latitude {own['latitude_deg']:.2f}, 95% from "
        f"{own['latitude_interval_deg'][0]:.2f} to {own['latitude_interval_deg'][1]:.2f} deg"
        for own in each[:_DESCRIBED]
        if own["latitude_deg"] is not None
    ]
