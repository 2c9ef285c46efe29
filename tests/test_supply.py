"""What is installed is what the locks say; and the locks, the constraints, pyproject.toml, the bill
of materials and the page of licences say the same."""

import json
import re
import shlex
import subprocess
import tomllib

import licences
import pytest
from helpers import ROOT
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PROJECT["project"]["optional-dependencies"]
LOCKS = ("requirements.lock", "requirements-cuda.lock", "requirements-bench.lock")


def locked(name: str) -> dict[str, tuple[str, list[str]]]:
    """Version and checksums of each package of a lock, in which nothing else may stand."""
    text = re.sub(r" *#.*", "", (ROOT / name).read_text()).replace("\\\n", "")
    found = {}
    for line in filter(str.strip, text.splitlines()):
        pinned, *hashes = line.split()
        package, version = pinned.split("==")
        assert package not in found
        found[package] = version, hashes
    return found


def pins(text: str) -> dict[str, str]:
    """Version by package, of a file of `name==version`."""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in (x.split("==") for x in lines)}


CONSTRAINTS = pins((ROOT / "constraints.txt").read_text())


@pytest.mark.parametrize("name", LOCKS)
def test_a_lock_has_the_constraints_versions_and_a_checksum_for_each_file(name):
    lock = locked(name)
    assert {package: version for package, (version, _) in lock.items()} == {
        package: CONSTRAINTS[package] for package in lock
    }
    for package, (_, hashes) in lock.items():
        assert hashes, package
        assert len(hashes) == len(set(hashes)), package
        assert all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", said) for said in hashes), package


def test_each_package_is_in_one_lock():
    assert len(set().union(*map(locked, LOCKS))) == sum(len(locked(name)) for name in LOCKS)


@pytest.mark.parametrize(
    ("asked", "names"),
    [
        (PROJECT["project"]["dependencies"], LOCKS[:1]),
        (EXTRAS["dev"] + EXTRAS["onnx"], LOCKS[:1]),
        (EXTRAS["bench"] + EXTRAS["dask"], (LOCKS[0], LOCKS[2])),
        (PROJECT["build-system"]["requires"], LOCKS[:1]),
    ],
    ids=["project", "dev and onnx", "bench and dask", "build"],
)
def test_what_the_project_asks_for_is_locked(asked, names):
    lock = {package: version for name in names for package, (version, _) in locked(name).items()}
    for requirement in map(Requirement, asked):
        assert lock[canonicalize_name(requirement.name)] in requirement.specifier


def test_the_build_backend_is_pinned():
    (version, _) = locked("requirements.lock")["setuptools"]
    assert PROJECT["build-system"]["requires"] == [f"setuptools=={version}"]


def test_the_lock_has_both_builds_of_pytorch():
    """The CPU's is in no index that `make lock` asks: the Makefile has its checksum."""
    (line,) = re.findall(r"^TORCH_CPU := (.*)$", (ROOT / "Makefile").read_text(), flags=re.M)
    version, checksum = line.split()
    of_version, hashes = locked("requirements.lock")["torch"]
    assert version == of_version
    assert checksum in hashes
    assert len(hashes) > 1
    assert "triton" in locked("requirements-cuda.lock")


def test_make_installs_from_the_locks_alone():
    """Each call of pip that installs asks for checksums; the project itself brings nothing."""
    command = ["make", "-nB", ".venv/.peers"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    calls = re.findall(r"-m pip .*? install ([^;\n]*)", done.stdout.replace("\\\n", ""))
    files = []
    for call in map(shlex.split, calls):
        assert {"--no-deps", "--no-build-isolation"} < set(call)
        if "-e" in call:
            assert call[-2:] == ["-e", "."]
        else:
            assert "--require-hashes" in call
            files.append(call[call.index("-r") + 1])
    assert files == [".venv/setuptools.lock", *LOCKS]


def test_the_bill_of_materials_names_what_is_locked():
    found = json.loads((ROOT / "docs/sbom.cdx.json").read_text())
    assert (found["bomFormat"], found["specVersion"]) == ("CycloneDX", "1.6")
    assert not {"serialNumber", "timestamp"} & {*found, *found["metadata"]}
    named = {canonicalize_name(part["name"]): part["version"] for part in found["components"]}
    named["torch"] = named["torch"].removesuffix("+cpu")
    assert named == {name: version for name, (version, _) in locked("requirements.lock").items()}
    assert found["metadata"]["component"]["version"] == PROJECT["project"]["version"]


def test_the_page_of_licences_names_what_is_locked():
    rows = re.findall(r"^\| (\S+) \| (\d\S*) \| (.+) \|$", licences.PAGE.read_text(), flags=re.M)
    named = {canonicalize_name(name): version.removesuffix("+cpu") for name, version, _ in rows}
    assert named == {name: version for name, (version, _) in locked("requirements.lock").items()}
    said = [{"Name": name, "Version": version, "License": x} for name, version, x in rows]
    again = licences.page([row | {"License": row["License"].removesuffix(" *")} for row in said])
    assert again == licences.PAGE.read_text(), "the page is behind its program: make sbom"


@pytest.mark.parametrize("licence", ["UNKNOWN", "GNU General Public License v3 (GPLv3)", "a\nb"])
def test_a_licence_that_nobody_has_read_ends_the_page(licence):
    with pytest.raises(ValueError, match="pack says of its licence"):
        licences.page([{"Name": "pack", "Version": "1", "License": licence}])
