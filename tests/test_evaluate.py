"""The evaluation: its figures, its page, and what it refuses."""

import csv
import json
import re
import shutil
from dataclasses import fields
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from helpers import default_config, generate, needs_recording
from PIL import Image
from test_logs import columns, spoiled, write

import lbgc.subjects
from lbgc.data.logs import LogConfig
from lbgc.errors import build
from lbgc.estimators.block_means import Site
from lbgc.estimators.floor import course_of, crlb
from lbgc.estimators.information import information
from lbgc.evaluate import KNOWN, EvaluateConfig
from lbgc.metrics import heading_errors, summarise
from lbgc.protocol import ProtocolConfig
from lbgc.sensor.datasheet import ImuConfig

CSV = ("log=csv", "log.path=log.csv", "log.latitude=32.76", "log.time_column=t")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return generate(
        tmp_path_factory.mktemp("d") / "d.zarr", recordings=30, rate_hz=10.0, duration_s=60.0
    )


def results(done, tmp_path) -> dict:
    assert done.code == 0, done.err
    return json.loads((tmp_path / done.last_line).with_name("results.json").read_text())


def untimed(said: dict) -> dict:
    """Without what differs from run to run."""
    for row in said["rows"]:
        del row["microseconds_a_window"]
    return said


def test_metrics_say_what_they_do():
    errors = heading_errors(np.deg2rad([359.0, 2.0, 183.0]), np.deg2rad([1.0, 358.0, 183.5]))
    np.testing.assert_allclose(np.rad2deg(errors), [-2.0, 4.0, -0.5], atol=1e-12)
    said = summarise(errors, np.full(3, np.pi / 3))
    assert said.windows == 3
    assert said.rmse_deg == pytest.approx(np.sqrt((4 + 16 + 0.25) / 3))
    assert said.median_deg == pytest.approx(2.0)
    assert said.iqr_deg == pytest.approx(3.0 - 1.25)
    assert said.p95_deg == pytest.approx(3.8)
    assert said.rmse_cos_latitude_deg == pytest.approx(said.rmse_deg / 2)


