"""Logs of a plate that turns: read as the recording they are, or refused with the reason."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import generate

from lbgc.answers import Answers, Own
from lbgc.data.logs import LogConfig, read
from lbgc.data.record import Record
from lbgc.data.windows import cut
from lbgc.earth import earth_rate_ned, normal_gravity
from lbgc.errors import InputError, build
from lbgc.estimators import CLASSICAL
from lbgc.estimators.estimate import Estimate
from lbgc.estimators.floor import floor
from lbgc.frames import AXES, DOWN, euler_to_matrix, rotation, rotation_z, wrap
from lbgc.learning import pretrained
from lbgc.learning.trained import Setting
from lbgc.protocol import REST, Move, ProtocolConfig
from lbgc.sensor.datasheet import GyroConfig, ImuConfig
from lbgc.units import DEG, HOUR

RATE, LATITUDE, HEADING = 20.0, 48.1, 70.0
COLUMNS = [f"{kind}_{axis}" for kind in ("w", "f") for axis in "xyz"]
ONE_MICRODEGREE = 1e-6
WINDOW_S = 240.0


def write(path, values, columns=(), names=(), start_s=0.0, rate=RATE):
    """A CSV of a time in s, rates in deg/s, forces in m/s2, and further columns."""
    t = start_s + np.arange(len(values)) / rate
    header = ",".join(["t", *COLUMNS, *names])
    table = np.column_stack([t, values, *columns])
    np.savetxt(path, table, fmt="%.17g", delimiter=",", header=header, comments="")
    return str(path)


def config(path, **changes) -> LogConfig:
    values = {"path": path, "latitude": LATITUDE, "gyro_unit": "deg/s", "accel_unit": "m/s2"}
    return LogConfig(**(values | changes))


def bench(angles_deg, rest_s=30.0, bias_deg_per_h=(0.5, -0.3, 0.2), lean_deg=(0.0, 0.0), seed=1,
          axis=DOWN):  # fmt: skip
    """A plate that rests at these angles, 30 s each, slews at 30 deg/s about an axis, and noise of
    0.02 deg/sqrt(h): rates in deg/s and forces, (n, 6), the plate's angle at the samples' ends,
    deg, and the rests' first and last samples."""
    rng = np.random.default_rng(seed)
    fine, at, moves = 10, 0.0, []
    spans = []
    for before, after in zip(angles_deg, [*angles_deg[1:], None], strict=True):
        spans.append((round(at * RATE), round((at + rest_s) * RATE)))
        at += rest_s
        if after is not None and after != before:
            moves.append(Move(at, (after - before) * DEG, 30 * DEG, 60 * DEG))
            at = np.ceil(moves[-1].end_s * RATE) / RATE + 1
    n = round(at * RATE)
    ends = (np.arange(n * fine) + 1) / fine / RATE
    angle = angles_deg[0] * DEG + sum(move.command(ends)[0] for move in moves)
    before = np.r_[angles_deg[0] * DEG, angle[:-1]]
    middle = (angle + before) / 2
    c_nb = rotation_z(HEADING * DEG) @ euler_to_matrix(*np.deg2rad(lean_deg), 0.0)
    c_nb = c_nb @ rotation(middle, axis)
    rate = earth_rate_ned(LATITUDE * DEG) @ c_nb
    rate[:, axis] += (angle - before) * fine * RATE
    force = np.array([0.0, 0.0, -normal_gravity(LATITUDE * DEG)]) @ c_nb
    rate, force = (v.reshape(n, fine, 3).mean(axis=1) for v in (rate, force))
    rate = rate / DEG + np.array(bias_deg_per_h) / HOUR
    rate += 0.02 / 60 * np.sqrt(RATE) * rng.standard_normal((n, 3))
    force += 1e-3 * rng.standard_normal((n, 3))
    return np.hstack([rate, force]), angle[fine - 1 :: fine] / DEG, spans


def one(log: LogConfig, imu=None) -> Record:
    (record,) = read(log, imu)
    return record


