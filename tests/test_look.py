"""The log doctor: right, or asking; never wrong in silence."""

from collections import Counter
from dataclasses import fields

import cases
import numpy as np
import pytest
import scipy.io
import yaml
from any_logs import FRAMES, judged, make
from helpers import ROOT

from lbgc.data.logconfig import LogConfig
from lbgc.data.logs import read
from lbgc.data.looking import columns, sensor, stretch
from lbgc.data.looking.doctor import looked
from lbgc.data.readers.texts import sheet
from lbgc.data.record import mock_record
from lbgc.look import Said, as_override
from lbgc.report import look_text

DEG_H = np.deg2rad(1) / 3600


def written(path, table: np.ndarray, header: str = "", separator: str = ","):
    np.savetxt(path, table, delimiter=separator, header=header, comments="", fmt="%.9g")
    return path


def still(hz: float = 100, seconds: float = 300, latitude: float = 48.1, **options) -> np.ndarray:
    """Time, s, rates, deg/s, and forces, m/s^2, (T, 7), forward-right-down."""
    t, w, f = cases.static(hz, seconds, latitude, **options)
    return np.column_stack([t, np.rad2deg(w), f])


def test_a_moment_of_a_log_that_moves_tells_no_unit_of_its_gyros(tmp_path):
    """A second of flight in rad/s is a rest with a bias in deg/s."""
    rows = still(seconds=60)
    log = sensor.Means("flight", rows[:, 1:4], rows[:, 4:], 100.0)
    for seconds, moves, brief in ((60, True, False), (1, False, False), (1, True, True)):
        found = sensor.gyro_unit(log.part(0, 100 * seconds), None, np.deg2rad(48.1), moves)
        assert ("it moves, and rests for 1 s at most" in found.why) == brief
        assert found.value is None or not brief
    rows[:2000, 1:4] += 2 * np.sin(rows[:2000, :1] / 3)
    rows[2100:, 1:4] += 2 * np.sin(rows[2100:, :1] / 3)
    look = looked(written(tmp_path / "flight.csv", rows[:, 1:]), {"rate_hz": 100.0})
    assert "gyro_unit" in {guess.key for guess in look.asks}


def test_logs_as_people_have_them(tmp_path):
    """Of 200 by other seeds none is wrong without asking: make study-logs."""
    counts: Counter[str] = Counter()
    for number in range(24):
        made = make(tmp_path, number)
        verdict, look = judged(made)
        assert verdict != "wrong", (made, look)
        counts["right" if verdict == "right" or not made.is_decidable else "asked"] += 1
    assert counts["right"] >= 0.9 * counts.total()


@pytest.mark.parametrize("frame", FRAMES)
def test_which_axis_is_up(tmp_path, frame):
    from lbgc.data.readers.axes import matrix_of

    matrix = matrix_of(FRAMES[frame])
    table = still(arw=0.02)
    for part in (slice(1, 4), slice(4, 7)):
        table[:, part] = table[:, part] @ matrix
    look = looked(written(tmp_path / "log.csv", table), {"latitude": 48.1})
    assert look.is_sure, look
    assert look.record is not None
    assert np.degrees(np.arccos(-look.record.accel.mean(0)[2] / 9.81)) < 3
    down = look.record.gyro.mean(0)[2] / DEG_H
    assert down == pytest.approx(-15.04 * np.sin(np.deg2rad(48.1)), abs=0.5)


def test_a_bias_that_hides_the_unit_is_asked_about(tmp_path):
    """In deg/s 860 deg/h and 0.05 deg/sqrt(h), in rad/s 57 times as much: nobody can tell."""
    table = still(arw=0.05)
    table[:, 1] += 0.06
    file = written(tmp_path / "log.csv", table)
    look = looked(file, {"latitude": 48.1})
    assert [guess.key for guess in look.asks] == ["gyro_unit"]
    told = looked(file, {"latitude": 48.1, "gyro_unit": "deg/s"})
    assert told.is_described
    # whether the accelerometers print +1 g up is not told beside such a bias either
    assert [guess.key for guess in told.asks] == ["axes"]
    assert told.keys["most_bias_deg_per_h"] > 200


def test_it_is_cut_to_where_it_rests(tmp_path):
    table = still(seconds=200, arw=0.02)
    t = table[:, 0]
    moves = t < 30
    table[moves, 1:4] += 20 * np.sin(t[moves, None] * [1, 2, 3])
    look = looked(written(tmp_path / "log.csv", table), {"latitude": 48.1})
    assert look.is_sure
    assert 30 <= look.keys["from_s"] <= 32
    assert look.record is not None
    assert look.record.duration_s == pytest.approx(200 - look.keys["from_s"], abs=0.02)