def test_a_dataset_and_a_run_become_a_table_json_and_a_page(cli, tmp_path, unit_bias_run):
    dataset, run = unit_bias_run
    done = cli("lbgc.evaluate", f"data={dataset.path}", f"run={run}")
    said = results(done, tmp_path)
    assert said["against"] == "truth"
    keys = {"estimator", "window_s", "windows", "rmse_deg", "median_deg", "iqr_deg"}
    assert all(keys <= set(row) for row in said["rows"])
    counts = {(r["estimator"], r["window_s"]): r["windows"] for r in said["rows"]}
    assert counts == {
        (e, w): 450 * round(240 // w)
        for e in ("mean", "bilstm_24")
        for w in (10.0, 20.0, 30.0, 60.0, 240.0)
    }
    for row in said["rows"]:
        assert f"{row['rmse_deg']:.2f}" in done.out
    page = (tmp_path / done.last_line).read_text()
    HTMLParser().feed(page)
    assert not re.search(r"""(src|href)=["'](?!data:)""", page), "the page needs another file"
    for title in ("Error against window", "Box plots", "Allan deviation", "Loss curve", "paper"):
        assert title in page
    assert "<b>100%</b> of its" in page.replace("\n", " ")
    assert "other recordings of these same" in page.replace("\n", " ")
    assert "the paper states 98965" in page


def test_a_model_of_other_units_is_called_that(cli, tmp_path, unit_bias_run, dataset):
    options = f"data={dataset.path}", f"run={unit_bias_run[1]}"
    refused = cli("lbgc.evaluate", *options)
    assert "bilstm_24 is left out" in refused.out
    assert "is not its sensor, although of the same name: figures differ" in refused.out
    done = cli("lbgc.evaluate", *options, "untrained=true")
    assert "bilstm_24 (untrained) answers all the same" in done.out
    assert "bilstm_24 (untrained)  " in done.out
    assert "trained on <b>other units</b>" in (tmp_path / done.last_line).read_text()
    assert "windows of 240 s are left out: the longest recording has 60 s" in done.out


def test_a_picture_of_the_scene_is_shown_where_there_is_one(cli, tmp_path, dataset):
    without = cli("lbgc.evaluate", f"data={dataset.path}")
    assert "The bench" not in (tmp_path / without.last_line).read_text()
    Image.new("RGB", (30, 20)).save(dataset.path.with_suffix(".png"))
    try:
        done = cli("lbgc.evaluate", f"data={dataset.path}")
        assert "The bench" in (tmp_path / done.last_line).read_text()
    finally:
        dataset.path.with_suffix(".png").unlink()


def test_every_field_changes_the_result(cli, tmp_path, dataset, unit_bias_run):
    other = generate(tmp_path / "other.zarr", recordings=30, rate_hz=10.0, duration_s=60.0, seed=3)
    write(tmp_path / "log.csv", columns())
    base = f"data={dataset.path}"
    changes = {
        "data": (f"data={other.path}",),
        "log": (*CSV, "log.heading_deg=40"),
        "run": (base, f"run={unit_bias_run[1]}"),
        "untrained": (base, f"run={unit_bias_run[1]}", "untrained=true"),
        "estimators": (base, "estimators=[gls]"),
        "estimator": (base, "estimator=triad"),
        "imu": (base, "imu=stim300"),
        "reach_deg": (base, "reach_deg=[3]"),
        "windows_s": (base, "windows_s=[15]"),
        "split": (base, "split=train"),
        "against": (base, "against=reference"),
        "known": (base, "known=[run]"),
    }
    elsewhere = {"calibration", "tumble"}  # in test_own_unit, test_tumbling
    assert set(changes) | elsewhere == {f.name for f in fields(EvaluateConfig)}
    usual = untimed(results(cli("lbgc.evaluate", base), tmp_path))
    assert untimed(results(cli("lbgc.evaluate", base), tmp_path)) == usual
    for field, options in changes.items():
        assert untimed(results(cli("lbgc.evaluate", *options), tmp_path)) != usual, field


def test_every_log_field_changes_the_record_or_is_refused(tmp_path):
    """What each field does is in other tests; here: that none is forgotten."""
    here = Path(__file__).parent
    source = "".join(
        path.read_text() for path in here.glob("test_*.py") if path.name != "test_evaluate.py"
    )
    named = {f.name for f in fields(LogConfig)} - {"name"}
    assert {n for n in named if n not in source} == set()


def test_a_log_of_ones_own(cli, tmp_path):
    write(tmp_path / "log.csv", columns())
    done = cli("lbgc.evaluate", *CSV, "log.heading_deg=41")
    (ten, twenty) = results(done, tmp_path)["rows"]
    assert (ten["windows"], twenty["windows"]) == (2, 1)
    assert ten["rmse_deg"] == pytest.approx(1.0, abs=1e-6)
    assert "a real log has no truth" in done.out
    assert "against the <b>reference</b>" in (tmp_path / done.last_line).read_text()


@pytest.mark.parametrize("name", ["nan", "gap", "backward", "missing", "g", "rad", "moving"])
def test_bad_logs_end_with_two(cli, tmp_path, name):
    write(tmp_path / "log.csv", spoiled(name))
    done = cli("lbgc.evaluate", *CSV, "log.heading_deg=40", "log.accel_unit=m/s2")
    assert done.code == 2
    assert done.err.startswith("error: lo")
    assert "Traceback" not in done.err
    assert not list(tmp_path.glob("outputs/evaluate/*/results.json"))


def test_a_log_shorter_than_the_shortest_window_is_refused(cli, tmp_path):
    write(tmp_path / "log.csv", columns(90))
    done = cli("lbgc.evaluate", *CSV, "log.heading_deg=40")
    assert done.code == 2
    assert "the longest recording = 9 s: is shorter than the shortest window, 10 s" in done.err


def test_a_log_without_heading_is_answered_and_not_scored(cli, tmp_path):
    """Level, at 40 degrees: every window's heading and sigma, on the screen, in JSON, CSV and the
    page; no error anywhere."""
    write(tmp_path / "log.csv", columns())
    done = cli("lbgc.evaluate", *CSV, "windows_s=[10,20]", "estimators=[mean,triad]")
    said = results(done, tmp_path)
    assert said["rows"] == []
    assert said["against"] is None
    assert [(r["estimator"], r["window_s"]) for r in said["headings"]][:2] == [
        ("mean", 10.0), ("mean", 20.0)]  # fmt: skip
    assert "no heading is known, so there are no errors; log.heading_deg gives one" in done.out
    own = said["headings"][0]["recordings"][0]
    assert own["windows"] == len(own["each"])
    known = results(cli("lbgc.evaluate", *CSV, "log.heading_deg=40", "windows_s=[10]"), tmp_path)
    with_csv = (tmp_path / done.last_line).with_name("windows.csv").read_text().splitlines()
    line = dict(zip(with_csv[0].split(","), with_csv[1].split(","), strict=True))
    assert line["heading_deg"] == line["error_deg"] == ""
    assert float(line["estimate_deg"]) % 360 == pytest.approx(own["each"][0]["heading_deg"])
    assert f"{own['each'][0]['heading_deg']:.2f}" in done.out or own["windows"] > 1
    rmse = known["rows"][0]["rmse_deg"]
    off = [(e["heading_deg"] - 40 + 180) % 360 - 180 for e in own["each"]]
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(rmse, abs=1e-5)
    page = (tmp_path / done.last_line).read_text()
    assert "Nothing is there to check the headings by" in page
    assert "windows of 20 s" in page
    assert "NSE" not in page


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "data or log = nothing: give one"),
        (("data=a", *CSV), "data or log = both: give one"),
        (("data=nonesuch",), "data = nonesuch: is no dataset"),
        (("log=nonesuch",), "lasergyro"),
        (("log=csv", "log.path=x"), "log.latitude"),
        (("data=d.zarr", "run=nonesuch"), "run = nonesuch: is no finished training run"),
        (("data=d.zarr", "estimators=[median]"), "estimators = median: choose from mean, triad"),
        (("data=d.zarr", "split=all"), "choose from train, validation, test"),
        (("data=d.zarr", "against=gps"), "choose from truth, reference"),
        (("data=d.zarr", "windows_s=[0]"), "windows_s = 0.0 s: must be greater than zero"),
        (("data=d.zarr", "windows_s=[]"), "must name a length"),
    ],
)
def test_bad_evaluation_input_is_named(cli, tmp_path, options, says):
    done = cli("lbgc.evaluate", *options)
    assert done.code == 2
    assert says in done.err
    assert "Traceback" not in done.err
    assert list(tmp_path.iterdir()) == []