@pytest.fixture(scope="module", params=AXES[::-1])
def any_axis(request, tmp_path_factory):
    """A simulated two-position recording, about each axis, of the sensor that pretrained models are
    of: the record, the sensor's configuration, and the samples that the plate does not rest in."""
    path = tmp_path_factory.mktemp("turned") / "two.zarr"
    protocol = ProtocolConfig("two_position", "indexed", axis=request.param)
    data = generate(path, recordings=1, rate_hz=100.0, duration_s=WINDOW_S, protocol=protocol)
    (record,) = data.records(np.arange(1))
    stage = data.load("stage", slice(0, 1))[0] if hasattr(data, "load") else None
    moving = np.flatnonzero(np.abs(record.plate_angle - record.plate_angle[0]) > 0)
    assert stage is None or stage[moving[0]] != REST
    # To the hundred-thousandth of a degree, and whole seconds, which are the estimators' blocks.
    still = np.abs(record.plate_angle - record.plate_angle[-1]) < 1e-5 * DEG
    settled = int(np.ceil(np.flatnonzero(~still)[-1] / 100) * 100)
    return record, build(ImuConfig, data.configuration["imu"]), (int(moving[0]), settled)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """The same about down."""
    return any_axis.__wrapped__(SimpleNamespace(param=AXES[DOWN]), tmp_path_factory)


def estimators(sensor: ImuConfig, axis: int = DOWN):
    """The estimators that answer two positions, and the pretrained model of those about down."""
    names = ("two_position", "two_position_weighted", "gls", "ekf")
    every = {name: CLASSICAL[name] for name in names} | {"floor": floor}
    if axis != DOWN:
        return every
    for model in pretrained.every():
        if model.sensor == sensor and model.said["protocol"] == "two_position":
            every[model.name] = model.asked(Setting(sensor), False)
    assert len(every) == 6
    return every


def assert_alike(records: list[Record], sensor: ImuConfig) -> None:
    model = sensor.model(100.0)
    for name, estimate in estimators(sensor, records[0].axis).items():
        found = [estimate(cut(record, WINDOW_S), model).heading[0] for record in records]
        apart = np.abs(wrap(np.array(found[1:]) - found[0])) / DEG
        assert apart.max() < ONE_MICRODEGREE, name


def printed(record: Record) -> np.ndarray:
    return np.hstack([record.gyro / DEG, record.accel])


def test_an_angle_column_or_a_list_of_positions_answers_as_the_dataset(tmp_path, any_axis):
    record, sensor, (moves, settled) = any_axis
    where = {"latitude": record.latitude / DEG, "plate_axis": AXES[record.axis]}
    angle = record.plate_angle / DEG
    path = write(tmp_path / "log.csv", printed(record), [angle], ["plate_deg"], rate=100.0)
    column = one(config(path, plate_column="plate_deg", **where), sensor.model(100.0))
    np.testing.assert_allclose(column.plate_angle, record.plate_angle, atol=1e-12)
    listed = [[0, moves / 100, 0], [settled / 100, 240, 180]]
    positions = one(config(path, positions=listed, **where), sensor.model(100.0))
    assert_alike([record, column, positions], sensor)


def test_two_files_answer_as_the_dataset_without_its_slew(tmp_path, any_axis):
    """To a millionth of a degree; with the slew's samples, which are in no file, it is a
    thousandth, or one of a sigma."""
    record, sensor, (moves, settled) = any_axis
    values = printed(record)
    up = write(tmp_path / "up.csv", values[:moves], rate=100.0)
    down = write(tmp_path / "down.csv", values[settled:], rate=100.0)
    log = config([up, down], angles_deg=[0.0, 180.0], gap_s=(settled - moves) / 100,
                 latitude=record.latitude / DEG, plate_axis=AXES[record.axis])  # fmt: skip
    files = one(log, sensor.model(100.0))
    assert len(files.gyro) == len(record.gyro)
    gyro, accel = record.gyro.copy(), record.accel.copy()
    gyro[moves:settled] = accel[moves:settled] = np.nan
    assert_alike([replace(record, gyro=gyro, accel=accel), files], sensor)
    for name, estimate in estimators(sensor, record.axis).items():
        whole, own = (estimate(cut(r, WINDOW_S), sensor.model(100.0)) for r in (record, files))
        assert abs(whole.heading[0] - own.heading[0]) < 0.005 * max(DEG, own.sigma[0]), name
        assert own.sigma[0] == pytest.approx(whole.sigma[0], rel=0.01), name