def test_a_slow_drift_is_no_motion():
    rng = np.random.default_rng(1)
    drift = np.cumsum(rng.normal(size=(60_000, 3)), axis=0) * 0.01
    values = drift + rng.normal(size=(60_000, 3))
    found = stretch.rest(values, values, 100.0)
    assert (found.first, found.last) == (0, 60_000)


def test_a_long_recording_is_judged_by_its_means(tmp_path, monkeypatch):
    look = looked(written(tmp_path / "log.csv", still(arw=0.1)), {"latitude": 48.1})
    assert look.record is not None
    whole = look_text.deviations(look.record)
    monkeypatch.setattr(look_text, "_ROWS", 8000)
    coarse = look_text.deviations(look.record)
    assert coarse[0][0] == pytest.approx(0.04)
    # white: means of four samples, which overlap less, have the same law at the same times
    for part, fine in whole[1].items():
        np.testing.assert_allclose(coarse[1][part][:, :6], fine[:, 2:8], rtol=0.05)


def test_columns_without_names(tmp_path):
    """Any order of the two triads, and other columns between them."""
    table = still(seconds=60, arw=0.02)
    t, w, f = table[:, :1], table[:, 1:4], table[:, 4:]
    warm = 30 + np.sin(t / 10)
    for at, (parts, six) in enumerate(
        [
            ((t, w, f), [2, 3, 4, 5, 6, 7]),
            ((t, f, w), [5, 6, 7, 2, 3, 4]),
            ((f, w, t), [4, 5, 6, 1, 2, 3]),
            ((t, w, warm, f), [2, 3, 4, 6, 7, 8]),
        ]
    ):
        found = columns.find(sheet(written(tmp_path / f"{at}.csv", np.hstack(parts))))
        (guess,) = [own for own in found.guesses if own.key == "columns"]
        assert guess.value == six


def test_the_command_writes_what_every_command_reads(cli, tmp_path):
    header = "time (s),gx (deg/s),gy (deg/s),gz (deg/s),ax (m/s2),ay (m/s2),az (m/s2)"
    written(tmp_path / "My log.csv", still(arw=0.02), header, ";")
    said = cli("lbgc.look", "files=['My log.csv']", "log.latitude=48.1")
    assert said.code == 0, said.err
    assert "python lbgc/evaluate.py --config-dir mine log=my_log" in said.out
    assert list(tmp_path.glob("outputs/look/*/my_log.png"))
    keys = yaml.safe_load((tmp_path / "mine/log/my_log.yaml").read_text())
    (record,) = read(LogConfig(**keys))
    assert record.rate_hz == pytest.approx(100)
    done = cli("lbgc.evaluate", "--config-dir", "mine", "log=my_log", "windows_s=[60]",
               "log.heading_deg=90")  # fmt: skip
    assert done.code == 0, done.err
    # a description of the user's own is not written over
    (tmp_path / "mine/log/my_log.yaml").write_text("reader: table\n")
    again = cli("lbgc.look", "files=['My log.csv']", "log.latitude=48.1")
    assert again.code == 2
    assert "give name=ANOTHER" in again.err


def test_a_file_alone_where_it_tells_all(cli, tmp_path):
    table = still(arw=0.02)
    written(tmp_path / "log.csv", table)
    done = cli("lbgc.evaluate", "log.path=log.csv", "log.latitude=48.1", "windows_s=[60]",
               "log.heading_deg=90")  # fmt: skip
    assert done.code == 0, done.err
    assert "found log.columns=[2,3,4,5,6,7]: " in done.out
    fitted = cli("lbgc.fit", "log.path=log.csv", "log.latitude=48.1", "processes=1")
    assert fitted.code == 0, fitted.err
    table[:, 1] += 0.06  # a bias that hides the unit
    written(tmp_path / "biased.csv", table)
    asked = cli("lbgc.fit", "log.path=biased.csv", "log.latitude=48.1")
    assert asked.code == 2
    assert "log.gyro_unit = None: is not told by the file: is it deg/s or rad/s?" in asked.err
    told = cli("lbgc.evaluate", "log.path=biased.csv", "log.latitude=48.1", "log.gyro_unit=deg/s")
    assert "log.axes = None: is not told by the file: do they print +1 g up" in told.err
    assert cli("lbgc.fit", "log.path=none.csv").code == 2


