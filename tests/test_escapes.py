"""A directory that is brought along, or a command line that somebody sent, runs nothing, reads and
writes nowhere else, and tells no secret. A thousand more: `make study-fuzz`."""

import json
import os
import subprocess
import sys
from dataclasses import asdict
from types import SimpleNamespace

import pytest
from escapes import EXAMPLES, KINDS
from helpers import ROOT
from omegaconf import OmegaConf

from lbgc import command_line, user_yaml
from lbgc.commands import as_written
from lbgc.errors import InputError
from lbgc.sensor.datasheet import GyroConfig, ImuConfig


def test_nothing_gets_out():
    """In a process of its own, under an audit hook."""
    count = len(EXAMPLES) + len(KINDS)
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests/escapes.py"), "1", "0", str(count)],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert found == {"variants": count, "escapes": []}


@pytest.fixture
def mine(tmp_path):
    """A directory that is brought along."""
    files = {
        "imu/mine.yaml": "name: mine\ngyro: {arw_deg_per_sqrt_h: 15e-2}",
        "imu/based.yaml": "defaults: [stim300, _self_]\nname: based",
        "imu/twice.yaml": "defaults: [based, _self_]\nname: twice",
        "imu/broken.yaml": "a: b: c",
        "protocol/slow.yaml": "kind: carousel\ncarousel_deg_per_s: 3",
        "experiment/e.yaml": "defaults: [{override /imu: twice}, {override /protocol: slow}]\n"
                             "recordings: 3\nimu: {gyro: {tone_hz: 5}}",
    }  # fmt: skip
    for name, text in files.items():
        (tmp_path / "brought" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "brought" / name).write_text(text)
    return tmp_path / "brought"


def composed(cli, entry: str, *arguments: str):
    done = cli(entry, *arguments, "--cfg", "job")
    assert done.code == 0, done.err
    return SimpleNamespace(**OmegaConf.to_container(OmegaConf.create(done.out)))


def test_a_file_is_composed_as_one_of_ours(cli, mine):
    """Also with figures on the command line, a base, and an experiment that names several."""
    asked = ("--config-dir", str(mine))
    imu = composed(cli, "lbgc.bound", *asked, "imu=mine", "imu.gyro.tone_hz=7").imu
    gyro = GyroConfig(arw_deg_per_sqrt_h=0.15, tone_hz=7)
    assert imu == as_written(asdict(ImuConfig(name="mine", gyro=gyro)))
    sheet = composed(cli, "lbgc.bound", "imu=stim300").imu
    based = composed(cli, "lbgc.bound", *asked, "imu=twice", "protocol=slow")
    assert based.imu == sheet | {"name": "twice"}
    assert based.protocol["carousel_deg_per_s"] == 3
    named = composed(cli, "sim.generate", *asked, "experiment=e", "recordings=4")
    assert named.imu["gyro"] == sheet["gyro"] | {"tone_hz": 5}
    assert (named.recordings, named.protocol["kind"]) == (4, "carousel")


def test_a_sweep_goes_over_them(cli, mine):
    options = ("protocol=static", "windows_s=[10]", "--multirun", "imu=mine,twice")
    done = cli("lbgc.bound", "--config-dir", str(mine), *options)
    assert done.code == 0, done.err
    assert [name in done.out for name in ("mine", "twice")] == [True, True]


@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_a_sweep_goes_over_them_in_other_processes(mine, launcher):
    pytest.importorskip(f"hydra_plugins.hydra_{launcher.split('_')[0]}_launcher")
    done = subprocess.run(
        [sys.executable, str(ROOT / "lbgc/bound.py"), "--config-dir", str(mine), "--multirun",
         f"hydra/launcher={launcher}", "protocol=static", "windows_s=[10]", "imu=twice,ideal"],
        cwd=mine, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert list((mine / "outputs").iterdir())


def test_what_is_refused_is_named(cli, mine):
    """A file of another's is no hindrance, unless it is asked for; a name of ours is one."""
    asked = ("--config-dir", str(mine))
    assert "broken.yaml: is refused (mapping values" in cli("lbgc.bound", *asked, "imu=broken").err
    assert "--config-dir = nowhere: is no directory" in cli("lbgc.bound", "-cd", "nowhere").err
    (mine / "imu/stim300.yaml").write_text("")
    done = cli("lbgc.bound", *asked, "imu=stim300")
    assert "stim300.yaml: has the name of a file that comes with lbgc" in done.err


def test_the_environment_is_said_aloud(cli, monkeypatch):
    monkeypatch.setenv("MY_SENSOR", "number 7")
    options = ("imu=ideal", "protocol=static", "windows_s=[10]")
    done = cli("lbgc.bound", "imu.name=${oc.env:MY_SENSOR}", *options)
    assert done.code == 0
    assert "note: MY_SENSOR is taken from the environment" in done.err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["hydra.sweep.dir=x"], "key = hydra.sweep.dir: choose from hydra/launcher"),
        (["hydra.launcher.setup=[x]"], "choose from hydra/launcher"),
        (["hydra.launcher.partition='a b'"], "must be a number or one word"),
        (["hydra/launcher=ray"], "choose from basic, joblib"),
        (["imu=../x"], "must be a choice's name, and no path"),
        (["imu@hydra=ideal"], "cannot be put elsewhere"),
        (["--config-path", "x"], "option = --config-path: choose from --help"),
        (["--experimental-re=x"], "option = --experimental-re=x"),
        (["--cfg"], "option = --cfg/-c: expected one argument"),
    ],
)
def test_what_a_command_line_may_not_say(cli, words, says):
    done = cli("lbgc.bound", *words)
    assert done.code == 2
    assert says in done.err


def test_what_hydra_is_told_of_a_command_line():
    taken = command_line.taken_apart(["-m", "a=1,2", "--cfg=job", "b=3", "--verify", "--inf"])
    assert taken == (None, True, ["--multirun", "--cfg=job", "--info=all"], ["a=1,2", "b=3"])


def test_our_own_files_could_be_brought_along(tmp_path):
    """What they say is no more than what a user's may."""
    for group in ("imu",):
        (tmp_path / group).mkdir()
        for file in (ROOT / "conf" / group).glob("*.yaml"):
            (tmp_path / group / file.name).write_bytes(file.read_bytes())
        found = user_yaml.read(tmp_path, group, ImuConfig)
        assert len(found) > 10
        assert not [error for error in found.values() if isinstance(error, InputError)]