def test_time_that_was_not_recorded_counts_as_time(tmp_path, simulated):
    """A longer gap lets a bias walk on: sigma grows, by the filter's law as by the covariance's."""
    record, sensor, (moves, settled) = simulated
    walks = replace(sensor, gyro=replace(sensor.gyro, rrw_deg_per_h_per_sqrt_h=20.0))
    values = printed(record)
    paths = [
        write(tmp_path / "up.csv", values[:moves], rate=100.0),
        write(tmp_path / "down.csv", values[settled:], rate=100.0),
    ]
    found = {}
    for gap in (10.0, 100.0):
        log = config(paths, angles_deg=[0.0, 180.0], gap_s=gap, latitude=record.latitude / DEG)
        own = one(log, walks.model(100.0))
        windows = cut(own, own.duration_s)
        for name in ("gls", "ekf"):
            estimate = CLASSICAL[name](windows, walks.model(100.0))
            found[name, gap] = float(estimate.sigma[0])
    assert found["gls", 100.0] > 1.5 * found["gls", 10.0]
    for gap in (10.0, 100.0):
        assert found["ekf", gap] == pytest.approx(found["gls", gap], rel=0.03)


def test_what_needs_every_sample_refuses_time_without_a_record(simulated):
    record, sensor, (moves, settled) = simulated
    gyro, accel = record.gyro.copy(), record.accel.copy()
    gyro[moves:settled] = accel[moves:settled] = np.nan
    windows = cut(replace(record, gyro=gyro, accel=accel), WINDOW_S)
    assert windows.unrecorded.sum() == settled - moves
    for name in ("oba", "oba_bias"):
        with pytest.raises(InputError, match="nothing was recorded"):
            CLASSICAL[name](windows, sensor.model(100.0))
    still = replace(windows, plate_angle=0 * windows.plate_angle)
    with pytest.raises(InputError, match="not recorded"):
        CLASSICAL["mean"](still, sensor.model(100.0))


def test_windows_in_which_nothing_was_recorded_are_left_out(tmp_path):
    paths = in_files(tmp_path, [0.0, 180.0])
    record = one(config(paths, angles_deg=[0.0, 180.0], gap_s=60.0))
    windows = cut(record, 10.0)
    np.testing.assert_array_equal(windows.start_s, [0, 10, 20, 90, 100, 110])
    assert not windows.unrecorded.any()
    short = write(tmp_path / "short.csv", np.ones((40, 6)))
    with pytest.raises(InputError, match="takes 4 s or more"):
        one(config([paths[0], short], angles_deg=[0.0, 180.0]))


def test_a_single_channel_that_is_no_number_is_not_a_gap(simulated):
    record, sensor, _ = simulated
    gyro = record.gyro.copy()
    gyro[50] = np.nan
    windows = cut(replace(record, gyro=gyro), WINDOW_S)
    assert not windows.unrecorded.any()
    model = list(estimators(sensor).values())[-1]
    with pytest.raises(InputError, match="finite"):
        model(windows, None)


@pytest.mark.parametrize(
    ("name", "factor", "changes"),
    [
        ("plate_deg", 1.0, {}),
        ("plate [rad]", DEG, {}),
        ("turned", DEG, {"plate_unit": "rad"}),
        ("counts", -100.0, {"plate_scale": -0.01}),
        (9, 1.0, {}),
    ],
)
def test_units_and_counts_of_an_angle_column(tmp_path, name, factor, changes):
    values, angle, _ = bench([0.0, 90.0, 180.0])
    title = "x" if name == 9 else name
    at = name if name != 9 else 8  # after the time and six channels
    path = write(tmp_path / "log.csv", values, [angle * factor], [title])
    record = one(config(path, plate_column=at, **changes))
    np.testing.assert_allclose(record.plate_angle, angle * DEG, atol=1e-9)


def test_an_angle_that_starts_again_at_a_full_turn_is_carried_on(tmp_path):
    values, angle, _ = bench([0.0, 180.0, 360.0, 540.0])
    path = write(tmp_path / "log.csv", values, [angle % 360], ["plate_deg"])
    record = one(config(path, plate_column="plate_deg"))
    np.testing.assert_allclose(record.plate_angle, angle * DEG, atol=1e-9)


def test_an_encoder_that_flickers_rests_all_the_same(tmp_path):
    values, angle, _ = bench([0.0, 180.0])
    noisy = angle + 0.005 * np.random.default_rng(2).standard_normal(len(angle))
    path = write(tmp_path / "log.csv", values, [noisy], ["plate_deg"])
    record = one(config(path, plate_column="plate_deg"))
    assert any("flickers at rest, by 0.005" in note for note in record.notes)
    found = CLASSICAL["two_position"](cut(record, record.duration_s))
    assert abs(wrap(found.heading[0] - HEADING * DEG)) < 4 * found.sigma[0] < 4 * DEG


