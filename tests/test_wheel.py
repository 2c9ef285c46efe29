"""What a wheel holds, built without a network: all of the project in lbgc, nothing beside."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
from helpers import ROOT, generate

from lbgc.data.store import Dataset

PLACES = {"lbgc": "lbgc", "sim": "lbgc/sim", "conf": "lbgc/conf"}
"""Of the checkout, and where a wheel has them."""
OTHERS = ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE")


def build(project: Path, kind: str, out: Path) -> Path:
    """A wheel, an sdist or an editable wheel of the project, as pip has it built."""
    out.mkdir(exist_ok=True)
    call = f"from setuptools import build_meta as b; print(b.build_{kind}({str(out)!r}))"
    command = [sys.executable, "-c", call]
    done = subprocess.run(command, cwd=project, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out / done.stdout.splitlines()[-1]


def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as files:
        return set(files.namelist())


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A copy of the checkout: setuptools leaves traces in what it builds."""
    required = re.search(r"setuptools==([\d.]+)", (ROOT / "pyproject.toml").read_text())
    try:
        good = version("setuptools") == required[1]
    except PackageNotFoundError:
        good = False
    if not good:
        pytest.skip(f"needs {required[0]} here, to build without a network")
    home = tmp_path_factory.mktemp("project")
    for part in PLACES:
        left = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / part, home / part, ignore=left)
    for name in OTHERS:
        shutil.copy(ROOT / name, home)
    return home


@pytest.fixture(scope="module")
def wheel(project):
    return build(project, "wheel", project / "wheels")


def test_a_wheel_holds_all_of_the_project_in_one_package(wheel):
    expected = {
        f"{place}/{file.relative_to(ROOT / part).as_posix()}"
        for part, place in PLACES.items()
        for file in (ROOT / part).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    assert {"lbgc/sim/turntable.xml", "lbgc/conf/imu/stim300.yaml", "lbgc/py.typed"} <= expected
    found = names(wheel)
    information = {name for name in found if name.startswith("lbgc-")}
    assert found - information == expected
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in information)


def test_the_sdist_builds_the_same_wheel(project, wheel, tmp_path):
    with tarfile.open(build(project, "sdist", project / "sdists")) as files:
        files.extractall(tmp_path, filter="data")
    (unpacked,) = tmp_path.iterdir()
    again = build(unpacked, "wheel", tmp_path / "wheels")
    with zipfile.ZipFile(wheel) as first, zipfile.ZipFile(again) as second:
        assert {i.filename: i.CRC for i in first.infolist()} == {
            i.filename: i.CRC for i in second.infolist()
        }


def test_an_editable_install_is_the_checkout_as_it_lies(project):
    """lbgc and sim, and no lbgc.sim: it would be a second copy of each module of the bench."""
    with zipfile.ZipFile(build(project, "editable", project / "editables")) as files:
        (finder,) = (name for name in files.namelist() if name.endswith("_finder.py"))
        mapping = re.search(r"MAPPING.*= (\{.*\})", files.read(finder).decode())
    assert re.findall(r"'([\w.]+)': '", mapping[1]) == ["lbgc", "sim"]


def test_what_a_wheel_holds_runs_from_any_directory(wheel, tmp_path):
    site, home = tmp_path / "site", tmp_path / "home"
    home.mkdir()
    with zipfile.ZipFile(wheel) as files:
        files.extractall(site)

    def run(module: str, *options: str) -> subprocess.CompletedProcess:
        return subprocess.run(
            [sys.executable, "-m", module, *options],
            cwd=home,
            capture_output=True,
            text=True,
            env=os.environ | {"PYTHONPATH": str(site)},
        )

    by = ("cluster=local", "cluster.workers=1")  # another process, which knows modules by name
    done = run("lbgc.sim.generate", "recordings=2", "duration_s=10", "rate_hz=25", *by)
    assert done.returncode == 0, done.stderr
    assert "No module named" not in done.stderr  # of the picture
    here = generate(tmp_path / "here.zarr", recordings=2, duration_s=10.0, rate_hz=25.0)
    made = Dataset.open_finished(home / "outputs/generate/latest/dataset.zarr")
    assert made.digest() == here.digest()
    refused = run("lbgc.bound", "latitude=91")
    assert (refused.returncode, "latitude = 91.0" in refused.stderr) == (2, True), refused.stderr
