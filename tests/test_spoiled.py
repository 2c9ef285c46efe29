"""What happened to samples on their way into a file: refused with the place, and never invented."""

from dataclasses import replace

import cases
import numpy as np
import pytest
from helpers import composed, default_config, needs_recording
from test_checks import case, held
from test_logs import config, write

from lbgc.data import logs
from lbgc.data.checks.pasted import Pasted, pasted
from lbgc.earth import earth_rate_ned
from lbgc.errors import InputError
from lbgc.evaluate import EvaluateConfig
from lbgc.frames import euler_to_matrix

GYRO_COUNT, ACCEL_COUNT = np.deg2rad(0.001), 2e-3


def resting(counted: bool, seed=0, seconds=120) -> np.ndarray:
    """Six channels at 48.1 degrees, 100 Hz, (n, 6), SI; counted ones at 0.06 of sigma."""
    _, gyro, accel = cases.static(100, seconds, arw=0.1, accel_ug=300, seed=seed)
    if counted:
        gyro = np.rint(gyro / GYRO_COUNT) * GYRO_COUNT
        accel = np.rint(accel / ACCEL_COUNT) * ACCEL_COUNT
    return np.hstack([gyro, accel])


def said(values: np.ndarray, **changes) -> tuple[str, ...]:
    return held(values[:, :3], values[:, 3:], bias_limit_deg_per_h=100.0, **changes)


@pytest.mark.parametrize("counted", [False, True])
def test_nothing_is_found_in_what_is_right(counted):
    for seed in range(5):
        (note,) = said(resting(counted, seed))
        assert note.startswith("mirrored: ")


@pytest.mark.parametrize("counted", [False, True])
@pytest.mark.parametrize("share", [0.01, 0.05, 0.5])
def test_a_rail_is_named_with_its_share(counted, share):
    for channel, name in ((0, "gyro x"), (5, "accelerometer z")):
        values = resting(counted)
        rail = np.quantile(values[:, channel], 1 - share, method="higher")
        values[:, channel] = np.minimum(values[:, channel], rail)
        held_there = 100 * float(np.mean(values[:, channel] == rail))
        with pytest.raises(InputError, match=f"% of {name} at its largest value") as caught:
            said(values)
        told = float(str(caught.value).split("stand ")[1].split("%")[0])
        assert told == pytest.approx(held_there, rel=0.01)
        assert any("(accepted)" in note for note in said(values, accept=["rail"]))


def test_the_case_of_a_saturated_log(tmp_path):
    cases.saturated(tmp_path)
    with pytest.raises(InputError, match=r"5\d.*% of accelerometer z at its smallest value, -9.80"):
        list(logs.read(case(tmp_path / "log.csv")))


def test_a_rail_is_named_by_the_files_own_axis():
    values = resting(False)[:, [1, 0, 2, 4, 3, 5]] * [1, 1, -1, 1, 1, -1]
    rail = np.quantile(values[:, 0], 0.05)
    values[:, 0] = np.maximum(values[:, 0], rail)
    with pytest.raises(InputError, match="gyro x at its smallest value"):
        said(values, axes=["y", "x", "-z"])


@pytest.mark.parametrize("counted", [False, True])
def test_a_channel_that_stays_is_named(counted):
    values = resting(counted)
    values[3000:4000, 4] = values[3000, 4]
    with pytest.raises(InputError, match="accelerometer y from 30 to 40 s"):
        said(values)
    values = resting(counted)
    values[:, 1] = values[0, 1]
    with pytest.raises(InputError, match="gyro y never changes while others do"):
        said(values)


def test_coarse_counts_that_never_change_are_no_dead_channel():
    """30 mg beside a noise of 3: x and y print one value, z two. The table says so."""
    values = resting(False)
    values[:, 3:] = np.rint(values[:, 3:] / 0.3) * 0.3
    assert [len(np.unique(v)) for v in values[:, 3:].T] == [1, 1, 2]
    notes = said(values)
    assert any(n.startswith("counts: accelerometer x, y, z in counts of 0.3 m/s2") for n in notes)
    assert not any(note.startswith("stuck") for note in notes)


def test_spikes_are_named_and_refused_where_they_matter():
    values = resting(False)
    values[5000, 0] += 15 * values[:, 0].std()
    assert any("row 5000" in n and "too few to matter" in n for n in said(values))
    values[1000:9000:400, 0] += 30 * values[:, 0].std()
    with pytest.raises(InputError, match=r"20 samples of gyro x.*check outliers"):
        said(values)


@pytest.mark.parametrize("nothing", [-999.0, 0.0, 32767.0])
def test_values_that_stand_for_none_are_named(nothing):
    values = resting(False)
    values[100:110, 5] = nothing
    values[7000, 5] = nothing
    with pytest.raises(InputError, match=r"11 samples of accelerometer z.*11 are exactly this"):
        said(values)


