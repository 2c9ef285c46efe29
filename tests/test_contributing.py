"""CONTRIBUTING.md: every example, put into a copy of the project, does what it says; and whatever
the documents for engineers name is there."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import contributed
import numpy as np
import pytest
from helpers import ROOT

from lbgc.data.store import Dataset
from lbgc.protocol import REST

DOCUMENTS = ("CONTRIBUTING.md", "docs/architecture.md", "docs/glossary.md")
_SECTION = re.compile(r"^## (.*)\n((?:(?!^## ).*\n)*)", re.MULTILINE)
_BLOCK = re.compile(r"^```(\w+)(.*)\n((?:(?!```).*\n)*)```$", re.MULTILINE)
_TITLE = re.compile(r'(title|before)="([^"]+)"')


@dataclass
class Example:
    """A section of CONTRIBUTING.md: what is written where, and what is typed then."""

    blocks: list[tuple[str, str, str | None, str]] = field(default_factory=list)
    """Language, path, what a block stands before (None: at the end), content."""
    commands: list[str] = field(default_factory=list)


def examples() -> dict[str, Example]:
    found: dict[str, Example] = {}
    for title, text in _SECTION.findall((ROOT / "CONTRIBUTING.md").read_text()):
        own = Example()
        for language, info, content in _BLOCK.findall(text):
            said = dict(_TITLE.findall(info))
            if said:
                own.blocks.append((language, said["title"], said.get("before"), content))
            elif language == "bash":
                own.commands += content.replace("\\\n", "").splitlines()
        if own.blocks:
            found[title] = own
    return found


EXAMPLES = examples()
OUTSIDE = [title for title, own in EXAMPLES.items() if own.blocks[0][1].startswith("mine/")]
INSIDE = [title for title in EXAMPLES if title not in OUTSIDE]


def put(home: Path, language: str, path: str, before: str | None, content: str) -> None:
    """A block to its place: a diff changes a file, code joins one that is there, else it is one."""
    file = home / path
    if language == "diff":
        file.write_text(patched(file.read_text(), content, path))
    elif file.exists():
        text = file.read_text()
        at = len(text) if before is None else re.search(f"^{before}\\b", text, re.MULTILINE).start()
        if before is not None:
            at = text.rindex("\n\n\n", 0, at) + 3
        after = text[at:]
        file.write_text(f"{text[:at].rstrip()}\n\n\n{content}" + (f"\n\n{after}" if after else ""))
    else:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content)


def patched(text: str, diff: str, path: str) -> str:
    """The text with every hunk of a diff done, one below the other: what a hunk takes away, and
    what it keeps, must be there."""
    at = 0
    for hunk in diff.split("@@\n")[1:]:
        lines = hunk.splitlines(keepends=True)
        old = "".join(line[1:] for line in lines if line[0] in " -")
        new = "".join(line[1:] for line in lines if line[0] in " +")
        assert old in text[at:], f"{path} has no\n{old}"
        start = text.index(old, at)
        text = text[:start] + new + text[start + len(old) :]
        at = start + len(new)
    return text


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """The project with all examples in it."""
    home = tmp_path_factory.mktemp("project")
    for part in ("lbgc", "sim", "conf"):
        left = shutil.ignore_patterns("__pycache__", "pretrained")
        shutil.copytree(ROOT / part, home / part, ignore=left)
    shutil.copy(ROOT / "pyproject.toml", home)
    for title in INSIDE:
        for block in EXAMPLES[title].blocks:
            put(home, *block)
    return home


def test_every_kind_of_extension_has_its_example():
    assert set(INSIDE) == set(contributed.CHECKS)
    assert OUTSIDE == ["A protocol", "A preset"]


@pytest.mark.parametrize("title", INSIDE)
def test_an_example_that_is_part_of_the_project_works(title, copy, tmp_path):
    called = {"PYTHONPATH": os.pathsep.join((str(copy), str(ROOT / "tests")))}
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests/contributed.py"), title, *EXAMPLES[title].commands],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=os.environ | called | {"MUJOCO_GL": "disable"},
    )
    assert done.returncode == 0, done.stderr[-3000:]


def test_examples_are_in_the_house_style(copy):
    for what in (["check"], ["format", "--check"]):
        done = subprocess.run(
            [sys.executable, "-m", "ruff", *what, "--no-cache", "."],
            cwd=copy,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("title", OUTSIDE)
def test_an_example_beside_the_project_works(title, cli, tmp_path):
    for block in EXAMPLES[title].blocks:
        put(tmp_path, *block)
    for command in EXAMPLES[title].commands:
        _, script, *arguments = shlex.split(command)
        done = cli(script.removesuffix(".py").replace("/", "."), *arguments)
        assert done.code == 0, done.err


def test_a_protocol_of_ones_own_is_what_the_plate_does(cli, tmp_path):
    """Six rests a sixth of the circle apart, by the encoder."""
    for block in EXAMPLES["A protocol"].blocks:
        put(tmp_path, *block)
    (command,) = EXAMPLES["A protocol"].commands
    assert cli("sim.generate", *shlex.split(command)[2:]).code == 0
    dataset = Dataset.open_finished("six.zarr")
    angle = dataset.label("plate_angle")[0][dataset.label("stage")[0] == REST]
    rests = np.unique(np.rad2deg(angle).round(3))
    np.testing.assert_allclose(rests, [0, 60, 120, 180, 240, 300], atol=0.01)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_what_a_document_names_is_there(document):
    """Files in back-quotes, links, and in a table's row the symbols beside a file's name."""
    text = _BLOCK.sub("", (ROOT / document).read_text())
    made = {path for own in EXAMPLES.values() for _, path, _, _ in own.blocks}
    for path in re.findall(r"`((?:lbgc|sim|conf|tests|docs)/[\w./]*\w)`", text):
        assert (ROOT / path).exists() or path in made, path
    for link in re.findall(r"\]\((?!http)([^)#]+)", text):
        assert ((ROOT / document).parent / link).exists(), link
    for row in re.findall(r"^\|.*\|$", text, re.MULTILINE):
        cells = row.strip("|").split(" | ")
        for place, symbols in pairwise(cells):
            file = re.fullmatch(r" ?`([\w/]+\.py)` ?", place)
            for symbol in re.findall(r"`(\w+)`", symbols) if file else ():
                found = re.search(rf"\b{symbol}\b", (ROOT / file[1]).read_text())
                assert found, f"{file[1]} has no {symbol}"
