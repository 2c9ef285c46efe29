"""A unit of one's own: labelled recordings become a file, and what takes it is better for it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from floor_cases import STATIC, Case
from test_evaluate import results

from lbgc import labelling
from lbgc.estimators.block_means import Course, Site
from lbgc.estimators.floor import small_errors
from lbgc.estimators.information import information
from lbgc.estimators.unit_posterior import Reference
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


def test_an_update_goes_on_from_the_file(cli, of_one_unit):
    """By the split that the first recordings were given, one file by all recordings, and one that
    is updated, know the same."""
    whole = cli("lbgc.calibrate", "data=asked.zarr", "split=stated")
    first = cli("lbgc.calibrate", "data=labelled.zarr", "split=stated")
    both = cli("lbgc.calibrate", "data=asked.zarr", "split=stated",
               f"calibration={Path(first.last_line).with_name('unit.json')}")  # fmt: skip
    assert both.code == 0, both.err
    assert "by 52 labelled recordings of 40 power-ups" in both.out
    one, two, three = (
        json.loads(Path(own.last_line).with_name("unit.json").read_text())
        for own in (whole, first, both)
    )
    precision = [np.linalg.inv(np.array(own["covariance"])[:3, :3]) for own in (one, two, three)]
    prior = np.eye(3) / (1.5 * DEG / HOUR) ** 2
    joint = precision[0] + precision[1] - prior
    assert np.allclose(precision[2] / joint[0, 0], joint / joint[0, 0], atol=0.03)


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
