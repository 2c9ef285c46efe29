"""A name stands for one thing; and what an interrupted or damaged run left is mended by running it
again."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from fuzzing import model_files
from helpers import composed, default_config, generate

import lbgc.bound
import lbgc.train
from lbgc import sweeps
from lbgc.data import picture
from lbgc.errors import InputError
from lbgc.evaluate import KNOWN
from lbgc.fit import FitConfig
from lbgc.learning import description
from lbgc.learning.model import ModelConfig
from lbgc.report import history
from lbgc.sweeps import Ended
from lbgc.train import TrainConfig

TAKEN = (*KNOWN, "Mean", "FLOOR", "floor, unit known", "Floor, x", "\uff4d\uff45\uff41\uff4e",
         "m\u200bean", "me\u00adan", " mean", "mean\n", "floor\u2060", "\ufb02oor")  # fmt: skip


@pytest.mark.parametrize("name", TAKEN)
def test_a_network_has_no_estimators_name(name):
    with pytest.raises(InputError, match="name = "):
        ModelConfig(name=name)


def test_a_network_may_be_called_otherwise():
    for name in ("mean 2", "my floor", "gls_net", "bilstm_24", "Größe"):
        assert ModelConfig(name=name).name == name


@pytest.mark.parametrize("name", ["mean", "floor", "gls", "floor, run known"])
def test_neither_on_the_command_line_nor_in_a_sealed_file(cli, tmp_path, name):
    done = cli("lbgc.train", "data=x", f"model.name='{name}'")
    assert done.code == 2
    assert "is an estimator's" in done.err
    home = tmp_path / "run"
    home.mkdir()
    for file, content in model_files().items():
        (home / file).write_bytes(content)
    said = json.loads((home / description.DESCRIPTION).read_bytes())
    weights = next(home.glob("*.safetensors")).read_bytes()
    said = {k: v for k, v in said.items() if k not in ("format", "weights", "checksum")}
    said["model"]["name"] = name
    (home / description.DESCRIPTION).write_bytes(description.compose(said, weights))
    with pytest.raises(InputError, match="is an estimator's"):
        description.read(home)


def test_a_run_called_as_another_estimator_is_refused(cli, monkeypatch, trained):
    """Whatever its name collides with: the later one would answer for both."""
    home, _, run = trained
    name = description.read(run)["model"]["name"]
    monkeypatch.setitem(KNOWN, name, KNOWN["mean"])
    done = cli("lbgc.evaluate", f"data={home / 'd.zarr'}", f"run={run}", f"estimators=[{name}]",
               "windows_s=[10]")  # fmt: skip
    assert done.code == 2
    assert "is another estimator's name here" in done.err


def test_a_protocol_called_as_another_does_not_take_its_curve(monkeypatch):
    monkeypatch.setattr(lbgc.bound, "bounds", lambda *_: [])
    asked = composed(lbgc.bound.BoundConfig, "bound", "protocol=indexed", "windows_s=[60]")
    for name, kind in (("static", "indexed"), ("carousel", "indexed"), ("two_position", "static")):
        own = replace(asked.protocol, name=name, kind=kind, angles_deg=(0.0, 120.0), dwell_s=None)
        curves = lbgc.bound._curves(replace(asked, protocol=own))
        assert f"{name} (chosen)" in curves
        assert len(curves) == 5
    own = replace(asked.protocol, name="two_position", kind="indexed", angles_deg=(0.0, 180.0))
    assert len(lbgc.bound._curves(replace(asked, protocol=own))) == 4


@pytest.mark.parametrize("name", ["stim300", "kvh1775"])
def test_a_fitted_sensor_has_no_shipped_ones_name(name):
    with pytest.raises(InputError, match="is a sensor's that lbgc has"):
        FitConfig(data="x", name=name)
    assert FitConfig(data="x", name="mine").name == "mine"


# --- sweeps ---------------------------------------------------------------------------------------


def test_a_sweep_does_not_take_what_another_left(tmp_path, monkeypatch):
    """One that was killed, and whose process's number came again."""
    monkeypatch.chdir(tmp_path)
    stale = Ended(0, "seed=1", "outputs/train/old", None)
    for name in (f"sweep_{os.getpid()}", "sweep_1"):
        (tmp_path / "outputs/multirun" / name).mkdir(parents=True)
        (tmp_path / "outputs/multirun" / name / "0.json").write_text(json.dumps(vars(stale)))
    seen = set()
    for _ in range(3):
        with sweeps.sweep() as directory:
            assert sweeps.ended(directory) == []
            sweeps.report(Ended(1, "seed=2", None, "no"))
            assert [job.number for job in sweeps.ended(directory)] == [1]
            seen.add(directory)
        assert not directory.exists()
    assert len(seen) == 3
    assert (tmp_path / f"outputs/multirun/sweep_{os.getpid()}/0.json").exists()