@pytest.mark.parametrize(
    ("column", "changes", "says"),
    [
        (lambda a: a, {"plate_unit": "rad"}, "log.plate_unit=deg"),
        (lambda a: a * DEG, {"plate_unit": "deg"}, "log.plate_unit=rad"),
        (lambda a: -a, {}, "log.plate_scale=-1"),
        (lambda a: a / 2, {}, "another one's"),
        (lambda a: np.roll(a, 300), {}, "the turn itself is not in the log"),
    ],
)
def test_an_angle_that_the_gyros_did_not_feel_is_refused(tmp_path, column, changes, says):
    values, angle, _ = bench([0.0, 90.0, 180.0])
    path = write(tmp_path / "log.csv", values, [column(angle)], ["turned"])
    with pytest.raises(InputError) as refused:
        one(config(path, plate_column="turned", **changes))
    assert says in str(refused.value)
    assert "log.plate_column" in str(refused.value)


def test_a_late_column_is_said(tmp_path):
    values, angle, _ = bench([0.0, 90.0, 180.0])
    path = write(tmp_path / "log.csv", values, [np.r_[angle[:1].repeat(6), angle[:-6]]], ["p"])
    record = one(config(path, plate_column="p"))
    assert any("is 0.3 s late against its gyros" in note for note in record.notes)


def test_a_list_is_between_its_positions_as_the_gyros_felt(tmp_path):
    values, angle, spans = bench([0.0, 90.0, 180.0])
    path = write(tmp_path / "log.csv", values)
    positions = [[a / RATE, b / RATE, d] for (a, b), d in zip(spans, (0, 90, 180), strict=True)]
    record = one(config(path, positions=positions))
    np.testing.assert_allclose(record.plate_angle / DEG, angle, atol=0.02)
    part = one(config(path, positions=positions[1:]))
    assert any(f"{spans[1][0] / RATE:.4g} s before the first" in note for note in part.notes)
    assert len(part.gyro) == len(angle) - spans[1][0]


@pytest.mark.parametrize(
    ("degrees", "says"),
    [
        ((0, -90, -180), "the plate turned the other way, or the down axis points up; negate"),
        ((0, 90, 0), "the gyros turned by 90 deg"),
        ((0, 1.5708, 3.1416), "another one's, its times are wrong"),
    ],
)
def test_a_list_that_the_gyros_contradict_is_refused(tmp_path, degrees, says):
    values, _, spans = bench([0.0, 90.0, 180.0])
    path = write(tmp_path / "log.csv", values)
    positions = [[a / RATE, b / RATE, d] for (a, b), d in zip(spans, degrees, strict=True)]
    with pytest.raises(InputError) as refused:
        one(config(path, positions=positions))
    assert says in str(refused.value)


def test_a_turn_that_is_accepted_against_the_gyros_is_left_out(tmp_path):
    """Gyros at their rail in a slew by hand: the positions are right, and all that is used."""
    values, _, spans = bench([0.0, 180.0])
    values[:, 2] = np.clip(values[:, 2], -10.0, 10.0)
    path = write(tmp_path / "log.csv", values)
    positions = [[a / RATE, b / RATE, d] for (a, b), d in zip(spans, (0, 180), strict=True)]
    with pytest.raises(InputError, match="at their rail"):
        one(config(path, positions=positions))
    record = one(config(path, positions=positions, accept=["turned"]))
    assert np.isnan(record.gyro[spans[0][1] : spans[1][0]]).all()
    found = CLASSICAL["two_position"](cut(record, record.duration_s))
    assert abs(wrap(found.heading[0] - HEADING * DEG)) < 4 * found.sigma[0] < 4 * DEG


def test_times_of_positions_are_within_the_log(tmp_path):
    values, _, _ = bench([0.0, 180.0])
    path = write(tmp_path / "log.csv", values)
    for changes in ({"from_s": 1.0}, {"to_s": 50.0}):
        with pytest.raises(InputError, match="from its first sample to its last"):
            one(config(path, positions=[[0, 30, 0], [40, 60, 180]], **changes))
    with pytest.raises(InputError, match=r"is not within the 67"):
        one(config(path, positions=[[0, 30, 0], [40, 9000, 180]]))


def in_files(tmp_path, angles, **changes):
    """A file for each position."""
    values, _, spans = bench(angles, **changes)
    return [
        write(tmp_path / f"{k}.csv", values[a:b], start_s=100.0) for k, (a, b) in enumerate(spans)
    ]