def test_an_unfinished_dataset_is_refused_everywhere(cli, tmp_path):
    from lbgc.data import store

    store.create(tmp_path / "d.zarr", store.Layout(10, 40, 2.0, {}), {"a": 1}, {})
    for module in ("lbgc.train", "lbgc.evaluate"):
        done = cli(module, "data=d.zarr")
        assert done.code == 2
        assert "is not finished: 1 of 1 shards are missing" in done.err


@pytest.fixture(scope="module")
def turning(tmp_path_factory):
    """Recordings in which the plate stands at 0, turns, and stands at 180 degrees."""
    return generate(
        tmp_path_factory.mktemp("t") / "t.zarr",
        recordings=12,
        rate_hz=10.0,
        duration_s=60.0,
        split=[0, 0, 1],
        protocol=default_config("protocol=two_position").protocol,
    )


def test_what_cannot_answer_is_left_out_and_the_rest_go_on(cli, tmp_path, turning):
    done = cli("lbgc.evaluate", f"data={turning.path}", "estimator=all", "windows_s=[10,60]")
    said = results(done, tmp_path)
    rows = {(r["estimator"], r["window_s"]) for r in said["rows"]}
    out = {(r["estimator"], r["window_s"]): r["why"] for r in said["left_out"]}
    assert rows | set(out) == {(name, w) for name in KNOWN for w in (10.0, 60.0)}
    assert not rows & set(out)
    assert ("two_position", 60.0) in rows
    assert ("two_position", 10.0) in out
    assert "of plate travel within a window" in out["mean", 60.0]
    notes = [n for n in said["notes"] if n.startswith("mean is left out")]
    assert len(notes) == 1
    assert "left out at 10, 60 s" in notes[0]
    assert notes[0] in done.out
    page = (tmp_path / done.last_line).read_text()
    assert "left out at 10, 60 s" in page
    assert "Error by heading" in page