# --- a run's history ------------------------------------------------------------------------------

DAMAGES = {
    "cut": lambda content: content[: len(content) // 2], "nothing": lambda _: b"",
    "half a number": lambda content: content[:-3] + b"\n", "text": lambda _: b"step,all\n1,x\n",
    "another figure": lambda content: content.replace(b"15,", b"14,", 1), "nul": lambda _: b"\0",
    "a row more": lambda content: content + content.splitlines()[-1] + b"\n",
    "a formula": lambda content: content + b"=1+1,2,3,4,5\n", "no UTF-8": lambda _: b"\xff\xfe",
}  # fmt: skip


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    home = tmp_path_factory.mktemp("trained")
    data = generate(home / "d.zarr", protocol=default_config("protocol=static").protocol,
                    recordings=12, duration_s=20.0, output="means", split=[1, 1, 1])  # fmt: skip
    options = (f"data={data.path}", "steps=30", "validate_every=15", "windows_s=[10]", "batch=4",
               "model=bilstm_8")  # fmt: skip
    config = composed(TrainConfig, "train", *options)
    before = os.getcwd()
    os.chdir(home)
    try:
        run = lbgc.train.main(config).resolve()
    finally:
        os.chdir(before)
    return home, config, run


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_damaged_history_is_noticed(trained, kind):
    _, _, run = trained
    content = (run / history.FILE).read_bytes()
    own = description.read(run)["history"]
    assert history.checksum(content) == own
    rows = history.read(run / history.FILE, own)
    assert [row["step"] for row in rows] == [15.0, 30.0]
    try:
        (run / history.FILE).write_bytes(DAMAGES[kind](content))
        with pytest.raises(InputError, match="makes it anew"):
            history.read(run / history.FILE, own)
    finally:
        (run / history.FILE).write_bytes(content)


def test_an_earlier_versions_run_has_no_checksum_of_it(trained):
    _, _, run = trained
    assert len(history.read(run / history.FILE, None)) == 2
    assert description.Description.__dataclass_fields__["history"].default is None


def test_it_is_evaluated_without_its_curve_and_mended_by_training_again(
    trained, cli, monkeypatch, capsys
):
    home, config, run = trained
    names = ("history.csv", "model.safetensors")
    whole = {name: (run / name).read_bytes() for name in names}
    (run / "history.csv").write_bytes(whole["history.csv"][:-9])
    asked = (f"data={home / 'd.zarr'}", f"run={run}", "windows_s=[10]")
    done = cli("lbgc.evaluate", *asked)
    assert done.code == 0, done.err
    page = Path(done.last_line).read_text()
    assert "no loss curve: history.csv is damaged" in page
    assert ">Loss curve<" not in page
    monkeypatch.chdir(home)
    capsys.readouterr()
    lbgc.train.main(config)
    assert "training it again" in capsys.readouterr().out
    assert {name: (run / name).read_bytes() for name in names} == whole
    monkeypatch.chdir(home.parent)
    assert ">Loss curve<" in Path(cli("lbgc.evaluate", *asked).last_line).read_text()


def test_a_link_is_no_history(trained, cli):
    home, _, run = trained
    file = run / history.FILE
    content = file.read_bytes()
    (home / "secret").write_text("step,all,score\n1,2,3\n")
    file.unlink()
    file.symlink_to(home / "secret")
    try:
        with pytest.raises(InputError, match="is damaged"):
            history.read(file, None)
    finally:
        file.unlink()
        file.write_bytes(content)


@pytest.mark.parametrize("spoil", ["half", "link", "absent"])
def test_a_damaged_loss_curve_is_drawn_again(trained, monkeypatch, capsys, spoil):
    home, config, run = trained
    file = run / "loss.png"
    drawn = file.read_bytes()
    file.unlink()
    if spoil == "half":
        file.write_bytes(b"\x89PNG")
    elif spoil == "link":
        file.symlink_to(home / "elsewhere.png")
    monkeypatch.chdir(home)
    lbgc.train.main(config)
    assert "already finished" in capsys.readouterr().out
    assert picture.read(file) is not None
    assert file.read_bytes() == drawn
    assert not (home / "elsewhere.png").exists()