def test_files_of_four_positions(tmp_path):
    paths = in_files(tmp_path, [0.0, 90.0, 180.0, 270.0])
    record = one(config(paths, angles_deg=[0.0, 90.0, 180.0, 270.0], gap_s=5.0))
    assert record.name == "0 and 3 more"
    assert len(record.gyro) == (4 * 30 + 3 * 5) * RATE
    assert not any(note.startswith("mirrored") for note in record.notes)  # Earth's rate tells
    found = CLASSICAL["cosine_fit"](cut(record, record.duration_s))
    assert abs(wrap(found.heading[0] - HEADING * DEG)) < 4 * found.sigma[0] < 4 * DEG


@pytest.mark.parametrize(
    ("factor", "says"), [(-1.0, "the other way"), (DEG, "as if these angles were radians")]
)
def test_angles_of_files_are_told_by_earths_rate(tmp_path, factor, says):
    paths = in_files(tmp_path, [0.0, 90.0, 180.0, 270.0])
    angles = [factor * a for a in (0.0, 90.0, 180.0, 270.0)]
    with pytest.raises(InputError) as refused:
        one(config(paths, angles_deg=angles, gap_s=5.0))
    assert says in str(refused.value)
    assert "log.angles_deg" in str(refused.value)


def test_angles_of_files_are_told_by_a_lean(tmp_path):
    """Where Earth's rate is too small to tell: gravity turns, too."""
    angles = [0.0, 90.0, 180.0, 270.0]
    values, _, spans = bench(angles, lean_deg=(1.0, 0.0))
    values[:, :3] += 0.05 * np.random.default_rng(6).standard_normal((len(values), 3))
    paths = [write(tmp_path / f"{k}.csv", values[a:b]) for k, (a, b) in enumerate(spans)]
    with pytest.raises(InputError, match="the lean turns the other way"):
        one(config(paths, angles_deg=[-a for a in angles], gap_s=5.0))


def test_half_turns_do_not_tell_their_sense_and_need_not(tmp_path):
    paths = in_files(tmp_path, [0.0, 180.0])
    found = []
    for angle in (180.0, -180.0):
        record = one(config(paths, angles_deg=[0.0, angle]))
        assert any(note.startswith("mirrored") for note in record.notes)
        found.append(CLASSICAL["two_position"](cut(record, 60.0)).heading[0])
    assert abs(wrap(found[0] - found[1])) < 1e-9


def test_the_time_between_files(tmp_path):
    """By stamps that run on; else it is asked for where the sensor's drift matters."""
    values, _, ((_, a), (b, _)) = bench([0.0, 180.0])
    up = write(tmp_path / "up.csv", values[:a])
    for start, known in ((b / RATE, True), (0.0, False)):
        down = write(tmp_path / "down.csv", values[b:], start_s=start)
        log = config([up, down], angles_deg=[0.0, 180.0])
        if known:
            record = one(log, ImuConfig().model(RATE))
            assert len(record.gyro) == len(values)
            assert any("by their time stamps" in note for note in record.notes)
        else:
            with pytest.raises(InputError, match=r"log.gap_s = None s: must be given"):
                one(log, ImuConfig().model(RATE))
            assert any("is not known" in note for note in one(log).notes)


def test_each_position_is_checked(tmp_path):
    values, angle, spans = bench([0.0, 90.0, 180.0])
    stuck = values.copy()
    stuck[spans[1][0] + 200 : spans[1][1], 0] = stuck[spans[1][0] + 200, 0]
    path = write(tmp_path / "log.csv", stuck, [angle], ["p"])
    with pytest.raises(InputError, match=r"at 90 deg: gyro x .*check stuck"):
        one(config(path, plate_column="p"))
    moved = values.copy()
    moved[spans[2][0] + 100 : spans[2][0] + 200, 1] += 2.0
    path = write(tmp_path / "log.csv", moved, [angle], ["p"])
    with pytest.raises(InputError, match=r"at 180 deg: turned .*check moved"):
        one(config(path, plate_column="p"))


def test_a_bias_is_no_fault_and_is_told(tmp_path):
    """At rest such a bias hides north; here it is what does not turn with the plate."""
    bias = (500.0, -300.0, 200.0)
    values, angle, spans = bench([0.0, 90.0, 180.0, 270.0], bias_deg_per_h=bias)
    path = write(tmp_path / "log.csv", values, [angle], ["p"])
    record = one(config(path, plate_column="p"))
    assert any("is +500, -300 deg/h" in note for note in record.notes)
    found = CLASSICAL["cosine_fit"](cut(record, record.duration_s))
    assert abs(wrap(found.heading[0] - HEADING * DEG)) < 4 * found.sigma[0] < 4 * DEG
    still = write(tmp_path / "still.csv", values[: spans[0][1]])
    with pytest.raises(InputError, match="check bias"):
        one(config(still))


