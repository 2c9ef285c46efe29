"""Compensation of a dataset's recordings for the errors that were drawn for their sensors."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lbgc.data.record import Record, require_on_plate
from lbgc.data.store import Dataset
from lbgc.errors import InputError, build
from lbgc.frames import euler_to_matrix, level, turned
from lbgc.sensor import errors, unit
from lbgc.sensor.datasheet import ImuConfig
from lbgc.sensor.errors import Drawn
from lbgc.sensor.imu import ImuModel
from lbgc.sensor.known import Known


def stored(dataset: Dataset, rows: np.ndarray, *lifetimes: str) -> tuple[Drawn, Drawn]:
    """The stored errors of gyros and accelerometers that have these lifetimes, as they were drawn
    for the recordings `rows`, one row each."""
    own = build(ImuConfig, dataset.configuration["imu"])
    gyro, accel = (
        {e.name: dataset.label(f"{name}_{e.name}")[rows] for e in triad.lasting(*lifetimes)}
        for name, triad in (("gyro", own.gyro.triad()), ("accel", own.accel.triad()))
    )
    return gyro, accel


def drawn_errors(dataset: Dataset, indices: np.ndarray) -> Iterator[tuple[Drawn, Drawn]]:
    """The errors that were drawn for the gyros and the accelerometers of the recordings at these
    indices, in ascending order, one recording after the other."""
    gyro, accel = stored(dataset, np.sort(indices), *errors.LIFETIMES)
    for i in range(len(indices)):
        yield errors.rows(gyro, i), errors.rows(accel, i)


def calibrated(
    record: Record, imu: ImuModel, gyro: Drawn, accel: Drawn, lifetimes: tuple[str, ...]
) -> Record:
    """The record as a sensor without the errors of these lifetimes (unit, session, run) would print
    it.

    imu : the sensor's error model; gyro, accel : the errors that were drawn for the recording.
    """
    n, dt, around = len(record.gyro), 1 / record.rate_hz, imu.warming
    warmth = around.rise(n, dt) if around.rise_k != 0 else None
    force = errors.undone(imu.accel.lasting(*lifetimes), accel, record.accel.T, around, warmth)
    field = _field(record, imu) if imu.feels_field else None
    felt = replace(around, force=force, field=field)
    rate = errors.undone(imu.gyro.lasting(*lifetimes), gyro, record.gyro.T, felt, warmth)
    return replace(record, gyro=rate.T, accel=force.T)


def without_mean(record: Record, imu: ImuModel, known: Known) -> Record:
    """The record with the means of what is known of its unit taken off what the sensor printed.
    imu : the sensor's model before anything was known."""
    gyro, accel = unit.drawn(imu, known, known.mean)
    return calibrated(record, imu, gyro, accel, ("unit", "session"))


def _field(record: Record, imu: ImuModel) -> np.ndarray:
    """The magnetic field in the body, T, (3, n), at the record's true heading and the level that
    its mean specific force tells. Raises InputError where the heading is not known."""
    require_on_plate(record)
    if record.heading is None:
        raise InputError(f"{record.name}'s heading", "(unknown)", "", "it has no truth")
    angle, axis = record.plate_angle, record.axis
    lean = level(turned(record.accel, angle, axis).mean(axis=0, keepdims=True))
    base = np.array(imu.field_ned) @ euler_to_matrix(*lean, record.heading)
    return turned(np.repeat(base, len(record.gyro), axis=0), -angle, axis).T
