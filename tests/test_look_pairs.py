"""The log doctor on gyros and accelerometers in two files, and on one triad alone."""

import numpy as np
import pytest
import yaml
from test_triads_of_logs import log, only

from lbgc.data.logconfig import LogConfig
from lbgc.data.logs import read, read_noise
from lbgc.data.looking import pair
from lbgc.data.looking.doctor import looked

HERE = {"latitude": 32.76}


def written(path, values: dict[str, np.ndarray], names=None, header: bool = True):
    """A comma file of columns, called as `names` has them."""
    names = {} if names is None else names
    text = ",".join(names.get(name, name) for name in values) if header else ""
    table = np.column_stack(list(values.values()))
    np.savetxt(path, table, fmt="%.12g", delimiter=",", header=text, comments="")
    return str(path)


def xyz(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns whose names are those of axes alone."""
    return {"t" if name == "t" else name[-1]: own for name, own in values.items()}


@pytest.mark.parametrize("accel_hz", [20.0, 51.3])
@pytest.mark.parametrize("layout", ["named", "xyz", "nameless"])
def test_two_files_of_one_sensor_are_read_as_every_command_reads_them(tmp_path, accel_hz, layout):
    """On one clock and on two, whatever their columns are called."""
    other = log(accel_hz, round(150 * accel_hz), seed=2) if accel_hz != 20 else log()
    made = [only(log(), "w"), only(other, "f")]
    made = made if layout == "named" else [xyz(own) for own in made]
    names = ("gyroscope.csv", "accelerometer.csv")
    files = [
        written(tmp_path / name, own, header=layout != "nameless")
        for name, own in zip(names, made, strict=True)
    ]
    assert pair.of_files(files[::-1], HERE) == tuple(files)
    look = looked(tmp_path / names[0], {**HERE, "accel_path": files[1]})
    assert look.is_sure, look
    assert (look.keys["gyro_unit"], look.keys["accel_unit"]) == ("deg/s", "m/s2")
    (record,) = read(LogConfig(**look.keys))
    assert record.rate_hz == pytest.approx(20.0, rel=1e-3)
    assert record.duration_s == pytest.approx(150, abs=0.2)
    assert any("two clocks" in note for note in record.notes) == (accel_hz != 20)


def test_what_is_no_pair(tmp_path):
    gyro = written(tmp_path / "gyro.csv", only(log(), "w"))
    again = written(tmp_path / "again.csv", only(log(seed=4), "w"))
    accel = written(tmp_path / "accel.csv", only(log(), "f"))
    both = written(tmp_path / "both.csv", log())
    field = written(tmp_path / "field.csv", xyz(only(log(), "w")))  # may be a magnetometer's
    assert pair.of_files([gyro, accel, both, field], {}) == (gyro, accel)
    for files in ([gyro, again, accel], [field, accel], [both, accel], [gyro], [gyro, again]):
        assert pair.of_files(files, {}) is None
    assert pair.of_files([gyro, accel], {"columns": [1, 2, 3, 4, 5, 6]}) is None
    # said to be the gyros', it is read as that
    told = looked(tmp_path / "field.csv", {**HERE, "accel_path": accel})
    assert told.is_sure, told


def test_two_files_without_common_time_are_asked_about(tmp_path):
    written(tmp_path / "gyro.csv", only(log(), "w"))
    accel = written(tmp_path / "accel.csv", only(log(40.0, start=1e6), "f"))
    look = looked(tmp_path / "gyro.csv", {**HERE, "accel_path": accel})
    (asked,) = look.asks
    assert asked.key == "accel_path"
    assert "have no time in common" in asked.why


def test_a_rest_of_two_clocks_is_cut_by_the_time_from_which_both_have_begun(tmp_path):
    """The gyros begin five seconds late, and the bench moves for thirty more."""
    gyro, accel = log(start=5.0, samples=4000), log(40.0, 9000, seed=2)
    moves = gyro["t"] < 35
    for axis, name in enumerate(("w_x", "w_y", "w_z")):
        gyro[name][moves] += 20 * np.sin(gyro["t"][moves] * (1 + axis))
    written(tmp_path / "gyro.csv", only(gyro, "w"))
    other = written(tmp_path / "accel.csv", only(accel, "f"))
    look = looked(tmp_path / "gyro.csv", {**HERE, "accel_path": other})
    assert look.is_sure, look
    assert 30 <= look.keys["from_s"] <= 32
    (record,) = read(LogConfig(**look.keys))
    assert np.abs(record.gyro).max() < np.deg2rad(0.1)


def test_rows_of_one_triad_each_are_found_to_be_so(tmp_path):
    gyro, accel = only(log(), "w"), only(log(50.0, 7500, seed=3), "f")
    rows = [(t, *w, "", "", "") for t, *w in zip(*gyro.values(), strict=True)]
    rows += [(t, "", "", "", *f) for t, *f in zip(*accel.values(), strict=True)]
    rows.sort(key=lambda row: row[0])
    text = "\n".join(",".join(str(cell) for cell in row) for row in rows)
    (tmp_path / "log.csv").write_text(f"t,w_x,w_y,w_z,f_x,f_y,f_z\n{text}\n")
    look = looked(tmp_path / "log.csv", HERE)
    assert look.is_sure, look
    (record,) = read(LogConfig(**look.keys))
    assert record.duration_s == pytest.approx(150, abs=0.2)


def test_look_and_fit_take_two_files(cli, tmp_path):
    written(tmp_path / "gyro.csv", only(log(), "w"))
    written(tmp_path / "accel.csv", only(log(50.0, 7500, seed=3), "f"))
    said = cli("lbgc.look", "files=[accel.csv,gyro.csv]", "log.latitude=32.76")
    assert said.code == 0, said.err
    assert "gyro.csv and accel.csv are taken as gyros and accelerometers of one sensor" in said.out
    keys = yaml.safe_load((tmp_path / "mine/log/gyro.yaml").read_text())
    assert (keys["path"], keys["accel_path"]) == tuple(
        str(tmp_path / name) for name in ("gyro.csv", "accel.csv")
    )
    assert len(read_noise(LogConfig(**keys))) == 2
    done = cli("lbgc.fit", "log.path=gyro.csv", "log.accel_path=accel.csv", "processes=1",
               "flicker_short_s=1", "log.latitude=32.76")  # fmt: skip
    assert done.code == 0, done.err
    assert "found log.gyro_unit=deg/s" in done.out


@pytest.mark.parametrize(("kind", "what"), [("w", "angle"), ("f", "velocity")])
def test_one_triad_alone_has_a_picture_and_figures(cli, tmp_path, kind, what):
    names = {f"{kind}_{axis}": f"{kind}{axis} ({unit})" for axis in "xyz"
             for unit in ["deg/s" if kind == "w" else "m/s2"]}  # fmt: skip
    written(tmp_path / "log.csv", only(log(), kind), names)
    said = cli("lbgc.look", "files=[log.csv]")
    assert said.code == 0, said.err
    assert f"{what} random walk" in said.out
    assert "Allan deviation falls to" in said.out
    assert list(tmp_path.glob("outputs/look/*/log.png"))