def test_where_none_can_answer_it_says_why(cli, tmp_path, turning):
    done = cli("lbgc.evaluate", f"data={turning.path}", "estimators=[mean,triad]", "windows_s=[60]")
    assert done.code == 2
    for name in ("mean", "triad"):
        assert f"estimator '{name}'" in done.err
    assert "of plate travel within a window" in done.err
    assert not list(tmp_path.glob("outputs/evaluate/*/results.json"))


def test_every_window_is_in_the_csv(cli, tmp_path, dataset):
    options = ("estimators=[mean,gls]", "windows_s=[20,60]")
    done = cli("lbgc.evaluate", f"data={dataset.path}", *options)
    said = results(done, tmp_path)
    with (tmp_path / done.last_line).with_name("windows.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    names = "recording window_s start_s estimator heading_deg estimate_deg error_deg sigma_deg"
    assert list(lines[0]) == names.split()
    for row in said["rows"]:
        own = [
            line
            for line in lines
            if (line["estimator"], float(line["window_s"])) == (row["estimator"], row["window_s"])
        ]
        assert len(own) == row["windows"]
        error, sigma = (np.array([float(o[n]) for o in own]) for n in ("error_deg", "sigma_deg"))
        heading, estimate = (
            np.array([float(o[n]) for o in own]) for n in ("heading_deg", "estimate_deg")
        )
        np.testing.assert_allclose((estimate - heading - error + 180) % 360, 180, atol=3e-6)
        assert np.sqrt(np.mean(error**2)) == pytest.approx(row["rmse_deg"], rel=1e-5)
        nse = row["mean_normalised_squared_error"]
        assert np.mean((error / sigma) ** 2) == pytest.approx(nse, rel=1e-4)
        assert sum(s["windows"] for s in row["by_heading"]) == row["windows"]
        parts = sum(s["windows"] * s["rmse_deg"] ** 2 for s in row["by_heading"])
        assert parts / row["windows"] == pytest.approx(row["rmse_deg"] ** 2)
        for s in row["by_heading"]:
            if s["windows"] > 1:
                assert s["interval"][0] <= s["rmse_deg"] <= s["interval"][1]
            else:
                assert s["interval"] is None
        for name, (low, high) in row["intervals"].items():
            assert low <= row[name] <= high, name
    for by_error in said["time_to_reach"].values():
        for reach in by_error.values():
            assert all(t.endswith(" s") for t in reach.values())
    starts = {float(line["start_s"]) for line in lines if line["window_s"] == "20"}
    assert starts == {0.0, 20.0, 40.0}
    assert len({line["recording"] for line in lines}) == len(dataset.in_split("test"))


def test_results_are_json_that_anyone_can_read(cli, tmp_path, turning):
    """No NaN and no Infinity, which JSON does not have."""

    def refuse(name):
        raise AssertionError(name)

    done = cli("lbgc.evaluate", f"data={turning.path}", "estimator=all", "windows_s=[60]")
    text = (tmp_path / done.last_line).with_name("results.json").read_text()
    said = json.loads(text, parse_constant=refuse)
    assert said["rows"]
    assert json.loads(json.dumps(said)) == said


def test_a_log_is_weighed_once_its_sensor_is_known(cli, tmp_path):
    write(tmp_path / "log.csv", columns())
    options = (*CSV, "log.heading_deg=40", "estimators=[mean,gls]")
    said = results(cli("lbgc.evaluate", *options), tmp_path)
    assert {r["estimator"] for r in said["rows"]} == {"mean"}
    assert {r["estimator"] for r in said["left_out"]} == {"gls"}
    said = results(cli("lbgc.evaluate", *options, "imu=stim300"), tmp_path)
    assert {r["estimator"] for r in said["rows"]} == {"mean", "gls"}
    assert any("one recording" in note for note in said["notes"])


def test_a_model_is_not_given_a_rate_it_cannot_use(cli, tmp_path, unit_bias_run):
    size = {"recordings": 10, "output": "means", "duration_s": 60.0, "split": [0, 0, 1]}
    generate(tmp_path / "d.zarr", **size, mean_s=2.0)
    model = f"run={unit_bias_run[1]}", "untrained=true"
    alone = cli("lbgc.evaluate", "data=d.zarr", *model, "estimators=[]")
    assert alone.code == 2
    assert "the data's rate = 0.5 Hz: must be a whole multiple of 0.2 Hz" in alone.err
    with_others = cli("lbgc.evaluate", "data=d.zarr", *model)
    said = results(with_others, tmp_path)
    assert {row["estimator"] for row in said["rows"]} == {"mean"}
    assert {out["estimator"] for out in said["left_out"]} == {"bilstm_24 (untrained)"}
    assert "left out at 10, 20, 30, 60 s: the data's rate = 0.5 Hz" in with_others.out


@pytest.mark.parametrize("latitude", [90.0, -90.0])
def test_at_the_pole_it_says_why_it_refuses(cli, tmp_path, latitude):
    generate(tmp_path / "d.zarr", recordings=10, rate_hz=10.0, duration_s=20.0, latitude=latitude)
    done = cli("lbgc.evaluate", "data=d.zarr")
    assert done.code == 2
    assert "Earth's rate has no horizontal part there and heading does not exist" in done.err


@needs_recording("lasergyro.imu")
def test_lasergyro_baseline_agrees_with_its_readme(cli, tmp_path):
    """RMSE and median within 5% of the published table (whose figures have two digits)."""
    windows = {10: (29.2, 2.1), 30: (21.8, 1.4), 60: (16.5, 2.0), 120: (8.0, 2.4), 300: (3.6, 2.3)}
    done = cli("lbgc.evaluate", "log=lasergyro", f"windows_s={list(windows)}")
    for row in results(done, tmp_path)["rows"]:
        rmse, median = windows[row["window_s"]]
        assert row["rmse_deg"] == pytest.approx(rmse, rel=0.05, abs=0.05)
        assert row["median_deg"] == pytest.approx(median, rel=0.05, abs=0.05)


def test_the_screens_table_lines_up(cli, tmp_path, dataset):
    done = cli("lbgc.evaluate", f"data={dataset.path}", "windows_s=[10,60]")
    lines = [line for line in done.out.splitlines() if line.startswith(("estimator", "--", "mean"))]
    assert len({len(line) for line in lines}) == 1
    assert len(lines) == 4


def test_a_floor_that_knows_the_units_bias_is_far_below_one_that_does_not(
    cli, tmp_path, unit_bias_run
):
    """All of the bias is the unit's, 1 deg/h: knowing it, in-run noise is left, as `bound.py` says.

    450 recordings' RMSE has a sampling error of 3.3%.
    """
    data = unit_bias_run[0]
    done = cli("lbgc.evaluate", f"data={data.path}", "estimators=[mean,floor]", "known=[unit]",
               "windows_s=[240]")  # fmt: skip
    assert done.code == 0, done.err
    rows = {r["estimator"]: r for r in results(done, tmp_path)["rows"]}
    told = rows["floor, unit known"]
    over = rows["mean"]["over_floor"]
    assert 0.97 < over["low"] <= over["value"] <= over["high"] < 1.03  # one bias: the mean is best
    assert rows["floor"]["over_floor"] is None
    assert told["rmse_deg"] < 0.5 * rows["floor"]["rmse_deg"]
    assert 0.9 < told["mean_normalised_squared_error"] < 1.1 + 4 * np.sqrt(2 / 450)
    imu = build(ImuConfig, data.configuration["imu"]).model(600.0).without("unit")
    course = course_of(ProtocolConfig(), 240.0)
    expected = crlb(information(imu, course, Site.at(np.deg2rad(32.76))))
    assert told["rmse_deg"] == pytest.approx(np.rad2deg(expected), rel=4 * 0.034)


def test_what_a_real_log_drew_is_not_known(cli, tmp_path):
    write(tmp_path / "log.csv", columns())
    done = cli("lbgc.evaluate", *CSV, "log.heading_deg=40", "known=[unit]")
    assert done.code == 2
    assert "known" in done.err


def test_recordings_together_are_answered_as_each_alone(cli, tmp_path, turning, monkeypatch):
    options = (f"data={turning.path}", "estimators=[two_position,gls,floor]", "windows_s=[10,40]")
    together = results(cli("lbgc.evaluate", *options), tmp_path)
    monkeypatch.setattr(lbgc.subjects, "_BATCH_BYTES", 0.0)
    shutil.rmtree(tmp_path / "outputs")
    alone = results(cli("lbgc.evaluate", *options), tmp_path)
    assert [r["why"] for r in alone["left_out"]] == [r["why"] for r in together["left_out"]]
    for one, other in zip(alone["rows"], together["rows"], strict=True):
        for name in ("rmse_deg", "median_deg", "mean_normalised_squared_error"):
            assert one[name] == pytest.approx(other[name], rel=1e-9)


def test_a_perfect_sensor_is_evaluated_too(cli, tmp_path):
    """Its Allan deviation is zero, which has no logarithm."""
    imu = default_config("imu=ideal").imu
    perfect = generate(tmp_path / "p.zarr", recordings=3, imu=imu, rate_hz=10.0, duration_s=60.0,
                       split=[0, 0, 1])  # fmt: skip
    rows = results(cli("lbgc.evaluate", f"data={perfect.path}", "windows_s=[60]"), tmp_path)["rows"]
    assert rows[0]["rmse_deg"] < 1e-4


def test_a_log_of_a_rate_that_is_not_tidy_says_how_long_its_windows_are(cli, tmp_path):
    """Windows of the nearest whole number of samples, at the clock's own rate."""
    import cases

    t, w, f = cases.static(98.317, 130, arw=0.001, accel_ug=1, seed=2)
    cases.write(tmp_path / "log.csv", cases.table(w, f, t), ["t", *cases.HEADER], "%.12g")
    own = ("log=csv", "log.path=log.csv", "log.latitude=48.1", "log.heading_deg=90")
    done = cli("lbgc.evaluate", *own, "windows_s=[10,60]", "imu=sdc500", "estimators=[mean,gls]")
    assert "windows of 10 s are 983 samples, 9.99827 s, at 98.317 Hz" in done.out
    assert "windows of 60 s are 5899 samples, 59.9998 s, at 98.317 Hz" in done.out
    rows = results(done, tmp_path)["rows"]
    assert {(r["estimator"], r["window_s"], r["windows"]) for r in rows} >= {
        ("mean", 10.0, 13), ("mean", 60.0, 2), ("gls", 60.0, 2)}  # fmt: skip
    assert max(r["rmse_deg"] for r in rows if r["window_s"] == 60.0) < 1
