"""A unit of one's own: labelled recordings become a file, and what takes it is better for it."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from floor_cases import STATIC, Case
from test_evaluate import results

from lbgc import labelling
from lbgc.earth import EARTH_RATE
from lbgc.estimators.block_means import Course, Site
from lbgc.estimators.floor import small_errors
from lbgc.estimators.information import information
from lbgc.estimators.unit_posterior import Reference
from lbgc.frames import rotation_z
from lbgc.units import DEG, HOUR

BIAS = ("imu.gyro.bias_unit_deg_per_h=1.5", "imu.gyro.bias_session_deg_per_h=0.3",
        "imu.gyro.bias_run_deg_per_h=0.2")  # fmt: skip
STILL = ("protocol=static", "output=means", "duration_s=240", "split=[0,0,100]")


@pytest.fixture
def of_one_unit(cli):
    """What labels a unit, and what is asked about it then."""
    for name, *options in (("labelled", "seed=1", "sessions=4", "recordings=12"),
                           ("asked", "seed=2", "sessions=40", "recordings=40")):  # fmt: skip
        done = cli("sim.generate", *STILL, *BIAS, *options, f"out={name}.zarr")
        assert done.code == 0, done.err


def test_labelled_recordings_make_north_better(cli, of_one_unit, tmp_path):
    """The bias is mostly the unit's, so that taking it off halves the error at least; and what is
    stated after it holds: forty power-ups, of which each has two errors, 4.5 sampling errors."""
    done = cli("lbgc.calibrate", "data=labelled.zarr")
    assert done.code == 0, done.err
    assert "known of this SDC500 as measured now, by 12 labelled recordings of 4" in done.out
    assert "a power-up adds" in done.out
    assert "expect no gain" not in done.out
    with_it, without = re.search(
        r"([\d.]+) deg RMS with a constant, ([\d.]+) without", done.out
    ).groups()
    assert float(with_it) < 0.5 * float(without)
    path = f"calibration={Path(done.last_line).with_name('unit.json')}"
    ask = ("data=asked.zarr", "estimators=[mean,gls,ekf,floor]", "windows_s=[240]")
    before = {
        own["estimator"]: own for own in results(cli("lbgc.evaluate", *ask), tmp_path)["rows"]
    }
    told = cli("lbgc.evaluate", *ask, path)
    assert "12 labelled recordings of 4 power-ups tell of this unit is taken off" in told.out
    after = {own["estimator"]: own for own in results(told, tmp_path)["rows"]}
    for name, own in after.items():
        assert own["rmse_deg"] < 0.5 * before[name]["rmse_deg"]
        assert abs(own["mean_normalised_squared_error"] - 1) < 4.5 * np.sqrt(2 / 40)
    bound = cli("lbgc.bound", path, *BIAS, "windows_s=[240]")
    assert bound.code == 0, bound.err
    assert "what is left of the unit" in bound.out


def means(
    path: Path, sessions: range, unit: tuple = (1.2, -0.8, 0.5), power_up: tuple = (0.3, 0.3, 0.3)
) -> str:
    """Means of three recordings of each of these power-ups, of a unit with these biases, deg/h, and
    what each power-up adds."""
    rng = np.random.default_rng(sessions.start)
    rows = []
    for session in sessions:
        own = power_up * rng.standard_normal(3)
        for heading in rng.uniform(0, 360, 3):
            earth = EARTH_RATE * np.array([np.cos(0.6), 0.0, -np.sin(0.6)])
            truth = earth @ rotation_z(heading * DEG) / DEG
            error = np.array(unit) + own + 0.2 * rng.standard_normal(3)
            rows.append([heading, *(truth + error / 3600), session])
    head = "heading_deg,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s,session"
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.12g")
    return str(path)


def test_a_constant_that_turns_no_heading_is_no_gain(cli, tmp_path):
    """Of the vertical gyro alone: recordings show it beyond doubt, and no heading is better for it.
    The table's means are of many samples: what is expected before is what `bound` says."""
    means(tmp_path / "table.csv", range(12), unit=(0, 0, 3), power_up=(1, 1, 0.1))
    base = ("imu=sdc500", "mean_s=240", "latitude=34.37746770784939")
    done = cli("lbgc.calibrate", "means=table.csv", *base)
    assert done.code == 0, done.err
    factor = float(re.search(r"constant of this unit against none: ([+-][\d.]+)", done.out)[1])
    assert factor > 2
    assert "whatever constant these recordings show, it makes no heading better" in done.out
    before = float(re.search(r"([\d.]+) deg before", done.out)[1])
    bound = cli("lbgc.bound", "imu=sdc500", base[-1], "windows_s=[240]")
    floor = json.loads((tmp_path / bound.last_line / "bound.json").read_text())["bounds"][0]
    assert before == pytest.approx(floor["floor_deg"], rel=0.02)