def test_what_stands_twice_is_found_to_the_row():
    values = resting(True)
    assert pasted(values) == []
    values[9000:9700] = values[1234:1934]
    assert pasted(values) == [Pasted(1234, 9000, 700)]
    with pytest.raises(InputError, match=r"7 s from 12.34 s stand again from 90 s"):
        said(values)
    with pytest.raises(InputError, match="check pasted"):
        said(values, north=False)


def test_rows_printed_twice_in_a_row_are_not_pasted():
    assert pasted(np.repeat(resting(True), 3, axis=0)) == []


def test_a_triad_that_is_slower_than_the_other_is_noted():
    values = resting(False)
    values[1::2, 3:] = values[::2, 3:]
    assert any(
        n.startswith("held: the accelerometers print each value 2 times") for n in said(values)
    )


def test_what_many_recordings_say_is_said_once(tmp_path):
    for heading, seed in ((10, 1), (100, 2), (200, 3)):
        _, gyro, accel = cases.static(100, 20, 32.76, heading, seed=seed)
        names = [f"{k}_{a}" for k in "wf" for a in "xyz"]
        columns = np.hstack([np.rad2deg(gyro), accel]).T
        write(tmp_path / f"x_{heading}.csv", dict(zip(names, columns, strict=True)))
    log = config(tmp_path, reader="recordings", time_column=None, rate_hz=100.0, heading_deg=None)
    records = list(logs.read(log))
    assert len({record.notes for record in records}) == 1
    assert sum(note.startswith("mirrored") for note in records[0].notes) == 1


@needs_recording("lasergyro.imu")
def test_real_logs_are_read_as_before():
    """Coarse counts of a real sensor; they are noted, once."""
    log = composed(EvaluateConfig, "evaluate", "log=lasergyro").log
    (record,) = logs.read(log)
    assert [note.split(":")[0] for note in record.notes] == ["counts"]
    (record,) = logs.read(log, default_config("imu=lasergyro").imu.model(100.0))
    assert record.notes == ()  # that one carries the rest over


def test_counts_that_carry_their_rest_over_nearly_repeat_and_are_not_pasted():
    """A laser gyro at rest prints a few sums over and over; 60 s of it pasted are found."""
    imu = default_config("imu=lasergyro").imu.model(10.0)
    rng = np.random.default_rng(3)
    lean = euler_to_matrix(0.01, 0.02, 0.3)
    both = []
    truths = (earth_rate_ned(0.5), [0.0, 0.0, -9.79])
    for triad, truth in zip((imu.gyro, imu.accel), truths, strict=True):
        errors = triad.draw_run(rng, triad.draw_unit(rng) | triad.draw_session(rng))
        both.append(triad.measure(rng, (lean.T @ truth)[:, None], errors, 18_000, 0.1)[0].T)
    values = np.hstack(both).astype(float)
    assert pasted(values) == []
    values[9000:9600] = values[100:700]
    assert (pasted(values)[0].first, pasted(values)[0].again) == (100, 9000)


def test_a_triad_that_never_changes_is_noted():
    values = resting(False)
    values[:, :3] = values[:, :3].mean(axis=0)
    assert any(n.startswith("counts: gyro x, y, z, which never change") for n in said(values))


@pytest.mark.parametrize("mirrored", [False, True])
def test_recordings_at_several_headings_tell_a_mirrored_frame(tmp_path, mirrored):
    turn = np.array([1.0, -1.0 if mirrored else 1.0, 1.0])
    for heading in range(0, 360, 40):
        _, gyro, accel = cases.static(100, 20, 32.76, heading, arw=0.02, seed=heading)
        names = [f"{k}_{a}" for k in "wf" for a in "xyz"]
        columns = np.hstack([np.rad2deg(gyro * turn), accel * turn]).T
        write(tmp_path / f"x_{heading}.csv", dict(zip(names, columns, strict=True)))
    log = config(tmp_path, reader="recordings", time_column=None, rate_hz=100.0, heading_deg=None)
    if not mirrored:
        assert not any(n.startswith("mirrored") for r in logs.read(log) for n in r.notes)
        return
    with pytest.raises(InputError, match=r"fall where their references rise.*axes=\[x,-y,z\]"):
        list(logs.read(log))
    records = list(logs.read(log, north=False))
    assert sum(n.startswith("mirrored") for n in records[0].notes) == 1
    own = replace(log, axes=["x", "-y", "z"], accel_axes=["x", "-y", "z"])
    assert not any(n.startswith("mirrored") for r in logs.read(own) for n in r.notes)
