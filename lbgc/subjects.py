"""The subject of an evaluation: a dataset's recordings or a log's, and what is known of their
sensor."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbgc.data import logs, picture, unit_file
from lbgc.data.compensated import calibrated, drawn_errors, without_mean
from lbgc.data.record import Record
from lbgc.data.store import Dataset
from lbgc.data.unit_file import CalibratedUnit
from lbgc.earth import heading_exists
from lbgc.errors import InputError, build, require
from lbgc.outputs import shown
from lbgc.report.page import Subject
from lbgc.sensor.datasheet import ImuConfig


@dataclass(frozen=True)
class Measured:
    """A recording, and a copy of it from which the known errors of its sensor are taken out."""

    record: Record
    calibrated: Record | None = None


_BATCH_BYTES = 6e6
"""Bytes of gyro data of the recordings that are answered together: many short recordings, or two
at full rate."""


def batches(records: Iterator[Measured]) -> Iterator[list[Measured]]:
    """Consecutive recordings of equal rate and length in lists, so that estimators can answer many
    at once."""
    batch: list[Measured] = []
    for own in records:
        if batch:
            first = batch[0].record
            alike = own.record.rate_hz == first.rate_hz and len(own.record.gyro) == len(first.gyro)
            if not alike or len(batch) * first.gyro.nbytes > _BATCH_BYTES:
                yield batch
                batch = []
        batch.append(own)
    if batch:
        yield batch


def of_log(
    log: logs.LogConfig, imu: ImuConfig | None, tumbles: bool = False
) -> tuple[Subject, Iterator[Measured], int]:
    """A log's description, its recordings, and their number. imu : its sensor, where the user names
    one; tumbles : whether it was held in several attitudes."""
    law = None if imu is None else imu.model(log.rate_hz or 1.0)
    records = list(logs.read(log, law, tumbles=tumbles))
    unknown = [record.name for record in records if not record.has_reference]
    if unknown:
        whose = unknown[0] + (f" and {len(unknown) - 1} more" if len(unknown) > 1 else "")
        key = "log.poses gives them" if tumbles else "log.heading_deg gives one"
        notes = [f"{whose}: no heading is known, so there are no errors; {key}"]
    else:
        notes = [f"{log.name}: a real log has no truth; errors are from its reference"]
        if log.heading_sigma_deg is not None:
            notes.append(
                f"its 1 sigma is {log.heading_sigma_deg:g} deg, which is part of every error here; "
                "sigmas are held against errors with it taken into account"
            )
    named = [f"{key} {own}" for key, own in (("unit", log.unit), ("session", log.session)) if own]
    notes += [f"the log is of {', '.join(named)}"] if named else []
    notes += dict.fromkeys(note for record in records for note in record.notes)
    model = None if imu is None else imu.model(records[0].rate_hz)
    some = records[:16]
    subject = Subject(
        log.name,
        None if unknown else "reference",
        notes,
        lambda: some,
        min(len(r.gyro) for r in some),
        some[0].rate_hz,
        some[0].latitude,
        identity="",
        imu=model,
        sensor=None if imu is None else imu.name,
    )
    return subject, (Measured(record) for record in records), len(records)


def of_dataset(
    path: str, split: str, against: str, lifetimes: Sequence[str], told: ImuConfig | None
) -> tuple[Subject, Iterator[Measured], int]:
    """The description of a dataset's split, its recordings, and their number.

    lifetimes : of the drawn errors that are taken out of second copies; told : the sensor that
    estimators are told, in place of the dataset's own.
    """
    dataset = Dataset.open_finished(path)
    indices = dataset.in_split(split)
    require(len(indices) > 0, "split", split, "has no recordings in this dataset")
    configuration = dataset.configuration
    own = build(ImuConfig, configuration["imu"])
    notes = []
    if told is not None:
        notes.append(f"estimators are told of {told.name}; the data are of {own.name}")
    subject = Subject(
        shown(f"{dataset.place}, {split} split"),
        against,
        notes,
        lambda: dataset.records(indices[:16]),
        dataset.layout.samples,
        dataset.rate_hz,
        float(np.deg2rad(configuration["latitude"])),
        identity=dataset.identity,
        configuration=configuration,
        imu=(told or own).model(float(configuration["rate_hz"])),
        sensor=(told or own).name,
        picture=picture.beside(dataset.place),
    )
    measured: Iterator[Measured] = (Measured(record) for record in dataset.records(indices))
    if lifetimes:
        law = own.model(float(configuration["rate_hz"]))
        measured = (
            Measured(record, calibrated(record, law, *drawn, tuple(lifetimes)))
            for record, drawn in zip(
                dataset.records(indices), drawn_errors(dataset, indices), strict=True
            )
        )
    return subject, measured, len(indices)


def require_of_unit(unit: CalibratedUnit, said: str | logs.LogConfig, split: str) -> None:
    """Raise InputError where recordings, of a dataset's split or of a log, are of several units, or
    not of the power-up whose own errors are known; but not where they were simulated from what is
    known."""
    if isinstance(said, str):
        unit_file.require_of_dataset(unit, said, split)
    else:
        unit_file.require_power_up(unit, {said.session or "(unnamed)"})


def of_unit(
    subject: Subject, records: Iterator[Measured], count: int, unit: CalibratedUnit
) -> tuple[Subject, Iterator[Measured], int]:
    """The same where a unit is known: the means of its errors taken off the recordings, and the
    sensor's model what is left."""
    law = subject.imu
    assert law is not None

    def off(record: Record) -> Record:
        return without_mean(record, law, unit.known)

    plain, count_of = subject.records, len(unit.sessions)
    which = f", and of power-up {shown(unit.now)}" if unit.now is not None else ""
    note = (
        f"what {unit.recordings} labelled recordings of {count_of} power-up"
        f"{'s' * (count_of != 1)} tell of this unit{which} is taken off, and estimators are told "
        "what is left"
    )
    own = replace(
        subject,
        notes=[*subject.notes, note],
        imu=unit.told(law),
        calibration=unit.checksum,
        records=lambda: [off(record) for record in plain()],
    )
    return own, (replace(each, record=off(each.record)) for each in records), count


def heading_of(record: Record, against: str | None) -> float:
    """The heading that a record's errors are relative to, rad: the truth or the reference; NaN
    where `against` is None.

    Raises InputError where the record has no such heading, or was taken at a pole."""
    require(
        bool(heading_exists(record.latitude)),
        "latitude",
        round(float(np.rad2deg(record.latitude)), 6),
        f"{record.name} was taken at a pole: Earth's rate has no horizontal part there and heading "
        "does not exist, so there is nothing to evaluate",
    )
    if against is None:
        return float("nan")
    heading = record.heading if against == "truth" else record.heading_reference
    if heading is None:
        raise InputError(f"{record.name}'s heading", "(unknown)", "", f"it has no {against}")
    return heading