def test_an_update_is_what_all_recordings_at_once_give(cli, tmp_path):
    """By a split that is stated: what two files tell one after the other, and both in one."""
    base = ("imu=sdc500", "latitude=34.37746770784939", "mean_s=240", "split=stated")
    imu = ("imu.gyro.bias_unit_deg_per_h=1.5", "imu.gyro.bias_session_deg_per_h=0.3",
           "imu.gyro.bias_run_deg_per_h=0.2")  # fmt: skip
    found = {}
    for name, sessions in (("first", range(4)), ("second", range(4, 9))):
        means(tmp_path / f"{name}.csv", sessions)
    both = [(tmp_path / f"{name}.csv").read_text().splitlines() for name in ("first", "second")]
    (tmp_path / "all.csv").write_text("\n".join([*both[0], *both[1][1:]]) + "\n")
    for name, more in (("first", ()), ("second", ("first",)), ("all", ())):
        old = [f"calibration={found[own]}" for own in more]
        done = cli("lbgc.calibrate", f"means={name}.csv", *base, *imu, *old)
        assert done.code == 0, done.err
        found[name] = Path(done.last_line).with_name("unit.json").rename(tmp_path / f"{name}.json")
    one, two = (json.loads(found[name].read_text()) for name in ("second", "all"))
    assert (one["recordings"], one["sessions"]) == (two["recordings"], two["sessions"])
    order = [two["coefficients"].index(own) for own in one["coefficients"]]
    sigma = np.sqrt(np.diag(two["covariance"]))[order]
    off = np.array(one["mean"]) - np.array(two["mean"])[order]
    assert np.abs(off / sigma).max() < 0.02  # linear about another mean
    whole = np.array(two["covariance"])[np.ix_(order, order)]
    assert np.abs((np.array(one["covariance"]) - whole) / sigma / sigma[:, None]).max() < 0.01
    again = cli("lbgc.calibrate", "means=first.csv", *base, *imu, f"calibration={found['second']}")
    assert again.code == 2
    assert "of which the file has recordings already" in again.err


def test_a_power_up_that_is_known_is_not_another(cli, of_one_unit):
    """Errors of a power-up are known until it is switched off."""
    refused = cli("lbgc.calibrate", "data=labelled.zarr", "now=noon")
    assert refused.code == 2
    assert "now = noon" in refused.err
    done = cli("lbgc.calibrate", "data=labelled.zarr", "now=2")
    assert "of power-up 2" in done.out
    path = f"calibration={Path(done.last_line).with_name('unit.json')}"
    other = cli("lbgc.evaluate", "data=asked.zarr", path)
    assert other.code == 2
    assert "is the power-up that it knows" in other.err


def test_a_file_that_is_not_this_units_is_refused(cli, of_one_unit):
    done = cli("lbgc.calibrate", "data=labelled.zarr")
    path = Path(done.last_line).with_name("unit.json")
    whole = path.read_text()
    for content, option in (
        (whole.replace('"recordings": 12', '"recordings": 13'), None),
        (whole, "imu=stim300"),
        ("{]", None),
        ("[]", None),
        (None, None),
    ):
        if content is None:
            path.unlink()
        else:
            path.write_text(content)
        options = () if option is None else (option,)
        refused = cli("lbgc.evaluate", "data=asked.zarr", *options, f"calibration={path}")
        assert refused.code == 2
        assert "calibration = " in refused.err.splitlines()[-1]


def test_known_in_two_ways_is_refused(cli):
    for module, more in (("lbgc.evaluate", "data=x.zarr"), ("lbgc.bound", "imu=stim300")):
        done = cli(module, more, "known=[unit]", "calibration=x.json")
        assert done.code == 2
        assert "known" in done.err


def test_what_k_recordings_buy_has_a_closed_form():
    """One axis: of a bias u that stays and r that is new, and of noise n in each mean, k labels
    leave 1/(1/u^2 + k/(r^2 + n^2)) of the variance u^2, and r^2 + n^2 beside."""
    u, r = 0.02 * DEG / HOUR, 0.01 * DEG / HOUR
    case = Case("", "ideal", STATIC, 0.0, overrides=("imu.gyro.arw_deg_per_sqrt_h=0.001",))
    imu = case.model()
    imu = replace(imu, gyro=imu.gyro.with_bias(unit=(u,) * 3, run=(r,) * 3))
    site, course = Site.at(40 * DEG), Course.planned(np.zeros(4), 60.0)
    n = imu.gyro.N[0] / np.sqrt(240.0)
    for k in (0, 1, 3, 10, 100):
        known = labelling.after(imu, course, site, k, None, Reference(np.zeros(1)))
        found = np.sqrt(small_errors(information(known, course, site)))
        left = 1 / (1 / u**2 + k / (r**2 + n**2)) + r**2 + n**2
        assert found == pytest.approx(np.sqrt(left) / site.north, rel=1e-3)
    assert "100 labelled recordings" not in labelling.enough(lambda k: 1 + 9 / (k + 1))
    assert "buy nothing here" in labelling.enough(lambda k: 1 + 0.01 / (k + 1))
    one = labelling.after(imu, course, site, 100, 1, Reference(np.zeros(1)))
    assert one.gyro.bias("unit") == pytest.approx(known.gyro.bias("unit"))  # there is no session


def test_bound_tells_how_many_to_make(cli, tmp_path):
    done = cli("lbgc.bound", "imu=sdc500", *BIAS, "labelled=[0,3,30]", "windows_s=[240]")
    assert done.code == 0, done.err
    said = json.loads((tmp_path / done.last_line / "bound.json").read_text())["labelled"]
    sizes = [row["floor_deg"] for row in said]
    assert [row["labelled"] for row in said] == [0, 3, 30]
    assert sizes == sorted(sizes, reverse=True)
    assert "after any number of them" in done.out
    assert (tmp_path / done.last_line / "labelled.png").exists()
    refused = cli("lbgc.bound", "imu=sdc500", "labelled=[-1]")
    assert refused.code == 2
    assert "labelled" in refused.err