def test_a_vertical_bias_is_no_flipped_gyro_where_a_slew_was_felt(tmp_path):
    """Twice Earth's vertical rate, the other way: at rest that asks for other frames."""
    bias = (0.5, -0.3, 2 * 15.041 * np.sin(LATITUDE * DEG))
    values, angle, spans = bench([0.0, 90.0, 180.0, 270.0], bias_deg_per_h=bias)
    path = write(tmp_path / "log.csv", values, [angle], ["p"])
    record = one(config(path, plate_column="p"))
    assert not any(note.startswith(("frames", "mirrored")) for note in record.notes)
    paths = [write(tmp_path / f"{k}.csv", values[a:b]) for k, (a, b) in enumerate(spans)]
    files = one(config(paths, angles_deg=[0.0, 90.0, 180.0, 270.0], gap_s=5.0))
    assert any(note.startswith("frames") for note in files.notes)
    with pytest.raises(InputError, match="check frames"):
        one(config([paths[0], paths[2]], angles_deg=[0.0, 180.0], gap_s=5.0))


def test_units_and_frames_are_told_by_what_turns(tmp_path):
    values, angle, _ = bench([0.0, 90.0, 180.0, 270.0])
    path = write(tmp_path / "log.csv", values, [angle], ["p"])
    with pytest.raises(InputError, match="check force"):
        one(config(path, plate_column="p", accel_unit="mg"))
    scaled = values.copy()
    scaled[:, :2] *= 3.0
    path = write(tmp_path / "scaled.csv", scaled, [angle], ["p"])
    with pytest.raises(InputError, match=r"turns with the plate is .*Earth's horizontal rate is"):
        one(config(path, plate_column="p"))
    mirrored = values * [1, -1, 1, 1, -1, 1]
    path = write(tmp_path / "mirrored.csv", mirrored, [angle], ["p"])
    with pytest.raises(InputError, match="or y points the other way"):
        one(config(path, plate_column="p"))


def test_files_in_another_gyro_unit(tmp_path):
    """No slew is in them that would tell: Earth's rate does."""
    paths = in_files(tmp_path, [0.0, 90.0, 180.0, 270.0])
    angles = [0.0, 90.0, 180.0, 270.0]
    with pytest.raises(InputError, match="in deg/s it would make sense"):
        one(config(paths, angles_deg=angles, gap_s=5.0, gyro_unit="rad/s"))


def test_a_sensor_that_was_moved_between_positions_is_refused(tmp_path):
    angles = [0.0, 90.0, 180.0, 270.0]
    paths = in_files(tmp_path, angles)
    other, _, spans = bench(angles, lean_deg=(4.0, 0.0))
    write(paths[3], other[slice(*spans[3])])
    with pytest.raises(InputError, match="from the lean of one base"):
        one(config(paths, angles_deg=angles, gap_s=5.0))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("stated", range(3))
def test_an_axis_is_held_against_what_was_felt(tmp_path, axis, stated):
    """By the slew where a log has it, by gravity in files of either position, and where that turns
    alike by Earth's rate."""
    values, angle, spans = bench([0.0, 180.0], axis=axis)
    own = {"plate_axis": AXES[stated]}
    column = config(write(tmp_path / "log.csv", values, [angle], ["p"]), plate_column="p", **own)
    files = [write(tmp_path / f"{k}.csv", values[a:b]) for k, (a, b) in enumerate(spans)]
    positions = [[a / RATE, b / RATE, d] for (a, b), d in zip(spans, (0, 180), strict=True)]
    listed = config(column.path, positions=positions, **own)
    apart = config(files, angles_deg=[0.0, 180.0], gap_s=5.0, **own)
    if axis == stated:
        assert [one(log).axis for log in (column, listed, apart)] == [axis] * 3
        return
    for log in (column, listed, apart):
        with pytest.raises(InputError, match=f"log.plate_axis=.*{AXES[axis]}"):
            one(log)