def test_it_asks_by_the_key(cli, tmp_path):
    written(tmp_path / "log.csv", still(arw=0.02)[:, 1:])
    said = cli("lbgc.look", "files=[log.csv]")
    assert said.code == 0
    assert "log.rate_hz: how many samples a second?" in said.out
    assert "log.latitude: where was it recorded?" in said.out
    assert not (tmp_path / "mine").exists()


def test_what_is_no_log(cli, tmp_path):
    (tmp_path / "letter.txt").write_text("Dear Sir,\nno numbers here.\n")
    written(tmp_path / "log.csv", still(arw=0.02))
    alone = cli("lbgc.look", "files=[letter.txt]")
    assert alone.code == 2
    assert len(alone.err.strip().splitlines()) == 1
    both = cli("lbgc.look", "files=[letter.txt,log.csv]", "log.latitude=48.1")
    assert both.code == 0
    assert "letter.txt" in both.out
    assert (tmp_path / "mine/log/log.yaml").exists()
    assert cli("lbgc.look").code == 2


def test_what_it_asks_for_can_be_said(cli, tmp_path):
    """Of a file with two tables it asks for log.table, which the commands take."""
    said = {field.name for field in fields(Said)}
    alone = yaml.safe_load((ROOT / "conf/log/auto.yaml").read_text())
    assert said <= alone.keys() <= {field.name for field in fields(LogConfig)}
    assert {"table", "dtype", "skip_bytes"} <= said
    table = still(seconds=60, arw=0.02)
    one = {"t": table[:, 0], "gyro": np.deg2rad(table[:, 1:4]), "accel": table[:, 4:]}
    scipy.io.savemat(tmp_path / "log.mat", {"first": one, "second": one})
    asked = cli("lbgc.look", "files=[log.mat]", "log.latitude=48.1")
    assert "log.table: which is it?" in asked.out
    told = cli("lbgc.look", "files=[log.mat]", "log.latitude=48.1", "log.table=second")
    assert told.code == 0, told.err
    assert yaml.safe_load((tmp_path / "mine/log/log.yaml").read_text())["table"] == "second"
    done = cli("lbgc.evaluate", "log.path=log.mat", "log.latitude=48.1", "log.table=first",
               "windows_s=[30]")  # fmt: skip
    assert done.code == 0, done.err


def test_a_log_without_noise_has_none(tmp_path):
    """It is no sensor of 1e-32 degrees."""
    table = still(seconds=60, arw=0.0, accel_ug=0.0)
    header = "t,gx (deg/s),gy (deg/s),gz (deg/s),ax (m/s2),ay (m/s2),az (m/s2)"
    look = looked(written(tmp_path / "log.csv", table, header), {"latitude": 48.1})
    record = mock_record() if look.rest is None else look.rest
    said = "\n".join(look_text.worth(record, look_text.deviations(record)))
    assert "the gyros have no noise in this log" in said
    assert "the accelerometers have no noise in this log" in said
    assert "deg" not in said


def test_a_limit_that_is_said_is_kept(tmp_path):
    table = still(arw=0.02)
    table[:, 1] += 100 / 3600
    file = written(tmp_path / "log.csv", table)
    told = {"latitude": 48.1, "gyro_unit": "deg/s"}
    assert looked(file, told).keys["most_bias_deg_per_h"] > 90
    look = looked(file, {**told, "most_bias_deg_per_h": 50.0})
    assert look.keys["most_bias_deg_per_h"] == 50
    assert "most_bias" in str(look.refusal)


def test_no_name_gets_out_of_a_description(tmp_path):
    """Whatever a file calls its columns: the description has its keys and no other."""
    table = still(seconds=60, arw=0.02)
    text = "time \"a'b: {x} #,gx,gy,gz,ax,ay,az,timestamp: [1\n"
    rows = np.column_stack([table, np.arange(len(table))])
    body = "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows)
    (tmp_path / "log.csv").write_text(text + body + "\n")
    look = looked(tmp_path / "log.csv", {"latitude": 48.1})
    keys = yaml.safe_load(look_text.description(look, "# first"))
    assert set(keys) == {field.name for field in fields(LogConfig)}
    assert all(keys[key] == value for key, value in look.keys.items() if key != "path")


def test_files_without_a_key(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a=b.csv").write_text("")
    given = ["a=b.csv", "it's.csv", "log.latitude=3", "--verify"]
    expected = [r"files=['a=b.csv','it\'s.csv']", "log.latitude=3", "--verify"]
    assert as_override(given) == expected
