"""What every study and the bench share: where results go and what they say of the machine."""

import os
import platform
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import sim.generate
from lbgc import cores
from lbgc.outputs import as_json, write_atomically


def cases(study: str, beside: Path | None = None) -> dict[str, Any]:
    """What a study is of: its YAML file, here or in the directory `beside`; LBGC_STUDY=small puts
    what small.yaml has of it in the place of what it costs, so that the tests run the same code in
    seconds."""
    here = Path(__file__).parent
    own = yaml.safe_load(((beside or here) / f"{study}.yaml").read_text())
    size = os.environ.get("LBGC_STUDY")
    if size is None:
        return own
    return _replaced(own, yaml.safe_load((here / f"{size}.yaml").read_text())[study])


def _replaced(own: dict[str, Any], by: dict[str, Any]) -> dict[str, Any]:
    """`key: value` takes the value's place; `key+: {...}` does so within a group."""
    found = dict(own)
    for key, value in by.items():
        name = key.removesuffix("+")
        assert name in own, f"small.yaml: {name} is no key of its study's cases"
        found[name] = value if name == key else _replaced(own[name], value)
    return found


# A picture is no data, and here would only cost time.
sim.generate.try_picture = lambda *_: None


class Report:
    """Prints lines as they come; on exit writes summary.json and the lines as table.txt."""

    def __init__(self, directory: str):
        self.directory = Path("outputs") / directory
        self.summary: dict[str, object] = {}
        self._lines: list[str] = []

    def line(self, text: str = "") -> None:
        print(text, flush=True)
        self._lines.append(text)

    def __enter__(self) -> "Report":
        self.directory.mkdir(parents=True, exist_ok=True)
        self._started = time.perf_counter()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            return
        self.summary["minutes"] = round((time.perf_counter() - self._started) / 60, 2)
        self.summary["machine"] = f"{platform.machine()}, {cores.count()} cores"
        write_atomically(self.directory / "table.txt", "\n".join(self._lines) + "\n")
        write_atomically(self.directory / "summary.json", as_json(self.summary) + "\n")
        print(self.directory / "summary.json")


def interval95(values: np.ndarray) -> tuple[float, float]:
    """Normal 95% interval of a mean of independent values."""
    half = 1.96 * np.std(values, ddof=1) / np.sqrt(len(values))
    return float(np.mean(values) - half), float(np.mean(values) + half)