@pytest.mark.parametrize("axis", [0, 1])
def test_four_positions_about_a_level_axis(tmp_path, axis):
    """Angles of the wrong sign, unit or size are told by gravity; a bias is told beside."""
    angles = [0.0, 90.0, 180.0, 270.0]
    bias = (50.0, -30.0, 20.0)
    values, _, spans = bench(angles, axis=axis, lean_deg=(1.0, -2.0), bias_deg_per_h=bias)
    paths = [write(tmp_path / f"{k}.csv", values[a:b]) for k, (a, b) in enumerate(spans)]
    own = {"gap_s": 5.0, "plate_axis": AXES[axis]}
    record = one(config(paths, angles_deg=angles, **own))
    i, j = sorted(set(range(3)) - {axis}, key=lambda k: (k - axis) % 3)
    (told,) = (re.search(r"is (\S+), (\S+) deg/h \(1 sigma", n) for n in record.notes[-1:])
    assert told is not None
    np.testing.assert_allclose([float(own) for own in told.groups()], [bias[i], bias[j]], atol=1.2)
    imu = ImuConfig("own", gyro=GyroConfig(arw_deg_per_sqrt_h=0.02, bias_run_deg_per_h=40.0))
    windows = cut(record, record.duration_s)
    found = CLASSICAL["cosine_fit"](windows, imu.model(RATE))
    assert abs(wrap(found.heading[0] - HEADING * DEG)) < 4 * found.sigma[0]
    for wrong, says in (
        ([-a for a in angles], "the rates turn the other way"),
        ([a * DEG for a in angles], "as if these angles were radians"),
        ([0.0, 90.0, 180.0, 240.0], "the vertical turns"),
        ([0.0, 90.0, 180.0, 262.0], "was moved between them"),
    ):
        with pytest.raises(InputError, match=says):
            one(config(paths, angles_deg=wrong, **own))
    with pytest.raises(InputError, match="in deg/s it would make sense"):
        one(config(paths, angles_deg=angles, gyro_unit="rad/s", **own))


def test_a_position_about_a_level_axis_that_is_no_half_turn_is_refused(tmp_path):
    """By gravity, up to what accelerometers' biases may do, which is said."""
    values, _, spans = bench([0.0, 172.0], axis=0)
    paths = [write(tmp_path / f"{k}.csv", values[a:b]) for k, (a, b) in enumerate(spans)]
    with pytest.raises(InputError, match="the vertical = 4: deg from the lean of one base"):
        one(config(paths, angles_deg=[0.0, 180.0], plate_axis="forward"))
    record = one(config(paths, angles_deg=[0.0, 174.0], plate_axis="forward"))
    assert any("stays within 2 deg, the accelerometers' bias" in note for note in record.notes)


def test_a_plate_turned_back_about_a_level_axis_is_refused(tmp_path):
    values, angle, _ = bench([0.0, 90.0], axis=1)
    path = write(tmp_path / "log.csv", values, [-angle], ["p"])
    with pytest.raises(InputError, match=r"or the right axis points back; log.plate_scale=-1"):
        one(config(path, plate_column="p", plate_axis="right"))


def test_a_turn_about_another_axis_is_refused(tmp_path):
    """Up and down: over a horizontal axis, which is then asked for."""
    values, _, spans = bench([0.0, 360.0])
    up = write(tmp_path / "up.csv", values[slice(*spans[0])])
    down = write(tmp_path / "down.csv", values[slice(*spans[1])] * [1, -1, -1, 1, -1, -1])
    with pytest.raises(InputError, match=r"than its down one; log.plate_axis=forward or right"):
        one(config([up, down], angles_deg=[0.0, 180.0]))


def test_a_column_that_a_reader_does_not_have_is_refused(tmp_path):
    path = tmp_path / "log.imu"
    rows = ["0 0 0 0 0 0", "48 0 0 0 50 9.8", "1 1 1 1 1 1", *["0 0 0 0 0 1"] * 100]
    path.write_text("\n".join(rows))
    with pytest.raises(InputError, match=r"log.reader=psins has no further columns"):
        one(LogConfig(path=str(path), reader="psins", plate_column="p"))


def test_a_column_that_is_not_there_is_named(tmp_path):
    values, angle, _ = bench([0.0, 180.0])
    path = write(tmp_path / "log.csv", values, [angle], ["p"])
    with pytest.raises(InputError, match=r"log.plate_column = q: is no column .* f_z, p$"):
        one(config(path, plate_column="q"))


def test_a_lean_is_no_fault(tmp_path):
    values, angle, _ = bench([0.0, 90.0, 180.0, 270.0], lean_deg=(3.0, -2.0))
    path = write(tmp_path / "log.csv", values, [angle], ["p"])
    record = one(config(path, plate_column="p"))
    found = CLASSICAL["cosine_fit"](cut(record, record.duration_s))
    assert abs(wrap(found.heading[0] - HEADING * DEG)) < 1 * DEG


