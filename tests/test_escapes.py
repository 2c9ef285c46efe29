"""A directory that is brought along, or a command line that somebody sent, runs nothing, reads and
writes nowhere else, and tells no secret. A thousand more: `make study-fuzz`."""

import json
import os
import re
import subprocess
import sys
import time
from dataclasses import asdict
from types import SimpleNamespace

import pytest
from escapes import EXAMPLES, KINDS
from helpers import ROOT
from hydra.core.override_parser.overrides_parser import OverridesParser
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


def test_a_link_stays_in_the_directory(cli, mine, tmp_path):
    """One to a file within is as good as the file; one that leads out could show what is there."""
    (tmp_path / "secret.yaml").write_text("name: secret")
    (mine / "imu/within.yaml").symlink_to("twice.yaml")
    (mine / "imu/without.yaml").symlink_to(tmp_path / "secret.yaml")
    (mine / "protocol").rename(tmp_path / "elsewhere")
    (mine / "protocol").symlink_to(tmp_path / "elsewhere")
    asked = ("--config-dir", str(mine))
    assert composed(cli, "lbgc.bound", *asked, "imu=within").imu["name"] == "twice"
    for group, name in (("imu", "without"), ("protocol", "slow")):
        done = cli("lbgc.bound", *asked, f"{group}={name}")
        assert f"{name}.yaml: is refused (a link that leads out of the directory)" in done.err


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
        (["hydra/launcher=null"], "hydra/launcher = null: choose from basic, joblib"),
        (["-m", "hydra/sweeper=null"], "hydra/sweeper = null: choose from basic, optuna"),
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


GROUPS = sorted(place.name for place in (ROOT / "conf").iterdir() if place.is_dir())


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize(
    "value", ["null", "", "''", "none", "[]", "[ideal,stim300]", "{}", "1", "true"]
)
def test_a_group_that_is_set_to_no_choice_is_refused_by_its_name(group, value):
    """Hydra would make [] and {} the defaults of all keys, and [a,b] a mixture of two sensors."""
    (override,) = OverridesParser.create().parse_overrides([f"{group}={value}"])
    with pytest.raises(InputError, match=rf"^{group} = {re.escape(value)}: choose from one, two$"):
        command_line.require_allowed(override, {group: ["one", "two"]})


@pytest.mark.parametrize("value", ["null,ideal", "ideal,null", "1,2", "range(1,3)", "~"])
def test_a_sweep_over_what_is_no_choice_is_refused_in_one_line(cli, value):
    done = cli("lbgc.bound", "-m", f"imu={value}")
    assert done.code == 2
    assert done.err.startswith(f"error: imu = {value}: choose from adis16405")
    assert len(done.err.splitlines()) == 1


@pytest.mark.parametrize("value", ["ideal", "'ideal'", "ideal,'stim300'", "glob(i*)", "a.b"])
def test_a_choice_may_be_a_name_or_a_sweep_of_names(value):
    for override in OverridesParser.create().parse_overrides([f"imu={value}", "~imu", "~imu=x"]):
        command_line.require_allowed(override, {"imu": ["ideal"]})


def test_a_file_of_many_keys_is_refused_as_fast_as_a_list_of_them():
    """The least of three runs: within 10 times; with each key held against all others it was 55."""
    keys = "".join(f"{i:x}:\n" for i in range(16_000)).encode()
    listed = b"a:\n" + b"".join(b"- %x\n" % i for i in range(14_000))

    def cost(text: bytes) -> float:
        start = time.process_time()
        with pytest.raises(ValueError, match="10000 values"):
            user_yaml.parse(text)
        return time.process_time() - start

    assert min(cost(keys) for _ in range(3)) < 10 * min(cost(listed) for _ in range(3))


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