def test_a_carousel_is_read(tmp_path):
    t = np.arange(60 * RATE) / RATE
    angle = 6.0 * (t + 1 / RATE)
    c_nb = rotation_z((HEADING + angle - 3.0 / RATE) * DEG)
    rate = earth_rate_ned(LATITUDE * DEG) @ c_nb / DEG + [0, 0, 6.0]
    rng = np.random.default_rng(4)
    rate += 1e-4 * rng.standard_normal(rate.shape)
    force = np.tile([0.0, 0.0, -normal_gravity(LATITUDE * DEG)], (len(t), 1))
    force += 1e-3 * rng.standard_normal(rate.shape)
    values = np.hstack([rate, force])
    path = write(tmp_path / "log.csv", values, [angle], ["p"])
    record = one(config(path, plate_column="p"))
    found = CLASSICAL["carousel"](cut(record, 60.0))
    assert abs(wrap(found.heading[0] - HEADING * DEG)) < 4 * found.sigma[0] < 4 * DEG
    with pytest.raises(InputError, match=r"log.plate_scale=1"):
        one(config(path, plate_column="p", plate_scale=-1.0))


def test_a_model_answers_the_course_that_it_was_trained_for(simulated):
    record, sensor, _ = simulated
    (carousel,) = (m for m in pretrained.every() if m.name.startswith("sdc500-carousel"))
    with pytest.raises(InputError, match="that turns and rests is none of its"):
        carousel(cut(record, WINDOW_S))
    two = list(estimators(sensor).values())[-1]
    quarter = replace(record, plate_angle=record.plate_angle / 2)
    with pytest.raises(InputError, match="from any of its positions, which are 180 degrees apart"):
        two(cut(quarter, WINDOW_S))


def test_a_reference_in_a_column(tmp_path):
    values, angle, _ = bench([0.0, 180.0])
    own = (HEADING + angle + 0.2 * np.random.default_rng(3).standard_normal(len(angle))) % 360
    path = write(tmp_path / "log.csv", values, [angle, own], ["p", "north"])
    log = config(path, plate_column="p", heading_column="north", heading_sigma_deg=0.5,
                 unit="A7", session="monday")  # fmt: skip
    record = one(log)
    assert record.heading_reference / DEG == pytest.approx(HEADING, abs=4 * 0.2 / len(own) ** 0.5)
    assert record.reference_sigma == pytest.approx(0.5 * DEG)
    assert (record.unit, record.session) == ("A7", "monday")
    with pytest.raises(InputError, match="from one heading of log that turns with the plate"):
        one(replace(log, plate_column=None, positions=None, heading_column="p", accept=["moved"]))


def test_a_reference_s_sigma_is_part_of_the_errors():
    """Errors of 5 deg by an estimate of 3 and a reference of 4: true sigmas, NSE 1."""
    n = 4000
    rng = np.random.default_rng(5)
    errors = rng.normal(0.0, 3.0, n) - rng.normal(0.0, 4.0, n)
    estimate = Estimate(errors * DEG, np.full(n, 3.0 * DEG))
    own = Own(np.zeros(n), np.arange(n), np.zeros(n), np.zeros(n), np.full(n, 4.0 * DEG))
    answers = Answers()
    answers.add(estimate, own, 0.0)
    nse = answers.summary().mean_normalised_squared_error
    assert nse == pytest.approx(1.0, abs=4 * np.sqrt(2 / n))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"path": ["a.csv", "b.csv"], "angles_deg": [0.0]}, "one for each file"),
        ({"path": ["a.csv", "a.csv"], "angles_deg": [0.0, 180.0]}, "twice"),
        ({"plate_column": "p", "positions": [[0.0, 1.0, 0.0]]}, "give one"),
        ({"positions": [[0.0, 10.0, 0.0], [5.0, 20.0, 180.0]]}, "without overlap"),
        ({"positions": [[0.0, 10.0]]}, "must be"),
        ({"positions": []}, "must name one"),
        ({"plate_unit": "turns"}, "deg"),
        ({"plate_scale": 0.0}, "zero"),
        ({"gap_s": 5.0}, "several files"),
        ({"path": ["a", "b"], "angles_deg": [0.0, 90.0], "gap_s": 1e6}, "86400"),
        ({"heading_sigma_deg": -1.0}, "greater than zero"),
        ({"plate_axis": "forward"}, "needs the plate's angles"),
        ({"plate_axis": "up", "plate_column": "p"}, "forward"),
        ({"unit": "two\nlines"}, "name"),
        ({"plate_column": 0}, "counted from one"),
    ],
)
def test_what_cannot_be_meant_is_refused(changes, says):
    with pytest.raises(InputError, match=says):
        config(**({"path": "log.csv"} | changes))
